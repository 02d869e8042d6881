//! `motionette device`: a robot at the other end of a line.

mod generate;
mod report;
mod send_blob;
mod watch;

use anyhow::{Context, Result};
use clap::{Args, Subcommand};
use motionette_link::message::{Command, Hello};
use serde_json::{Value, json};

use super::say;
use crate::device::{Client, Options, Transport, open};

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
    /// Emergency stop: movement and work end at once.
    Stop,
    /// Comes to rest within the motion.
    Hold,
    /// Goes on after `hold`, and waits for the end.
    Resume,
    /// Moves to the neutral pose.
    Neutral,
    /// Says how the device stands.
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
        if matches!(self.action, Action::Stop) {
            // Works without a session and leaves another host's alone.
            return tell(&mut Client::new(transport, Options::default()), &Command::Stop, "stopped");
        }
        let (mut client, hello) = Client::connect(transport, Options::default())?;
        match self.action {
            Action::Hello => {
                report::say_hello(&hello);
                Ok(report::hello(&hello))
            }
            Action::Generate(cmd) => cmd.run(&mut client, &hello),
            Action::Play => play(&mut client, &Command::Play),
            Action::Resume => play(&mut client, &Command::Resume),
            Action::Stop | Action::Hold => tell(&mut client, &Command::Hold, "holds"),
            Action::Neutral => play(&mut client, &Command::Neutral),
            Action::Status => {
                let status = client.status()?;
                report::say_status(&status);
                Ok(report::status(&status))
            }
            Action::SelfTest => self_test(&mut client),
            Action::SendBlob(cmd) => cmd.run(&mut client, &hello),
            Action::Watch(cmd) => cmd.run(&mut client),
        }
    }
}

fn tell(client: &mut Session, command: &Command, done: &str) -> Result<Value> {
    client.tell(command)?;
    say(done);
    Ok(json!({"done": done}))
}

/// Begins a movement and waits for its end.
fn play(client: &mut Session, command: &Command) -> Result<Value> {
    client.tell(command)?;
    rest(client)
}

/// Waits for the end of a movement.
fn rest(client: &mut Session) -> Result<Value> {
    let bar = super::bar(0, "frames");
    let mut longest = 0;
    let state = client.wait_for_rest(&mut |status| {
        let left = u64::from(status.device.frames_queued);
        longest = longest.max(left);
        bar.set_length(longest);
        bar.set_position(longest - left);
    });
    bar.finish_and_clear();
    let status = client.status()?;
    let state = state?.name();
    say(&format!("at rest: {state}, {} ticks missed", status.device.missed_ticks));
    Ok(report::status(&status))
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
    hello
        .model
        .as_ref()
        .ok_or(crate::device::Error::Refused(motionette_link::Refusal::NoModel))
        .context("the request needs a model")
}
