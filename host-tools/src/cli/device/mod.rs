//! `motionette device`: a robot at the other end of a line.

mod generate;
mod interrupt;
mod report;
mod send_blob;
mod watch;

use anyhow::{Context, Result};
use clap::{Args, Subcommand};
use motionette_link::Refusal;
use motionette_link::message::{Command, Hello, Status};
use serde_json::{Value, json};

use super::say;
use crate::device::{Client, Error, Options, Transport, open};
use interrupt::Interrupt;

/// Talks to a robot that runs motionette.
///
/// Example: motionette device --port /dev/ttyACM0 generate --text "a person waves the right hand" --play
#[derive(Debug, Args)]
pub(super) struct Cmd {
    /// The port: a serial device, or tcp:HOST:PORT (the simulator).
    #[arg(long, value_name = "PORT")]
    port: String,
    /// Speed of a UART; USB takes no notice of it.
    #[arg(long, default_value_t = 115_200)]
    baud: u32,
    /// End another host's session; else it is waited for until it closes its own or falls silent.
    #[arg(long)]
    take_over: bool,
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// Says what is at the other end: versions, robot, model, limits.
    Hello,
    Generate(generate::Cmd),
    /// Plays the motion that is ready, and waits for its end.
    Play,
    /// Emergency stop: movement and work end at once, whoever else talks to the robot.
    Stop,
    /// Comes to rest within the motion.
    Hold,
    /// Goes on after `hold`, and waits for the end.
    Resume,
    /// Moves to the neutral pose.
    Neutral,
    /// Lets servos that cannot say where they stand have their first pulses: bring the robot to its start pose before.
    Release,
    /// Says how the device stands, whoever else talks to it.
    Status,
    /// Has the model prove that it gives the bits it should.
    SelfTest,
    SendBlob(send_blob::Cmd),
    Watch(watch::Cmd),
}

/// A session with whatever the port is.
type Session = Client<Box<dyn Transport>>;

impl Cmd {
    pub(super) fn run(self) -> Result<Value> {
        let transport = open(&self.port, self.baud)?;
        let options = Options { take_over: self.take_over, ..Options::default() };
        match self.action {
            // These work without a session and leave another host's alone.
            Action::Stop => tell(&mut Client::new(transport, options), &Command::Stop, "stopped"),
            Action::Status => status(&mut Client::new(transport, options)),
            action => {
                let (mut client, hello) = Client::connect(transport, options)?;
                let result = action.run(&mut client, &hello);
                client.close();
                result
            }
        }
    }
}

impl Action {
    fn run(self, client: &mut Session, hello: &Hello) -> Result<Value> {
        match self {
            Action::Hello => {
                report::say_hello(hello);
                Ok(report::hello(hello))
            }
            Action::Generate(cmd) => cmd.run(client, hello),
            Action::Play => play(client, &Command::Play),
            Action::Resume => play(client, &Command::Resume),
            Action::Stop => tell(client, &Command::Stop, "stopped"),
            Action::Hold => tell(client, &Command::Hold, "holds"),
            Action::Neutral => play(client, &Command::Neutral),
            Action::Release => play(client, &Command::Release),
            Action::Status => status(client),
            Action::SelfTest => self_test(client),
            Action::SendBlob(cmd) => cmd.run(client, hello),
            Action::Watch(cmd) => cmd.run(client),
        }
    }
}

fn status(client: &mut Session) -> Result<Value> {
    let status = client.status()?;
    report::say_status(&status);
    Ok(report::status(&status))
}

fn tell(client: &mut Session, command: &Command, done: &str) -> Result<Value> {
    client.tell(command)?;
    say(done);
    Ok(json!({"done": done}))
}

/// Begins a movement and waits for its end.
fn play(client: &mut Session, command: &Command) -> Result<Value> {
    let interrupt = Interrupt::watch()?;
    client.tell(command)?;
    rest(client, &interrupt, command)
}

/// Waits for the end of a movement that `command` has begun. When the program is interrupted, the movement ends.
fn rest(client: &mut Session, interrupt: &Interrupt, command: &Command) -> Result<Value> {
    let bar = super::bar(0, "frames");
    let mut longest = 0;
    let mut watch = |status: &Status| {
        let left = u64::from(status.device.frames_queued);
        longest = longest.max(left);
        bar.set_length(longest);
        bar.set_position(longest - left);
        interrupt.flow()
    };
    // A robot on its way to its first or its neutral pose knows no hold.
    let (state, end) = match command {
        Command::Neutral | Command::Release => (client.wait_for_rest(&mut watch), Command::Stop),
        _ => (client.wait_for_motion(&mut watch), Command::Hold),
    };
    bar.finish_and_clear();
    let state = state.or_else(|error| broken_off(client, error, &end))?.name();
    let status = client.status()?;
    say(&format!("at rest: {state}, {} ticks missed", status.device.missed_ticks));
    Ok(report::status(&status))
}

/// What becomes of `error`: when it is an interruption, the robot does not go on without its host.
fn broken_off<T>(client: &mut Session, error: Error, end: &Command) -> Result<T> {
    if !matches!(error, Error::Interrupted) {
        return Err(error.into());
    }
    match client.tell(end) {
        Ok(()) if *end == Command::Stop => Err(error).context("the robot was stopped"),
        Ok(()) => Err(error).context("the robot holds where it is; `motionette device resume` goes on"),
        Err(Error::Refused(Refusal::NotPlaying)) => Err(error).context("the robot is at rest"),
        Err(unheard) => Err(unheard).context("interrupted, and the robot goes on: it could not be told"),
    }
}

fn self_test(client: &mut Session) -> Result<Value> {
    let passed = client.self_test()?;
    let words = match passed {
        Some(true) => "the model gives the bits it should",
        Some(false) => "the model gives other bits than it should",
        None => "the blob carries no self-test",
    };
    anyhow::ensure!(passed != Some(false), "{words}; send the blob again, then check the firmware's build");
    say(words);
    Ok(json!({"passed": passed}))
}

/// The model's figures, for requests that need them.
fn model(hello: &Hello) -> Result<&motionette_link::message::ModelInfo> {
    let none = match hello.refused {
        Some(refused) if hello.blob.is_none() => Refusal::Unusable(refused.why),
        _ => Refusal::NoModel,
    };
    hello.model.as_ref().ok_or(Error::Refused(none)).context("the request needs a model")
}
