//! `robot.toml`: what a robot's servos are, what each of them follows, and what it may do.
//!
//! ```toml
//! name = "nodder"
//! tick_rate = 50
//!
//! [defaults]
//! bus = "pca9685"
//! pulse = [500, 2500]
//! speed = 300
//! acceleration = 2000
//!
//! [[channel]]
//! name = "nod"
//! joint = "neck"
//! axis = "x"
//! range = [-40, 40]
//! output = 0
//! ```
//!
//! `docs/robot.md` says what every key means. [`parse`] finds everything that is wrong with a text, each with its line; [`load`] takes a
//! preset's name, a file, or a packed robot.

mod channel;
mod error;
mod presets;
mod reader;
mod version1;
mod violations;

use std::path::Path;

use motionette::playback::Robot;
use motionette::playback::robot::{MAGIC, MAX_BYTES, RobotError};

pub use error::{Error, Problem, Problems};
pub use presets::{PRESETS, Preset, preset, preset_names};
pub use version1::{Lifted, lift};

/// A robot by the name of a preset, or from a file: a `robot.toml` or a packed robot.
///
/// # Errors
/// [`Error`].
pub fn load(name: &str) -> Result<Robot, Error> {
    if let Some(preset) = preset(name) {
        return Ok(parse(preset.text, preset.name)?);
    }
    let path = Path::new(name);
    if !path.exists() && path.extension().is_none() && path.components().count() == 1 {
        return Err(Error::NoSuchRobot { name: name.to_owned() });
    }
    read(path)
}

/// Reads a `robot.toml` or a packed robot.
///
/// # Errors
/// [`Error::Read`], [`Error::Invalid`], or [`Error::Packed`].
pub fn read(path: &Path) -> Result<Robot, Error> {
    let failed = |source| Error::Read { path: path.to_path_buf(), source };
    let bytes = std::fs::read(path).map_err(failed)?;
    if bytes.starts_with(&MAGIC) {
        return Robot::open(&bytes).map_err(|source| Error::Packed { path: path.to_path_buf(), source });
    }
    let text = String::from_utf8(bytes).map_err(|e| failed(std::io::Error::new(std::io::ErrorKind::InvalidData, e)))?;
    Ok(parse(&text, &path.display().to_string())?)
}

/// Parses the text of a `robot.toml`; `file` is what complaints call it.
///
/// # Errors
/// [`Problems`]: everything that is wrong, each with its line.
pub fn parse(text: &str, file: &str) -> Result<Robot, Problems> {
    reader::parse(text).map_err(|mut problems| {
        problems.sort_by_key(|problem| (problem.line, problem.column));
        Problems { file: file.to_owned(), problems }
    })
}

/// The bytes of a packed robot.
///
/// # Errors
/// [`RobotError::Violation`], for a robot that [`parse`] has not seen.
pub fn pack(robot: &Robot) -> Result<Vec<u8>, RobotError> {
    let mut bytes = vec![0; MAX_BYTES];
    let length = robot.pack(&mut bytes)?;
    bytes.truncate(length);
    Ok(bytes)
}
