//! Parts shared by the bare-metal images.
#![no_std]

pub mod stack;

#[cfg(feature = "bench")]
#[path = "../../src/standard.rs"]
pub mod standard;

#[cfg(feature = "twin")]
#[path = "../../src/twin.rs"]
pub mod twin;
