//! Checkpoints: tokenizers (MoMask's RVQ-VAE, T2M-GPT's VQ-VAE and our own), our priors and their anchor control, from safetensors
//! files or torch containers.
//!
//! Four types come out, [`TokenizerCheckpoint`], [`PriorCheckpoint`], [`ControlCheckpoint`] and [`PublishedPlanner`], with every tensor checked. Nothing in a file is executed, every length is
//! checked before it is used, and errors name the tensor or option, what was expected and what was found.
//!
//! The layers, from bytes up: [`zip`] and [`pickle`] (torch containers), [`torch`] and [`safetensors`] (named tensors),
//! [`options`], [`config`] and [`anchors`] (sizes, scales, families), [`tokenizer`], [`prior`] and [`control`] (the checked networks).

pub mod anchors;
pub mod config;
pub mod control;
pub mod error;
pub mod options;
pub mod pickle;
pub mod prior;
pub mod published;
pub mod safetensors;
pub mod tensors;
pub mod tokenizer;
pub mod torch;
pub mod words;
pub mod zip;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

pub use config::{Config, Source};
pub use control::{ControlCheckpoint, ControlConfig};
pub use error::{Error, ErrorKind};
pub use prior::{PriorCheckpoint, PriorConfig};
pub use published::PublishedPlanner;
pub use tensors::{Tensor, TensorMap};
pub use tokenizer::{Conv1d, Decoder, DecoderStage, Encoder, EncoderStage, ResBlock, Statistics, TokenizerCheckpoint};
pub use words::WordTable;

use crate::input;
use error::Result;
use options::Options;

/// Files that go with a checkpoint and are not beside it, or not under their usual names.
#[derive(Debug, Clone, Default)]
pub struct Companions {
    /// Option file; else `opt.txt` (MoMask) or `t2mgpt_args.json` (T2M-GPT) beside the checkpoint.
    pub options: Option<PathBuf>,
    /// `mean.npy`; else that file beside the checkpoint or in `meta/` there. Our own checkpoints carry it inside.
    pub mean: Option<PathBuf>,
    /// `std.npy`, likewise.
    pub std: Option<PathBuf>,
}

/// Reads a tokenizer checkpoint with its companions where they usually are.
///
/// # Errors
/// [`Error`] with the path and what is wrong.
pub fn load(path: &Path) -> core::result::Result<TokenizerCheckpoint, Error> {
    load_with(path, &Companions::default())
}

/// Reads a tokenizer checkpoint.
///
/// # Errors
/// [`Error`] with the path and what is wrong.
pub fn load_with(path: &Path, companions: &Companions) -> core::result::Result<TokenizerCheckpoint, Error> {
    let read = || tokenizer_of(&input::read(path, input::ANY)?, path, companions);
    read().map_err(|kind| Error { path: path.to_owned(), kind })
}

/// Reads a tokenizer checkpoint of our own, which needs no companions, that is in memory; errors call it `name`.
///
/// # Errors
/// [`Error`] with the name and what is wrong.
pub fn from_bytes(bytes: &[u8], name: &str) -> core::result::Result<TokenizerCheckpoint, Error> {
    let path = Path::new(name);
    tokenizer_of(bytes, path, &Companions::default()).map_err(|kind| Error { path: path.to_owned(), kind })
}

/// The checkpoint in `bytes`, whose companions lie beside `path` where none are given.
fn tokenizer_of(bytes: &[u8], path: &Path, companions: &Companions) -> Result<TokenizerCheckpoint> {
    let (map, metadata) = tensors_of(bytes)?;
    let config = configuration(path, &map, &metadata, companions)?;
    let mut checkpoint = TokenizerCheckpoint::build(&map, config)?;
    if checkpoint.statistics.is_none() {
        checkpoint.statistics = statistics(path, companions, checkpoint.config.features)?;
    }
    Ok(checkpoint)
}

/// SHA-256 of a file, hex: how a blob names the checkpoint it came from.
///
/// # Errors
/// [`Error`] when the file cannot be read.
pub fn file_hash(path: &Path) -> core::result::Result<String, Error> {
    use sha2::{Digest, Sha256};
    let bytes = input::read(path, input::ANY).map_err(|e| Error { path: path.to_owned(), kind: e.into() })?;
    Ok(Sha256::digest(&bytes).iter().map(|b| format!("{b:02x}")).collect())
}

