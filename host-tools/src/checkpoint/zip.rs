//! The zip archives `torch.save` writes: entries are stored, never compressed.
//!
//! Only the central directory is trusted for sizes (local headers carry zeros, flag bit 3), every offset is checked against
//! the file, names are plain keys that never touch the file system, and the CRC-32 of an entry is verified when it is read.

use std::collections::BTreeMap;

use super::error::{ErrorKind, Result};

const END_SIGNATURE: u32 = 0x0605_4b50;
const CENTRAL_SIGNATURE: u32 = 0x0201_4b50;
const LOCAL_SIGNATURE: u32 = 0x0403_4b50;
/// Fixed part of the end-of-central-directory record; a comment of up to 65535 bytes may follow.
const END_LEN: usize = 22;
const CENTRAL_LEN: usize = 46;
const LOCAL_LEN: usize = 30;

/// Where an entry's bytes are.
#[derive(Debug, Clone, Copy)]
struct Entry {
    start: usize,
    len: usize,
    crc: u32,
}

/// A checked view of a stored zip archive in memory.
#[derive(Debug)]
pub struct Archive<'a> {
    bytes: &'a [u8],
    entries: BTreeMap<String, Entry>,
}

impl<'a> Archive<'a> {
    /// Reads the central directory.
    ///
    /// # Errors
    /// [`ErrorKind::Zip`] with the byte offset: damaged or truncated records, compressed or encrypted entries, zip64.
    pub fn open(bytes: &'a [u8]) -> Result<Self> {
        let end = find_end(bytes)?;
        let count = usize::from(u16_at(bytes, end + 10)?);
        let size = u32_at(bytes, end + 12)? as usize;
        let start = u32_at(bytes, end + 16)? as usize;
        if start.checked_add(size).is_none_or(|stop| stop > end) {
            return Err(bad("the central directory lies outside the file", end));
        }
        let mut entries = BTreeMap::new();
        let mut at = start;
        for _ in 0..count {
            let (name, entry, next) = central_entry(bytes, at, end)?;
            entries.insert(name, entry);
            at = next;
        }
        Ok(Self { bytes, entries })
    }

    /// Entry names, sorted.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.entries.keys().map(String::as_str)
    }

    /// The bytes of an entry, `None` when there is no entry of that name.
    ///
    /// # Errors
    /// [`ErrorKind::Zip`] when the bytes do not match the stored CRC-32.
    pub fn read(&self, name: &str) -> Result<Option<&'a [u8]>> {
        let Some(entry) = self.entries.get(name) else {
            return Ok(None);
        };
        let data = &self.bytes[entry.start..entry.start + entry.len];
        let actual = crc32(data);
        if actual != entry.crc {
            let what = format!("entry `{name}` has CRC {actual:08x}, its directory says {:08x}", entry.crc);
            return Err(bad(what, entry.start));
        }
        Ok(Some(data))
    }
}

fn bad(what: impl Into<String>, at: usize) -> ErrorKind {
    ErrorKind::Zip { what: what.into(), at }
}

fn field<const N: usize>(bytes: &[u8], at: usize) -> Result<[u8; N]> {
    at.checked_add(N)
        .and_then(|end| bytes.get(at..end))
        .and_then(|s| s.try_into().ok())
        .ok_or_else(|| bad("the file ends inside a record", at))
}

fn u16_at(bytes: &[u8], at: usize) -> Result<u16> {
    field(bytes, at).map(u16::from_le_bytes)
}

fn u32_at(bytes: &[u8], at: usize) -> Result<u32> {
    field(bytes, at).map(u32::from_le_bytes)
}

fn find_end(bytes: &[u8]) -> Result<usize> {
    let last = bytes.len().checked_sub(END_LEN).ok_or_else(|| bad("no end record: the file is too short", 0))?;
    let first = last.saturating_sub(usize::from(u16::MAX));
    (first..=last)
        .rev()
        .find(|&at| u32_at(bytes, at).is_ok_and(|s| s == END_SIGNATURE))
        .ok_or_else(|| bad("no end record (file cut short)", bytes.len()))
}

