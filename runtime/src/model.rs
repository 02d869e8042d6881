//! A checked model: every module resolved to views into the blob.

use crate::blob::{ALIGNMENT, SelfTest, Tensors};
use crate::blob::{
    Card, Error, HEADER_LEN, Header, MAX_BLOCKS, MAX_LAYERS, MAX_STAGES, MAX_TENSORS, MINOR, Manifest, Representation,
    Sampler, TransformerConfig,
};
use crate::conditioning::scaffold_encoder::Timing;
use crate::decoding::codebook::{Codebooks, MAX_QUANTIZERS};
use crate::decoding::decoder::Decoder;
use crate::motion::humanml3d;
use crate::perception::Text;
use crate::planning::session::Modules;
use crate::planning::{Control, Planner};
use crate::request::conditions::FAMILIES;

/// A blob whose weights could drive activations beyond this is refused: no infinity is reachable after `open`.
pub const MAX_MAGNITUDE: f32 = 1e28;
/// Embeddings may leave the range of the codes by this factor before a refinement step is rejected.
pub const EMBEDDING_MARGIN: f32 = 8.0;
/// Largest magnitude of the feature statistics.
const MAX_STATISTIC: f32 = 1e3;
/// Longest motion any blob may declare, tokens.
pub const MAX_TOKENS: u16 = 256;
/// Widest row of a transformer.
const MAX_WIDTH: u32 = 1024;
/// Most attention heads.
const MAX_HEADS: u32 = 64;
/// Widest feed-forward layer.
const MAX_HIDDEN: u32 = 4096;
/// Longest prompt any blob may declare, words.
const MAX_WORDS: u32 = 256;

/// An opened blob. Nothing about it can fail any more.
#[derive(Debug, Clone)]
pub struct Model<'a> {
    bytes: &'a [u8],
    card: Card<'a>,
    frame_rate: u16,
    max_tokens: u16,
    self_test: SelfTest,
    mean: &'a [f32],
    std: &'a [f32],
    codebooks: Codebooks<'a>,
    decoder: Decoder<'a>,
    text: Option<Text<'a>>,
    planner: Option<Planner<'a>>,
    control: Option<Control<'a>>,
}

impl<'a> Model<'a> {
    /// Checks `bytes` (header, checksum, manifest, every tensor) in one pass and resolves the modules.
    ///
    /// `bytes` must begin on a 16-byte boundary; bytes behind the blob are ignored.
    ///
    /// # Errors
    /// [`Error`], saying what is wrong and where.
    // Its own frame: what opening needs of the stack is not to lie below everything that comes later.
    #[inline(never)]
    pub fn open(bytes: &'a [u8]) -> Result<Self, Error> {
        let remainder = bytes.as_ptr().addr() % ALIGNMENT;
        if remainder != 0 {
            return Err(Error::Misaligned { remainder: remainder as u8 });
        }
        let header = Header::parse(bytes)?;
        let bytes = bytes.get(..header.total_len as usize).ok_or(Error::Header)?;
        let manifest = bytes.get(HEADER_LEN..HEADER_LEN + header.manifest_len as usize).ok_or(Error::Header)?;
        let weights = bytes.get(header.weights_offset as usize..).ok_or(Error::Header)?;
        let (manifest, table) = postcard::take_from_bytes::<Manifest<'a>>(manifest).map_err(|_| Error::Manifest)?;
        let features = check(&manifest)?;

        let mut tensors = Tensors::new(table, weights, manifest.tensor_count);
        let tensor = tensors.take()?;
        let mean = tensor.singles(features)?;
        refuse_beyond(mean, MAX_STATISTIC, tensor.index)?;
        let tensor = tensors.take()?;
        let std = tensor.scales(features)?;
        refuse_beyond(std, MAX_STATISTIC, tensor.index)?;
        let codebooks = Codebooks::open(&mut tensors, &manifest.decoder)?;
        let decoder = Decoder::open(&mut tensors, &manifest.decoder, EMBEDDING_MARGIN * codebooks.largest())?;
        let text = match &manifest.text {
            None => None,
            Some(config) => Some(Text::open(&mut tensors, config, manifest.max_tokens)?),
        };
        let (mut planner, mut control) = (None, None);
        if let (Some(config), Some(text)) = (&manifest.planner, &text) {
            let max_tokens = manifest.max_tokens;
            let opened = Planner::open(&mut tensors, config, text, manifest.decoder.codes, max_tokens)?;
            if let Some(config) = &manifest.control {
                let frames = decoder.upsampling() as u16;
                let timing = Timing { rate: manifest.frame_rate, frames, tokens: max_tokens };
                control = Some(Control::open(&mut tensors, config, timing, &opened, text)?);
            } else {
                opened.check(text, (0.0, 0.0))?;
            }
            planner = Some(opened);
        }
        // A newer minor version may carry more behind what this one knows.
        if header.minor <= MINOR {
            tensors.finish()?;
        }
        Ok(Model {
            bytes,
            card: manifest.card,
            frame_rate: manifest.frame_rate,
            max_tokens: manifest.max_tokens,
            self_test: manifest.self_test,
            mean,
            std,
            codebooks,
            decoder,
            text,
            planner,
            control,
        })
    }

