//! A motion tokenizer in memory, put together from named tensors.

use super::config::{Config, Source};
use super::error::Result;
use super::tensors::TensorMap;

/// Weights of a 1-D convolution in torch layout.
#[derive(Debug, Clone, PartialEq)]
pub struct Conv1d {
    /// Name without `.weight`, as in the checkpoint less its prefix ("decoder.model.0").
    pub name: String,
    /// Output channels.
    pub outputs: usize,
    /// Input channels.
    pub inputs: usize,
    /// Taps.
    pub kernel: usize,
    /// `[outputs][inputs][kernel]`.
    pub weight: Vec<f32>,
    /// `[outputs]`.
    pub bias: Vec<f32>,
}

/// `x + conv2(relu(conv1(relu(x))))`.
#[derive(Debug, Clone, PartialEq)]
pub struct ResBlock {
    /// Three taps, dilated.
    pub conv1: Conv1d,
    /// One tap.
    pub conv2: Conv1d,
    /// Dilation of `conv1`.
    pub dilation: usize,
}

/// Halves the frame rate, then residual blocks.
#[derive(Debug, Clone, PartialEq)]
pub struct EncoderStage {
    /// Four taps, stride 2, padding 1.
    pub down: Conv1d,
    /// In order of execution.
    pub blocks: Vec<ResBlock>,
}

/// Features to code space: conv k3, ReLU, stages, conv k3.
#[derive(Debug, Clone, PartialEq)]
pub struct Encoder {
    /// F to encoder width.
    pub input: Conv1d,
    /// `down_t` of them.
    pub stages: Vec<EncoderStage>,
    /// Encoder width to du.
    pub output: Conv1d,
}

/// Residual blocks, then every sample twice, then a convolution.
#[derive(Debug, Clone, PartialEq)]
pub struct DecoderStage {
    /// In order of execution.
    pub blocks: Vec<ResBlock>,
    /// Three taps, after nearest x2. No ReLU follows.
    pub up: Conv1d,
}

/// Code space to normalised features: conv k3, ReLU, stages, conv k3, ReLU, conv k3.
#[derive(Debug, Clone, PartialEq)]
pub struct Decoder {
    /// du to width.
    pub input: Conv1d,
    /// `down_t` of them.
    pub stages: Vec<DecoderStage>,
    /// Width to width.
    pub hidden: Conv1d,
    /// Width to F.
    pub output: Conv1d,
    /// Frames that each convolution with three taps looks ahead, in order of execution. It looks back what is left of twice its dilation.
    pub right: Vec<usize>,
}

impl Decoder {
    /// All convolutions in order of execution.
    #[must_use]
    pub fn convolutions(&self) -> Vec<&Conv1d> {
        let mut all = vec![&self.input];
        for stage in &self.stages {
            all.extend(stage.blocks.iter().flat_map(|b| [&b.conv1, &b.conv2]));
            all.push(&stage.up);
        }
        all.extend([&self.hidden, &self.output]);
        all
    }

    /// All convolutions in order of execution, to change them.
    #[must_use]
    pub fn convolutions_mut(&mut self) -> Vec<&mut Conv1d> {
        let mut all = vec![&mut self.input];
        for stage in &mut self.stages {
            all.extend(stage.blocks.iter_mut().flat_map(|b| [&mut b.conv1, &mut b.conv2]));
            all.push(&mut stage.up);
        }
        all.extend([&mut self.hidden, &mut self.output]);
        all
    }
}

/// Per-channel normalisation: feature = normalised * std + mean.
#[derive(Debug, Clone, PartialEq)]
pub struct Statistics {
    /// `[F]`, features' units.
    pub mean: Vec<f64>,
    /// `[F]`, positive (a channel that never varied in training has a tiny one).
    pub std: Vec<f64>,
}

/// A tokenizer read from a checkpoint, checked: every tensor present, of the shape the configuration says, finite.
#[derive(Debug, Clone, PartialEq)]
pub struct TokenizerCheckpoint {
    /// Sizes and provenance.
    pub config: Config,
    /// The encoder, unless the checkpoint was stripped of it.
    pub encoder: Option<Encoder>,
    /// The decoder.
    pub decoder: Decoder,
    /// `quantizers` codebooks of `[codes][code_dim]`.
    pub codebooks: Vec<Vec<f32>>,
    /// Mean and std of the features, where known.
    pub statistics: Option<Statistics>,
}

