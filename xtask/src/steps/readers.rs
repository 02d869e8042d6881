//! What other programs read of the files that motionette exports, as the fixture of a test that needs none of them.
//!
//! three.js and Khronos' glTF validator come from npm, `bvhio` from PyPI, in the exact versions of `xtask/readers`, into
//! `target/readers`.

use std::{fs, path::PathBuf, process::Command};

use anyhow::{Context, Result};

use crate::{setup, shell};

/// Runs JavaScript.
const NODE: setup::Tool = setup::Tool {
    programs: &["node", "nodejs"],
    package: "nodejs",
    elsewhere: "Fedora: sudo dnf install nodejs | Arch: sudo pacman -S nodejs | macOS: brew install node",
};

/// Installs its packages.
const NPM: setup::Tool = setup::Tool {
    programs: &["npm"],
    package: "npm",
    elsewhere: "Fedora: sudo dnf install nodejs-npm | Arch: sudo pacman -S npm | macOS: brew install node",
};

/// Runs Python and installs its packages.
const PYTHON: setup::Tool = setup::Tool {
    programs: &["python3"],
    package: "python3-venv",
    elsewhere: "Fedora: sudo dnf install python3 | Arch: sudo pacman -S python | macOS: brew install python",
};

/// Where the test expects the fixture.
const FIXTURE: &str = "host-tools/tests/fixtures/readers.json";
/// Scripts, and the versions of what they import.
const SCRIPTS: &str = "xtask/readers";
/// Everything that is installed or written on the way.
const PLACE: &str = "target/readers";

/// Writes the files of the test, lets the readers read them and writes the fixture.
///
/// # Errors
/// When a tool or a package is missing and cannot be installed, or a reader fails.
pub fn run() -> Result<()> {
    setup::ensure(&[&NODE, &NPM, &PYTHON])?;
    let place = shell::root().join(PLACE);
    let files = place.join("files");
    fs::create_dir_all(&files).with_context(|| format!("cannot make {}", files.display()))?;

    let mut write = shell::cargo();
    write.args(["test", "--quiet", "--package", "motionette-host", "--test", "readers", "--"]);
    write.args(["--ignored", "--exact", "write_the_files"]).env("MOTIONETTE_READERS", &files);
    shell::run(&mut write)?;

    for name in ["package.json", "requirements.txt", "bvh_files.py", "all_files.mjs"] {
        let from = shell::root().join(SCRIPTS).join(name);
        fs::copy(&from, place.join(name)).with_context(|| format!("cannot copy {}", from.display()))?;
    }
    let python = virtual_environment(&place)?;
    let here = |program: &str| {
        let mut command = Command::new(program);
        command.current_dir(&place);
        command
    };
    let python = python.to_string_lossy();
    shell::run(here(&python).args(["-m", "pip", "install", "--quiet", "--requirement", "requirements.txt"]))?;
    shell::run(here("npm").args(["install", "--no-audit", "--no-fund", "--no-package-lock", "--silent"]))?;
    shell::run(here(&python).args(["bvh_files.py", "files"]))?;
    let node = if shell::find("node").is_some() { "node" } else { "nodejs" };
    shell::run(here(node).args(["all_files.mjs", "files"]).arg(shell::root().join(FIXTURE)))
}

/// A Python of its own for the packages; gives its interpreter.
fn virtual_environment(place: &std::path::Path) -> Result<PathBuf> {
    let folder = place.join("python");
    let python = folder.join(if cfg!(windows) { "Scripts/python.exe" } else { "bin/python" });
    if !python.is_file() {
        shell::run(Command::new("python3").args(["-m", "venv"]).arg(&folder))
            .context("Python cannot make a virtual environment; on Debian: sudo apt-get install python3-venv")?;
    }
    Ok(python)
}
