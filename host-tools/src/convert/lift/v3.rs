//! Blob format 3 as it was: header and manifest, for reading alone. Frozen: what this version wrote does not change any more.

use serde::Deserialize;

use super::Error;
use motionette::blob::{HEADER_LEN, Header, MAGIC};

/// The major format version read here.
pub(super) const MAJOR: u16 = 3;
/// Its newest minor version.
const MINOR: u16 = 1;

/// Manifest of a blob of format 3.
#[derive(Debug, Deserialize)]
pub(super) struct Manifest<'a> {
    #[serde(borrow)]
    pub(super) card: Card<'a>,
    pub(super) representation: Representation,
    pub(super) frame_rate: u16,
    pub(super) max_tokens: u16,
    pub(super) decoder: Decoder,
    #[serde(borrow)]
    pub(super) text: Option<Text<'a>>,
    pub(super) planner: Option<Planner>,
    pub(super) control: Option<Control>,
    pub(super) self_test: SelfTest,
    pub(super) tensor_count: u16,
}

/// Model card.
#[derive(Debug, Deserialize)]
pub(super) struct Card<'a> {
    pub(super) name: &'a str,
    pub(super) licence: &'a str,
    pub(super) data: &'a str,
    pub(super) checkpoint: &'a str,
}

/// Feature channels.
#[derive(Debug, Clone, Copy, Deserialize)]
pub(super) enum Representation {
    HumanMl3d,
    /// Reserved; no reader of format 3 accepted it.
    Direct {
        channels: u16,
    },
}

/// VQ decoder.
#[derive(Debug, Deserialize)]
pub(super) struct Decoder {
    pub(super) width: u16,
    pub(super) code_width: u16,
    pub(super) codes: u16,
    pub(super) quantizers: u8,
    pub(super) stages: u8,
    pub(super) dilations: Vec<u8>,
    pub(super) features: u16,
}

/// Where a transformer block normalises.
#[derive(Debug, Clone, Copy, Deserialize)]
pub(super) enum Norm {
    Pre,
    Post,
}

/// Activation of a feed-forward layer.
#[derive(Debug, Clone, Copy, Deserialize)]
pub(super) enum Activation {
    Relu,
    Gelu,
}

/// Stack of transformer blocks.
#[derive(Debug, Clone, Copy, Deserialize)]
pub(super) struct Transformer {
    pub(super) width: u16,
    pub(super) heads: u8,
    pub(super) layers: u8,
    pub(super) hidden: u16,
    pub(super) norm: Norm,
    pub(super) activation: Activation,
    pub(super) epsilon: f32,
}

/// Text encoder and stored prompts.
#[derive(Debug, Deserialize)]
pub(super) struct Text<'a> {
    pub(super) width: u16,
    pub(super) max_words: u16,
    pub(super) vocabulary: &'a str,
    pub(super) encoder: Option<Transformer>,
    pub(super) bank: &'a str,
}

/// Planner.
#[derive(Debug, Deserialize)]
pub(super) struct Planner {
    pub(super) transformer: Transformer,
    pub(super) sampler: Sampler,
}

/// Sampler.
#[derive(Debug, Clone, Copy, Deserialize)]
pub(super) enum Sampler {
    Tmd { c: f32, a: f32 },
}

/// Anchor control.
#[derive(Debug, Deserialize)]
pub(super) struct Control {
    pub(super) scaffold: Transformer,
    pub(super) frame_width: u16,
    pub(super) rank: u16,
    pub(super) context: bool,
    pub(super) families: u8,
}

/// Request with a known answer.
#[derive(Debug, Deserialize)]
pub(super) struct SelfTest {
    pub(super) seed: u32,
    pub(super) tokens: u16,
    pub(super) hash: u64,
}

/// A blob of format 3, taken apart.
#[derive(Debug)]
pub(super) struct Parts<'a> {
    /// Minor version.
    pub(super) minor: u16,
    pub(super) manifest: Manifest<'a>,
    /// The tensor table as it is on the wire; format 4 writes it alike.
    pub(super) table: &'a [u8],
    pub(super) weights: &'a [u8],
}

/// Checks the header of `blob` and reads its manifest. The header's layout has been the same since format 1.
pub(super) fn read(blob: &[u8]) -> Result<Parts<'_>, Error> {
    let header = blob.get(..HEADER_LEN).ok_or(Error::Truncated { needed: HEADER_LEN, found: blob.len() })?;
    let short = |at: usize| u16::from_le_bytes([header[at], header[at + 1]]);
    let word = |at: usize| u32::from_le_bytes([header[at], header[at + 1], header[at + 2], header[at + 3]]);
    let (major, minor) = (short(4), short(6));
    if header[..4] != MAGIC {
        return Err(Error::NotABlob);
    }
    if major != MAJOR || minor > MINOR {
        return Err(Error::Version { major, minor });
    }
    let [total, manifest, weights, length] = [8, 12, 16, 20].map(|at| word(at) as usize);
    let whole = blob.get(..total).ok_or(Error::Truncated { needed: total, found: blob.len() })?;
    let computed = Header::checksum(whole);
    if computed != word(24) {
        return Err(Error::Checksum { computed, stored: word(24) });
    }
    let text =
        HEADER_LEN.checked_add(manifest).filter(|&end| end <= weights).and_then(|end| whole.get(HEADER_LEN..end));
    let section = whole.get(weights..).filter(|section| section.len() == length);
    let (Some(text), Some(section)) = (text, section) else { return Err(Error::Header) };
    let (manifest, table) = postcard::take_from_bytes(text).map_err(Error::Manifest)?;
    Ok(Parts { minor, manifest, table, weights: section })
}
