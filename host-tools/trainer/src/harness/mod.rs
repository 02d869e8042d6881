//! One harness for every training: options, state, loop, curves, resume.
//!
//! | module | what it does |
//! |---|---|
//! | [`options`] | the command line that all trainings share |
//! | [`configuration`] | what a training says about its configuration and about what is stored of a run |
//! | [`training`] | what a training does: a step, an evaluation, a checkpoint |
//! | [`state`] | everything a run needs to go on, as a file |
//! | [`curves`] | the course of a run as JSON and SVG |
//! | [`run`] | the loop: time limit, points, checkpoints, the end |
//! | [`progress`] | a bar on a terminal, lines elsewhere |
//!
//! A new training is one folder: a configuration that implements [`Configuration`], its data and networks that implement
//! [`Training`], and a command of [`Options`] and its own arguments. `harness/tests.rs` holds the smallest one.
//!
//! Random numbers need no state: a step draws from its seed and its number, so a resumed run equals an uninterrupted one.

pub mod configuration;
pub mod curves;
mod error;
pub mod options;
pub mod progress;
pub mod run;
pub mod state;
#[cfg(test)]
mod tests;
pub mod training;

pub use configuration::{Configuration, Extra, Figures, Sources};
pub use curves::{Curves, Evaluation};
pub use error::Error;
pub use options::{Length, Options};
pub use run::Run;
pub use state::{State, Update};
pub use training::{EvaluationOf, Means, Training};
