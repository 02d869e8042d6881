//! Runs a request: plans its tokens, embeds them, bends them onto the anchors, decodes the joints.

mod bones;
pub(crate) mod buffers;
mod decode_map;
mod environment;
mod error;
mod observer;
pub mod plan;
mod plan_tokens;
mod sequence;
#[cfg(feature = "timeline")]
mod spans;
pub(crate) mod stream;
#[cfg(test)]
mod tests;
mod timeline;

pub use error::{Error, StreamError};
pub use observer::{Observer, Progress, Stage};
pub use stream::{Frame, MotionStream, Segment};

use crate::JOINTS;
pub use crate::blob::SELF_TEST_NUMBERS;
use crate::codec::Decode;
use crate::codec::vq::decoder::Workspace;
use crate::generation::tokens::session::Modules;
use crate::generation::tokens::{self as planning, PlanningError};
use crate::log;
use crate::memory::{Arena, ArenaTooSmall};
use crate::model::Model;
use crate::numerics::hash::Fnv;
use crate::pipeline::plan::{Limits, Plan, PlanError, ROWS, StreamLimits};
use crate::refining::motion_space::rows::Rows;
use crate::refining::motion_space::{self, Edited};
use crate::refining::terms::anchors::Distances;
use crate::refining::{self, Config, Objective, Report, SolverError, Strain};
use crate::representation::humanml3d::{Path, channels};
use crate::representation::{Features, Recover};
use crate::request::conditions::{AnchorSet, Track, TrackError, obstacle, track};
use crate::request::prompt::PromptStats;
use crate::request::{Bones, Request, Source};
use crate::text::meaning::Understood;
use buffers::{Decoding, EditScratch};
use decode_map::DecoderMap;
use environment::floating_point_is_default;
use observer::Watch;
use plan_tokens::{Planned, PlanningTask, plan_tokens};
use sequence::{Then, is_one_action, plan_clauses};

/// A finished motion, in the generator's arena.
#[derive(Debug, Clone, Copy)]
pub struct Motion<'a> {
    joints: &'a [f32],
    u: &'a [f32],
    tokens: &'a [u16],
    heard: PromptStats,
    then: Then,
    parted: bool,
    #[cfg(feature = "timeline")]
    spans: spans::Heard,
    unconditioned: u16,
    frame_rate: u16,
    /// What the refinement onto anchors did; `None` without one.
    pub refinement: Option<Report>,
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
        let frames = bytemuck::try_cast_slice(self.joints);
        invariant!(frames.is_ok(), "{} numbers are no whole frames", self.joints.len());
        frames.unwrap_or(&[])
    }

    /// Token embeddings `[L][du]` the motion was decoded from.
    #[must_use]
    pub const fn u(&self) -> &'a [f32] {
        self.u
    }

    /// Tokens `[L][Q]` it was decoded from, before refinement; empty when it was made from embeddings.
    #[must_use]
    pub const fn tokens(&self) -> &'a [u16] {
        self.tokens
    }

    /// Words of the prompt; 0 without one.
    #[must_use]
    pub const fn words(&self) -> u16 {
        self.heard.words
    }

    /// Words of the prompt that the model does not know.
    #[must_use]
    pub const fn unknown_words(&self) -> u16 {
        self.heard.unknown_words
    }

    /// What the prompt was understood as, or the first of its clauses; `None` without a prompt, or of a model that was not taught it.
    #[must_use]
    pub const fn understood(&self) -> Option<Understood> {
        self.heard.understood
    }

    /// What its further clauses were understood as, in the order in which they are done ([`crate::Clauses`]).
    pub fn then(&self) -> impl Iterator<Item = Understood> + '_ {
        self.then.iter().copied().flatten()
    }

    /// Whether each clause of the prompt was planned for itself.
    #[must_use]
    pub const fn parted(&self) -> bool {
        self.parted
    }

    /// What was understood of the prompts of the timeline's spans, in the request's order; behind the last of them nothing.
    #[must_use]
    pub const fn spans(&self) -> &[PromptStats] {
        #[cfg(feature = "timeline")]
        return &self.spans;
        #[cfg(not(feature = "timeline"))]
        &[]
    }

    /// Distinct anchors of the request that the planner did not see: those of families it was not trained for, or all of them,
    /// where the blob has no anchor control, the request wants none ([`Request::unconditioned`]), its prompt has several clauses
    /// or no text was planned.
    #[must_use]
    pub const fn unconditioned_anchors(&self) -> u16 {
        self.unconditioned
    }

    /// Frames a second.
    #[must_use]
    pub const fn frame_rate(&self) -> u16 {
        self.frame_rate
    }

    /// How much the anchors ask of the motion, where it was edited onto them ([`Config::exact`]).
    #[must_use]
    pub fn strain(&self) -> Option<Strain> {
        Some(self.refinement?.edited?.strain)
    }

    /// Hash over every bit of embeddings and joints.
    #[must_use]
    pub fn hash(&self) -> u64 {
        crate::numerics::hash::motion(self.u, self.joints)
    }
}

