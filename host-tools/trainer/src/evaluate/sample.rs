//! The motions of one row of a table as the judge sees them.

use motionette_host::motion::features::Processed;
use motionette_host::{metrics, parallel};
use serde::{Deserialize, Serialize};

use super::prompt::{Motion, Prompt};
use super::{Error, copies};
use crate::evaluator::judge::Judge;
use crate::evaluator::motion;

/// What became of a motion's anchors, and of the motion for their sake.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Controlled {
    /// Distance from each of those that some motion may meet, centimetres.
    pub errors_cm: Vec<f64>,
    /// Those that no motion meets within the speed that may be added, by the reference's pairs.
    pub unreachable: usize,
    /// Of them those that were loosened, because they ask for too much speed.
    pub loosened: usize,
    /// Mean magnitude of the jerk over all joints, m/s^3.
    pub jerk: f64,
    /// The same of the frames around anchors.
    pub jerk_at_anchors: f64,
    /// Mean horizontal speed of feet near the ground, m/s.
    pub foot_speed: f64,
    /// Speed of the fastest joint, m/s.
    pub speed: f64,
    /// How far the bone that is farthest from its length is from it, millimetres.
    pub bone_mm: f64,
    /// How far refinement moved the token embeddings, `||u - u0||`.
    pub distance: f64,
    /// Decoder evaluations of the refinement.
    pub evaluations: f64,
    /// How far the edit took the motion from what was generated; 0 without one.
    pub strain: f64,
}

impl Controlled {
    /// Number of its anchors.
    pub fn anchors(&self) -> usize {
        self.errors_cm.len() + self.unreachable
    }
}

/// One motion, judged.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Judged {
    /// Unit vector.
    pub embedding: Vec<f64>,
    /// Action the judge names.
    pub content: String,
    /// Style the judge names.
    pub style: String,
    /// Share of frames in which a foot skates.
    pub foot_skating: f64,
    /// Whether its tokens are nearly those of a training sequence.
    pub near_copy: bool,
    /// What became of its anchors, where it had some.
    pub controlled: Option<Controlled>,
}

/// The motions of one row: one for every seed and prompt.
#[derive(Clone, Debug, PartialEq)]
pub struct Sample {
    /// Name of the row.
    pub name: String,
    /// `[seed][prompt]`; one seed for a row that knows no chance.
    pub motions: Vec<Vec<Judged>>,
    /// `[prompt]` which prompt the motion is held against: its own, but for the control.
    pub against: Vec<usize>,
    /// Embeddings that stand for the row in the Fréchet distance, `[seed][prompt]`, where they are not those of `motions`.
    pub independent: Option<Vec<Vec<Vec<f64>>>>,
}

impl Sample {
    /// A row whose motions are held against their own prompts.
    pub fn new(name: &str, motions: Vec<Vec<Judged>>) -> Self {
        let prompts = motions.first().map_or(0, Vec::len);
        Self { name: name.to_owned(), motions, against: (0..prompts).collect(), independent: None }
    }

    /// The same motions held against other prompts: no two motions against one prompt.
    pub fn shuffled(&self, name: &str, against: Vec<usize>) -> Self {
        Self { name: name.to_owned(), against, ..self.clone() }
    }

    /// Embedding that stands for prompt `index` in the Fréchet distance.
    pub fn standing(&self, seed: usize, index: usize) -> &[f64] {
        match &self.independent {
            Some(sets) => &sets[seed % sets.len()][index],
            None => &self.motions[seed % self.motions.len()][index].embedding,
        }
    }

    /// Seeds of the Fréchet distance.
    pub fn seeds(&self) -> usize {
        self.independent.as_ref().map_or(self.motions.len(), Vec::len)
    }
}

/// Judges motions; `training` holds the token sequences that copies are looked for in.
///
/// # Errors
/// [`Error::Judge`] naming the prompt whose motion has no features.
pub fn judged(
    judge: &Judge,
    prompts: &[Prompt],
    motions: &[Motion],
    training: &[Vec<u16>],
) -> Result<Vec<Judged>, Error> {
    let pairs: Vec<(&Prompt, &Motion)> = prompts.iter().zip(motions).collect();
    let prepared = parallel::map(&pairs, |(prompt, motion)| {
        let prepared = motion::prepare(&motion.joints).map_err(|source| {
            let name = format!("the motion for {:?}", prompt.caption);
            crate::evaluator::Error::Features { name, source }
        })?;
        let skating = metrics::foot_skating(&prepared.joints, 0.0);
        Ok::<_, Error>((prepared, skating, copies::is_near_copy(&motion.tokens, training)))
    });
    let prepared: Vec<(Processed, f64, bool)> = prepared.into_iter().collect::<Result<_, _>>()?;
    let judgements = judge.motions(&prepared.iter().map(|(processed, ..)| processed).collect::<Vec<_>>());
    let judged =
        |(judgement, (_, skating, near_copy)): (crate::evaluator::judge::Judgement<'_>, &(Processed, f64, bool))| {
            Judged {
                embedding: judgement.embedding,
                content: judgement.content.to_owned(),
                style: judgement.style.to_owned(),
                foot_skating: *skating,
                near_copy: *near_copy,
                controlled: None,
            }
        };
    Ok(judgements.into_iter().zip(&prepared).map(judged).collect())
}
