//! Running the bare-metal images of `firmware-sim/cortex-m` in QEMU, and reading what they and the linker left behind.

pub mod image;
pub mod log;
pub mod qemu;
pub mod report;
