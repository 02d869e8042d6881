//! The manifest's values, one after another.

use super::super::Error;
use serde::Deserialize;

/// What is left of a manifest. After the first error nothing is left, and what is asked for is 0 or empty: the fields of a manifest are
/// read without a branch each, and [`Reader::finish`] says how it went.
#[derive(Debug)]
pub struct Reader<'a> {
    rest: &'a [u8],
    /// Minor format version of the blob.
    minor: u16,
    error: Option<Error>,
}

impl<'a> Reader<'a> {
    /// Reads `bytes` of a blob of that minor format version.
    pub const fn new(bytes: &'a [u8], minor: u16) -> Self {
        Reader { rest: bytes, minor, error: None }
    }

    /// The bytes that have not been read, when all others were well.
    pub fn finish(self) -> Result<&'a [u8], Error> {
        self.error.map_or(Ok(self.rest), Err)
    }

    #[inline(never)]
    fn fail(&mut self, error: Error) {
        self.error.get_or_insert(error);
        self.rest = &[];
    }

    /// The next value.
    pub fn take<T: Deserialize<'a> + Default>(&mut self) -> T {
        match postcard::take_from_bytes(self.rest) {
            Ok((value, rest)) => {
                self.rest = rest;
                value
            }
            Err(_) => {
                self.fail(Error::Manifest);
                T::default()
            }
        }
    }

    /// The next number of 16 bits.
    #[inline(never)]
    pub fn short(&mut self) -> u16 {
        self.take()
    }

    /// The next byte.
    #[inline(never)]
    pub fn byte(&mut self) -> u8 {
        self.take()
    }

    /// The next single.
    #[inline(never)]
    pub fn single(&mut self) -> f32 {
        self.take()
    }

    /// The next string.
    #[inline(never)]
    pub fn text(&mut self) -> &'a str {
        self.take()
    }

    /// The next `count` bytes as they are.
    pub fn bytes(&mut self, count: usize) -> &'a [u8] {
        let Some((bytes, rest)) = self.rest.split_at_checked(count) else {
            self.fail(Error::Manifest);
            return &[];
        };
        self.rest = rest;
        bytes
    }

    /// Which kind the next section is of; this reader knows the first `known`. An option is a section of two kinds, nothing and
    /// something. There are never more than 128, so that a kind is a byte.
    #[inline(never)]
    pub fn kind(&mut self, section: &'static str, known: u8) -> u8 {
        let found = self.byte();
        if found < known {
            return found;
        }
        self.fail(Error::Unknown { section, found, known, minor: self.minor });
        0
    }

    /// Refuses a section of a family that this build was made without.
    #[inline(never)]
    pub fn not_linked<T: Default>(&mut self, feature: &'static str) -> T {
        self.fail(Error::NotLinked { feature });
        T::default()
    }

    /// The length of the next list, at most `limit`.
    #[inline(never)]
    pub fn length(&mut self, what: &'static str, limit: u16) -> u16 {
        let found = self.short();
        if found <= limit {
            return found;
        }
        self.fail(Error::Config { what, found: u32::from(found), limit: u32::from(limit) });
        0
    }
}
