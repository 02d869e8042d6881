//! Files of a folder, names of clips, choice of splits: what the imports have in common.

use std::path::{Path, PathBuf};
use std::{fs, io};

use crate::dataset::Split;

/// How clips that come without a split get one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SplitChoice {
    /// By a hash of the name: about 80 % train, 5 % val, 15 % test, the same every time.
    ByName,
    /// All the same.
    Fixed(Split),
}

impl SplitChoice {
    /// The split of a clip.
    pub fn of(self, id: &str) -> Split {
        match self {
            Self::Fixed(split) => split,
            Self::ByName => match fnv1a(id) % 100 {
                0..80 => Split::Train,
                80..85 => Split::Val,
                _ => Split::Test,
            },
        }
    }
}

/// 64-bit FNV-1a, folded to mix the low bits.
pub(super) fn fnv1a(text: &str) -> u64 {
    let hash =
        text.bytes().fold(0xcbf2_9ce4_8422_2325u64, |h, b| (h ^ u64::from(b)).wrapping_mul(0x0000_0100_0000_01b3));
    hash ^ (hash >> 32)
}

/// A file and the name of its clip.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Found {
    /// The file.
    pub path: PathBuf,
    /// Its path below the folder given, without ending; the bare name for a file given itself.
    pub id: String,
}

/// All files with this ending: `path` itself, or regular files below it when it is a folder, in the order of their names. Links to folders
/// are not followed.
///
/// # Errors
/// What the system says, with the path.
pub fn files(path: &Path, ending: &str) -> Result<Vec<Found>, (PathBuf, io::Error)> {
    if !fs::metadata(path).map_err(|error| (path.to_path_buf(), error))?.is_dir() {
        let id = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        return Ok(vec![Found { path: path.to_path_buf(), id }]);
    }
    let mut found = Vec::new();
    let mut folders = vec![path.to_path_buf()];
    while let Some(folder) = folders.pop() {
        let failed = |error| (folder.clone(), error);
        for entry in fs::read_dir(&folder).map_err(failed)? {
            let entry = entry.map_err(failed)?;
            let here = entry.path();
            if entry.file_type().map_err(failed)?.is_dir() {
                folders.push(here);
            } else if here.extension().is_some_and(|e| e.eq_ignore_ascii_case(ending)) && here.is_file() {
                let below = here.strip_prefix(path).unwrap_or(&here).with_extension("");
                let id = below.components().map(|c| c.as_os_str().to_string_lossy()).collect::<Vec<_>>().join("/");
                found.push(Found { path: here, id });
            }
        }
    }
    found.sort_by(|a, b| a.id.cmp(&b.id));
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn splits_by_name_have_their_shares_and_stay() {
        let mut counts = [0usize; 3];
        for i in 0..10_000 {
            let id = format!("clip_{i:05}");
            assert_eq!(SplitChoice::ByName.of(&id), SplitChoice::ByName.of(&id));
            counts[SplitChoice::ByName.of(&id) as usize] += 1;
        }
        assert!((7800..8200).contains(&counts[0]) && (400..600).contains(&counts[1]), "{counts:?}");
    }

    #[test]
    fn files_are_found_at_any_depth_in_order() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir_all(folder.path().join("b/c")).unwrap();
        for name in ["z.bvh", "b/c/a.BVH", "b/x.txt", "a.bvh"] {
            fs::write(folder.path().join(name), "").unwrap();
        }
        let ids: Vec<String> = files(folder.path(), "bvh").unwrap().into_iter().map(|f| f.id).collect();
        assert_eq!(ids, ["a", "b/c/a", "z"]);
        assert_eq!(files(&folder.path().join("z.bvh"), "bvh").unwrap()[0].id, "z");
        assert!(files(&folder.path().join("none"), "bvh").is_err());
    }
}
