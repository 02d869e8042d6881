//! Blobs of the format before this one, brought to this one: another manifest around the same weights.
//!
//! What a format-3 manifest does not say was the same for every model of its time: HumanML3D's body, symmetrical padding, a word table, a
//! length head, guidance by two passes.

mod v3;

use motionette::blob::{
    Activation, Card, Codec, ControlConfig, Corruption, DecoderConfig, Generator, Guidance, HEADER_LEN, HumanMl3d,
    MAGIC, MAJOR, MAX_STAGES, Manifest, Norm, PhraseBank, PlannerConfig, Representation, SelfTest, Skeleton,
    TextConfig, TextEncoderConfig, TextEncoding, TextLength, TextTable, TransformerConfig,
};
use motionette::{Model, blob};
use sha2::{Digest, Sha256};

use crate::blob::AlignedBlob;

/// Minor version of a lifted blob: nothing that format 3 says came later.
pub const LIFTED: u16 = 0;

/// A blob could not be lifted. Nothing was written.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Not a blob at all.
    #[error("the first bytes are not those of a motionette blob")]
    NotABlob,
    /// Fewer bytes than the header promises.
    #[error("the blob needs {needed} bytes but {found} are there: it was cut short")]
    Truncated {
        /// Bytes that are needed.
        needed: usize,
        /// Bytes that are there.
        found: usize,
    },
    /// Already of the format that this version writes.
    #[error("the blob is of format {MAJOR}.{minor} already: there is nothing to lift")]
    Current {
        /// Its minor version.
        minor: u16,
    },
    /// Of a format that is neither this one nor the one before.
    #[error(
        "the blob is of format {major}.{minor}; only format 3.0 and 3.1 are lifted to {MAJOR}.{LIFTED}: {}",
        if *major < v3::MAJOR { "convert its checkpoint again" } else { "it needs a newer motionette" }
    )]
    Version {
        /// Its major version.
        major: u16,
        /// Its minor version.
        minor: u16,
    },
    /// Lengths in the header contradict each other.
    #[error("lengths and offsets in the blob's header contradict each other: the blob is damaged")]
    Header,
    /// The checksum does not match.
    #[error("CRC-32 of the bytes is {computed:08x}, the header says {stored:08x}: the blob is damaged")]
    Checksum {
        /// CRC computed over the bytes.
        computed: u32,
        /// CRC stored in the header.
        stored: u32,
    },
    /// The manifest is none of format 3.
    #[error("the manifest is none of format 3: {0}")]
    Manifest(postcard::Error),
    /// The manifest says what no reader of format 3 accepted.
    #[error("the manifest's {what} is {found}, format 3 allows {allowed}")]
    Value {
        /// Which value.
        what: &'static str,
        /// The value.
        found: u32,
        /// What format 3 allows.
        allowed: &'static str,
    },
    /// The new manifest cannot be written.
    #[error(transparent)]
    Write(#[from] super::Error),
    /// The runtime refuses the lifted blob; it would have refused the old one, too.
    #[error("the runtime refuses the lifted blob: {0}")]
    Refused(blob::Error),
}

/// A lifted blob.
#[derive(Debug, Clone)]
pub struct Lifted {
    /// The blob, of the format that this version writes.
    pub blob: AlignedBlob,
    /// Format of the old one, major and minor.
    pub from: [u16; 2],
    /// Length of the weight section, bytes.
    pub weights: usize,
    /// SHA-256 of the weight section of the old and of the new blob, each taken from the bytes of its own file.
    pub hashes: [String; 2],
}

/// Whether `bytes` begin like a blob, of whatever format.
#[must_use]
pub fn is_blob(bytes: &[u8]) -> bool {
    bytes.starts_with(&MAGIC)
}

/// Writes the manifest of a blob of format 3 anew, weights and tensor table as they are, and has the runtime open the result. Bytes
/// behind the blob are left out.
///
/// # Errors
/// [`Error`].
pub fn lift(bytes: &[u8]) -> Result<Lifted, Error> {
    if let Some(&[a, b, c, d]) = bytes.get(4..8).filter(|_| is_blob(bytes)) {
        let (major, minor) = (u16::from_le_bytes([a, b]), u16::from_le_bytes([c, d]));
        if major == MAJOR {
            return Err(Error::Current { minor });
        }
    }
    let old = v3::read(bytes)?;
    let skeleton = super::blob::skeleton_bytes();
    let manifest = manifest(&old.manifest, &skeleton)?;
    let blob = crate::blob::write::file(&manifest, old.table, old.weights).map_err(super::Error::from)?;
    Model::open(blob.bytes()).map_err(Error::Refused)?;
    let hashes = [hash(old.weights), hash(weights(blob.bytes()))];
    Ok(Lifted { from: [v3::MAJOR, old.minor], weights: old.weights.len(), hashes, blob })
}

