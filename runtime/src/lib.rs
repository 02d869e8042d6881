//! Motion generation that runs inside the robot.
//!
//! A firmware author opens a model blob in flash, hands over one static buffer and a text, and gets full-body motion that
//! passes through anchors, in bounded time, with the same bits on every machine.
//!
//! ```text
//! request ──► text, conditioning ──► generation ──► codec ──► representation ──► motion ──► playback ──► servos
//! prompt,     words' memory,         tokens by      VQ        HumanML3D:         22 joints
//! anchors     anchors' scaffold      TMD            decoder   263 channels
//!                                                   ▲    │
//!                                                   └────┴─ refining: bends embeddings until joints meet the anchors
//! ```
//!
//! # Rooms, top-down, and what each may not know
//! What firmware needs stands at the root of the crate, in [`blob`], [`refining`] and [`playback`]. The other rooms are seen by tests and tools,
//! with feature `internals`, and may change in any release.
//!
//! - `pipeline`: runs a request through the stages, or a motion that goes on segment by segment, and plans its bytes and work
//!   beforehand. Owns the arena; knows every room below, none knows it.
//! - `request`: what a user asks for: prompts, joints by name, anchors in frames or seconds, checked, and how each stage is to go
//!   about it. Knows no model.
//! - `text`: prompts to memory rows: words, vocabulary, stored prompts, encoder. Knows words, no motion.
//! - `conditioning`: anchors as a planner sees them: scaffold, its encoder, keys and values. Knows anchors and networks.
//! - `generation`: a family of generators each. `generation::tokens`: transformer, session and samplers
//!   (trait `TokenSampler` is the seam for another one). Does not know what a token moves.
//! - `codec`: tokens to features of the representation, and the gradient back (trait `Decode` is the seam). Knows nothing of
//!   anchors.
//! - `representation`: features to joints, and the gradient back (trait `Recover` is the seam); the skeleton. Knows
//!   neither generator nor networks.
//! - [`refining`]: the anchor solver: an objective of terms, a basis, methods. Knows a differentiable [`refining::MotionMap`], not the
//!   decoder behind it.
//! - [`playback`]: motions onto servos: inverse kinematics, fades, limits, outputs, a verified start. Knows joints and frames, not how
//!   they were made.
//! - `nn`: layers with forward and input gradient, and their configurations. Know nothing of the model they stand in.
//! - `kernels`: integer inner loops; the portable ones are the specification.
//! - `model`: a blob opened and resolved to its rooms, each checked on its own. After [`Model::open`] nothing about it can fail.
//! - [`blob`]: the model file: format, manifest, checked zero-copy views.
//! - `memory`: the one allocator over the caller's bytes; the same declarations, measured, are the plan.
//! - `channels`: which features are wanted, the one word that codec and representation share.
//! - `numerics`: angles, hashes, the seeded random stream. `stop`: the one way to end work before its time.
//!
//! # Example
//! ```no_run
//! use motionette::blob::Aligned;
//! use motionette::{Anchors, Generator, Joint, Model, Request};
//!
//! // Any 16-byte aligned bytes in flash.
//! static BLOB: &Aligned<[u8]> =
//!     &Aligned(*include_bytes!(concat!(env!("CARGO_MANIFEST_DIR"), "/../models/nano.blob")));
//!
//! # fn run(arena: &'static mut [u8]) -> Result<(), Box<dyn core::error::Error>> {
//! let model = Model::open(&BLOB.0)?; // checks everything, once
//! let mut generator = Generator::new(model, arena)?;
//! let tokens = [117, 204, 407, 13, 227, 418, 370, 83];
//! // Seconds and metres: the pelvis half a metre ahead after 1.4 s, the hand up before that.
//! let anchors =
//!     Anchors::new().root_at(1.4, [0.1, 0.9, 0.5]).joint_at(0.8, Joint::RightWrist, [-0.3, 1.4, 0.4]);
//! let motion = generator.generate(&Request::tokens(&tokens).through(&anchors), &mut ())?;
//! // With a planner in the blob: `Request::text("a person waves").frames(100).seed(7)` instead of `tokens`.
//! for frame in motion.frames() {
//!     let _wrist = frame[Joint::RightWrist.index()]; // metres, 20 frames a second
//! }
//! # Ok(())
//! # }
//! ```
//!
//! # Features
//! `default = []`. Families, each linked only where it is named, so that a firmware carries what its blob needs: `vq` (the decoder),
//! `tmd` (its planner), `anchor-control` (of the planner), `text` (the encoder; without it a planner takes prompts stored in the blob),
//! `masked`, `residual` and `autoregressive` (planners that are given a vector: MoMask's, T2M-GPT's), `wide-layers` (weights of 16 bits),
//! `editing` (anchors met exactly, planted feet), `refining` (and motions bent onto anchors), `tracks` (joints led at every frame), `obstacles` (and
//! bodies to keep clear of), `timeline` (prompts for parts of the body), `playback` (servos); `all` of them. On a Cortex-M4F
//! what the default model needs is 227 KiB of code, without playback 198, without text as well 183, `vq` and `refining` alone 135, `playback` alone
//! 35; `masked` adds 5 KiB, `residual` 6 more, `autoregressive` 5, `wide-layers` 8, `tracks` 18, `obstacles` 9 more, `timeline` 7. A blob that needs a family which
//! is not linked is refused by [`Model::open`] with that family's name, a request by
//! [`Error::NotLinked`]. The interface is the same whatever is linked, but for [`playback`].
//!
//! `defmt`: `defmt::Format` on public types and progress messages; off it costs zero bytes.
//! `dsp`, `mve`: kernels for Armv8-M cores that have the DSP extension (most Cortex-M33) or MVE with floating point (Cortex-M55); Armv7E-M
//! (Cortex-M4, M7) and x86-64 need no feature, other targets take no notice. `check-kernels`: `kernels` come with the runner
//! that compares them with the portable ones on a device. `count`: they count multiply-accumulates, for tests of plans.
//! `invariants`: what cannot be panics instead of carrying on, for tests and check builds.
//! `internals`: all rooms are public, for tests and tools.
//! `pwm`, `pca9685`, `sts3215`: outputs of [`playback`], on `embedded-hal` and `embedded-io`.
//!
//! # Numerics
//! Weights int8 (root rows int16), activations int16, accumulators int32; floating point only as single IEEE
//! operations in a written order, so that every target computes the same bits.
#![no_std]
#![deny(unsafe_code)]
#![allow(rustdoc::private_intra_doc_links)]
// Rooms that nobody outside sees hold more than one set of features uses; with `internals` the lint sees all of it.
#![cfg_attr(not(feature = "internals"), allow(dead_code, unused_imports))]

