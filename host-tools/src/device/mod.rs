//! A robot at the other end of a line: the host's side of the device link.
//!
//! [`open`] opens a port, [`Client::connect`] says hello, and every method of [`Client`] is one request: sent again with the
//! same number until the device answers, executed by it once. The protocol is in `link/PROTOCOL.md`.

mod client;
mod error;
mod transport;

pub use client::{Client, Made, Observe, Options};
pub use error::{Error, advice_for_start};
pub use transport::{Transport, open};
