//! Biovision hierarchies (`.bvh`): text of a joint hierarchy, then one line of channel values a frame.
//!
//! What this reader takes: any channel order, one to six channels a joint, position channels on any joint (they replace the matching
//! components of OFFSET), any frame time, End Sites, braces and numbers laid out freely within the hierarchy, any depth (no recursion);
//! UTF-8, or UTF-16 with a byte order mark; lines that end in LF, CR LF or CR.
//!
//! [`load`] is the road from a file to 22 joints at 20 frames a second. Which joints of the file those are, and what its unit is, the user
//! says ([`Reading`]), or a built-in table for the names of a common program, or else the names themselves and the height of the body; what
//! was guessed is told ([`Recording::notes`]).

mod choice;
mod encoding;
mod error;
mod guess;
mod kinematics;
mod mapping;
mod names;
mod parse;
mod plausible;
mod resample;
#[cfg(test)]
mod tests;
mod unit;

use std::path::Path;

pub use error::{Error, Problem};
pub use mapping::{Mapping, MappingError, Source, Up};
pub use parse::parse;
pub use unit::Unit;

use crate::input;
use crate::motion::Pose;
use choice::Choice;

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
    /// Its name; an End Site is called after its joint, `Head End Site`.
    pub name: String,
    /// Index of its parent, smaller than its own; `None` for the root.
    pub parent: Option<usize>,
    /// Position in the parent's frame where no channel says otherwise, file units.
    pub offset: [f64; 3],
    /// Its channels in the order of the file.
    pub channels: Vec<Channel>,
    /// Index of its first channel in a frame.
    pub first_channel: usize,
    /// True for the End Site of its parent, which has no channels.
    pub end_site: bool,
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

/// Bytes of a file at most: some ten hours of a body with fingers at 30 frames a second.
const LARGEST_FILE: u64 = 1 << 30;

/// What the user says about a file.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Reading {
    /// Which joints are which; the built-in tables ([`Mapping::built_in`]) are tried and the names guessed from where there is none.
    pub mapping: Option<Mapping>,
    /// What a unit of the file is, whatever the mapping says.
    pub unit: Option<Unit>,
}

/// A recording as 22 joints at 20 frames a second.
#[derive(Debug, Clone, PartialEq)]
pub struct Recording {
    /// Global joints, metres, y up; neither moved to the origin nor retargeted.
    pub joints: Vec<Pose>,
    /// Frame rate of the file, 1/s.
    pub fps_source: f64,
    /// Name of the mapping that fitted; `guessed` where none did.
    pub mapping: String,
    /// What was guessed or looks unusual, a sentence each.
    pub notes: Vec<String>,
}

/// Reads a file, maps it to the 22 joints and resamples it to 20 frames a second.
///
/// # Errors
/// [`Error`], naming the file, the line and what to do.
pub fn load(path: &Path, reading: &Reading) -> Result<Recording, Error> {
    let at = |line: usize, problem: Problem| Error { path: path.to_path_buf(), line, problem };
    let bytes = input::read(path, LARGEST_FILE).map_err(|source| at(0, Problem::Read(source)))?;
    let bvh = parse(&encoding::text(&bytes)).map_err(|(line, problem)| at(line, problem))?;
    let choice = Choice::of(&bvh, reading).map_err(|problem| at(0, problem))?;
    let frames = resample::to_20_fps(&bvh, choice.first);
    let joints: Vec<Pose> = frames.map(|frame| choice.pose(&kinematics::positions(&bvh, &frame))).collect();
    plausible::check(&joints).map_err(|problem| at(0, problem))?;
    Ok(Recording { joints, fps_source: bvh.fps(), mapping: choice.mapping, notes: choice.notes })
}
