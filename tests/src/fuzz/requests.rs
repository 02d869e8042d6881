//! Hostile requests on a good model: lengths, tokens, anchors, tracks, obstacles, timelines, solver settings, arenas that are too small, observers that
//! stop the work anywhere.

use motionette::codec::codebook::Codebooks;
use motionette::numerics::hash::Stream;
use motionette::refining::{Activity, Basis, Config, Method, PerFamily};
use motionette::{
    ALL_JOINTS, Anchor, AnchorList, BodyParts, Bones, Course, Error, Fixed, Generator, JOINTS, Keyframe, LEAST_SPAN,
    Length, Limits, Model, Observer, Obstacle, Plan, Planning, Progress, Prompt, ROWS, Request, Sampling, Schedule,
    Shape, Source, Span, Stop, Target, Track,
};
use std::ops::ControlFlow;

use super::{Entry, Memory, Tally};

/// Numbers that a careless caller may hand over.
const NUMBERS: [f32; 14] =
    [0.0, -0.0, 1e-3, 0.5, 1.0, -1.0, 10.0, 999.9, -1001.0, 1e30, 1e-40, f32::NAN, f32::INFINITY, f32::NEG_INFINITY];

/// Stops the work after so many layer boundaries.
pub(super) struct Stopper {
    /// Calls that are let through, and one; 0 lets all through.
    pub left: u32,
    /// What it wishes then.
    pub wish: ControlFlow<Stop>,
}

impl Observer for Stopper {
    fn progress(&mut self, _: Progress) -> ControlFlow<Stop> {
        let now = self.left == 1;
        self.left = self.left.saturating_sub(1);
        if now { self.wish } else { ControlFlow::Continue(()) }
    }
}

/// Arena bytes of the least request there is.
pub(super) fn least(model: &Model<'_>) -> usize {
    let limits = Limits {
        tokens: 1,
        anchors: 0,
        tracked: 0,
        timeline: None,
        refinement: Config::default(),
        planning: None,
        rows: ROWS,
    };
    Plan::for_request(model, &limits).expect("the limits are legal").arena_bytes
}

/// Arena bytes of `request` with so many rows at a time, if it can be planned.
pub(super) fn need(model: &Model<'_>, request: &Request<'_>, rows: usize) -> Option<usize> {
    let mut generator = Generator::new(model.clone(), &mut []).ok()?;
    generator.set_rows(rows);
    generator.plan(request).ok().map(|plan| plan.arena_bytes)
}

/// A prompt as a vector, mostly of the width that the model takes.
pub(super) fn vector(random: &mut Stream, model: &Model<'_>) -> Vec<f32> {
    let width = match random.below(12) {
        0 => random.below(8) as usize,
        _ => model.vector_width().unwrap_or(3),
    };
    let wild = random.below(6) == 0;
    (0..width).map(|_| if wild { number(random, 1e4) } else { 2.0 * random.unit() - 1.0 }).collect()
}

