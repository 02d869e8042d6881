//! Motions of one way to make them, judged; groups of them are kept on disk, so that a long table goes on where it was interrupted.

use std::collections::BTreeMap;
use std::io::Write;
use std::path::PathBuf;
use std::time::Instant;

use anyhow::{Context, Result};
use motionette::refining::{Config, Exact};
use motionette::{Bones, Request, Target, Track};
use motionette_host::blob::BlobFile;
use motionette_host::motion::{Pose, widened};
use motionette_host::reference::Anchor;
use motionette_host::reference::bridge::runtime_anchor;
use motionette_host::reference::reach;
use motionette_host::{metrics, parallel, verify};
use serde::{Deserialize, Serialize};

use super::problem::{Problem, Targets};
use crate::control::sampling::Planner;
use crate::evaluate::figures::{Row, Yardstick};
use crate::evaluate::generators::Options;
use crate::evaluate::prompt::Motion;
use crate::evaluate::sample::{Controlled, Judged, Sample, judged};
use crate::evaluator::judge::Judge;
use crate::tokenizer::config::FPS;

/// Who makes the motion that is refined.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// The runtime's planner, anchors unknown to it.
    Prior,
    /// The runtime's planner, conditioned on the anchors.
    Controlled,
    /// A planner on the trainer's networks, by its place in [`Bench::planners`].
    Network(usize),
}

/// Which anchors, of whose motion.
pub type Task = (Problem, Targets);

/// A way to make motions.
#[derive(Clone, Debug)]
pub struct Way {
    /// Name of its rows.
    pub name: String,
    /// Who makes the motion.
    pub origin: Origin,
    /// How it is bent onto the anchors.
    pub refinement: Option<Config>,
}

/// Places of a joint, for a track.
struct Path {
    joint: u8,
    mask: Vec<u8>,
    positions: Vec<[f32; 3]>,
}

impl Path {
    /// A path for each joint of `anchors`, from frame 0 on.
    fn all(anchors: &[motionette::Anchor]) -> Vec<Self> {
        let mut paths: Vec<Self> = Vec::new();
        for anchor in anchors {
            let Target::Joint { joint, position } = anchor.target else { continue };
            let at = paths.iter().position(|path| path.joint == joint).unwrap_or_else(|| {
                paths.push(Self { joint, mask: Vec::new(), positions: Vec::new() });
                paths.len() - 1
            });
            let (frame, path) = (usize::from(anchor.frame), &mut paths[at]);
            path.mask.resize(frame, 0);
            path.positions.resize(frame, [0.0; 3]);
            path.mask.push(1);
            path.positions.push(position);
        }
        paths
    }

    fn track(&self) -> Track<'_> {
        let Self { joint, mask, positions } = self;
        Track { joint: *joint, first: 0, axes: [true; 3], mask: Some(mask), positions, tolerance: 0.0 }
    }
}

/// All prompts once: one way, one problem, one seed.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Group {
    /// What it was made with.
    key: String,
    /// `[prompt]`
    pub judged: Vec<Judged>,
    /// `[prompt]` tokens before refinement.
    tokens: Vec<Vec<u16>>,
    /// Seconds it took, all cores.
    seconds: f64,
}

/// Everything groups are made with.
pub struct Bench<'a> {
    /// Who judges.
    pub judge: &'a Judge,
    /// Prompts, sentences and real motion as embeddings.
    pub yardstick: Yardstick,
    /// `[prompt]` joints of the real motions with the model's bones, as long as the prompts say: where anchors are taken from.
    pub real: Vec<Vec<Pose>>,
    /// The model.
    pub blob: &'a BlobFile,
    /// Names the model and the prompts in keys.
    pub identity: String,
    /// Planners on the trainer's networks, with what names them in keys.
    pub planners: Vec<(String, Planner)>,
    /// How motions are sampled.
    pub generation: Options,
    /// Groups that are known.
    pub store: Store,
}

/// Groups on disk, one JSON object a line; lines of other models are left alone.
pub struct Store {
    path: PathBuf,
    groups: BTreeMap<String, Group>,
}

