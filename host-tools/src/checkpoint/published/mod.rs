//! Planners that others have published: MoMask's mask and residual transformers, T2M-GPT's GPT.
//!
//! Their text is a vector that only a host makes (CLIP's); their sizes come from an option file beside them. Three facts are not in their
//! tensors: heads, and which of two transformers of the same shapes it is that the tensors' names tell.

pub mod momask;
pub mod t2mgpt;

use std::path::Path;

pub use momask::{Mask, Residual, Tables};
pub use t2mgpt::Gpt;

use super::error::{Error, ErrorKind, Result};
use super::options::Options;
use super::prior::{Block, Builder, Embedding, LayerNorm, Linear, Sizes};
use super::tensors::TensorMap;
use crate::input;

/// Most layers, heads or quantizers that are believed.
const MAX_COUNT: usize = 64;
/// Largest width that is believed.
const MAX_EXTENT: usize = 1 << 16;

/// A planner of any of the three kinds.
#[derive(Debug, Clone, PartialEq)]
pub enum PublishedPlanner {
    /// MoMask's mask transformer.
    Mask(Mask),
    /// MoMask's residual transformer.
    Residual(Residual),
    /// T2M-GPT's transformer.
    Gpt(Gpt),
}

/// Reads a published planner from a torch container or a safetensors file; its options from `options`, else from the usual file beside it:
/// `mask_opt.txt`, `res_opt.txt` (MoMask; in the folder of the model they are called `opt.txt`) or `t2mgpt_args.json`.
///
/// # Errors
/// [`Error`] with the path and what is wrong.
pub fn load(path: &Path, options: Option<&Path>) -> core::result::Result<PublishedPlanner, Error> {
    let read = || {
        let (map, _) = super::tensors_of(&input::read(path, input::ANY)?)?;
        let usual: &[&str] = match Kind::of(&map)? {
            Kind::Mask => &["mask_opt.txt", "opt.txt"],
            Kind::Residual => &["res_opt.txt", "opt.txt"],
            Kind::Gpt => &["t2mgpt_args.json"],
        };
        let beside = || usual.iter().map(|name| path.with_file_name(name)).find(|file| file.is_file());
        let file = options.map(Path::to_owned).or_else(beside).unwrap_or_else(|| path.with_file_name(usual[0]));
        let text = input::read_text(&file, input::WRITTEN).map_err(|e| ErrorKind::Companion {
            what: "option file",
            path: file,
            reason: format!("cannot be read ({e}); give it with --options"),
        })?;
        PublishedPlanner::build(&map, &Options::parse(&text)?)
    };
    read().map_err(|kind| Error { path: path.to_owned(), kind })
}

/// Whether a file holds tensors of a published planner; what cannot be read does not.
#[must_use]
pub fn is_published(path: &Path) -> bool {
    let bytes = input::read(path, input::ANY).ok();
    let map = bytes.and_then(|bytes| super::tensors_of(&bytes).ok());
    map.is_some_and(|(map, _)| Kind::of(&map).is_ok())
}

/// Which planner some tensors are.
enum Kind {
    Mask,
    Residual,
    Gpt,
}

impl Kind {
    fn of(map: &TensorMap) -> Result<Self> {
        let has = |start: &str| map.names().any(|name| name.starts_with(start));
        match () {
            () if has("trans_base.") => Ok(Self::Gpt),
            () if has("quant_emb.") => Ok(Self::Residual),
            () if has("token_emb.") => Ok(Self::Mask),
            () => Err(ErrorKind::MissingTensor {
                tensor: "token_emb.weight".into(),
                present: map.len(),
                similar: map.names().next().map(str::to_owned),
            }),
        }
    }
}

impl PublishedPlanner {
    /// Puts a planner together and checks every tensor against its options.
    ///
    /// # Errors
    /// The first tensor that is missing, misshapen or not finite, by name; an option that is missing or out of range.
    pub fn build(map: &TensorMap, options: &Options) -> Result<Self> {
        Ok(match Kind::of(map)? {
            Kind::Mask => Self::Mask(Mask::build(map, options)?),
            Kind::Residual => Self::Residual(Residual::build(map, options)?),
            Kind::Gpt => Self::Gpt(Gpt::build(map, options)?),
        })
    }
}

/// Refuses heads that do not divide the width.
fn check_heads(key: &str, sizes: Sizes) -> Result<()> {
    if sizes.width.is_multiple_of(sizes.heads) {
        return Ok(());
    }
    let expected = format!("a divisor of the width, {}", sizes.width);
    Err(ErrorKind::Option { key: key.into(), value: sizes.heads.to_string(), expected })
}

/// Extents of a tensor with so many of them.
fn extents<const N: usize>(map: &TensorMap, name: &str) -> Result<[usize; N]> {
    let tensor = map.get(name, &[None; N])?;
    Ok(core::array::from_fn(|axis| tensor.shape[axis]))
}

/// A linear layer without a bias.
fn unbiased(builder: &Builder<'_>, name: &str, outputs: usize, inputs: usize) -> Result<Linear> {
    let weight = builder.tensor(&format!("{name}.weight"), &[outputs, inputs])?;
    Ok(Linear { name: name.to_owned(), outputs, inputs, weight, bias: vec![0.0; outputs] })
}
