//! What a run begins with, and the codebook in its state.

use serde::Deserialize;
use serde_json::{Map, Value, json};

use super::checkpoint::Checkpoint;
use super::config::Config;
use super::model;
use super::quantizer::Codebook;
use crate::harness::configuration::DatasetHash;
use crate::harness::{self, Error, Extra};
use crate::setting::{OutOfRange, require};
use crate::tensor_file::TensorFile;

/// A run between two steps; beside the parameters it keeps the codebook, once quantisation has begun.
pub type State = harness::State<Config>;

impl State {
    /// A run that has not begun.
    pub fn begin(config: &Config, data_hash: &str) -> Self {
        let parameters = model::initial_parameters(&model::shapes(&config.architecture), config.seed);
        Self::new(config.clone(), DatasetHash { data_hash: data_hash.to_owned() }, parameters, None)
    }
}

impl State {
    /// A run that begins with the weights and codes of a checkpoint.
    ///
    /// # Errors
    /// [`OutOfRange`] when the checkpoint has other sizes.
    pub fn after(config: &Config, data_hash: &str, checkpoint: &Checkpoint) -> Result<Self, OutOfRange> {
        let (own, other) = (&config.architecture, &checkpoint.config.architecture);
        require(
            own == other,
            "architecture",
            format!("{own:?}"),
            "the sizes of the checkpoint that the run begins with",
        )?;
        let rows = &checkpoint.codebook;
        // As if every code had been met once, where it is.
        let book = Codebook::from_parts(rows.clone(), vec![1.0; own.codes], rows.clone(), own.code_dim);
        let sources = DatasetHash { data_hash: data_hash.to_owned() };
        Ok(Self::new(config.clone(), sources, checkpoint.parameters.clone(), Some(book)))
    }
}

/// Entry of the run that says whether there is a codebook.
#[derive(Deserialize)]
struct Quantized {
    quantized: bool,
}

impl Extra<Config> for Option<Codebook> {
    fn store(&self, run: &mut Map<String, Value>, file: &mut TensorFile) {
        run.insert("quantized".to_owned(), json!(self.is_some()));
        if let Some(book) = self {
            let shape = [book.codes(), book.dim()];
            file.insert("codebook.rows", &shape, book.rows.clone());
            file.insert("codebook.sums", &shape, book.sums.clone());
            file.insert("codebook.counts", &shape[..1], book.counts.clone());
        }
    }

    fn restore(config: &Config, file: &TensorFile) -> Result<Self, Error> {
        if !file.parsed::<Quantized>("run")?.quantized {
            return Ok(None);
        }
        let shape = [config.architecture.codes, config.architecture.code_dim];
        let rows = file.values("codebook.rows", &shape)?.to_vec();
        let sums = file.values("codebook.sums", &shape)?.to_vec();
        let counts = file.values("codebook.counts", &shape[..1])?.to_vec();
        Ok(Some(Codebook::from_parts(rows, counts, sums, shape[1])))
    }
}
