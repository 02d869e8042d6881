//! The motion-capture pack: `clips.jsonl` and `joints.safetensors` in one folder.
//!
//! `joints.safetensors` holds `local` f16 `[N][22][3]` (positions without the pelvis' x, z), `root_xz` f32 `[N][2]` and `offsets` i32
//! `[clips + 1]`; clip i is line i of `clips.jsonl`. Global metres = local + (root x, 0, root z).

use std::path::{Path, PathBuf};

use half::f16;
use safetensors::{Dtype, SafeTensors};
use serde::Deserialize;

use super::Summary;
use crate::dataset::{Builder, Caption, Clip, Dataset, Split};
use crate::input;
use crate::motion::features::{self, Options};
use crate::motion::{JOINTS, Pose};
use crate::parallel;

/// Why a pack cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file of the pack cannot be read.
    #[error("cannot read {}; the folder of a pack holds clips.jsonl and joints.safetensors", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A line of `clips.jsonl` is not a clip.
    #[error("{} line {line} does not describe a clip", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// What the reader said.
        source: serde_json::Error,
    },
    /// `joints.safetensors` is not a whole safetensors file.
    #[error("{} is not a whole safetensors file; fetch the pack again", path.display())]
    Container {
        /// The file.
        path: PathBuf,
        /// What the format reader said.
        source: safetensors::SafeTensorError,
    },
    /// A tensor is missing or does not fit the others or the list of clips.
    #[error("{}: {problem}; clips.jsonl and joints.safetensors must be of the same pack", path.display())]
    Mismatch {
        /// The file.
        path: PathBuf,
        /// What does not fit.
        problem: String,
    },
    /// The result does not fit into a dataset.
    #[error(transparent)]
    Dataset(#[from] crate::dataset::Error),
}

/// A line of `clips.jsonl`, as far as it is used.
#[derive(Debug, Deserialize)]
struct Line {
    id: String,
    subset: String,
    source: String,
    src_fps: f64,
    split: Split,
    captions: Vec<LineCaption>,
    #[serde(default)]
    labels: serde_json::Value,
    n_frames: usize,
}

#[derive(Debug, Deserialize)]
struct LineCaption {
    text: String,
    f: f64,
    t: f64,
    src: String,
}

/// A clip as the pack has it.
#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    /// Its description.
    pub clip: Clip,
    /// Global joints, metres: captured bone lengths, first frame at the origin facing +z.
    pub joints: Vec<Pose>,
}

/// Reads a pack as it is.
///
/// # Errors
/// [`Error`], naming the file and the line.
pub fn read(folder: &Path) -> Result<Vec<Recording>, Error> {
    let lines = read_lines(&folder.join("clips.jsonl"))?;
    let motions = read_motions(&folder.join("joints.safetensors"), &lines)?;
    Ok(lines.into_iter().zip(motions).map(|(line, joints)| Recording { clip: describe(line), joints }).collect())
}

/// Reads a pack and extracts features. `progress` is called with (1, total) once a clip.
///
/// Clips with fewer than `shortest` frames, or whose motion has no features, are left out and listed in the summary.
///
/// # Errors
/// [`Error`], naming the file and the line.
pub fn import(
    folder: &Path,
    shortest: usize,
    options: &Options,
    progress: &(dyn Fn(usize, usize) + Sync),
) -> Result<(Dataset, Summary), Error> {
    let recordings = read(folder)?;
    let processed = parallel::map(&recordings, |Recording { joints, .. }| {
        let result = if joints.len() < shortest {
            Err(format!("{} frames, fewer than {shortest}", joints.len()))
        } else {
            features::process(joints, options).map_err(|error| error.to_string())
        };
        progress(1, recordings.len());
        result
    });

    let mut builder = Builder::new();
    let mut summary = Summary::default();
    for (Recording { clip, .. }, result) in recordings.into_iter().zip(processed) {
        match result {
            Ok(motion) => {
                summary.count(&clip, motion.joints.len());
                builder.push(clip, &motion.joints, &motion.features)?;
            }
            Err(reason) => summary.skip(&clip.id, reason),
        }
    }
    Ok((builder.finish(), summary))
}