/// Runs a hostile request on a model, then checks that the generator still works.
///
/// # Errors
/// What a generator may not do.
pub fn case(entry: &Entry<'_>, random: &mut Stream, memory: &mut Memory, tally: &mut Tally) -> Result<(), String> {
    let model = &entry.model;
    let quantizers = model.codebooks().quantizers();

    let refinement = if random.below(5) == 0 { None } else { Some(config(random)) };
    let tokens: Vec<u16> = (0..length(random, model, quantizers)).map(|_| token(random, model)).collect();
    let width = model.decoder().code_width();
    let u: Vec<f32> = (0..length(random, model, width)).map(|_| number(random, model.embedding_limit())).collect();
    let text = prompt(random);
    let fixed: Vec<Fixed> = (0..random.below(4)).map(|_| given(random, model)).collect();
    let vector = vector(random, model);
    let vectors = model.vector_width().is_some();
    let planner = model.planning().is_some() || random.below(16) == 0;
    let encoder = model.text().is_some_and(|text| text.encoder().is_some());
    let stored = if random.below(4) == 0 { text.as_str() } else { "wave" };
    let (source, positions) = match random.below(if planner { 8 } else { 4 }) {
        0 | 1 => (Source::Tokens(&tokens), tokens.len() / quantizers),
        2 | 3 => (Source::Embeddings(&u), u.len() / width),
        4..7 if vectors || random.below(32) == 0 => (Source::Text(Prompt::Vector(&vector)), model.max_tokens()),
        4..7 if encoder || random.below(16) == 0 => (Source::Text(Prompt::Text(&text)), model.max_tokens()),
        _ => (Source::Text(Prompt::Bank(stored)), model.max_tokens()),
    };
    let frames = positions.clamp(1, model.max_tokens()) * model.frames_per_token();
    let anchors: Vec<Anchor> = (0..anchor_count(random)).map(|_| anchor(random, frames)).collect();
    let planning = planning(random, &fixed);
    let skeleton = skeleton(model, random);
    let bones = match random.below(6) {
        0 => Bones::Decoded,
        1 | 2 => Bones::Given(&skeleton),
        _ => Bones::Model,
    };
    let paths: Vec<Vec<[f32; 3]>> = (0..rows(random)).map(|_| path(random, frames)).collect();
    let masks: Vec<Vec<u8>> = paths.iter().map(|path| mask(random, path.len())).collect();
    let tracks: Vec<Track<'_>> = paths.iter().zip(&masks).map(|(path, mask)| track(random, path, mask)).collect();
    let keyframes: Vec<Keyframe> = (0..random.below(4)).map(|i| keyframe(random, i)).collect();
    let obstacles: Vec<Obstacle<'_>> = (0..rows(random)).map(|_| obstacle(random, &keyframes)).collect();
    // Tracks and obstacles are met by the edit behind the decoder alone.
    let refinement = match refinement {
        Some(config) if !(tracks.is_empty() && obstacles.is_empty()) && random.below(8) > 0 => Some(config.exactly()),
        other => other,
    };
    let anchors = AnchorList::Frames(&anchors);
    let said: Vec<String> = (0..rows(random)).map(|_| prompt(random)).collect();
    let timeline: Vec<Span<'_>> = said.iter().map(|said| span(random, said, &vector, model, frames)).collect();
    let request = Request {
        source,
        anchors,
        tracks: &tracks,
        obstacles: &obstacles,
        timeline: &timeline,
        refinement,
        planning,
        bones,
    };

    // Anything from the least request's need on, exactly what this one needs, a byte less, or plenty from an odd address.
    let rows = random.below(30) as usize;
    let (least, need) = (least(model), need(model, &request, rows).unwrap_or(0));
    let (size, shift) = match random.below(8) {
        0 => (least + random.below(4096) as usize, 0),
        1 => (need.saturating_sub(1), 0),
        2..5 => (need, 0),
        _ => (need.max(least) + 16 + random.below(4096) as usize, random.below(16) as usize),
    };
    let Some(arena) = memory.arena.painted(size.max(least)).get_mut(shift..) else {
        return Err("the case's arena is short".to_owned());
    };
    let mut generator = Generator::new(model.clone(), arena).map_err(|e| e.to_string())?;
    generator.set_rows(rows);
    let mut stopper = Stopper {
        left: 1 + random.below(200),
        wish: if random.below(2) == 0 { ControlFlow::Break(Stop::Finish) } else { ControlFlow::Break(Stop::Abort) },
    };
    if random.below(3) == 0 {
        serve(&mut generator, &request, &mut stopper, tally)?;
    } else {
        serve(&mut generator, &request, &mut (), tally)?;
    }
    match generator.generate(&Request::tokens(&entry.plain), &mut ()) {
        Ok(motion) if motion.hash() == entry.hash => Ok(()),
        Ok(_) => Err("the request changed the next motion".to_owned()),
        Err(error) => Err(format!("the generator is unusable after the request: {error}")),
    }
}

/// The model's skeleton, larger or smaller, now and then with a bone that no body has.
pub(super) fn skeleton(model: &Model<'_>, random: &mut Stream) -> [[f32; 3]; JOINTS] {
    let size = 0.02 + random.below(300) as f32 * 0.01;
    let mut skeleton = model.skeleton().offsets();
    for offset in &mut skeleton {
        let share = size * (0.5 + random.below(100) as f32 * 0.01);
        *offset = offset.map(|value| value * share);
    }
    if random.below(4) == 0 {
        skeleton[random.below(JOINTS as u32) as usize] = [number(random, 4.0), 0.0, number(random, 4.0)];
    }
    skeleton
}

/// A span of a timeline, mostly one that there may be.
fn span<'r>(random: &mut Stream, said: &'r str, vector: &'r [f32], model: &Model<'_>, frames: usize) -> Span<'r> {
    let parts = BodyParts::from_bits(1 << random.below(5)).filter(|_| random.below(6) > 0);
    let parts = parts.or(BodyParts::from_bits(random.below(64) as u8)).unwrap_or(BodyParts::RIGHT_ARM);
    let room = (frames as u32).saturating_sub(u32::from(LEAST_SPAN));
    let (first, count) = match random.below(8) {
        0 => (random.below(1 << 16), random.below(1 << 16)),
        _ => {
            let first = random.below(room + 1);
            (first, u32::from(LEAST_SPAN) + random.below(room - first + 1))
        }
    };
    let prompt = match model.vector_width() {
        Some(_) => Prompt::Vector(vector),
        None if model.text().is_some_and(|text| text.encoder().is_some()) => Prompt::Text(said),
        None => Prompt::Bank("wave"),
    };
    Span { parts, first: first as u16, frames: count as u16, prompt }
}

