//! Biovision hierarchies (`.bvh`): text of a joint hierarchy, then one line of channel values a frame.
//!
//! What this reader takes: any channel order, one to six channels a joint, position channels on any joint (they replace the matching
//! components of OFFSET), any frame time, End Sites, braces and numbers laid out freely within the hierarchy, any depth (no recursion).
//!
//! [`load`] is the road from a file to 22 joints at 20 frames a second.

mod error;
mod kinematics;
mod mapping;
mod parse;
mod resample;
#[cfg(test)]
mod tests;

use std::path::Path;

pub use error::{Error, Problem};
pub use mapping::{Mapping, MappingError, Source};
pub use parse::parse;

use crate::motion::Pose;

/// A component that varies over time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Channel {
    /// Position along an axis (0 = x), in the file's unit; replaces that component of the offset.
    Position(usize),
    /// Rotation about an axis (0 = x), degrees; a joint's rotations apply from the last listed to the first.
    Rotation(usize),
}

/// A joint of the hierarchy.
#[derive(Debug, Clone, PartialEq)]
pub struct Joint {
    /// Its name; End Sites are not joints.
    pub name: String,
    /// Index of its parent, smaller than its own; `None` for the root.
    pub parent: Option<usize>,
    /// Position in the parent's frame where no channel says otherwise, file units.
    pub offset: [f64; 3],
    /// Its channels in the order of the file.
    pub channels: Vec<Channel>,
    /// Index of its first channel in a frame.
    pub first_channel: usize,
}

/// A parsed file.
#[derive(Debug, Clone, PartialEq)]
pub struct Bvh {
    /// Joints, parents first.
    pub joints: Vec<Joint>,
    /// Seconds a frame.
    pub frame_time: f64,
    /// Channels a frame.
    pub channels: usize,
    /// `[frames][channels]`.
    pub values: Vec<f64>,
}

impl Bvh {
    /// Number of frames.
    pub fn frames(&self) -> usize {
        self.values.len() / self.channels
    }

    /// Frames a second. Rates that are whole up to the digits files give (0.0333333, 0.008333) come out whole.
    pub fn fps(&self) -> f64 {
        let fps = 1.0 / self.frame_time;
        if (fps - fps.round()).abs() < 0.01 { fps.round() } else { fps }
    }
}

/// A recording as 22 joints at 20 frames a second.
#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    /// Global joints, metres, y up; neither moved to the origin nor retargeted.
    pub joints: Vec<Pose>,
    /// Frame rate of the file, 1/s.
    pub fps_source: f64,
    /// Name of the mapping that fitted.
    pub mapping: String,
}

/// Reads a file, maps it to the 22 joints and resamples it to 20 frames a second.
///
/// With `mapping` = `None` the built-in tables are tried in turn ([`Mapping::built_in`]).
///
/// # Errors
/// [`Error`], naming the file, the line and what to do.
pub fn load(path: &Path, mapping: Option<&Mapping>) -> Result<Recording, Error> {
    let at = |line: usize, problem: Problem| Error { path: path.to_path_buf(), line, problem };
    let bytes = std::fs::read(path).map_err(|source| at(0, Problem::Read(source)))?;
    let bvh = parse(&String::from_utf8_lossy(&bytes)).map_err(|(line, problem)| at(line, problem))?;
    let built_in;
    let mapping = match mapping {
        Some(mapping) => mapping,
        None => {
            built_in = Mapping::detect(&bvh).map_err(|problem| at(0, problem))?;
            &built_in
        }
    };
    let sources = mapping.resolve(&bvh).map_err(|problem| at(0, problem))?;
    let first = mapping.drop_frames.min(bvh.frames());
    let place = |frame| mapping.pose(&sources, &kinematics::positions(&bvh, &frame));
    let joints: Vec<Pose> = resample::to_20_fps(&bvh, first).map(place).collect();
    if joints.is_empty() {
        return Err(at(0, Problem::NothingLeft { dropped: first }));
    }
    Ok(Recording { joints, fps_source: bvh.fps(), mapping: mapping.name.clone() })
}
