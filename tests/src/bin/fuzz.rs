//! Runs the fuzzer for a number of cases, or repeats one. Started by `cargo xtask fuzz`.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::thread;
use std::time::Instant;

use motionette_tests::fuzz;

/// What to run.
struct Options {
    cases: u64,
    seed: u64,
    first: u64,
    threads: usize,
    write_corpus: Option<PathBuf>,
}

const USAGE: &str = "usage: fuzz [--cases N] [--seed N] [--first N] [--threads N] | fuzz --write-corpus FOLDER";

fn options() -> Result<Options, String> {
    let threads = thread::available_parallelism().map_or(1, usize::from);
    let mut options = Options { cases: 100_000, seed: 1, first: 0, threads, write_corpus: None };
    let mut arguments = std::env::args().skip(1);
    while let Some(name) = arguments.next() {
        let value = arguments.next().ok_or(format!("{name} needs a value"))?;
        let number = || value.parse::<u64>().map_err(|_| format!("{name} needs a number, not `{value}`"));
        match name.as_str() {
            "--cases" => options.cases = number()?,
            "--seed" => options.seed = number()?,
            "--first" => options.first = number()?,
            "--threads" => options.threads = number()? as usize,
            "--write-corpus" => options.write_corpus = Some(value.into()),
            _ => return Err(format!("{name} is unknown")),
        }
    }
    Ok(options)
}

fn main() -> ExitCode {
    let Options { cases, seed, first, threads, write_corpus } = match options() {
        Ok(options) => options,
        Err(message) => {
            eprintln!("{message}\n{USAGE}");
            return ExitCode::FAILURE;
        }
    };
    if let Some(folder) = write_corpus {
        return match write(&folder) {
            Ok(()) => ExitCode::SUCCESS,
            Err(error) => {
                eprintln!("{}: {error}", folder.display());
                ExitCode::FAILURE
            }
        };
    }
    let start = Instant::now();
    let progress = |done: u64| {
        if done.is_multiple_of(1 << 18) {
            eprintln!("{done} of {cases} cases, {:.0} a second", done as f64 / start.elapsed().as_secs_f64());
        }
    };
    match fuzz::run(seed, first, cases, threads, progress) {
        Ok(tally) => {
            println!(
                "{} cases in {:.1} s on {threads} threads: blobs {} refused, {} opened; requests {} refused, {} gave a motion, {} of anchors inside the planner, {} with tracks or obstacles, {} with a timeline; {} streams; files {} refused, {} read",
                tally.cases,
                start.elapsed().as_secs_f64(),
                tally.blobs_refused,
                tally.blobs_opened,
                tally.requests_refused,
                tally.motions,
                tally.conditioned,
                tally.led,
                tally.parted,
                tally.streams,
                tally.files_refused,
                tally.files_read
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

/// Writes the small models that mutations begin with.
fn write(folder: &Path) -> std::io::Result<()> {
    std::fs::create_dir_all(folder)?;
    for (name, tiny) in fuzz::corpus() {
        std::fs::write(folder.join(format!("{name}.blob")), tiny.bytes())?;
        println!("{name}.blob: {} bytes", tiny.bytes().len());
    }
    Ok(())
}
