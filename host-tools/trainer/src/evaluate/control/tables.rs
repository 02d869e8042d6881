//! Which ways and problems make which table.

use std::collections::BTreeMap;
use std::time::Instant;

use anyhow::Result;
use motionette::refining::{Activity, Basis, Config};
use motionette::{Generator, Request};
use motionette_host::reference::bridge::runtime_anchor;
use motionette_host::verify;

use super::bench::{Bench, Origin, Task, Way};
use super::problem::{DENSITIES, Density, LED, Problem, Targets};
use crate::control::anchors::{FAMILIES, Kind};
use crate::evaluate::figures::{Figure, Row};

/// Whose motion anchors are places of, in the tables that tell the two apart.
const TARGETS: [Targets; 2] = [Targets::Own, Targets::Foreign];
/// Numbers of anchors that figures are averaged over.
pub const COUNTS: [usize; 5] = [2, 4, 8, 16, 32];
/// Those of ways that take hundreds of decoder evaluations, and of ablations.
pub const FEW: [usize; 3] = [2, 8, 32];
/// Strains of which a request might be warned; [`motionette::refining::Strain::WARNING`] among them.
const THRESHOLDS: [f64; 7] = [0.4, 0.6, 0.8, 1.0, 1.25, 1.6, 2.0];
/// Several joints at once: pelvis and a wrist, both wrists, feet and pelvis, head and wrists, all six.
const CROSS: [(u8, Density); 5] = [
    (0b10_0001, Density::Percent(100)),
    (0b11_0000, Density::Percent(25)),
    (0b00_0111, Density::Percent(100)),
    (0b11_1000, Density::Frames(5)),
    (0b11_1111, Density::Percent(100)),
];
/// Steps at which solvers are compared with one another.
const BALANCED: u16 = 200;

/// One row with what it is about.
#[derive(Clone, Debug, PartialEq)]
pub struct Entry {
    /// Control family; `all` for all three together.
    pub family: &'static str,
    /// Whose motion anchors are places of.
    pub targets: Targets,
    /// Number of anchors; `None` is the mean over several.
    pub k: Option<usize>,
    /// Trainable parameters of a control.
    pub parameters: Option<usize>,
    /// The figures.
    pub row: Row,
}

/// Seeds and words to whoever waits.
pub struct Course<'a> {
    /// Motions a prompt and problem.
    pub seeds: u64,
    /// Is told how far it is.
    pub say: &'a dyn Fn(&str),
}

fn way(name: &str, origin: Origin, refinement: Option<Config>) -> Way {
    Way { name: name.to_owned(), origin, refinement }
}

fn family(kind: Kind) -> &'static str {
    Problem::Family(kind, 0).family()
}

/// How many of them hold, with 1.96 standard errors.
fn share(holds: impl Iterator<Item = bool>) -> Figure {
    let (yes, all) = holds.fold((0.0, 0.0), |(yes, all), holds| (yes + f64::from(u8::from(holds)), all + 1.0));
    let mean = if all > 0.0 { yes / all } else { 0.0 };
    Figure { mean, half_width: 1.96 * (mean * (1.0 - mean) / f64::max(all, 1.0)).sqrt() }
}