/// Runs a request and checks what comes back.
///
/// # Errors
/// A motion with a number that is not finite, of another length than its source, or with another need than planned; a
/// refusal without words, or one for memory that was there.
pub fn serve(
    generator: &mut Generator<'_>,
    request: &Request<'_>,
    observer: &mut impl Observer,
    tally: &mut Tally,
) -> Result<(), String> {
    let plan = generator.plan(request);
    let (width, per_token) = (generator.model().decoder().code_width(), generator.model().frames_per_token());
    let (codes, quantizers) = (generator.model().codebooks().codes(), generator.model().codebooks().quantizers());
    match generator.generate(request, observer) {
        Ok(motion) => {
            tally.motions += 1;
            let unseen = usize::from(motion.unconditioned_anchors());
            if unseen > request.anchors.len() {
                return Err(format!("{unseen} of {} anchors were not seen", request.anchors.len()));
            }
            tally.led += u64::from(!request.tracks.is_empty() || !request.obstacles.is_empty());
            tally.parted += u64::from(!request.timeline.is_empty());
            tally.conditioned += u64::from(unseen == 0 && !request.anchors.is_empty());
            let plan = plan.map_err(|e| format!("a motion came out of a request that cannot be planned: {e}"))?;
            if motion.arena_used != plan.arena_bytes {
                return Err(format!("planned {} arena bytes, took {}", plan.arena_bytes, motion.arena_used));
            }
            if let Some(report) = motion.refinement
                && u32::from(report.evaluations) >= plan.evaluations
            {
                return Err(format!("planned {} evaluations, took {} and one", plan.evaluations, report.evaluations));
            }
            let tokens = motion.u().len() / width.max(1);
            if motion.frames().len() != tokens * per_token {
                return Err(format!("{} frames from {tokens} tokens", motion.frames().len()));
            }
            let each = quantizers;
            if !matches!(request.source, Source::Embeddings(_)) && motion.tokens().len() != tokens * each {
                return Err(format!("{} tokens of {tokens} positions", motion.tokens().len()));
            }
            if matches!(request.source, Source::Text(_)) {
                // Behind the first quantizer a planner may choose nothing.
                let out = |(at, &token): (usize, &u16)| {
                    usize::from(token) >= codes && (at.is_multiple_of(each) || token != Codebooks::NONE)
                };
                if motion.tokens().iter().enumerate().any(out) {
                    return Err("a token that the codebook does not have".to_owned());
                }
                let kept = |f: &Fixed| motion.tokens().get(usize::from(f.position) * each) == Some(&f.token);
                if !request.planning.fixed.iter().all(kept) {
                    return Err("a given token was changed".to_owned());
                }
            }
            match motion.joints().iter().chain(motion.u()).position(|v| !v.is_finite()) {
                Some(at) => Err(format!("number {at} of the motion is not finite")),
                None => Ok(()),
            }
        }
        Err(error) => {
            tally.requests_refused += 1;
            if error.to_string().is_empty() {
                return Err("an error without words".to_owned());
            }
            match error {
                Error::Arena(short) if short.needed <= short.available => Err(format!("refused for memory: {short}")),
                Error::Arena(short) if plan.is_ok_and(|plan| plan.arena_bytes != short.needed) => {
                    Err(format!("the refusal names another need than the plan: {short}"))
                }
                _ => Ok(()),
            }
        }
    }
}

/// Numbers in a request: mostly whole tokens inside the limit, else anything.
pub(super) fn length(random: &mut Stream, model: &Model<'_>, each: usize) -> usize {
    match random.below(20) {
        0 => random.below(700) as usize,
        1 => 0,
        2 => model.max_tokens() * each,
        3 => (model.max_tokens() + 1) * each,
        _ => (1 + random.below(model.max_tokens().min(12) as u32) as usize) * each,
    }
}

pub(super) fn token(random: &mut Stream, model: &Model<'_>) -> u16 {
    match random.below(400) {
        0 => random.next_u32() as u16,
        1 => u16::MAX,
        2 => model.codebooks().codes() as u16,
        _ => random.below(model.codebooks().codes() as u32) as u16,
    }
}

