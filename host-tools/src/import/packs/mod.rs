//! Several motion-capture packs into one dataset: one taxonomy, one body, no broken frames, a validation split, and who moved.
//!
//! In order, for every clip of every pack:
//! 1. **Subset**: a name that more than one pack uses gets the pack's number (`cmu` of the first two packs: `cmu1`, `cmu2`). Clips of
//!    withdrawn subsets are left out.
//! 2. **Broken frames**: see [`longest_slow_run`].
//! 3. **Action and side**: what the raw label (`labels.content`, else `action`, else `cmu_description`) means in the table of actions.
//! 4. **Validation split**: training clips of the subset's `val_actor`; in subsets that name none and come without validation clips,
//!    [`VAL_SHARE`] of the takes, in the order of a hash of their names, without those that would leave an action of theirs with
//!    fewer than [`LEAST_SCORED`] training clips of the subset. A take is a trial of CMU, else a clip with its windows (`_w0`, `_w1`, ...).
//!    So the split of a subset does not depend on which others are there.
//! 5. **Features** on the uniform skeleton, so that bones of every source are rigid and of the same lengths.
//!
//! Actions with fewer than [`LEAST_SCORED`] training clips, those of the mirror image counted, are marked as not scored. An actor is known
//! when the training split has clips of the same actor; where the source does not name actors, known is assumed.

mod report;
mod side;

use std::collections::{BTreeMap, BTreeSet, HashSet};
use std::ops::Range;
use std::path::PathBuf;

use serde_json::Value;

use super::actions::Actions;
use super::pack::{self, Recording};
use super::{Summary, collect};
use crate::dataset::{Builder, Caption, Clip, Dataset, Facts, Quality, Split};
use crate::metrics::distance;
use crate::motion::features::{self, Options, Processed};
use crate::motion::{FPS, Pose};
use crate::parallel;

pub use report::{ActionRow, Cut, Report, Row};
pub use side::measured as measured_side;

/// A joint that moves faster than this is broken, m/s.
pub const FASTEST: f64 = 12.0;
/// Share of a clip that must be left for its captions to hold.
pub const LEAST_LEFT: f64 = 2.0 / 3.0;
/// Share of the takes that become the validation split of a subset that has none.
pub const VAL_SHARE: f64 = 0.05;
/// Training clips that an action needs to be scored.
pub const LEAST_SCORED: usize = 5;

/// What to import and how.
#[derive(Debug, Clone)]
pub struct Request {
    /// Folders of packs.
    pub folders: Vec<PathBuf>,
    /// Taxonomy and sources.
    pub actions: Actions,
    /// Subsets that are left out beside those that the table withdraws.
    pub withdraw: Vec<String>,
    /// Leave out clips with fewer frames than this.
    pub shortest: usize,
}

/// Why packs cannot be imported.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A pack cannot be read.
    #[error("the pack in {} cannot be imported", folder.display())]
    Pack {
        /// Its folder.
        folder: PathBuf,
        /// Why.
        source: pack::Error,
    },
    /// The table of actions does not know a subset.
    #[error("{} has no [subset.{subset}]; add one with its licence", table.display())]
    Subset {
        /// The table of actions.
        table: PathBuf,
        /// The subset.
        subset: String,
    },
    /// The table of actions does not know a raw label.
    #[error("{} gives no action to the label {label:?} of {subset} (clip {clip}); add it to the labels of an action", table.display())]
    Label {
        /// The table of actions.
        table: PathBuf,
        /// Name of the clip.
        clip: String,
        /// Its subset.
        subset: String,
        /// Its raw label.
        label: String,
    },
    /// A clip has no raw label.
    #[error(
        "clip {clip} of {subset} has none of the labels content, action and cmu_description; leave its subset out (--withdraw {subset})"
    )]
    NoLabel {
        /// Name of the clip.
        clip: String,
        /// Its subset.
        subset: String,
    },
    /// The action has a left and a right form, and nothing says which the clip is.
    #[error(
        "clip {clip} of {subset}, label {label:?}, says neither left nor right, but its action has a side; give the label a side in {}",
        table.display()
    )]
    NoSide {
        /// The table of actions.
        table: PathBuf,
        /// Name of the clip.
        clip: String,
        /// Its subset.
        subset: String,
        /// Its raw label.
        label: String,
    },
    /// A clip's `labels.quality` is none that is known.
    #[error("clip {clip} is of quality {found:?}, not optical, kinect or retargeted; correct its labels.quality")]
    Quality {
        /// Name of the clip.
        clip: String,
        /// What it says.
        found: String,
    },
    /// The result does not fit into a dataset.
    #[error(transparent)]
    Dataset(#[from] crate::dataset::Error),
}

