//! Building the bare-metal images of `firmware-sim/cortex-m`.

use std::{
    path::{Path, PathBuf},
    process::Command,
};

use anyhow::{Context, Result};

use crate::{
    shell,
    toolchain::{RISCV, THUMB_V6, THUMB_V7, THUMB_V8, Toolchain},
};

/// ELF files of one target.
pub struct Images {
    /// Runs the seeded requests.
    pub twin: PathBuf,
    /// The runtime's public road and nothing else.
    pub check: PathBuf,
}

/// Folder of the images' package.
pub fn package() -> PathBuf {
    shell::root().join("firmware-sim/cortex-m")
}

/// Builds both images for `target`, with `blob` embedded (default: the bundled model).
///
/// # Errors
/// When the build fails.
pub fn build(toolchain: Toolchain, target: &str, blob: Option<&Path>) -> Result<Images> {
    let folder = package().join("target").join(toolchain.name());
    for image in ["twin", "check"] {
        let mut cargo = image_cargo(toolchain, "build", target, image, image);
        if let Some(blob) = blob {
            cargo.env("MOTIONETTE_BLOB", std::path::absolute(blob)?);
        }
        shell::run(&mut cargo)?;
    }
    let image = |name| folder.join(target).join("release").join(name);
    Ok(Images { twin: image("twin"), check: image("check") })
}

/// Links the check image with a panic handler that calls a symbol nobody defines: one reachable panic fails it.
fn refuse_panics(toolchain: Toolchain, target: &str) -> Result<()> {
    shell::run(&mut image_cargo(toolchain, "build", target, "check", "gate"))
        .context("code that a panic can be reached from is in the runtime (or the build failed); `cargo xtask twin` lists the call sites")
}

/// `cargo SUBCOMMAND` for one image with one feature, in release, into the toolchain's own folder.
pub fn image_cargo(toolchain: Toolchain, subcommand: &str, target: &str, image: &str, feature: &str) -> Command {
    let mut cargo = toolchain.cargo(subcommand, target);
    cargo.args(["--release", "--bin", image, "--features", feature, "--target-dir"]);
    cargo.arg(Path::new("target").join(toolchain.name())).current_dir(package());
    cargo
}

/// Compiles the runtime for a core without floating-point unit; nothing is linked or run.
fn build_runtime(toolchain: Toolchain, target: &str) -> Result<()> {
    let mut cargo = toolchain.cargo("build", target);
    cargo.args(["--release", "--package", "motionette", "--target-dir"]);
    cargo.arg(package().join("target").join(toolchain.name())).current_dir(shell::root());
    shell::run(&mut cargo)
}

/// Builds the images for the Cortex-M4F and M7 (one target) and the Cortex-M33, prints where they are, and compiles the
/// runtime for cores without floating-point unit.
///
/// # Errors
/// When no compiler for the targets can be had, a build fails, or a panic is reachable in the runtime.
pub fn build_all() -> Result<()> {
    let toolchain = Toolchain::ensure()?;
    for (core, target) in [("Cortex-M4F, M7", THUMB_V7), ("Cortex-M33", THUMB_V8)] {
        refuse_panics(toolchain, target)?;
        let images = build(toolchain, target, None)?;
        println!("{core}: {} and {}", relative(&images.twin), relative(&images.check));
    }
    for (core, target) in [("Cortex-M0, M0+", THUMB_V6), ("RISC-V without FPU", RISCV)] {
        build_runtime(toolchain, target)?;
        println!("{core}: the runtime compiles");
    }
    Ok(())
}

fn relative(path: &Path) -> String {
    path.strip_prefix(shell::root()).unwrap_or(path).display().to_string()
}