    /// The blob.
    #[must_use]
    pub const fn bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// Name, licence and data of the weights.
    #[must_use]
    pub const fn card(&self) -> &Card<'a> {
        &self.card
    }

    /// Frames a second.
    #[must_use]
    pub const fn frame_rate(&self) -> u16 {
        self.frame_rate
    }

    /// Longest motion, tokens.
    #[must_use]
    pub const fn max_tokens(&self) -> usize {
        self.max_tokens as usize
    }

    /// Frames a token.
    #[must_use]
    pub fn frames_per_token(&self) -> usize {
        self.decoder.upsampling()
    }

    /// The request with a known answer.
    #[must_use]
    pub const fn self_test(&self) -> SelfTest {
        self.self_test
    }

    /// Mean of each feature channel.
    #[must_use]
    pub const fn mean(&self) -> &'a [f32] {
        self.mean
    }

    /// Standard deviation of each feature channel.
    #[must_use]
    pub const fn std(&self) -> &'a [f32] {
        self.std
    }

    /// Token embeddings.
    #[must_use]
    pub const fn codebooks(&self) -> &Codebooks<'a> {
        &self.codebooks
    }

    /// Largest magnitude of an embedding that the decoder is guaranteed to keep finite.
    #[must_use]
    pub const fn embedding_limit(&self) -> f32 {
        EMBEDDING_MARGIN * self.codebooks.largest()
    }

    /// Token decoder.
    #[must_use]
    pub const fn decoder(&self) -> &Decoder<'a> {
        &self.decoder
    }

    /// Text encoder and stored prompts.
    #[must_use]
    pub const fn text(&self) -> Option<&Text<'a>> {
        self.text.as_ref()
    }

    /// Planner.
    #[must_use]
    pub const fn planner(&self) -> Option<&Planner<'a>> {
        self.planner.as_ref()
    }

    /// Anchor control of the planner.
    #[must_use]
    pub const fn control(&self) -> Option<&Control<'a>> {
        self.control.as_ref()
    }

    /// What a planning session works with; `None` when the blob cannot make tokens.
    #[must_use]
    pub fn planning(&self) -> Option<Modules<'_, 'a>> {
        let (text, planner) = (self.text.as_ref()?, self.planner.as_ref()?);
        Some(Modules { text, planner, control: self.control(), codebooks: &self.codebooks })
    }
}

/// Checks configuration values; returns the number of features.
fn check(manifest: &Manifest<'_>) -> Result<u16, Error> {
    let decoder = &manifest.decoder;
    let limits = [
        ("max_tokens", u32::from(manifest.max_tokens), u32::from(MAX_TOKENS)),
        ("frame_rate", u32::from(manifest.frame_rate), 1000),
        ("decoder.width", u32::from(decoder.width), 2048),
        ("decoder.code_width", u32::from(decoder.code_width), 2048),
        ("decoder.codes", u32::from(decoder.codes), u32::from(u16::MAX) - 1),
        ("decoder.quantizers", u32::from(decoder.quantizers), MAX_QUANTIZERS as u32),
        ("decoder.stages", u32::from(decoder.stages), MAX_STAGES as u32),
        ("decoder.features", u32::from(decoder.features), 2048),
        ("tensor_count", u32::from(manifest.tensor_count), MAX_TENSORS as u32),
        ("decoder.dilations", decoder.dilations.len() as u32, MAX_BLOCKS as u32),
    ];
    for (what, found, limit) in limits {
        if found == 0 || found > limit {
            return Err(Error::Config { what, found, limit });
        }
    }
    if let Some(&found) = decoder.dilations.iter().find(|&&d| d == 0) {
        return Err(Error::Config { what: "decoder.dilations", found: u32::from(found), limit: 255 });
    }
    let (found, limit) = match manifest.representation {
        Representation::HumanMl3d => (decoder.features, humanml3d::FEATURES as u16),
        // Actuator channels have no recovery of joints yet: such a blob is refused rather than misread.
        Representation::Direct { channels } => (channels, 0),
    };
    if found != limit {
        return Err(Error::Config { what: "representation", found: u32::from(found), limit: u32::from(limit) });
    }
    check_words(manifest)?;
    Ok(decoder.features)
}