fn describe(line: Line) -> Clip {
    let caption = |c: LineCaption| Caption { text: c.text, from: c.f, to: c.t, source: c.src };
    Clip {
        id: line.id,
        split: line.split,
        subset: line.subset,
        source: line.source,
        fps_source: line.src_fps,
        captions: line.captions.into_iter().map(caption).collect(),
        labels: line.labels,
        facts: None,
        hash: String::new(),
    }
}

fn read_lines(path: &Path) -> Result<Vec<Line>, Error> {
    let text = input::read_text(path, input::ANY).map_err(|source| Error::Read { path: path.to_path_buf(), source })?;
    text.lines()
        .enumerate()
        .filter(|(_, line)| !line.trim().is_empty())
        .map(|(index, line)| {
            serde_json::from_str(line).map_err(|source| Error::Line {
                path: path.to_path_buf(),
                line: index + 1,
                source,
            })
        })
        .collect()
}

/// Global joints of every clip, metres.
fn read_motions(path: &Path, lines: &[Line]) -> Result<Vec<Vec<Pose>>, Error> {
    let bytes = input::read(path, input::ANY).map_err(|source| Error::Read { path: path.to_path_buf(), source })?;
    let file =
        SafeTensors::deserialize(&bytes).map_err(|source| Error::Container { path: path.to_path_buf(), source })?;
    let mismatch = |problem: String| Error::Mismatch { path: path.to_path_buf(), problem };
    let tensor = |name: &str, dtype: Dtype, inner: &[usize]| {
        let view = file.tensor(name).map_err(|_| mismatch(format!("tensor {name:?} is missing")))?;
        if view.dtype() != dtype || view.shape().get(1..) != Some(inner) {
            let found = format!("{:?} {:?}", view.dtype(), view.shape());
            return Err(mismatch(format!("tensor {name:?} is {found}, not {dtype:?} [N, {inner:?}]")));
        }
        Ok(view)
    };
    let local = tensor("local", Dtype::F16, &[JOINTS, 3])?;
    let root = tensor("root_xz", Dtype::F32, &[2])?;
    let offsets = tensor("offsets", Dtype::I32, &[])?;
    let rows = local.shape()[0];
    if root.shape()[0] != rows {
        return Err(mismatch(format!("{rows} rows of \"local\" but {} of \"root_xz\"", root.shape()[0])));
    }
    let offsets: Vec<i64> =
        offsets.data().as_chunks::<4>().0.iter().map(|&b| i64::from(i32::from_le_bytes(b))).collect();
    if offsets.len() != lines.len() + 1 {
        return Err(mismatch(format!("{} offsets for {} clips", offsets.len(), lines.len())));
    }
    let local = local.data().as_chunks::<2>().0;
    let root = root.data().as_chunks::<4>().0;
    let pose = |row: usize| -> Pose {
        let ground = [f32::from_le_bytes(root[row * 2]), 0.0, f32::from_le_bytes(root[row * 2 + 1])];
        std::array::from_fn(|j| {
            std::array::from_fn(|c| f16::from_le_bytes(local[(row * JOINTS + j) * 3 + c]).to_f32() + ground[c])
        })
    };
    lines
        .iter()
        .zip(offsets.windows(2))
        .map(|(line, range)| {
            let (from, to) = (range[0], range[1]);
            if from < 0 || to < from || to > rows as i64 || to - from != line.n_frames as i64 {
                return Err(mismatch(format!(
                    "clip {} of {} frames has rows {from}..{to} of {rows}",
                    line.id, line.n_frames
                )));
            }
            Ok((from as usize..to as usize).map(pose).collect())
        })
        .collect()
}
