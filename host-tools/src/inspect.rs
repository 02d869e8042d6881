//! What is in a blob: every tensor, its size and range, what quantisation cost it, and the work of every layer.

use serde::Serialize;

use crate::blob::{BlobFile, Error, Parts, QuantisedConv1d};
use crate::checkpoint::anchors::Family;
use crate::checkpoint::prior::Part;
use crate::checkpoint::{ControlCheckpoint, Conv1d, PriorCheckpoint, TokenizerCheckpoint};
use motionette::blob::{
    Codec, Corruption, DType, Generator, Guidance, Manifest, Padding, PhraseBank, PlannerConfig, Representation,
    TextEncoding, TextTable, TransformerConfig,
};
use motionette::model::cargo_features;

/// Everything `motionette inspect` shows.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Inspection {
    /// Name of the model.
    pub name: String,
    /// Licence of the weights.
    pub licence: String,
    /// Data they were trained on.
    pub data: String,
    /// Hash of the checkpoint.
    pub checkpoint: String,
    /// Format version, "major.minor".
    pub version: String,
    /// Bytes of the blob.
    pub bytes: usize,
    /// Frames a second.
    pub frame_rate: u16,
    /// Frames a token.
    pub frames_per_token: usize,
    /// Longest motion, tokens.
    pub max_tokens: u16,
    /// Kind of the representation, as `FORMAT.md` calls it.
    pub representation: &'static str,
    /// Offset of each of the 22 joints from its parent at rest, metres.
    pub skeleton: Vec<[f32; 3]>,
    /// Kind of the codec.
    pub codec: &'static str,
    /// Configuration of the decoder in words.
    pub decoder: String,
    /// Rows that each convolution with more than one tap looks back and ahead, in order of execution.
    pub padding: Vec<[u16; 2]>,
    /// Kind of the generator.
    pub generator: &'static str,
    /// Cargo features that a firmware needs to run it.
    pub features: Vec<&'static str>,
    /// Whether it carries a self-test.
    pub self_test: bool,
    /// All tensors.
    pub tensors: Vec<TensorInfo>,
    /// All layers of the decoder.
    pub layers: Vec<LayerInfo>,
    /// Text encoder, stored prompts and planner; `None` when there are none.
    pub prior: Option<PriorInfo>,
    /// Anchor control of the planner; `None` when there is none.
    pub control: Option<ControlInfo>,
}

/// Anchor control of the planner.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ControlInfo {
    /// Configuration of the scaffold encoder in words.
    pub scaffold: String,
    /// Width of a frame before frames are merged.
    pub frame_width: u16,
    /// Rank of the projections to keys and values.
    pub rank: u16,
    /// Whether anchors speak to the planner's rows as well (dual context).
    pub context: bool,
    /// Control families that it sees, as a control checkpoint names them.
    pub families: Vec<Family>,
    /// Linears and tables. Work is that of the anchors of one request at the longest motion.
    pub layers: Vec<LayerInfo>,
}

/// Text encoder, stored prompts and planner.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PriorInfo {
    /// Configuration of the text encoder in words; `None` without one.
    pub text: Option<String>,
    /// Numbers of a prompt, where prompts are vectors.
    pub vector: Option<u16>,
    /// Kind of the text table; `None` without a text encoder.
    pub table: Option<&'static str>,
    /// Words with a row; 0 without a text encoder.
    pub words: usize,
    /// Words of the vocabulary in the order of their ids; empty without a text encoder, or where the blob holds hashes of them alone and no
    /// checkpoint says more.
    pub vocabulary: Vec<String>,
    /// Longest prompt, words.
    pub max_words: u16,
    /// Kind of the phrase bank.
    pub bank_kind: &'static str,
    /// Names of the stored prompts.
    pub bank: Vec<String>,
    /// What prompts may be understood as, actions before styles.
    pub phrases: Vec<String>,
    /// Configuration of the planner in words; `None` without one.
    pub planner: Option<String>,
    /// Kind of its guidance; `None` without one.
    pub guidance: Option<&'static str>,
    /// Configuration of the planner of further quantizers in words; `None` without one.
    pub residual: Option<String>,
    /// Linears and tables. Work is that of one text or one pass of the planner at the longest motion and the longest prompt.
    pub layers: Vec<LayerInfo>,
}

