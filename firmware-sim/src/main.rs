//! `motionette-sim`: the virtual robot. Without a subcommand it runs the demo.

use clap::{Parser, Subcommand};
use motionette_host::console;
use motionette_sim::robot::boots;
use motionette_sim::{demo, sample_clips, serve};
use std::process::ExitCode;

/// A virtual robot that runs motionette's embedded runtime and checks it against the reference.
#[derive(Debug, Parser)]
#[command(name = "motionette-sim", version, args_conflicts_with_subcommands = true)]
struct Cli {
    #[command(subcommand)]
    command: Option<Command>,
    #[command(flatten)]
    demo: demo::Cmd,
}

#[derive(Debug, Subcommand)]
enum Command {
    /// Text and anchors, or real motion, through the runtime, checked, shown (the default).
    Demo(Box<demo::Cmd>),
    /// Serve the device link of a simulated robot over TCP.
    Serve(serve::Cmd),
    /// Start simulated robots again and again, and say what their horns did.
    Boots(boots::Cmd),
    /// Make the bundled token sequences anew from a dataset and a checkpoint.
    #[command(name = "bundle")]
    SampleClips(sample_clips::Cmd),
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    let result = match cli.command {
        Some(Command::Demo(cmd)) => cmd.run(),
        Some(Command::Serve(cmd)) => cmd.run(),
        Some(Command::Boots(cmd)) => cmd.run(),
        Some(Command::SampleClips(cmd)) => cmd.run(),
        None => cli.demo.run(),
    };
    console::conclude(result)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_readme_s_commands_are_understood() {
        let text = include_str!("../../README.md");
        let mut count = 0;
        for line in text.lines() {
            // `cargo run` runs this program.
            let rest = line.strip_prefix("motionette-sim ").or_else(|| line.strip_prefix("cargo run --release -- "));
            let Some(rest) = rest else { continue };
            // Every other part stands in quotes.
            let parts = rest.split(" #").next().unwrap_or_default().split('"').enumerate();
            let words = parts.flat_map(|(k, part)| match k % 2 {
                0 => part.split_whitespace().collect::<Vec<_>>(),
                _ => vec![part],
            });
            if let Err(error) = Cli::try_parse_from(std::iter::once("motionette-sim").chain(words)) {
                panic!("{line}: {error}");
            }
            count += 1;
        }
        assert!(count >= 4, "{count} commands");
    }
}
