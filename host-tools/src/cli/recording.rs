//! What commands share that read a recording: how it is to be read.

use std::path::PathBuf;

use clap::Args;

use crate::import::bvh::{Mapping, MappingError, Reading, Unit};

/// How recordings are to be read.
#[derive(Debug, Clone, Default, Args)]
pub struct RecordingOptions {
    /// Which joints of a recording are which (motionette import bvh --help shows the form); else tables of common programs are tried,
    /// then the joints' names, and what was guessed is printed.
    #[arg(long, value_name = "FILE.json")]
    mapping: Option<PathBuf>,
    /// What a unit of a recording is: m, cm, mm, inch, or its metres as a number; else as the mapping says, or as the height of the body
    /// suggests.
    #[arg(long, value_name = "UNIT")]
    unit: Option<Unit>,
}

impl RecordingOptions {
    /// What is known of the files.
    ///
    /// # Errors
    /// When the mapping file cannot be used.
    pub fn reading(&self) -> Result<Reading, MappingError> {
        Ok(Reading { mapping: self.mapping.as_deref().map(Mapping::read).transpose()?, unit: self.unit })
    }
}