impl Bench<'_> {
    fn entry(
        &mut self,
        way: &Way,
        (family, k): (&'static str, Option<usize>),
        problems: &[Problem],
        targets: Targets,
        course: &Course<'_>,
    ) -> Result<Entry> {
        let anchors = k.map_or_else(String::new, |k| format!(", {k} anchors"));
        (course.say)(&format!("{family}, {}: {}{anchors}", targets.name(), way.name));
        let parameters = match way.origin {
            Origin::Network(index) => Some(self.planners[index].1.parameters()),
            Origin::Prior | Origin::Controlled => None,
        };
        let tasks: Vec<Task> = problems.iter().map(|problem| (*problem, targets)).collect();
        Ok(Entry { family, targets, k, parameters, row: self.row(way, &tasks, course.seeds)? })
    }

    /// AnchorRoute's table III: the generator, the edit in motion space, quasi-Newton steps, RouteSolver in two lengths, by family and number
    /// of anchors, on own and foreign targets.
    ///
    /// # Errors
    /// Those of [`Bench::group`].
    pub fn frontier(&mut self, course: &Course<'_>) -> Result<Vec<Entry>> {
        let solver = |name: &str, config: Config| way(name, Origin::Controlled, Some(config));
        let ways = [
            way("generator", Origin::Controlled, None),
            solver("exact", Config::exact()),
            solver("fast20", Config::fast(20)),
            solver("rs200", Config::published(200)),
            solver("rs500", Config::published(500)),
        ];
        let mut entries = Vec::new();
        for targets in TARGETS {
            for way in &ways {
                let counts: &[usize] = if way.name.starts_with("rs") { &FEW } else { &COUNTS };
                for kind in FAMILIES {
                    for k in counts {
                        let problems = [Problem::Family(kind, *k)];
                        entries.push(self.entry(way, (family(kind), Some(*k)), &problems, targets, course)?);
                    }
                    let problems: Vec<Problem> = counts.iter().map(|k| Problem::Family(kind, *k)).collect();
                    entries.push(self.entry(way, (family(kind), None), &problems, targets, course)?);
                }
            }
        }
        Ok(entries)
    }

    /// Table IV: controls trained in different ways, without refinement, all families together.
    ///
    /// # Errors
    /// Those of [`Bench::group`].
    pub fn components(&mut self, course: &Course<'_>) -> Result<Vec<Entry>> {
        let problems: Vec<Problem> =
            FAMILIES.into_iter().flat_map(|kind| FEW.map(|k| Problem::Family(kind, k))).collect();
        let names: Vec<String> = self.planners.iter().map(|(name, _)| name.clone()).collect();
        let named = |(index, name): (usize, String)| {
            let name = name.split('@').next().unwrap_or_default().to_owned();
            Way { name, origin: Origin::Network(index), refinement: None }
        };
        let mut ways = vec![way("prior", Origin::Prior, None)];
        ways.extend(names.into_iter().enumerate().map(named));
        ways.push(way("runtime", Origin::Controlled, None));
        let each = |targets| ways.iter().map(move |way| (targets, way));
        let rows: Vec<_> = TARGETS.into_iter().flat_map(each).collect();
        rows.into_iter().map(|(targets, way)| self.entry(way, ("all", None), &problems, targets, course)).collect()
    }

    /// Table V: plain updates, the interval basis with uniform activity, and RouteSolver, 200 steps each.
    ///
    /// # Errors
    /// Those of [`Bench::group`].
    pub fn refinement(&mut self, course: &Course<'_>) -> Result<Vec<Entry>> {
        let full = Config::published(BALANCED);
        let ways = [
            ("generator", None),
            ("plain", Some(Config { basis: Basis::Plain, ..full })),
            ("uniform_activity", Some(Config { activity: Activity::Uniform, ..full })),
            ("route_solver", Some(full)),
        ];
        let mut entries = Vec::new();
        for kind in FAMILIES {
            let problems = FEW.map(|k| Problem::Family(kind, k));
            for (name, refinement) in ways {
                let way = way(name, Origin::Controlled, refinement);
                entries.push(self.entry(&way, (family(kind), None), &problems, Targets::Own, course)?);
            }
        }
        Ok(entries)
    }

    /// Table VI: what RouteSolver is made of, 200 steps, body points.
    ///
    /// # Errors
    /// Those of [`Bench::group`].
    pub fn mechanism(&mut self, course: &Course<'_>) -> Result<Vec<Entry>> {
        let full = Config::published(BALANCED);
        let basis = |basis| Some(Config { basis, ..full });
        let activity = |activity| Some(Config { activity, ..full });
        let ways = [
            ("generator", None),
            ("plain", basis(Basis::Plain)),
            ("transport_only", basis(Basis::Transport)),
            ("slope_only", basis(Basis::Slope)),
            ("quadratic", basis(Basis::Quadratic)),
            ("cubic", basis(Basis::Cubic)),
            ("uniform_activity", activity(Activity::Uniform)),
            ("shuffled_activity", activity(Activity::Shuffled)),
            ("route_solver", Some(full)),
        ];
        let problems = FEW.map(|k| Problem::Family(Kind::Body, k));
        let entry = |(name, refinement): (&str, Option<Config>)| {
            let way = way(name, Origin::Controlled, refinement);
            self.entry(&way, (family(Kind::Body), None), &problems, Targets::Own, course)
        };
        ways.into_iter().map(entry).collect()
    }

    /// Table II: six joints at five frames; the prior with a solver, the controlled generator alone, both.
    ///
    /// # Errors
    /// Those of [`Bench::group`].
    pub fn sparse(&mut self, course: &Course<'_>) -> Result<Vec<Entry>> {
        let (published, fast, exact) = (Some(Config::published(500)), Some(Config::fast(20)), Some(Config::exact()));
        let ways = [
            way("prior", Origin::Prior, None),
            way("prior_exact", Origin::Prior, exact),
            way("prior_rs500", Origin::Prior, published),
            way("generator", Origin::Controlled, None),
            way("generator_exact", Origin::Controlled, exact),
            way("generator_fast20", Origin::Controlled, fast),
            way("generator_rs500", Origin::Controlled, published),
        ];
        let problem = Problem::SixJoints;
        let each = |targets| ways.iter().map(move |way| (targets, way));
        let rows: Vec<_> = TARGETS.into_iter().flat_map(each).collect();
        let place = (problem.family(), Some(problem.count()));
        rows.into_iter().map(|(targets, way)| self.entry(way, place, &[problem], targets, course)).collect()
    }

    /// ControlMM's tables 1 (first part) and 4: joints led by tracks at one to all frames, by the planner alone and with the edit behind it.
    ///
    /// # Errors
    /// Those of [`Bench::group`].
    pub fn density(&mut self, course: &Course<'_>) -> Result<Vec<Entry>> {
        let ways = [
            way("generator", Origin::Controlled, None),
            way("generator+exact", Origin::Controlled, Some(Config::exact())),
        ];
        let single = |bit: usize| 1u8 << bit;
        let mut entries = Vec::new();
        for targets in TARGETS {
            for way in &ways {
                for bit in 0..LED.len() {
                    for density in DENSITIES {
                        let problem = Problem::Tracks(single(bit), density);
                        let place = (problem.family(), Some(problem.count()));
                        entries.push(self.entry(way, place, &[problem], targets, course)?);
                    }
                    let problems = DENSITIES.map(|density| Problem::Tracks(single(bit), density));
                    entries.push(self.entry(way, (problems[0].family(), None), &problems, targets, course)?);
                }
                let all: Vec<Problem> = (0..LED.len())
                    .flat_map(|bit| DENSITIES.map(|density| Problem::Tracks(single(bit), density)))
                    .collect();
                entries.push(self.entry(way, ("average", None), &all, targets, course)?);
                let cross = CROSS.map(|(joints, density)| Problem::Tracks(joints, density));
                entries.push(self.entry(way, ("cross", None), &cross, targets, course)?);
            }
        }
        Ok(entries)
    }

    /// What [`Strain`](motionette::refining::Strain) is worth as a warning: at several values, how many requests it speaks of, and how many of those
    /// whose motion was taken for its action as it was generated and for another one as it was edited.
    ///
    /// # Errors
    /// Those of [`Bench::group`].
    pub fn strain(&mut self, course: &Course<'_>) -> Result<Vec<Entry>> {
        let generator = way("generator", Origin::Controlled, None);
        let exact = way("exact", Origin::Controlled, Some(Config::exact()));
        let mut entries = Vec::new();
        for targets in TARGETS {
            // Strain, and whether the action was lost where there was one.
            let mut seen: Vec<(f64, Option<bool>)> = Vec::new();
            for kind in FAMILIES {
                (course.say)(&format!("{}, {}", family(kind), targets.name()));
                for (k, seed) in FEW.into_iter().flat_map(|k| (0..course.seeds).map(move |seed| (k, seed))) {
                    let task = (Problem::Family(kind, k), targets);
                    let [before, after] = [self.group(&generator, task, seed)?, self.group(&exact, task, seed)?];
                    let pairs = before.judged.iter().zip(&after.judged).zip(&self.yardstick.prompts);
                    seen.extend(pairs.map(|((before, after), prompt)| {
                        let strain = after.controlled.as_ref().map_or(0.0, |controlled| controlled.strain);
                        (strain, (before.content == prompt.content).then(|| after.content != prompt.content))
                    }));
                }
            }
            for threshold in THRESHOLDS {
                let warned = share(seen.iter().map(|(strain, _)| *strain > threshold));
                let lost = share(seen.iter().filter_map(|(_, lost)| *lost));
                let of_lost = seen.iter().filter(|(_, lost)| *lost == Some(true));
                let lost_warned = share(of_lost.map(|(strain, _)| *strain > threshold));
                let figures = [("warned", warned), ("lost", lost), ("lost_warned", lost_warned)].into_iter().collect();
                let row = Row { name: format!("strain above {threshold}"), figures };
                entries.push(Entry { family: "all", targets, k: None, parameters: None, row });
            }
        }
        Ok(entries)
    }

    /// Table VII: seconds, decoder evaluations and work of a sample on one thread: four anchors, two of the pelvis and two of joints.
    /// `instructions` a multiply-accumulate turn work into instructions of a Cortex-M7.
    ///
    /// # Errors
    /// What the runtime refuses.
    pub fn runtime(&mut self, course: &Course<'_>, instructions: f64) -> Result<Vec<Entry>> {
        let solver = |config: Config| Some(config);
        let ways = [
            ("generator", None),
            ("exact", solver(Config::exact())),
            ("fast20", solver(Config::fast(20))),
            ("rs200", solver(Config::published(200))),
            ("rs500", solver(Config::published(500))),
        ];
        let problem = Problem::Family(Kind::Mixed, 4);
        let mut entries = Vec::new();
        for (name, refinement) in ways {
            (course.say)(name);
            let mut sums: BTreeMap<&'static str, Vec<f64>> = BTreeMap::new();
            for (place, prompt) in self.yardstick.prompts.iter().enumerate() {
                let anchors = self.anchors((problem, Targets::Own), place, 0);
                let request = Request::text(&prompt.caption).planned(self.generation.planning(prompt, 0));
                let anchors: Vec<_> = anchors.iter().map(runtime_anchor).collect();
                let request = Request { refinement, ..request.anchors(&anchors) };
                let plan = Generator::new(self.blob.model()?, &mut [])?.plan(&request)?;
                let start = Instant::now();
                let motion = verify::run(self.blob, &prompt.caption, &request)?;
                let seconds = start.elapsed().as_secs_f64();
                let evaluations = motion.refinement.map_or(0.0, |report| f64::from(report.evaluations));
                let share = |used: f64, most: f64| if most > 0.0 { used / most } else { 0.0 };
                let solving = plan.macs - plan.planning_macs - plan.decoding_macs;
                let spent = share(evaluations, f64::from(plan.evaluations - 1)) * solving as f64;
                let macs = (plan.planning_macs + plan.decoding_macs) as f64 + spent;
                for (what, value) in [
                    ("seconds", seconds),
                    ("evaluations", evaluations + 1.0),
                    ("macs_m", macs / 1e6),
                    ("m7_instructions_m", instructions * macs / 1e6),
                ] {
                    sums.entry(what).or_default().push(value);
                }
            }
            let figure = |values: &Vec<f64>| {
                let n = values.len() as f64;
                let mean = values.iter().sum::<f64>() / n;
                let variance = values.iter().map(|v| (v - mean) * (v - mean)).sum::<f64>() / (n - 1.0).max(1.0);
                Figure { mean, half_width: 1.96 * (variance / n).sqrt() }
            };
            let figures = sums.iter().map(|(what, values)| (*what, figure(values))).collect();
            let row = Row { name: name.to_owned(), figures };
            let (family, k) = (problem.family(), Some(problem.count()));
            entries.push(Entry { family, targets: Targets::Own, k, parameters: None, row });
        }
        Ok(entries)
    }
}
