//! What is in a dataset of several packs, by subset, by quality and by action.

use std::collections::{BTreeMap, BTreeSet};

use serde::Serialize;

use super::super::actions::Actions;
use crate::dataset::{Clip, Facts, Quality, Split};
use crate::metrics;
use crate::motion::FEATURES;
use crate::motion::FPS;
use crate::motion::features::{CONTACTS, Processed};

/// Figures of a subset, of a quality, of all.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Row {
    /// Name of the subset; or what the row is about.
    pub name: String,
    /// How it was recorded, with commas where more than one way.
    pub quality: String,
    /// Terms of the source; empty for rows over several.
    pub licence: String,
    /// Whether a model card can state them.
    pub card: bool,
    /// Clips.
    pub clips: usize,
    /// Clips by split.
    pub train: usize,
    /// Clips by split.
    pub val: usize,
    /// Clips by split.
    pub test: usize,
    /// Clips of val and test whose actor is, or may be, in the training split.
    pub known_actor: usize,
    /// Length of all clips, hours.
    pub hours: f64,
    /// Share of frames in which a foot skates ([`metrics::foot_skating`]).
    pub skating: f64,
    /// Mean jerk, m/s^3 ([`metrics::jerk`]).
    pub jerk: f64,
    /// Mean of the four contact channels.
    pub contact: f64,
    /// Clips that were left out.
    pub clips_dropped: usize,
    /// Frames that were left out, those of clips left out counted.
    pub frames_dropped: usize,
}

/// Clips of an action.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct ActionRow {
    /// Canonical name.
    pub name: String,
    /// Clips by split.
    pub train: usize,
    /// Clips by split.
    pub val: usize,
    /// Clips by split.
    pub test: usize,
    /// Whether it has enough training clips to be judged.
    pub scored: bool,
    /// Whether all its training clips are of Kinect quality: its legs were never measured.
    pub kinect_only: bool,
}

/// A clip that was cut.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Cut {
    /// Its name.
    pub id: String,
    /// First frame of the recording that is kept.
    pub from: usize,
    /// Frame after the last that is kept.
    pub to: usize,
    /// Frames of the recording.
    pub frames: usize,
}

/// Figures of a dataset.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// By subset; then by quality, of actions that only a Kinect recorded, and of all.
    pub rows: Vec<Row>,
    /// By action, in the order of the table.
    pub actions: Vec<ActionRow>,
    /// Clips of which a part was left out because a joint is too fast.
    pub cut: Vec<Cut>,
}

/// What was left out, by subset.
#[derive(Debug, Default)]
pub(super) struct Losses(BTreeMap<String, (usize, usize)>);

impl Losses {
    /// Counts a clip that is left out.
    pub fn drop_clip(&mut self, subset: &str, frames: usize) {
        self.cut(subset, frames);
        self.0.entry(subset.to_owned()).or_default().0 += 1;
    }

    /// Counts frames that are cut off.
    pub fn cut(&mut self, subset: &str, frames: usize) {
        self.0.entry(subset.to_owned()).or_default().1 += frames;
    }
}

/// Figures of one clip.
struct Measured {
    subset: String,
    split: Split,
    facts: Facts,
    frames: usize,
    skating: f64,
    jerk: f64,
    contact: f64,
}

/// Puts a report together clip by clip.
pub(super) struct Maker<'a> {
    table: &'a Actions,
    losses: Losses,
    clips: Vec<Measured>,
    cut: Vec<Cut>,
}

impl<'a> Maker<'a> {
    pub fn new(table: &'a Actions, losses: Losses) -> Self {
        Self { table, losses, clips: Vec::new(), cut: Vec::new() }
    }

