//! What of a checkpoint goes into the manifest and the tensors of a blob (`runtime/src/blob/FORMAT.md`).

use motionette::blob::{
    ALIGNMENT, Activation, Card, Codec, ControlConfig, Corruption, DType, DecoderConfig, Generator as GeneratorConfig,
    Guidance, HumanMl3d, MAX_BLOCKS, MAX_STAGES, Manifest, Norm, PhraseBank, PlannerConfig, Representation,
    SKELETON_BYTES, SelfTest, Skeleton, TextConfig, TextEncoderConfig, TextEncoding, TextLength, TextTable,
    TransformerConfig,
};
use motionette::numerics::hash::Stream;
use motionette::{Bones, Generator, Limits, Model, Plan, Request};

use super::prior::{QuantisedPart, QuantisedPrior};
use super::{CardText, Error, MAX_TOKENS, Planned, PriorSource, PublishedSource, bank};
use crate::blob::layer::{pack, split};
use crate::blob::write::{self as blob, Tensor, narrow};
use crate::blob::{AlignedBlob, QuantisedConv1d};
use crate::checkpoint::prior::{self, NormOrder, SPECIAL, WordRows, WordVectors};
use crate::checkpoint::words::hash;
use crate::checkpoint::{ControlCheckpoint, PriorCheckpoint, PublishedPlanner, TokenizerCheckpoint};
use crate::motion::uniform;

/// Seed of the self-test's tokens.
const SELF_TEST_SEED: u32 = 1;
/// Numbers (tokens times quantizers) of a self-test request at most.
const SELF_TEST_NUMBERS: usize = 24;

/// Everything of a manifest that does not depend on bytes.
struct Facts<'a> {
    card: &'a CardText,
    frame_rate: u16,
    skeleton: [u8; SKELETON_BYTES],
    decoder: DecoderConfig,
    text: Option<Text>,
    generator: GeneratorConfig,
}

/// [`TextConfig`] with text of its own.
struct Text {
    width: u16,
    max_words: u16,
    encoder: Encoder,
    length: TextLength,
    bank: String,
    meanings: Option<Meanings>,
}

/// [`TextEncoding`] with words of its own.
enum Encoder {
    Stored,
    /// Words and blocks.
    Words(Words, TransformerConfig),
    Vectors,
}

/// [`TextTable`] with words of its own.
enum Words {
    Listed(String),
    Vectors { words: u16, dims: u16 },
}

/// What prompts may mean.
struct Meanings {
    phrases: String,
    actions: u16,
    threshold: f32,
}

/// Serialises `checkpoint` with its quantised decoder `layers`, the prior if there is one, and a self-test, and has the runtime open and
/// run it.
///
/// # Errors
/// [`Error`], when a size does not fit, or the runtime refuses the result.
pub(super) fn write(
    checkpoint: &TokenizerCheckpoint,
    layers: &[QuantisedConv1d],
    planned: Planned<'_>,
    card: &CardText,
) -> Result<AlignedBlob, Error> {
    let mut tensors = tensors(checkpoint, layers)?;
    match planned {
        Planned::Given => {}
        Planned::Prior(source, quantised) => push_prior(&mut tensors, source, quantised)?,
        Planned::Published(source, quantised) => {
            push_bank(&mut tensors, source.bank, source.vector())?;
            quantised.planner.iter().chain(&quantised.residual).try_for_each(|part| push_part(&mut tensors, part))?;
        }
    }
    let facts = Facts {
        card,
        frame_rate: checkpoint.config.fps.round() as u16,
        skeleton: skeleton_bytes(),
        decoder: decoder_config(checkpoint)?,
        text: match planned {
            Planned::Given => None,
            Planned::Prior(source, _) => Some(text_config(source)?),
            Planned::Published(source, _) => Some(vector_config(source)?),
        },
        generator: match planned {
            Planned::Given => GeneratorConfig::Given { max_tokens: narrow(MAX_TOKENS, "longest motion")? },
            Planned::Prior(source, _) => GeneratorConfig::Words(planner_config(source)?),
            Planned::Published(source, _) => match source.planner {
                PublishedPlanner::Gpt(_) => GeneratorConfig::Autoregressive(source.config()?),
                _ => GeneratorConfig::Masked(source.config()?),
            },
        },
    };
    let quantizers = checkpoint.config.quantizers;
    let tokens = (SELF_TEST_NUMBERS / quantizers).max(1).min(usize::from(facts.generator.max_tokens()));
    let mut self_test = SelfTest { seed: SELF_TEST_SEED, tokens: tokens as u16, hash: 0 };
    let first = assemble(&tensors, &facts, self_test)?;
    self_test.hash = run_self_test(first.bytes(), &self_test)?;
    assemble(&tensors, &facts, self_test)
}

