//! Runs a request: embeds its tokens, bends them onto the anchors, decodes the joints.

use crate::JOINTS;
use crate::arena::{Arena, ArenaTooSmall};
use crate::decoding::codebook::TokenOutOfRange;
use crate::decoding::decoder::{Interrupted, Workspace};
use crate::log;
use crate::model::Model;
use crate::motion::humanml3d::{Features, POSITION_CHANNELS, Path, channels};
use crate::nn::output::Channels;
use crate::perception::anchors::{Anchor, AnchorError, AnchorSet, Target};
use crate::plan::{JOINT_COLUMNS, Limits, Plan, feature_columns};
use crate::refining::{self, Config, MotionMap, SolverError, Stop};

/// Where the motion comes from.
#[derive(Debug, Clone, Copy)]
pub enum Source<'r> {
    /// Motion tokens, `[L][Q]` for `Q` quantizers.
    Tokens(&'r [u16]),
    /// Token embeddings `u [L][du]`, as an earlier motion or a solver left them.
    Embeddings(&'r [f32]),
}

/// One motion to be made. Quantities are SI; the motion starts at the origin facing +z, anchors are in that frame.
#[derive(Debug, Clone, Copy)]
pub struct Request<'r> {
    /// Where the motion comes from.
    pub source: Source<'r>,
    /// Where it must pass. Empty: no refinement.
    pub anchors: &'r [Anchor],
    /// How it is bent there; `None` leaves the motion as it is.
    pub refinement: Option<Config>,
}

impl<'r> Request<'r> {
    /// The motion of `tokens`, without anchors.
    #[must_use]
    pub const fn tokens(tokens: &'r [u16]) -> Self {
        Request { source: Source::Tokens(tokens), anchors: &[], refinement: None }
    }

    /// The motion of embeddings `u`, without anchors.
    #[must_use]
    pub const fn embeddings(u: &'r [f32]) -> Self {
        Request { source: Source::Embeddings(u), anchors: &[], refinement: None }
    }

    /// The same, bent onto `anchors` with the default refinement.
    #[must_use]
    pub fn through(self, anchors: &'r [Anchor]) -> Self {
        Request { anchors, refinement: Some(Config::default()), ..self }
    }

    /// The same with another refinement.
    #[must_use]
    pub const fn refined(self, refinement: Config) -> Self {
        Request { refinement: Some(refinement), ..self }
    }
}

/// A stage of the work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Stage {
    /// Bending the motion onto its anchors.
    Refining,
    /// Decoding the final motion.
    Decoding,
}

/// How far the work is. Reported at every layer boundary.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Progress {
    /// The stage.
    pub stage: Stage,
    /// Decoder evaluations begun in this stage.
    pub evaluation: u16,
    /// Decoder evaluations this stage may take.
    pub evaluations: u16,
}

/// What the observer wants.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Flow {
    /// Go on.
    Continue,
    /// Finish with the best motion so far: refinement ends, the motion is decoded and returned.
    Finish,
    /// Stop at once, no motion.
    Abort,
}

/// Watches the work and may end it at any layer boundary.
pub trait Observer {
    /// Called at every layer boundary.
    fn progress(&mut self, progress: Progress) -> Flow {
        let _ = progress;
        Flow::Continue
    }
}

impl Observer for () {}

/// Why a request gave no motion. The generator is usable afterwards.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Error {
    /// The arena is too small for this request; [`Plan::for_request`] says beforehand what is needed.
    Arena(ArenaTooSmall),
    /// The processor's floating-point environment would give other bits: rounding to nearest even, subnormal numbers
    /// and NaN payloads must be on (on Cortex-M: FPSCR's RMode, FZ and DN bits zero).
    FloatingPoint,
    /// A motion needs at least one token and at most `limit`.
    Tokens {
        /// Tokens (or numbers of the embeddings, when they are no whole tokens) in the request.
        found: usize,
        /// Most tokens the model allows.
        limit: usize,
    },
    /// A token that no codebook has.
    TokenOutOfRange {
        /// Position in the request's tokens.
        index: usize,
        /// The token.
        token: u16,
        /// Codes there are.
        codes: u16,
    },
    /// An embedding is not finite or further from zero than the model guarantees to handle.
    Embedding {
        /// Position in `u`.
        index: usize,
    },
    /// An anchor was refused.
    Anchors(AnchorError),
    /// The refinement failed.
    Solver(SolverError),
    /// The observer asked to abort.
    Aborted,
}

