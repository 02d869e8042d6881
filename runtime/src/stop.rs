//! The one way to stop: whoever waits for a motion is asked at every layer boundary.

use core::ops::ControlFlow;

/// How work ends before its time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Stop {
    /// With the best so far. Refinement ends, the motion is decoded and returned. Planning ends with its last proposals; before there are
    /// any, as soon as the first step has made them. What is about to end anyway carries on.
    Finish,
    /// At once, and nothing is wanted of it.
    Abort,
}

/// Asked at every layer boundary whether to go on.
pub type Check<'c> = &'c mut dyn FnMut() -> ControlFlow<Stop>;
