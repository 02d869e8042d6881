//! Published planners as they are published: networks, and how tokens are drawn from them. Plain loops over whole sequences.
//!
//! Random numbers come from a closure that is asked in the published order, so that a run can be repeated with recorded ones.
//!
//! | file | what |
//! |---|---|
//! | [`momask`] | mask and residual transformer |
//! | [`t2mgpt`] | T2M-GPT's transformer |
//! | [`draw`] | filtered and noisy choices |
//! | [`masked`] | confidence re-masking, as it is published |
//! | [`residual`] | one pass for each further layer of codes |
//! | [`autoregressive`] | a token at a time until the stop class |

pub mod autoregressive;
pub mod draw;
pub mod masked;
pub mod momask;
pub mod residual;
pub mod t2mgpt;

pub use momask::{Mask, Residual};
pub use t2mgpt::Gpt;
