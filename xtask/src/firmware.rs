//! Building the bare-metal images of `firmware-sim/cortex-m`.

use std::{
    fs,
    path::{Path, PathBuf},
    process::Command,
    thread,
};

use anyhow::{Context, Result, bail};

use crate::{
    shell,
    toolchain::{RISCV, THUMB_V6, THUMB_V7, THUMB_V8, Toolchain},
};

/// A core that images are built for.
pub struct Core {
    /// Short name, as the twin and the bench know it.
    pub name: &'static str,
    title: &'static str,
    /// Its target.
    pub target: &'static str,
    /// Feature that chooses its kernels, where the target does not.
    kernels: Option<&'static str>,
}

/// Cortex-M4F; its images run on the Cortex-M7 as well.
pub const M4: Core = Core { name: "m4", title: "Cortex-M4F, M7", target: THUMB_V7, kernels: None };
/// Cortex-M33 with the DSP extension.
pub const M33: Core = Core { name: "m33", title: "Cortex-M33", target: THUMB_V8, kernels: Some("dsp") };
/// Cortex-M55 with MVE, floating point included.
pub const M55: Core = Core { name: "m55", title: "Cortex-M55", target: THUMB_V8, kernels: Some("mve") };
/// All of them.
pub const CORES: [Core; 3] = [M4, M33, M55];

/// What a firmware may link of the runtime, as features of the check image, and the bytes that its code may take on a Cortex-M4F,
/// whichever compiler builds it.
struct FeatureSet {
    name: &'static str,
    features: &'static str,
    budget: u32,
}

/// Motions from text through anchors, without servos: what the check image links where nothing else is said.
const GENERATOR: &str = "generate,families";
const FEATURE_SETS: [FeatureSet; 10] = [
    FeatureSet { name: "all", features: "generate,families,playback", budget: 228 * 1024 },
    FeatureSet { name: "no playback", features: GENERATOR, budget: 198 * 1024 },
    FeatureSet {
        name: "no playback, tracks and obstacles",
        features: "generate,families,obstacles",
        budget: 225 * 1024,
    },
    FeatureSet { name: "no playback, timelines", features: "generate,families,timeline", budget: 205 * 1024 },
    FeatureSet {
        name: "no playback, tokens not bent",
        features: "generate,motionette/tmd,motionette/text,motionette/anchor-control,motionette/editing",
        budget: 172 * 1024,
    },
    FeatureSet {
        name: "no playback, no text",
        features: "generate,motionette/tmd,motionette/anchor-control,motionette/refining",
        budget: 184 * 1024,
    },
    FeatureSet { name: "no playback, no planner", features: "generate,motionette/refining", budget: 138 * 1024 },
    FeatureSet {
        name: "no playback, MoMask alone",
        features: "generate,motionette/residual,motionette/wide-layers,motionette/editing",
        budget: 174 * 1024,
    },
    FeatureSet {
        name: "no playback, T2M-GPT alone",
        features: "generate,motionette/autoregressive,motionette/wide-layers,motionette/editing",
        budget: 168 * 1024,
    },
    FeatureSet { name: "playback only", features: "playback", budget: 40 * 1024 },
];

/// The blob that a Pico 2 keeps two of.
const PICO2_BLOB: &str = "models/nano-pico2.blob";

/// Symbol that the gate's panic handler calls and nobody defines.
const UNDEFINED: &str = "a_panic_is_reachable";

/// Folder of the images' package.
pub fn package() -> PathBuf {
    shell::root().join("firmware-sim/cortex-m")
}

/// Builds `image` with the features that it needs for `core`, with `blob` embedded (default: the bundled model). Returns a
/// copy that builds for other cores leave alone.
///
/// # Errors
/// When the build fails.
pub fn build(toolchain: Toolchain, core: &Core, image: &str, blob: Option<&Path>) -> Result<PathBuf> {
    let mut cargo = image_cargo(toolchain, "build", core, image, features(image));
    if let Some(blob) = blob {
        cargo.env("MOTIONETTE_BLOB", std::path::absolute(blob)?);
    }
    shell::run(&mut cargo)?;
    keep(toolchain, core, (&package().join("target").join(toolchain.name()), image), image)
}

/// Builds the check image with the features of `set`, in a folder of its own so that another build may run beside it, and returns the copy.
fn link(toolchain: Toolchain, set: &FeatureSet) -> Result<PathBuf> {
    let folder = Path::new("target").join(format!("{}-sets", toolchain.name()));
    shell::run(&mut image_cargo_in(&folder, (toolchain, "build"), &M4, "check", set.features))?;
    keep(toolchain, &M4, (&package().join(folder), "check"), &set.name.replace([',', ' '], "-"))
}

/// Features that an image needs beside the core's own.
pub fn features(image: &str) -> &str {
    match image {
        "request" => "bench",
        "check" => GENERATOR,
        image => image,
    }
}

/// Copies the `image` that was built last in `folder` to where builds for other cores, or with other features, leave it alone.
fn keep(toolchain: Toolchain, core: &Core, (folder, image): (&Path, &str), name: &str) -> Result<PathBuf> {
    let images = package().join("target").join(toolchain.name()).join("images").join(core.name);
    fs::create_dir_all(&images).with_context(|| format!("cannot make {}", images.display()))?;
    let copy = images.join(name);
    let built = folder.join(core.target).join("release").join(image);
    fs::copy(&built, &copy).with_context(|| format!("cannot copy {} to {}", built.display(), copy.display()))?;
    Ok(copy)
}