/// The weight section of a blob that the runtime accepts.
fn weights(blob: &[u8]) -> &[u8] {
    let offset =
        blob.get(16..HEADER_LEN).and_then(|rest| rest.first_chunk()).map_or(0, |&word| u32::from_le_bytes(word));
    blob.get(offset as usize..).unwrap_or_default()
}

fn hash(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect()
}

fn manifest<'a>(old: &v3::Manifest<'a>, skeleton: &'a [u8; blob::SKELETON_BYTES]) -> Result<Manifest<'a>, Error> {
    if let v3::Representation::Direct { channels } = old.representation {
        let what = "number of direct channels";
        return Err(Error::Value { what, found: u32::from(channels), allowed: "HumanML3D alone" });
    }
    let v3::Card { name, licence, data, checkpoint } = old.card;
    let v3::SelfTest { seed, tokens, hash } = old.self_test;
    let max_tokens = old.max_tokens;
    let generator = match (&old.planner, &old.control) {
        (None, None) => Generator::Given { max_tokens },
        (None, Some(_)) => {
            return Err(Error::Value { what: "anchor control without a planner", found: 1, allowed: "none" });
        }
        (Some(planner), control) => {
            let v3::Sampler::Tmd { c, a } = planner.sampler;
            Generator::Words(PlannerConfig {
                max_tokens,
                transformer: transformer(planner.transformer),
                corruption: Corruption::Near { c, a },
                guidance: Guidance::TwoPass,
                control: control.as_ref().map(|control| ControlConfig {
                    scaffold: transformer(control.scaffold),
                    frame_width: control.frame_width,
                    rank: control.rank,
                    context: control.context,
                    families: control.families,
                }),
            })
        }
    };
    Ok(Manifest {
        card: Card { name, licence, data, checkpoint },
        representation: Representation::HumanMl3d(HumanMl3d {
            frame_rate: old.frame_rate,
            skeleton: Skeleton::new(skeleton),
        }),
        codec: Codec::Vq(decoder(&old.decoder)?),
        text: old.text.as_ref().map(text).transpose()?,
        generator,
        self_test: SelfTest { seed, tokens, hash },
        tensor_count: old.tensor_count,
    })
}

fn decoder(old: &v3::Decoder) -> Result<DecoderConfig, Error> {
    let found = old.dilations.len() as u32;
    let dilations = heapless::Vec::from_slice(&old.dilations).map_err(|_| Error::Value {
        what: "number of dilations",
        found,
        allowed: "1 to 4",
    })?;
    if usize::from(old.stages) > MAX_STAGES {
        return Err(Error::Value { what: "number of stages", found: u32::from(old.stages), allowed: "1 to 3" });
    }
    let mut config = DecoderConfig {
        width: old.width,
        code_width: old.code_width,
        codes: old.codes,
        quantizers: old.quantizers,
        stages: old.stages,
        dilations,
        padding: heapless::Vec::new(),
        features: old.features,
    };
    config.padding = config.symmetrical();
    Ok(config)
}

fn text<'a>(old: &v3::Text<'a>) -> Result<TextConfig<'a>, Error> {
    if old.encoder.is_none() && !old.vocabulary.is_empty() {
        let found = old.vocabulary.lines().count() as u32;
        return Err(Error::Value { what: "vocabulary without a text encoder", found, allowed: "no words" });
    }
    Ok(TextConfig {
        width: old.width,
        max_words: old.max_words,
        encoder: old.encoder.map_or(TextEncoding::Stored, |encoder| {
            let table = TextTable::Words(old.vocabulary);
            TextEncoding::Words(TextEncoderConfig { table, transformer: transformer(encoder) })
        }),
        length: TextLength::Head,
        bank: PhraseBank::Prompts(old.bank),
    })
}

fn transformer(old: v3::Transformer) -> TransformerConfig {
    let v3::Transformer { width, heads, layers, hidden, norm, activation, epsilon } = old;
    TransformerConfig {
        width,
        heads,
        layers,
        hidden,
        norm: match norm {
            v3::Norm::Pre => Norm::Pre,
            v3::Norm::Post => Norm::Post,
        },
        activation: match activation {
            v3::Activation::Relu => Activation::Relu,
            v3::Activation::Gelu => Activation::Gelu,
        },
        epsilon,
    }
}
