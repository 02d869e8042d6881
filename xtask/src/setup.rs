//! Tools that the checks need, and how they get onto the machine.
//!
//! On Debian missing tools are installed with apt-get, announced first. Elsewhere the commands to type are printed and the
//! check fails: it never passes without its tool.

use std::{
    env,
    io::{BufRead, BufReader},
    path::Path,
    process::{Command, Stdio},
    thread,
    time::Duration,
};

use anyhow::{Context, Result, bail};

use crate::shell::{self, capture, find};

/// A program that a check needs.
pub struct Tool {
    /// Names it may have, any of which will do.
    pub programs: &'static [&'static str],
    /// Debian package that carries it.
    pub package: &'static str,
    /// How to get it on other systems.
    pub elsewhere: &'static str,
}

/// Emulates the Cortex-M machines.
pub const QEMU: Tool = Tool {
    programs: &["qemu-system-arm"],
    package: "qemu-system-arm",
    elsewhere: "Fedora: sudo dnf install qemu-system-arm | Arch: sudo pacman -S qemu-system-arm | macOS: brew install qemu",
};

/// Opens the HTML viewer in a test.
pub const CHROMIUM: Tool = Tool {
    programs: &["chromium", "chromium-browser", "google-chrome", "google-chrome-stable"],
    package: "chromium",
    elsewhere: "Fedora: sudo dnf install chromium | Arch: sudo pacman -S chromium | macOS: brew install chromium",
};

/// Compiles C for the Cortex-M4F.
pub const C_COMPILER: Tool = Tool {
    programs: &["arm-none-eabi-gcc", "clang"],
    package: "clang",
    elsewhere: "Fedora: sudo dnf install arm-none-eabi-gcc-cs | Arch: sudo pacman -S arm-none-eabi-gcc | macOS: brew install arm-none-eabi-gcc",
};

/// Compiles C for this machine.
pub const HOST_C_COMPILER: Tool = Tool {
    programs: &["cc", "gcc", "clang"],
    package: "build-essential",
    elsewhere: "Fedora: sudo dnf install gcc | Arch: sudo pacman -S gcc | macOS: xcode-select --install",
};

/// Links what clang compiled.
pub const LLD: Tool = Tool {
    programs: &["ld.lld"],
    package: "lld",
    elsewhere: "Fedora: sudo dnf install lld | Arch: sudo pacman -S lld | macOS: brew install lld",
};

/// How often and how long apt-get waits for another package manager: up to twenty minutes, as long as an upgrade may take.
const PATIENCE: (u32, Duration) = (120, Duration::from_secs(10));
/// What apt-get says when another one is at work.
const LOCKED: [&str; 2] = ["Could not get lock", "Unable to lock"];

/// Makes sure that every tool in `tools` is there.
///
/// # Errors
/// When one is missing and cannot be installed; the message is the command to type.
pub fn ensure(tools: &[&Tool]) -> Result<()> {
    let missing: Vec<&Tool> =
        tools.iter().copied().filter(|tool| !tool.programs.iter().any(|program| find(program).is_some())).collect();
    if missing.is_empty() {
        return Ok(());
    }
    if is_debian() {
        return apt_install(&missing.iter().map(|tool| tool.package).collect::<Vec<_>>());
    }
    let lines: Vec<String> =
        missing.iter().map(|tool| format!("  {}: {}", tool.programs.join(" or "), tool.elsewhere)).collect();
    bail!("these programs are missing:\n{}\nInstall them, then run the same command again", lines.join("\n"));
}

/// Makes sure that cargo's formatter and linter are there.
///
/// # Errors
/// When one is missing and rustup cannot fetch it.
pub fn ensure_components() -> Result<()> {
    for (component, subcommand, package) in [("rustfmt", "fmt", "rustfmt-web"), ("clippy", "clippy", "rust-web-clippy")]
    {
        let works = || capture(shell::cargo().args([subcommand, "--version"])).is_some();
        if works() {
            continue;
        }
        if find("rustup").is_some() {
            announce(&format!("adding rustup component {component}"));
            shell::run(Command::new("rustup").args(["component", "add", component]).current_dir(shell::root()))?;
        } else if is_debian() {
            apt_install(&[package])?;
        }
        if !works() {
            bail!("`cargo {subcommand}` is missing: run `rustup component add {component}`");
        }
    }
    Ok(())
}

