//! Bytes of a file to text with `\n` at the end of a line.

/// UTF-16 with a byte order mark is decoded, everything else taken as UTF-8 (broken parts become the replacement character: only names
/// can hold them). Ends of lines may be LF, CR LF, or CR alone as old Macintosh programs write them.
pub(super) fn text(bytes: &[u8]) -> String {
    let text = match bytes {
        [0xff, 0xfe, rest @ ..] => utf16(rest, u16::from_le_bytes),
        [0xfe, 0xff, rest @ ..] => utf16(rest, u16::from_be_bytes),
        _ => String::from_utf8_lossy(bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes)).into_owned(),
    };
    if text.contains('\r') { text.replace("\r\n", "\n").replace('\r', "\n") } else { text }
}

fn utf16(bytes: &[u8], unit: fn([u8; 2]) -> u16) -> String {
    let (pairs, odd) = bytes.as_chunks::<2>();
    let decoded = char::decode_utf16(pairs.iter().map(|&pair| unit(pair)));
    let mut text: String = decoded.map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER)).collect();
    if !odd.is_empty() {
        text.push(char::REPLACEMENT_CHARACTER);
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_encoding_gives_the_same_text() {
        let plain = "ROOT H\u{fc}fte\n{\n\n}\n";
        let wide = |unit: fn(u16) -> [u8; 2]| -> Vec<u8> {
            "\u{feff}".encode_utf16().chain(plain.encode_utf16()).flat_map(unit).collect()
        };
        let with_mark = [b"\xef\xbb\xbf", plain.as_bytes()].concat();
        for bytes in [plain.into(), with_mark, wide(u16::to_le_bytes), wide(u16::to_be_bytes)] {
            assert_eq!(text(&bytes), plain);
        }
        assert_eq!(text(plain.replace('\n', "\r").as_bytes()), plain);
        assert_eq!(text(plain.replace('\n', "\r\n").as_bytes()), plain);
        assert_eq!(text(&[0xff, 0xfe, b'a', 0, 0x00, 0xd8, b'b']), "a\u{fffd}\u{fffd}");
        assert_eq!(text(b"\xff"), "\u{fffd}");
    }
}