/// One tensor.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TensorInfo {
    /// Name.
    pub name: String,
    /// Number format.
    pub dtype: &'static str,
    /// Shape, slowest dimension first.
    pub shape: [usize; 3],
    /// Offset in the weight section.
    pub offset: usize,
    /// Bytes.
    pub bytes: usize,
    /// Smallest number (integers before scaling).
    pub min: f64,
    /// Largest.
    pub max: f64,
}

/// One convolution.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct LayerInfo {
    /// Name in the checkpoint.
    pub name: String,
    /// Output channels.
    pub outputs: usize,
    /// Input channels.
    pub inputs: usize,
    /// Taps.
    pub kernel: usize,
    /// Output channels in int16.
    pub wide: usize,
    /// Bits of the others, 8 or 4.
    pub bits: u8,
    /// Smallest scale.
    pub scale_min: f32,
    /// Largest scale.
    pub scale_max: f32,
    /// Rows of output at the longest motion.
    pub rows: usize,
    /// Multiply-accumulates at the longest motion, all channels; an int16 row counts twice.
    pub macs: u64,
    /// Root mean square of the difference to the checkpoint's weights, as a share of their own; `None` without a checkpoint.
    pub weight_error: Option<f64>,
    /// Largest difference to a checkpoint's weight; `None` without a checkpoint.
    pub weight_error_max: Option<f64>,
}

/// Looks into a blob; with the checkpoints it came from, also what quantisation cost.
///
/// # Errors
/// [`Error`].
pub fn inspect(
    blob: &BlobFile,
    checkpoint: Option<&TokenizerCheckpoint>,
    prior: Option<&PriorCheckpoint>,
    control: Option<&ControlCheckpoint>,
) -> Result<Inspection, Error> {
    let Parts { header, manifest, .. } = blob.parts()?;
    let tensors: Vec<TensorInfo> = blob
        .table()?
        .into_iter()
        .map(|t| TensorInfo {
            dtype: dtype_name(t.dtype),
            min: t.values.iter().copied().fold(f64::INFINITY, f64::min),
            max: t.values.iter().copied().fold(f64::NEG_INFINITY, f64::max),
            name: t.name,
            shape: t.shape,
            offset: t.offset,
            bytes: t.bytes,
        })
        .collect();
    let d = manifest.codec.decoder();
    let layers = blob.layers()?;
    let originals = checkpoint.map(|c| c.decoder.convolutions()).unwrap_or_default();
    let rows = rows_of_layers(usize::from(manifest.generator.max_tokens()), usize::from(d.stages), d.dilations.len());
    let layers = layers.iter().zip(rows).enumerate().map(|(i, (l, rows))| info(l, rows, originals.get(i).copied()));
    Ok(Inspection {
        name: manifest.card.name.to_owned(),
        licence: manifest.card.licence.to_owned(),
        data: manifest.card.data.to_owned(),
        checkpoint: manifest.card.checkpoint.to_owned(),
        version: format!("{}.{}", header.major, header.minor),
        bytes: header.total_len as usize,
        frame_rate: manifest.representation.frame_rate(),
        frames_per_token: manifest.codec.frames_per_token(),
        max_tokens: manifest.generator.max_tokens(),
        representation: match manifest.representation {
            Representation::HumanMl3d(_) => "humanml3d",
        },
        skeleton: manifest.representation.skeleton().offsets().to_vec(),
        codec: match manifest.codec {
            Codec::Vq(_) => "vq",
        },
        padding: d.padding.iter().map(|&Padding { left, right }| [left, right]).collect(),
        features: {
            let needed = cargo_features(&manifest).into_iter().filter(|f| f.needed).map(|f| f.name);
            let wide = tensors.iter().filter(|t| t.dtype == dtype_name(DType::I16Planes)).count() > 1;
            needed.chain(wide.then_some("wide-layers")).collect()
        },
        generator: match manifest.generator {
            Generator::Given { .. } => "given",
            Generator::Words(PlannerConfig { corruption: Corruption::Near { .. }, .. }) => "tmd",
            Generator::Words(_) | Generator::Masked(_) => "masked",
            Generator::Autoregressive(_) => "autoregressive",
        },
        decoder: format!(
            "width {}, {} x {} codes of {}, {} stages of dilations {:?}, {} features",
            d.width, d.quantizers, d.codes, d.code_width, d.stages, d.dilations, d.features
        ),
        self_test: manifest.self_test.hash != 0,
        tensors,
        layers: layers.collect(),
        prior: prior_info(blob, &manifest, prior)?,
        control: control_info(blob, &manifest, control)?,
    })
}

