//! The `motionette` command line: one file a subcommand, each a `Cmd` of arguments and a `run`.
//!
//! A command says what it did on standard output and returns a JSON object; with `--json` that object is the last line of standard
//! output. Progress goes to standard error, on a terminal only. A failure prints its chain of causes and what to do, and the exit
//! status is 1 (2 for arguments that make no sense).

mod capabilities;
mod convert;
mod device;
mod export;
mod generate;
mod generate_args;
mod hint;
mod import;
mod inspect;
mod model;
mod plan;
mod progress;
mod recording;
mod recover;
mod refinement;
mod robot;
mod verify;

use std::path::Path;
use std::process::ExitCode;

use clap::{Parser, Subcommand};
use serde_json::{Value, json};

use crate::console::{self, say};
pub use progress::bar;
pub use recording::RecordingOptions;
pub use refinement::Refinement;

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
        }
        Err(error) => {
            console::complain(&error, hint::of(&error));
            if cli.json
                && let Some(missed) = error.downcast_ref::<verify::BudgetMissed>()
            {
                // The figures are the result, whether they please or not.
                say(&missed.report.to_string());
            } else if cli.json {
                let causes = console::causes(&error);
                say(&json!({"error": error.to_string(), "causes": causes, "hint": hint::of(&error)}).to_string());
            }
            return ExitCode::FAILURE;
        }
    }
    match console::finish() {
        Ok(()) => ExitCode::SUCCESS,
        Err(lost) => {
            let lost = lost.into();
            console::complain(&lost, hint::of(&lost));
            ExitCode::FAILURE
        }
    }
}

/// A path in a report. JSON is Unicode, paths need not be: what is none is replaced, as on a terminal.
fn shown(path: &Path) -> String {
    path.display().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The lines of the README's commands that call `program`, as words.
    fn examples(program: &str) -> Vec<Vec<String>> {
        let text = include_str!("../../../README.md").replace("\\\n", " ");
        let lines = text.lines().filter(|line| line.starts_with(&format!("{program} ")));
        lines.map(|line| words(line.split_once(" #").map_or(line, |(command, _)| command))).collect()
    }

    /// Words with double quotes as a shell reads them.
    fn words(line: &str) -> Vec<String> {
        let parts = line.split('"').enumerate();
        let marked = parts.map(|(k, part)| if k % 2 == 0 { part.to_owned() } else { part.replace(' ', "\0") });
        let line: String = marked.collect();
        line.split_whitespace().map(|word| word.replace('\0', " ")).collect()
    }

    #[test]
    fn the_readme_s_commands_are_understood_and_replace_nothing() {
        let examples = examples("motionette");
        assert!(examples.len() >= 8, "{examples:?}");
        for example in &examples {
            if let Err(error) = Cli::try_parse_from(example) {
                panic!("{example:?}: {error}");
            }
            let outputs =
                example.windows(2).filter(|pair| ["-o", "--output", "--model-rs"].contains(&pair[0].as_str()));
            for output in outputs {
                assert!(output[1].starts_with("out/") || output[1].starts_with("data/"), "{example:?}");
            }
        }
        let convert = examples.iter().find(|example| example[1] == "convert").expect("an example");
        for part in ["models/nano.prior.safetensors", "models/nano.control.safetensors", "models/bank.txt"] {
            assert!(convert.iter().any(|word| word == part), "{part} is not in {convert:?}");
        }
    }
}
