//! The networks that stay as they are: prior and tokenizer.

use std::path::Path;

use burn::tensor::{Device, Tensor, TensorData};
use motionette_host::checkpoint::prior::codebook_hash;
use motionette_host::motion::Pose;
use motionette_host::reference::recover::{self, CHANNELS};

use super::Error;
use super::config::Config;
use crate::tokenizer::model::Network;
use crate::transformer::{Layout, Weights};
use crate::{prior, tokenizer};

/// The networks that stay as they are.
pub struct Frozen {
    /// The prior.
    pub prior: prior::checkpoint::Checkpoint,
    /// Names and shapes of its parameters.
    pub layout: Layout,
    /// The tokenizer.
    pub tokenizer: tokenizer::checkpoint::Checkpoint,
}

/// The same on a device, without gradients of their own.
pub struct FrozenNetworks {
    /// Text encoder and planner.
    pub prior: Weights,
    /// The tokenizer's decoder, only the channels that joints are recovered from.
    pub decoder: Network,
    /// `[V, du]`.
    pub codebook: Tensor<2>,
}

/// What the decoder says of a motion.
pub struct Recovered {
    /// Features as they are, `[T][CHANNELS]`.
    pub features: Vec<f32>,
    /// Joints, metres.
    pub joints: Vec<Pose>,
}

impl Frozen {
    /// Reads prior and tokenizer, and checks them against one another.
    ///
    /// # Errors
    /// [`Error::Prior`], [`Error::Tokenizer`], [`Error::OtherTokenizer`].
    pub fn load(prior: &Path, tokenizer: &Path) -> Result<Self, Error> {
        let tokenizer = tokenizer::checkpoint::Checkpoint::load(tokenizer).map_err(Error::Tokenizer)?;
        let prior = prior::checkpoint::load(prior).map_err(Error::Prior)?;
        let found = codebook_hash(&tokenizer.codebook);
        if found != prior.sources.tokenizer {
            return Err(Error::OtherTokenizer { wanted: prior.sources.tokenizer, found });
        }
        let layout = prior.sources.layout(&prior.config);
        Ok(Self { prior, layout, tokenizer })
    }

    /// The networks on a device.
    pub fn on(&self, device: &Device) -> FrozenNetworks {
        let a = &self.tokenizer.config.architecture;
        let codebook = TensorData::new(self.tokenizer.codebook.clone(), [a.codes, a.code_dim]);
        FrozenNetworks {
            prior: Weights::new(&self.layout, &self.prior.parameters, false, device),
            decoder: Network::frozen_decoder(a, &self.tokenizer.parameters, CHANNELS, device),
            codebook: Tensor::from_data(codebook, device),
        }
    }

    /// What the corpus draws for a run of control: whole motions, pieces and joined ones, nothing fixed.
    pub fn examples(&self, config: &Config) -> prior::config::Config {
        prior::config::Config {
            seed: config.seed,
            batch: config.batch,
            text_dropout: config.text_dropout,
            crops: config.crops,
            joins: config.joins,
            fixed: 0.0,
            ..self.prior.config.clone()
        }
    }

    /// Normalised features `[T][CHANNELS]` to joints.
    pub fn recovered(&self, y: &[f32]) -> Recovered {
        let n = &self.tokenizer.normalization;
        let restored = |(i, y): (usize, &f32)| y * n.std[i % CHANNELS] + n.mean[i % CHANNELS];
        let features: Vec<f32> = y.iter().enumerate().map(restored).collect();
        let joints = recover::joints(&features, CHANNELS);
        Recovered { features, joints }
    }

    /// `dJ/djoints` back to the normalised features.
    pub fn recovered_backward(&self, recovered: &Recovered, gradient: &[Pose]) -> Vec<f32> {
        let std = &self.tokenizer.normalization.std;
        let d = recover::joints_backward(&recovered.features, CHANNELS, gradient);
        d.into_iter().enumerate().map(|(i, d)| d * std[i % CHANNELS]).collect()
    }
}
