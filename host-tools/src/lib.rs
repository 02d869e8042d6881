//! Host side of motionette: data in, models converted and checked, motion out.
//!
//! | module | what it does |
//! |---|---|
//! | [`dataset`] | the one file a training run reads: joints, features, captions, splits, hashes |
//! | [`import`] | BVH, HumanML3D arrays and the motion-capture pack into a dataset |
//! | [`motion`] | skeleton tables, HumanML3D features from joints and back, mirroring, resampling |
//! | [`output`] | files that appear whole or not at all |
//! | [`parallel`] | work on all cores |
//! | [`checkpoint`] | tokenizer checkpoints: MoMask, T2M-GPT and our own, from safetensors or torch containers |
//! | [`reference`] | the plain-loop reference in f32 and f64: encoder, decoder, recovery, gradients, solver |
//! | [`cli`] | the `motionette` command line |
//!
//! Nothing here runs on a device and nothing here links the training framework. The reference road shares manifest types with
//! the runtime and no numerical code.

#![deny(unsafe_code)]

pub mod checkpoint;
pub mod cli;
pub mod dataset;
pub mod import;
pub mod motion;
pub mod output;
pub mod parallel;
pub mod reference;
