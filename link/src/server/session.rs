//! Which requests are new, and whose.
//!
//! A host sends a request when the one before has been answered or given up, so the last reply is all that is kept.
//! A session that was closed keeps its numbers, so that what comes late from it is known, until another one begins.

use heapless::Vec;
use serde::Serialize;

use crate::frame;
use crate::message::{Header, REPLY_FRAME};

/// How a request stands to those before it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Order {
    /// It comes next.
    Next,
    /// It is the last one again.
    Repeated,
    /// A later one was handled before.
    Overtaken {
        /// Id of the last that was handled.
        last: u32,
    },
    /// It belongs to another session.
    Foreign,
}

/// The session with a host, and the last reply.
#[derive(Debug)]
pub struct Session {
    /// Its number and the id of its last request.
    current: Option<(u32, u32)>,
    /// Its host has not closed it.
    open: bool,
    reply: Vec<u8, REPLY_FRAME>,
}

impl Session {
    pub const fn new() -> Self {
        Session { current: None, open: false, reply: Vec::new() }
    }

    /// Number of the session, 0 before the first.
    pub fn number(&self) -> u32 {
        self.current.map_or(0, |(number, _)| number)
    }

    /// Whether it began and was not closed.
    pub const fn is_open(&self) -> bool {
        self.open
    }

    pub fn order(&self, header: &Header) -> Order {
        match self.current {
            Some((number, last)) if number == header.session => {
                // Ids may go round.
                match header.id.wrapping_sub(last).cast_signed() {
                    0 => Order::Repeated,
                    1.. => Order::Next,
                    _ => Order::Overtaken { last },
                }
            }
            _ => Order::Foreign,
        }
    }

    /// The session of `header` is the current one from now on, and its request the last.
    pub fn begin(&mut self, header: &Header) {
        self.open = true;
        self.advance(header);
    }

    /// The request of `header` is the last one.
    pub fn advance(&mut self, header: &Header) {
        self.current = Some((header.session, header.id));
        self.reply.clear();
    }

    /// Its host has left.
    pub const fn close(&mut self) {
        self.open = false;
    }

    /// Keeps the reply to the last request, as a frame.
    pub fn keep(&mut self, message: &impl Serialize) -> Option<&[u8]> {
        let mut buffer = [0; REPLY_FRAME];
        let frame = frame::encode(message, &mut buffer).ok()?;
        self.reply.clear();
        self.reply.extend_from_slice(frame).ok()?;
        Some(&self.reply)
    }

    /// The frame that answers the last request.
    pub fn reply(&self) -> Option<&[u8]> {
        (!self.reply.is_empty()).then_some(&self.reply)
    }
}