impl core::fmt::Display for Error {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Error::Arena(e) => e.fmt(f),
            Error::FloatingPoint => write!(
                f,
                "floating point is not in its default state: clear flush-to-zero, default-NaN and rounding mode bits"
            ),
            Error::Tokens { found, limit } => {
                write!(
                    f,
                    "the request has {found} tokens (or numbers that are no whole tokens), allowed are 1 to {limit}"
                )
            }
            Error::TokenOutOfRange { index, token, codes } => {
                write!(f, "token {token} at position {index}: the codebook has codes 0 to {}", codes.saturating_sub(1))
            }
            Error::Embedding { index } => write!(f, "number {index} of the embeddings is not finite or too large"),
            Error::Anchors(e) => e.fmt(f),
            Error::Solver(e) => e.fmt(f),
            Error::Aborted => write!(f, "the observer aborted the request"),
        }
    }
}

impl core::error::Error for Error {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Error::Arena(e) => Some(e),
            Error::Anchors(e) => Some(e),
            Error::Solver(e) => Some(e),
            _ => None,
        }
    }
}

impl From<ArenaTooSmall> for Error {
    fn from(e: ArenaTooSmall) -> Self {
        Error::Arena(e)
    }
}

impl From<AnchorError> for Error {
    fn from(e: AnchorError) -> Self {
        Error::Anchors(e)
    }
}

impl From<TokenOutOfRange> for Error {
    fn from(e: TokenOutOfRange) -> Self {
        Error::TokenOutOfRange { index: e.index, token: e.token, codes: e.codes }
    }
}

/// A finished motion, in the generator's arena.
#[derive(Debug, Clone, Copy)]
pub struct Motion<'a> {
    joints: &'a [f32],
    u: &'a [f32],
    frame_rate: u16,
    /// What the refinement did; `None` without one.
    pub refinement: Option<refining::Report>,
    /// Arena bytes that were taken.
    pub arena_used: usize,
}

impl<'a> Motion<'a> {
    /// Joint positions `[T][22][3]`, metres, flat.
    #[must_use]
    pub const fn joints(&self) -> &'a [f32] {
        self.joints
    }

    /// Joint positions, a frame at a time, metres.
    #[must_use]
    pub fn frames(&self) -> &'a [[[f32; 3]; JOINTS]] {
        bytemuck::try_cast_slice(self.joints).unwrap_or(&[])
    }

    /// Token embeddings `[L][du]` the motion was decoded from.
    #[must_use]
    pub const fn u(&self) -> &'a [f32] {
        self.u
    }

    /// Frames a second.
    #[must_use]
    pub const fn frame_rate(&self) -> u16 {
        self.frame_rate
    }

    /// Hash over every bit of embeddings and joints.
    #[must_use]
    pub fn hash(&self) -> u64 {
        crate::hash::motion(self.u, self.joints)
    }
}

/// Makes motions of one model in one arena.
#[derive(Debug)]
pub struct Generator<'a> {
    model: Model<'a>,
    arena: &'a mut [u8],
}

impl<'a> Generator<'a> {
    /// A generator of `model` that works in `arena` and nowhere else.
    ///
    /// # Errors
    /// [`Error::FloatingPoint`] when the processor would compute other bits than the digital-twin contract says.
    pub fn new(model: Model<'a>, arena: &'a mut [u8]) -> Result<Self, Error> {
        if floating_point_is_default() { Ok(Generator { model, arena }) } else { Err(Error::FloatingPoint) }
    }