/// Links the check image with a panic handler that calls a symbol nobody defines: one reachable panic fails it.
fn refuse_panics(toolchain: Toolchain, core: &Core) -> Result<()> {
    shell::run(&mut image_cargo(toolchain, "build", core, "check", "gate"))
        .context("code that a panic can be reached from is in the runtime (or the build failed); `cargo xtask twin` lists the call sites")
}

/// The gate must not link when an index that nobody checks is planted beside the runtime.
fn refuse_a_planted_panic(toolchain: Toolchain, core: &Core) -> Result<()> {
    let mut cargo = image_cargo(toolchain, "build", core, "check", "planted");
    let output = cargo.output().context("cannot start cargo")?;
    let message = String::from_utf8_lossy(&output.stderr);
    if output.status.success() {
        bail!("the gate links although a panic is reachable: it proves nothing");
    }
    if !message.contains(UNDEFINED) {
        bail!("the gate with a planted panic failed for another reason than its undefined symbol:\n{message}");
    }
    Ok(())
}

/// `cargo SUBCOMMAND` for one image with these features beside the core's own, in release, into the toolchain's own folder.
pub fn image_cargo(toolchain: Toolchain, subcommand: &str, core: &Core, image: &str, features: &str) -> Command {
    let folder = Path::new("target").join(toolchain.name());
    image_cargo_in(&folder, (toolchain, subcommand), core, image, features)
}

/// The same into a folder of the caller's choice.
fn image_cargo_in(
    folder: &Path,
    (toolchain, subcommand): (Toolchain, &str),
    core: &Core,
    image: &str,
    features: &str,
) -> Command {
    let mut cargo = toolchain.cargo(subcommand, core.target);
    cargo.args(["--release", "--bin", image, "--features", features]);
    cargo.args(core.kernels.map(|kernels| ["--features", kernels]).into_iter().flatten());
    cargo.arg("--target-dir").arg(folder).current_dir(package());
    cargo
}

/// Folder of the Pico 2's package.
pub fn pico2() -> PathBuf {
    shell::root().join("firmware-sim/boards/pico2")
}

/// `cargo SUBCOMMAND` for the Pico 2's image, in release, into the toolchain's own folder.
pub fn pico2_cargo(toolchain: Toolchain, subcommand: &str) -> Command {
    let mut cargo = toolchain.cargo(subcommand, THUMB_V8);
    cargo.args(["--release", "--target-dir"]).arg(Path::new("target").join(toolchain.name())).current_dir(pico2());
    cargo
}

/// Compiles runtime and device link for a core without floating-point unit; nothing is linked or run.
fn build_runtime(toolchain: Toolchain, target: &str) -> Result<()> {
    let mut cargo = toolchain.cargo("build", target);
    cargo.args(["--release", "--package", "motionette", "--package", "motionette-link", "--target-dir"]);
    cargo.arg(package().join("target").join(toolchain.name())).current_dir(shell::root());
    shell::run(&mut cargo)
}

/// Builds the images for all cores and the Pico 2, none of which may reach a panic.
fn build_images(toolchain: Toolchain) -> Result<()> {
    refuse_a_planted_panic(toolchain, &M4)?;
    for core in &CORES {
        refuse_panics(toolchain, core)?;
        let images = ["twin", "check"].map(|image| build(toolchain, core, image, None));
        for image in images {
            println!("{}: {}", core.title, relative(&image?));
        }
    }
    shell::run(&mut pico2_cargo(toolchain, "build"))
}

/// Builds the images for all cores, prints where they are, and compiles the runtime for cores without floating-point unit.
///
/// # Errors
/// When no compiler for the targets can be had, a build fails, or a panic is reachable in the runtime.
pub fn build_all() -> Result<()> {
    let toolchain = Toolchain::ensure()?;
    // Linking is the work of one processor, so two of them link side by side.
    let (sets, images) = thread::scope(|scope| {
        let sets = scope.spawn(|| FEATURE_SETS.iter().map(|set| link(toolchain, set)).collect::<Result<Vec<_>>>());
        let images = build_images(toolchain);
        (sets.join(), images)
    });
    images?;
    let Ok(sets) = sets else { bail!("linking the sets of features broke off") };
    let mut size = shell::cargo();
    size.args(["run", "--quiet", "--release", "--package", "motionette-twin", "--bin", "motionette-board", "--"]);
    let image = pico2().join("target").join(toolchain.name()).join(THUMB_V8).join("release/pico2");
    size.arg(&image).arg("models/nano.blob").args(["--slot", PICO2_BLOB]);
    for (set, linked) in FEATURE_SETS.iter().zip(sets?) {
        size.arg("--code").arg(format!("{}={}={}", set.name, set.budget, linked.display()));
    }
    println!("Raspberry Pi Pico 2: {}", relative(&image));
    shell::run(size.current_dir(shell::root()))?;
    for (core, target) in [("Cortex-M0, M0+", THUMB_V6), ("RISC-V without FPU", RISCV)] {
        build_runtime(toolchain, target)?;
        println!("{core}: runtime and link compile");
    }
    Ok(())
}

fn relative(path: &Path) -> String {
    path.strip_prefix(shell::root()).unwrap_or(path).display().to_string()
}
