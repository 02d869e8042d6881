//! One request through the runtime in one static buffer, watched: timings, memory, control-error curve.

use motionette::{
    Anchor, Error, Generator, JOINTS, Model, Motion, Observer, Obstacle, Plan, Progress, Request, Source, Span, Stage,
    Stop, Track,
};
use motionette_host::console;
use motionette_host::spans::HeardSpan;
use std::ops::ControlFlow;
use std::time::{Duration, Instant};

/// What the arena is painted with before the run, so that its high-water mark can be read afterwards.
const PAINT: u8 = 0xC3;

/// What the observer saw.
#[derive(Debug, Clone)]
pub struct Watch {
    started: Instant,
    refining: Option<Instant>,
    decoding: Option<Instant>,
    /// Tokens after each planner step.
    pub steps: Vec<Vec<u16>>,
    /// Mean control error of each decoder evaluation, metres, in order.
    pub errors: Vec<f32>,
    report: fn(&Progress),
}

impl Observer for Watch {
    fn progress(&mut self, progress: Progress) -> ControlFlow<Stop> {
        (self.report)(&progress);
        if self.decoding.is_some() && matches!(progress.stage, Stage::Reading | Stage::Planning) {
            // What was decoded was a span of the timeline; behind the last of them comes the motion itself.
            self.decoding = None;
            self.steps.clear();
        }
        let begun = match progress.stage {
            Stage::Reading | Stage::Planning => None,
            Stage::Refining => Some(&mut self.refining),
            Stage::Decoding => Some(&mut self.decoding),
        };
        if let Some(begun) = begun {
            begun.get_or_insert_with(Instant::now);
        }
        self.errors.extend(progress.control_error);
        ControlFlow::Continue(())
    }

    fn tokens(&mut self, _step: u16, tokens: &[u16]) {
        self.steps.push(tokens.to_vec());
    }
}

/// A motion and what making it took.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// Joint positions, metres.
    pub joints: Vec<[[f32; 3]; JOINTS]>,
    /// Frames a second.
    pub frame_rate: u16,
    /// Token embeddings `[L][du]`.
    pub u: Vec<f32>,
    /// Motion tokens `[L][Q]`.
    pub tokens: Vec<u16>,
    /// Tokens after each planner step; empty when they were given.
    pub steps: Vec<Vec<u16>>,
    /// Words of the prompt that the model does not know.
    pub unknown_words: u16,
    /// What the prompt was understood as, of a model that was taught it.
    pub understood: Option<String>,
    /// Distinct anchors that the planner did not see.
    pub unconditioned_anchors: u16,
    /// Whether the planner saw some of what the motion is to meet: anchors, or places of tracks.
    pub conditioned: bool,
    /// What was understood of each span of the timeline.
    pub spans: Vec<HeardSpan>,
    /// What the refinement did; `None` without one.
    pub refinement: Option<motionette::refining::Report>,
    /// Mean control error of each decoder evaluation, metres, in order.
    pub errors: Vec<f32>,
    /// Time in text encoder and planner, and for the motions of a timeline's spans.
    pub planning: Duration,
    /// Time in the solver.
    pub refining: Duration,
    /// Time in the final decoding.
    pub decoding: Duration,
    /// The plan.
    pub plan: Plan,
    /// Bytes from the arena's start to the last one that was touched.
    pub high_water: usize,
    /// Hash over every bit of embeddings and joints.
    pub hash: u64,
}

/// Runs `request` on `model` in a painted arena of exactly the planned size plus a guard. `report` is called at every
/// layer boundary.
///
/// # Errors
/// Whatever the runtime refuses.
pub fn run(model: &Model<'_>, request: &Request<'_>, report: fn(&Progress)) -> Result<Outcome, Error> {
    let plan = Generator::new(model.clone(), &mut [])?.plan(request)?;
    // Words, so that the first byte is aligned; the guard shows whether the plan was exceeded.
    let mut words = vec![u128::from_ne_bytes([PAINT; 16]); plan.arena_bytes.div_ceil(16) + 64];
    let started = Instant::now();
    let mut watch = Watch { started, refining: None, decoding: None, steps: Vec::new(), errors: Vec::new(), report };
    let mut outcome = {
        let mut generator = Generator::new(model.clone(), bytemuck::cast_slice_mut(&mut words))?;
        let motion: Motion<'_> = generator.generate(request, &mut watch)?;
        let ended = Instant::now();
        let decoding = watch.decoding.unwrap_or(ended);
        let refining = watch.refining.unwrap_or(decoding);
        // Of given tokens nothing was planned but spans.
        let planned = matches!(request.source, Source::Text(_));
        Outcome {
            frame_rate: model.frame_rate(),
            joints: motion.frames().to_vec(),
            u: motion.u().to_vec(),
            tokens: motion.tokens().to_vec(),
            steps: if planned { watch.steps } else { Vec::new() },
            unknown_words: motion.unknown_words(),
            understood: console::understood(model, &motion),
            unconditioned_anchors: motion.unconditioned_anchors(),
            conditioned: plan.planning.anchors > 0 && !motion.parted(),
            spans: HeardSpan::of_all(model, request.timeline, motion.spans()),
            refinement: motion.refinement,
            errors: watch.errors,
            planning: refining - watch.started,
            refining: decoding - refining,
            decoding: ended - decoding,
            plan,
            high_water: 0,
            hash: motion.hash(),
        }
    };
    let bytes: &[u8] = bytemuck::cast_slice(&words);
    outcome.high_water = bytes.iter().rposition(|&b| b != PAINT).map_or(0, |last| last + 1);
    Ok(outcome)
}

/// RAM the runtime owns for this request: the arena and the generator itself. It has no `.data` and no `.bss`.
#[must_use]
pub fn ram_bytes(plan: &Plan) -> usize {
    plan.arena_bytes + size_of::<Generator<'static>>()
}

/// `||u - u0||_F`.
#[must_use]
pub fn distance(u: &[f32], u0: &[f32]) -> f64 {
    u.iter().zip(u0).map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2)).sum::<f64>().sqrt()
}

/// What a motion is to meet.
#[derive(Debug, Clone, Copy)]
pub struct Conditions<'r> {
    /// Where it passes.
    pub anchors: &'r [Anchor],
    /// Where joints are at many frames.
    pub tracks: &'r [Track<'r>],
    /// What the body keeps clear of.
    pub obstacles: &'r [Obstacle<'r>],
    /// What parts of the body do instead.
    pub timeline: &'r [Span<'r>],
}

impl Conditions<'_> {
    /// Whether any of them is met by the edit alone: tracks or obstacles.
    #[must_use]
    pub const fn has_rows(&self) -> bool {
        !self.tracks.is_empty() || !self.obstacles.is_empty()
    }

    /// Whether the reference makes a motion of them: it knows no tracks, obstacles or spans.
    #[must_use]
    pub const fn known_to_reference(&self) -> bool {
        !self.has_rows() && self.timeline.is_empty()
    }
}

/// `request` through its conditions, with this refinement.
#[must_use]
pub fn through<'r>(
    request: Request<'r>,
    conditions: &Conditions<'r>,
    refinement: Option<motionette::refining::Config>,
) -> Request<'r> {
    let request = request.anchors(conditions.anchors).tracks(conditions.tracks).obstacles(conditions.obstacles);
    let request = request.timeline(conditions.timeline);
    Request { refinement, ..request }
}
