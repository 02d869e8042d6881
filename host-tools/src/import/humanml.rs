//! A folder in HumanML3D's layout.
//!
//! | what | where |
//! |---|---|
//! | features `[T][263]` | `new_joint_vecs/<id>.npy` |
//! | joints `[T][22][3]`, used where a clip has no features | `new_joints/<id>.npy` |
//! | captions | `texts/<id>.txt` |
//! | splits, one id a line | `train.txt`, `val.txt`, `test.txt` |
//!
//! Arrays are f32 or f64. Features are taken as they are and joints recovered from them; where only joints exist, features are
//! extracted (which costs their last frame). Ids in no split file get a split by name.

use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

use super::collect::{self, SplitChoice};
use super::{Summary, captions, npy};
use crate::dataset::{Builder, Clip, Dataset, Split};
use crate::input;
use crate::motion::features::{self, Options, Processed};
use crate::motion::{FEATURES, FPS, JOINTS, Pose, recover};
use crate::parallel;

/// What to import and how.
#[derive(Debug, Clone)]
pub struct Request {
    /// The folder.
    pub folder: PathBuf,
    /// Name of the collection.
    pub subset: String,
    /// Splits of ids that no split file names.
    pub split: SplitChoice,
    /// Leave out clips with fewer frames than this.
    pub shortest: usize,
    /// Leave out clips that cannot be read instead of failing.
    pub skip_bad: bool,
    /// Extraction, where only joints exist.
    pub options: Options,
}

