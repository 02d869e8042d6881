//! The C library `bindings/c`: its tests and header, and its example on an emulated Cortex-M4F against the desktop.

use std::{
    fs,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context, Result, bail};
use clap::Args;

use crate::{
    setup,
    shell::{self, capture, find},
    toolchain::{TARGETS, THUMB_V7, Toolchain},
};

/// Options of `cargo xtask c`.
#[derive(Args, Default)]
pub struct Options {
    /// Write the C header anew instead of comparing it.
    #[arg(long)]
    write_header: bool,
}

/// Longest time that the example may take in QEMU.
const LIMIT: Duration = Duration::from_secs(180);
/// Sources of the example, in the library's package.
const SOURCES: [&str; 4] = ["walk.c", "qemu/start.c", "qemu/console.c", "qemu/blob.S"];

/// Sets of the library's features that each lack a family of the bundled model, or what its requests need.
const FEATURE_SETS: [&str; 6] =
    ["", "vq", "vq,tmd", "vq,tmd,anchor-control", "vq,tmd,anchor-control,text", "vq,tmd,anchor-control,text,editing"];

/// Folder of the library's package.
pub fn package() -> PathBuf {
    shell::root().join("bindings/c")
}

/// Tests the library, builds it with its example, and compares what the example prints in QEMU and on the desktop.
///
/// # Errors
/// When a tool is missing, a test or build fails, a panic is reachable, the header is out of date, or one bit differs.
pub fn run(options: &Options) -> Result<()> {
    let mut test = host_cargo("test");
    if options.write_header {
        return shell::run(test.args(["--test", "header"]).env("MOTIONETTE_WRITE_HEADER", "1"));
    }
    setup::ensure(&[&setup::QEMU, &setup::C_COMPILER])?;
    let toolchain = Toolchain::ensure()?;
    shell::run(&mut test)?;
    for features in FEATURE_SETS {
        let mut test = host_cargo("test");
        shell::run(test.args(["--lib", "--no-default-features", "--features", features, "families::"]))?;
    }

    let image = link(&build_library(toolchain, None)?, "walk.elf", "-Wl,--gc-sections")?;
    // Without the collection of unused sections every function of the library is linked, and so is any panic.
    link(&build_library(toolchain, Some("gate"))?, "gate.elf", "-Wl,--no-gc-sections")
        .context("code that a panic can be reached from is in the library")?;

    let desktop = capture(host_cargo("run").args(["--quiet", "--example", "walk"]));
    let desktop =
        desktop.context("the example failed on the desktop: cargo run --example walk in bindings/c says why")?;
    let device = emulate(&image)?;
    print!("{device}");
    // Behind what the desktop prints too, the device says what it took.
    let printed = device.split("image:").next().unwrap_or_default().trim_end();
    if printed != desktop {
        bail!("the device prints other lines than the desktop, which printed:\n{desktop}");
    }
    println!("desktop and Cortex-M4F print the same");
    Ok(())
}

/// Lints the library for the desktop, tests included, and for every device.
///
/// # Errors
/// When a lint warns.
pub fn clippy(toolchain: Toolchain) -> Result<()> {
    let deny = ["--", "--deny", "warnings"];
    shell::run(host_cargo("clippy").arg("--all-targets").args(deny))?;
    TARGETS.iter().try_for_each(|target| shell::run(device_cargo(toolchain, "clippy", target).args(deny)))
}

/// Builds the library's documentation.
///
/// # Errors
/// When rustdoc warns.
pub fn docs() -> Result<()> {
    shell::run(host_cargo("doc").arg("--no-deps").env("RUSTDOCFLAGS", "--deny warnings"))
}

/// `cargo SUBCOMMAND` for the library on the desktop.
fn host_cargo(subcommand: &str) -> Command {
    let mut cargo = shell::cargo();
    cargo.arg(subcommand).current_dir(package());
    cargo
}