/// Decodes the self-test's tokens and hashes the motion.
fn run_self_test(blob: &[u8], test: &SelfTest) -> Result<u64, Error> {
    let model = Model::open(blob).map_err(Error::Refused)?;
    let mut stream = Stream::new(u64::from(test.seed));
    let count = usize::from(test.tokens) * model.codebooks().quantizers();
    let codes = model.codebooks().codes() as u32;
    let tokens: Vec<u16> = (0..count).map(|_| stream.below(codes) as u16).collect();
    let limits = Limits {
        tokens: usize::from(test.tokens),
        anchors: 0,
        tracked: 0,
        timeline: None,
        refinement: Default::default(),
        planning: None,
        rows: motionette::ROWS,
    };
    let plan = Plan::for_request(&model, &limits).map_err(|e| Error::SelfTest(e.into()))?;
    let mut arena = vec![0_u128; plan.arena_bytes.div_ceil(ALIGNMENT)];
    let mut generator = Generator::new(model, bytemuck::cast_slice_mut(&mut arena)).map_err(Error::SelfTest)?;
    let decoded = Request::tokens(&tokens).bones(Bones::Decoded).unrefined();
    Ok(generator.generate(&decoded, &mut ()).map_err(Error::SelfTest)?.hash())
}

fn assemble(tensors: &[Tensor], facts: &Facts<'_>, self_test: SelfTest) -> Result<AlignedBlob, Error> {
    let manifest = Manifest {
        card: Card {
            name: &facts.card.name,
            licence: &facts.card.licence,
            data: &facts.card.data,
            checkpoint: &facts.card.checkpoint,
        },
        representation: Representation::HumanMl3d(HumanMl3d {
            frame_rate: facts.frame_rate,
            skeleton: Skeleton::new(&facts.skeleton),
        }),
        codec: Codec::Vq(facts.decoder.clone()),
        text: facts.text.as_ref().map(|t| TextConfig {
            width: t.width,
            max_words: t.max_words,
            encoder: match &t.encoder {
                Encoder::Stored => TextEncoding::Stored,
                Encoder::Vectors => TextEncoding::Vectors,
                Encoder::Words(words, transformer) => TextEncoding::Words(TextEncoderConfig {
                    table: match *words {
                        Words::Listed(ref words) => TextTable::Words(words),
                        Words::Vectors { words, dims } => TextTable::Vectors { words, dims },
                    },
                    transformer: *transformer,
                }),
            },
            length: t.length,
            bank: match &t.meanings {
                None => PhraseBank::Prompts(&t.bank),
                Some(Meanings { phrases, actions, threshold }) => {
                    PhraseBank::Meanings { prompts: &t.bank, phrases, actions: *actions, threshold: *threshold }
                }
            },
        }),
        generator: facts.generator,
        self_test,
        tensor_count: narrow::<u16>(tensors.len(), "number of tensors")?,
    };
    Ok(blob::write(&manifest, tensors)?)
}

/// The body that moves, as a manifest holds it: [`uniform::body`].
pub(super) fn skeleton_bytes() -> [u8; SKELETON_BYTES] {
    let mut bytes = uniform::body().into_iter().flatten().flat_map(|v| (v as f32).to_le_bytes());
    std::array::from_fn(|_| bytes.next().unwrap_or_default())
}

