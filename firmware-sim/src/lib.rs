//! A virtual robot on the desktop that runs the embedded runtime and checks it against the reference.
//!
//! | module | what it does |
//! |---|---|
//! | [`demo`] | the main job: a request through runtime, robot loop and reference, results in a folder |
//! | [`sample_clips`] | the token sequences of real test motions that come with the simulator, and how they are made |
//! | [`default_model`] | the model that is built in: its blob and its checkpoints |
//! | [`source`] | what a request is made from: a prompt, a sample clip or the user's BVH file |
//! | [`session`] | one request through the runtime, watched: timings, memory, control-error curve |
//! | [`intervals`] | the intervals between anchors and their activity |
//! | [`robot`] | the simulated robot: buses, chips, servos, faults, in virtual time |
//! | [`serve`] | the simulated robot behind a TCP port, with the device link of a board |
//! | [`report`] | the figures of a run, as text, markdown and JSON |
//! | [`viewer`] | the self-contained HTML page |
//! | [`standard_request`] | the standard request of the budgets, counted on the desktop and on emulated cores |
//! | [`twin`] | the requests that desktop and emulated Cortex-M run alike |

pub mod default_model;
pub mod demo;
pub mod intervals;
mod planners;
pub mod report;
pub mod robot;
pub mod sample_clips;
pub mod serve;
pub mod session;
pub mod source;
pub mod standard_request;
pub mod twin;
pub mod viewer;
