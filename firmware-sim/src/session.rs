//! One request through the runtime in one static buffer, watched: timings, memory, control-error curve.

use motionette::{Anchor, Error, Generator, JOINTS, Model, Motion, Observer, Plan, Progress, Request, Stage};
use std::time::{Duration, Instant};

/// What the arena is painted with before the run, so that its high-water mark can be read afterwards.
const PAINT: u8 = 0xC3;

/// What the observer saw.
#[derive(Debug, Clone)]
pub struct Watch {
    started: Instant,
    decoding: Option<Instant>,
    /// Mean control error of each decoder evaluation, metres, in order.
    pub errors: Vec<f32>,
    report: fn(&Progress),
}

impl Observer for Watch {
    fn progress(&mut self, progress: Progress) -> motionette::Flow {
        (self.report)(&progress);
        if progress.stage == Stage::Decoding && self.decoding.is_none() {
            self.decoding = Some(Instant::now());
        }
        self.errors.extend(progress.control_error);
        motionette::Flow::Continue
    }
}

/// A motion and what making it took.
#[derive(Debug, Clone)]
pub struct Outcome {
    /// Joint positions, metres.
    pub joints: Vec<[[f32; 3]; JOINTS]>,
    /// Token embeddings `[L][du]`.
    pub u: Vec<f32>,
    /// What the refinement did; `None` without one.
    pub refinement: Option<motionette::refining::Report>,
    /// Mean control error of each decoder evaluation, metres, in order.
    pub errors: Vec<f32>,
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
    let mut watch = Watch { started, decoding: None, errors: Vec::new(), report };
    let mut outcome = {
        let mut generator = Generator::new(model.clone(), bytemuck::cast_slice_mut(&mut words))?;
        let motion: Motion<'_> = generator.generate(request, &mut watch)?;
        let ended = Instant::now();
        let decoding = watch.decoding.unwrap_or(ended);
        Outcome {
            joints: motion.frames().to_vec(),
            u: motion.u().to_vec(),
            refinement: motion.refinement,
            errors: watch.errors,
            refining: decoding - watch.started,
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

/// The request of `tokens` through `anchors` with `refinement`; without anchors, as it is.
#[must_use]
pub fn request<'r>(
    tokens: &'r [u16],
    anchors: &'r [Anchor],
    refinement: Option<motionette::refining::Config>,
) -> Request<'r> {
    let request = Request::tokens(tokens);
    match refinement {
        Some(config) if !anchors.is_empty() => request.through(anchors).refined(config),
        _ => request,
    }
}