fn decoder_config(checkpoint: &TokenizerCheckpoint) -> Result<DecoderConfig, Error> {
    let c = &checkpoint.config;
    let mut dilations = heapless::Vec::new();
    for &d in &c.dilations {
        let dilation = narrow(d, "dilation")?;
        let limit = || Error::Limit {
            what: "residual blocks a stage",
            found: c.depth,
            allowed: format!("at most {MAX_BLOCKS}"),
        };
        dilations.push(dilation).map_err(|_| limit())?;
    }
    if c.down_t > MAX_STAGES {
        return Err(Error::Limit { what: "stages", found: c.down_t, allowed: format!("at most {MAX_STAGES}") });
    }
    let mut config = DecoderConfig {
        width: narrow(c.width, "decoder width")?,
        code_width: narrow(c.code_dim, "code width")?,
        codes: narrow(c.codes, "number of codes")?,
        quantizers: narrow(c.quantizers, "number of quantizers")?,
        stages: narrow(c.down_t, "stages")?,
        dilations,
        padding: heapless::Vec::new(),
        features: narrow(c.features, "number of features")?,
    };
    config.padding = config.symmetrical();
    for (padding, right) in config.padding.iter_mut().zip(c.right()) {
        let both = padding.left + padding.right;
        padding.right = narrow(right, "look-ahead of a convolution")?;
        padding.left = both - padding.right;
    }
    Ok(config)
}

fn text_config(source: &PriorSource<'_>) -> Result<Text, Error> {
    let c = &source.checkpoint.config;
    let names: Vec<&str> = source.bank.iter().map(|e| e.name.as_str()).collect();
    let encoder = match source.text_encoder {
        true => Encoder::Words(words(source.checkpoint)?, transformer_config(c.form(), c.text)?),
        false => Encoder::Stored,
    };
    let actions = c.meanings.iter().filter(|meaning| !meaning.style).count();
    let phrases: Vec<&str> = c.meanings.iter().map(|meaning| meaning.phrase.as_str()).collect();
    let meanings = Meanings {
        phrases: phrases.join("\n"),
        actions: narrow(actions, "phrases of actions")?,
        threshold: c.threshold,
    };
    Ok(Text {
        width: narrow(c.text.width, "width of the text encoder")?,
        max_words: narrow(c.max_words, "longest prompt")?,
        encoder,
        length: TextLength::Head,
        bank: names.join("\n"),
        meanings: (!phrases.is_empty()).then_some(meanings),
    })
}

/// Of prompts that are vectors.
fn vector_config(source: &PublishedSource<'_>) -> Result<Text, Error> {
    let names: Vec<&str> = source.bank.iter().map(|e| e.name.as_str()).collect();
    Ok(Text {
        width: narrow(source.vector(), "width of a prompt's vector")?,
        max_words: 1,
        encoder: Encoder::Vectors,
        length: TextLength::Unsaid,
        bank: names.join("\n"),
        meanings: None,
    })
}

fn words(prior: &PriorCheckpoint) -> Result<Words, Error> {
    let dims = prior.config.word_vectors;
    if dims == 0 {
        return Ok(Words::Listed(prior.config.vocabulary.join("\n")));
    }
    Ok(Words::Vectors {
        words: narrow(prior.config.vocabulary.len() - SPECIAL, "words with a vector")?,
        dims: narrow(dims, "numbers of a word's vector")?,
    })
}

fn planner_config(source: &PriorSource<'_>) -> Result<PlannerConfig, Error> {
    let c = &source.checkpoint.config;
    Ok(PlannerConfig {
        max_tokens: narrow(c.max_tokens, "longest motion")?,
        transformer: transformer_config(c.form(), c.planner)?,
        corruption: match c.corruption {
            prior::Corruption::Near => Corruption::Near { c: c.c as f32, a: c.a as f32 },
            prior::Corruption::Masks => Corruption::Masks,
        },
        guidance: if source.checkpoint.planner.guidance.is_some() { Guidance::OnePass } else { Guidance::TwoPass },
        control: source.control.map(control_config).transpose()?,
    })
}