/// Parses one central directory record: name, place of the data, offset of the next record.
fn central_entry(bytes: &[u8], at: usize, limit: usize) -> Result<(String, Entry, usize)> {
    if at.checked_add(CENTRAL_LEN).is_none_or(|e| e > limit) || u32_at(bytes, at)? != CENTRAL_SIGNATURE {
        return Err(bad("damaged directory record", at));
    }
    let flags = u16_at(bytes, at + 8)?;
    let method = u16_at(bytes, at + 10)?;
    let crc = u32_at(bytes, at + 16)?;
    let packed = u32_at(bytes, at + 20)?;
    let len = u32_at(bytes, at + 24)?;
    let name_len = usize::from(u16_at(bytes, at + 28)?);
    let extra_len = usize::from(u16_at(bytes, at + 30)?);
    let comment_len = usize::from(u16_at(bytes, at + 32)?);
    let local = u32_at(bytes, at + 42)?;
    if [packed, len, local].contains(&u32::MAX) {
        return Err(bad("zip64 entry (4 GiB or more), which no tokenizer needs", at));
    }
    let next = at + CENTRAL_LEN + name_len + extra_len + comment_len;
    let name = bytes
        .get(at + CENTRAL_LEN..at + CENTRAL_LEN + name_len)
        .filter(|_| next <= limit)
        .ok_or_else(|| bad("directory record runs over its end", at))?;
    let name = core::str::from_utf8(name).map_err(|_| bad("entry name is not UTF-8", at))?.to_owned();
    if flags & 1 != 0 {
        return Err(bad(format!("entry `{name}` is encrypted"), at));
    }
    if method != 0 || packed != len {
        return Err(bad(format!("entry `{name}` is compressed (method {method})"), at));
    }
    let local = local as usize;
    if u32_at(bytes, local)? != LOCAL_SIGNATURE {
        return Err(bad(format!("entry `{name}` has no local header"), local));
    }
    let skip = usize::from(u16_at(bytes, local + 26)?) + usize::from(u16_at(bytes, local + 28)?);
    let start = local + LOCAL_LEN + skip;
    let len = len as usize;
    if start.checked_add(len).is_none_or(|e| e > bytes.len()) {
        return Err(bad(format!("entry `{name}` of {len} bytes runs over the end of the file"), start));
    }
    Ok((name, Entry { start, len, crc }, next))
}

/// CRC-32 (IEEE 802.3, reflected, as zip uses), one byte at a time.
fn crc32(data: &[u8]) -> u32 {
    const fn table() -> [u32; 256] {
        let mut t = [0_u32; 256];
        let mut n = 0;
        while n < 256 {
            let mut c = n as u32;
            let mut k = 0;
            while k < 8 {
                c = if c & 1 != 0 { 0xedb8_8320 ^ (c >> 1) } else { c >> 1 };
                k += 1;
            }
            t[n] = c;
            n += 1;
        }
        t
    }
    const TABLE: [u32; 256] = table();
    !data.iter().fold(!0_u32, |c, &b| TABLE[((c ^ u32::from(b)) & 0xff) as usize] ^ (c >> 8))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn crc_check_value() {
        // The check value every CRC-32 catalogue lists.
        assert_eq!(crc32(b"123456789"), 0xcbf4_3926);
    }

    #[test]
    fn rubbish_is_refused_with_its_place() {
        for bytes in [&b""[..], b"PK\x03\x04", &[0_u8; 100], b"PK\x05\x06aaaaaaaaaaaaaaaaaaaaaa"] {
            let error = Archive::open(bytes).expect_err("rubbish was opened");
            assert!(matches!(error, ErrorKind::Zip { .. }), "{error}");
        }
    }
}
