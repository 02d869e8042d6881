//! `cargo xtask`: the one entry point for people and CI.
//!
//! It stays small because it is compiled before anything else: what needs the runtime or decodes device output lives in
//! the crates it starts (`motionette-twin`, `motionette-tests`).

mod firmware;
mod setup;
mod shell;
mod steps;
mod test;
mod toolchain;

use std::process::ExitCode;

use clap::{Parser, Subcommand};

/// Builds, tests and measures motionette.
#[derive(Parser)]
#[command(name = "cargo xtask", bin_name = "cargo xtask", version, about)]
struct Cli {
    #[command(subcommand)]
    task: Task,
}

#[derive(Subcommand)]
enum Task {
    /// Sets the machine up, then runs every check: format, lints, tests, firmware, digital twin, documentation.
    Test(test::Options),
    /// Runs the seeded requests on the desktop and on QEMU's Cortex-M4F, M7, M33 and M55, and compares every bit.
    Twin(steps::twin::Options),
    /// Feeds mutated blobs and hostile requests to the runtime; nothing may panic.
    Fuzz(steps::fuzz::Options),
    /// Counts instructions on emulated cores; with --desktop, times the runtime against other libraries instead.
    Bench(steps::bench::Options),
    /// Builds the bare-metal images for the Cortex-M4F, M7, M33 and M55, and the runtime for cores without FPU.
    Firmware,
    /// Builds and tests the C library and runs its example on QEMU's Cortex-M4F; the desktop must print the same.
    C(steps::c::Options),
    /// Lets three.js, bvhio and Khronos' glTF validator read what is exported and writes the fixture of the test `readers`.
    Readers,
}

fn main() -> ExitCode {
    let result = match Cli::parse().task {
        Task::Test(options) => test::run(&options),
        Task::Twin(options) => steps::twin::run(&options),
        Task::Fuzz(options) => steps::fuzz::run(&options),
        Task::Bench(options) => steps::bench::run(&options),
        Task::Firmware => firmware::build_all().map(drop),
        Task::C(options) => steps::c::run(&options),
        Task::Readers => steps::readers::run(),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error:#}");
            ExitCode::FAILURE
        }
    }
}
