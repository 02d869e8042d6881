//! Digital twin: seeded requests that every machine makes from the same numbers, and the hashes that must be equal.
//!
//! The bare-metal image includes this very file, so it uses nothing but `core` and the runtime, and no memory of its own
//! beyond a few hundred bytes of stack.
//!
//! A request plans tokens from a prompt (or takes them at random or from a recorded motion), decodes them, reads joint
//! positions from the result, moves them by a seeded offset, and asks for a motion that passes through them. Every way to
//! sample, all families of anchors, tracks and obstacles, both solvers and their ablations, lengths from one token to the model's limit take
//! part.

use motionette::blob::Aligned;
use motionette::generation::tokens::{Fixed, Length, Planning, Sampling, Schedule};
use motionette::numerics::hash::{Fnv, Stream};
use motionette::refining::{Activity, Basis, Config};
use motionette::{
    Anchor, Bones, Course, Error, Generator, JOINTS, Joint, Keyframe, Model, Motion, Obstacle, PlanningError, Request,
    Track,
};

/// Requests of the model.
pub const REQUESTS: usize = 27;
/// Requests of small models with random weights: planners that the model is not one of, and weights of 16 bits.
pub const SMALL_REQUESTS: usize = 3 * SMALL.len();
/// Requests of a run.
pub const ALL: usize = REQUESTS + SMALL_REQUESTS;
/// Token numbers a request may have (positions times quantizers).
pub const MAX_NUMBERS: usize = 49;
/// Anchors a request may have.
pub const MAX_ANCHORS: usize = 12;

static MASKED: &Aligned<[u8]> = &Aligned(*include_bytes!("../../tests/corpus/masked.blob"));
static MOMASK: &Aligned<[u8]> = &Aligned(*include_bytes!("../../tests/corpus/masked-and-residual.blob"));
static TURNS: &Aligned<[u8]> = &Aligned(*include_bytes!("../../tests/corpus/autoregressive.blob"));
static WIDE_TURNS: &Aligned<[u8]> = &Aligned(*include_bytes!("../../tests/corpus/autoregressive-of-16-bits.blob"));
static SMALL: [&Aligned<[u8]>; 4] = [MASKED, MOMASK, TURNS, WIDE_TURNS];

/// Joints that robots want to steer: wrists, head, feet.
const HANDLES: [u8; 5] = [20, 21, 15, 10, 11];
/// Largest offset of an anchor from the motion, metres.
const REACH: f32 = 0.3;

/// What a request is made of, before its anchors are placed.
#[derive(Debug, Clone, Copy)]
struct Shape {
    from: Tokens,
    /// Positions; cut to what the model allows.
    positions: u16,
    anchors: Anchors,
    refinement: Config,
}

/// Frames of a track.
const TRACKED: usize = 24;

/// Knees, ankles and feet.
const LEGS: u32 = 1 << 4 | 1 << 5 | 1 << 7 | 1 << 8 | 1 << 10 | 1 << 11;
/// The standard request of DESIGN section 6 among them.
pub const STANDARD: usize = 23;
/// The first of the requests with tracks, with obstacles, and with both.
const ROWS_FROM: usize = 24;

/// How many anchors, and on what.
#[derive(Debug, Clone, Copy)]
enum Anchors {
    None,
    Root(u8),
    PlanarRoot(u8),
    Joint(u8),
    /// Root-3D, Planar-root and Body-point in turn, two joints at each frame.
    Mixed(u8),
    /// The standard request of DESIGN section 6: two for the root, one for each wrist.
    Standard,
}

