//! Instructions of layers and of the standard request on QEMU's Cortex-M4F, M7, M33 and M55.

use std::path::Path;

use anyhow::{Context, Result, bail};

use crate::{
    firmware::{self, CORES, M4},
    setup::{self, HOST_C_COMPILER},
    shell,
    toolchain::Toolchain,
};

/// The bundled model, which the images embed.
const BLOB: &str = "models/nano.blob";

/// Builds images and counting plugin, runs them and reports.
///
/// # Errors
/// When a tool is missing, a build or a run fails, or cores differ in their kernels' or the motion's bits.
pub fn run(profile: bool, out: Option<&Path>, json: bool) -> Result<()> {
    setup::ensure(&[&setup::QEMU, &HOST_C_COMPILER])?;
    let toolchain = Toolchain::ensure()?;
    let mut bench = shell::cargo();
    bench.args(["run", "--quiet", "--release", "--package", "motionette-twin", "--bin", "motionette-bench", "--"]);
    for core in &CORES {
        for (option, image) in [("--bench", "bench"), ("--request", "request")] {
            let built = firmware::build(toolchain, core, image, None)?;
            bench.arg(option).arg(format!("{}={}", core.name, built.display()));
        }
    }
    bench.arg("--check").arg(firmware::build(toolchain, &M4, "check", None)?);
    bench.arg("--plugin").arg(plugin()?).arg("--blob").arg(shell::root().join(BLOB));
    bench.arg("--macs").arg(macs()?).arg("--desktop").arg(shell::root().join("docs/results/desktop.json"));
    bench.args(profile.then_some("--profile")).args(json.then_some("--json"));
    if let Some(out) = out {
        bench.arg("--out").arg(std::path::absolute(out).context("--out")?);
    }
    shell::run(&mut bench)
}

/// Compiles the counting plugin.
fn plugin() -> Result<std::path::PathBuf> {
    let compiler = HOST_C_COMPILER.programs.iter().find(|name| shell::find(name).is_some()).context("no C compiler")?;
    let plugin = shell::root().join("target/libcount.so");
    std::fs::create_dir_all(shell::root().join("target"))?;
    let mut cc = std::process::Command::new(compiler);
    cc.args(["-O2", "-Wall", "-Wextra", "-fPIC", "-shared", "-o"]).arg(&plugin);
    shell::run(cc.arg(shell::root().join("firmware-sim/twin/count.c")))?;
    Ok(plugin)
}

/// Multiply-accumulates of the standard request, planned and counted: the last line of a program that runs it here.
fn macs() -> Result<String> {
    let mut counted = shell::cargo();
    counted.args(["run", "--quiet", "--release", "--package", "motionette-tests", "--bin", "counted", "--", BLOB]);
    let mut last = String::new();
    if !shell::lines(counted.current_dir(shell::root()), |line| line.clone_into(&mut last))? {
        bail!("the standard request could not be counted: {last}");
    }
    Ok(last)
}
