//! `cargo xtask test`: every check, each announced and timed, a failure with the command that repeats only it.

use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use clap::{Args, ValueEnum};

use crate::{
    firmware, setup, shell,
    steps::{bench, c, fuzz, twin},
    toolchain::Toolchain,
};

/// Options of `cargo xtask test`.
#[derive(Args)]
pub struct Options {
    /// Run only this step (may be given several times).
    #[arg(long, value_enum, value_name = "STEP")]
    only: Vec<Step>,
}

/// The checks, in order.
#[derive(Clone, Copy, PartialEq, Eq, ValueEnum, Debug)]
enum Step {
    /// Installs what is missing: rustup components and targets, or Debian packages.
    Setup,
    /// Every file is formatted.
    Fmt,
    /// No lint warns, in any crate and in the firmware.
    Clippy,
    /// Every test of every crate.
    Test,
    /// A bounded run of the fuzzer.
    Fuzz,
    /// The images for the Cortex-M4F, M7, M33 and M55 build, a planted panic fails the gate, the Pico 2's firmware builds and fits, and
    /// the runtime builds for cores without FPU.
    Firmware,
    /// The C library: its header is current, its example runs in QEMU and prints what the desktop does.
    C,
    /// Desktop, Cortex-M4F, M7, M33 and M55 agree in every bit.
    Twin,
    /// The documentation builds without a warning.
    Docs,
}

/// Cases of the fuzzer in a test run.
const FUZZ_CASES: u64 = 100_000;

/// What a step counted.
#[derive(Clone, Copy, Default)]
struct Count {
    passed: usize,
    failed: usize,
}

impl Step {
    fn name(self) -> String {
        self.to_possible_value().map_or_else(String::new, |value| value.get_name().to_owned())
    }

    fn run(self) -> Result<Count> {
        match self {
            Self::Setup => set_up(),
            Self::Fmt => fmt(),
            Self::Clippy => clippy(),
            Self::Test => return cargo_test(),
            Self::Fuzz => fuzz::run(&fuzz::Options { cases: FUZZ_CASES, seed: 1 }),
            Self::Firmware => firmware::build_all(),
            Self::C => c::run(&c::Options::default()),
            Self::Twin => twin::run(&twin::Options::default()),
            Self::Docs => docs(),
        }
        .map(|()| Count { passed: 1, failed: 0 })
    }
}

/// Runs the chosen steps, all of them by default. The last line on standard output is `N passed, N failed`.
///
/// # Errors
/// When a step failed.
pub fn run(options: &Options) -> Result<()> {
    let all = Step::value_variants();
    let steps: Vec<Step> =
        all.iter().copied().filter(|step| options.only.is_empty() || options.only.contains(step)).collect();
    let mut report: Vec<(Step, Duration, Count, Option<anyhow::Error>)> = Vec::new();
    for (index, step) in steps.iter().enumerate() {
        println!("==> [{}/{}] {}", index + 1, steps.len(), step.name());
        let start = Instant::now();
        let (count, error) = match step.run() {
            Ok(count) if count.failed == 0 => (count, None),
            Ok(count) => (count, Some(anyhow::anyhow!("{} of {} failed", count.failed, count.passed + count.failed))),
            Err(error) => (Count { passed: 0, failed: 1 }, Some(error)),
        };
        let elapsed = start.elapsed();
        match &error {
            None => println!("<== {} passed in {:.1} s", step.name(), elapsed.as_secs_f64()),
            Some(error) => println!(
                "<== {} FAILED after {:.1} s: {error:#}\n    only this again: cargo xtask test --only {}",
                step.name(),
                elapsed.as_secs_f64(),
                step.name()
            ),
        }
        report.push((*step, elapsed, count, error));
    }
    println!("\nstep      seconds  result");
    for (step, elapsed, count, error) in &report {
        let detail = if count.passed + count.failed > 1 {
            format!(" ({} passed, {} failed)", count.passed, count.failed)
        } else {
            String::new()
        };
        let result = if error.is_none() { "passed" } else { "FAILED" };
        println!("{:<9} {:>7.1}  {result}{detail}", step.name(), elapsed.as_secs_f64());
    }
    let passed: usize = report.iter().map(|(_, _, count, _)| count.passed).sum();
    let failed: usize = report.iter().map(|(_, _, count, _)| count.failed).sum();
    println!("{passed} passed, {failed} failed");
    let broken: Vec<String> = report.iter().filter(|entry| entry.3.is_some()).map(|entry| entry.0.name()).collect();
    if !broken.is_empty() {
        bail!("failed: {}", broken.join(", "));
    }
    Ok(())
}

