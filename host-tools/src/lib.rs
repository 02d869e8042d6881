//! Host side of motionette: data in, models converted and checked, motion out.
//!
//! | module | what it does |
//! |---|---|
//! | [`dataset`] | the one file a training run reads: joints, features, captions, splits, hashes |
//! | [`import`] | BVH, HumanML3D arrays and the motion-capture pack into a dataset |
//! | [`motion`] | skeleton tables, HumanML3D features from joints and back, mirroring, resampling |
//! | [`input`] | files read whole, with an end to it |
//! | [`output`] | files that appear whole or not at all |
//! | [`console`] | what a program says, and whether it could be said |
//! | [`parallel`] | work on all cores |
//! | [`checkpoint`] | tokenizer checkpoints: MoMask, T2M-GPT and our own, from safetensors or torch containers |
//! | [`mod@reference`] | the plain-loop reference in f32 and f64: encoder, decoder, recovery, gradients, solver |
//! | [`blob`] | the model blob on the host: written, opened and checked, its table walked, its layers as integers |
//! | [`convert`] | quantisation: from checkpoints to a blob |
//! | [`export`] | motions in files that other programs read: BVH, glTF, servo timelines |
//! | [`servos`] | what a robot's servos make of a motion |
//! | [`robot_file`] | `robot.toml`: servos, what they follow and what they may do |
//! | [`anchors_file`] | `anchors.json`: where the motion must pass |
//! | [`scene_file`] | tracks, where joints are at many frames, obstacles, which the figure keeps clear of, and timelines of parts of the body |
//! | [`followed`] | what came of tracks and obstacles, as figures and in words |
//! | [`spans`] | what was understood of a timeline's spans, and what to do about one that is refused |
//! | [`entries`] | lists of objects in JSON files, read so that complaints name entry and field |
//! | [`metrics`] | figures of a motion: jerk, foot skating, joint errors, control error |
//! | [`agreement`] | how far two motions are apart |
//! | [`mod@detect`] | what a body was seen to do, from joints alone |
//! | [`inspect`] | what is in a blob |
//! | [`plan`] | arena, flash and work of a request before anything is flashed |
//! | [`mod@verify`] | the quantised runtime against the reference |
//! | [`device`] | a robot at the other end of a line: ports, requests, repetition |
//! | [`cli`] | the `motionette` command line |
//!
//! Nothing here runs on a device and nothing here links the training framework. The reference shares manifest types with
//! the runtime and no numerical code.

#![deny(unsafe_code)]

pub mod agreement;
pub mod anchors_file;
pub mod blob;
pub mod checkpoint;
pub mod cli;
pub mod console;
pub mod convert;
pub mod dataset;
pub mod detect;
pub mod device;
pub mod entries;
pub mod export;
pub mod followed;
pub mod import;
pub mod input;
pub mod inspect;
pub mod metrics;
pub mod motion;
pub mod output;
pub mod parallel;
pub mod plan;
pub mod reference;
pub mod robot_file;
pub mod scene_file;
pub mod servos;
pub mod spans;
pub mod verify;
