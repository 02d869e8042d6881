//! Where the bytes of one line arrive.

use crate::frame::{Faults, Receiver};
use crate::message::REQUEST_BYTES;

/// One line to the device, and what has come over it of a request: a board has one for each UART or USB port, a server one for each TCP
/// connection. [`Server::port`](super::Server::port) makes it.
#[derive(Debug)]
pub struct Port {
    pub(super) receiver: Receiver<REQUEST_BYTES>,
    /// Tells it from the server's other ports.
    pub(super) number: u32,
}

impl Port {
    pub(super) const fn new(number: u32) -> Self {
        Port { receiver: Receiver::new(), number }
    }

    /// What its receiver skipped.
    #[must_use]
    pub const fn skipped(&self) -> Faults {
        self.receiver.faults()
    }
}