    /// Measures a clip that has facts.
    pub fn add(&mut self, clip: &Clip, motion: &Processed, cut: Option<Cut>) {
        self.cut.extend(cut);
        let Some(facts) = clip.facts.clone() else { return };
        let frames = motion.joints.len();
        let contacts = motion.features.chunks_exact(FEATURES).flat_map(|row| &row[CONTACTS]).map(|x| f64::from(*x));
        self.clips.push(Measured {
            subset: clip.subset.clone(),
            split: clip.split,
            facts,
            frames,
            skating: metrics::foot_skating(&motion.joints, 0.0),
            jerk: metrics::jerk(&motion.joints, FPS),
            contact: contacts.sum::<f64>() / (CONTACTS.len() * frames.max(1)) as f64,
        });
    }

    pub fn finish(self) -> Report {
        let actions: Vec<ActionRow> = self.table.actions.iter().map(|action| self.action(&action.name)).collect();
        let subsets: BTreeSet<&str> = self
            .clips
            .iter()
            .map(|clip| clip.subset.as_str())
            .chain(self.losses.0.keys().map(String::as_str))
            .collect();
        let mut rows: Vec<Row> = subsets
            .into_iter()
            .map(|name| {
                let source = self.table.subsets.get(name);
                let (clips_dropped, frames_dropped) = self.losses.0.get(name).copied().unwrap_or_default();
                Row {
                    licence: source.map(|s| s.licence.clone()).unwrap_or_default(),
                    card: source.is_some_and(|s| s.card),
                    clips_dropped,
                    frames_dropped,
                    ..self.row(name, |clip| clip.subset == name)
                }
            })
            .collect();
        for quality in [Quality::Optical, Quality::Kinect, Quality::Retargeted] {
            rows.push(self.row(&format!("{quality}, all"), |clip| clip.facts.quality == quality));
        }
        let kinect: BTreeSet<&str> = actions.iter().filter(|a| a.kinect_only).map(|a| a.name.as_str()).collect();
        rows.push(self.row("kinect-only actions", |clip| kinect.contains(clip.facts.action.as_str())));
        rows.push(self.row("all", |_| true));
        rows.retain(|row| row.clips + row.clips_dropped > 0);
        Report { rows, actions, cut: self.cut }
    }

    fn action(&self, name: &str) -> ActionRow {
        let own = || self.clips.iter().filter(|clip| clip.facts.action == name);
        let count = |split: Split| own().filter(|clip| clip.split == split).count();
        let mut train = own().filter(|clip| clip.split == Split::Train).peekable();
        ActionRow {
            name: name.to_owned(),
            train: count(Split::Train),
            val: count(Split::Val),
            test: count(Split::Test),
            scored: own().any(|clip| clip.facts.scored),
            kinect_only: train.peek().is_some() && train.all(|clip| clip.facts.quality == Quality::Kinect),
        }
    }

    /// Means are over frames.
    fn row(&self, name: &str, belongs: impl Fn(&Measured) -> bool) -> Row {
        let own: Vec<&Measured> = self.clips.iter().filter(|clip| belongs(clip)).collect();
        let frames: usize = own.iter().map(|clip| clip.frames).sum();
        let mean = |value: fn(&Measured) -> f64| {
            own.iter().map(|clip| value(clip) * clip.frames as f64).sum::<f64>() / frames.max(1) as f64
        };
        let count = |split: Split| own.iter().filter(|clip| clip.split == split).count();
        let qualities: BTreeSet<Quality> = own.iter().map(|clip| clip.facts.quality).collect();
        Row {
            name: name.to_owned(),
            quality: qualities.iter().map(Quality::to_string).collect::<Vec<_>>().join(","),
            licence: String::new(),
            card: own.iter().all(|clip| self.table.subsets.get(&clip.subset).is_some_and(|s| s.card)),
            clips: own.len(),
            train: count(Split::Train),
            val: count(Split::Val),
            test: count(Split::Test),
            known_actor: own.iter().filter(|clip| clip.split != Split::Train && clip.facts.known_actor).count(),
            hours: frames as f64 / FPS / 3600.0,
            skating: mean(|clip| clip.skating),
            jerk: mean(|clip| clip.jerk),
            contact: mean(|clip| clip.contact),
            clips_dropped: 0,
            frames_dropped: 0,
        }
    }
}