/// `cargo SUBCOMMAND` for the library on `target`, in release, into the toolchain's own folder.
fn device_cargo(toolchain: Toolchain, subcommand: &str, target: &str) -> Command {
    let mut cargo = toolchain.cargo(subcommand, target);
    cargo.args(["--release", "--lib", "--target-dir"]).arg(Path::new("target").join(toolchain.name()));
    cargo.current_dir(package());
    cargo
}

/// Builds the static library for the Cortex-M4F and copies it to where the next build does not overwrite it.
fn build_library(toolchain: Toolchain, feature: Option<&str>) -> Result<PathBuf> {
    let mut cargo = device_cargo(toolchain, "build", THUMB_V7);
    if let Some(feature) = feature {
        cargo.args(["--features", feature]);
    }
    shell::run(&mut cargo)?;
    let target = package().join("target");
    let built = target.join(toolchain.name()).join(THUMB_V7).join("release/libmotionette_c.a");
    let folder = target.join("example").join(feature.unwrap_or("default"));
    fs::create_dir_all(&folder)?;
    let library = folder.join("libmotionette_c.a");
    fs::copy(&built, &library).with_context(|| format!("cannot copy {}", built.display()))?;
    Ok(library)
}

/// Compiles the example and links it with `library`.
fn link(library: &Path, name: &str, collection: &str) -> Result<PathBuf> {
    let mut compiler = compiler()?;
    let (examples, image) = (Path::new("examples"), package().join("target/example").join(name));
    compiler.args(["-mcpu=cortex-m4", "-mthumb", "-mfpu=fpv4-sp-d16", "-mfloat-abi=hard"]);
    compiler.args(["-std=c99", "-O2", "-ffreestanding", "-ffunction-sections", "-fdata-sections"]);
    compiler.args(["-Wall", "-Wextra", "-Wpedantic", "-Werror"]);
    compiler.args(["-Iinclude", "-Iexamples/qemu", "-I../../models"]);
    compiler.args(SOURCES.map(|source| examples.join(source))).arg(library);
    compiler.args(["-nostdlib", "-Texamples/qemu/mps2-an386.ld", "-Wl,-z,noexecstack", collection, "-o"]).arg(&image);
    shell::run(compiler.current_dir(package()))?;
    Ok(image)
}

/// The C compiler for the Cortex-M4F, without its options.
fn compiler() -> Result<Command> {
    if find("arm-none-eabi-gcc").is_some() {
        return Ok(Command::new("arm-none-eabi-gcc"));
    }
    setup::ensure(&[&setup::LLD])?;
    let mut clang = Command::new("clang");
    clang.args([&format!("--target={THUMB_V7}"), "-fuse-ld=lld"]);
    Ok(clang)
}

/// Runs `image` on QEMU's Cortex-M4F; what it printed.
fn emulate(image: &Path) -> Result<String> {
    let mut qemu = Command::new("qemu-system-arm");
    qemu.args(["-machine", "mps2-an386", "-cpu", "cortex-m4", "-display", "none", "-monitor", "none"]);
    qemu.args(["-serial", "none", "-chardev", "stdio,id=console"]);
    qemu.args(["-semihosting-config", "enable=on,target=native,chardev=console", "-kernel"]).arg(image);
    shell::announce(&qemu);
    let start = Instant::now();
    // A few lines: the pipe holds them all.
    let mut child = qemu.stdin(Stdio::null()).stdout(Stdio::piped()).spawn().context("cannot start qemu-system-arm")?;
    while child.try_wait()?.is_none() {
        if start.elapsed() > LIMIT {
            child.kill()?;
            child.wait()?;
            bail!("the example did not exit within {} s", LIMIT.as_secs());
        }
        thread::sleep(Duration::from_millis(20));
    }
    let output = child.wait_with_output()?;
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    if !output.status.success() {
        bail!("the example ended with {}:\n{printed}", output.status);
    }
    Ok(printed)
}
