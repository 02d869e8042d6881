//! Frames: postcard, CRC-32, COBS, between zero bytes.
//!
//! A frame begins and ends with a zero, so that line noise before it becomes a broken frame of its own. Two zeros in a row
//! enclose nothing and mean nothing.

use cobs::{CobsEncoder, DecodeResult, DecoderState};
use motionette::blob::crc32;
use postcard::ser_flavors::Flavor;
use serde::{Deserialize, Serialize};

/// Bytes of the checksum behind a message.
pub const CRC_BYTES: usize = 4;

/// Bytes of the longest frame around a message of `message` bytes with its checksum.
#[must_use]
pub const fn frame_bytes(message: usize) -> usize {
    // Two delimiters, and a code byte for every 254 bytes.
    message + message / 254 + 1 + 2
}

/// The frame does not fit the buffer that was to hold it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NoRoom {
    /// Bytes of the buffer.
    pub room: usize,
}

impl core::fmt::Display for NoRoom {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        write!(f, "the message does not fit a frame of {} bytes", self.room)
    }
}

impl core::error::Error for NoRoom {}

/// Writes `message` as one frame to the front of `out`; the frame comes back.
///
/// # Errors
/// [`NoRoom`].
pub fn encode<'o>(message: &impl Serialize, out: &'o mut [u8]) -> Result<&'o [u8], NoRoom> {
    let full = NoRoom { room: out.len() };
    let (delimiter, rest) = out.split_first_mut().ok_or(full)?;
    *delimiter = 0;
    let length = postcard::serialize_with_flavor(message, Framed::new(rest)).map_err(|_| full)?;
    *out.get_mut(1 + length).ok_or(full)? = 0;
    out.get(..length + 2).ok_or(full)
}

/// postcard's output with the checksum behind it, COBS-encoded on its way.
struct Framed<'o> {
    cobs: CobsEncoder<'o>,
    crc: u32,
}

impl<'o> Framed<'o> {
    fn new(out: &'o mut [u8]) -> Self {
        Framed { cobs: CobsEncoder::new(out), crc: !0 }
    }
}

impl Flavor for Framed<'_> {
    /// Encoded bytes, without delimiters.
    type Output = usize;

    fn try_extend(&mut self, data: &[u8]) -> postcard::Result<()> {
        self.crc = crc32(self.crc, data);
        self.cobs.push(data).map_err(|_| postcard::Error::SerializeBufferFull)
    }

    fn try_push(&mut self, data: u8) -> postcard::Result<()> {
        self.try_extend(&[data])
    }

    fn finalize(mut self) -> postcard::Result<usize> {
        let crc = (!self.crc).to_le_bytes();
        self.cobs.push(&crc).map_err(|_| postcard::Error::SerializeBufferFull)?;
        Ok(self.cobs.finalize())
    }
}

/// Why bytes between two delimiters are no frame. They have been skipped.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Fault {
    /// Not COBS: a byte was lost or put in, or this is noise.
    Encoding,
    /// More bytes than any message has.
    TooLong {
        /// Most bytes of a message with its checksum.
        limit: usize,
    },
    /// The checksum does not match, or there is none.
    Checksum,
}

impl core::fmt::Display for Fault {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match self {
            Fault::Encoding => write!(f, "bytes that are no frame were skipped"),
            Fault::TooLong { limit } => write!(f, "a frame of more than {limit} bytes was skipped"),
            Fault::Checksum => write!(f, "a frame with a wrong checksum was skipped"),
        }
    }
}

impl core::error::Error for Fault {}

/// How often bytes were skipped, by reason. The counts stop at their largest value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Faults {
    /// Not COBS.
    pub encoding: u32,
    /// Longer than any message.
    pub too_long: u32,
    /// Wrong checksum.
    pub checksum: u32,
    /// A message without a header, or one from the wrong end of the line; the receiver's owner counts these.
    pub unfit: u32,
}

impl Faults {
    /// All of them.
    #[must_use]
    pub const fn total(&self) -> u32 {
        self.encoding.saturating_add(self.too_long).saturating_add(self.checksum).saturating_add(self.unfit)
    }

    fn count(&mut self, fault: Fault) {
        let count = match fault {
            Fault::Encoding => &mut self.encoding,
            Fault::TooLong { .. } => &mut self.too_long,
            Fault::Checksum => &mut self.checksum,
        };
        *count = count.saturating_add(1);
    }
}

/// Bytes in, messages out. `N`: bytes of the longest message with its checksum.
#[derive(Debug)]
pub struct Receiver<const N: usize> {
    buffer: [u8; N],
    length: usize,
    overflown: bool,
    decoder: DecoderState,
    faults: Faults,
}

impl<const N: usize> Default for Receiver<N> {
    fn default() -> Self {
        Self::new()
    }
}

impl<const N: usize> Receiver<N> {
    /// Waits for a frame.
    #[must_use]
    pub const fn new() -> Self {
        let faults = Faults { encoding: 0, too_long: 0, checksum: 0, unfit: 0 };
        Receiver { buffer: [0; N], length: 0, overflown: false, decoder: DecoderState::Idle, faults }
    }

    /// What was skipped so far.
    #[must_use]
    pub const fn faults(&self) -> Faults {
        self.faults
    }

    /// Counts a message that has no header or comes from the wrong end.
    pub fn count_unfit(&mut self) {
        self.faults.unfit = self.faults.unfit.saturating_add(1);
    }

    /// Takes bytes from the front of `bytes` up to the end of the next frame and returns its message, checked and without
    /// checksum, or why there is none. `None`: all bytes are taken and the frame goes on.
    pub fn next(&mut self, bytes: &mut &[u8]) -> Option<Result<&[u8], Fault>> {
        while let Some((&byte, rest)) = bytes.split_first() {
            *bytes = rest;
            match self.decoder.feed(byte) {
                Ok(DecodeResult::NoData) => {}
                Ok(DecodeResult::DataContinue(byte)) => self.keep(byte),
                Ok(DecodeResult::DataComplete) => return Some(self.finish(None)),
                Err(_) => return Some(self.finish(Some(Fault::Encoding))),
            }
        }
        None
    }

    fn keep(&mut self, byte: u8) {
        match self.buffer.get_mut(self.length) {
            Some(slot) => {
                *slot = byte;
                self.length += 1;
            }
            None => self.overflown = true,
        }
    }

    fn finish(&mut self, fault: Option<Fault>) -> Result<&[u8], Fault> {
        let length = core::mem::take(&mut self.length);
        let overflown = core::mem::take(&mut self.overflown).then_some(Fault::TooLong { limit: N });
        let result = match overflown.or(fault) {
            Some(fault) => Err(fault),
            None => checked(self.buffer.get(..length).unwrap_or(&[])).ok_or(Fault::Checksum),
        };
        if let Err(fault) = result {
            self.faults.count(fault);
        }
        result
    }
}

/// The message in front of its checksum, if that is right.
fn checked(bytes: &[u8]) -> Option<&[u8]> {
    let (message, crc) = bytes.split_last_chunk::<CRC_BYTES>()?;
    (!crc32(!0, message) == u32::from_le_bytes(*crc)).then_some(message)
}