/// What an import gives.
#[derive(Debug, Clone, PartialEq)]
pub struct Imported {
    /// The clips.
    pub dataset: Dataset,
    /// Counts, and what was left out, cut or withdrawn.
    pub summary: Summary,
    /// Figures by subset, quality and action.
    pub report: Report,
}

/// A clip on its way.
struct Taken {
    recording: Recording,
    facts: Facts,
    /// Name of the take, unique over all subsets.
    take: String,
    /// Frames of the recording that are kept, where some are not.
    cut: Option<Cut>,
}

/// Reads packs and extracts features. `progress` is called with (1, total) once a clip.
///
/// # Errors
/// [`Error`], naming the file, the clip and what to do.
pub fn import(request: &Request, progress: &(dyn Fn(usize, usize) + Sync)) -> Result<Imported, Error> {
    let table = &request.actions;
    if let Some(subset) = request.withdraw.iter().find(|name| !table.subsets.contains_key(*name)) {
        return Err(Error::Subset { table: table.path.clone(), subset: subset.clone() });
    }
    let mut summary = Summary::default();
    let mut losses = report::Losses::default();
    let mut taken = Vec::new();
    for named in read(request)? {
        let Some(subset) = table.subsets.get(&named.recording.clip.subset) else {
            return Err(Error::Subset { table: table.path.clone(), subset: named.recording.clip.subset });
        };
        let clip = &named.recording.clip;
        if subset.withdrawn || request.withdraw.contains(&clip.subset) {
            summary.note(&clip.id, format!("{} is withdrawn", clip.subset));
            continue;
        }
        if let Some(clip) = take(table, named, &mut summary, &mut losses)? {
            taken.push(clip);
        }
    }
    cut_val(table, &mut taken);

    let options = Options::default();
    let processed = parallel::map(&taken, |Taken { recording, .. }| {
        let joints = &recording.joints;
        let result = if joints.len() < request.shortest {
            Err(format!("{} frames, fewer than {}", joints.len(), request.shortest))
        } else {
            features::process(joints, &options).map_err(|error| error.to_string())
        };
        progress(1, taken.len());
        result
    });
    let mut kept: Vec<(Taken, Processed)> = Vec::with_capacity(taken.len());
    for (clip, result) in taken.into_iter().zip(processed) {
        match result {
            Ok(motion) => kept.push((clip, motion)),
            Err(reason) => {
                losses.drop_clip(&clip.recording.clip.subset, clip.recording.joints.len());
                summary.skip(&clip.recording.clip.id, reason);
            }
        }
    }
    mark(&mut kept);
    let mut builder = Builder::new();
    let mut report = report::Maker::new(table, losses);
    for (Taken { recording, facts, cut, .. }, motion) in kept {
        let clip = Clip { facts: Some(facts), ..recording.clip };
        summary.count(&clip, motion.joints.len());
        report.add(&clip, &motion, cut);
        builder.push(clip, &motion.joints, &motion.features)?;
    }
    Ok(Imported { dataset: builder.finish(), summary, report: report.finish() })
}

/// A clip whose subset is named apart.
struct Named {
    recording: Recording,
    /// The subset's name in its own pack.
    collection: String,
}

/// All clips of all packs.
fn read(request: &Request) -> Result<Vec<Named>, Error> {
    let mut packs = Vec::with_capacity(request.folders.len());
    for folder in &request.folders {
        packs.push(pack::read(folder).map_err(|source| Error::Pack { folder: folder.clone(), source })?);
    }
    let mut owners: BTreeMap<String, BTreeSet<usize>> = BTreeMap::new();
    for (number, pack) in packs.iter().enumerate() {
        for Recording { clip, .. } in pack {
            owners.entry(clip.subset.clone()).or_default().insert(number);
        }
    }
    let shared = |subset: &str| owners.get(subset).is_some_and(|packs| packs.len() > 1);
    let mut all = Vec::new();
    for (number, pack) in packs.into_iter().enumerate() {
        for mut recording in pack {
            let collection = recording.clip.subset.clone();
            if shared(&collection) {
                recording.clip.subset = format!("{collection}{}", number + 1);
            }
            all.push(Named { recording, collection });
        }
    }
    Ok(all)
}