fn set_up() -> Result<()> {
    setup::ensure_components()?;
    let toolchain = Toolchain::ensure()?;
    setup::ensure(&[&setup::QEMU, &setup::CHROMIUM, &setup::C_COMPILER])?;
    println!("firmware is built with the {} toolchain", toolchain.name());
    Ok(())
}

fn fmt() -> Result<()> {
    setup::ensure_components()?;
    shell::run(shell::cargo().args(["fmt", "--all", "--check"]))?;
    for package in [firmware::package(), firmware::pico2(), c::package(), bench::package()] {
        shell::run(shell::cargo().args(["fmt", "--check"]).current_dir(package))?;
    }
    Ok(())
}

fn clippy() -> Result<()> {
    setup::ensure_components()?;
    shell::run(shell::cargo().args(["clippy", "--workspace", "--all-targets", "--", "--deny", "warnings"]))?;
    let toolchain = Toolchain::ensure()?;
    for image in ["twin", "check", "bench", "request"] {
        let mut clippy = firmware::image_cargo(toolchain, "clippy", &firmware::M4, image, firmware::features(image));
        shell::run(clippy.args(["--", "--deny", "warnings"]))?;
    }
    shell::run(firmware::pico2_cargo(toolchain, "clippy").args(["--", "--deny", "warnings"]))?;
    // The desktop's bench takes minutes to compile: here only that its lock file still fits the runtime's dependencies.
    let manifest = bench::package().join("Cargo.toml");
    shell::run(shell::cargo().args(["update", "--workspace", "--locked", "--manifest-path"]).arg(manifest))
        .context("benchmarks/desktop/Cargo.lock: run the same command without --locked, and commit what it changes")?;
    c::clippy(toolchain)
}

/// Runs all tests and counts them from cargo's own summary lines.
fn cargo_test() -> Result<Count> {
    setup::ensure(&[&setup::CHROMIUM])?;
    let mut count = Count::default();
    let mut command = shell::cargo();
    command.args(["test", "--workspace", "--no-fail-fast"]);
    let succeeded = shell::lines(&mut command, |line| {
        println!("{line}");
        if let Some(one) = summary(line) {
            count.passed += one.passed;
            count.failed += one.failed;
        }
    })?;
    // A test program that does not compile or is killed prints no summary.
    if !succeeded && count.failed == 0 {
        count.failed = 1;
    }
    Ok(count)
}

/// Reads `test result: ok. 12 passed; 0 failed; ...`.
fn summary(line: &str) -> Option<Count> {
    let (_, counts) = line.strip_prefix("test result: ")?.split_once(". ")?;
    let number = |word: &str| counts.split("; ").find_map(|part| part.strip_suffix(word)?.trim().parse::<usize>().ok());
    Some(Count { passed: number("passed")?, failed: number("failed")? })
}

fn docs() -> Result<()> {
    let mut doc = shell::cargo();
    doc.args(["doc", "--workspace", "--no-deps"]).env("RUSTDOCFLAGS", "--deny warnings");
    shell::run(&mut doc)?;
    c::docs()
}

#[cfg(test)]
mod tests {
    use super::summary;

    #[test]
    fn cargo_summaries_are_counted() {
        let read = |line| summary(line).map(|count| (count.passed, count.failed));
        assert_eq!(read("test result: ok. 12 passed; 0 failed; 1 ignored; 0 measured; 0 filtered out"), Some((12, 0)));
        assert_eq!(read("test result: FAILED. 3 passed; 2 failed; 0 ignored; 0 measured"), Some((3, 2)));
        assert_eq!(read("test blob::tests::round_trip ... ok"), None);
        assert_eq!(read("test result: ok. many passed"), None);
    }
}