/// Takes tensors out of a map under a common prefix.
struct Builder<'a> {
    map: &'a TensorMap,
    prefix: &'static str,
}

impl Builder<'_> {
    fn conv(&self, name: String, outputs: usize, inputs: usize, kernel: usize) -> Result<Conv1d> {
        let weight = self.tensor(&format!("{name}.weight"), &[outputs, inputs, kernel])?;
        let bias = self.tensor(&format!("{name}.bias"), &[outputs])?;
        Ok(Conv1d { name, outputs, inputs, kernel, weight, bias })
    }

    fn tensor(&self, name: &str, shape: &[usize]) -> Result<Vec<f32>> {
        let shape: Vec<Option<usize>> = shape.iter().copied().map(Some).collect();
        Ok(self.map.get(&format!("{}{name}", self.prefix), &shape)?.data.clone())
    }

    fn blocks(&self, base: &str, width: usize, dilations: &[usize]) -> Result<Vec<ResBlock>> {
        let block = |(b, &dilation): (usize, &usize)| {
            Ok(ResBlock {
                conv1: self.conv(format!("{base}.model.{b}.conv1"), width, width, 3)?,
                conv2: self.conv(format!("{base}.model.{b}.conv2"), width, width, 1)?,
                dilation,
            })
        };
        dilations.iter().enumerate().map(block).collect()
    }

    fn encoder(&self, c: &Config) -> Result<Encoder> {
        let width = c.encoder_width;
        let stage = |s: usize| {
            Ok(EncoderStage {
                down: self.conv(format!("encoder.model.{}.0", s + 2), width, width, 4)?,
                blocks: self.blocks(&format!("encoder.model.{}.1", s + 2), width, c.encoder_dilations())?,
            })
        };
        Ok(Encoder {
            input: self.conv("encoder.model.0".into(), width, c.features, 3)?,
            stages: (0..c.down_t).map(stage).collect::<Result<_>>()?,
            output: self.conv(format!("encoder.model.{}", c.down_t + 2), c.code_dim, width, 3)?,
        })
    }

    fn decoder(&self, c: &Config) -> Result<Decoder> {
        let width = c.width;
        let stage = |s: usize| {
            Ok(DecoderStage {
                blocks: self.blocks(&format!("decoder.model.{}.0", s + 2), width, &c.dilations)?,
                up: self.conv(format!("decoder.model.{}.2", s + 2), width, width, 3)?,
            })
        };
        Ok(Decoder {
            input: self.conv("decoder.model.0".into(), width, c.code_dim, 3)?,
            stages: (0..c.down_t).map(stage).collect::<Result<_>>()?,
            hidden: self.conv(format!("decoder.model.{}", c.down_t + 2), width, width, 3)?,
            output: self.conv(format!("decoder.model.{}", c.down_t + 4), c.features, width, 3)?,
            right: c.right(),
        })
    }
}

impl TokenizerCheckpoint {
    /// Puts a tokenizer together and checks every tensor against `config`.
    ///
    /// # Errors
    /// The first tensor that is missing, misshapen or not finite, by name.
    pub fn build(map: &TensorMap, config: Config) -> Result<Self> {
        let prefix = match config.source {
            Source::T2mGpt => "vqvae.",
            Source::Momask | Source::Motionette => "",
        };
        let builder = Builder { map, prefix };
        let decoder = builder.decoder(&config)?;
        let has_encoder = map.names().any(|n| n.strip_prefix(prefix).is_some_and(|n| n.starts_with("encoder.")));
        let encoder = if has_encoder { Some(builder.encoder(&config)?) } else { None };
        let codebooks = (0..config.quantizers)
            .map(|q| {
                let name = match config.source {
                    Source::T2mGpt => "quantizer.codebook".to_owned(),
                    Source::Momask | Source::Motionette => format!("quantizer.layers.{q}.codebook"),
                };
                builder.tensor(&name, &[config.codes, config.code_dim])
            })
            .collect::<Result<_>>()?;
        let statistics = if map.find("mean").is_some() || map.find("std").is_some() {
            let read = |name| -> Result<Vec<f64>> {
                let tensor = map.get(name, &[Some(config.features)])?;
                Ok(tensor.data.iter().copied().map(f64::from).collect())
            };
            Some(Statistics { mean: read("mean")?, std: read("std")? })
        } else {
            None
        };
        Ok(Self { config, encoder, decoder, codebooks, statistics })
    }
}