/// A number of ordinary size, seldom a strange one.
fn number(random: &mut Stream, limit: f32) -> f32 {
    match random.below(300) {
        0 => NUMBERS[random.below(NUMBERS.len() as u32) as usize],
        1 => limit,
        2 => 1.1 * limit,
        _ => 0.5 * limit * (2.0 * random.unit() - 1.0),
    }
}

fn anchor_count(random: &mut Stream) -> u32 {
    match random.below(16) {
        0 => 0,
        1 => random.below(80),
        _ => 1 + random.below(5),
    }
}

/// Tracks or obstacles of a request: mostly none.
fn rows(random: &mut Stream) -> u32 {
    match random.below(32) {
        0 => random.below(40),
        1..10 => 1 + random.below(3),
        _ => 0,
    }
}

fn coordinate(random: &mut Stream) -> f32 {
    match random.below(2000) {
        0 => NUMBERS[random.below(NUMBERS.len() as u32) as usize],
        _ => 3.0 * random.unit() - 1.5,
    }
}

fn path(random: &mut Stream, frames: usize) -> Vec<[f32; 3]> {
    let count = match random.below(20) {
        0 => random.below(300),
        _ => random.below(frames as u32 + 1),
    };
    (0..count).map(|_| [(); 3].map(|()| coordinate(random))).collect()
}

fn mask(random: &mut Stream, positions: usize) -> Vec<u8> {
    let count = if random.below(40) == 0 { random.below(9) as usize } else { positions };
    (0..count).map(|_| random.below(3) as u8).collect()
}

fn track<'r>(random: &mut Stream, positions: &'r [[f32; 3]], mask: &'r [u8]) -> Track<'r> {
    let joints = if random.below(100) == 0 { 256 } else { 22 };
    let first = if random.below(60) == 0 { random.next_u32() as u16 } else { 0 };
    Track {
        joint: random.below(joints) as u8,
        first: if random.below(3) == 0 { random.below(3) as u16 } else { first },
        axes: [(); 3].map(|()| random.below(8) > 0),
        mask: Some(mask).filter(|_| random.below(2) == 0),
        positions,
        tolerance: if random.below(3) == 0 { coordinate(random) } else { 0.0 },
    }
}

fn keyframe(random: &mut Stream, number: u32) -> Keyframe {
    let frame = if random.below(30) == 0 { random.next_u32() as u16 } else { (7 * number) as u16 };
    Keyframe { frame, position: [(); 3].map(|()| 0.3 * coordinate(random)) }
}

fn obstacle<'r>(random: &mut Stream, keyframes: &'r [Keyframe]) -> Obstacle<'r> {
    let mut size = || if random.below(60) == 0 { coordinate(random) } else { 0.05 + 0.5 * random.unit() };
    let [a, b, c] = [size(), size(), size()];
    let shape = match random.below(5) {
        0 => Shape::Sphere { radius: a },
        1 => Shape::Capsule { half: [a, b, c], radius: 0.3 * a },
        2 => Shape::Cylinder { radius: a, half_height: b },
        3 => Shape::Box { half: [a, b, c] },
        _ => Shape::Plane { normal: [a - 0.3, b - 0.3, c - 0.3] },
    };
    let place = [(); 3].map(|()| coordinate(random));
    let course = match random.below(4) {
        0 => Course::Moving { from: place, velocity: [(); 3].map(|()| coordinate(random)) },
        1 => Course::Keyframes(keyframes),
        _ => Course::Still(place),
    };
    let joints = if random.below(4) == 0 { random.next_u32() } else { ALL_JOINTS };
    let margin = if random.below(30) == 0 { coordinate(random) } else { 0.05 };
    Obstacle { shape, course, margin, joints }
}

pub(super) fn anchor(random: &mut Stream, frames: usize) -> Anchor {
    let mut coordinate = || match random.below(60) {
        0 => NUMBERS[random.below(NUMBERS.len() as u32) as usize],
        _ => 4.0 * random.unit() - 2.0,
    };
    let [x, y, z] = [coordinate(), coordinate(), coordinate()];
    let joints = if random.below(200) == 0 { 256 } else { 22 };
    let target = match random.below(3) {
        0 => Target::Root([x, y, z]),
        1 => Target::PlanarRoot([x, z]),
        _ => Target::Joint { joint: random.below(joints) as u8, position: [x, y, z] },
    };
    let limit = match random.below(200) {
        0 => 0x1_0000,
        1..10 => 4,
        _ => frames as u32,
    };
    let frame = random.below(limit) as u16;
    Anchor { frame, target }
}