    /// The model.
    #[must_use]
    pub const fn model(&self) -> &Model<'a> {
        &self.model
    }

    /// What this request will need of the arena.
    ///
    /// # Errors
    /// [`Error::Tokens`] when its length is not allowed.
    pub fn plan(&self, request: &Request<'_>) -> Result<Plan, Error> {
        Ok(Plan::for_request(&self.model, &self.limits(request)?))
    }

    fn limits(&self, request: &Request<'_>) -> Result<Limits, Error> {
        let limit = self.model.max_tokens();
        let (numbers, each) = match request.source {
            Source::Tokens(tokens) => (tokens.len(), self.model.codebooks().quantizers()),
            Source::Embeddings(u) => (u.len(), self.model.decoder().code_width()),
        };
        let tokens = numbers / each.max(1);
        if tokens == 0 || tokens > limit || !numbers.is_multiple_of(each.max(1)) {
            return Err(Error::Tokens { found: if tokens > limit { tokens } else { numbers }, limit });
        }
        let anchors = if request.refinement.is_some() { request.anchors.len() } else { 0 };
        Ok(Limits { tokens, anchors, refinement: request.refinement.unwrap_or_default() })
    }

    /// Makes the motion of `request`. `observer` is asked at every layer boundary.
    ///
    /// # Errors
    /// [`Error`]; the generator can be used again at once.
    pub fn generate(&mut self, request: &Request<'_>, observer: &mut impl Observer) -> Result<Motion<'_>, Error> {
        let result = self.run(request, observer);
        if let Err(error) = &result {
            log::refused!("request refused: {}", error);
        }
        result
    }

    fn run(&mut self, request: &Request<'_>, observer: &mut dyn Observer) -> Result<Motion<'_>, Error> {
        let limits = self.limits(request)?;
        let model = &self.model;
        let decoder = model.decoder();
        let frames = limits.tokens * model.frames_per_token();
        let anchors = AnchorSet::new(request.anchors, frames)?;

        let mut arena = Arena::new(self.arena);
        let too_small = |e: ArenaTooSmall| {
            Error::Arena(ArenaTooSmall { needed: Plan::for_request(model, &limits).arena_bytes, ..e })
        };
        let mut take = |count| arena.take::<f32>(count).map_err(too_small);
        let u = take(limits.tokens * decoder.code_width())?;
        let features = take(frames * feature_columns(limits.anchors))?;
        let mut path = Path {
            cos: take(frames)?,
            sin: take(frames)?,
            x: take(frames)?,
            z: take(frames)?,
            d_angle: take(frames)?,
            d_x: take(frames)?,
            d_z: take(frames)?,
        };
        let mut work =
            decoder.workspace(&mut arena, limits.tokens, POSITION_CHANNELS, JOINT_COLUMNS).map_err(too_small)?;
        embed(model, request.source, u)?;

        let mut refinement = None;
        if limits.anchors > 0 {
            let config = limits.refinement;
            let scratch = refining::scratch_len(limits.tokens, decoder.code_width(), limits.anchors, &config);
            let scratch = arena.take::<f32>(scratch).map_err(too_small)?;
            let selected = channels(anchored_joints(request.anchors));
            let (values, gradient) = features.split_at_mut_checked(frames * selected.count()).unwrap_or_default();
            let mut map = DecoderMap {
                model,
                channels: &selected,
                values,
                gradient,
                path: &mut path,
                work: &mut work,
                watch: Watch { observer, stage: Stage::Refining, evaluation: 0, evaluations: config.evaluations },
                frames,
                in_range: true,
            };
            refinement = match refining::solve(&mut map, u, &anchors, &config, scratch) {
                Ok(report) => {
                    log::debug!("refined: {}", report);
                    Some(report)
                }
                Err(SolverError::Aborted) => return Err(Error::Aborted),
                Err(e) => return Err(Error::Solver(e)),
            };
        }

        let all = channels(u32::MAX);
        let values = features.get_mut(..frames * all.count()).unwrap_or(&mut []);
        let mut watch = Watch { observer, stage: Stage::Decoding, evaluation: 1, evaluations: 1 };
        // A wish to finish is granted by carrying on: this pass is the end.
        let mut check = || match watch.ask() {
            Err(Stop::Abort) => Err(Interrupted),
            Ok(()) | Err(Stop::Finish) => Ok(()),
        };
        decoder.forward(u, &all, values, &mut work, &mut check).map_err(|Interrupted| Error::Aborted)?;
        let features = Features { values, channels: &all, mean: model.mean(), std: model.std() };
        features.integrate(&mut path);
        let joints = work.sequence.get_mut(..frames * JOINT_COLUMNS).unwrap_or(&mut []);
        for (frame, row) in joints.chunks_exact_mut(JOINT_COLUMNS).enumerate() {
            for (joint, to) in row.chunks_exact_mut(3).enumerate() {
                for (to, from) in to.iter_mut().zip(features.position(&path, joint, frame)) {
                    *to = from;
                }
            }
        }
        log::debug!("decoded {} frames in {} arena bytes", frames, arena.used());
        Ok(Motion { joints, u, frame_rate: model.frame_rate(), refinement, arena_used: arena.used() })
    }

    /// Runs the blob's self-test: decodes its token sequence and compares the hash. `None`: the blob carries none.
    ///
    /// # Errors
    /// Any [`Error`] of the request.
    pub fn self_test(&mut self) -> Result<Option<bool>, Error> {
        let test = self.model.self_test();
        if test.hash == 0 {
            return Ok(None);
        }
        let mut tokens = [0u16; SELF_TEST_NUMBERS];
        let count = usize::from(test.tokens) * self.model.codebooks().quantizers();
        let limit = self.model.max_tokens();
        let tokens = tokens.get_mut(..count).ok_or(Error::Tokens { found: count, limit })?;
        let mut stream = crate::hash::Stream::new(u64::from(test.seed));
        for token in tokens.iter_mut() {
            *token = stream.below(self.model.codebooks().codes() as u32) as u16;
        }
        let motion = self.generate(&Request::tokens(tokens), &mut ())?;
        Ok(Some(motion.hash() == test.hash))
    }
}

/// Token numbers a self-test may have.
pub const SELF_TEST_NUMBERS: usize = 64;

/// Fills `u` from tokens or embeddings.
fn embed(model: &Model<'_>, source: Source<'_>, u: &mut [f32]) -> Result<(), Error> {
    match source {
        Source::Tokens(tokens) => model.codebooks().embed(tokens, u)?,
        Source::Embeddings(values) => {
            let limit = model.embedding_limit();
            if let Some(index) = values.iter().position(|v| !(v.abs() <= limit)) {
                return Err(Error::Embedding { index });
            }
            for (to, from) in u.iter_mut().zip(values) {
                *to = *from;
            }
        }
    }
    Ok(())
}

/// Bit mask of the joints that anchors control.
fn anchored_joints(anchors: &[Anchor]) -> u32 {
    anchors.iter().fold(0, |mask, anchor| match anchor.target {
        Target::Root(_) | Target::PlanarRoot(_) => mask,
        Target::Joint { joint, .. } => mask | 1u32.wrapping_shl(u32::from(joint)),
    })
}

/// Asks the observer.
struct Watch<'o> {
    observer: &'o mut dyn Observer,
    stage: Stage,
    evaluation: u16,
    evaluations: u16,
}