/// Named tensors (and safetensors metadata) of either container, told apart by the first bytes.
///
/// # Errors
/// Those of [`torch::read`] and [`safetensors::read`], and [`ErrorKind::UnknownContainer`].
pub fn tensors_of(bytes: &[u8]) -> Result<(TensorMap, BTreeMap<String, String>)> {
    match bytes {
        [b'P', b'K', ..] => Ok((torch::read(bytes)?, BTreeMap::new())),
        // A safetensors file is a little-endian header length, then JSON.
        [_, _, _, _, _, _, _, 0, b'{', ..] => safetensors::read(bytes),
        _ => Err(ErrorKind::UnknownContainer { start: bytes.iter().take(8).copied().collect() }),
    }
}

/// Refuses metadata that say something else than `expected`.
fn expect_entry(key: &'static str, actual: Option<&String>, expected: &'static str) -> Result<()> {
    match actual {
        Some(a) if a == expected => Ok(()),
        other => Err(ErrorKind::Version { key, actual: other.map_or("nothing", String::as_str).to_owned(), expected }),
    }
}

/// Tensors and the text of `config` of a file that must be of a format and version of ours.
fn of_format(bytes: &[u8], format: &'static str, version: &'static str) -> Result<(TensorMap, String)> {
    let (map, mut metadata) = tensors_of(bytes)?;
    expect_entry("format", metadata.get("format"), format)?;
    expect_entry("version", metadata.get("version"), version)?;
    let config = metadata.remove("config").ok_or_else(|| ErrorKind::MissingOption { key: "config".into() })?;
    Ok((map, config))
}

fn configuration(
    path: &Path,
    map: &TensorMap,
    metadata: &BTreeMap<String, String>,
    companions: &Companions,
) -> Result<Config> {
    if let Some(format) = metadata.get("format").filter(|f| f.starts_with("motionette")) {
        expect_entry("format", Some(format), "motionette-tokenizer")?;
        expect_entry("version", metadata.get("version"), "1")?;
        let text = metadata.get("config").ok_or_else(|| ErrorKind::MissingOption { key: "config".into() })?;
        return Config::from_json(text);
    }
    let source = if map.names().any(|n| n.starts_with("vqvae.")) { Source::T2mGpt } else { Source::Momask };
    let usual = if source == Source::T2mGpt { "t2mgpt_args.json" } else { "opt.txt" };
    let file = companions.options.clone().unwrap_or_else(|| path.with_file_name(usual));
    let text = input::read_text(&file, input::WRITTEN).map_err(|e| ErrorKind::Companion {
        what: "option file",
        path: file,
        reason: format!("cannot be read ({e}); give it with --options"),
    })?;
    Config::from_options(&Options::parse(&text)?, source)
}

/// Mean and std from `.npy` files; `None` when none was named and none is at the usual places.
fn statistics(path: &Path, companions: &Companions, features: usize) -> Result<Option<Statistics>> {
    let usual = |name: &str| {
        [path.with_file_name(name), path.with_file_name("meta").join(name)].into_iter().find(|p| p.is_file())
    };
    let mean = companions.mean.clone().or_else(|| usual("mean.npy"));
    let std = companions.std.clone().or_else(|| usual("std.npy"));
    let (Some(mean), Some(std)) = (mean, std) else { return Ok(None) };
    Ok(Some(Statistics { mean: vector(&mean, "mean file", features)?, std: vector(&std, "std file", features)? }))
}

/// A vector of `features` finite numbers from a `.npy` file of f64 or f32.
fn vector(path: &Path, what: &'static str, features: usize) -> Result<Vec<f64>> {
    let bad = |reason: String| ErrorKind::Companion { what, path: path.to_owned(), reason };
    let bytes = input::read(path, input::ANY).map_err(|e| bad(format!("cannot be read ({e})")))?;
    let npy = |bytes| npyz::NpyFile::new(bytes).map_err(|e| bad(format!("is not a .npy file ({e})")));
    let file = npy(&bytes[..])?;
    if file.shape() != [features as u64] {
        return Err(bad(format!("has shape {:?}, expected [{features}]", file.shape())));
    }
    let values = match file.into_vec::<f64>() {
        Ok(values) => values,
        Err(_) => npy(&bytes[..])?
            .into_vec::<f32>()
            .map_err(|e| bad(format!("holds neither f64 nor f32 ({e})")))?
            .into_iter()
            .map(f64::from)
            .collect(),
    };
    match values.iter().position(|v| !v.is_finite()) {
        Some(i) => Err(bad(format!("holds {} at element {i}", values[i]))),
        None => Ok(values),
    }
}
