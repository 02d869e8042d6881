//! What a user asks for: prompts, joints by name, and the conditions that a motion must meet, checked.
//!
//! This layer knows frames, joints and words, of the stages below what may be set for each of them, and neither models nor memory.

pub mod conditions;
pub mod joint;
pub mod prompt;
pub mod timeline;

use crate::JOINTS;
use crate::generation::tokens::{Fixed, Length, Planning, Sampling, Schedule};
use crate::refining::Config;
use conditions::{AnchorList, AsAnchors, Obstacle, Track};
use prompt::Prompt;
use timeline::Span;

/// Where the motion comes from.
#[derive(Debug, Clone, Copy)]
pub enum Source<'r> {
    /// Motion tokens, `[L][Q]` for `Q` quantizers.
    Tokens(&'r [u16]),
    /// Token embeddings `u [L][du]`, as an earlier motion or a solver left them.
    Embeddings(&'r [f32]),
    /// Words: the planner makes the tokens, as [`Request::planning`] says.
    Text(Prompt<'r>),
}

/// The body that moves.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub enum Bones<'r> {
    /// The model's skeleton: every bone as long as it is there, in every frame.
    #[default]
    Model,
    /// A skeleton of one's own, a robot's: offset of each joint from its parent at rest `[22]`, metres, in the order and with the parents of
    /// [`representation::skeleton`](crate::representation::skeleton), y up, the left at +x; the pelvis has none. The motion's ways are as
    /// much longer or shorter as its legs are, and anchors are in its world.
    Given(&'r [[f32; 3]; JOINTS]),
    /// None: joints as they were decoded, whose distances change from frame to frame. For measuring.
    Decoded,
}

/// One motion to be made. Quantities are SI; the motion starts at the origin facing +z, anchors are in that frame.
#[derive(Debug, Clone, Copy)]
pub struct Request<'r> {
    /// Where the motion comes from.
    pub source: Source<'r>,
    /// Where it must pass: what the planner sees of a text's anchors, and what the refinement meets. Empty: neither.
    pub anchors: AnchorList<'r>,
    /// Where joints are to be at many frames; the planner sees some of their places as anchors. A refinement must be one that edits behind the
    /// decoder ([`Config::exact`], the default); without one tracks are for the planner alone.
    pub tracks: &'r [Track<'r>],
    /// What the figure keeps clear of, by the edit behind the decoder.
    pub obstacles: &'r [Obstacle<'r>],
    /// What parts of the body do instead, over spans of the motion, each with a prompt of its own. Planned as [`Request::planning`] says, with
    /// other seeds and the lengths of the spans; anchors, tracks and obstacles are met by what comes of all of it.
    pub timeline: &'r [Span<'r>],
    /// How it is bent there, and whether feet stay where they stand; `None` leaves the motion as it was decoded.
    pub refinement: Option<Config>,
    /// How tokens are planned; of no account for tokens and embeddings.
    pub planning: Planning<'r>,
    /// The body that moves.
    pub bones: Bones<'r>,
}

impl<'r> Request<'r> {
    /// The motion of `tokens`, without anchors.
    #[must_use]
    pub const fn tokens(tokens: &'r [u16]) -> Self {
        Request {
            source: Source::Tokens(tokens),
            anchors: AnchorList::Frames(&[]),
            tracks: &[],
            obstacles: &[],
            timeline: &[],
            refinement: Some(Config::DEFAULT),
            planning: Planning::DEFAULT,
            bones: Bones::Model,
        }
    }

    /// The motion of embeddings `u`, without anchors.
    #[must_use]
    pub const fn embeddings(u: &'r [f32]) -> Self {
        Request {
            source: Source::Embeddings(u),
            anchors: AnchorList::Frames(&[]),
            tracks: &[],
            obstacles: &[],
            timeline: &[],
            refinement: Some(Config::DEFAULT),
            planning: Planning::DEFAULT,
            bones: Bones::Model,
        }
    }

    /// The motion of a text, planned with the defaults of [`Planning`].
    #[must_use]
    pub const fn text(text: &'r str) -> Self {
        Self::prompt(Prompt::Text(text))
    }