impl Watch<'_> {
    fn ask(&mut self) -> Result<(), Stop> {
        let Watch { stage, evaluation, evaluations, .. } = *self;
        match self.observer.progress(Progress { stage, evaluation, evaluations }) {
            Flow::Continue => Ok(()),
            Flow::Finish => Err(Stop::Finish),
            Flow::Abort => Err(Stop::Abort),
        }
    }
}

/// The decoder and the recovery of joints as the solver sees them.
struct DecoderMap<'s, 'm, 'w, 'o> {
    model: &'s Model<'m>,
    channels: &'s Channels,
    values: &'s mut [f32],
    gradient: &'s mut [f32],
    path: &'s mut Path<'w>,
    work: &'s mut Workspace<'w>,
    watch: Watch<'o>,
    frames: usize,
    /// False when the last point lay where the model guarantees nothing; its positions are infinite then.
    in_range: bool,
}

impl DecoderMap<'_, '_, '_, '_> {
    fn features(&self) -> Features<'_> {
        Features { values: self.values, channels: self.channels, mean: self.model.mean(), std: self.model.std() }
    }
}

/// Runs a decoder pass with the observer asked at its layer boundaries.
fn watched(
    watch: &mut Watch<'_>,
    pass: impl FnOnce(&mut dyn FnMut() -> Result<(), Interrupted>) -> Result<(), Interrupted>,
) -> Result<(), Stop> {
    let mut stop = Stop::Abort;
    let mut check = || {
        watch.ask().map_err(|wish| {
            stop = wish;
            Interrupted
        })
    };
    let result = pass(&mut check);
    result.map_err(|Interrupted| stop)
}

