//! `motionette device watch`: what happens on the device.

use std::time::{Duration, Instant};

use anyhow::Result;
use clap::Args;
use serde_json::{Value, json};

use super::{Interrupt, Session, report};
use crate::cli::say;

/// How often the device is asked for its state.
const POLL: Duration = Duration::from_millis(200);

/// Says what happens: events, changes of state, broken frames. Keeps the device from taking its host for lost.
#[derive(Debug, Args)]
pub(super) struct Cmd {
    /// End after so many seconds; else only when interrupted.
    #[arg(long, value_parser = seconds)]
    seconds: Option<Duration>,
}

fn seconds(text: &str) -> Result<Duration, String> {
    let seconds: f64 = text.parse().map_err(|_| "not a number".to_owned())?;
    Duration::try_from_secs_f64(seconds).map_err(|error| error.to_string())
}

impl Cmd {
    pub(super) fn run(self, client: &mut Session) -> Result<Value> {
        let end = self.seconds.map(|seconds| Instant::now() + seconds);
        let interrupt = Interrupt::watch()?;
        let mut events = Vec::new();
        let mut last = client.status()?;
        report::say_status(&last);
        while end.is_none_or(|end| Instant::now() < end) && interrupt.flow().is_continue() {
            if let Some(event) = client.event(POLL)? {
                say(&report::words(&event));
                events.push(report::event(&event));
                continue;
            }
            let status = client.status()?;
            let (now, before) = (&status.device, &last.device);
            if now.start != before.start {
                report::say_start(now.start);
            }
            if now.state != before.state {
                say(now.state.name());
            }
            for (what, now, before) in [
                ("ticks missed", now.missed_ticks, before.missed_ticks),
                ("bus faults", now.bus_faults, before.bus_faults),
                ("broken frames skipped", status.skipped.total(), last.skipped.total()),
            ] {
                if now != before {
                    say(&format!("{} {what}", now.wrapping_sub(before)));
                }
            }
            last = status;
        }
        Ok(json!({"events": events, "status": report::status(&last)}))
    }
}
