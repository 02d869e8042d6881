//! The digital twin: same requests, same bits on the desktop and on emulated Cortex-M cores.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;

use crate::{
    firmware::{self, M4, M33, M55},
    setup, shell,
    toolchain::Toolchain,
};

/// The model that the images embed by default.
const BUNDLED_BLOB: &str = "models/nano.blob";

/// Options of `cargo xtask twin`.
#[derive(Args, Default)]
pub struct Options {
    /// Model to embed and run instead of the bundled one.
    #[arg(long, value_name = "FILE")]
    pub blob: Option<PathBuf>,
    /// Print what the images log.
    #[arg(long)]
    pub log: bool,
    /// Print one machine-readable object as the last line.
    #[arg(long)]
    pub json: bool,
}

/// Builds the images, runs them in QEMU and compares them with the desktop.
///
/// # Errors
/// When a tool is missing, a build or a run fails, or one bit differs.
pub fn run(options: &Options) -> Result<()> {
    setup::ensure(&[&setup::QEMU])?;
    let toolchain = Toolchain::ensure()?;
    let build = |core, image| firmware::build(toolchain, core, image, options.blob.as_deref());
    let mut compare = shell::cargo();
    compare.args(["run", "--quiet", "--package", "motionette-twin", "--bin", "motionette-twin", "--"]);
    compare.arg("--image").arg(build(&M4, "twin")?).arg("--m33-image").arg(build(&M33, "twin")?);
    compare.arg("--m55-image").arg(build(&M55, "twin")?).arg("--check").arg(build(&M4, "check")?);
    let blob = options.blob.clone().unwrap_or_else(|| shell::root().join(BUNDLED_BLOB));
    compare.arg("--blob").arg(std::path::absolute(blob)?);
    compare.args(options.log.then_some("--log")).args(options.json.then_some("--json"));
    shell::run(&mut compare)
}