impl MotionMap for DecoderMap<'_, '_, '_, '_> {
    fn frames(&self) -> usize {
        self.frames
    }

    fn tokens(&self) -> usize {
        self.frames / self.model.frames_per_token().max(1)
    }

    fn width(&self) -> usize {
        self.model.decoder().code_width()
    }

    fn forward(&mut self, u: &[f32]) -> Result<(), Stop> {
        self.watch.evaluation = self.watch.evaluation.saturating_add(1);
        let limit = self.model.embedding_limit();
        self.in_range = u.iter().all(|v| v.abs() <= limit);
        if !self.in_range {
            return self.watch.ask();
        }
        let (decoder, channels) = (self.model.decoder(), self.channels);
        let (values, work) = (&mut *self.values, &mut *self.work);
        watched(&mut self.watch, |check| decoder.forward(u, channels, values, work, check))?;
        let features =
            Features { values: self.values, channels: self.channels, mean: self.model.mean(), std: self.model.std() };
        features.integrate(self.path);
        Ok(())
    }

    fn position(&self, joint: u8, frame: usize) -> [f32; 3] {
        if self.in_range { self.features().position(self.path, usize::from(joint), frame) } else { [f32::INFINITY; 3] }
    }

    fn clear_gradient(&mut self) {
        self.gradient.fill(0.0);
        self.path.d_angle.fill(0.0);
        self.path.d_x.fill(0.0);
        self.path.d_z.fill(0.0);
    }

    fn add_gradient(&mut self, joint: u8, frame: usize, d: [f32; 3]) {
        let features =
            Features { values: self.values, channels: self.channels, mean: self.model.mean(), std: self.model.std() };
        features.add_gradient(self.path, self.gradient, usize::from(joint), frame, d);
    }

    fn backward(&mut self, du: &mut [f32]) -> Result<(), Stop> {
        let features =
            Features { values: self.values, channels: self.channels, mean: self.model.mean(), std: self.model.std() };
        let used = self.values.len();
        let gradient = self.gradient.get_mut(..used).unwrap_or(&mut []);
        features.integrate_gradient(self.path, gradient);
        let (decoder, channels, work) = (self.model.decoder(), self.channels, &mut *self.work);
        let gradient = &*gradient;
        watched(&mut self.watch, |check| decoder.backward(gradient, channels, du, work, check))
    }
}

/// Whether arithmetic rounds to nearest even, keeps subnormal numbers and NaN payloads.
fn floating_point_is_default() -> bool {
    use core::hint::black_box;
    // 1 + 2^-24 is a tie that goes to even; 1 + 3 * 2^-24 is one that goes up; both differ in every other mode.
    let half_step = f32::from_bits(0x3380_0000);
    let nearest = black_box(1.0f32) + black_box(half_step) == 1.0
        && black_box(-1.0f32) - black_box(half_step) == -1.0
        && black_box(1.0f32) + black_box(3.0 * half_step) == 1.0 + 4.0 * half_step;
    let subnormal = black_box(f32::MIN_POSITIVE) * black_box(0.5) != 0.0;
    let payload = (black_box(f32::from_bits(0x7FC0_1234)) + black_box(1.0)).to_bits() & 0x000F_FFFF == 0x0000_1234;
    nearest && subnormal && payload
}
