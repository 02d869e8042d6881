//! Running an image on one of QEMU's Cortex-M machines.

use std::{
    io::{Read, Seek},
    path::Path,
    process::{Command, Stdio},
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context, Result, bail};

/// An emulated machine.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Machine {
    /// Short name, also the key in `--json`.
    pub name: &'static str,
    /// What it emulates.
    pub title: &'static str,
    /// QEMU's options that select it.
    options: &'static [&'static str],
}

/// ARM MPS2 with a Cortex-M4F.
pub const M4: Machine =
    Machine { name: "m4", title: "Cortex-M4F (mps2-an386)", options: &["-machine", "mps2-an386", "-cpu", "cortex-m4"] };
/// ARM MPS2 with a Cortex-M7; runs the M4F's image.
pub const M7: Machine = Machine { name: "m7", title: "Cortex-M7 (mps2-an500)", options: &["-machine", "mps2-an500"] };
/// ARM MPS2 with a Cortex-M33.
pub const M33: Machine =
    Machine { name: "m33", title: "Cortex-M33 (mps2-an505)", options: &["-machine", "mps2-an505"] };

/// ARM MPS3 with a Cortex-M55.
pub const M55: Machine =
    Machine { name: "m55", title: "Cortex-M55 (mps3-an547)", options: &["-machine", "mps3-an547"] };
/// All of them.
pub const MACHINES: [Machine; 4] = [M4, M7, M33, M55];

/// What a run left behind.
pub struct Run {
    /// Bytes the image wrote to the semihosting console.
    pub output: Vec<u8>,
    /// The image's exit status.
    pub status: i32,
    /// How long the run took.
    pub elapsed: Duration,
}

/// Runs `image` on `machine` until it exits.
///
/// # Errors
/// When QEMU cannot be started, does not end within `limit`, or is killed.
pub fn run(machine: Machine, image: &Path, limit: Duration) -> Result<Run> {
    run_with(machine, image, limit, &[])
}

/// The same with the plugin that counts instructions; what it reports comes second. `places` adds counts of addresses.
///
/// # Errors
/// As [`run`], and when the plugin's report cannot be read.
pub fn count(machine: Machine, image: &Path, limit: Duration, plugin: &Path, places: bool) -> Result<(Run, String)> {
    let report = tempfile::NamedTempFile::new().context("cannot make a file for the plugin's report")?;
    let plugin = format!("{}{}", plugin.display(), if places { ",places=1" } else { "" });
    let path = report.path().display().to_string();
    let run = run_with(machine, image, limit, &["-plugin", &plugin, "-d", "plugin", "-D", &path])?;
    let text = std::fs::read_to_string(report.path()).context("cannot read the plugin's report")?;
    Ok((run, text))
}

fn run_with(machine: Machine, image: &Path, limit: Duration, more: &[&str]) -> Result<Run> {
    let mut console = tempfile::tempfile().context("cannot make a file for the console output")?;
    let start = Instant::now();
    let mut child = Command::new("qemu-system-arm")
        .args(machine.options)
        .args(["-display", "none", "-monitor", "none", "-serial", "none", "-parallel", "none"])
        .args(more)
        .args(["-semihosting-config", "enable=on,target=native", "-kernel"])
        .arg(image)
        .stdin(Stdio::null())
        .stdout(console.try_clone()?)
        .spawn()
        .context("cannot start qemu-system-arm (on Debian: sudo apt-get install --yes qemu-system-arm)")?;
    let status = loop {
        if let Some(status) = child.try_wait()? {
            break status;
        }
        if start.elapsed() > limit {
            child.kill()?;
            child.wait()?;
            bail!("{}: the image did not exit within {} s", machine.title, limit.as_secs());
        }
        thread::sleep(Duration::from_millis(20));
    };
    let elapsed = start.elapsed();
    let status = status.code().with_context(|| format!("{}: QEMU was killed", machine.title))?;
    let mut output = Vec::new();
    console.rewind()?;
    console.read_to_end(&mut output)?;
    Ok(Run { output, status, elapsed })
}