/// What the tokens come from.
#[derive(Debug, Clone, Copy)]
enum Tokens {
    /// Drawn at random.
    Drawn,
    /// A recorded motion.
    Recorded,
    /// Planned from a prompt.
    Text(&'static str, Plan),
}

/// How tokens are planned.
#[derive(Debug, Clone, Copy)]
struct Plan {
    steps: u16,
    guidance: f32,
    schedule: Schedule,
    sampling: Sampling,
    /// The first and the last token are given.
    ends_fixed: bool,
    /// The window lies in the middle of a motion.
    open: bool,
}

/// The requests. Steps and decoder evaluations are few but in the last, so that an emulated core is done within minutes.
fn shape(index: usize) -> Shape {
    use Anchors::{Joint, Mixed, None, PlanarRoot, Root, Standard};
    use Sampling::{Greedy, Gumbel, Sample};
    use Tokens::{Drawn, Recorded, Text};
    let fast = Config::fast;
    let published = |evaluations, basis, activity| Config { basis, activity, ..Config::published(evaluations) };
    let plain = Plan {
        steps: 2,
        guidance: 1.0,
        schedule: Schedule::Uniform,
        sampling: Planning::DEFAULT.sampling,
        ends_fixed: false,
        open: false,
    };
    let guided = Plan { guidance: 2.0, ..plain };
    let filtered = Plan { sampling: Sample { temperature: 0.8, top_k: 40, top_p: 0.9 }, ..guided };
    let greedy = Plan { sampling: Greedy, steps: 3, ..plain };
    let gumbel = Plan { sampling: Gumbel { temperature: 0.7 }, schedule: Schedule::Cosine, ..plain };
    let gap = Plan { ends_fixed: true, open: true, ..guided };
    let (from, positions, anchors, refinement) = match index {
        0 => (Drawn, 1, None, fast(0)),
        1 => (Text("wave", plain), 1, Root(1), fast(4)),
        2 => (Text("A person walks forward.", guided), 2, PlanarRoot(2), fast(4)),
        3 => (Text("a person raises the left hand", greedy), 3, Joint(2), fast(6)),
        4 => (Recorded, 49, None, fast(0)),
        5 => (Text("someone RUNS straight ahead, energetically!", guided), 12, Root(2), fast(6)),
        6 => (Text("a tired robot walks backwards", filtered), 13, PlanarRoot(3), fast(6)),
        7 => (Text("the person lifts both hands up and lowers them", gumbel), 14, Joint(3), fast(6)),
        8 => (Text("a figure takes a bow in a lively way", gap), 17, Mixed(4), fast(6)),
        9 => (Drawn, 9, Mixed(12), fast(8)),
        10 => (Text("dance", greedy), 10, Root(3), published(4, Basis::Affine, Activity::Residual)),
        11 => (Text("a person bows", guided), 11, PlanarRoot(2), published(3, Basis::Plain, Activity::Residual)),
        12 => (Text("a person waves goodbye", plain), 12, Joint(4), published(3, Basis::Transport, Activity::Uniform)),
        13 => (Text("a giant walks", gumbel), 13, Mixed(5), published(3, Basis::Slope, Activity::Shuffled)),
        14 => (Text("a shy person zorbs left", plain), 16, Root(5), published(3, Basis::Quadratic, Activity::Residual)),
        15 => (Recorded, 21, Joint(3), published(3, Basis::Cubic, Activity::Residual)),
        16 => (Text("punches", filtered), 7, Joint(1), Config { feasibility: 1.0, ..fast(5) }),
        17 => (Text("a person walks and turns to the right", gap), 25, Mixed(8), Config::exact()),
        18 => (Text("an old person walks ahead", plain), 31, Mixed(12), Config::exact()),
        19 => (Text("stands and waves with both hands", plain), 36, Joint(6), fast(3)),
        20 => (Text("runs like a child", greedy), 44, PlanarRoot(4), fast(3)),
        21 => (Text("a proud figure walks", plain), 48, Mixed(7), fast(2).exactly()),
        24 => (Text("a person walks forward", plain), 12, None, Config::exact()),
        25 => (Text("a person walks and waves", plain), 14, None, Config::exact()),
        26 => (Recorded, 10, PlanarRoot(1), fast(1).exactly()),
        22 => (Text("throws kicks", Plan { steps: 5, ..guided }), 5, Mixed(2), fast(20)),
        _ => {
            (Text("a tired person waves the right hand", Plan { steps: 5, ..guided }), 49, Standard, Config::default())
        }
    };
    Shape { from, positions, anchors, refinement }
}

/// What one request gave, on any machine.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Digest {
    /// Tokens in the request, positions times quantizers.
    pub numbers: usize,
    /// Anchors in the request.
    pub anchors: usize,
    /// Decoder evaluations of its refinement.
    pub evaluations: u16,
    /// Decoder gradients of its refinement.
    pub gradients: u16,
    /// Bits of the mean control error before the refinement, metres.
    pub before: u32,
    /// Bits of the mean control error after it.
    pub after: u32,
    /// Arena bytes taken.
    pub arena_used: usize,
    /// FNV-1a over the tokens.
    pub tokens: u64,
    /// FNV-1a over every bit of the token embeddings.
    pub u: u64,
    /// FNV-1a over every bit of the joints.
    pub joints: u64,
}

