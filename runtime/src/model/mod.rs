//! A checked model: every module resolved to views into the blob.
//!
//! [`Model::open`] reads the manifest, checks the values of each of its sections (a file each, named as the section), then resolves the
//! modules, which check their tensors.

mod codec;
mod families;
mod generator;
mod representation;
mod self_test;
mod text;
mod value;

use crate::blob::{
    ALIGNMENT, Card, Codec, Error, Generator, HEADER_LEN, Header, MAX_TENSORS, MINOR, Manifest, SelfTest, Skeleton,
    Tensors,
};
use crate::codec::codebook::Codebooks;
use crate::codec::vq::decoder::Decoder;
use crate::conditioning::scaffold_encoder::Timing;
#[cfg(feature = "residual")]
use crate::generation::tokens::residual::Residual;
use crate::generation::tokens::session::Modules;
use crate::generation::tokens::{AnchorControl, Planner, Planning};
use crate::representation::humanml3d::Recovery;
use crate::text::Text;
use crate::text::meaning::{Guess, Understood};
use crate::text::words::{UNKNOWN, Word};
pub use families::{CargoFeature, cargo_features};
pub(crate) use representation::is_bone;

/// A blob whose weights could drive activations beyond this is refused: no infinity is reachable after `open`.
pub const MAX_MAGNITUDE: f32 = 1e28;
/// Embeddings may leave the range of the codes by this factor before a refinement step is rejected.
pub const EMBEDDING_MARGIN: f32 = 8.0;
/// Largest magnitude of the feature statistics.
const MAX_STATISTIC: f32 = 1e3;
/// Whether this build knows planners.
const PLANNERS: bool = cfg!(any(feature = "tmd", feature = "masked", feature = "autoregressive"));
/// Longest motion any blob may declare, tokens.
pub const MAX_TOKENS: u16 = 256;

