//! Text to motion tokens: a transformer proposes, a sampler moves noisy tokens towards the proposals.
//!
//! ```text
//! prompt ──► memory, pooled ──► keys and values a block      once a request, with guidance also of no text
//! anchors ─► scaffold ──► keys and values a block, rows' biases   once a request
//! z_0 random ──► pass ──► logits ──► proposals ──► z_1 ...    S steps, each position revisable throughout (TMD)
//! z_0 masked ──► pass ──► logits ──► proposals ──► z_1 ...    S steps, the least certain positions again (masked)
//!                row ──► logits ──► token, row ──► ...        a token at a time (autoregressive)
//! tokens ──► pass ──► tokens of the next quantizer ──► ...    a pass a quantizer (residual)
//! ```
//!
//! # The random stream
//! One [`Stream`](crate::numerics::hash::Stream) of the request's seed. TMD: first one `below(V)` a position in order: `z_0`. Then in each
//! step, positions in order: what the [`Sampling`] takes, one `unit()` for "change?", one `unit()` for the new token. All of
//! them are drawn for given tokens and in the last step as well, so that a stream's place depends on step and position alone.
//! Masked: in each step, positions in order, masked or not, what the [`Sampling`] takes. Autoregressive: what it takes, given tokens and
//! the end of the motion included. Residual, behind the planner of the first quantizer: quantizers, then positions in order.
//!
//! # Guidance
//! `none + g (conditioned - none)` of the logits, `conditioned` by text and anchors, `none` by neither: one pair guides towards
//! both (measured: anchors missed by a tenth less than when `none` knows them, FID and R-precision the same, and a cheaper
//! pass). The token layer is linear, so hidden rows are combined in its place: half the
//! work, one row a position to keep.
//!
//! This layer knows words' memory, anchors' scaffold and tokens. It does not know how tokens become motion.

pub mod condition;
pub mod head;
pub mod inputs;
pub mod length;
#[cfg(feature = "masked")]
pub mod masked;
pub mod request;
#[cfg(feature = "residual")]
pub mod residual;
pub mod sampler;
pub mod sampling;
pub mod schedule;
pub mod session;
pub mod tmd;
pub mod transformer;

pub use crate::conditioning::anchor_kv::AnchorControl;
pub use length::Length;
pub use request::{Fixed, Planning, PlanningError};
pub use sampler::{Sampler, TokenSampler};
pub use sampling::{Sampling, SamplingError};
pub use schedule::Schedule;
pub use session::{CONTEXT, PlanningBytes, PlanningLimits, SEED_STEP, Session};
pub use transformer::Planner;
