//! The receiver: any pieces, any garbage.

mod common;

use common::Random;
use motionette_link::frame::{Fault, Receiver, encode};

const LIMIT: usize = 64;
type Small = Receiver<LIMIT>;

fn frame(message: &[u8]) -> Vec<u8> {
    let mut buffer = [0; 512];
    encode(&message, &mut buffer).unwrap().to_vec()
}

/// Everything that comes out, when `bytes` come in pieces of up to `piece` bytes.
fn receive(receiver: &mut Small, bytes: &[u8], piece: usize, random: &mut Random) -> (Vec<Vec<u8>>, Vec<Fault>) {
    let (mut messages, mut faults) = (Vec::new(), Vec::new());
    let mut rest = bytes;
    while !rest.is_empty() {
        let (mut part, behind) = rest.split_at(1 + random.below(piece.min(rest.len())));
        rest = behind;
        while let Some(received) = receiver.next(&mut part) {
            match received {
                Ok(message) => messages.push(message[1..].to_vec()),
                Err(fault) => faults.push(fault),
            }
        }
    }
    (messages, faults)
}

#[test]
fn any_pieces_give_the_same_messages() {
    for seed in 0..300 {
        let mut random = Random::new(seed);
        let sent: Vec<Vec<u8>> = (0..8)
            .map(|_| {
                let n = random.below(LIMIT - 4);
                random.bytes(n)
            })
            .collect();
        let line: Vec<u8> = sent.iter().flat_map(|message| frame(message)).collect();
        let piece = 1 + random.below(200);
        let mut receiver = Small::new();
        assert_eq!(receive(&mut receiver, &line, piece, &mut random), (sent, vec![]), "seed {seed}");
        assert_eq!(receiver.faults().total(), 0);
    }
}

/// Garbage stands between frames: every frame arrives, nothing else does, and all garbage is counted.
#[test]
fn garbage_between_frames_costs_no_frame() {
    for seed in 0..2000 {
        let mut random = Random::new(seed);
        let (mut line, mut sent, mut garbled) = (Vec::new(), Vec::new(), 0);
        for _ in 0..6 {
            if random.once_in(2) {
                let length = 1 + random.below(3 * LIMIT);
                let garbage: Vec<u8> = random.bytes(length);
                // What zeros cut it into.
                garbled += garbage.split(|&byte| byte == 0).filter(|part| !part.is_empty()).count();
                line.extend(garbage);
            }
            let length = random.below(LIMIT - 4);
            let message = random.bytes(length);
            line.extend(frame(&message));
            sent.push(message);
        }
        let mut receiver = Small::new();
        let (messages, faults) = receive(&mut receiver, &line, 40, &mut random);
        assert_eq!(messages, sent, "seed {seed}");
        assert_eq!(faults.len(), garbled, "seed {seed}");
        assert_eq!(receiver.faults().total() as usize, garbled);
    }
}

/// A bit error, a lost or an added byte spoils the frame it hits and no other.
#[test]
fn damage_is_reported_and_stays_where_it_is() {
    let mut kinds = [0; 3];
    for seed in 0..3000 {
        let mut random = Random::new(seed);
        let sent: Vec<Vec<u8>> = (0..5).map(|_| random.bytes(20)).collect();
        let frames: Vec<Vec<u8>> = sent.iter().map(|message| frame(message)).collect();
        let mut hit = frames[2].clone();
        let at = random.below(hit.len());
        match random.below(3) {
            0 => hit[at] ^= 1 << random.below(8),
            1 => drop(hit.remove(at)),
            _ => hit.insert(at, random.bits() as u8),
        }
        let line = [&frames[0][..], &frames[1], &hit, &frames[3], &frames[4]].concat();
        let mut receiver = Small::new();
        let (messages, faults) = receive(&mut receiver, &line, 9, &mut random);
        for message in &messages {
            assert!(sent.contains(message), "seed {seed}: a message that nobody sent");
        }
        for index in [0, 1, 3, 4] {
            assert!(messages.contains(&sent[index]), "seed {seed}: message {index} is lost");
        }
        // A delimiter more, or one less of two, does no harm.
        assert!(messages.len() == sent.len() || !faults.is_empty(), "seed {seed}: lost without a word");
        for fault in faults {
            kinds[match fault {
                Fault::Encoding => 0,
                Fault::TooLong { .. } => 1,
                _ => 2,
            }] += 1;
        }
    }
    assert!(kinds[0] > 500 && kinds[2] > 500, "{kinds:?}");
}

#[test]
fn what_is_too_long_is_skipped_and_said() {
    let mut receiver = Small::new();
    let mut random = Random::new(5);
    // A postcard slice has its length in front; four bytes of checksum are behind.
    let fits = random.bytes(LIMIT - 5);
    let long = random.bytes(LIMIT - 4);
    let longest = vec![7; 400];
    let line = [frame(&fits), frame(&long), frame(&fits), frame(&longest), frame(&fits)].concat();
    let (messages, faults) = receive(&mut receiver, &line, 1, &mut random);
    assert_eq!(messages, [fits.clone(), fits.clone(), fits]);
    assert_eq!(faults, [Fault::TooLong { limit: LIMIT }; 2]);
    assert_eq!(receiver.faults().too_long, 2);
    for fault in [Fault::Encoding, Fault::Checksum, Fault::TooLong { limit: LIMIT }] {
        assert!(fault.to_string().contains("skipped"));
    }
}
