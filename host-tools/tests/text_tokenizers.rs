//! The runtime's text tokenizer against the reference's restatement of its rules.

mod common;

use common::Random;
use motionette::text::table::WordIds;
use motionette::text::words::{UNKNOWN, Vocabulary as RuntimeVocabulary, Words};
use motionette_host::reference::text::Vocabulary;

const WORDS: [&str; 32] = [
    "<none>",
    "<unknown>",
    "a",
    "the",
    "person",
    "walk",
    "waves",
    "carry",
    "dance",
    "run",
    "jumps",
    "stop",
    "skip",
    "left",
    "don't",
    "'",
    "'s",
    "s",
    "ing",
    "e",
    "es",
    "über",
    "歩く",
    "2",
    "cross",
    "crossing",
    "sees",
    "hurries",
    "boxes",
    "wash",
    "i",
    "bus",
];

/// Pieces of which most concatenations are near a word's form.
const PIECES: [&str; 30] = [
    "walk", "Walk", "wave", "carr", "danc", "run", "runn", "jump", "stopp", "skipp", "hurr", "box", "s", "es", "ies",
    "'s", "ing", "ed", "e", "'", " ", " ", ", ", "-", "\u{a0}", "Ü", "ü", "歩く", "2", "\u{301}",
];

/// What both make of a prompt.
fn readers() -> impl Fn(&str) -> (Vec<u16>, Vec<u16>) {
    let joined = WORDS.join("\n");
    let reference = Vocabulary::new(&WORDS.map(str::to_owned));
    move |prompt| {
        let runtime = WordIds::Listed(RuntimeVocabulary::new(&joined));
        (Words::new(prompt).map(|word| runtime.id(&word)).collect(), reference.read(prompt).ids)
    }
}

#[test]
fn both_read_the_same_words() {
    let (both, mut random) = (readers(), Random(7));
    let (mut words, mut known) = (0, 0);
    for _ in 0..4000 {
        let count = random.bits() % 9;
        let prompt: String = (0..count).map(|_| PIECES[(random.bits() % PIECES.len() as u64) as usize]).collect();
        let (runtime, reference) = both(&prompt);
        assert_eq!(runtime, reference, "{prompt:?}");
        words += runtime.len();
        known += runtime.iter().filter(|id| **id != UNKNOWN).count();
    }
    assert!(words > 4000 && known > words / 5 && known < words, "{known} of {words}");
}

#[test]
fn every_character_separates_or_not_in_both() {
    let both = readers();
    for c in (0..0x3_0000_u32).filter_map(char::from_u32) {
        let (runtime, reference) = both(&format!("a{c}a"));
        assert_eq!(runtime, reference, "{c:?}");
    }
}

#[test]
fn long_words_are_unknown_to_both() {
    for length in 25..45 {
        for ending in ["", "s", "ing"] {
            let prompt = format!("{}{ending}", "b".repeat(length));
            let long =
                WORDS.iter().map(|w| (*w).to_owned()).chain(["b".repeat(31), "b".repeat(32)]).collect::<Vec<_>>();
            let joined = long.join("\n");
            let runtime: Vec<u16> =
                Words::new(&prompt).map(|w| WordIds::Listed(RuntimeVocabulary::new(&joined)).id(&w)).collect();
            assert_eq!(runtime, Vocabulary::new(&long).read(&prompt).ids, "{prompt}");
        }
    }
}
