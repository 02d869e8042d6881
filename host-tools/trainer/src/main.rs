//! Command line of the trainer.

use std::process::ExitCode;

use clap::Parser;
use motionette_host::console;
use motionette_train::{control, evaluate, evaluator, prior, tokenizer};

/// Trains motionette's models on motion capture.
#[derive(Parser)]
#[command(version)]
enum Command {
    /// Trains or measures the motion tokenizer.
    Tokenizer(tokenizer::command::Args),
    /// Trains the prior: text encoder and planner.
    Prior(prior::command::Args),
    /// Trains what a frozen prior is told of anchors.
    Control(control::command::Args),
    /// Trains or measures the judge of generated motion.
    Evaluator(evaluator::command::Args),
    /// Measures generated motion and writes the table.
    Evaluate(evaluate::command::Args),
}

fn main() -> ExitCode {
    let result = match Command::parse() {
        Command::Tokenizer(args) => tokenizer::command::run(&args),
        Command::Prior(args) => prior::command::run(&args),
        Command::Control(args) => control::command::run(&args),
        Command::Evaluator(args) => evaluator::command::run(&args),
        Command::Evaluate(args) => evaluate::command::run(&args),
    };
    console::conclude(result)
}
