//! Command line of the trainer.

use clap::Parser;
use motionette_train::tokenizer;

/// Trains motionette's models on motion capture.
#[derive(Parser)]
#[command(version)]
enum Command {
    /// Trains or measures the motion tokenizer.
    Tokenizer(tokenizer::command::Args),
}

fn main() -> anyhow::Result<()> {
    match Command::parse() {
        Command::Tokenizer(args) => tokenizer::command::run(&args),
    }
}
