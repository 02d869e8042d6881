//! Decoding the defmt frames of an image.

use anyhow::{Result, anyhow, bail};
use defmt_decoder::{DecodeError, Table};

/// Decodes `bytes`, written by the image with the ELF file `elf`, to one line a frame; levelled messages begin with theirs.
///
/// # Errors
/// When the image carries no defmt table, or the bytes are no frames of it.
pub fn decode(elf: &[u8], bytes: &[u8]) -> Result<Vec<String>> {
    let table = Table::parse(elf)?.ok_or_else(|| anyhow!("the image has no .defmt section: is defmt.x linked?"))?;
    let mut stream = table.new_stream_decoder();
    stream.received(bytes);
    let mut lines = Vec::new();
    loop {
        match stream.decode() {
            Ok(frame) => {
                let level = frame.level().map_or_else(String::new, |level| format!("{level:?}: ").to_lowercase());
                lines.push(format!("{level}{}", frame.display_message()));
            }
            Err(DecodeError::UnexpectedEof) => return Ok(lines),
            Err(DecodeError::Malformed) => bail!("frame {} of the image's output is malformed", lines.len()),
        }
    }
}
