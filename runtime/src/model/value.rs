//! Values that several sections hold.

use crate::blob::{Error, TransformerConfig};

/// Widest row of a transformer.
pub(super) const MAX_WIDTH: u32 = 1024;
/// Most attention heads.
const MAX_HEADS: u32 = 64;
/// Most blocks of a transformer.
const MAX_LAYERS: u32 = 32;
/// Widest feed-forward layer.
const MAX_HIDDEN: u32 = 4096;

/// Refuses 0 and what is beyond `limit`.
#[inline(never)]
pub(super) fn at_most(what: &'static str, found: u32, limit: u32) -> Result<(), Error> {
    if found == 0 || found > limit { Err(Error::Config { what, found, limit }) } else { Ok(()) }
}

/// The same of each.
#[inline(never)]
pub(super) fn all_at_most(values: &[(&'static str, u32, u32)]) -> Result<(), Error> {
    values.iter().try_for_each(|&(what, found, limit)| at_most(what, found, limit))
}

/// Refuses numbers that are not within a range.
#[inline(never)]
pub(super) fn within(what: &'static str, found: f32, least: f32, most: f32) -> Result<(), Error> {
    if found >= least && found <= most { Ok(()) } else { Err(Error::Number { what, bits: found.to_bits() }) }
}

/// Checks a stack of transformer blocks.
#[inline(never)]
pub(super) fn transformer(config: &TransformerConfig) -> Result<(), Error> {
    all_at_most(&[
        ("transformer.width", u32::from(config.width), MAX_WIDTH),
        ("transformer.heads", u32::from(config.heads), MAX_HEADS),
        ("transformer.layers", u32::from(config.layers), MAX_LAYERS),
        ("transformer.hidden", u32::from(config.hidden), MAX_HIDDEN),
    ])?;
    if !config.width.is_multiple_of(u16::from(config.heads)) {
        let (found, limit) = (u32::from(config.heads), u32::from(config.width));
        return Err(Error::Config { what: "transformer.heads that do not divide the width", found, limit });
    }
    within("transformer.epsilon", config.epsilon, 1e-12, 1.0)
}