/// A transformer in words.
fn words(t: &TransformerConfig) -> String {
    let (norm, activation) = (format!("{:?}", t.norm).to_lowercase(), format!("{:?}", t.activation).to_lowercase());
    format!(
        "{} layers of width {}, {} heads, hidden {}, norms {norm}, {activation}",
        t.layers, t.width, t.heads, t.hidden
    )
}

fn prior_info(
    blob: &BlobFile,
    manifest: &Manifest<'_>,
    checkpoint: Option<&PriorCheckpoint>,
) -> Result<Option<PriorInfo>, Error> {
    let (Some(text), prefix) = (manifest.text, manifest.generator.prefix()) else { return Ok(None) };
    let lines = |text: &str| text.lines().map(str::to_owned).collect::<Vec<_>>();
    let parts = checkpoint.map(|prior| [prior.text_parts(), prior.planner_parts()].concat());
    let originals = originals(&parts.unwrap_or_default());
    let max_tokens = usize::from(manifest.generator.max_tokens());
    let layers = blob.prior_layers()?;
    let layers = layers.iter().map(|layer| {
        let rows = prior_rows(&layer.name, max_tokens, usize::from(text.max_words));
        info(layer, rows, originals.iter().find(|o| o.name == layer.name))
    });
    let table = text.encoder.words().map(|encoder| match encoder.table {
        TextTable::Words(words) => ("words", words.lines().count(), lines(words)),
        // A blob has hashes of its words alone.
        TextTable::Vectors { words, dims: _ } => {
            ("vectors", usize::from(words), checkpoint.map(|prior| prior.config.vocabulary.clone()).unwrap_or_default())
        }
    });
    let (bank_kind, bank) = match text.bank {
        PhraseBank::Prompts(names) => ("prompts", lines(names)),
        PhraseBank::Meanings { prompts, .. } => ("meanings", lines(prompts)),
    };
    let phrases = match text.bank {
        PhraseBank::Prompts(_) => Vec::new(),
        PhraseBank::Meanings { phrases, .. } => lines(phrases),
    };
    Ok(Some(PriorInfo {
        text: text.encoder.words().map(|encoder| words(&encoder.transformer)),
        vector: (text.encoder == TextEncoding::Vectors).then_some(text.width),
        table: table.as_ref().map(|(kind, ..)| *kind),
        words: table.as_ref().map_or(0, |(_, count, _)| *count),
        vocabulary: table.map(|(.., words)| words).unwrap_or_default(),
        max_words: text.max_words,
        bank_kind,
        bank,
        phrases,
        planner: match &manifest.generator {
            Generator::Given { .. } => None,
            Generator::Words(p) => Some(match p.corruption {
                Corruption::Near { c, a } => format!("{}, TMD with c = {c}, a = {a}", words(&p.transformer)),
                Corruption::Masks => format!("{}, masked", words(&p.transformer)),
            }),
            Generator::Masked(p) => Some(format!("{}, masked", words(&p.transformer))),
            Generator::Autoregressive(p) => Some(format!("{}, a token at a time", words(&p.transformer))),
        },
        guidance: match &manifest.generator {
            Generator::Given { .. } => None,
            Generator::Words(p) if p.guidance == Guidance::OnePass => Some("one pass"),
            Generator::Words(_) | Generator::Masked(_) => Some("two passes"),
            Generator::Autoregressive(_) => Some("nothing"),
        },
        residual: prefix
            .and_then(|p| p.residual)
            .map(|r| format!("{}, guidance {}", words(&r.transformer), r.guidance)),
        layers: layers.collect(),
    }))
}

fn control_info(
    blob: &BlobFile,
    manifest: &Manifest<'_>,
    checkpoint: Option<&ControlCheckpoint>,
) -> Result<Option<ControlInfo>, Error> {
    let Some(control) = manifest.generator.control() else { return Ok(None) };
    let originals = originals(&checkpoint.map(ControlCheckpoint::parts).unwrap_or_default());
    let (max_tokens, frames) = (usize::from(manifest.generator.max_tokens()), manifest.codec.frames_per_token());
    let layers = blob.control_layers()?;
    let layers = layers.iter().map(|layer| {
        let rows = control_rows(&layer.name, max_tokens, frames);
        info(layer, rows, originals.iter().find(|o| o.name == layer.name))
    });
    Ok(Some(ControlInfo {
        scaffold: words(&control.scaffold),
        frame_width: control.frame_width,
        rank: control.rank,
        context: control.context,
        families: Family::ALL.into_iter().filter(|family| control.families & family.bit() != 0).collect(),
        layers: layers.collect(),
    }))
}