#[cfg(test)]
extern crate std;

#[cfg(target_endian = "big")]
compile_error!("motionette reads little-endian weights in place; big-endian targets are not supported");

#[macro_use]
mod invariant;

// What firmware needs of these rooms stands at the root; tests and tools see the rooms themselves.
mod rooms;
#[cfg(feature = "internals")]
#[doc(hidden)]
pub use rooms::*;
#[cfg(not(feature = "internals"))]
use rooms::*;

pub mod blob;
mod log;
#[cfg(feature = "playback")]
pub mod playback;
pub mod refining;

pub use generation::tokens::request::MAX_STEPS;
pub use generation::tokens::{
    Fixed, Length, Planning, PlanningBytes, PlanningError, PlanningLimits, Sampling, SamplingError, Schedule,
};
#[cfg(feature = "check-kernels")]
pub use kernels::check as check_kernels;
pub use memory::ArenaTooSmall;
pub use model::{CargoFeature, InWords, Model, cargo_features};
pub use nn::linear::{LEAST_ROWS, MOST_ROWS};
pub use numerics::hash::motion as motion_hash;
pub use pipeline::plan::{Limits, Plan, PlanError, ROWS, StreamLimits, StreamPlan, TimelineLimits};
pub use pipeline::{Error, Frame, Generator, Motion, MotionStream, Observer, Progress, Segment, Stage, StreamError};
pub use request::conditions::{
    ALL_JOINTS, Anchor, AnchorError, AnchorList, Anchors, AsAnchors, Course, FARTHEST, FASTEST_OBSTACLE, Family,
    Keyframe, MAX_ANCHORS, MAX_OBSTACLES, MAX_TRACKS, Obstacle, ObstacleError, Shape, Target, Track, TrackError,
};
pub use request::joint::{Joint, NoSuchJoint};
pub use request::prompt::{Prompt, PromptError, PromptStats};
pub use request::timeline::{BodyParts, LEAST_SPAN, LINKED_SPANS, MAX_SPANS, Span, TimelineError};
pub use request::{Bones, Request, Source};
pub use stop::Stop;
pub use text::clauses::{Clauses, MAX_CLAUSES};
pub use text::meaning::{Guess, NEAREST, Understood};
pub use text::words::{MAX_PROMPT, MAX_WORD, Word, Words};

/// Joints of the body skeleton (SMPL order, see [`representation::skeleton`]).
pub const JOINTS: usize = 22;