/// Checks configuration values of text encoder, planner and anchor control.
fn check_words(manifest: &Manifest<'_>) -> Result<(), Error> {
    let at_most = |what, found: u32, limit: u32| {
        if found == 0 || found > limit { Err(Error::Config { what, found, limit }) } else { Ok(()) }
    };
    if let Some(text) = &manifest.text {
        at_most("text.width", u32::from(text.width), MAX_WIDTH)?;
        at_most("text.max_words", u32::from(text.max_words), MAX_WORDS)?;
        if let Some(encoder) = &text.encoder {
            check_transformer(encoder)?;
        }
    }
    if let Some(planner) = &manifest.planner {
        if manifest.text.is_none() {
            return Err(Error::Config { what: "planner without text", found: 1, limit: 0 });
        }
        check_transformer(&planner.transformer)?;
        at_most("decoder.quantizers with a planner", u32::from(manifest.decoder.quantizers), 1)?;
        at_most("max_tokens with a planner", u32::from(manifest.max_tokens), u32::from(MAX_TOKENS) - 1)?;
        let Sampler::Tmd { c, a } = planner.sampler;
        check_number("planner.sampler.c", c, 1e-6, 1e3)?;
        check_number("planner.sampler.a", a, 1e-6, 4.0)?;
    }
    if let Some(control) = &manifest.control {
        if manifest.planner.is_none() {
            return Err(Error::Config { what: "control without planner", found: 1, limit: 0 });
        }
        check_transformer(&control.scaffold)?;
        at_most("control.frame_width", u32::from(control.frame_width), MAX_WIDTH)?;
        at_most("control.rank", u32::from(control.rank), MAX_WIDTH)?;
        at_most("control.families", u32::from(control.families), u32::from(FAMILIES))?;
    }
    Ok(())
}

/// Checks configuration values of a stack of transformer blocks.
fn check_transformer(config: &TransformerConfig) -> Result<(), Error> {
    let limits = [
        ("transformer.width", u32::from(config.width), MAX_WIDTH),
        ("transformer.heads", u32::from(config.heads), MAX_HEADS),
        ("transformer.layers", u32::from(config.layers), MAX_LAYERS as u32),
        ("transformer.hidden", u32::from(config.hidden), MAX_HIDDEN),
    ];
    for (what, found, limit) in limits {
        if found == 0 || found > limit {
            return Err(Error::Config { what, found, limit });
        }
    }
    if !config.width.is_multiple_of(u16::from(config.heads)) {
        let (found, limit) = (u32::from(config.heads), u32::from(config.width));
        return Err(Error::Config { what: "transformer.heads that do not divide the width", found, limit });
    }
    check_number("transformer.epsilon", config.epsilon, 1e-12, 1.0)
}

/// Refuses numbers that are not within a range.
fn check_number(what: &'static str, found: f32, least: f32, most: f32) -> Result<(), Error> {
    if found >= least && found <= most { Ok(()) } else { Err(Error::Number { what, bits: found.to_bits() }) }
}

fn refuse_beyond(values: &[f32], limit: f32, index: u16) -> Result<(), Error> {
    match values.iter().position(|v| !(v.abs() <= limit)) {
        None => Ok(()),
        Some(element) => Err(Error::TensorValue { index, element: u32::try_from(element).unwrap_or(u32::MAX) }),
    }
}
