//! Mutated blobs. Lengths and checksum are mostly repaired after the mutation, so that what lies behind them is reached.

use motionette::ROWS;
use motionette::blob::{HEADER_LEN, Header, MAGIC, MAJOR};
use motionette::numerics::hash::Stream;
use motionette::{Anchor, Generator, Model, Prompt, Request, refining::Config};

use super::{Entry, Memory, Tally};

/// Bytes that often sit on a limit: of variable-length integers, signs, sizes.
const BYTES: [u8; 12] = [0, 1, 2, 3, 7, 16, 0x3F, 0x7F, 0x80, 0x81, 0xFE, 0xFF];

/// Singles that arithmetic stumbles over.
const SINGLES: [f32; 12] =
    [0.0, -0.0, 1.0, -1.0, f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::MIN_POSITIVE, 1e-45, 1e20, -1e20];

/// Mutates the entry's blob, opens it and, if that succeeds, runs a request on it.
///
/// # Errors
/// What a reader may not do.
pub fn case(entry: &Entry<'_>, random: &mut Stream, memory: &mut Memory, tally: &mut Tally) -> Result<(), String> {
    let mut bytes = entry.model.bytes().to_vec();
    for _ in 0..1 + random.below(4) {
        mutate(&mut bytes, random);
    }
    if random.below(16) != 0 {
        repair(&mut bytes);
    }
    let blob = memory.blob.painted(bytes.len());
    blob.copy_from_slice(&bytes);
    let model = match Model::open(blob) {
        Ok(model) => model,
        Err(error) => {
            tally.blobs_refused += 1;
            return if error.to_string().is_empty() { Err("an error without words".to_owned()) } else { Ok(()) };
        }
    };
    tally.blobs_opened += 1;
    let codes = model.codebooks().codes() as u32;
    let positions = 1 + random.below(6) as usize;
    let tokens: Vec<u16> =
        (0..positions * model.codebooks().quantizers()).map(|_| random.below(codes) as u16).collect();
    let anchors = [Anchor::root(0, [0.1, 1.0, 0.0]), Anchor::joint(1, 20, [0.3, 1.2, 0.4])];
    let text = Request { planning: super::requests::planning(random, &[]), ..Request::text("a person runs left") };
    let kinds = if model.text().is_some() { 5 } else { 2 };
    let request = match random.below(kinds) {
        0 => Request::tokens(&tokens),
        1 => Request::tokens(&tokens).through(&anchors).refined(Config::fast(3)),
        2 => text,
        3 => Request { planning: text.planning, ..Request::prompt(Prompt::Bank("wave")) },
        _ => text.through(&anchors).refined(Config::fast(2)),
    };
    // Refusals are to be about the blob, so there is as much memory as any blob of this size can make use of.
    let need = super::requests::need(&model, &request, ROWS).unwrap_or(0).max(super::requests::least(&model));
    let mut generator = Generator::new(model, memory.arena.painted(need)).map_err(|e| e.to_string())?;
    super::requests::serve(&mut generator, &request, &mut (), tally)?;
    let _ = generator.self_test();
    Ok(())
}

/// Changes `bytes` in one place, preferring header and manifest, which decide how the rest is read.
fn mutate(bytes: &mut Vec<u8>, random: &mut Stream) {
    let weights = word(bytes, 16).unwrap_or(0) as usize;
    let structured = weights.clamp(HEADER_LEN.min(bytes.len()), bytes.len().max(1));
    let anywhere = |random: &mut Stream, length: usize| random.below(length.max(1) as u32) as usize;
    match random.below(8) {
        // A bit, somewhere.
        0 => {
            let at = anywhere(random, bytes.len());
            if let Some(byte) = bytes.get_mut(at) {
                *byte ^= 1 << random.below(8);
            }
        }
        // A byte of header or manifest.
        1..=3 => {
            let at = anywhere(random, structured);
            if let Some(byte) = bytes.get_mut(at) {
                *byte = BYTES[anywhere(random, BYTES.len())];
            }
        }
        // A single in the weights.
        4 | 5 => {
            let at = (structured + anywhere(random, bytes.len().saturating_sub(structured))) & !3;
            if let Some(slot) = bytes.get_mut(at..at + 4) {
                slot.copy_from_slice(&SINGLES[anywhere(random, SINGLES.len())].to_le_bytes());
            }
        }
        // A run of bytes of the manifest repeated or removed.
        6 => {
            let at = anywhere(random, structured);
            let end = (at + 1 + random.below(16) as usize).min(bytes.len());
            if random.below(2) == 0 {
                let run = bytes[at..end].to_vec();
                bytes.splice(at..at, run);
            } else {
                bytes.drain(at..end);
            }
        }
        // The end cut off or longer.
        _ => {
            let length = if random.below(2) == 0 { anywhere(random, bytes.len()) } else { bytes.len() + 64 };
            bytes.resize(length, 0xFF);
        }
    }
}

fn word(bytes: &[u8], at: usize) -> Option<u32> {
    Some(u32::from_le_bytes(bytes.get(at..at + 4)?.try_into().ok()?))
}

/// Makes magic, version, total length and checksum fit the bytes, where there are enough of them.
fn repair(bytes: &mut [u8]) {
    if bytes.len() < HEADER_LEN {
        return;
    }
    let total = bytes.len() as u32;
    let offset = word(bytes, 16).unwrap_or(0);
    bytes[..4].copy_from_slice(&MAGIC);
    bytes[4..6].copy_from_slice(&MAJOR.to_le_bytes());
    bytes[8..12].copy_from_slice(&total.to_le_bytes());
    if offset <= total {
        bytes[20..24].copy_from_slice(&(total - offset).to_le_bytes());
    }
    let crc = Header::checksum(bytes);
    bytes[24..28].copy_from_slice(&crc.to_le_bytes());
}
