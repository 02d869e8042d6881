//! The viewer: one HTML file with everything in it, made from the parts under `page/`.
//!
//! Why not three.js: a skeleton of 22 lines needs a projection and a canvas, and the file opens without a network.
//! Once meshes are shown, that library is less work than this.

#[cfg(test)]
mod contrast;
mod surroundings;
mod timeline;

use crate::intervals::Interval;
use crate::report::AnchorErrors;
use crate::robot::ShownRobot;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use motionette_host::motion::{Pose, widened};
use motionette_host::reference;
use serde::Serialize;
pub use surroundings::{Clearances, ShownObstacle, ShownTrack, Surroundings};
pub use timeline::ShownSpan;

const PAGE: &str = include_str!("page/page.html");
const STYLE: &str = include_str!("page/style.css");
/// Scripts in the order in which they build on one another.
const SCRIPTS: [&str; 14] = [
    include_str!("page/scene.js"),
    include_str!("page/camera.js"),
    include_str!("page/body.js"),
    include_str!("page/surroundings.js"),
    include_str!("page/stage.js"),
    include_str!("page/labels.js"),
    include_str!("page/chart.js"),
    include_str!("page/overtime.js"),
    include_str!("page/tokens.js"),
    include_str!("page/intervals.js"),
    include_str!("page/feet.js"),
    include_str!("page/timeline.js"),
    include_str!("page/servos.js"),
    include_str!("page/app.js"),
];

/// A motion to be shown.
#[derive(Debug, Serialize)]
pub struct Shown {
    /// `after`, `before`, `alone`, `robot` or `reference`.
    pub id: &'static str,
    /// What it is called.
    pub name: &'static str,
    /// What it is.
    pub label: &'static str,
    /// Base64 of little-endian f32 `[T][22][3]`, metres.
    pub positions: String,
    /// When the left and the right foot stand: frames from and to, behind the last.
    pub stances: [Vec<[usize; 2]>; 2],
}

impl Shown {
    /// A motion under one of these ids.
    #[must_use]
    pub fn new(id: &'static str, name: &'static str, label: &'static str, motion: &[Pose]) -> Self {
        let bytes: Vec<u8> = motion.iter().flatten().flatten().flat_map(|v| v.to_le_bytes()).collect();
        let stances = reference::motion_space::standing(&widened(motion))
            .map(|foot| foot.iter().map(|s| [s.start, s.end]).collect());
        Shown { id, name, label, positions: STANDARD.encode(bytes), stances }
    }
}

/// A point of the control-error curve.
#[derive(Debug, Serialize)]
pub struct CurvePoint {
    /// Decoder evaluations so far.
    pub evaluations: usize,
    /// Best mean control error so far, centimetres.
    pub error_cm: f64,
}

/// A word of the prompt.
#[derive(Debug, Clone, Serialize)]
pub struct ShownWord {
    /// As it was written.
    pub text: String,
    /// Whether the model knows it.
    pub known: bool,
}

/// How the planner came to its tokens.
#[derive(Debug, Serialize)]
pub struct ShownPlan {
    /// The prompt.
    pub words: Vec<ShownWord>,
    /// Tokens after each planner step, `[steps][L]`; none where the clause of a position is yet to come.
    pub steps: Vec<Vec<Option<u16>>>,
    /// Positions that were fixed in advance.
    pub fixed: Vec<u16>,
}

/// What a stage cost.
#[derive(Debug, Serialize)]
pub struct ShownStage {
    /// Its name.
    pub label: &'static str,
    /// Multiply-accumulates.
    pub macs: u64,
    /// Time on this machine.
    pub milliseconds: f64,
}

/// A line of the figures.
#[derive(Debug, Serialize)]
pub struct Fact {
    /// What.
    pub label: String,
    /// How much, with its unit.
    pub value: String,
}

/// Everything the page shows.
#[derive(Debug, Serialize)]
pub struct Scene<'s> {
    /// Name of the motion.
    pub title: String,
    /// What it shows.
    pub caption: String,
    /// Frames a second.
    pub fps: u16,
    /// Frames.
    pub frames: usize,
    /// Frames a token.
    pub frames_per_token: usize,
    /// How the tokens were planned; `None` for tokens that were given.
    pub plan: Option<ShownPlan>,
    /// Cost by stage.
    pub stages: Vec<ShownStage>,
    /// Names of the joints.
    pub joint_names: Vec<&'static str>,
    /// Parent of each joint.
    pub parents: Vec<u8>,
    /// The motions.
    pub motions: Vec<Shown>,
    /// The anchors.
    pub anchors: Vec<AnchorErrors>,
    /// What is to be said about them.
    pub note: Option<String>,
    /// The intervals between them, with their activities at the motion as generated and as refined.
    pub intervals: Vec<Interval>,
    /// Where joints were to be at many frames.
    pub tracks: Vec<ShownTrack>,
    /// What the body was to keep clear of.
    pub obstacles: Vec<ShownObstacle>,
    /// How clear of it the motions are; `None` without obstacles.
    pub clearance: Option<Clearances>,
    /// What parts of the body do instead.
    pub timeline: Vec<ShownSpan>,
    /// The robot that played it.
    pub robot: &'s ShownRobot,
    /// How anchors were met; nothing where none were.
    pub refinement: Option<String>,
    /// Control error over decoder evaluations.
    pub curve: Vec<CurvePoint>,
    /// Mean control error of the prompt alone, centimetres, where the planner of the others saw anchors.
    pub error_alone_cm: Option<f64>,
    /// Without refinement.
    pub error_before_cm: f64,
    /// And with it.
    pub error_after_cm: f64,
    /// Figures of the run.
    pub facts: Vec<Fact>,
}

/// The page for `scene`.
///
/// # Errors
/// When the scene cannot be serialised (it always can).
pub fn page(scene: &Scene<'_>) -> serde_json::Result<String> {
    // In a script element only `<` could end the data early.
    let data = serde_json::to_string(scene)?.replace('<', "\\u003c");
    Ok(PAGE.replace("/*STYLE*/", STYLE).replace("/*SCRIPT*/", &SCRIPTS.join("\n")).replace("/*SCENE*/", &data))
}