impl Store {
    /// Reads what is there. A line that was cut off counts as missing.
    ///
    /// # Errors
    /// A file that is there and cannot be read.
    pub fn open(path: &std::path::Path) -> Result<Self> {
        let text = match std::fs::read_to_string(path) {
            Ok(text) => text,
            Err(e) if e.kind() == std::io::ErrorKind::NotFound => String::new(),
            Err(e) => return Err(e).with_context(|| format!("cannot read {}", path.display())),
        };
        let groups = text.lines().filter_map(|line| serde_json::from_str::<Group>(line).ok());
        Ok(Self { path: path.to_owned(), groups: groups.map(|group| (group.key.clone(), group)).collect() })
    }

    fn add(&mut self, group: &Group) -> Result<()> {
        let failed = || format!("cannot write {}", self.path.display());
        if let Some(folder) = self.path.parent() {
            std::fs::create_dir_all(folder).with_context(failed)?;
        }
        let mut file = std::fs::OpenOptions::new().create(true).append(true).open(&self.path).with_context(failed)?;
        // A line break first: what an interrupted run left half written must not swallow this one.
        let line = format!("\n{}\n", serde_json::to_string(group)?);
        file.write_all(line.as_bytes()).with_context(failed)?;
        self.groups.insert(group.key.clone(), group.clone());
        Ok(())
    }
}

