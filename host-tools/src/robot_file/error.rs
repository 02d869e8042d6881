//! What can be wrong with a robot file.

use std::fmt;
use std::ops::Range;
use std::path::PathBuf;

use motionette::playback::RobotError;

/// Why there is no robot.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The file cannot be read.
    #[error("cannot read the robot file {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Neither a preset nor a file.
    #[error("there is no robot {name:?}: no such file, and the presets are {}", super::preset_names())]
    NoSuchRobot {
        /// What was asked for.
        name: String,
    },
    /// Something in the text is wrong.
    #[error(transparent)]
    Invalid(#[from] Problems),
    /// A packed robot of version 1 does not say where its servos stand when power comes up.
    #[error(
        "the packed robot {} is of version 1, which does not say where these servos stand when power comes up: {channels}. They cannot \
         say it themselves: give `start` in a robot.toml, or `--start neutral` if all of them stand at their neutral angles then",
        path.display()
    )]
    NoStart {
        /// The file.
        path: PathBuf,
        /// Their names, with commas.
        channels: String,
    },
    /// The file is a packed robot that the runtime refuses.
    #[error("the packed robot {} is refused", path.display())]
    Packed {
        /// The file.
        path: PathBuf,
        /// Why.
        source: RobotError,
    },
}

/// A problem, and where it is.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problem {
    /// Line, from 1.
    pub line: usize,
    /// Column, characters from 1.
    pub column: usize,
    /// Characters of that line that it is about.
    pub width: usize,
    /// The line as it stands.
    pub text: String,
    /// What is wrong and what to do.
    pub message: String,
}

/// All problems of a robot file, in the order of its lines.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Problems {
    /// Name of the file.
    pub file: String,
    /// At least one.
    pub problems: Vec<Problem>,
}

impl Problem {
    /// About the bytes `span` of `source`.
    pub(super) fn new(source: &str, span: Range<usize>, message: String) -> Self {
        let start = floor(source, span.start);
        let before = &source[..start];
        let begin = before.rfind('\n').map_or(0, |end| end + 1);
        let text = source[begin..].lines().next().unwrap_or_default();
        let (line, column) = (line_of(source, start), source[begin..start].chars().count() + 1);
        let end = floor(source, span.end).clamp(start, (begin + text.len()).max(start));
        let width = source[start..end].trim_end().chars().count().max(1);
        Problem { line, column, width, text: text.trim_end().to_owned(), message }
    }
}

/// The line, from 1, in which byte `at` lies.
pub(super) fn line_of(source: &str, at: usize) -> usize {
    source[..floor(source, at)].matches('\n').count() + 1
}

/// The nearest boundary of a character at or before `at`.
fn floor(source: &str, at: usize) -> usize {
    (0..=at.min(source.len())).rev().find(|&at| source.is_char_boundary(at)).unwrap_or(0)
}

impl fmt::Display for Problems {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Problems { file, problems } = self;
        let plural = if problems.len() == 1 { "" } else { "s" };
        write!(f, "{file} has {} problem{plural}", problems.len())?;
        for Problem { line, column, width, text, message } in problems {
            let number = format!("{line:5}");
            let (blank, marks) = (" ".repeat(column - 1), "^".repeat(*width));
            // Tabs stay tabs, so that the marks stand below what they mark.
            let blank: String =
                blank.chars().zip(text.chars()).map(|(b, c)| if c == '\t' { '\t' } else { b }).collect();
            write!(f, "\n\n{file}:{line}: {message}\n{number} | {text}\n      | {blank}{marks}")?;
        }
        Ok(())
    }
}

impl std::error::Error for Problems {}