/// Why a folder cannot be imported.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A path cannot be read.
    #[error("cannot read {}", path.display())]
    Read {
        /// The path.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The folder has neither features nor joints.
    #[error("{} holds no .npy files in new_joint_vecs/ or new_joints/; give the folder that has these two", folder.display())]
    Nothing {
        /// The folder.
        folder: PathBuf,
    },
    /// An array cannot be read.
    #[error(transparent)]
    Array(#[from] npy::Error),
    /// An array has another shape.
    #[error("{} has shape {found:?}, not [frames, {expected}]", path.display())]
    Shape {
        /// The file.
        path: PathBuf,
        /// Shape found.
        found: Vec<usize>,
        /// Sizes after the first.
        expected: &'static str,
    },
    /// A value is NaN or infinite.
    #[error("{}: frame {frame} holds a value that is not finite; leave the clip out (--skip-bad)", path.display())]
    NotFinite {
        /// The file.
        path: PathBuf,
        /// Frame, from 0.
        frame: usize,
    },
    /// A motion has no features.
    #[error("{} has no features", path.display())]
    Features {
        /// The file.
        path: PathBuf,
        /// What is wrong with the motion.
        source: features::Error,
    },
    /// A caption file is bad.
    #[error(transparent)]
    Captions(#[from] captions::Error),
    /// The result does not fit into a dataset.
    #[error(transparent)]
    Dataset(#[from] crate::dataset::Error),
}

/// Which array a clip comes from.
#[derive(Debug, Clone, PartialEq, Eq)]
enum Array {
    Features(PathBuf),
    Joints(PathBuf),
}

/// Reads a folder. `progress` is called with (1, total) once a clip.
///
/// # Errors
/// [`Error`], naming the file; clips that cannot be read are only listed when `skip_bad` is set.
pub fn import(request: &Request, progress: &(dyn Fn(usize, usize) + Sync)) -> Result<(Dataset, Summary), Error> {
    let mut arrays = BTreeMap::new();
    for found in list(&request.folder.join("new_joints"))? {
        arrays.insert(found.id, Array::Joints(found.path));
    }
    for found in list(&request.folder.join("new_joint_vecs"))? {
        arrays.insert(found.id, Array::Features(found.path));
    }
    if arrays.is_empty() {
        return Err(Error::Nothing { folder: request.folder.clone() });
    }
    let splits = splits(&request.folder)?;
    let arrays: Vec<(String, Array)> = arrays.into_iter().collect();
    let read = parallel::map(&arrays, |(id, array)| {
        let result = read(request, id, array, &splits);
        progress(1, arrays.len());
        result
    });
    let mut builder = Builder::new();
    let mut summary = Summary::default();
    for ((id, _), result) in arrays.iter().zip(read) {
        match result {
            Ok(Some((clip, motion))) => {
                summary.count(&clip, motion.joints.len());
                builder.push(clip, &motion.joints, &motion.features)?;
            }
            Ok(None) => summary.skip(id, format!("fewer than {} frames", request.shortest)),
            Err(error) if request.skip_bad => summary.skip(id, super::chain(&error)),
            Err(error) => return Err(error),
        }
    }
    Ok((builder.finish(), summary))
}

/// The arrays of a folder; none when there is no such folder.
fn list(folder: &Path) -> Result<Vec<collect::Found>, Error> {
    if !folder.is_dir() {
        return Ok(Vec::new());
    }
    collect::files(folder, "npy").map_err(|(path, source)| Error::Read { path, source })
}

fn splits(folder: &Path) -> Result<HashMap<String, Split>, Error> {
    let mut splits = HashMap::new();
    for split in [Split::Train, Split::Val, Split::Test] {
        let path = folder.join(format!("{split}.txt"));
        if path.is_file() {
            let text = input::read_text(&path, input::ANY).map_err(|source| Error::Read { path, source })?;
            splits.extend(text.split_whitespace().map(|id| (id.to_string(), split)));
        }
    }
    Ok(splits)
}

fn read(
    request: &Request,
    id: &str,
    array: &Array,
    splits: &HashMap<String, Split>,
) -> Result<Option<(Clip, Processed)>, Error> {
    let (path, motion) = match array {
        Array::Features(path) => (path, from_features(path)?),
        Array::Joints(path) => (path, from_joints(path, &request.options)?),
    };
    if motion.joints.len() < request.shortest {
        return Ok(None);
    }
    let text = request.folder.join("texts").join(format!("{id}.txt"));
    let clip = Clip {
        id: id.into(),
        split: splits.get(id).copied().unwrap_or_else(|| request.split.of(id)),
        subset: request.subset.clone(),
        source: path.strip_prefix(&request.folder).unwrap_or(path).to_string_lossy().into_owned(),
        fps_source: FPS,
        captions: if text.is_file() { captions::read(&text, "humanml3d")? } else { Vec::new() },
        labels: serde_json::Value::Null,
        facts: None,
        hash: String::new(),
    };
    Ok(Some((clip, motion)))
}

/// Reads `[T][inner...]` with finite values.
fn finite(path: &Path, inner: &[usize], expected: &'static str) -> Result<npy::Array, Error> {
    let array = npy::read(path)?;
    if array.shape.get(1..) != Some(inner) || array.shape[0] == 0 {
        return Err(Error::Shape { path: path.to_path_buf(), found: array.shape, expected });
    }
    let width: usize = inner.iter().product();
    match array.data.iter().position(|&x| !(x as f32).is_finite()) {
        Some(index) => Err(Error::NotFinite { path: path.to_path_buf(), frame: index / width }),
        None => Ok(array),
    }
}

fn from_features(path: &Path) -> Result<Processed, Error> {
    let array = finite(path, &[FEATURES], "263")?;
    // The shape has been checked: whole rows.
    let joints = recover::joints_f64(&array.data).unwrap_or_default();
    let joints = joints.into_iter().map(|pose| pose.map(|p| p.map(|x| x as f32))).collect();
    Ok(Processed { joints, features: array.data.iter().map(|&x| x as f32).collect() })
}

fn from_joints(path: &Path, options: &Options) -> Result<Processed, Error> {
    let array = finite(path, &[JOINTS, 3], "22, 3")?;
    let (points, _) = array.data.as_chunks::<3>();
    let (poses, _) = points.as_chunks::<JOINTS>();
    let poses: Vec<Pose> = poses.iter().map(|pose| pose.map(|p| p.map(|x| x as f32))).collect();
    features::process(&poses, options).map_err(|source| Error::Features { path: path.to_path_buf(), source })
}
