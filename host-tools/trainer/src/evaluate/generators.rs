//! Motion from text: by the plain-loop reference in f32, and by the quantised runtime.
//!
//! Both draw the same random numbers for the same prompt and seed.

use std::path::Path;

use anyhow::{Context, Result, ensure};
use motionette::generation::tokens::{Planning, Sampling, Schedule};
use motionette::{Length, Request};
use motionette_host::blob::BlobFile;
use motionette_host::checkpoint::{self, file_hash, prior};
use motionette_host::motion::Pose;
use motionette_host::reference::{DecodePath, Prior, Quantizer, tmd};
use motionette_host::verify;
use serde_json::{Value, json};

use super::prior::Generate;
use super::prompt::{Motion, Prompt};

/// How motions are sampled.
#[derive(clap::Args, Clone, Copy, Debug)]
pub struct Options {
    /// Steps of the sampler.
    #[arg(long, default_value_t = Planning::DEFAULT.steps, value_parser = clap::value_parser!(u16).range(1..=1000))]
    pub steps: u16,
    /// Times of the steps.
    #[arg(long, value_enum, default_value_t = Times::Uniform)]
    pub schedule: Times,
    /// Classifier-free guidance; 1 is off.
    #[arg(long, default_value_t = Planning::DEFAULT.guidance)]
    pub guidance: f32,
    /// How proposals are drawn.
    #[arg(long, value_enum, default_value_t = Proposal::Sample)]
    pub proposal: Proposal,
    /// Temperature of sampled proposals.
    #[arg(long, default_value_t = 1.0)]
    pub temperature: f32,
    /// Only so many of the most probable tokens; 0 = all.
    #[arg(long, default_value_t = 0)]
    pub top_k: u16,
    /// Only the most probable tokens with this share of the mass.
    #[arg(long, default_value_t = 1.0)]
    pub top_p: f32,
}

/// Times of the steps.
#[derive(clap::ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Times {
    /// Even.
    Uniform,
    /// Small steps first.
    Cosine,
}

/// How proposals are drawn.
#[derive(clap::ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Proposal {
    /// The most probable token.
    Greedy,
    /// From the distribution.
    Sample,
    /// The largest logit with Gumbel noise.
    Gumbel,
}

impl Options {
    /// For the runtime.
    pub fn planning(self, prompt: &Prompt, seed: u64) -> Planning<'static> {
        let Self { temperature, top_k, top_p, .. } = self;
        Planning {
            length: Length::Tokens(prompt.tokens as u16),
            seed: drawn_seed(prompt, seed),
            steps: self.steps,
            schedule: match self.schedule {
                Times::Uniform => Schedule::Uniform,
                Times::Cosine => Schedule::Cosine,
            },
            guidance: self.guidance,
            sampling: match self.proposal {
                Proposal::Greedy => Sampling::Greedy,
                Proposal::Sample => Sampling::Sample { temperature, top_k, top_p },
                Proposal::Gumbel => Sampling::Gumbel { temperature },
            },
            ..Planning::DEFAULT
        }
    }

    /// For the reference.
    pub fn settings(self, prompt: &Prompt, seed: u64) -> tmd::Settings {
        let Self { temperature, top_k, top_p, .. } = self;
        tmd::Settings {
            seed: drawn_seed(prompt, seed),
            steps: usize::from(self.steps),
            schedule: match self.schedule {
                Times::Uniform => tmd::Schedule::Uniform,
                Times::Cosine => tmd::Schedule::Cosine,
            },
            sampling: match self.proposal {
                Proposal::Greedy => tmd::Sampling::Greedy,
                Proposal::Sample => tmd::Sampling::Sample { temperature, top_k, top_p },
                Proposal::Gumbel => tmd::Sampling::Gumbel { temperature },
            },
            fixed: Vec::new(),
        }
    }

    /// For the record of a table.
    pub fn facts(&self) -> Value {
        json!({
            "steps": self.steps,
            "schedule": format!("{:?}", self.schedule).to_lowercase(),
            "guidance": self.guidance,
            "proposal": format!("{:?}", self.proposal).to_lowercase(),
            "temperature": self.temperature,
            "top_k": self.top_k,
            "top_p": self.top_p,
        })
    }

    /// The flags that are not at their default, as they are written.
    pub fn flags(&self) -> String {
        let name = |value: &dyn std::fmt::Debug| format!("{value:?}").to_lowercase();
        let mut flags = String::new();
        let mut flag = |differs: bool, text: String| {
            if differs {
                flags += &text;
            }
        };
        flag(self.steps != Planning::DEFAULT.steps, format!(" --steps {}", self.steps));
        flag(self.schedule != Times::Uniform, format!(" --schedule {}", name(&self.schedule)));
        flag(self.guidance != Planning::DEFAULT.guidance, format!(" --guidance {}", self.guidance));
        flag(self.proposal != Proposal::Sample, format!(" --proposal {}", name(&self.proposal)));
        flag(self.temperature != 1.0, format!(" --temperature {}", self.temperature));
        flag(self.top_k != 0, format!(" --top-k {}", self.top_k));
        flag(self.top_p != 1.0, format!(" --top-p {}", self.top_p));
        flags
    }
}

/// Every prompt draws its own numbers.
fn drawn_seed(prompt: &Prompt, seed: u64) -> u64 {
    (seed << 32) | prompt.clip as u64
}

/// The f32 reference of a prior's and its tokenizer's checkpoint.
///
/// # Errors
/// Files that cannot be used or do not belong together; later, prompts without a known word.
pub fn reference(prior: &Path, tokenizer: &Path, options: Options) -> Result<Box<Generate<'static>>> {
    let tokenizer = checkpoint::load(tokenizer)?;
    let prior = prior::load(prior)?;
    prior.check_tokenizer(&tokenizer).context("the prior was trained with another tokenizer")?;
    let planner = Prior::<f32>::new(&prior, &tokenizer);
    let quantizer = Quantizer::<f32>::new(&tokenizer.codebooks, tokenizer.config.code_dim);
    let decode_path = DecodePath::<f32>::new(&tokenizer)?;
    Ok(Box::new(move |prompt, seed| {
        let words = planner.text.read(&prompt.caption)?;
        let tokens = planner.generate(&words.ids, options.guidance, prompt.tokens, &options.settings(prompt, seed));
        let ids: Vec<i64> = tokens.iter().map(|token| i64::from(*token)).collect();
        let joints: Vec<Pose> = decode_path.forward(&quantizer.decode(&ids)?).joints;
        Ok(Motion { joints, tokens })
    }))
}

/// The quantised runtime on a blob made of these checkpoints.
///
/// # Errors
/// A blob that cannot be used or was made of others; later, what the runtime refuses.
pub fn runtime(blob: &Path, checkpoints: &[&Path], options: Options) -> Result<Box<Generate<'static>>> {
    let path = blob.display().to_string();
    let blob = BlobFile::open(blob)?;
    for checkpoint in checkpoints {
        let named = verify::names_checkpoint(&blob, &file_hash(checkpoint)?)?;
        ensure!(named, "{path} was not made of {}; make it anew with motionette convert", checkpoint.display());
    }
    Ok(Box::new(move |prompt, seed| {
        let request = Request::text(&prompt.caption).planned(options.planning(prompt, seed));
        let motion = verify::run(&blob, &prompt.caption, &request)?;
        Ok(Motion { joints: motion.joints, tokens: motion.tokens })
    }))
}
