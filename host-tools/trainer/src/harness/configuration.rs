//! What a training says about its configuration, and about what is stored of its runs.

use std::fmt::{Debug, Display};

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::{Curves, Error};
use crate::chart::Panel;
use crate::setting::OutOfRange;
use crate::tensor_file::{Format, TensorFile};
use crate::{optimizer, schedule};

/// Everything that decides a run beside its sources. Two runs with equal configuration, sources and version give equal weights.
///
/// It has a field `seed`, which `--seed` sets.
pub trait Configuration: Clone + Debug + PartialEq + Serialize + DeserializeOwned {
    /// Format of the state file.
    const STATE: Format;
    /// What a run belongs to.
    type Sources: Sources;
    /// What a run keeps beside its parameters; `()` for nothing.
    type Extra: Extra<Self>;
    /// A point of the curves: means over the steps since the point before.
    type Point: Figures;
    /// Figures of the averaged weights on clips that were not trained on.
    type Evaluation: Figures;

    /// Checks the training's own settings; schedule and optimiser are checked by [`Self::checked`].
    ///
    /// # Errors
    /// [`OutOfRange`] with the setting, its value and what is allowed.
    fn check(&self) -> Result<(), OutOfRange>;

    /// Course of the learning rate.
    fn schedule(&self) -> schedule::Settings;

    /// Settings of the optimiser.
    fn optimizer(&self) -> optimizer::Settings;

    /// The diagrams of a run, one below the other. Without any, no curves are written beside the checkpoint.
    fn panels(curves: &Curves<Self::Point, Self::Evaluation>) -> Vec<Panel>;

    /// The configuration, once all settings are in range.
    ///
    /// # Errors
    /// [`OutOfRange`] with the first one that is not.
    fn checked(self) -> Result<Self, OutOfRange> {
        self.check()?;
        self.schedule().check()?;
        self.optimizer().check()?;
        Ok(self)
    }
}

/// Figures at one step of a run: a point of the curves or an evaluation. Displayed as text for people.
pub trait Figures: Clone + Debug + PartialEq + Serialize + DeserializeOwned + Display {
    /// Steps done.
    fn step(&self) -> u64;
}

/// What a run belongs to: its dataset, and networks that it builds on. A run goes on only where they are the same.
pub trait Sources: Clone + Debug + PartialEq + Serialize + DeserializeOwned {
    /// Whether they are stored as one entry `sources`; otherwise each is an entry of its own among those of the run.
    const NESTED: bool = true;

    /// What differs from `other`, in a word for people.
    fn difference(&self, other: &Self) -> Option<&'static str>;
}

/// The sources of a training that needs nothing but a dataset.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct DatasetHash {
    /// Hash of the dataset.
    pub data_hash: String,
}

impl Sources for DatasetHash {
    const NESTED: bool = false;

    fn difference(&self, other: &Self) -> Option<&'static str> {
        (self != other).then_some("dataset")
    }
}

/// What a run keeps in its state beside parameters and moments, a codebook for instance.
pub trait Extra<C>: Clone + Debug + PartialEq {
    /// Puts it into the state file: entries among those of the run, and tensors.
    fn store(&self, run: &mut Map<String, Value>, file: &mut TensorFile);

    /// Takes what [`Self::store`] put there.
    ///
    /// # Errors
    /// [`Error::File`] naming the entry or tensor that is missing or does not fit.
    fn restore(config: &C, file: &TensorFile) -> Result<Self, Error>;
}

impl<C> Extra<C> for () {
    fn store(&self, _run: &mut Map<String, Value>, _file: &mut TensorFile) {}

    fn restore(_config: &C, _file: &TensorFile) -> Result<Self, Error> {
        Ok(())
    }
}
