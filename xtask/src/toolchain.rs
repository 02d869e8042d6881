//! Which compiler builds the firmware.
//!
//! - `native`: the user's own toolchain with the bare-metal targets' precompiled `core`; rustup fetches them.
//! - `debian`: Debian's matched compiler, cargo and standard-library source, which builds `core` itself, for machines that
//!   cannot fetch targets. Its version moves with security updates, so it is never pinned.
//!
//! `MOTIONETTE_TOOLCHAIN=native|debian` forces one.

use std::{path::Path, process::Command};

use anyhow::{Result, bail};

use crate::{
    setup::{self, announce},
    shell::{self, capture, find},
};

/// Target of the Cortex-M4F and the Cortex-M7.
pub const THUMB_V7: &str = "thumbv7em-none-eabihf";
/// Target of the Cortex-M33.
pub const THUMB_V8: &str = "thumbv8m.main-none-eabihf";
/// Target of the Cortex-M0 and M0+: no floating-point unit, no compare-and-swap.
pub const THUMB_V6: &str = "thumbv6m-none-eabi";
/// Target of RISC-V microcontrollers without a floating-point unit, such as the ESP32-C6.
pub const RISCV: &str = "riscv32imac-unknown-none-elf";
/// All of them.
pub const TARGETS: [&str; 4] = [THUMB_V7, THUMB_V8, THUMB_V6, RISCV];

const DEBIAN_PACKAGES: [&str; 5] = ["rustc-web", "cargo-web", "rust-web-src", "rust-web-clippy", "lld"];
const DEBIAN_CARGO: &str = "/usr/bin/cargo";
const DEBIAN_RUSTC: &str = "/usr/bin/rustc";
const DEBIAN_CARGO_CLIPPY: &str = "/usr/bin/cargo-clippy";
const DEBIAN_SOURCE: &str = "/usr/lib/rustlib/src/rust/library/core/src/lib.rs";

/// A way to compile firmware.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub enum Toolchain {
    /// The cargo that started this program, with precompiled targets.
    Native,
    /// Debian's compiler; builds `core` from source.
    Debian,
}

impl Toolchain {
    /// Finds a compiler for the bare-metal targets, installing what is missing.
    ///
    /// # Errors
    /// When no way works here; the message holds the exact commands.
    pub fn ensure() -> Result<Self> {
        match setup::variable("MOTIONETTE_TOOLCHAIN").as_deref() {
            None if native() => Ok(Self::Native),
            None if setup::is_debian() => debian(),
            Some("native") if native() => Ok(Self::Native),
            Some("debian") => debian(),
            Some("native") | None => bail!(
                "the bare-metal targets are missing. With rustup (https://rustup.rs) run:\n  rustup target add {}",
                TARGETS.join(" ")
            ),
            Some(other) => bail!("MOTIONETTE_TOOLCHAIN is `{other}`: it may be `native` or `debian`"),
        }
    }

    /// `cargo SUBCOMMAND` for a bare-metal `target`, without a working directory. A warning in our own crates is an error, as on the
    /// desktop: clippy sees each image's features on one core only.
    pub fn cargo(self, subcommand: &str, target: &str) -> Command {
        let mut command = match (self, subcommand) {
            (Self::Native, _) => shell::cargo(),
            // Debian's cargo would start the first cargo-clippy in PATH, which may be another toolchain's.
            (Self::Debian, "clippy") => Command::new(DEBIAN_CARGO_CLIPPY),
            (Self::Debian, _) => Command::new(DEBIAN_CARGO),
        };
        command.arg(subcommand);
        if self == Self::Debian {
            let linker = format!("CARGO_TARGET_{}_LINKER", target.to_uppercase().replace(['-', '.'], "_"));
            command
                .env("RUSTC", DEBIAN_RUSTC)
                .env("RUSTC_BOOTSTRAP", "1")
                .env(linker, "ld.lld")
                .args(["-Zbuild-std=core,compiler_builtins", "-Zbuild-std-features=compiler-builtins-mem"]);
        }
        // The image has its own build folder; the caller's must not be mixed into it.
        command.env_remove("CARGO_TARGET_DIR").args(["--target", target]);
        // Joined with what a package's `.cargo/config.toml` says of the target, which RUSTFLAGS would replace.
        command.arg("--config").arg(format!(r#"target.{target}.rustflags=["--deny=warnings"]"#));
        command
    }

    /// Name of the folder that keeps this compiler's output apart.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Native => "native",
            Self::Debian => "debian",
        }
    }
}

fn has_target(target: &str) -> bool {
    let mut rustc = Command::new("rustc");
    rustc.args(["--print", "target-libdir", "--target", target]).current_dir(shell::root());
    capture(&mut rustc).is_some_and(|folder| {
        Path::new(&folder).read_dir().is_ok_and(|mut files| {
            files.any(|file| file.is_ok_and(|file| file.file_name().to_string_lossy().starts_with("libcore-")))
        })
    })
}

fn native() -> bool {
    let complete = || TARGETS.into_iter().all(has_target);
    if complete() {
        return true;
    }
    if find("rustup").is_none() {
        return false;
    }
    announce(&format!("adding rustup targets {}", TARGETS.join(" ")));
    let mut rustup = Command::new("rustup");
    rustup.args(["target", "add"]).args(TARGETS).current_dir(shell::root());
    match shell::run(&mut rustup) {
        Ok(()) => complete(),
        Err(error) => {
            eprintln!("setup: {error:#}");
            false
        }
    }
}

fn debian() -> Result<Toolchain> {
    let complete = || {
        [DEBIAN_CARGO, DEBIAN_RUSTC, DEBIAN_CARGO_CLIPPY, DEBIAN_SOURCE].iter().all(|path| Path::new(path).exists())
            && find("ld.lld").is_some()
    };
    if !complete() {
        if !setup::is_debian() {
            bail!("MOTIONETTE_TOOLCHAIN=debian needs Debian's packages {}", DEBIAN_PACKAGES.join(" "));
        }
        setup::apt_install(&DEBIAN_PACKAGES)?;
    }
    if complete() {
        Ok(Toolchain::Debian)
    } else {
        bail!("Debian's {} do not carry what is needed", DEBIAN_PACKAGES.join(" "))
    }
}
