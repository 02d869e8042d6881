//! The device link: how a host talks to a robot that runs motionette.
//!
//! Requests and replies are postcard messages with a CRC-32 in COBS frames, over USB serial, UART or TCP. The wire format
//! is specified in `PROTOCOL.md` beside this crate.
//!
//! # Layers, top-down, and what each may not know
//! - [`device_state`]: a ready-made [`Device`] between a playback line and a thread that makes motions; board and simulator use it.
//! - [`thread`]: what that thread does: proves the model, works off tasks.
//! - [`server`]: the device's side, a state machine with time passed in: sessions, repeated requests, silence of the host.
//!   Knows what a [`Device`] can do, not how.
//! - [`update`]: a model blob into one of two slots of NOR flash. Knows neither frames nor messages.
//! - [`conditions`]: tracks, obstacles, timelines and vectors of prompts, which fit no message, into memory set aside for them.
//! - [`message`]: requests, replies, events and refusals. Knows neither bytes nor time.
//! - [`frame`]: bytes to frames and back. Knows nothing of what is in them.
//!
//! The host's side is `motionette_host::device`.
//!
//! # Interrupts
//! On a board the link runs in an interrupt while inference runs in thread mode: every method of [`Device`] returns at
//! once, a generation is handed over and its end comes back as an event. Flash is written only while nothing moves and
//! nothing is generated.
#![no_std]
#![forbid(unsafe_code)]

#[cfg(test)]
extern crate std;

pub mod conditions;
pub mod device_state;
pub mod frame;
pub mod message;
pub mod server;
pub mod thread;
pub mod update;

pub use device_state::{DeviceState, Preset, SharedFlags, Task};
pub use message::{Command, Event, Generate, Refusal, Reply};
pub use server::{Device, Port, Server, Sink};
pub use update::{Storage, Store};