/// True where Debian's package manager is at hand.
pub fn is_debian() -> bool {
    Path::new("/etc/debian_version").exists() && find("apt-get").is_some()
}

/// Installs Debian packages, with `sudo` when not root.
///
/// # Errors
/// When apt-get fails or the user is neither root nor has `sudo`.
pub fn apt_install(packages: &[&str]) -> Result<()> {
    let list = packages.join(" ");
    let by_hand = format!("sudo apt-get update && sudo apt-get install --yes --no-install-recommends {list}");
    let root = capture(Command::new("id").arg("-u")).as_deref() == Some("0");
    if !root && find("sudo").is_none() {
        bail!("Debian packages are missing and this user may not install them. As root run:\n  {by_hand}");
    }
    let apt = |arguments: &[&str]| {
        let mut command = Command::new(if root { "apt-get" } else { "sudo" });
        if root {
            command.envs([("DEBIAN_FRONTEND", "noninteractive"), ("LC_ALL", "C")]);
        } else {
            command.args(["env", "DEBIAN_FRONTEND=noninteractive", "LC_ALL=C", "apt-get"]);
        }
        // For dpkg's lock apt-get waits by itself.
        command.args(["-o", "DPkg::Lock::Timeout=600"]).args(arguments);
        command
    };
    announce(&format!("installing Debian packages with apt-get: {list}"));
    let install = [&["install", "--yes", "--no-install-recommends"], packages].concat();
    for arguments in [&["update"][..], &install] {
        let (tries, pause) = PATIENCE;
        run_when_free(|| apt(arguments), tries, pause).with_context(|| format!("by hand:\n  {by_hand}"))?;
    }
    Ok(())
}

/// Runs a command of the package manager; as long as another one holds a lock, again after a `pause`, `tries` times at most.
fn run_when_free(command: impl Fn() -> Command, tries: u32, pause: Duration) -> Result<()> {
    let shown = shell::display(&command());
    shell::announce(&command());
    let mut left = tries;
    loop {
        let mut child = command().stderr(Stdio::piped()).spawn().with_context(|| format!("cannot start `{shown}`"))?;
        let mut locked = false;
        for line in child.stderr.take().into_iter().flat_map(|stderr| BufReader::new(stderr).split(b'\n')) {
            let line = String::from_utf8_lossy(&line?).into_owned();
            eprintln!("{line}");
            locked |= LOCKED.iter().any(|said| line.contains(said));
        }
        let status = child.wait()?;
        if status.success() {
            return Ok(());
        }
        left = left.saturating_sub(1);
        if !locked || left == 0 {
            bail!("`{shown}` ended with {status}");
        }
        announce(&format!("another package manager is at work: waiting for it, {} s at a time", pause.as_secs()));
        thread::sleep(pause);
    }
}

/// Tells what is about to be changed on the machine.
pub fn announce(what: &str) {
    eprintln!("setup: {what}");
}

/// Value of an environment variable, if it is set and not empty.
pub fn variable(name: &str) -> Option<String> {
    env::var(name).ok().filter(|value| !value.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Counts how often it was started in `file`; fails with `words` until it was `count` times.
    fn busy(file: &Path, words: &str, count: u32) -> Command {
        let mut shell = Command::new("sh");
        let script =
            format!("echo x >> \"$1\"; [ $(wc -l < \"$1\") -ge {count} ] || {{ echo '{words}' >&2; exit 100; }}");
        shell.args(["-c", &script, "sh"]).arg(file);
        shell
    }

    #[test]
    fn a_lock_is_waited_for_and_nothing_else() {
        let folder = env::temp_dir().join(format!("motionette-xtask-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder");
        let locked = "E: Could not get lock /var/lib/apt/lists/lock. It is held by process 7 (apt-get)";
        for (name, words, tries, succeeds, started) in [
            ("free-again", locked, 5, true, 3),
            ("never-free", locked, 2, false, 2),
            ("no-network", "E: Temporary failure resolving 'deb.example'", 5, false, 1),
        ] {
            let file = folder.join(name);
            let result = run_when_free(|| busy(&file, words, 3), tries, Duration::ZERO);
            assert_eq!(result.is_ok(), succeeds, "{name}: {result:?}");
            let starts = std::fs::read_to_string(&file).expect("counted").lines().count();
            assert_eq!(starts, started, "{name}");
        }
        std::fs::remove_dir_all(&folder).expect("removed");
    }
}
