//! Measurements.

mod desktop;

pub use desktop::package;

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;

/// Options of `cargo xtask bench`.
#[derive(Args)]
pub struct Options {
    /// The runtime on this machine against candle and tract, which are compiled for it.
    #[arg(long)]
    desktop: bool,
    /// Write the result's page and JSON into this folder, e.g. docs/results.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print one machine-readable object as the last line.
    #[arg(long)]
    json: bool,
}

/// Runs the chosen measurement; without a choice that on this machine, the only one there is.
///
/// # Errors
/// When a build or a run fails.
pub fn run(options: &Options) -> Result<()> {
    let Options { desktop: _, out, json } = options;
    desktop::run(out.as_deref(), *json)
}
