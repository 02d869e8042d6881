//! Parts shared by the bare-metal images.
#![no_std]

pub mod stack;

#[cfg(feature = "bench")]
#[path = "../../src/standard_request.rs"]
pub mod standard_request;

#[cfg(feature = "twin")]
#[path = "../../src/twin.rs"]
pub mod twin;
