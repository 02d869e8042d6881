//! Whether a judge rests on legs: real motion with its own legs, with none, and with those of another motion.
//!
//! Motions with synthetic legs (a Kinect's) must be named as well with legs that a model could have given them; motions with recorded legs
//! must not be taken for an action that only a Kinect recorded.

use std::collections::BTreeSet;
use std::fmt;

use motionette_host::dataset::{ClipView, Dataset, Split};
use motionette_host::motion::Pose;
use motionette_host::parallel;
use serde::{Deserialize, Serialize};

use super::judge::Judge;
use super::{Error, legs, motion};
use crate::evaluate::codec::Codec;
use crate::evaluate::prompt::labelled;

/// Shares under several conditions.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Shares {
    /// Legs as the clip has them.
    pub own: f64,
    /// Without legs and contacts.
    pub hidden: f64,
    /// With legs and contacts of the recorded clip of the same split and another action whose root moves most like the clip's.
    pub exchanged: f64,
    /// The clip through a tokenizer and back, with the legs that the decoder gives to it; none without a tokenizer.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub decoded: Option<f64>,
    /// The same without legs and contacts: what is missing here is not missed because of legs.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub decoded_hidden: Option<f64>,
}

impl fmt::Display for Shares {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:.3} (legs hidden {:.3}, exchanged {:.3}", self.own, self.hidden, self.exchanged)?;
        for (condition, share) in [("decoded", self.decoded), ("decoded and hidden", self.decoded_hidden)] {
            share.map_or(Ok(()), |share| write!(f, ", {condition} {share:.3}"))?;
        }
        f.write_str(")")
    }
}

/// What became of the actions of one split.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Clips with synthetic legs.
    pub synthetic: usize,
    /// Share of them whose action is named right.
    pub right: Shares,
    /// Clips with recorded legs.
    pub recorded: usize,
    /// Share of them whose action is named right.
    pub recorded_right: Shares,
    /// Share of them named as an action that only clips with synthetic legs show.
    pub drawn: Shares,
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} clips with synthetic legs, action {}; ", self.synthetic, self.right)?;
        write!(f, "{} with recorded legs, action {}, ", self.recorded, self.recorded_right)?;
        write!(f, "taken for an action of the others {}", self.drawn)
    }
}

/// A clip and its normalised rows.
struct Shown<'d> {
    clip: ClipView<'d>,
    rows: Vec<f32>,
}

/// Who judges, and where other legs come from.
struct Bench<'a> {
    judge: &'a Judge,
    codec: Option<&'a Codec>,
    recorded: &'a [Shown<'a>],
}

/// Measures the labelled clips of a split; none where no clip, or every clip, has synthetic legs. With a tokenizer, through it as well.
///
/// # Errors
/// [`Error::Features`] when a clip has no features.
pub fn measure(judge: &Judge, dataset: &Dataset, split: Split, codec: Option<&Codec>) -> Result<Option<Report>, Error> {
    let clips = labelled(dataset, split);
    let shown = parallel::map(&clips, |(_, clip)| Ok(Shown { clip: *clip, rows: rows(judge, clip, clip.joints)? }));
    let shown = shown.into_iter().collect::<Result<Vec<_>, Error>>()?;
    let (synthetic, recorded): (Vec<_>, Vec<_>) = shown.into_iter().partition(|shown| shown.clip.info.synthetic_legs());
    if synthetic.is_empty() || recorded.is_empty() {
        return Ok(None);
    }
    let bench = Bench { judge, codec, recorded: &recorded };
    let elsewhere = actions(dataset, false);
    let only: BTreeSet<&str> = actions(dataset, true).difference(&elsewhere).copied().collect();
    let right = |clip: &ClipView<'_>, named: &str| clip.info.action() == Some(named);
    Ok(Some(Report {
        synthetic: synthetic.len(),
        right: bench.shares(&synthetic, &right)?,
        recorded: recorded.len(),
        recorded_right: bench.shares(&recorded, &right)?,
        drawn: bench.shares(&recorded, &|_, named| only.contains(named))?,
    }))
}

impl Bench<'_> {
    /// Shares of the clips for which `hit` holds of the action that is named.
    fn shares(&self, clips: &[Shown<'_>], hit: &dyn Fn(&ClipView<'_>, &str) -> bool) -> Result<Shares, Error> {
        let share = |rows: &[Vec<f32>]| {
            let judged = self.judge.rows(rows);
            let hits = clips.iter().zip(judged).filter(|(shown, judged)| hit(&shown.clip, judged.content)).count();
            hits as f64 / clips.len().max(1) as f64
        };
        let hidden = |rows: &[Vec<f32>]| {
            let mut rows = rows.to_vec();
            rows.iter_mut().for_each(|rows| legs::hide(rows));
            share(&rows)
        };
        let through = |codec: &Codec| {
            let decoded = parallel::map(clips, |Shown { clip, .. }| {
                rows(self.judge, clip, &codec.decode(&codec.encode(clip.features)))
            });
            decoded.into_iter().collect::<Result<Vec<_>, _>>()
        };
        let own: Vec<Vec<f32>> = clips.iter().map(|shown| shown.rows.clone()).collect();
        let decoded = self.codec.map(through).transpose()?;
        Ok(Shares {
            own: share(&own),
            hidden: hidden(&own),
            exchanged: share(&clips.iter().map(|shown| self.exchanged(shown)).collect::<Vec<_>>()),
            decoded: decoded.as_deref().map(share),
            decoded_hidden: decoded.as_deref().map(hidden),
        })
    }

    /// Rows with the legs of another action; its own where there is none.
    fn exchanged(&self, shown: &Shown<'_>) -> Vec<f32> {
        let others = self.recorded.iter().filter(|other| other.clip.info.action() != shown.clip.info.action());
        let mut rows = shown.rows.clone();
        let donor = legs::nearest(&shown.rows, others.map(|other| other.rows.as_slice()));
        legs::replace(&mut rows, donor.unwrap_or_default());
        rows
    }
}

/// Normalised rows of a clip's motion, or of one made from it.
fn rows(judge: &Judge, clip: &ClipView<'_>, joints: &[Pose]) -> Result<Vec<f32>, Error> {
    let prepared =
        motion::prepare(joints).map_err(|source| Error::Features { name: format!("clip {}", clip.info.id), source })?;
    Ok(judge.normalised(&prepared))
}

/// Actions of the clips with synthetic, or with recorded legs.
fn actions(dataset: &Dataset, synthetic: bool) -> BTreeSet<&str> {
    let clips = dataset.clips.iter().filter(|clip| clip.synthetic_legs() == synthetic);
    clips.filter_map(|clip| clip.action()).collect()
}
