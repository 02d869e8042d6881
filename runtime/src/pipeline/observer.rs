//! Who watches the work and may end it.

use crate::stop::Stop;
use core::ops::ControlFlow;

/// A stage of the work.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Stage {
    /// Reading the prompt.
    Reading,
    /// Planning tokens.
    Planning,
    /// Bending the motion onto its anchors.
    Refining,
    /// Decoding the final motion.
    Decoding,
}

/// How far the work is. Reported at every layer boundary.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Progress {
    /// The stage.
    pub stage: Stage,
    /// Decoder evaluations begun in this stage; when planning, steps.
    pub evaluation: u16,
    /// Decoder evaluations, or steps, this stage may take.
    pub evaluations: u16,
    /// Mean distance from the anchors of the evaluation that has just been completed, metres; reported once each.
    pub control_error: Option<f32>,
}

/// Watches the work and may end it at any layer boundary.
pub trait Observer {
    /// Called at every layer boundary; breaks off to [`Stop`].
    fn progress(&mut self, progress: Progress) -> ControlFlow<Stop> {
        let _ = progress;
        ControlFlow::Continue(())
    }

    /// Called behind every step of the planner, counted from 0, with the tokens it has left: of a prompt of several clauses those of the
    /// present one and the few in front of it that it sees.
    fn tokens(&mut self, step: u16, tokens: &[u16]) {
        let _ = (step, tokens);
    }
}

impl Observer for () {}

/// Asks the observer.
pub(super) struct Watch<'o> {
    /// Whom to ask.
    pub observer: &'o mut dyn Observer,
    /// The stage that is reported.
    pub stage: Stage,
    /// Evaluations begun.
    pub evaluation: u16,
    /// Evaluations there may be.
    pub evaluations: u16,
}

impl Watch<'_> {
    /// Reports progress.
    pub fn ask(&mut self) -> ControlFlow<Stop> {
        self.report(None)
    }

    /// The same, with what a completed evaluation gave.
    pub fn report(&mut self, control_error: Option<f32>) -> ControlFlow<Stop> {
        let Watch { stage, evaluation, evaluations, .. } = *self;
        self.observer.progress(Progress { stage, evaluation, evaluations, control_error })
    }

    /// The same where the work is about to end: [`Stop::Finish`] is granted by carrying on.
    pub fn ask_at_the_end(&mut self) -> ControlFlow<Stop> {
        match self.ask() {
            ControlFlow::Break(Stop::Finish) => ControlFlow::Continue(()),
            flow => flow,
        }
    }
}
