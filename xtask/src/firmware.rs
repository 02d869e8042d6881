//! Building the bare-metal images of `firmware-sim/cortex-m`.

use std::path::{Path, PathBuf};

use anyhow::Result;

use crate::{
    shell,
    toolchain::{THUMB_V7, THUMB_V8, Toolchain},
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
/// When no compiler for the target can be had or the build fails.
pub fn build(toolchain: Toolchain, target: &str, blob: Option<&Path>) -> Result<Images> {
    let folder = package().join("target").join(toolchain.name());
    for image in ["twin", "check"] {
        let mut cargo = toolchain.cargo("build", target);
        cargo.args(["--release", "--locked", "--bin", image, "--features", image]);
        cargo.arg("--target-dir").arg(&folder).current_dir(package());
        if let Some(blob) = blob {
            cargo.env("MOTIONETTE_BLOB", std::path::absolute(blob)?);
        }
        shell::run(&mut cargo)?;
    }
    let image = |name| folder.join(target).join("release").join(name);
    Ok(Images { twin: image("twin"), check: image("check") })
}

/// Builds the images for the Cortex-M4F and M7 (one target) and the Cortex-M33, and prints where they are.
///
/// # Errors
/// As [`build`].
pub fn build_all() -> Result<()> {
    let toolchain = Toolchain::ensure()?;
    for (core, target) in [("Cortex-M4F, M7", THUMB_V7), ("Cortex-M33", THUMB_V8)] {
        let images = build(toolchain, target, None)?;
        println!("{core}: {} and {}", relative(&images.twin), relative(&images.check));
    }
    Ok(())
}

fn relative(path: &Path) -> String {
    path.strip_prefix(shell::root()).unwrap_or(path).display().to_string()
}
