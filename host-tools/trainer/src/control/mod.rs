//! Anchor control: what a frozen prior is told of anchors, trained (EQUATIONS sections 2 and 3).
//!
//! | module | what it does |
//! |---|---|
//! | [`config`] | sizes, variants, anchors, loss, schedule, presets |
//! | [`anchors`] | anchors drawn from real motion |
//! | [`model`] | scaffold encoder, AnchorKV, dual context; the baselines |
//! | [`loss`] | the distance of decoded motion from real motion around anchors |
//! | [`frozen`] | the prior and the tokenizer, which stay as they are |
//! | [`training`] | one step |
//! | [`sampling`] | tokens from these networks, for comparison |
//! | [`state`] | what a run belongs to and begins with |
//! | [`checkpoint`] | the finished control, as a file |
//! | [`validation`] | figures on motions that were not trained on |
//! | [`curves`] | points and diagrams of a run |
//! | [`command`] | `motionette-train control` |

pub mod anchors;
pub mod checkpoint;
pub mod command;
pub mod config;
pub mod curves;
pub mod frozen;
pub mod loss;
pub mod model;
pub mod sampling;
pub mod state;
#[cfg(test)]
mod tests;
pub mod training;
pub mod validation;

use crate::harness;

/// Why control cannot be trained.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The prior cannot be used.
    #[error("the prior cannot be used")]
    Prior(#[source] harness::Error),
    /// The tokenizer cannot be used.
    #[error("the tokenizer cannot be used")]
    Tokenizer(#[source] harness::Error),
    /// The prior plans the tokens of another tokenizer.
    #[error(
        "the prior was trained with tokenizer {wanted}, this one is {found}; give the tokenizer it was trained with"
    )]
    OtherTokenizer {
        /// Hash in the prior.
        wanted: String,
        /// Hash of the tokenizer.
        found: String,
    },
    /// Frozen weights are not what they were.
    #[error("the frozen {what} changed during training: {before} before, {after} after; this is a bug")]
    Thawed {
        /// Prior or decoder.
        what: &'static str,
        /// Hash before.
        before: String,
        /// Hash after.
        after: String,
    },
}