fn control_config(control: &ControlCheckpoint) -> Result<ControlConfig, Error> {
    let c = &control.config;
    Ok(ControlConfig {
        scaffold: transformer_config(c.form(), c.scaffold)?,
        frame_width: narrow(c.frame_width, "width of a frame of the scaffold")?,
        rank: narrow(c.rank, "rank of the anchors' keys and values")?,
        context: c.context,
        families: c.families.iter().fold(0, |bits, family| bits | family.bit()),
    })
}

pub(super) fn transformer_config(form: prior::Form, sizes: prior::Sizes) -> Result<TransformerConfig, Error> {
    Ok(TransformerConfig {
        width: narrow(sizes.width, "width of a transformer")?,
        heads: narrow(sizes.heads, "number of heads")?,
        layers: narrow(sizes.layers, "number of layers")?,
        hidden: narrow(sizes.hidden, "hidden width of a transformer")?,
        norm: match form.norm {
            NormOrder::Pre => Norm::Pre,
            NormOrder::Post => Norm::Post,
        },
        activation: match form.activation {
            prior::Activation::Gelu => Activation::Gelu,
            prior::Activation::Relu => Activation::Relu,
        },
        epsilon: form.epsilon as f32,
    })
}

/// Text encoder or its length head alone, stored prompts, planner, anchor control.
fn push_prior(tensors: &mut Vec<Tensor>, source: &PriorSource<'_>, prior: &QuantisedPrior) -> Result<(), Error> {
    let heads = 1 + usize::from(source.checkpoint.text.meaning.is_some());
    if let (true, WordRows::Vectors(vectors)) = (source.text_encoder, &source.checkpoint.text.table) {
        push_vectors(tensors, source.checkpoint, vectors)?;
    }
    for part in &prior.text[if source.text_encoder { 0 } else { prior.text.len().saturating_sub(heads) }..] {
        push_part(tensors, part)?;
    }
    push_bank(tensors, source.bank, source.checkpoint.config.text.width)?;
    prior.planner.iter().try_for_each(|part| push_part(tensors, part))?;
    if let Some(control) = source.control {
        tensors.push(Tensor::vector("control.mean".into(), &control.statistics.mean)?);
        tensors.push(Tensor::vector("control.std".into(), &control.statistics.std)?);
    }
    prior.control.iter().try_for_each(|part| push_part(tensors, part))
}

/// Stored prompts, rows of so many numbers.
fn push_bank(tensors: &mut Vec<Tensor>, bank: &[bank::Entry], width: usize) -> Result<(), Error> {
    for entry in bank {
        let mut bytes = Vec::with_capacity(2 * entry.rows.len());
        for &value in &entry.rows {
            let half = half::f16::from_f32(value);
            if !half.is_finite() {
                return Err(Error::Prompt { name: entry.name.clone(), value });
            }
            bytes.extend(half.to_le_bytes());
        }
        let rows = narrow(entry.rows.len() / width, "rows of a stored prompt")?;
        let shape = [1, rows, narrow(width, "width of the text encoder")?];
        // The table bounds the length of names, and a prompt may have the name of another tensor.
        let name = format!("bank.{}", tensors.iter().filter(|t| t.name.starts_with("bank.")).count());
        tensors.push(Tensor { name, dtype: DType::F16, shape, bytes });
    }
    Ok(())
}

/// Hashes of words, their vectors in 4 bits, the scales of these; in the order of the hashes, as the vocabulary is.
fn push_vectors(tensors: &mut Vec<Tensor>, prior: &PriorCheckpoint, vectors: &WordVectors) -> Result<(), Error> {
    let words = &prior.config.vocabulary[SPECIAL..];
    let (rows, dims) =
        (narrow(words.len(), "words with a vector")?, narrow(prior.config.word_vectors, "word vectors")?);
    let numbers: Vec<i32> = vectors.numbers.iter().map(|number| *number as i32).collect();
    let hashes = words.iter().flat_map(|word| hash(word).to_le_bytes()).collect();
    let scales = vectors.scales.iter().flat_map(|scale| half::f16::from_f32(*scale).to_le_bytes()).collect();
    for (name, dtype, shape, bytes) in [
        ("text.words", DType::U32, [1, 1, rows], hashes),
        ("text.vectors", DType::I4, [1, rows, dims], pack(&numbers)),
        ("text.scales", DType::F16, [1, 1, rows], scales),
    ] {
        tensors.push(Tensor { name: name.into(), dtype, shape, bytes });
    }
    Ok(())
}