/// One hash over the hashes of all requests.
#[must_use]
pub fn combine(digests: &[Digest]) -> u64 {
    let add = |hash: Fnv, value: u64| hash.bytes(&value.to_le_bytes());
    digests.iter().fold(Fnv::default(), |hash, d| add(add(add(hash, d.tokens), d.u), d.joints)).value()
}

/// Makes and runs request `index` of [`REQUESTS`]. `recorded` are token sequences of recorded motions.
///
/// # Errors
/// Whatever the runtime refuses; none of these requests should be, unless the model knows no text.
pub fn run(generator: &mut Generator<'_>, index: usize, recorded: &[&[u16]]) -> Result<Digest, Error> {
    let shape = shape(index);
    let mut random = Stream::new(index as u64);
    let mut tokens = [0u16; MAX_NUMBERS];
    let tokens =
        draw_tokens(generator, &mut random, shape.positions, recorded_for(index, &shape, recorded), &mut tokens);
    let first =
        |position: usize| Fixed { position: position as u16, token: tokens.get(position).copied().unwrap_or(0) };
    let fixed = [first(0), first(tokens.len().saturating_sub(1))];
    let request = match shape.from {
        Tokens::Drawn | Tokens::Recorded => Request::tokens(tokens),
        Tokens::Text(prompt, plan) => Request::text(prompt).planned(Planning {
            length: Length::Tokens(tokens.len() as u16),
            seed: index as u64,
            steps: plan.steps,
            schedule: plan.schedule,
            guidance: plan.guidance,
            sampling: plan.sampling,
            fixed: if plan.ends_fixed { &fixed } else { &[] },
            start_open: plan.open,
            end_open: plan.open,
            conditioned: true,
        }),
    };

    let skeleton = larger(generator);
    let request = request.bones(match index % 8 {
        2 => Bones::Given(&skeleton),
        6 => Bones::Decoded,
        _ => Bones::Model,
    });

    let mut anchors = [Anchor::root(0, [0.0; 3]); MAX_ANCHORS];
    let motion = generator.generate(&request, &mut ())?;
    let count = place_anchors(motion.frames(), &mut random, shape.anchors, &mut anchors);
    let anchors = anchors.get(..count).unwrap_or(&[]);

    if index >= ROWS_FROM {
        let paths = paths(motion.frames());
        return with_rows(generator, request.anchors(anchors).refined(shape.refinement), &paths, index - ROWS_FROM)
            .map(|motion| digest(&motion, tokens.len(), anchors.len()));
    }
    let request = if anchors.is_empty() { request } else { request.through(anchors).refined(shape.refinement) };
    let motion = generator.generate(&request, &mut ())?;
    Ok(digest(&motion, tokens.len(), anchors.len()))
}

/// Where pelvis and left wrist are for [`TRACKED`] frames from the fifth on, and how they swing beside that, metres.
fn paths(frames: &[[[f32; 3]; JOINTS]]) -> [[[f32; 3]; TRACKED]; 2] {
    let mut paths = [[[0.0; 3]; TRACKED]; 2];
    for (path, joint) in paths.iter_mut().zip([0, 20]) {
        for (step, (place, pose)) in path.iter_mut().zip(frames.iter().skip(4)).enumerate() {
            let swing = 0.01 * (step % 9) as f32;
            let [x, y, z] = pose.get(joint).copied().unwrap_or_default();
            *place = [x + swing, y + 0.5 * swing, z - swing];
        }
    }
    paths
}