/// A clip with its facts, without its broken frames; `None` when too much of it is broken. Whether it is scored and its actor known is
/// found out when all splits are.
fn take(
    table: &Actions,
    named: Named,
    summary: &mut Summary,
    losses: &mut report::Losses,
) -> Result<Option<Taken>, Error> {
    let Named { mut recording, collection } = named;
    let frames = recording.joints.len();
    let slow = longest_slow_run(&recording.joints);
    if (slow.len() as f64) < LEAST_LEFT * frames as f64 {
        let longest = slow.len();
        let reason =
            format!("a joint is faster than {FASTEST} m/s, and only {longest} of {frames} frames in a row are without");
        summary.skip(&recording.clip.id, reason);
        losses.drop_clip(&recording.clip.subset, frames);
        return Ok(None);
    }
    let mut cut = None;
    if slow.len() < frames {
        losses.cut(&recording.clip.subset, frames - slow.len());
        recording.joints = recording.joints[slow.clone()].to_vec();
        recording.clip.captions = shifted(recording.clip.captions, &slow);
        cut = Some(Cut { id: recording.clip.id.clone(), from: slow.start, to: slow.end, frames });
    }

    let Clip { id, subset, labels, .. } = &recording.clip;
    let text = |key: &str| labels.get(key).and_then(Value::as_str);
    let (clip, subset) = (id.clone(), subset.clone());
    let Some(label) = ["content", "action", "cmu_description"].into_iter().find_map(text) else {
        return Err(Error::NoLabel { clip, subset });
    };
    let label = label.to_owned();
    let Some(meaning) = table.meaning(&subset, &label) else {
        return Err(Error::Label { table: table.path.clone(), clip, subset, label });
    };
    let side = side::of(meaning.side, &label, labels, &recording.joints);
    let Some(action) = meaning.action(side) else {
        return Err(Error::NoSide { table: table.path.clone(), clip, subset, label });
    };
    let quality = match text("quality") {
        None | Some("optical") => Quality::Optical,
        Some("kinect") => Quality::Kinect,
        Some("retargeted") => Quality::Retargeted,
        Some(found) => return Err(Error::Quality { clip, found: found.into() }),
    };
    let actor = actor(labels).map(|actor| format!("{collection}/{actor}"));
    let take = text("trial").map_or_else(|| without_window(&clip).to_owned(), str::to_owned);
    let style = text("style").map(str::to_owned);
    let licence = table.subsets.get(&subset).map(|s| s.licence.clone()).unwrap_or_default();
    let own_legs = meaning.legs && quality == Quality::Kinect;
    let facts = Facts { action, side, style, scored: false, quality, own_legs, licence, actor, known_actor: true };
    Ok(Some(Taken { recording, facts, take: format!("{subset}/{take}"), cut }))
}

/// The longest run of frames between which no joint moves faster than [`FASTEST`]; the first of those that are equally long.
pub fn longest_slow_run(motion: &[Pose]) -> Range<usize> {
    let fast = |pair: &[Pose]| pair[0].iter().zip(&pair[1]).any(|(a, b)| distance(*a, *b) * FPS > FASTEST);
    let mut best = 0..motion.len().min(1);
    let mut start = 0;
    for (frame, pair) in motion.windows(2).enumerate() {
        if fast(pair) {
            start = frame + 1;
        }
        if frame + 2 - start > best.len() {
            best = start..frame + 2;
        }
    }
    best
}

/// Captions of the part that is kept: times from its first frame on, without those that hold before or after it alone.
fn shifted(captions: Vec<Caption>, kept: &Range<usize>) -> Vec<Caption> {
    let (start, length) = (kept.start as f64 / FPS, kept.len() as f64 / FPS);
    let shift = |caption: Caption| {
        if caption.from == 0.0 && caption.to == 0.0 {
            return Some(caption);
        }
        let (from, to) = ((caption.from - start).max(0.0), (caption.to - start).min(length));
        (to > from).then_some(Caption { from, to, ..caption })
    };
    captions.into_iter().filter_map(shift).collect()
}

/// The actor that the labels name: `actor`, else the subject of CMU's `trial` (`SUBJECT_NUMBER`).
fn actor(labels: &Value) -> Option<String> {
    match labels.get("actor") {
        Some(Value::String(name)) => Some(name.clone()),
        Some(Value::Number(number)) => Some(number.to_string()),
        _ => {
            let trial = labels.get("trial")?.as_str()?;
            Some(trial.split_once('_').map_or(trial, |(subject, _)| subject).to_owned())
        }
    }
}

