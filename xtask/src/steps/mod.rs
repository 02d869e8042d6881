//! Checks that are commands of their own as well as steps of `cargo xtask test`, and measurements.

pub mod bench;
pub mod c;
pub mod fuzz;
pub mod readers;
pub mod twin;
