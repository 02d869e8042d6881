//! Training of motionette's models. The automatic differentiation framework lives here and nowhere else.
//!
//! | module | what it does |
//! |---|---|
//! | [`tokenizer`] | the motion tokenizer: a VQ-VAE |
//! | [`prior`] | text encoder and planner: tokens from text |
//! | [`control`] | anchors as a condition of a frozen prior |
//! | [`evaluator`] | the judge of generated motion |
//! | [`harness`] | what all trainings have in common: options, state, loop, curves, resume |
//! | [`evaluate`] | tables of figures of generated motion |
//! | [`convolution`], [`transformer`] | layers on the framework |
//! | [`optimizer`] | AdamW with averaged weights |
//! | [`schedule`] | learning rate, end of a run |
//! | [`setting`] | settings that are out of range |
//! | [`chart`] | line diagrams |
//! | [`normalization`] | mean and deviation of features |
//! | [`tensor_file`] | named tensors and text as safetensors |
//! | [`random`] | random numbers by seed and step |
//!
//! A run is decided by its configuration, its dataset and the number of steps; all three are part of a checkpoint. Steps do not
//! depend on what ran before in the same process, so a resumed run gives the same weights as one that was never interrupted.

#![deny(unsafe_code, clippy::too_many_arguments)]

pub mod chart;
pub mod control;
pub mod convolution;
pub mod evaluate;
pub mod evaluator;
pub mod harness;
pub mod normalization;
pub mod optimizer;
pub mod prior;
pub mod random;
pub mod schedule;
pub mod setting;
pub mod tensor_file;
#[cfg(test)]
mod testing;
pub mod tokenizer;
pub mod transformer;
