//! Scenes with obstacles: whether the figure keeps clear of them, judged by [`clearance`], and what that costs.
//!
//! Scenes stand in a file, a JSON object a line: `text`, `seed`, `frames`, `kind`, `goal` (`[x, z]`, metres, at the last frame) and `obstacles` as
//! in [`scene_file`]. In each the motion of the prompt alone collides; `draw` makes them.

use std::fmt::Write as _;
use std::path::Path;

use anyhow::{Context, Result};
use motionette::{Anchor, Course, Length, Obstacle, Planning, Request, Shape};
use motionette_host::blob::BlobFile;
use motionette_host::input;
use motionette_host::motion::Pose;
use motionette_host::output::write_atomic;
use motionette_host::reference::clearance;
use motionette_host::scene_file::{self, OwnedObstacle};
use motionette_host::{metrics, parallel, verify};
use serde_json::{Value, json};

use super::report::Facts;
use crate::random::Random;
use crate::tokenizer::config::FPS;

/// Scenes that can be cleared.
const SCENES: usize = 200;
/// And those that cannot.
const INFEASIBLE: usize = 20;
/// Kinds of scenes that can, in turn.
const KINDS: [&str; 4] = ["one", "ahead", "moving", "several"];
/// The kind of those that cannot.
const IMPOSSIBLE: &str = "impossible";
/// Prompts of the scenes.
const TEXTS: [&str; 6] = [
    "a person walks forward",
    "a person runs forward",
    "a tired person walks",
    "an old person walks forward",
    "a person walks and turns left",
    "a proud person walks",
];
/// A margin is kept when no more than this of it is missing, metres.
const KEPT: f64 = 0.005;
/// A goal is reached within this, metres.
const REACHED: f64 = 0.01;
/// Streams of random numbers that draw scenes.
const STREAM: u64 = 1 << 46;

/// A scene.
struct Scene {
    text: String,
    seed: u64,
    frames: u16,
    kind: String,
    goal: [f32; 2],
    obstacles: Vec<OwnedObstacle>,
}

/// What became of one.
struct Outcome {
    kind: String,
    /// Least distance beyond the margins of the prompt's own motion, and of the one that keeps clear, metres.
    room: [f64; 2],
    /// How far from the goal it ends, metres.
    off: f64,
    /// Jerk and foot skating, before and after.
    jerk: [f64; 2],
    skating: [f64; 2],
    /// Whether the runtime says that margins are kept.
    said: bool,
}