/// A request with tracks, obstacles, or both: kind 0 to 2.
#[inline(never)]
fn with_rows<'g>(
    generator: &'g mut Generator<'_>,
    request: Request<'_>,
    [pelvis, wrist]: &[[[f32; 3]; TRACKED]; 2],
    kind: usize,
) -> Result<Motion<'g>, Error> {
    let mut mask = [1; TRACKED];
    mask.iter_mut().step_by(3).for_each(|counts| *counts = 0);
    let tracks = [
        Track::new(Joint::Pelvis, 4, pelvis).axes([true, false, true]).within(0.01),
        Track::new(Joint::LeftWrist, 4, wrist).masked(&mask),
    ];
    let [x, _, z] = pelvis.last().copied().unwrap_or_default();
    let keys =
        [Keyframe { frame: 5, position: [x - 1.0, 1.0, z] }, Keyframe { frame: 30, position: [x + 0.6, 1.0, z] }];
    let obstacles = [
        Obstacle::new(motionette::Shape::Cylinder { radius: 0.15, half_height: 1.0 }, [x + 0.1, 1.0, z + 0.4])
            .margin(0.03),
        Obstacle::new(motionette::Shape::Sphere { radius: 0.2 }, [0.0; 3]).moving(Course::Keyframes(&keys)),
    ];
    // Beside tracks the legs alone keep clear, whatever the tracks pass through.
    let obstacles = obstacles.map(|obstacle| if kind == 2 { obstacle.joints(LEGS) } else { obstacle });
    let request = if kind != 1 { request.tracks(&tracks) } else { request };
    let request = if kind > 0 { request.obstacles(&obstacles) } else { request };
    generator.generate(&request, &mut ())
}

/// Makes and runs request `index` of [`SMALL_REQUESTS`] in `arena`: a stored prompt, an anchor, each way to sample.
///
/// # Errors
/// Whatever the runtime refuses; none of these requests should be.
pub fn run_small(arena: &mut [u8], index: usize) -> Result<Digest, Error> {
    let blob = SMALL.get(index / 3).copied().unwrap_or(MASKED);
    let model = Model::open(&blob.0).map_err(|_| PlanningError::NoPlanner)?;
    small(&mut Generator::new(model, arena)?, index)
}

// Its own frame: what a request takes is not to lie below the opening of a model.
#[inline(never)]
fn small(generator: &mut Generator<'_>, index: usize) -> Result<Digest, Error> {
    let sampling = match index % 3 {
        0 => Sampling::Greedy,
        1 => Sampling::Gumbel { temperature: 0.9 },
        _ => Sampling::Sample { temperature: 1.1, top_k: 4, top_p: 0.9 },
    };
    let planning = Planning { seed: index as u64, sampling, ..generator.model().default_planning() };
    let anchors = [Anchor::joint(9, 20, [0.3, 1.0, 0.2])];
    let request = Request::bank("wave").planned(planning).length(Length::Tokens(5)).through(&anchors);
    let motion = generator.generate(&request, &mut ())?;
    Ok(digest(&motion, motion.tokens().len(), anchors.len()))
}

fn digest(motion: &Motion<'_>, numbers: usize, anchors: usize) -> Digest {
    let report = motion.refinement;
    let bits = |error: Option<motionette::refining::ControlError>| error.map_or(0, |e| e.mean.to_bits());
    Digest {
        numbers,
        anchors,
        evaluations: report.map_or(0, |r| r.evaluations),
        gradients: report.map_or(0, |r| r.gradients),
        before: report.map_or(0, |r| bits(r.before)),
        after: report.map_or(0, |r| bits(r.after)),
        arena_used: motion.arena_used,
        tokens: motion.tokens().iter().fold(Fnv::default(), |hash, token| hash.bytes(&token.to_le_bytes())).value(),
        u: Fnv::default().f32s(motion.u()).value(),
        joints: Fnv::default().f32s(motion.joints()).value(),
    }
}