impl Bench<'_> {
    /// Anchors of a prompt.
    pub fn anchors(&self, (problem, targets): Task, place: usize, seed: u64) -> Vec<Anchor> {
        let of = targets.of(&self.yardstick.prompts, place, seed);
        let frames = self.real[place].len().min(self.real[of].len());
        problem.anchors(&self.real[of][..frames], place, seed)
    }

    fn key(&self, way: &Way, (problem, targets): Task, seed: u64) -> String {
        let origin = match way.origin {
            Origin::Prior => "prior".to_owned(),
            Origin::Controlled => "controlled".to_owned(),
            Origin::Network(index) => self.planners[index].0.clone(),
        };
        let refinement = way.refinement.map_or_else(String::new, |config| format!("{config:?}"));
        let (family, targets) = (problem.family(), targets.name());
        format!("{} {origin} {family} {} {targets} {seed} {refinement}", self.identity, problem.count())
    }

    /// A group, from disk or made now.
    ///
    /// # Errors
    /// What generator, solver or judge refuse, and a store that cannot be written.
    pub fn group(&mut self, way: &Way, task: Task, seed: u64) -> Result<Group> {
        let key = self.key(way, task, seed);
        if let Some(group) = self.store.groups.get(&key) {
            return Ok(group.clone());
        }
        let start = Instant::now();
        let unrefined = Way { refinement: None, ..way.clone() };
        let tokens = match way.refinement {
            Some(_) => Some(self.group(&unrefined, task, seed)?.tokens),
            None => None,
        };
        let places: Vec<usize> = (0..self.real.len()).collect();
        let made = parallel::map(&places, |&i| self.make(way, task, seed, i, tokens.as_ref().map(|t| &t[i][..])));
        let made = made.into_iter().collect::<Result<Vec<(Motion, Controlled)>>>()?;
        let (motions, controlled): (Vec<Motion>, Vec<Controlled>) = made.into_iter().unzip();
        let mut judged = judged(self.judge, &self.yardstick.prompts, &motions, &[])?;
        for (judged, controlled) in judged.iter_mut().zip(controlled) {
            judged.controlled = Some(controlled);
        }
        let tokens = motions.into_iter().map(|motion| motion.tokens).collect();
        let group = Group { key, judged, tokens, seconds: start.elapsed().as_secs_f64() };
        self.store.add(&group)?;
        Ok(group)
    }

    /// One motion, from `tokens` where they are known.
    fn make(
        &self,
        way: &Way,
        task: Task,
        seed: u64,
        place: usize,
        tokens: Option<&[u16]>,
    ) -> Result<(Motion, Controlled)> {
        let prompt = &self.yardstick.prompts[place];
        let known = self.anchors(task, place, seed);
        let anchors = known.iter().map(runtime_anchor).collect::<Vec<_>>();
        let paths = Path::all(if task.0.is_tracks() { &anchors } else { &[] });
        let tracks: Vec<Track<'_>> = paths.iter().map(Path::track).collect();
        let planned;
        let request = match (tokens, way.origin) {
            (Some(tokens), _) => Request::tokens(tokens),
            (None, Origin::Network(index)) => {
                let settings = self.generation.settings(prompt, seed);
                let (_, planner) = &self.planners[index];
                let guidance = self.generation.guidance;
                planned = planner.sample(&prompt.caption, prompt.tokens, &known, guidance, &settings);
                Request::tokens(&planned)
            }
            (None, Origin::Prior | Origin::Controlled) => {
                Request::text(&prompt.caption).planned(self.generation.planning(prompt, seed))
            }
        };
        let request = if task.0.is_tracks() { request.tracks(&tracks) } else { request.anchors(&anchors) };
        let request = Request { refinement: way.refinement, ..request };
        // What bends tokens is measured as it is published, where it works: on what is decoded.
        let bends = way.refinement.is_some_and(|config| config.exact.is_none());
        let request = request.bones(if bends { Bones::Decoded } else { Bones::Model });
        let request = if way.origin == Origin::Prior { request.unconditioned() } else { request };
        let motion = verify::run(self.blob, &prompt.caption, &request)?;
        let error =
            |anchor: &motionette::Anchor| metrics::anchor_error(&motion.joints, anchor).map(|error| 100.0 * error);
        let errors_cm: Option<Vec<f64>> = anchors.iter().map(error).collect();
        let errors_cm = errors_cm.context("anchors lie within the motion")?;
        // Of the motion that was generated for these tokens, whatever bends it.
        let generated = verify::run(self.blob, &prompt.caption, &Request::tokens(&motion.tokens).unrefined())?.joints;
        let generated = widened(&generated);
        let out = match task.0.is_tracks() {
            // Frame by frame there is no telling which of two places is too far from the other.
            true => vec![false; known.len()],
            false => reach::unreachable(&generated, &known, Exact::DEFAULT.added_speed.into(), FPS as f64),
        };
        let frames: Vec<usize> = known.iter().map(|anchor| anchor.frame).collect();
        let (joints, fps) = (&motion.joints, FPS as f64);
        let edited = motion.refinement.and_then(|report| report.edited);
        let controlled = Controlled {
            unreachable: out.iter().filter(|out| **out).count(),
            errors_cm: errors_cm.into_iter().zip(out).filter(|(_, out)| !out).map(|(error, _)| error).collect(),
            loosened: edited.map_or(0, |edited| edited.loosened.into()),
            jerk: metrics::jerk(joints, fps),
            jerk_at_anchors: metrics::jerk_around(joints, fps, &frames),
            foot_speed: metrics::foot_speed(joints, fps),
            speed: metrics::top_speed(joints, fps),
            bone_mm: 1e3 * metrics::bone_error(joints, self.blob.model()?.skeleton().offsets()),
            distance: motion.refinement.map_or(0.0, |report| f64::from(report.distance)),
            evaluations: motion.refinement.map_or(0.0, |report| f64::from(report.evaluations)),
            strain: edited.map_or(0.0, |edited| edited.strain.value.into()),
        };
        Ok((Motion { joints: motion.joints, tokens: motion.tokens }, controlled))
    }

    /// One row: all problems and seeds of a way together.
    ///
    /// # Errors
    /// Those of [`Bench::group`].
    pub fn row(&mut self, way: &Way, tasks: &[Task], seeds: u64) -> Result<Row> {
        let mut motions = Vec::new();
        for task in tasks {
            for seed in 0..seeds {
                motions.push(self.group(way, *task, seed)?.judged);
            }
        }
        let whole: Vec<usize> = (0..self.real.len()).collect();
        Ok(self.yardstick.measure(&Sample::new(&way.name, motions), &whole))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A run that was interrupted while it wrote loses what it was writing and nothing else.
    #[test]
    fn groups_outlive_an_interrupted_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("deep/store.jsonl");
        let group = |key: &str| Group { key: key.into(), judged: Vec::new(), tokens: vec![vec![7]], seconds: 1.5 };
        let mut store = Store::open(&path).unwrap();
        store.add(&group("a")).unwrap();
        let mut file = std::fs::OpenOptions::new().append(true).open(&path).unwrap();
        file.write_all(b"{\"key\":\"b\",\"jud").unwrap();
        let mut store = Store::open(&path).unwrap();
        assert_eq!(store.groups.keys().collect::<Vec<_>>(), ["a"]);
        store.add(&group("c")).unwrap();
        let store = Store::open(&path).unwrap();
        assert_eq!(store.groups.keys().collect::<Vec<_>>(), ["a", "c"]);
        assert_eq!(store.groups["c"].tokens, [[7]]);
        assert!(Store::open(folder.path()).is_err(), "a folder is no store");
    }
}
