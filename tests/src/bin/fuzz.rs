//! Runs the fuzzer for a number of cases, or repeats one. Started by `cargo xtask fuzz`.

use std::process::ExitCode;
use std::time::Instant;

use motionette_tests::fuzz;

/// What to run.
struct Options {
    cases: u64,
    seed: u64,
    first: u64,
}

const USAGE: &str = "usage: fuzz [--cases N] [--seed N] [--first N]";

fn options() -> Result<Options, String> {
    let mut options = Options { cases: 20_000, seed: 1, first: 0 };
    let mut arguments = std::env::args().skip(1);
    while let Some(name) = arguments.next() {
        let value = arguments.next().and_then(|text| text.parse().ok()).ok_or(format!("{name} needs a number"))?;
        match name.as_str() {
            "--cases" => options.cases = value,
            "--seed" => options.seed = value,
            "--first" => options.first = value,
            _ => return Err(format!("{name} is unknown")),
        }
    }
    Ok(options)
}

fn main() -> ExitCode {
    let Options { cases, seed, first } = match options() {
        Ok(options) => options,
        Err(message) => {
            eprintln!("{message}\n{USAGE}");
            return ExitCode::FAILURE;
        }
    };
    let start = Instant::now();
    let progress = |done: u64| {
        if done > 0 && done.is_multiple_of(50_000) {
            eprintln!("{done} of {cases} cases, {:.0} a second", done as f64 / start.elapsed().as_secs_f64());
        }
    };
    match fuzz::run(seed, first, cases, progress) {
        Ok(tally) => {
            println!(
                "{} cases in {:.1} s: blobs {} refused, {} opened; requests {} refused, {} gave a motion",
                tally.cases,
                start.elapsed().as_secs_f64(),
                tally.blobs_refused,
                tally.blobs_opened,
                tally.requests_refused,
                tally.motions
            );
            ExitCode::SUCCESS
        }
        Err(failure) => {
            eprintln!("case {} of seed {seed} failed: {}", failure.case, failure.what);
            eprintln!(
                "only this again: cargo run -p motionette-tests --bin fuzz -- --seed {seed} --first {} --cases 1",
                failure.case
            );
            ExitCode::FAILURE
        }
    }
}
