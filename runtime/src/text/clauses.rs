//! What a prompt asks for one thing behind the other: "walk, then wave" has two clauses, and each is planned for itself.
//!
//! Only words that say an order part a prompt; "and" does not, since two things may be done at once:
//!
//! | words | order |
//! |---|---|
//! | `A then B`, `A, and afterwards B`, `A, next B`, `A followed by B`, `A and after that B`, `A. B`, `A; B` | A, B |
//! | `A first, B after that`, `A, B afterwards` | A, B |
//! | `A before you B`, `A before B-ing` | A, B |
//! | `B after you have A-ed`, `B after A-ing`; `after A, B`, `after A he B` | A, B |
//!
//! `before` and `after` say a place as well ("bow before the king", "run after the dog"), hence the word that must follow.

use heapless::Vec;

/// Most clauses of a prompt; what follows belongs to the last.
pub const MAX_CLAUSES: usize = 3;
/// A prompt of more words has one clause.
const MAX_WORDS: usize = 48;

/// The clauses of a prompt, in the order in which they are to be done.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Clauses<'p> {
    parts: [&'p str; MAX_CLAUSES],
    len: usize,
}

impl<'p> Clauses<'p> {
    /// A prompt that is not parted.
    #[must_use]
    pub const fn whole(prompt: &'p str) -> Self {
        Clauses { parts: [prompt, "", ""], len: 1 }
    }

    /// The clauses of `prompt`, at least one.
    #[must_use]
    pub fn of(prompt: &'p str) -> Self {
        let mut clauses = Self::whole(prompt);
        while clauses.len < MAX_CLAUSES {
            let Some(last) = clauses.parts.get_mut(clauses.len - 1) else { break };
            let Some([first, second]) = cut(last) else { break };
            *last = first;
            if let Some(next) = clauses.parts.get_mut(clauses.len) {
                *next = second;
            }
            clauses.len += 1;
        }
        clauses
    }

    /// How many.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.len
    }

    /// Never.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.len == 0
    }

    /// Each of them.
    pub fn iter(&self) -> impl Iterator<Item = &'p str> + '_ {
        self.parts.iter().take(self.len).copied()
    }
}

/// A text with the places of its words.
struct Sentence<'p> {
    text: &'p str,
    words: Vec<(u16, u16), MAX_WORDS>,
}

/// Who does something: behind one of these `before` and `after` speak of time.
const SUBJECTS: [&str; 7] = ["i", "you", "he", "she", "we", "they", "it"];

impl<'p> Sentence<'p> {
    /// `None` for a text that is too long to be parted.
    fn new(text: &'p str) -> Option<Self> {
        let mut words = Vec::new();
        let mut begin = None;
        for (at, c) in text.char_indices().chain([(text.len(), ' ')]) {
            let at = u16::try_from(at).ok()?;
            match (begin, c.is_alphanumeric() || c == '\'') {
                (None, true) => begin = Some(at),
                (Some(from), false) => {
                    words.push((from, at)).ok()?;
                    begin = None;
                }
                _ => {}
            }
        }
        Some(Sentence { text, words })
    }

    fn len(&self) -> usize {
        self.words.len()
    }

    /// A word; empty where there is none.
    fn word(&self, index: usize) -> &'p str {
        self.words.get(index).and_then(|&(from, to)| self.text.get(from.into()..to.into())).unwrap_or("")
    }

    fn is(&self, index: usize, word: &str) -> bool {
        self.word(index).eq_ignore_ascii_case(word)
    }

    fn any(&self, index: usize, words: &[&str]) -> bool {
        words.iter().any(|word| self.is(index, word))
    }

    /// Whether one of `marks`, and a space, stand in front of a word.
    fn mark(&self, index: usize, marks: &[char]) -> bool {
        let ends = index.checked_sub(1).and_then(|before| Some((self.words.get(before)?.1, self.words.get(index)?.0)));
        let between = ends.and_then(|(from, to)| self.text.get(from.into()..to.into()));
        between.is_some_and(|between| between.contains(marks) && between.ends_with(char::is_whitespace))
    }

    /// Whether somebody does something from this word on: "you sit", "he has sat", "sitting".
    fn acts(&self, index: usize) -> bool {
        let ing =
            self.word(index).as_bytes().last_chunk().is_some_and(|end: &[u8; 3]| end.eq_ignore_ascii_case(b"ing"));
        let subject = self.any(index, &SUBJECTS) && index + 1 < self.len();
        subject
            || (ing && !self.any(index, &["king", "ring", "thing", "something", "anything", "everything", "morning"]))
    }

    /// The text from one word up to another, without it and without an "and" before it; `None` when nothing is left.
    fn part(&self, from: usize, to: usize) -> Option<&'p str> {
        let to = if to > from && self.any(to - 1, &["and", "but"]) { to - 1 } else { to };
        let last = to.checked_sub(1).filter(|last| *last >= from)?;
        let (begin, end) = (self.words.get(from)?.0, self.words.get(last)?.1);
        self.text.get(begin.into()..end.into())
    }
}

