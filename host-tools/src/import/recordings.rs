//! BVH files into a dataset.

use std::path::PathBuf;

use super::bvh::{self, Reading};
use super::collect::{self, SplitChoice};
use super::{Summary, captions};
use crate::dataset::{Builder, Caption, Clip, Dataset};
use crate::motion::features::{self, Options, Processed};
use crate::parallel;

/// What to import and how.
#[derive(Debug, Clone)]
pub struct Request {
    /// Files, or folders that are searched for `.bvh`.
    pub paths: Vec<PathBuf>,
    /// What is known of the files.
    pub reading: Reading,
    /// Name of the collection.
    pub subset: String,
    /// How splits are chosen.
    pub split: SplitChoice,
    /// Leave out clips with fewer frames than this at 20 frames a second.
    pub shortest: usize,
    /// Leave out files that cannot be read instead of failing.
    pub skip_bad: bool,
    /// Extraction.
    pub options: Options,
}

/// Why recordings cannot be imported.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A path cannot be searched.
    #[error("cannot look into {}", path.display())]
    Search {
        /// The path.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A folder holds no recording.
    #[error("no .bvh file in {}", path.display())]
    Nothing {
        /// The path.
        path: PathBuf,
    },
    /// A file is bad.
    #[error(transparent)]
    Bvh(#[from] bvh::Error),
    /// A caption file is bad.
    #[error(transparent)]
    Captions(#[from] captions::Error),
    /// A motion has no features.
    #[error("{} has no features", path.display())]
    Features {
        /// The file.
        path: PathBuf,
        /// What is wrong with the motion.
        source: features::Error,
    },
    /// The result does not fit into a dataset.
    #[error(transparent)]
    Dataset(#[from] crate::dataset::Error),
}

/// Reads recordings and extracts features. A text file of the same name beside a recording holds its captions ([`captions::read`]).
/// `progress` is called with (1, total) once a file.
///
/// # Errors
/// [`Error`], naming the file; files that cannot be read are only listed when `skip_bad` is set.
pub fn import(request: &Request, progress: &(dyn Fn(usize, usize) + Sync)) -> Result<(Dataset, Summary), Error> {
    let mut found = Vec::new();
    for path in &request.paths {
        let files = collect::files(path, "bvh").map_err(|(path, source)| Error::Search { path, source })?;
        if files.is_empty() {
            return Err(Error::Nothing { path: path.clone() });
        }
        found.extend(files);
    }
    let read = parallel::map(&found, |file| {
        let result = read(request, file);
        progress(1, found.len());
        result
    });
    let mut builder = Builder::new();
    let mut summary = Summary::default();
    for (file, result) in found.iter().zip(read) {
        match result {
            Ok(Some(Read { clip, motion, notes })) => {
                summary.count(&clip, motion.joints.len());
                notes.into_iter().for_each(|note| summary.note(&clip.id, note));
                builder.push(clip, &motion.joints, &motion.features)?;
            }
            Ok(None) => summary.skip(&file.id, format!("fewer than {} frames", request.shortest)),
            Err(error) if request.skip_bad => summary.skip(&file.id, super::chain(&error)),
            Err(error) => return Err(error),
        }
    }
    Ok((builder.finish(), summary))
}

/// A recording as it goes into a dataset.
struct Read {
    clip: Clip,
    motion: Processed,
    /// What was guessed.
    notes: Vec<String>,
}

/// `None` for a recording that is too short.
fn read(request: &Request, file: &collect::Found) -> Result<Option<Read>, Error> {
    let recording = bvh::load(&file.path, &request.reading)?;
    if recording.joints.len() < request.shortest {
        return Ok(None);
    }
    let motion = features::process(&recording.joints, &request.options)
        .map_err(|source| Error::Features { path: file.path.clone(), source })?;
    let text = file.path.with_extension("txt");
    let captions: Vec<Caption> = if text.is_file() { captions::read(&text, "user")? } else { Vec::new() };
    let clip = Clip {
        id: file.id.clone(),
        split: request.split.of(&file.id),
        subset: request.subset.clone(),
        source: file.path.file_name().unwrap_or_default().to_string_lossy().into_owned(),
        fps_source: recording.fps_source,
        captions,
        labels: serde_json::json!({"mapping": recording.mapping}),
        facts: None,
        hash: String::new(),
    };
    Ok(Some(Read { clip, motion, notes: recording.notes }))
}
