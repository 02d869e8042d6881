//! The runtime against other inference libraries, in a package of its own that nothing else compiles.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};

use crate::{
    setup::{self, HOST_C_COMPILER},
    shell,
};

/// The package, which is not in the workspace.
pub fn package() -> PathBuf {
    shell::root().join("benchmarks/desktop")
}

/// Builds the package for this processor and runs it.
///
/// # Errors
/// When the compiler is missing, a library cannot be fetched or computes something else than the reference, or the result
/// cannot be written.
pub fn run(out: Option<&Path>, json: bool) -> Result<()> {
    // It assembles tract's kernels.
    setup::ensure(&[&HOST_C_COMPILER])?;
    let mut bench = shell::cargo();
    // The package has its own build folder; other flags would rebuild the caller's.
    bench.env_remove("CARGO_TARGET_DIR").env("RUSTFLAGS", "-Ctarget-cpu=native");
    bench.args(["run", "--release", "--locked", "--manifest-path"]);
    bench.arg(package().join("Cargo.toml")).arg("--");
    if let Some(out) = out {
        bench.arg("--out").arg(std::path::absolute(out).context("--out")?);
    }
    bench.args(json.then_some("--json"));
    shell::run(&mut bench)
}