/// The first place at which a text is parted: what is done first, and what then.
fn cut(text: &str) -> Option<[&str; 2]> {
    let sentence = Sentence::new(text)?;
    let all = sentence.len();
    if sentence.is(0, "after") && !sentence.any(1, &["that", "this"]) {
        let begins = |&word: &usize| sentence.mark(word, &[',']) || sentence.any(word, &SUBJECTS);
        if let Some(word) = (2..all).find(begins) {
            return Some([sentence.part(1, word)?, sentence.part(word, all)?]);
        }
    }
    for word in 1..all {
        let joined = sentence.mark(word, &[',', ';', '.']) || sentence.any(word - 1, &["and", "but"]);
        // Words that say an order there.
        let said = match () {
            () if sentence.is(word, "then") && !sentence.any(word - 1, &["since", "until", "now"]) => 1,
            () if sentence.any(word, &["afterwards", "afterward"]) => 1,
            () if sentence.is(word, "next") && joined => 1,
            () if sentence.is(word, "followed") && sentence.is(word + 1, "by") => 2,
            () if sentence.is(word, "after") && sentence.any(word + 1, &["that", "this"]) => 2,
            () if sentence.is(word, "before") && sentence.acts(word + 1) => 1,
            () if sentence.is(word, "after") && sentence.acts(word + 1) => {
                return Some([sentence.part(word + 1, all)?, sentence.part(0, word)?]);
            }
            () if sentence.mark(word, &[';', '.']) => 0,
            () => continue,
        };
        if word + said < all {
            return Some([sentence.part(0, word)?, sentence.part(word + said, all)?]);
        }
        // They stand at the end: "jump first, clap after that".
        let begins = |&other: &usize| sentence.mark(other, &[',']) || sentence.is(other - 1, "and");
        let other = (1..word).rev().find(begins)?;
        return Some([sentence.part(0, other)?, sentence.part(other, word)?]);
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::String;

    fn clauses(prompt: &str) -> std::vec::Vec<&str> {
        Clauses::of(prompt).iter().collect()
    }

    #[test]
    fn words_that_say_an_order_part_a_prompt() {
        let cases: [(&str, &[&str]); 22] = [
            ("he walks up and then waves", &["he walks up", "waves"]),
            ("Wave, THEN walk on.", &["Wave", "walk on"]),
            ("she claps and afterwards jumps", &["she claps", "jumps"]),
            ("go forward, afterwards go backward", &["go forward", "go backward"]),
            ("jump first, clap after that", &["jump first", "clap"]),
            ("clap, jump afterwards", &["clap", "jump"]),
            ("clap and jump afterwards", &["clap", "jump"]),
            ("bow, and after that wave with the right hand", &["bow", "wave with the right hand"]),
            ("clap, next put both hands up", &["clap", "put both hands up"]),
            ("throw a few punches, followed by a kick", &["throw a few punches", "a kick"]),
            ("wave before you sit down", &["wave", "you sit down"]),
            ("wave before sitting down", &["wave", "sitting down"]),
            ("lie down after you have walked for a bit", &["you have walked for a bit", "lie down"]),
            ("sits down after walking", &["walking", "sits down"]),
            ("after a jump she goes into a squat", &["a jump", "she goes into a squat"]),
            ("after walking, sit down", &["walking", "sit down"]),
            ("walk. then wave", &["walk", "wave"]),
            ("walk; wave", &["walk", "wave"]),
            ("A man walks. He waves.", &["A man walks", "He waves"]),
            ("walk, then run, then jump", &["walk", "run", "jump"]),
            ("walk, then run, then jump, then fall", &["walk", "run", "jump, then fall"]),
            ("then walk then wave", &["then walk", "wave"]),
        ];
        for (prompt, expected) in cases {
            assert_eq!(clauses(prompt), expected, "{prompt}");
        }
    }

    #[test]
    fn nothing_else_parts_a_prompt() {
        let whole = [
            "",
            " ",
            "then",
            "then walk",
            "walk then",
            "a person walks and waves",
            "bow before the king",
            "kneel before me",
            "run after the dog",
            "run after it",
            "after",
            "after that walk",
            "walk to the next door",
            "jump now and then",
            "stand still since then",
            "a person walks...",
            "before walking",
            "and then",
            "followed by",
            "3.5 m",
        ];
        for prompt in whole {
            assert_eq!(clauses(prompt), [prompt]);
        }
        let long = "walk then ".repeat(30);
        assert_eq!(clauses(&long), [long.as_str()], "too many words");
        let huge = String::from("walk then wave ") + &" ".repeat(1 << 16) + "now";
        assert_eq!(clauses(&huge), [huge.as_str()], "too many bytes");
        assert_eq!(clauses("Зайти. naïve; ÉTÉ"), ["Зайти", "naïve", "ÉTÉ"]);
    }
}
