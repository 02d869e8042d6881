//! Dataset to file and back.

use std::path::Path;

use safetensors::tensor::TensorView;
use safetensors::{Dtype, SafeTensors};
use serde_json::json;

use super::{Clip, Dataset, Error, FORMAT, VERSIONS, digest};
use crate::input;
use crate::motion::{FEATURES, JOINTS};
use crate::output::write_atomic;

impl Dataset {
    /// Writes the file whole or not at all. Equal datasets give equal bytes.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn save(&self, path: impl AsRef<Path>) -> Result<(), Error> {
        let rows = self.frames();
        let joints_end = rows * JOINTS * 3 * 4;
        let features_end = joints_end + rows * FEATURES * 4;
        let offsets_end = features_end + self.offsets.len() * 4;
        // The names sort as the tensors lie; serde_json's map is sorted too, so the header is the same every time.
        let mut header = serde_json::to_vec(&json!({
            "__metadata__": {
                "clips": json!(self.clips).to_string(),
                "format": FORMAT,
                "hash": self.hash,
                "version": VERSIONS[usize::from(self.clips.iter().any(|clip| clip.facts.is_some()))],
            },
            "joints": {"dtype": "F32", "shape": [rows, JOINTS, 3], "data_offsets": [0, joints_end]},
            "features": {"dtype": "F32", "shape": [rows, FEATURES], "data_offsets": [joints_end, features_end]},
            "offsets": {"dtype": "I32", "shape": [self.offsets.len()], "data_offsets": [features_end, offsets_end]},
        }))
        .unwrap_or_default();
        header.resize(header.len().next_multiple_of(8), b' ');
        write_atomic(path, |w| {
            w.write_all(&(header.len() as u64).to_le_bytes())?;
            w.write_all(&header)?;
            digest::bytes_of(&self.joints, |block| w.write_all(block))?;
            digest::bytes_of(&self.features, |block| w.write_all(block))?;
            self.offsets.iter().try_for_each(|&offset| w.write_all(&(offset as i32).to_le_bytes()))
        })?;
        Ok(())
    }

    /// Reads a file and checks all of it: format, shapes, clip ranges, finite values, hashes.
    ///
    /// # Errors
    /// [`Error`], naming the file and what is wrong in it.
    pub fn load(path: impl AsRef<Path>) -> Result<Self, Error> {
        let path = path.as_ref();
        let bytes = input::read(path, input::ANY).map_err(|source| Error::Read { path: path.to_path_buf(), source })?;
        let container = |source| Error::Container { path: path.to_path_buf(), source };
        let (_, header) = SafeTensors::read_metadata(&bytes).map_err(container)?;
        let file = SafeTensors::deserialize(&bytes).map_err(container)?;

        let entry = |name: &'static str| {
            header.metadata().as_ref().and_then(|m| m.get(name)).ok_or_else(|| Error::Metadata {
                path: path.to_path_buf(),
                entry: name,
                reason: "missing".into(),
            })
        };
        let (format, version) = (entry("format")?, entry("version")?);
        if format != FORMAT || !VERSIONS.contains(&version.as_str()) {
            return Err(Error::Version { path: path.to_path_buf(), found: format!("{format} version {version}") });
        }
        let clips: Vec<Clip> = serde_json::from_str(entry("clips")?).map_err(|error| Error::Metadata {
            path: path.to_path_buf(),
            entry: "clips",
            reason: error.to_string(),
        })?;
        let hash = entry("hash")?.clone();

        let joints = tensor(path, &file, "joints", Dtype::F32, &[None, Some(JOINTS), Some(3)])?;
        let rows = joints.shape()[0];
        let features = tensor(path, &file, "features", Dtype::F32, &[Some(rows), Some(FEATURES)])?;
        let offsets = tensor(path, &file, "offsets", Dtype::I32, &[Some(clips.len() + 1)])?;
        let offsets = ranges(path, &offsets, rows)?;
        let (joints, features) = (floats(joints.data()), floats(features.data()));
        drop(bytes);

        let dataset = Self { clips, joints, features, offsets, hash };
        let damaged = |what: String| Error::Hash { path: path.to_path_buf(), what };
        if let Some(index) = digest::first_mismatch(&dataset) {
            return Err(damaged(format!("clip {}", dataset.clips[index].id)));
        }
        if digest::whole(&dataset.clips) != dataset.hash {
            return Err(damaged("the list of clips".into()));
        }
        if let Some(clip) =
            dataset.iter().find(|clip| !finite(clip.joints.as_flattened().as_flattened(), clip.features))
        {
            return Err(Error::Value { clip: clip.info.id.clone() });
        }
        Ok(dataset)
    }
}

fn finite(joints: &[f32], features: &[f32]) -> bool {
    joints.iter().chain(features).all(|x| x.is_finite())
}

/// A tensor of the type and shape the rest of the file asks for; `None` is any size.
fn tensor<'a>(
    path: &Path,
    file: &SafeTensors<'a>,
    name: &'static str,
    dtype: Dtype,
    shape: &[Option<usize>],
) -> Result<TensorView<'a>, Error> {
    let wrong = |found: String| {
        let sizes: Vec<String> = shape.iter().map(|n| n.map_or("any".into(), |n| n.to_string())).collect();
        let expected = format!("{dtype:?} [{}]", sizes.join(", "));
        Error::Tensor { path: path.to_path_buf(), tensor: name, expected, found }
    };
    let view = file.tensor(name).map_err(|_| wrong("missing".into()))?;
    let fits =
        view.shape().len() == shape.len() && view.shape().iter().zip(shape).all(|(&n, m)| m.is_none_or(|m| m == n));
    if view.dtype() != dtype || !fits {
        return Err(wrong(format!("{:?} {:?}", view.dtype(), view.shape())));
    }
    Ok(view)
}

/// Clip ranges: strictly ascending from 0 to the number of rows.
fn ranges(path: &Path, offsets: &TensorView<'_>, rows: usize) -> Result<Vec<usize>, Error> {
    let values: Vec<i64> =
        offsets.data().as_chunks::<4>().0.iter().map(|&bytes| i64::from(i32::from_le_bytes(bytes))).collect();
    let wrong = |clip, from, to| Error::Offsets { path: path.to_path_buf(), clip, from, to, rows };
    if let Some(&first) = values.first().filter(|&&first| first != 0) {
        return Err(wrong(0, first, values.get(1).copied().unwrap_or(first)));
    }
    if let Some(clip) = values.windows(2).position(|pair| pair[0] >= pair[1]) {
        return Err(wrong(clip, values[clip], values[clip + 1]));
    }
    let last = values.last().copied().unwrap_or(-1);
    if last != rows as i64 {
        return Err(wrong(
            values.len().saturating_sub(2),
            values.get(values.len().wrapping_sub(2)).copied().unwrap_or(0),
            last,
        ));
    }
    Ok(values.into_iter().map(|offset| offset as usize).collect())
}

fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes.as_chunks::<4>().0.iter().map(|&b| f32::from_le_bytes(b)).collect()
}
