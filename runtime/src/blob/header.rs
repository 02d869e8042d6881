//! The 32-byte header and its checksum.

use super::Error;

/// First four bytes of every blob.
pub const MAGIC: [u8; 4] = *b"MNTB";
/// Major format version: readers refuse others.
pub const MAJOR: u16 = 4;
/// Newest minor format version: a blob says the oldest one that has all that is in it.
pub const MINOR: u16 = 3;
/// Bytes of the header.
pub const HEADER_LEN: usize = 32;
/// Alignment of the blob and of every tensor, bytes.
pub const ALIGNMENT: usize = 16;

/// Byte offsets of the header's fields (all little-endian).
mod field {
    use core::ops::Range;
    pub const MAGIC: Range<usize> = 0..4;
    pub const MAJOR: Range<usize> = 4..6;
    pub const MINOR: Range<usize> = 6..8;
    pub const TOTAL_LEN: Range<usize> = 8..12;
    pub const MANIFEST_LEN: Range<usize> = 12..16;
    pub const WEIGHTS_OFFSET: Range<usize> = 16..20;
    pub const WEIGHTS_LEN: Range<usize> = 20..24;
    pub const CRC: Range<usize> = 24..28;
}

/// Lengths and offsets of a blob, bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Header {
    /// Major format version.
    pub major: u16,
    /// Minor format version.
    pub minor: u16,
    /// Length of the whole blob.
    pub total_len: u32,
    /// Length of the manifest, which begins right after the header.
    pub manifest_len: u32,
    /// Offset of the weight section from the blob's start, a multiple of [`ALIGNMENT`].
    pub weights_offset: u32,
    /// Length of the weight section.
    pub weights_len: u32,
    /// CRC-32 of all bytes but the four of this field.
    pub crc: u32,
}

fn bytes<const N: usize>(from: &[u8], range: core::ops::Range<usize>) -> Result<[u8; N], Error> {
    from.get(range).and_then(|b| b.try_into().ok()).ok_or(Error::Header)
}

impl Header {
    /// Reads and checks the header of `blob`: magic, version, lengths, checksum.
    ///
    /// # Errors
    /// [`Error::Truncated`], [`Error::NotABlob`], [`Error::Version`], [`Error::Header`] or [`Error::Checksum`].
    pub fn parse(blob: &[u8]) -> Result<Self, Error> {
        let available = u32::try_from(blob.len()).unwrap_or(u32::MAX);
        if blob.len() < HEADER_LEN {
            return Err(Error::Truncated { needed: HEADER_LEN as u32, available });
        }
        let found = bytes::<4>(blob, field::MAGIC)?;
        if found != MAGIC {
            return Err(Error::NotABlob { found });
        }
        let word = |range| bytes::<4>(blob, range).map(u32::from_le_bytes);
        let header = Header {
            major: u16::from_le_bytes(bytes(blob, field::MAJOR)?),
            minor: u16::from_le_bytes(bytes(blob, field::MINOR)?),
            total_len: word(field::TOTAL_LEN)?,
            manifest_len: word(field::MANIFEST_LEN)?,
            weights_offset: word(field::WEIGHTS_OFFSET)?,
            weights_len: word(field::WEIGHTS_LEN)?,
            crc: word(field::CRC)?,
        };
        if header.major != MAJOR {
            return Err(Error::Version { found: header.major, supported: MAJOR });
        }
        if header.total_len > available {
            return Err(Error::Truncated { needed: header.total_len, available });
        }
        let manifest_end = u64::from(header.manifest_len) + HEADER_LEN as u64;
        let weights_end = u64::from(header.weights_offset) + u64::from(header.weights_len);
        if manifest_end > u64::from(header.weights_offset)
            || weights_end != u64::from(header.total_len)
            || !(header.weights_offset as usize).is_multiple_of(ALIGNMENT)
        {
            return Err(Error::Header);
        }
        let computed = Self::checksum(blob.get(..header.total_len as usize).ok_or(Error::Header)?);
        if computed != header.crc {
            return Err(Error::Checksum { computed, stored: header.crc });
        }
        Ok(header)
    }

    /// The header as bytes; `crc` is written as it stands.
    #[must_use]
    pub fn emit(&self) -> [u8; HEADER_LEN] {
        let mut out = [0u8; HEADER_LEN];
        let words: [&[u8]; 8] = [
            &MAGIC,
            &self.major.to_le_bytes(),
            &self.minor.to_le_bytes(),
            &self.total_len.to_le_bytes(),
            &self.manifest_len.to_le_bytes(),
            &self.weights_offset.to_le_bytes(),
            &self.weights_len.to_le_bytes(),
            &self.crc.to_le_bytes(),
        ];
        for (to, from) in out.iter_mut().zip(words.iter().flat_map(|w| w.iter())) {
            *to = *from;
        }
        out
    }

    /// CRC-32 of `blob` without the four bytes of the CRC field itself.
    #[must_use]
    pub fn checksum(blob: &[u8]) -> u32 {
        let before = blob.get(..field::CRC.start).unwrap_or(blob);
        let after = blob.get(field::CRC.end..).unwrap_or(&[]);
        !crc32(crc32(!0, before), after)
    }
}

/// One step of CRC-32 (IEEE 802.3, reflected polynomial `0xEDB88320`) over `bytes`: start with `!0`, invert the end.
#[must_use]
pub fn crc32(mut state: u32, bytes: &[u8]) -> u32 {
    for &byte in bytes {
        state ^= u32::from(byte);
        // Two table look-ups of four bits: a 64-byte table is a fair price in flash for 2 MiB checked at start.
        state = (state >> 4) ^ NIBBLES.get(state as usize & 15).copied().unwrap_or(0);
        state = (state >> 4) ^ NIBBLES.get(state as usize & 15).copied().unwrap_or(0);
    }
    state
}

static NIBBLES: [u32; 16] = {
    let mut table = [0u32; 16];
    let mut i = 0;
    while i < 16 {
        let mut value = i as u32;
        let mut bit = 0;
        while bit < 4 {
            value = if value & 1 == 1 { (value >> 1) ^ 0xEDB8_8320 } else { value >> 1 };
            bit += 1;
        }
        table[i] = value;
        i += 1;
    }
    table
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crc_of_the_standard_check_string() {
        assert_eq!(!crc32(!0, b"123456789"), 0xCBF4_3926);
    }

    #[test]
    fn header_round_trip() {
        let mut blob = [0u8; 64];
        let mut header = Header {
            major: MAJOR,
            minor: 3,
            total_len: 64,
            manifest_len: 9,
            weights_offset: 48,
            weights_len: 16,
            crc: 0,
        };
        blob[..HEADER_LEN].copy_from_slice(&header.emit());
        header.crc = Header::checksum(&blob);
        blob[..HEADER_LEN].copy_from_slice(&header.emit());
        assert_eq!(Header::parse(&blob), Ok(header));
        for length in 0..64 {
            assert!(matches!(Header::parse(&blob[..length]), Err(Error::Truncated { .. })), "{length}");
        }
        for bit in 0..64 * 8 {
            let mut damaged = blob;
            damaged[bit / 8] ^= 1 << (bit % 8);
            assert!(Header::parse(&damaged).is_err(), "bit {bit}");
        }
    }
}
