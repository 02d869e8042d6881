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

/// What a word has to say of an order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Kind {
    Other,
    /// `and`, `but`.
    And,
    /// `then`, `afterwards`: B follows.
    Then,
    Next,
    Followed,
    By,
    After,
    Before,
    /// `that`, `this`.
    That,
    /// Who does something: behind one of these `before` and `after` speak of time.
    Subject,
    /// What is done: the same.
    Doing,
    /// `since`, `until`, `now`: a `then` behind them says no order.
    Since,
}

/// Words of each kind, in lower case; a word that ends in `ing` and is not here is something that is done.
const KINDS: [(&str, Kind); 32] = [
    ("and", Kind::And),
    ("but", Kind::And),
    ("then", Kind::Then),
    ("afterwards", Kind::Then),
    ("afterward", Kind::Then),
    ("next", Kind::Next),
    ("followed", Kind::Followed),
    ("by", Kind::By),
    ("after", Kind::After),
    ("before", Kind::Before),
    ("that", Kind::That),
    ("this", Kind::That),
    ("i", Kind::Subject),
    ("you", Kind::Subject),
    ("he", Kind::Subject),
    ("she", Kind::Subject),
    ("we", Kind::Subject),
    ("they", Kind::Subject),
    ("it", Kind::Subject),
    ("since", Kind::Since),
    ("until", Kind::Since),
    ("now", Kind::Since),
    ("king", Kind::Other),
    ("ring", Kind::Other),
    ("string", Kind::Other),
    ("thing", Kind::Other),
    ("something", Kind::Other),
    ("anything", Kind::Other),
    ("nothing", Kind::Other),
    ("everything", Kind::Other),
    ("morning", Kind::Other),
    ("building", Kind::Other),
];

impl Kind {
    #[inline(never)]
    fn of(word: &[u8]) -> Self {
        let known = KINDS.iter().find(|(known, _)| known.as_bytes().eq_ignore_ascii_case(word));
        let doing = || word.last_chunk().is_some_and(|end: &[u8; 3]| end.eq_ignore_ascii_case(b"ing"));
        known.map_or_else(|| if doing() { Kind::Doing } else { Kind::Other }, |(_, kind)| *kind)
    }
}

/// What stands in front of a word.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Mark {
    None,
    Comma,
    /// A full stop or semicolon, and a space.
    Stop,
}

/// A word of a text.
#[derive(Debug, Clone, Copy)]
struct Place {
    from: u16,
    to: u16,
    kind: Kind,
    mark: Mark,
}

/// Nothing before or behind a text.
const NOWHERE: Place = Place { from: 0, to: 0, kind: Kind::Other, mark: Mark::None };

/// A text with the places of its words.
struct Sentence<'p> {
    text: &'p str,
    words: Vec<Place, MAX_WORDS>,
}

impl<'p> Sentence<'p> {
    /// `None` for a text that is too long to be parted.
    fn new(text: &'p str) -> Option<Self> {
        let mut words = Vec::new();
        let (mut begin, mut mark, mut last) = (None, Mark::None, ' ');
        for (at, c) in text.char_indices().chain([(text.len(), ' ')]) {
            let at = u16::try_from(at).ok()?;
            let letter = c.is_alphanumeric() || c == '\'';
            match begin {
                None if letter => begin = Some(at),
                Some(from) if !letter => {
                    let word = text.as_bytes().get(from.into()..at.into())?;
                    words.push(Place { from, to: at, kind: Kind::of(word), mark }).ok()?;
                    (begin, mark) = (None, Mark::None);
                }
                _ => {}
            }
            // A full stop alone may belong to a number.
            let found = match (last, c) {
                ('.' | ';', ' ' | '\n') => Mark::Stop,
                (_, ',') => Mark::Comma,
                _ => Mark::None,
            };
            if begin.is_none() && found > mark {
                mark = found;
            }
            last = c;
        }
        Some(Sentence { text, words })
    }

    #[inline(never)]
    fn at(&self, index: usize) -> Place {
        self.words.get(index).copied().unwrap_or(NOWHERE)
    }

    fn is(&self, index: usize, kind: Kind) -> bool {
        self.at(index).kind == kind
    }

    /// Whether somebody does something from this word on: "you sit", "he has sat", "sitting".
    fn acts(&self, index: usize) -> bool {
        self.is(index, Kind::Doing) || (self.is(index, Kind::Subject) && index + 1 < self.words.len())
    }

    /// The text from one word up to another, without it and without an "and" before it; `None` when nothing is left.
    #[inline(never)]
    fn part(&self, from: usize, to: usize) -> Option<&'p str> {
        let to = if to > from && self.is(to - 1, Kind::And) { to - 1 } else { to };
        let last = to.checked_sub(1).filter(|last| *last >= from)?;
        self.text.get(self.at(from).from.into()..self.at(last).to.into())
    }

    /// The words from one up to another, twice; `None` when nothing is left of either.
    #[inline(never)]
    fn parts(&self, first: (usize, usize), second: (usize, usize)) -> Option<[&'p str; 2]> {
        Some([self.part(first.0, first.1)?, self.part(second.0, second.1)?])
    }

    /// How many words say an order there, and whether what follows them is done first; `None` where none do.
    fn order(&self, word: usize) -> Option<(usize, bool)> {
        let (before, Place { kind, mark, .. }) = (word - 1, self.at(word));
        match kind {
            Kind::Then if !self.is(before, Kind::Since) => Some((1, false)),
            Kind::Next if mark > Mark::None || self.is(before, Kind::And) => Some((1, false)),
            Kind::Followed if self.is(word + 1, Kind::By) => Some((2, false)),
            Kind::After if self.is(word + 1, Kind::That) => Some((2, false)),
            Kind::Before if self.acts(word + 1) => Some((1, false)),
            Kind::After if self.acts(word + 1) => Some((1, true)),
            _ if mark == Mark::Stop => Some((0, false)),
            _ => None,
        }
    }
}

/// The first place at which a text is parted: what is done first, and what then.
#[inline(never)]
fn cut(text: &str) -> Option<[&str; 2]> {
    let sentence = Sentence::new(text)?;
    let all = sentence.words.len();
    if sentence.is(0, Kind::After) && !sentence.is(1, Kind::That) {
        let begins = |&word: &usize| sentence.at(word).mark == Mark::Comma || sentence.is(word, Kind::Subject);
        if let Some(word) = (2..all).find(begins) {
            return sentence.parts((1, word), (word, all));
        }
    }
    for word in 1..all {
        let Some((said, swapped)) = sentence.order(word) else { continue };
        if word + said < all {
            let (first, second) = ((0, word), (word + said, all));
            return if swapped { sentence.parts(second, first) } else { sentence.parts(first, second) };
        }
        // They stand at the end: "jump first, clap after that".
        let begins = |&other: &usize| sentence.at(other).mark == Mark::Comma || sentence.is(other - 1, Kind::And);
        let other = (1..word).rev().find(begins)?;
        return sentence.parts((0, other), (other, word));
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
