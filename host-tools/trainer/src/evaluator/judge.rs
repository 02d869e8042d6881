//! The finished evaluator: what it says about motions and sentences, and its file.
//!
//! The file is a safetensors file; convolutions are `[kernel][in][out]`, biases `[out]`, `mean` and `std` `[263]`. `__metadata__` has
//! `format`, `version`, `config` (JSON: labels, vocabulary, steps, data hash, metrics) and `training` (JSON: the whole [`Config`]).

use std::path::Path;

use burn::tensor::{Device, Tensor};
use motionette_host::motion::Pose;
use motionette_host::motion::features::Processed;
use serde_json::{Value, json};

use super::Error;
use super::config::Config;
use super::corpus::{self, Labels, Padded};
use super::model::{self, Network};
use super::motion;
use crate::convolution::{self, Order, Shape};
use crate::harness::{self, Configuration};
use crate::normalization::Normalization;
use crate::prior::captions::Vocabulary;
use crate::tensor_file::Format;

/// Format of the file.
pub const FORMAT: Format = Format { name: "motionette-evaluator", version: "1" };
/// Motions or sentences that are embedded at once.
const BATCH: usize = 32;

/// What the evaluator says about a motion.
#[derive(Clone, Debug, PartialEq)]
pub struct Judgement<'a> {
    /// `[embedding]`, unit length.
    pub embedding: Vec<f64>,
    /// Most likely content; empty when the evaluator knows none.
    pub content: &'a str,
    /// Most likely style; empty when the evaluator knows none.
    pub style: &'a str,
}

/// An evaluator that can judge.
pub struct Judge {
    config: Config,
    labels: Labels,
    normalization: Normalization,
    parameters: Vec<f32>,
    steps: u64,
    data_hash: String,
    shapes: Vec<Shape>,
    network: Network,
    device: Device,
}

impl Judge {
    /// Puts an evaluator together; `parameters` in the order of [`model::shapes`].
    pub(super) fn new(
        config: Config,
        labels: Labels,
        normalization: Normalization,
        parameters: Vec<f32>,
        steps: u64,
        data_hash: String,
    ) -> Self {
        let device = Device::flex();
        let shapes = model::shapes(&config, &labels);
        let network = Network::new(&shapes, &parameters, false, &device);
        Self { config, labels, normalization, parameters, steps, data_hash, shapes, network, device }
    }

    /// What the heads can name, and the words that are known.
    pub fn labels(&self) -> &Labels {
        &self.labels
    }

    /// Steps of training.
    pub fn steps(&self) -> u64 {
        self.steps
    }

    /// Judges motions that [`motion::prepare`] gave.
    pub fn motions(&self, motions: &[&Processed]) -> Vec<Judgement<'_>> {
        self.rows(&motions.iter().map(|motion| self.normalised(motion)).collect::<Vec<_>>())
    }

    /// Normalised rows `[T][263]` of a motion.
    pub(super) fn normalised(&self, motion: &Processed) -> Vec<f32> {
        self.normalization.apply(&motion.features)
    }

    /// Judges motions from their normalised rows `[T][263]`.
    pub(super) fn rows(&self, motions: &[Vec<f32>]) -> Vec<Judgement<'_>> {
        let mut judgements = Vec::with_capacity(motions.len());
        for part in motions.chunks(BATCH) {
            let Padded { features, lengths } = corpus::padded(part);
            let output = self.network.motion(features, &lengths, None, &self.device);
            let contents = best(output.content, &self.labels.contents);
            let styles = best(output.style, &self.labels.styles);
            let rows = rows(output.embedding).into_iter().zip(contents).zip(styles);
            judgements.extend(rows.map(|((embedding, content), style)| Judgement { embedding, content, style }));
        }
        judgements
    }

    /// Judges one motion, frames of joints as they are.
    ///
    /// # Errors
    /// [`Error::Features`] when it has no features.
    pub fn motion(&self, joints: &[Pose]) -> Result<Judgement<'_>, Error> {
        let prepared =
            motion::prepare(joints).map_err(|source| Error::Features { name: "the motion".into(), source })?;
        Ok(self.motions(&[&prepared]).remove(0))
    }

    /// Embeddings of sentences, `[embedding]` each, unit length.
    pub fn texts(&self, sentences: &[&str]) -> Vec<Vec<f64>> {
        let numbers = |sentence: &&str| corpus::encoded(&self.labels.vocabulary, sentence, self.config.max_words);
        let batches = sentences.chunks(BATCH);
        batches
            .flat_map(|part| {
                let numbers: Vec<Vec<usize>> = part.iter().map(numbers).collect();
                rows(self.network.text(&numbers, None, &self.device))
            })
            .collect()
    }

    /// Writes the file whole or not at all, with `metrics` inside.
    ///
    /// # Errors
    /// [`harness::Error::File`].
    pub fn save(&self, path: &Path, metrics: &Value) -> Result<(), harness::Error> {
        let config = json!({
            "contents": self.labels.contents,
            "styles": self.labels.styles,
            "vocabulary": self.labels.vocabulary.words,
            "steps": self.steps,
            "data_hash": self.data_hash,
            "metrics": metrics,
        });
        let mut file = FORMAT.file();
        file.describe("config", config.to_string());
        file.describe("training", json!(self.config).to_string());
        convolution::store(&self.shapes, &self.parameters, Order::InputsFirst, &mut file);
        self.normalization.store(&mut file);
        Ok(file.save(path)?)
    }

    /// Reads a file that [`Self::save`] wrote.
    ///
    /// # Errors
    /// [`harness::Error::File`] naming the entry or tensor that is missing or does not fit, [`harness::Error::Setting`] for a
    /// configuration out of range.
    pub fn load(path: &Path) -> Result<Self, harness::Error> {
        let file = FORMAT.load(path)?;
        let config = file.parsed::<Config>("training")?.checked()?;
        let facts: Facts = file.parsed("config")?;
        let vocabulary = Vocabulary::new(facts.vocabulary);
        let labels = Labels { vocabulary, contents: facts.contents, styles: facts.styles };
        let parameters = convolution::restore(&model::shapes(&config, &labels), Order::InputsFirst, &file)?;
        let normalization = Normalization::restored(&file)?;
        Ok(Self::new(config, labels, normalization, parameters, facts.steps, facts.data_hash))
    }
}

/// The entries of `config` that are needed again.
#[derive(serde::Deserialize)]
struct Facts {
    contents: Vec<String>,
    styles: Vec<String>,
    vocabulary: Vec<String>,
    steps: u64,
    data_hash: String,
}

fn rows(tensor: Tensor<2>) -> Vec<Vec<f64>> {
    let columns = tensor.dims()[1].max(1);
    let values = tensor.into_data().try_into_vec::<f32>().expect("networks compute in f32");
    values.chunks_exact(columns).map(|row| row.iter().map(|x| f64::from(*x)).collect()).collect()
}

/// The name of the largest logit of every row, the first of equal ones.
fn best(logits: Tensor<2>, names: &[String]) -> Vec<&str> {
    let largest = |row: Vec<f64>| (0..row.len()).fold(0, |best, i| if row[i] > row[best] { i } else { best });
    rows(logits).into_iter().map(|row| names.get(largest(row)).map_or("", String::as_str)).collect()
}