/// An id without `_w` and a number at its end.
fn without_window(id: &str) -> &str {
    match id.rsplit_once("_w") {
        Some((take, number)) if !number.is_empty() && number.bytes().all(|b| b.is_ascii_digit()) => take,
        _ => id,
    }
}

/// Moves training clips to the validation split, see the module.
fn cut_val(table: &Actions, taken: &mut [Taken]) {
    let is_train = |clip: &Taken| clip.recording.clip.split == Split::Train;
    for clip in taken.iter_mut().filter(|clip| is_train(clip)) {
        let held_out = table.subsets.get(&clip.recording.clip.subset).and_then(|subset| subset.val_actor.as_ref());
        let actor = clip.facts.actor.as_ref().and_then(|actor| actor.split_once('/')).map(|(_, actor)| actor);
        if held_out.is_some_and(|held_out| actor == Some(held_out)) {
            clip.recording.clip.split = Split::Val;
        }
    }
    for (subset, source) in &table.subsets {
        let of_subset = |clip: &Taken| clip.recording.clip.subset == *subset;
        let has_val = taken.iter().any(|clip| of_subset(clip) && clip.recording.clip.split == Split::Val);
        if source.val_actor.is_some() || has_val {
            continue;
        }
        let mut left = training_clips(taken.iter().filter(|clip| of_subset(clip)));
        // The actions of every take, one entry a clip.
        let mut takes: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
        for clip in taken.iter().filter(|clip| of_subset(clip) && is_train(clip)) {
            takes.entry(&clip.take).or_default().push(&clip.facts.action);
        }
        let count = (VAL_SHARE * takes.len() as f64).ceil() as usize;
        let mut takes: Vec<(&str, Vec<&str>)> = takes.into_iter().collect();
        takes.sort_by_key(|(take, _)| collect::fnv1a(take));
        let mut chosen: HashSet<String> = HashSet::new();
        for (take, actions) in takes {
            let mut without = left.clone();
            actions.iter().for_each(|action| without.remove_one(action));
            if chosen.len() < count && actions.iter().all(|action| without.of(action) >= LEAST_SCORED) {
                chosen.insert(take.to_owned());
                left = without;
            }
        }
        for clip in taken.iter_mut().filter(|clip| is_train(clip) && chosen.contains(&clip.take)) {
            clip.recording.clip.split = Split::Val;
        }
    }
}

/// Training clips by action.
#[derive(Clone, Default)]
struct Counts(BTreeMap<String, usize>);

impl Counts {
    /// Clips of an action and of its mirror image, of which training makes it as well.
    fn of(&self, action: &str) -> usize {
        let count = |name: &str| self.0.get(name).copied().unwrap_or(0);
        let twin = mirrored(action);
        count(action) + if twin == action { 0 } else { count(&twin) }
    }

    fn remove_one(&mut self, action: &str) {
        if let Some(count) = self.0.get_mut(action) {
            *count = count.saturating_sub(1);
        }
    }
}

fn training_clips<'t>(clips: impl Iterator<Item = &'t Taken>) -> Counts {
    let mut counts = Counts::default();
    for clip in clips.filter(|clip| clip.recording.clip.split == Split::Train) {
        *counts.0.entry(clip.facts.action.clone()).or_default() += 1;
    }
    counts
}

/// Sets `scored` and `known_actor`, which depend on all clips.
fn mark(kept: &mut [(Taken, Processed)]) {
    let counts = training_clips(kept.iter().map(|(clip, _)| clip));
    let train = kept.iter().filter(|(clip, _)| clip.recording.clip.split == Split::Train);
    let actors: HashSet<String> = train.filter_map(|(clip, _)| clip.facts.actor.clone()).collect();
    for (Taken { facts, .. }, _) in kept.iter_mut() {
        facts.scored = counts.of(&facts.action) >= LEAST_SCORED;
        facts.known_actor = facts.actor.as_ref().is_none_or(|actor| actors.contains(actor));
    }
}

/// Name of the mirrored action.
fn mirrored(name: &str) -> String {
    let other = |part: &str| match part {
        "left" => "right".to_owned(),
        "right" => "left".to_owned(),
        part => part.to_owned(),
    };
    name.split('-').map(other).collect::<Vec<_>>().join("-")
}