    /// The motion of a prompt that the blob stores under `name`.
    #[must_use]
    pub const fn bank(name: &'r str) -> Self {
        Self::prompt(Prompt::Bank(name))
    }

    /// The motion of a prompt.
    #[must_use]
    pub const fn prompt(prompt: Prompt<'r>) -> Self {
        Request {
            source: Source::Text(prompt),
            anchors: AnchorList::Frames(&[]),
            tracks: &[],
            obstacles: &[],
            timeline: &[],
            refinement: Some(Config::DEFAULT),
            planning: Planning::DEFAULT,
            bones: Bones::Model,
        }
    }

    /// The same with another plan altogether.
    #[must_use]
    pub const fn planned(self, planning: Planning<'r>) -> Self {
        Request { planning, ..self }
    }

    /// The same, `length` long.
    #[must_use]
    pub const fn length(self, length: Length) -> Self {
        Request { planning: Planning { length, ..self.planning }, ..self }
    }

    /// The same, at least `frames` long, to the next whole token.
    #[must_use]
    pub const fn frames(self, frames: u16) -> Self {
        self.length(Length::Frames(frames))
    }

    /// The same with another seed.
    #[must_use]
    pub const fn seed(self, seed: u64) -> Self {
        Request { planning: Planning { seed, ..self.planning }, ..self }
    }

    /// The same in so many planner steps.
    #[must_use]
    pub const fn steps(self, steps: u16) -> Self {
        Request { planning: Planning { steps, ..self.planning }, ..self }
    }

    /// The same with another schedule.
    #[must_use]
    pub const fn schedule(self, schedule: Schedule) -> Self {
        Request { planning: Planning { schedule, ..self.planning }, ..self }
    }

    /// The same with another guidance; 1 is off.
    #[must_use]
    pub const fn guidance(self, guidance: f32) -> Self {
        Request { planning: Planning { guidance, ..self.planning }, ..self }
    }

    /// The same with proposals drawn in another way.
    #[must_use]
    pub const fn sampling(self, sampling: Sampling) -> Self {
        Request { planning: Planning { sampling, ..self.planning }, ..self }
    }

    /// The same with these tokens given.
    #[must_use]
    pub const fn fixed(self, fixed: &'r [Fixed]) -> Self {
        Request { planning: Planning { fixed, ..self.planning }, ..self }
    }

    /// The same with a planner that does not see the anchors: they only refine.
    #[must_use]
    pub const fn unconditioned(self) -> Self {
        Request { planning: Planning { conditioned: false, ..self.planning }, ..self }
    }

    /// The same with `anchors` ([`Anchors`](crate::Anchors), or a list of [`Anchor`](crate::Anchor)s) and the refinement that it has:
    /// without one ([`Request::unrefined`]), only the planner sees them.
    #[must_use]
    pub fn anchors<A: AsAnchors + ?Sized>(self, anchors: &'r A) -> Self {
        Request { anchors: anchors.as_anchors(), ..self }
    }

    /// The same with `anchors`, as [`Request::anchors`], bent onto them with the default refinement.
    #[must_use]
    pub fn through<A: AsAnchors + ?Sized>(self, anchors: &'r A) -> Self {
        self.anchors(anchors).refined(Config::default())
    }

    /// The same with these tracks.
    #[must_use]
    pub const fn tracks(self, tracks: &'r [Track<'r>]) -> Self {
        Request { tracks, ..self }
    }

    /// The same, clear of these obstacles.
    #[must_use]
    pub const fn obstacles(self, obstacles: &'r [Obstacle<'r>]) -> Self {
        Request { obstacles, ..self }
    }

    /// The same with these spans.
    #[must_use]
    pub const fn timeline(self, timeline: &'r [Span<'r>]) -> Self {
        Request { timeline, ..self }
    }

    /// The same with another body.
    #[must_use]
    pub const fn bones(self, bones: Bones<'r>) -> Self {
        Request { bones, ..self }
    }

    /// The same as it is decoded: anchors are for the planner alone, and feet are not kept where they stand.
    #[must_use]
    pub const fn unrefined(self) -> Self {
        Request { refinement: None, ..self }
    }

    /// The same with another refinement.
    #[must_use]
    pub const fn refined(self, refinement: Config) -> Self {
        Request { refinement: Some(refinement), ..self }
    }
}