fn config(random: &mut Stream) -> Config {
    let mut strange = |usual: f32| match random.below(12) {
        0 => NUMBERS[random.below(NUMBERS.len() as u32) as usize],
        _ => usual,
    };
    let base = Config {
        stop_error: strange(0.001),
        smoothness: strange(0.1),
        trust: strange(1e-5),
        feasibility: strange(0.5),
        max_step: strange(0.25),
        ridge: strange(1.0),
        tolerance: PerFamily { root_3d: strange(0.05), planar_root: strange(0.05), body_point: strange(0.05) },
        learning_rate: PerFamily { root_3d: strange(0.02), planar_root: strange(0.1), body_point: strange(1e3) },
        ..Config::fast(0)
    };
    let bases = [Basis::Plain, Basis::Transport, Basis::Slope, Basis::Affine, Basis::Quadratic, Basis::Cubic];
    let activities = [Activity::Residual, Activity::Uniform, Activity::Shuffled];
    Config {
        method: if random.below(2) == 0 { Method::QuasiNewton } else { Method::Published },
        evaluations: random.below(7) as u16,
        basis: bases[random.below(6) as usize],
        activity: activities[random.below(3) as usize],
        memory: [0, 1, 5, 255][random.below(4) as usize],
        seed: random.next_u32(),
        ..base
    }
}

/// Pieces of prompts: words of the small models and of none, separators, and what is no ASCII.
const PIECES: [&str; 26] = [
    "a",
    "person",
    "waves",
    "Waving",
    "runs",
    "running",
    "left",
    "hand's",
    "zebra",
    " ",
    "  ",
    ",",
    "\n",
    "'",
    "naïve",
    "歩く",
    "<none>",
    "<unknown>",
    "\u{1F600}",
    "wave",
    "then",
    "THEN",
    "after",
    "before running",
    "afterwards",
    ". ",
];

pub(super) fn prompt(random: &mut Stream) -> String {
    let piece = |random: &mut Stream| PIECES[random.below(PIECES.len() as u32) as usize];
    match random.below(12) {
        0 => String::new(),
        1 => "wave".to_owned(),
        2 => piece(random).repeat(random.below(3000) as usize),
        3 => (0..random.below(40)).map(|_| char::from_u32(random.below(0x3000)).unwrap_or('\u{FFFD}')).collect(),
        4 => "<none>".to_owned(),
        _ => {
            let words: Vec<&str> = (0..random.below(6)).map(|_| piece(random)).collect();
            format!("a {}", words.join(" "))
        }
    }
}

/// A token to be fixed, mostly one that can be.
pub(super) fn given(random: &mut Stream, model: &Model<'_>) -> Fixed {
    let strange = random.below(20) == 0;
    let positions = if strange { 0x1_0000 } else { 4.min(model.max_tokens() as u32) };
    let codes = if random.below(20) == 0 { 0x1_0000 } else { model.codebooks().codes() as u32 };
    Fixed { position: random.below(positions) as u16, token: random.below(codes) as u16 }
}

/// A plan, mostly one that can be carried out.
pub fn planning<'f>(random: &mut Stream, fixed: &'f [Fixed]) -> Planning<'f> {
    let mut strange = |usual: f32| match random.below(20) {
        0 => NUMBERS[random.below(NUMBERS.len() as u32) as usize],
        _ => usual,
    };
    let (guidance, temperature, top_p) = (strange(2.0), strange(0.8), strange(0.9));
    let length = match random.below(24) {
        0 => Length::Tokens(random.next_u32() as u16),
        1..6 => Length::Tokens(1 + random.below(6) as u16),
        6..10 => Length::Frames(random.below(16) as u16),
        _ => Length::Predicted,
    };
    Planning {
        length,
        seed: u64::from(random.next_u32()),
        steps: match random.below(400) {
            0 => random.next_u32() as u16 % 1200,
            1..20 => [0, 1, 40, 1001, u16::MAX][random.below(5) as usize],
            _ => 1 + random.below(4) as u16,
        },
        schedule: if random.below(2) == 0 { Schedule::Uniform } else { Schedule::Cosine },
        guidance: if random.below(3) == 0 { 1.0 } else { guidance },
        sampling: match random.below(3) {
            0 => Sampling::Greedy,
            1 => Sampling::Gumbel { temperature },
            _ => Sampling::Sample { temperature, top_k: random.below(7) as u16, top_p },
        },
        fixed: if random.below(3) == 0 { fixed } else { &[] },
        start_open: random.below(2) == 0,
        end_open: random.below(2) == 0,
        conditioned: random.below(4) > 0,
    }
}