fn push_part(tensors: &mut Vec<Tensor>, part: &QuantisedPart) -> Result<(), Error> {
    match part {
        QuantisedPart::Linear(layer) => push_layer(tensors, layer)?,
        QuantisedPart::Table(table) => {
            push_layer(tensors, table)?;
            // A table has no bias.
            tensors.pop();
        }
        QuantisedPart::Norm(norm) => {
            tensors.push(Tensor::vector(format!("{}.weight", norm.name), &norm.weight)?);
            tensors.push(Tensor::vector(format!("{}.bias", norm.name), &norm.bias)?);
        }
    }
    Ok(())
}

fn tensors(checkpoint: &TokenizerCheckpoint, layers: &[QuantisedConv1d]) -> Result<Vec<Tensor>, Error> {
    let statistics =
        checkpoint.statistics.as_ref().ok_or(crate::reference::decode_path::DecodePathError::NoStatistics)?;
    let std: Vec<f32> = statistics.std.iter().map(|&s| s as f32).collect();
    if let Some(channel) = std.iter().position(|s| !(s.is_normal() && *s > 0.0)) {
        return Err(Error::Std { channel, value: statistics.std[channel] });
    }
    let mean: Vec<f32> = statistics.mean.iter().map(|&m| m as f32).collect();
    let mut tensors = vec![Tensor::vector("mean".into(), &mean)?, Tensor::vector("std".into(), &std)?];
    let width = checkpoint.config.code_dim;
    for (quantizer, book) in checkpoint.codebooks.iter().enumerate() {
        let mut bytes = Vec::with_capacity(2 * book.len());
        for (i, &value) in book.iter().enumerate() {
            let half = half::f16::from_f32(value);
            if !half.is_finite() {
                return Err(Error::Code { quantizer, code: i / width, value });
            }
            bytes.extend(half.to_le_bytes());
        }
        let shape = [1, narrow(checkpoint.config.codes, "number of codes")?, narrow(width, "code width")?];
        tensors.push(Tensor {
            name: format!("quantizer.layers.{quantizer}.codebook"),
            dtype: DType::F16,
            shape,
            bytes,
        });
    }
    for layer in layers {
        push_layer(&mut tensors, layer)?;
    }
    Ok(tensors)
}

/// int16 rows, int8 or 4-bit rows, scales, biases.
fn push_layer(tensors: &mut Vec<Tensor>, layer: &QuantisedConv1d) -> Result<(), Error> {
    let shape = |rows: usize| -> Result<[u16; 3], Error> {
        Ok([narrow(layer.kernel, "kernel")?, narrow(rows, "outputs")?, narrow(layer.inputs, "inputs")?])
    };
    if layer.wide > 0 {
        let pairs: Vec<(i8, i8)> = layer.planes(0, layer.wide).into_iter().map(split).collect();
        let bytes = pairs.iter().map(|p| p.0 as u8).chain(pairs.iter().map(|p| p.1 as u8)).collect();
        let name = format!("{}.wide", layer.name);
        tensors.push(Tensor { name, dtype: DType::I16Planes, shape: shape(layer.wide)?, bytes });
    }
    if layer.wide < layer.outputs {
        let weights = layer.planes(layer.wide, layer.outputs);
        let (dtype, bytes) = match layer.bits {
            4 => (DType::I4, pack(&weights)),
            _ => (DType::I8, weights.into_iter().map(|v| v as i8 as u8).collect()),
        };
        let name = format!("{}.weight", layer.name);
        tensors.push(Tensor { name, dtype, shape: shape(layer.outputs - layer.wide)?, bytes });
    }
    tensors.push(Tensor::vector(format!("{}.scale", layer.name), &layer.scales)?);
    tensors.push(Tensor::vector(format!("{}.bias", layer.name), &layer.bias)?);
    Ok(())
}
