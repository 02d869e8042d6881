//! The model that is built in, so that the program works wherever it lies: the blob, and the checkpoints of it that the reference runs.

use anyhow::Context;
use motionette_host::checkpoint::{self, ControlCheckpoint, PriorCheckpoint, TokenizerCheckpoint};
use std::path::Path;

/// `models/nano.blob`, what the runtime reads.
pub const BLOB: &[u8] = include_bytes!("../../models/nano.blob");
/// `models/nano-pico2.blob`, the same with fewer bits: what a board with two slots in 4 MiB of flash holds.
pub const BOARD_BLOB: &[u8] = include_bytes!("../../models/nano-pico2.blob");
/// `models/nano.safetensors`.
const TOKENIZER: &[u8] = include_bytes!("../../models/nano.safetensors");
/// `models/nano.prior.safetensors`.
const PRIOR: &[u8] = include_bytes!("../../models/nano.prior.safetensors");
/// `models/nano.control.safetensors`.
const CONTROL: &[u8] = include_bytes!("../../models/nano.control.safetensors");
/// What errors call them.
const NAME: &str = "(built in)";

/// The checkpoint of the tokenizer that was given, or the built-in one.
///
/// # Errors
/// When it cannot be read.
pub fn tokenizer(given: Option<&Path>) -> anyhow::Result<TokenizerCheckpoint> {
    let read = given.map_or_else(|| checkpoint::from_bytes(TOKENIZER, NAME), checkpoint::load);
    read.context("the reference needs the model's unquantised checkpoint: give --checkpoint")
}

/// The same for text encoder and planner.
///
/// # Errors
/// When it cannot be read.
pub fn prior(given: Option<&Path>) -> anyhow::Result<PriorCheckpoint> {
    let read = given.map_or_else(|| checkpoint::prior::from_bytes(PRIOR, NAME), checkpoint::prior::load);
    read.context("the reference needs the unquantised checkpoint of text encoder and planner: give --prior")
}

/// The same for anchor control.
///
/// # Errors
/// When it cannot be read.
pub fn control(given: Option<&Path>) -> anyhow::Result<ControlCheckpoint> {
    let read = given.map_or_else(|| checkpoint::control::from_bytes(CONTROL, NAME), checkpoint::control::load);
    read.context("the reference needs the unquantised checkpoint of anchor control: give --control")
}
