//! The manifest's values, one after another.

use super::super::{Error, MINOR};
use serde::Deserialize;

/// What is left of a manifest.
#[derive(Debug, Clone, Copy)]
pub struct Reader<'a> {
    rest: &'a [u8],
    /// Minor format version of the blob.
    minor: u16,
}

impl<'a> Reader<'a> {
    /// Reads `bytes` of a blob of that minor format version.
    pub const fn new(bytes: &'a [u8], minor: u16) -> Self {
        Reader { rest: bytes, minor }
    }

    /// The bytes that have not been read.
    pub const fn rest(&self) -> &'a [u8] {
        self.rest
    }

    /// The next value.
    pub fn take<T: Deserialize<'a>>(&mut self) -> Result<T, Error> {
        let (value, rest) = postcard::take_from_bytes(self.rest).map_err(|_| Error::Manifest)?;
        self.rest = rest;
        Ok(value)
    }

    /// The next number of 16 bits.
    #[inline(never)]
    pub fn short(&mut self) -> Result<u16, Error> {
        self.take()
    }

    /// The next byte.
    pub fn byte(&mut self) -> Result<u8, Error> {
        self.take()
    }

    /// The next string.
    #[inline(never)]
    pub fn text(&mut self) -> Result<&'a str, Error> {
        self.take()
    }

    /// The next `N` bytes as they are.
    pub fn bytes<const N: usize>(&mut self) -> Result<&'a [u8; N], Error> {
        let (bytes, rest) = self.rest.split_first_chunk().ok_or(Error::Manifest)?;
        self.rest = rest;
        Ok(bytes)
    }

    /// Which kind the next section is of; this reader knows the first `known`. An option is a section of two kinds, nothing and
    /// something.
    #[inline(never)]
    pub fn kind(&mut self, section: &'static str, known: u32) -> Result<u32, Error> {
        let found = self.take()?;
        if found < known {
            return Ok(found);
        }
        Err(Error::Unknown { section, found, known, minor: self.minor, supported: MINOR })
    }

    /// The length of the next list, at most `limit`.
    #[inline(never)]
    pub fn length(&mut self, what: &'static str, limit: usize) -> Result<usize, Error> {
        let (found, limit) = (self.take::<u32>()?, limit as u32);
        if found > limit { Err(Error::Config { what, found, limit }) } else { Ok(found as usize) }
    }
}