/// A skeleton a fifth larger than the model's, with longer arms.
fn larger(generator: &Generator<'_>) -> [[f32; 3]; JOINTS] {
    let mut skeleton = generator.model().skeleton().offsets();
    let shares = [1.2f32; 16].into_iter().chain([1.4; 6]);
    for (offset, share) in skeleton.iter_mut().zip(shares) {
        *offset = offset.map(|value| value * share);
    }
    skeleton
}

/// The recorded sequence for request `index`, if it takes one.
fn recorded_for<'r>(index: usize, shape: &Shape, recorded: &[&'r [u16]]) -> Option<&'r [u16]> {
    match shape.from {
        Tokens::Drawn => None,
        // Given ends of a gap are those of a real motion.
        Tokens::Recorded | Tokens::Text(..) => recorded.get((index / 2) % recorded.len().max(1)).copied(),
    }
}

/// Fills `tokens` with as many numbers as the model allows: from `recorded`, repeated when it is shorter, or at random.
fn draw_tokens<'t>(
    generator: &Generator<'_>,
    random: &mut Stream,
    positions: u16,
    recorded: Option<&[u16]>,
    tokens: &'t mut [u16],
) -> &'t [u16] {
    let model = generator.model();
    let (codes, quantizers) = (model.codebooks().codes(), model.codebooks().quantizers().max(1));
    let longest =
        [usize::from(positions), model.max_tokens(), tokens.len() / quantizers].into_iter().min().unwrap_or(0);
    let tokens = tokens.get_mut(..longest * quantizers).unwrap_or(&mut []);
    let fits = recorded.filter(|list| !list.is_empty() && list.iter().all(|&token| usize::from(token) < codes));
    match fits {
        Some(list) => tokens.iter_mut().zip(list.iter().cycle()).for_each(|(to, from)| *to = *from),
        None => tokens.iter_mut().for_each(|token| *token = random.below(codes as u32) as u16),
    }
    tokens
}

/// Places anchors beside the motion `frames [T][22][3]`; returns how many.
fn place_anchors(frames: &[[[f32; 3]; JOINTS]], random: &mut Stream, wanted: Anchors, anchors: &mut [Anchor]) -> usize {
    let count = match wanted {
        Anchors::None => 0,
        Anchors::Standard => 4,
        Anchors::Root(n) | Anchors::PlanarRoot(n) | Anchors::Joint(n) | Anchors::Mixed(n) => usize::from(n),
    };
    let mut placed = 0;
    for (i, anchor) in anchors.iter_mut().take(count).enumerate() {
        // Later anchors stand at later frames; a mixture puts two joints at one frame.
        let (step, steps) = if matches!(wanted, Anchors::Mixed(_)) { (i / 2, count.div_ceil(2)) } else { (i, count) };
        let Some(frame) = ((step + 1) * frames.len() / steps).checked_sub(1) else { break };
        let handle = HANDLES.get((i + random.below(2) as usize) % HANDLES.len()).copied().unwrap_or(0);
        let (kind, joint) = match wanted {
            Anchors::None | Anchors::Root(_) => (0, 0),
            Anchors::PlanarRoot(_) => (1, 0),
            Anchors::Joint(_) => (2, handle),
            // The first of two anchors at a frame is the root's.
            Anchors::Mixed(_) => {
                if i.is_multiple_of(2) {
                    (step % 2, 0)
                } else {
                    (2, handle)
                }
            }
            Anchors::Standard => {
                if i.is_multiple_of(2) {
                    (0, 0)
                } else {
                    (2, 20 + (i / 2) as u8)
                }
            }
        };
        let Some(&[x, y, z]) = frames.get(frame).and_then(|pose| pose.get(usize::from(joint))) else { break };
        let mut offset = || REACH * (2.0 * random.unit() - 1.0);
        let (x, y, z) = (x + offset(), y + offset() * 0.5, z + offset());
        *anchor = match kind {
            0 => Anchor::root(frame as u16, [x, y, z]),
            1 => Anchor::planar_root(frame as u16, [x, z]),
            _ => Anchor::joint(frame as u16, joint, [x, y, z]),
        };
        placed += 1;
    }
    placed
}
