//! Seeded, structure-aware fuzzing of everything that reads bytes or requests from outside.

use anyhow::Result;
use clap::Args;

use crate::shell;

/// Options of `cargo xtask fuzz`.
#[derive(Args)]
pub struct Options {
    /// Number of cases.
    #[arg(long, default_value_t = 10_000_000)]
    pub cases: u64,
    /// Seed; the same seed gives the same cases.
    #[arg(long, default_value_t = 1)]
    pub seed: u64,
}

/// Runs the fuzzer of `motionette-tests`.
///
/// # Errors
/// When a case panics or is accepted although it breaks a rule; the message says how to repeat it.
pub fn run(options: &Options) -> Result<()> {
    let mut fuzz = shell::cargo();
    // The profile of the tests, for its overflow checks: they cost a fifth.
    fuzz.args(["run", "--quiet", "--package", "motionette-tests", "--bin", "fuzz", "--"]);
    fuzz.args(["--cases", &options.cases.to_string(), "--seed", &options.seed.to_string()]);
    shell::run(&mut fuzz)
}
