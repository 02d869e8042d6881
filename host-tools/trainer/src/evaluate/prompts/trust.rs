//! Which actions the evaluator may judge: those that it names right on real test clips.

use std::collections::BTreeMap;

use motionette_host::dataset::{Dataset, Split};
use motionette_host::import::actions::Actions;
use motionette_host::parallel;

use crate::evaluate::prompt::labelled;
use crate::evaluator::judge::Judge;
use crate::evaluator::{Error, motion};

/// Share of an action's real test clips that the evaluator must name right to judge it.
pub const LEAST_ACCURACY: f64 = 0.9;

/// How an evaluator fares on the real test clips of one action.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Accuracy {
    /// Whether the evaluator can name the action itself, not only one that is accepted for it.
    pub named: bool,
    /// Clips.
    pub clips: usize,
    /// Those for which it names the action, or one that the table of actions accepts for it.
    pub right: usize,
}

impl Accuracy {
    /// Share of the clips; 0 without clips.
    pub fn share(self) -> f64 {
        self.right as f64 / self.clips.max(1) as f64
    }

    /// Whether the evaluator may judge the action.
    pub fn trusted(self) -> bool {
        self.named && self.clips > 0 && self.share() >= LEAST_ACCURACY
    }
}

/// The accuracy on every action that has scored clips in the test split.
///
/// # Errors
/// [`Error::Features`] naming the clip that cannot be judged.
pub fn accuracies(judge: &Judge, dataset: &Dataset, table: &Actions) -> Result<BTreeMap<String, Accuracy>, Error> {
    let clips = labelled(dataset, Split::Test);
    let prepared = parallel::map(&clips, |(_, clip)| {
        motion::prepare(clip.joints)
            .map_err(|source| Error::Features { name: format!("clip {}", clip.info.id), source })
    });
    let prepared = prepared.into_iter().collect::<Result<Vec<_>, _>>()?;
    let mut accuracies: BTreeMap<String, Accuracy> = BTreeMap::new();
    for ((_, clip), judgement) in clips.iter().zip(judge.motions(&prepared.iter().collect::<Vec<_>>())) {
        let action = clip.info.action().unwrap_or_default();
        let accepted = table.find(action).map(|action| action.accept.as_slice()).unwrap_or_default();
        let entry = accuracies.entry(action.to_owned()).or_default();
        entry.named = judge.labels().contents.iter().any(|name| name == action);
        entry.clips += 1;
        entry.right +=
            usize::from(judgement.content == action || accepted.iter().any(|name| name == judgement.content));
    }
    Ok(accuracies)
}