/// An opened blob. Nothing about it can fail any more.
#[derive(Debug, Clone)]
pub struct Model<'a> {
    bytes: &'a [u8],
    card: Card<'a>,
    frame_rate: u16,
    skeleton: Skeleton<'a>,
    max_tokens: u16,
    self_test: SelfTest,
    mean: &'a [f32],
    std: &'a [f32],
    codebooks: Codebooks<'a>,
    decoder: Decoder<'a>,
    text: Option<Text<'a>>,
    planner: Option<Planner<'a>>,
    control: Option<AnchorControl<'a>>,
    #[cfg(feature = "residual")]
    residual: Option<Residual<'a>>,
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
        let (manifest, table) = Manifest::read(manifest, header.minor)?;
        let max_tokens = manifest.generator.max_tokens();
        let Codec::Vq(config) = &manifest.codec;
        families::check(&manifest)?;
        check(&manifest)?;

        let mut tensors = Tensors::new(table, weights, manifest.tensor_count).of_minor(header.minor);
        let tensor = tensors.take()?;
        let mean = tensor.f32s(config.features)?;
        refuse_beyond(mean, MAX_STATISTIC, tensor.index)?;
        let tensor = tensors.take()?;
        let std = tensor.scales(config.features)?;
        refuse_beyond(std, MAX_STATISTIC, tensor.index)?;
        let codebooks = Codebooks::open(&mut tensors, config)?;
        let decoder = Decoder::open(&mut tensors, config, EMBEDDING_MARGIN * codebooks.largest())?;
        let text = match &manifest.text {
            None => None,
            Some(config) => Some(Text::open(&mut tensors, config, max_tokens)?),
        };
        let (mut planner, mut control) = (None, None);
        if cfg!(any(feature = "tmd", feature = "masked"))
            && let (Generator::Words(generator), Some(text)) = (&manifest.generator, &text)
        {
            let opened = Planner::open(&mut tensors, generator, text, config.codes)?;
            if cfg!(feature = "anchor-control")
                && let Some(anchors) = &generator.control
            {
                let frames = config.frames_per_token() as u16;
                let timing = Timing { rate: manifest.representation.frame_rate(), frames, tokens: max_tokens };
                control = Some(AnchorControl::open(&mut tensors, anchors, timing, &opened, text)?);
            } else {
                opened.check(text, (0.0, 0.0))?;
            }
            planner = Some(opened);
        }
        #[cfg(any(feature = "masked", feature = "autoregressive"))]
        if let Some(text) = &text {
            let opened = match &manifest.generator {
                #[cfg(feature = "masked")]
                Generator::Masked(config) => {
                    Some(Planner::open_masked(&mut tensors, config, text, codebooks.codes() as u16)?)
                }
                #[cfg(feature = "autoregressive")]
                Generator::Autoregressive(config) => {
                    Some(Planner::open_in_turn(&mut tensors, config, text, codebooks.codes() as u16)?)
                }
                _ => None,
            };
            if let Some(opened) = opened {
                opened.check(text, (0.0, 0.0))?;
                planner = Some(opened);
            }
        }
        #[cfg(feature = "residual")]
        let residual = match (manifest.generator.prefix().and_then(|prefix| prefix.residual), &text) {
            (Some(config), Some(text)) => Some(Residual::open(&mut tensors, &config, text, &codebooks, max_tokens)?),
            _ => None,
        };
        // A newer minor version may carry more behind what this one knows.
        let newer = header.minor > MINOR;
        if !newer {
            tensors.finish()?;
        }
        Ok(Model {
            bytes,
            card: manifest.card,
            frame_rate: manifest.representation.frame_rate(),
            skeleton: manifest.representation.skeleton(),
            max_tokens,
            self_test: manifest.self_test,
            mean,
            std,
            codebooks,
            decoder,
            text,
            planner,
            control,
            #[cfg(feature = "residual")]
            residual,
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

    /// The body that the model was trained on.
    #[must_use]
    pub const fn skeleton(&self) -> Skeleton<'a> {
        self.skeleton
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
    #[doc(hidden)]
    #[must_use]
    pub const fn mean(&self) -> &'a [f32] {
        self.mean
    }

    /// Standard deviation of each feature channel.
    #[doc(hidden)]
    #[must_use]
    pub const fn std(&self) -> &'a [f32] {
        self.std
    }

    /// How joints are recovered from the features.
    #[doc(hidden)]
    #[must_use]
    pub const fn recovery(&self) -> Recovery<'a> {
        Recovery { mean: self.mean, std: self.std }
    }

    /// Token embeddings.
    #[doc(hidden)]
    #[must_use]
    pub const fn codebooks(&self) -> &Codebooks<'a> {
        &self.codebooks
    }

    /// Largest magnitude of an embedding that the decoder is guaranteed to keep finite.
    #[doc(hidden)]
    #[must_use]
    pub const fn embedding_limit(&self) -> f32 {
        EMBEDDING_MARGIN * self.codebooks.largest()
    }

    /// Token decoder.
    #[doc(hidden)]
    #[must_use]
    pub const fn decoder(&self) -> &Decoder<'a> {
        &self.decoder
    }

    /// Text encoder and stored prompts.
    #[doc(hidden)]
    #[must_use]
    pub const fn text(&self) -> Option<&Text<'a>> {
        self.text.as_ref()
    }

    /// Planner.
    #[doc(hidden)]
    #[must_use]
    pub const fn planner(&self) -> Option<&Planner<'a>> {
        if PLANNERS { self.planner.as_ref() } else { None }
    }

    /// How its planner is meant to plan ([`Planner::defaults`]): what [`Request::planned`](crate::Request::planned) takes.
    #[must_use]
    pub fn default_planning(&self) -> Planning<'static> {
        self.planner().map_or(Planning::DEFAULT, Planner::defaults)
    }

    /// Anchor control of the planner.
    #[doc(hidden)]
    #[must_use]
    pub const fn control(&self) -> Option<&AnchorControl<'a>> {
        if cfg!(feature = "anchor-control") { self.control.as_ref() } else { None }
    }

    /// Numbers of a vector that it takes as a prompt ([`Prompt::Vector`](crate::Prompt::Vector)); `None` where prompts are words.
    #[must_use]
    pub fn vector_width(&self) -> Option<usize> {
        self.text().filter(|text| text.takes_vectors()).map(Text::width)
    }

    /// Longest prompt that it plans tokens for, words; `None` when it plans none.
    #[must_use]
    pub fn max_words(&self) -> Option<usize> {
        Some(self.planning()?.text.max_words())
    }

    /// Whether its text encoder knows `word`, in some form; `None` when it has none.
    #[must_use]
    pub fn knows(&self, word: &Word) -> Option<bool> {
        let vocabulary = self.text()?.encoder()?.vocabulary();
        Some(vocabulary.id(word) != UNKNOWN)
    }

    /// The phrase of that number, of those that prompts are understood as ([`Motion::understood`](crate::Motion::understood)).
    #[must_use]
    pub fn phrase(&self, number: u16) -> Option<&'a str> {
        self.text()?.meanings()?.phrase(number)
    }

    /// What a prompt was understood as, in words.
    #[must_use]
    pub const fn in_words(&self, understood: Understood) -> InWords<'_> {
        InWords { model: self, understood }
    }

    /// What a planning session works with; `None` when the blob cannot make tokens.
    #[doc(hidden)]
    #[must_use]
    pub fn planning(&self) -> Option<Modules<'_, 'a>> {
        let (text, planner) = (self.text()?, self.planner()?);
        Some(Modules {
            text,
            planner,
            control: self.control(),
            codebooks: &self.codebooks,
            #[cfg(feature = "residual")]
            residual: self.residual.as_ref(),
        })
    }
}