/// Makes motions of one model in one arena.
#[derive(Debug)]
pub struct Generator<'a> {
    model: Model<'a>,
    arena: &'a mut [u8],
    /// Of [`Limits::rows`].
    rows: usize,
}

impl<'a> Generator<'a> {
    /// A generator of `model` that works in `arena` and nowhere else.
    ///
    /// # Errors
    /// [`Error::FloatingPoint`] when the processor would compute other bits than the digital-twin contract says.
    pub fn new(model: Model<'a>, arena: &'a mut [u8]) -> Result<Self, Error> {
        if floating_point_is_default() { Ok(Generator { model, arena, rows: ROWS }) } else { Err(Error::FloatingPoint) }
    }

    /// Has so many rows pass through a layer at a time, from now on, instead of [`ROWS`]: what that is good for says [`Limits::rows`], what
    /// arena it takes [`Generator::plan`].
    pub const fn set_rows(&mut self, rows: usize) {
        self.rows = rows;
    }

    /// The model.
    #[must_use]
    pub const fn model(&self) -> &Model<'a> {
        &self.model
    }

    /// What this request will need of the arena.
    ///
    /// # Errors
    /// [`Error::Tokens`] when its length is not allowed, [`Error::Prompt`] or [`Error::Planning`] of a text, [`Error::Anchors`].
    pub fn plan(&self, request: &Request<'_>) -> Result<Plan, Error> {
        let mut anchors = AnchorSet::EMPTY;
        let limits = self.check(request, &mut anchors)?;
        Ok(Plan::for_request(&self.model, &limits)?)
    }

    /// Checks all of a request that can be checked before it runs. Its anchors, planned with or not, come into `anchors`.
    #[inline(never)]
    fn check(&self, request: &Request<'_>, anchors: &mut AnchorSet) -> Result<Limits, Error> {
        let mut limits = self.limits(request)?;
        bones::check(request.bones)?;
        limits.timeline = timeline::check(&self.model, request, limits.tokens)?;
        let frames = limits.tokens * self.model.frames_per_token();
        anchors.fill(request.anchors, self.model.frame_rate(), frames)?;
        if request.refinement.is_some() {
            limits.anchors = anchors.len();
        }
        if !request.tracks.is_empty() || !request.obstacles.is_empty() {
            self.check_rows(request, anchors, frames, &mut limits)?;
        }
        if let Some(planning) = &mut limits.planning {
            planning.anchors = request.planning.conditioned && self.seen(anchors);
        }
        Ok(limits)
    }

    /// Checks tracks and obstacles. Places of the tracks come into `anchors`, for the planner.
    #[inline(never)]
    fn check_rows(
        &self,
        request: &Request<'_>,
        anchors: &mut AnchorSet,
        frames: usize,
        limits: &mut Limits,
    ) -> Result<(), Error> {
        if !cfg!(feature = "tracks") {
            return Err(Error::NotLinked { feature: "tracks" });
        }
        if !request.obstacles.is_empty() && !cfg!(feature = "obstacles") {
            return Err(Error::NotLinked { feature: "obstacles" });
        }
        let frame_rate = self.model.frame_rate();
        track::check(request.tracks, anchors, frames)?;
        obstacle::check(request.obstacles, anchors, request.tracks, frame_rate)?;
        let rows = Rows { anchors, tracks: request.tracks, obstacles: request.obstacles, frame_rate };
        match request.refinement {
            Some(Config { exact: Some(_), .. }) => limits.tracked = rows.joints().count_ones() as usize,
            // Tracks are for the planner alone, as anchors are.
            None if request.obstacles.is_empty() => {}
            _ => return Err(Error::Tracks(TrackError::NotExact)),
        }
        anchors.suggest(request.tracks);
        Ok(())
    }

    /// Arena bytes of requests inside `limits`.
    #[inline(never)]
    fn needed(&self, limits: &Limits) -> Result<usize, PlanError> {
        Plan::for_request(&self.model, limits).map(|plan| plan.arena_bytes)
    }

    /// What the request takes without its anchors.
    fn limits(&self, request: &Request<'_>) -> Result<Limits, Error> {
        let refinement = request.refinement.unwrap_or(Config::NONE);
        let limit = self.model.max_tokens();
        let (numbers, each) = match request.source {
            Source::Tokens(tokens) => (tokens.len(), self.model.codebooks().quantizers()),
            Source::Embeddings(u) => (u.len(), self.model.decoder().code_width()),
            Source::Text(prompt) => {
                let Modules { text, planner, .. } = self.model.planning().ok_or(PlanningError::NoPlanner)?;
                let words = text.rows(&prompt)?;
                let plan = &request.planning;
                let tokens = plan.check(limit, planner.codes(), self.model.frames_per_token())?;
                let clauses = sequence::clauses(text, &prompt, plan).map_or(1, |clauses| clauses.len());
                let (steps, guided) = (plan.steps, plan.guided());
                let planning = planning::PlanningLimits { words, steps, guided, anchors: false, clauses };
                let (planning, rows) = (Some(planning), self.rows);
                return Ok(Limits { tokens, anchors: 0, tracked: 0, timeline: None, refinement, planning, rows });
            }
        };
        let tokens = numbers / each.max(1);
        if tokens == 0 || tokens > limit || !numbers.is_multiple_of(each.max(1)) {
            return Err(Error::Tokens { found: if tokens > limit { tokens } else { numbers }, limit });
        }
        let (planning, rows) = (None, self.rows);
        Ok(Limits { tokens, anchors: 0, tracked: 0, timeline: None, refinement, planning, rows })
    }

    /// Whether the planner would see any of `anchors`.
    fn seen(&self, anchors: &AnchorSet) -> bool {
        let control = self.model.control();
        control.is_some_and(|control| anchors.iter().any(|anchor| control.sees(anchor.family)))
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
        let mut anchors = AnchorSet::EMPTY;
        let limits = self.check(request, &mut anchors)?;
        let scale = bones::scale(&self.model, request.bones);
        if scale != 1.0 {
            // Planner and decoder know the model's own body alone.
            anchors.scale(1.0 / scale);
        }
        let needed = self.needed(&limits)?;
        let model = &self.model;
        let decoder = model.decoder();

        let mut arena = Arena::new(self.arena);
        // Nothing is planned that could not be decoded.
        let available = arena.available();
        let too_small = |_| Error::Arena(ArenaTooSmall { needed, available });
        if needed > available {
            return Err(Error::Arena(ArenaTooSmall { needed, available }));
        }
        let quantizers = model.codebooks().quantizers();
        let tokens = buffers::tokens(model, &limits, &mut arena).map_err(too_small)?;
        let mut peak = 0;
        #[cfg(feature = "timeline")]
        let directions = timeline::directions(&limits, &mut arena).map_err(too_small)?;
        #[cfg(feature = "timeline")]
        let spans = spans::read(model, (request, &limits), directions, (&mut arena, &mut peak), observer)?;
        let mut unconditioned = if linked(request.tracks).is_empty() { anchors.len() } else { limits.anchors } as u16;
        let heard = PromptStats::default();
        let mut made = Planned { tokens: limits.tokens, heard, then: Then::default(), parted: false };
        if let (Source::Text(prompt), Some(planning), Some(modules)) =
            (request.source, &limits.planning, model.planning())
        {
            let ends = linked(request.tracks).iter().filter_map(Track::last);
            let last = ends.chain(anchors.last_frame().map(usize::from)).max();
            #[cfg(feature = "timeline")]
            let last = last.max(request.timeline.iter().map(|span| span.end() - 1).max());
            let shortest = last.map_or(1, |frame| frame / model.frames_per_token().max(1) + 1);
            let task = PlanningTask {
                limits: planning,
                rows: limits.rows,
                prompt: &prompt,
                planning: &request.planning,
                shortest,
                capacity: limits.tokens,
                context: 0,
                clause: (0, 1),
                anchors: Some(&anchors).filter(|_| planning.anchors),
            };
            let mut overlay = arena.overlay();
            let used;
            (made, used) = match sequence::clauses(modules.text, &prompt, &request.planning) {
                Some(clauses) if !is_one_action(modules, &task, &clauses, &mut overlay.overlay(), observer)? => {
                    plan_clauses(modules, task, &clauses, &mut overlay, tokens, observer)?
                }
                _ => {
                    let made = plan_tokens(modules, task, &mut overlay, tokens, observer)?;
                    (made, overlay.used())
                }
            };
            peak = if peak > used { peak } else { used };
            if let (true, Some(control)) = (planning.anchors && !made.parted, model.control()) {
                unconditioned = anchors.iter().filter(|anchor| !control.sees(anchor.family)).count() as u16;
            }
            log::debug!("planned {} tokens", made.tokens);
        }
        if !linked(request.tracks).is_empty() {
            // Without the places of the tracks that were suggested to the planner.
            anchors.fill(request.anchors, model.frame_rate(), limits.tokens * model.frames_per_token())?;
            anchors.scale(1.0 / scale);
        }
        // A predicted length may be shorter than what the buffers are made for.
        let frames = made.tokens * model.frames_per_token();
        let tokens = part_mut!(tokens, ..made.tokens * quantizers);
        let Decoding { u, features, mut path, mut work, .. } =
            Decoding::take(model, &limits, &mut arena).map_err(too_small)?;
        let u = part_mut!(u, ..made.tokens * decoder.code_width());
        let tokens = embed(model, request.source, tokens, u)?;

        let mut refinement = None;
        if cfg!(feature = "refining") && limits.bends() {
            let config = limits.refinement;
            let mut overlay = arena.overlay();
            let scratch = buffers::solver(model, &limits, &mut overlay).map_err(too_small)?;
            peak = peak.max(overlay.used());
            let objective = Objective::new(&anchors, &config);
            let selected = channels(objective.joints());
            invariant!(features.len() >= 2 * frames * selected.count());
            let (values, gradient) = features.split_at_mut_checked(frames * selected.count()).unwrap_or_default();
            let mut map = DecoderMap {
                decoder,
                recovery: model.recovery(),
                channels: &selected,
                values,
                gradient,
                path: &mut path,
                work: &mut work,
                watch: Watch { observer, stage: Stage::Refining, evaluation: 0, evaluations: config.evaluations },
                tokens: made.tokens,
                limit: model.embedding_limit(),
                in_range: true,
            };
            refinement = match refining::solve(&mut map, u, &objective, &config, scratch) {
                Ok(report) => {
                    log::debug!("refined: {}", report);
                    Some(report)
                }
                Err(SolverError::Aborted) => return Err(Error::Aborted),
                Err(e) => return Err(Error::Solver(e)),
            };
        }

        let mut watch = Watch { observer, stage: Stage::Decoding, evaluation: 1, evaluations: 1 };
        let joints = decode(model, frames, (u, features, &mut path, &mut work), &mut watch)?;
        bones::pose(model, request.bones, joints);
        #[cfg(feature = "timeline")]
        spans::hold(request.timeline, directions, joints);
        if scale != 1.0 {
            anchors.fill(request.anchors, model.frame_rate(), limits.tokens * model.frames_per_token())?;
        }
        if cfg!(feature = "editing")
            && let Some(edited) =
                edit(model, (&limits, made.tokens), (request, &anchors), joints, &mut arena, &mut peak)
                    .map_err(too_small)?
        {
            if limits.anchors > 0 || limits.tracked > 0 {
                let report = Report::of_edit(refinement, edited, limits.refinement.stop_error);
                log::debug!("edited: {}", report);
                refinement = Some(report);
            }
        } else if let (Some(report), false) = (&mut refinement, request.bones == Bones::Decoded) {
            report.after = Some(control_error(&anchors, joints));
        }
        let arena_used = if peak > arena.used() { peak } else { arena.used() };
        log::debug!("decoded {} frames in {} arena bytes", frames, arena_used);
        let Planned { heard, then, parted, .. } = made;
        let frame_rate = model.frame_rate();
        Ok(Motion {
            joints,
            u,
            tokens,
            heard,
            then,
            parted,
            // Even an array of none would have the whole copied more often.
            #[cfg(feature = "timeline")]
            spans,
            unconditioned,
            frame_rate,
            refinement,
            arena_used,
        })
    }

    /// Runs the blob's self-test: decodes its token sequence, as a stream so that it needs less memory than a motion of that length, and
    /// compares the hash. `None`: the blob carries none.
    ///
    /// # Errors
    /// Any [`Error`] of the request.
    // Its own frame: the stream is not to lie on the stack of whoever asks, while motions are made.
    #[inline(never)]
    pub fn self_test(&mut self) -> Result<Option<bool>, Error> {
        let test = self.model.self_test();
        if test.hash == 0 {
            return Ok(None);
        }
        let mut tokens = [0u16; SELF_TEST_NUMBERS];
        let count = usize::from(test.tokens) * self.model.codebooks().quantizers();
        let limit = self.model.max_tokens();
        let tokens = tokens.get_mut(..count).ok_or(Error::Tokens { found: count, limit })?;
        let mut stream = crate::numerics::hash::Stream::new(u64::from(test.seed));
        for token in tokens.iter_mut() {
            *token = stream.below(self.model.codebooks().codes() as u32) as u16;
        }
        let mut hash = Fnv::default();
        let u = Arena::new(self.arena).take(self.model.decoder().code_width()).map_err(Error::Arena)?;
        for position in tokens.chunks_exact(self.model.codebooks().quantizers().max(1)) {
            self.model.codebooks().embed(position, u)?;
            hash = hash.f32s(u);
        }
        let request_error = |e| match e {
            StreamError::Request(e) => e,
            other => {
                invariant!(false, "the stream has as many tokens as it was made for: {other}");
                Error::Tokens { found: count, limit }
            }
        };
        let limits = StreamLimits { tokens: usize::from(test.tokens), planning: None, rows: ROWS };
        let mut motion = self.stream(&limits).map_err(request_error)?;
        motion.set_bones(Bones::Decoded).map_err(request_error)?;
        motion.push(tokens).map_err(request_error)?;
        motion.finish();
        while let Some(frames) = motion.frames(&mut ()).map_err(request_error)? {
            hash = hash.f32s(frames.as_flattened().as_flattened());
        }
        Ok(Some(hash.value() == test.hash))
    }
}

