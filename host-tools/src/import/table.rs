//! Tables that people write in TOML: read, and refused by file and line.

use std::path::{Path, PathBuf};

use serde::de::DeserializeOwned;

use crate::input;

/// Why a table cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The file cannot be read.
    #[error("cannot read the {what} in {}", path.display())]
    Read {
        /// What the file holds.
        what: &'static str,
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is not TOML, or a key has another type or name.
    #[error("{} does not hold the {what}; docs/data.md describes its keys", path.display())]
    Syntax {
        /// What the file should hold.
        what: &'static str,
        /// The file.
        path: PathBuf,
        /// What the reader said, with line and column.
        source: Box<toml::de::Error>,
    },
    /// An entry contradicts another, names what is not there, or is of no use.
    #[error("{} line {line}: {problem}", path.display())]
    Entry {
        /// The file.
        path: PathBuf,
        /// Line, from 1; 0 where no line is to blame.
        line: usize,
        /// What is wrong and what to do.
        problem: String,
    },
}

/// The text of the file that holds `what`.
pub(super) fn read(path: &Path, what: &'static str) -> Result<String, Error> {
    input::read_text(path, input::WRITTEN).map_err(|source| Error::Read { what, path: path.into(), source })
}

/// The table in `text`; `path` is what errors name.
pub(super) fn parse<T: DeserializeOwned>(path: &Path, text: &str, what: &'static str) -> Result<T, Error> {
    toml::from_str(text).map_err(|source| Error::Syntax { what, path: path.into(), source: Box::new(source) })
}
