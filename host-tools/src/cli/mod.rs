//! The `motionette` command line: one file a subcommand, each a `Cmd` of arguments and a `run`.
//!
//! A command says what it did on standard output and returns a JSON object; with `--json` that object is the last line of standard
//! output. Progress goes to standard error, on a terminal only. A failure prints its chain of causes and what to do, and the exit
//! status is 1 (2 for arguments that make no sense).

mod convert;
mod device;
mod export;
mod generate;
mod hint;
mod import;
mod inspect;
mod making;
mod model;
mod plan;
mod progress;
mod recording;
mod recover;
mod robot;
mod verify;

use std::io::Write;
use std::process::ExitCode;

use clap::{Parser, Subcommand};
use serde_json::{Value, json};

pub use progress::bar;
pub use recording::RecordingOptions;

/// Motion generation for robots: data in, models converted and checked, motion out.
#[derive(Debug, Parser)]
#[command(name = "motionette", version, propagate_version = true)]
struct Cli {
    /// Print one machine-readable object on the last line of standard output.
    #[arg(long, global = true)]
    json: bool,
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    // Data: recordings in, features and joints.
    Import(import::Cmd),
    Recover(recover::Cmd),
    // Models: convert, inspect, plan, verify.
    Convert(convert::Cmd),
    Inspect(inspect::Cmd),
    Plan(plan::Cmd),
    Verify(verify::Cmd),
    // Motion: generate, export.
    Generate(generate::Cmd),
    Export(export::Cmd),
    // Robots: what they are, and those that are connected.
    Robot(robot::Cmd),
    Device(device::Cmd),
}

impl Command {
    fn run(self) -> anyhow::Result<Value> {
        match self {
            Self::Import(cmd) => cmd.run(),
            Self::Recover(cmd) => cmd.run(),
            Self::Convert(cmd) => cmd.run(),
            Self::Inspect(cmd) => cmd.run(),
            Self::Plan(cmd) => cmd.run(),
            Self::Verify(cmd) => cmd.run(),
            Self::Generate(cmd) => cmd.run(),
            Self::Export(cmd) => cmd.run(),
            Self::Robot(cmd) => cmd.run(),
            Self::Device(cmd) => cmd.run(),
        }
    }
}

/// Runs the program with the process' arguments.
pub fn main() -> ExitCode {
    let cli = Cli::parse();
    match cli.command.run() {
        Ok(report) => {
            if cli.json {
                say(&report.to_string());
            }
            ExitCode::SUCCESS
        }
        Err(error) => {
            complain(&error);
            if cli.json
                && let Some(missed) = error.downcast_ref::<verify::BudgetMissed>()
            {
                // The figures are the result, whether they please or not.
                say(&missed.report.to_string());
            } else if cli.json {
                let causes: Vec<String> = error.chain().skip(1).map(ToString::to_string).collect();
                say(&json!({"error": error.to_string(), "causes": causes, "hint": hint::of(&error)}).to_string());
            }
            ExitCode::FAILURE
        }
    }
}

/// A line on standard output. A closed pipe (`| head`) is no reason to fail.
pub fn say(line: &str) {
    let _ = writeln!(std::io::stdout(), "{line}");
}

fn complain(error: &anyhow::Error) {
    let mut stderr = std::io::stderr();
    let _ = writeln!(stderr, "error: {error}");
    for cause in error.chain().skip(1) {
        let _ = writeln!(stderr, "  because: {cause}");
    }
    if let Some(hint) = hint::of(error) {
        let _ = writeln!(stderr, "  hint: {hint}");
    }
}
