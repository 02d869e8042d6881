//! The runtime as a C library: what [`motionette`] does, behind C types.
//!
//! `include/motionette.h` is made from this crate by cbindgen, documentation included; the README says how to link it.
//!
//! # Layers
//! - [`mod@error`]: results, what their numbers mean, messages.
//! - [`model`]: opening a blob, planning an arena.
//! - [`request`]: what is to be made, as C says it.
//! - [`conditions`]: tracks and obstacles of a request, as C says them.
//! - [`timeline`]: its prompts for parts of the body.
//! - [`generator`]: making it, watching it.
//! - `pointer`: what can be checked of a pointer, and storage that knows whether it was opened.
//!
//! # Input that C may get wrong
//! No type that comes from C has invalid bit patterns: choices are integers with named constants and are checked. Pointers are
//! checked for null, alignment and length, storage for having been opened.
#![no_std]
#![expect(non_camel_case_types, reason = "the names are those of the C header")]

// On a desktop the standard library brings the panic handler.
#[cfg(not(target_os = "none"))]
extern crate std;

// The header has their order.
pub mod error;
pub mod model;
pub mod request;

pub mod conditions;
pub mod timeline;

pub mod generator;

mod pointer;

#[cfg(target_os = "none")]
mod panic;

#[cfg(test)]
mod families;
#[cfg(test)]
#[expect(clippy::multiple_unsafe_ops_per_block, reason = "tests call function after function of the C interface")]
mod tests;