/// What a prompt was understood as, in words ([`Model::in_words`]): `a person waves the right hand, angrily (0.86)`, or, where nothing is
/// sure, the nearest actions: `hardly anything; nearest: a person waves (0.21), a person claps (0.08), a person bows (0.02)`.
#[derive(Debug)]
pub struct InWords<'m> {
    model: &'m Model<'m>,
    understood: Understood,
}

impl core::fmt::Display for InWords<'_> {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        let Understood { actions, style, sure } = self.understood;
        let phrase = |guess: Guess| self.model.phrase(guess.phrase).unwrap_or("?");
        // In whole numbers: formatting floats takes more flash than all of this.
        let hundredths = |guess: Guess| (100.0 * guess.score + 0.5) as u16;
        let score = |f: &mut core::fmt::Formatter<'_>, guess: Guess| {
            let hundredths = hundredths(guess);
            write!(f, " ({}.{:02})", hundredths / 100, hundredths % 100)
        };
        if sure {
            let action = self.understood.action();
            f.write_str(phrase(action))?;
            if let Some(style) = style {
                write!(f, ", {}", phrase(style))?;
            }
            return score(f, action);
        }
        let mut separator = "hardly anything; nearest: ";
        for guess in actions.into_iter().filter(|guess| *guess != Guess::NONE) {
            write!(f, "{separator}{}", phrase(guess))?;
            score(f, guess)?;
            separator = ", ";
        }
        Ok(())
    }
}

/// Checks what the manifest says, section by section.
fn check(manifest: &Manifest<'_>) -> Result<(), Error> {
    value::at_most("tensor_count", u32::from(manifest.tensor_count), MAX_TENSORS as u32)?;
    representation::check(&manifest.representation)?;
    codec::check(&manifest.codec, &manifest.representation)?;
    text::check(manifest.text.as_ref())?;
    generator::check(&manifest.generator, &manifest.codec, manifest.text.as_ref())?;
    self_test::check(&manifest.self_test, &manifest.codec, &manifest.generator)
}

fn refuse_beyond(values: &[f32], limit: f32, index: u16) -> Result<(), Error> {
    match values.iter().position(|v| !(v.abs() <= limit)) {
        None => Ok(()),
        Some(element) => Err(Error::TensorValue { index, element: u32::try_from(element).unwrap_or(u32::MAX) }),
    }
}