impl Scene {
    fn request(&self) -> Request<'_> {
        Request::text(&self.text).planned(Planning {
            length: Length::Frames(self.frames),
            seed: self.seed,
            ..Planning::DEFAULT
        })
    }

    fn line(&self) -> String {
        let numbers = |values: &[f32]| values.iter().map(f32::to_string).collect::<Vec<_>>().join(", ");
        let bodies = self.obstacles.iter().map(|body| {
            let obstacle = body.borrowed();
            let shape = match obstacle.shape {
                Shape::Sphere { radius } => format!(r#""sphere": {{"radius": {radius}}}"#),
                Shape::Cylinder { radius, half_height } => {
                    format!(r#""cylinder": {{"radius": {radius}, "height": {}}}"#, 2.0 * half_height)
                }
                Shape::Box { half } => format!(r#""box": {{"size": [{}]}}"#, numbers(&half.map(|half| 2.0 * half))),
                Shape::Plane { normal } => format!(r#""plane": {{"normal": [{}]}}"#, numbers(&normal)),
                Shape::Capsule { half, radius } => {
                    let at = if let Course::Still(at) = obstacle.course { at } else { [0.0; 3] };
                    let [from, to] = [-1.0, 1.0].map(|side| [0, 1, 2].map(|i| at[i] + side * half[i]));
                    let (from, to) = (numbers(&from), numbers(&to));
                    return format!(r#"{{"capsule": {{"radius": {radius}, "from": [{from}], "to": [{to}]}}}}"#);
                }
            };
            let course = match obstacle.course {
                Course::Moving { from, velocity } => {
                    format!(r#""at": [{}], "velocity": [{}]"#, numbers(&from), numbers(&velocity))
                }
                Course::Still(at) => format!(r#""at": [{}]"#, numbers(&at)),
                Course::Keyframes(_) => String::new(),
            };
            format!("{{{shape}, {course}}}")
        });
        let bodies = bodies.collect::<Vec<_>>().join(", ");
        let (text, kind, goal) = (json!(self.text), json!(self.kind), numbers(&self.goal));
        let (seed, frames) = (self.seed, self.frames);
        format!(
            r#"{{"text": {text}, "seed": {seed}, "frames": {frames}, "kind": {kind}, "goal": [{goal}], "obstacles": [{bodies}]}}"#
        )
    }
}

/// Reads scenes.
fn read(path: &Path) -> Result<Vec<Scene>> {
    let text = input::read_text(path, input::WRITTEN).with_context(|| format!("cannot read {}", path.display()))?;
    let scene = |(_, line): (usize, &str)| -> Result<Scene> {
        let value: Value = serde_json::from_str(line)?;
        let field = |name: &str| value.get(name).with_context(|| format!("{name} is missing"));
        let number_of = |name: &str| field(name)?.as_u64().with_context(|| format!("{name} is no number"));
        let word = |name: &str| Ok::<_, anyhow::Error>(field(name)?.as_str().unwrap_or_default().to_owned());
        let goal = field("goal")?.as_array().context("goal is no list")?;
        let place = |i: usize| goal.get(i).and_then(Value::as_f64).context("goal is [x, z]").map(|value| value as f32);
        let bodies = json!({ "obstacles": field("obstacles")? }).to_string();
        let seed = number_of("seed")?;
        Ok(Scene {
            text: word("text")?,
            seed,
            frames: u16::try_from(number_of("frames")?)?,
            kind: word("kind")?,
            goal: [place(0)?, place(1)?],
            obstacles: scene_file::parse_scene(&bodies, FPS as u16)?,
        })
    };
    let lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    lines.map(|line| scene(line).with_context(|| format!("{}, line {}", path.display(), line.0 + 1))).collect()
}

/// The least room that a motion leaves beyond the margins, metres.
fn room(frames: &[Pose], obstacles: &[Obstacle<'_>]) -> f64 {
    let each = obstacles.iter().map(|body| clearance::least(frames, body, FPS as f64) - f64::from(body.margin));
    each.fold(f64::INFINITY, f64::min)
}

/// Draws the scenes for a model, the same for the same model.
fn draw(blob: &BlobFile) -> Result<Vec<Scene>> {
    let numbers: Vec<usize> = (0..SCENES + INFEASIBLE).collect();
    parallel::map(&numbers, |&number| one(blob, number)).into_iter().collect()
}

/// The scene of a number: obstacles are drawn until the motion of the prompt alone collides, but not near its ends.
fn one(blob: &BlobFile, number: usize) -> Result<Scene> {
    let mut random = Random::new(1, STREAM + number as u64);
    let kind = if number < SCENES { KINDS[number % KINDS.len()] } else { IMPOSSIBLE };
    loop {
        let (text, seed) = (TEXTS[random.below(TEXTS.len())].to_owned(), random.below(10_000) as u64);
        let frames = 100 + 20 * random.below(4) as u16;
        let mut scene = Scene { text, seed, frames, kind: kind.to_owned(), goal: [0.0; 2], obstacles: Vec::new() };
        let motion = verify::run(blob, &scene.text, &scene.request())?.joints;
        let (Some(first), Some(last)) = (motion.first(), motion.last()) else { continue };
        let far = (last[0][0] - first[0][0]).hypot(last[0][2] - first[0][2]);
        if far < 2.0 {
            continue;
        }
        scene.goal = [last[0][0], last[0][2]];
        let count = if kind == "several" { 2 + random.below(2) } else { 1 };
        for place in 0..count {
            let share = if count == 1 { 0.35 + 0.3 * random.unit() } else { 0.25 + 0.5 * place as f64 / count as f64 };
            let at = (share * motion.len() as f64) as usize;
            scene.obstacles.push(body(&motion, at, kind, &mut random));
        }
        let bodies: Vec<Obstacle<'_>> = scene.obstacles.iter().map(OwnedObstacle::borrowed).collect();
        // All that moves is there at the ends as well: what begins or ends inside cannot be cleared.
        let ends = |poses: &[Pose], shift: u16| {
            let shifted: Vec<OwnedObstacle> = scene.obstacles.iter().map(|body| later(body, shift)).collect();
            let bodies: Vec<Obstacle<'_>> = shifted.iter().map(OwnedObstacle::borrowed).collect();
            room(poses, &bodies)
        };
        let collides = room(&motion, &bodies) < -0.02;
        let free = ends(&motion[..12], 0).min(ends(&motion[motion.len() - 8..], motion.len() as u16 - 8)) > 0.3;
        if collides && (free || kind == IMPOSSIBLE) {
            return Ok(scene);
        }
    }
}

/// The same body with its clock so many frames later.
fn later(body: &OwnedObstacle, frames: u16) -> OwnedObstacle {
    let mut body = body.clone();
    if let scene_file::OwnedCourse::Moving { from, velocity } = &mut body.course {
        for (place, speed) in from.iter_mut().zip(*velocity) {
            *place += speed * f32::from(frames) / FPS as f32;
        }
    }
    body
}

/// A body that the motion is in at about frame `at`.
fn body(motion: &[Pose], at: usize, kind: &str, random: &mut Random) -> OwnedObstacle {
    let mut between = |low: f64, high: f64| (low + (high - low) * random.unit()) as f32;
    let [x, _, z] = motion[at][0];
    let aside = if kind == "ahead" { [0.0, 0.0] } else { [between(-0.35, 0.35), between(-0.2, 0.2)] };
    let here = |y: f32| [x + aside[0], y, z + aside[1]];
    let (shape, place) = match (kind, between(0.0, 4.0) as usize) {
        (IMPOSSIBLE, _) => {
            // A wall between the start and the goal, or a ball around where it begins.
            let [dx, dz] = [x - motion[0][0][0], z - motion[0][0][2]];
            if between(0.0, 1.0) < 0.5 {
                (Shape::Plane { normal: [-dx, 0.0, -dz] }, [x, 0.0, z])
            } else {
                (Shape::Sphere { radius: between(0.3, 0.8) }, motion[0][0])
            }
        }
        (_, 0) => (Shape::Sphere { radius: between(0.15, 0.35) }, here(between(0.8, 1.3))),
        (_, 1) => {
            let half_height = between(0.5, 1.1);
            (Shape::Cylinder { radius: between(0.1, 0.25), half_height }, here(half_height))
        }
        (_, 2) => {
            let half = [between(0.1, 0.3), between(0.2, 0.6), between(0.1, 0.3)];
            (Shape::Box { half }, here(half[1]))
        }
        _ => {
            let half = [between(-0.3, 0.3), between(0.2, 0.8), between(-0.3, 0.3)];
            (Shape::Capsule { half, radius: between(0.05, 0.15) }, here(1.0))
        }
    };
    let course = if kind == "moving" {
        let angle = std::f32::consts::TAU * between(0.0, 1.0);
        let speed = between(0.2, 1.2);
        let velocity = [speed * angle.cos(), 0.0, speed * angle.sin()];
        let seconds = at as f32 / FPS as f32;
        scene_file::OwnedCourse::Moving { from: [0, 1, 2].map(|i| place[i] - velocity[i] * seconds), velocity }
    } else {
        scene_file::OwnedCourse::Still(place)
    };
    // A capsule that moves has no form in the file: it stays.
    let course = match (shape, course) {
        (Shape::Capsule { .. }, _) => scene_file::OwnedCourse::Still(place),
        (_, course) => course,
    };
    OwnedObstacle { shape, course, margin: 0.05, joints: motionette::ALL_JOINTS }
}

fn outcome(blob: &BlobFile, scene: &Scene) -> Result<Outcome> {
    let bodies: Vec<Obstacle<'_>> = scene.obstacles.iter().map(OwnedObstacle::borrowed).collect();
    let goal = [Anchor::planar_root(scene.frames - 1, scene.goal)];
    let free = verify::run(blob, &scene.text, &scene.request())?;
    let clear = verify::run(blob, &scene.text, &scene.request().unconditioned().anchors(&goal).obstacles(&bodies))?;
    let followed = clear.refinement.and_then(|report| report.edited).and_then(|edited| edited.followed);
    let both = [&free.joints, &clear.joints];
    let off = metrics::control_error(&clear.joints, &goal).context("the goal lies in the motion")?;
    Ok(Outcome {
        kind: scene.kind.clone(),
        room: both.map(|joints| room(joints, &bodies)),
        off,
        jerk: both.map(|joints| metrics::jerk(joints, FPS as f64)),
        skating: both.map(|joints| metrics::foot_skating(joints, 0.0)),
        said: followed.and_then(|followed| followed.clearance).is_some_and(|clearance| clearance.kept()),
    })
}

/// Reads the scenes, or draws and writes them where there is no file, and makes the table.
///
/// # Errors
/// Files that cannot be read or written, and what the runtime refuses.
pub fn table(blob: &BlobFile, scenes: &Path, facts: &Facts, out: &Path) -> Result<Value> {
    if !scenes.exists() {
        let text: String = draw(blob)?.iter().map(|scene| scene.line() + "\n").collect();
        write_atomic(scenes, |w| w.write_all(text.as_bytes()))?;
    }
    let scenes = read(scenes)?;
    let outcomes: Vec<Outcome> =
        parallel::map(&scenes, |scene| outcome(blob, scene)).into_iter().collect::<Result<_>>()?;
    let (text, value) = page(&outcomes, facts);
    let mut data = serde_json::to_string_pretty(&value)?;
    data.push('\n');
    write_atomic(out.join("obstacles.json"), |w| w.write_all(data.as_bytes()))?;
    write_atomic(out.join("obstacles.md"), |w| w.write_all(text.as_bytes()))?;
    Ok(value)
}

/// The page and its figures.
fn page(outcomes: &[Outcome], facts: &Facts) -> (String, Value) {
    let mut text = format!(
        "# Obstacles\n\nMade by `{}`. Scenes of a file, in each of which the motion of the prompt alone collides with an obstacle or its margin of 5 cm; \
         `ahead`: in the middle of its way, `one`: beside it, `moving`: at .2 to 1.2 m/s, `several`: two or three, `impossible`: a wall before the goal, or a ball around the start. \
         Bones are judged in f64 every 5 cm and at four moments a frame. A goal is an anchor on the floor at the last frame, where the prompt alone would end. \
         *Said as it is*: the runtime says that margins are kept where the judge finds them kept, and only there.\n\n\
         | scenes | collisions ↓ | margins kept ↑ | least room, mm | goal within 1 cm ↑ | goal missed, most, cm | jerk, times | skating, before, after | said as it is ↑ |\n|---|---|---|---|---|---|---|---|---|\n",
        facts.command
    );
    let mut rows = Vec::new();
    let kinds = KINDS.into_iter().chain(["all", IMPOSSIBLE]);
    for kind in kinds {
        let all: Vec<&Outcome> = outcomes
            .iter()
            .filter(|outcome| outcome.kind == kind || kind == "all" && outcome.kind != IMPOSSIBLE)
            .collect();
        let count = all.len().max(1) as f64;
        let share = |holds: &dyn Fn(&Outcome) -> bool| all.iter().filter(|o| holds(o)).count() as f64 / count;
        let mean = |value: &dyn Fn(&Outcome) -> f64| all.iter().map(|o| value(o)).sum::<f64>() / count;
        let margin = 0.05;
        let collisions = share(&|o| o.room[1] + margin < 0.0);
        let kept = share(&|o| o.room[1] >= -KEPT);
        let least = all.iter().map(|o| o.room[1]).fold(f64::INFINITY, f64::min);
        let reached = share(&|o| o.off <= REACHED);
        let missed = all.iter().map(|o| o.off).fold(0.0, f64::max);
        let jerk = mean(&|o| o.jerk[1] / o.jerk[0].max(1e-9));
        let skating = [0, 1].map(|i| mean(&|o| o.skating[i]));
        let said = share(&|o| o.said == (o.room[1] >= -KEPT));
        let _ = writeln!(
            text,
            "| {kind}, {} | {:.3} | {:.3} | {:.1} | {:.3} | {:.1} | {:.2} | {:.3}, {:.3} | {:.3} |",
            all.len(),
            collisions,
            kept,
            1e3 * least,
            reached,
            100.0 * missed,
            jerk,
            skating[0],
            skating[1],
            said
        );
        rows.push(json!({
            "name": kind, "scenes": all.len(), "collisions": collisions, "margins_kept": kept, "least_room_mm": 1e3 * least,
            "goal_reached": reached, "goal_missed_max_cm": 100.0 * missed, "jerk_ratio": jerk,
            "foot_skating_before": skating[0], "foot_skating": skating[1], "said_as_it_is": said,
        }));
    }
    text += "\n## Made from\n\n| file | SHA-256 |\n|---|---|\n";
    for (name, hash) in &facts.files {
        let _ = writeln!(text, "| {name} | `{hash}` |");
    }
    (text, json!({ "table": "obstacles", "rows": rows, "command": facts.command, "files": facts.files }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_are_read_as_they_are_written() {
        let still = |shape: Shape| OwnedObstacle {
            shape,
            course: scene_file::OwnedCourse::Still([0.5, 1.0, 2.0]),
            margin: 0.05,
            joints: motionette::ALL_JOINTS,
        };
        let obstacles = vec![
            still(Shape::Sphere { radius: 0.25 }),
            still(Shape::Box { half: [0.25, 0.5, 0.125] }),
            still(Shape::Cylinder { radius: 0.25, half_height: 1.0 }),
            still(Shape::Capsule { half: [0.25, 0.5, 0.0], radius: 0.125 }),
            OwnedObstacle {
                course: scene_file::OwnedCourse::Moving { from: [1.0, 2.0, 3.0], velocity: [0.5, 0.0, -0.25] },
                ..still(Shape::Sphere { radius: 0.5 })
            },
        ];
        let scene = Scene {
            text: "a \"person\"".into(),
            seed: 7,
            frames: 100,
            kind: "one".into(),
            goal: [0.25, 3.5],
            obstacles,
        };
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("scenes.jsonl");
        std::fs::write(&file, scene.line() + "\n").unwrap();
        let back = read(&file).unwrap().remove(0);
        assert_eq!((back.text, back.seed, back.frames), (scene.text, scene.seed, scene.frames));
        assert_eq!((back.kind, back.goal, back.obstacles), (scene.kind, scene.goal, scene.obstacles));
        std::fs::write(&file, "{\"text\": \"a\"}\n").unwrap();
        let error = format!("{:#}", read(&file).err().unwrap());
        assert!(error.contains("line 1") && error.contains("missing"), "{error}");
    }
}
