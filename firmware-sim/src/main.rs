//! `motionette-sim`: the virtual robot. Without a subcommand it runs the demo.

use clap::{Parser, Subcommand};
use motionette_sim::robot::boots;
use motionette_sim::{bundle, demo, serve};
use std::io::Write;
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
    Bundle(bundle::Cmd),
}

fn main() -> ExitCode {
    let cli = Cli::parse();
    let result = match cli.command {
        Some(Command::Demo(cmd)) => cmd.run(),
        Some(Command::Serve(cmd)) => cmd.run(),
        Some(Command::Boots(cmd)) => cmd.run(),
        Some(Command::Bundle(cmd)) => cmd.run(),
        None => cli.demo.run(),
    };
    match result {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let mut stderr = std::io::stderr();
            let _ = writeln!(stderr, "error: {error}");
            for cause in error.chain().skip(1) {
                let _ = writeln!(stderr, "  because: {cause}");
            }
            ExitCode::FAILURE
        }
    }
}
