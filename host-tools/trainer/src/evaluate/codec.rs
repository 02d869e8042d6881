//! The tokenizer as a judge's instrument: motion to tokens and back, in f32.

use std::path::Path;

use burn::tensor::{Device, Tensor, TensorData};
use motionette_host::motion::{Pose, recover};

use crate::tokenizer::Error;
use crate::tokenizer::checkpoint::Checkpoint;
use crate::tokenizer::config::{FEATURES, FRAMES_PER_TOKEN};
use crate::tokenizer::model::Network;
use crate::tokenizer::quantizer::nearest;

/// A tokenizer on the trainer's own layers.
pub struct Codec {
    checkpoint: Checkpoint,
    network: Network,
    device: Device,
}

impl Codec {
    /// Reads a tokenizer's checkpoint.
    ///
    /// # Errors
    /// Those of [`Checkpoint::load`].
    pub fn load(path: &Path) -> Result<Self, Error> {
        Ok(Self::new(Checkpoint::load(path)?))
    }

    /// From a checkpoint in memory.
    pub fn new(checkpoint: Checkpoint) -> Self {
        let device = Device::flex();
        let network = Network::new(&checkpoint.config.architecture, &checkpoint.parameters, false, &device);
        Self { checkpoint, network, device }
    }

    /// Unnormalised features `[T][263]` to T / 4 tokens; what is left of the last token is dropped.
    pub fn encode(&self, features: &[f32]) -> Vec<u16> {
        let frames = features.len() / FEATURES / FRAMES_PER_TOKEN * FRAMES_PER_TOKEN;
        if frames == 0 {
            return Vec::new();
        }
        let x = self.checkpoint.normalization.apply(&features[..frames * FEATURES]);
        let x = Tensor::from_data(TensorData::new(x, [1, frames, FEATURES]), &self.device);
        let latents = values(self.network.encode(x, None));
        nearest(&self.checkpoint.codebook, self.checkpoint.config.architecture.code_dim, &latents)
    }

    /// Tokens of the codebook to joints, four frames a token.
    pub fn decode(&self, tokens: &[u16]) -> Vec<Pose> {
        if tokens.is_empty() {
            return Vec::new();
        }
        let dim = self.checkpoint.config.architecture.code_dim;
        let code = |token: &u16| self.checkpoint.codebook[usize::from(*token) * dim..][..dim].iter().copied();
        let codes: Vec<f32> = tokens.iter().flat_map(code).collect();
        let codes = Tensor::from_data(TensorData::new(codes, [1, tokens.len(), dim]), &self.device);
        let features = self.checkpoint.normalization.restore(&values(self.network.decode(codes, None)));
        recover::joints(&features).expect("the decoder gives whole rows")
    }
}

fn values(tensor: Tensor<3>) -> Vec<f32> {
    tensor.into_data().try_into_vec().expect("networks compute in f32")
}