/// Linears and tables as convolutions of one tap.
fn originals(parts: &[Part<'_>]) -> Vec<Conv1d> {
    parts
        .iter()
        .filter_map(|part| match part {
            Part::Linear(linear) => Some(linear.as_convolution()),
            Part::Embedding(table) => Some(table.as_convolution()),
            Part::Norm(_) => None,
        })
        .collect()
}

/// Rows that a linear of text encoder or planner computes, by its name; 0 for tables, of which rows are picked. Keys and values of a text
/// are computed once a text.
#[must_use]
pub fn prior_rows(name: &str, tokens: usize, words: usize) -> usize {
    let ends = |ending: &str| name.ends_with(ending);
    match name {
        "text.length" | "planner.global" | "residual.global" => 1,
        "planner.token" => tokens,
        "planner.dense" => tokens + 1,
        "residual.dense" => tokens + 2,
        _ if name.starts_with("residual.token.") => tokens,
        _ if ends(".cross.kv") => words,
        _ if !name.contains(".layers.") => 0,
        _ if name.starts_with("text.") => words,
        _ if name.starts_with("residual.") => tokens + 2,
        _ => tokens + 1,
    }
}

/// Rows that a linear of the anchor control computes, by its name; 0 for tables.
#[must_use]
pub fn control_rows(name: &str, tokens: usize, frames_per_token: usize) -> usize {
    match name {
        "control.position" => 0,
        "control.frame" => tokens * frames_per_token,
        "control.global.in" | "control.global.out" => 1,
        _ => tokens,
    }
}

/// Output rows of every convolution in order of execution, for so many tokens.
#[must_use]
pub fn rows_of_layers(tokens: usize, stages: usize, blocks: usize) -> Vec<usize> {
    let mut rows = vec![tokens];
    for stage in 0..stages {
        rows.extend(std::iter::repeat_n(tokens << stage, 2 * blocks));
        rows.push(tokens << (stage + 1));
    }
    rows.extend([tokens << stages; 2]);
    rows
}

/// Multiply-accumulates of one layer for `rows` output rows, all channels.
#[must_use]
pub fn layer_macs(layer: &QuantisedConv1d, rows: usize) -> u64 {
    (rows * layer.kernel * layer.inputs * (layer.outputs + layer.wide)) as u64
}

fn info(layer: &QuantisedConv1d, rows: usize, original: Option<&Conv1d>) -> LayerInfo {
    let errors = original.filter(|o| o.weight.len() == layer.values.len()).map(|original| {
        let back = layer.dequantised();
        let pairs = || original.weight.iter().zip(&back.weight).map(|(&a, &b)| (f64::from(a), f64::from(b)));
        let square = pairs().map(|(a, b)| (a - b).powi(2)).sum::<f64>();
        let total = pairs().map(|(a, _)| a * a).sum::<f64>();
        (
            if total > 0.0 { (square / total).sqrt() } else { 0.0 },
            pairs().map(|(a, b)| (a - b).abs()).fold(0.0, f64::max),
        )
    });
    LayerInfo {
        name: layer.name.clone(),
        outputs: layer.outputs,
        inputs: layer.inputs,
        kernel: layer.kernel,
        wide: layer.wide,
        bits: layer.bits,
        scale_min: layer.scales.iter().copied().fold(f32::INFINITY, f32::min),
        scale_max: layer.scales.iter().copied().fold(0.0, f32::max),
        rows,
        macs: layer_macs(layer, rows),
        weight_error: errors.map(|e| e.0),
        weight_error_max: errors.map(|e| e.1),
    }
}

/// Short name of a number format.
#[must_use]
pub fn dtype_name(dtype: DType) -> &'static str {
    match dtype {
        DType::I4 => "int4",
        DType::I8 => "int8",
        DType::I16Planes => "int16",
        DType::F16 => "f16",
        DType::F32 => "f32",
        DType::U32 => "u32",
    }
}
