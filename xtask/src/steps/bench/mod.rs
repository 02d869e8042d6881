//! Measurements: instructions on emulated cores, and time on this machine.

mod cortex_m;
mod desktop;

pub use desktop::package;

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;

/// Options of `cargo xtask bench`.
#[derive(Args)]
pub struct Options {
    /// Time the runtime on this machine against candle and tract, which are compiled for it, instead of counting instructions.
    #[arg(long)]
    desktop: bool,
    /// List the functions in which the standard request's instructions are spent on the Cortex-M4F.
    #[arg(long, conflicts_with = "desktop")]
    profile: bool,
    /// Write the result's page and JSON into this folder, e.g. docs/results.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print one machine-readable object as the last line.
    #[arg(long)]
    json: bool,
}

/// Runs the chosen measurement.
///
/// # Errors
/// When a tool is missing, or a build or a run fails.
pub fn run(options: &Options) -> Result<()> {
    let Options { desktop, profile, out, json } = options;
    if *desktop { desktop::run(out.as_deref(), *json) } else { cortex_m::run(*profile, out.as_deref(), *json) }
}