/// Decodes embeddings, the first of the buffers, to the joints of so many frames, `[T][22][3]` metres, in the place of the features.
#[inline]
fn decode<'f>(
    model: &Model<'_>,
    frames: usize,
    (u, features, path, work): (&[f32], &'f mut [f32], &mut Path<'_>, &mut Workspace<'_>),
    watch: &mut Watch<'_>,
) -> Result<&'f mut [f32], Error> {
    let all = channels(u32::MAX);
    let values = part_mut!(features, ..frames * all.count());
    if model.decoder().forward(u, &all, values, work, &mut || watch.ask_at_the_end()).is_break() {
        return Err(Error::Aborted);
    }
    let recovery = model.recovery();
    recovery.integrate(Features { values, channels: &all }, path);
    Ok(recovery.joints(values, path))
}

/// The tracks of a firmware that knows any: what takes them is left out with the feature.
const fn linked<'r>(tracks: &'r [Track<'r>]) -> &'r [Track<'r>] {
    if cfg!(feature = "tracks") { tracks } else { &[] }
}

/// How far joints, `[T][22][3]` metres, are from their anchors.
#[inline(never)]
fn control_error(anchors: &AnchorSet, joints: &[f32]) -> refining::ControlError {
    let (points, _) = joints.as_chunks::<3>();
    let at = |joint: u8, frame: usize| points.get(frame * JOINTS + usize::from(joint)).copied().unwrap_or_default();
    Distances::of(anchors, &at).control_error(anchors)
}

/// Edits the joints until they meet the anchors and feet stay where they stand, where the request asks for it.
#[inline(never)]
fn edit(
    model: &Model<'_>,
    (limits, made): (&Limits, usize),
    (request, anchors): (&Request<'_>, &AnchorSet),
    joints: &mut [f32],
    arena: &mut Arena<'_>,
    peak: &mut usize,
) -> Result<Option<Edited>, ArenaTooSmall> {
    // As many frames as there are, in the room for as many as there might have been.
    let used = arena.used() + Arena::measure(|arena| buffers::edit(model, limits, arena));
    let mut overlay = arena.overlay();
    let limits = Limits { tokens: made, ..*limits };
    let Some((exact, mut scratch)) = buffers::edit(model, &limits, &mut overlay)? else { return Ok(None) };
    *peak = if *peak > used { *peak } else { used };
    let (points, _) = joints.as_chunks_mut::<3>();
    let (poses, _) = points.as_chunks_mut::<JOINTS>();
    let Request { tracks, obstacles, .. } = *request;
    let rows = Rows { anchors, tracks, obstacles, frame_rate: model.frame_rate() };
    Ok(Some(match &mut scratch {
        EditScratch::Sparse(scratch) => motion_space::solve(poses, anchors, &exact, rows.frame_rate, scratch),
        #[cfg(feature = "tracks")]
        EditScratch::Dense(scratch) => motion_space::dense::follow(poses, &rows, &exact, scratch),
    }))
}

/// Fills `u` from tokens (the request's, or those that were planned) or embeddings. The tokens come back.
fn embed<'t>(model: &Model<'_>, source: Source<'_>, tokens: &'t mut [u16], u: &mut [f32]) -> Result<&'t [u16], Error> {
    match source {
        Source::Tokens(given) => {
            for (to, from) in tokens.iter_mut().zip(given) {
                *to = *from;
            }
        }
        Source::Text(_) => {}
        Source::Embeddings(values) => {
            let limit = model.embedding_limit();
            if let Some(index) = values.iter().position(|v| !(v.abs() <= limit)) {
                return Err(Error::Embedding { index });
            }
            for (to, from) in u.iter_mut().zip(values) {
                *to = *from;
            }
            return Ok(&[]);
        }
    }
    model.codebooks().embed(tokens, u)?;
    Ok(tokens)
}
