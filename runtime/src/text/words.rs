//! Prompts to words, words to ids.
//!
//! A word is a maximal run of alphanumeric characters (Unicode's) and apostrophes (`'`), ASCII letters in lower case.
//! [`Word::forms`] says how a word that a table does not hold may still be one of its words in another form.

/// Longest word that can be known, bytes.
pub const MAX_WORD: usize = 32;
/// Longest prompt, bytes: more is refused before it is read.
pub const MAX_PROMPT: usize = 4096;
/// Id of `<none>`: the only word of the prompt that says nothing.
pub const UNCONDITIONAL: u16 = 0;
/// Id of `<unknown>`: every word outside the vocabulary.
pub const UNKNOWN: u16 = 1;

/// Room for the longest word with the longest ending.
const BUFFER: usize = MAX_WORD + 4;

/// One word in lower case. One that is longer than [`MAX_WORD`] has lost its end, and is no word of any vocabulary.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Word {
    bytes: [u8; BUFFER],
    len: usize,
    whole: bool,
}

impl Word {
    const EMPTY: Self = Word { bytes: [0; BUFFER], len: 0, whole: true };

    /// Its UTF-8 bytes.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        self.bytes.get(..self.len).unwrap_or(&[])
    }

    /// The word; empty when it lost its end inside a character.
    #[must_use]
    pub fn as_str(&self) -> &str {
        core::str::from_utf8(self.bytes()).unwrap_or("")
    }

    fn push(&mut self, bytes: &[u8], limit: usize) {
        for byte in bytes {
            match self.bytes.get_mut(self.len) {
                Some(slot) if self.len < limit => {
                    *slot = *byte;
                    self.len += 1;
                }
                _ => self.whole = false,
            }
        }
    }

    /// What `find` says of the word or, where it knows none, of the first other form that it knows.
    ///
    /// Other forms, in this order: the ending `'s`, `s`, `es` taken off; `ies` to `y`; `ing` taken off, to `e`, to `s`;
    /// `ed` the same; `s`, `es`, `ing` added; `ing` behind a doubled consonant taken off with one of the two (`running`
    /// to `run`), and that with `s`.
    #[must_use]
    pub fn forms<T>(&self, find: impl Fn(&[u8]) -> Option<T>) -> Option<T> {
        if !self.whole {
            return None;
        }
        if let Some(found) = find(self.bytes()) {
            return Some(found);
        }
        let forms = ENDINGS.iter().filter(|(old, _)| self.bytes().ends_with(old));
        for form in forms.map(|(old, new)| self.with(old.len(), new)) {
            if let Some(found) = find(form.bytes()) {
                return Some(found);
            }
        }
        if let [.., a, b, b'i', b'n', b'g'] = self.bytes()
            && a == b
            && a.is_ascii_lowercase()
            && !matches!(a, b'a' | b'e' | b'i' | b'o' | b'u')
        {
            return [b"".as_slice(), b"s"].into_iter().find_map(|ending| find(self.with(4, ending).bytes()));
        }
        None
    }

    /// The word without the last `less` bytes and with `ending` behind.
    fn with(&self, less: usize, ending: &[u8]) -> Word {
        let mut word = *self;
        word.len = word.len.saturating_sub(less);
        word.push(ending, BUFFER);
        word
    }
}

/// The words of a prompt in order.
#[derive(Debug, Clone)]
pub struct Words<'p> {
    rest: core::str::Chars<'p>,
}

impl<'p> Words<'p> {
    /// The words of `prompt`.
    #[must_use]
    pub fn new(prompt: &'p str) -> Self {
        Words { rest: prompt.chars() }
    }
}

impl Iterator for Words<'_> {
    type Item = Word;

    fn next(&mut self) -> Option<Word> {
        let mut word = Word::EMPTY;
        let mut found = false;
        for c in self.rest.by_ref() {
            if c.is_alphanumeric() || c == '\'' {
                found = true;
                let mut utf8 = [0; 4];
                word.push(c.to_ascii_lowercase().encode_utf8(&mut utf8).as_bytes(), MAX_WORD);
            } else if found {
                break;
            }
        }
        found.then_some(word)
    }
}

/// Words by id: `\n` between them, [`UNCONDITIONAL`] and [`UNKNOWN`] first.
#[derive(Debug, Clone, Copy)]
pub struct Vocabulary<'a> {
    words: &'a str,
}

/// Endings that a word may lose for another, in the order in which they are tried.
const ENDINGS: [(&[u8], &[u8]); 13] = [
    (b"'s", b""),
    (b"s", b""),
    (b"es", b""),
    (b"ies", b"y"),
    (b"ing", b""),
    (b"ing", b"e"),
    (b"ing", b"s"),
    (b"ed", b""),
    (b"ed", b"e"),
    (b"ed", b"s"),
    (b"", b"s"),
    (b"", b"es"),
    (b"", b"ing"),
];

impl<'a> Vocabulary<'a> {
    /// The vocabulary in `words`, `\n` between.
    #[must_use]
    pub const fn new(words: &'a str) -> Self {
        Vocabulary { words }
    }

    /// Words there are; an empty string has none.
    #[must_use]
    pub fn len(&self) -> usize {
        if self.words.is_empty() { 0 } else { self.entries().count() }
    }

    /// Whether there are none.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.words.is_empty()
    }

    /// Words in id order.
    pub fn entries(&self) -> impl Iterator<Item = &'a [u8]> + use<'a> {
        self.words.as_bytes().split(|byte| *byte == b'\n')
    }

    /// Place of an entry.
    #[must_use]
    pub fn position(&self, entry: &[u8]) -> Option<u16> {
        if entry.is_empty() {
            return None;
        }
        self.entries().position(|e| e == entry).and_then(|at| u16::try_from(at).ok())
    }
}

#[cfg(test)]
mod tests {
    use super::super::table::WordIds;
    use super::*;
    use std::string::String;
    use std::vec::Vec;

    const WORDS: &str = "<none>\n<unknown>\na\nperson\nwaves\nwalk\ndance\nrun\nhurry\njumps\nleft\nnaïve\ncarry\ngo\nskip\nskips\npush\n2";

    fn ids_of(words: &str, prompt: &str) -> Vec<u16> {
        let ids = WordIds::Listed(Vocabulary::new(words));
        Words::new(prompt).map(|word| ids.id(&word)).collect()
    }

    fn ids(prompt: &str) -> Vec<u16> {
        ids_of(WORDS, prompt)
    }

    fn id(word: &str) -> u16 {
        WORDS.split('\n').position(|w| w == word).unwrap() as u16
    }

    #[test]
    fn words_are_runs_of_letters_digits_and_apostrophes_in_lower_case() {
        let words = |prompt| Words::new(prompt).map(|w| String::from(w.as_str())).collect::<Vec<_>>();
        assert_eq!(words("A  person,waves...\tTWICE!"), ["a", "person", "waves", "twice"]);
        assert_eq!(words("person's left-hand 2x"), ["person's", "left", "hand", "2x"]);
        assert_eq!(words("naïve ÉTÉ 歩く"), ["naïve", "ÉtÉ", "歩く"]);
        assert_eq!(words(" ,.\n-"), Vec::<String>::new());
        assert_eq!(words(""), Vec::<String>::new());
        assert_eq!(words("<none>"), ["none"]);
    }

    #[test]
    fn forms_are_tried_in_order() {
        let cases = [
            ("waves", "waves"),
            ("WAVES", "waves"),
            ("person's", "person"),
            ("persons", "person"),
            ("pushes", "push"),
            ("hurries", "hurry"),
            ("walking", "walk"),
            ("dancing", "dance"),
            ("waving", "<unknown>"),
            ("jumping", "jumps"),
            ("walked", "walk"),
            ("danced", "dance"),
            ("jumped", "jumps"),
            ("jump", "jumps"),
            ("running", "run"),
            ("skipping", "skip"),
            ("going", "go"),
            ("seeing", "<unknown>"),
            ("s", "<unknown>"),
            ("ing", "<unknown>"),
            ("'s", "<unknown>"),
            ("<none>", "<unknown>"),
            ("2", "2"),
            ("naïve", "naïve"),
        ];
        for (word, expected) in cases {
            assert_eq!(ids(word), [id(expected)], "{word}");
        }
        assert_eq!(ids("a person  walks, running left!"), ["a", "person", "walk", "run", "left"].map(id));
    }

    #[test]
    fn long_words_are_unknown_and_nothing_else_is_lost() {
        let long = "a".repeat(10_000);
        assert_eq!(ids(&long), [UNKNOWN]);
        assert_eq!(ids(&std::format!("{long} person")), [UNKNOWN, id("person")]);
        let vocabulary = "x".repeat(MAX_WORD);
        let word = |n: usize| Words::new(&"x".repeat(n)).next().unwrap();
        let listed = WordIds::Listed(Vocabulary::new(&vocabulary));
        assert_eq!((listed.id(&word(MAX_WORD)), listed.id(&word(MAX_WORD + 1))), (0, UNKNOWN));
        // Cut inside a character.
        let umlauts = "ü".repeat(17);
        assert_eq!(Words::new(&umlauts).count(), 1);
        assert_eq!(ids(&std::format!("x{umlauts} person")), [UNKNOWN, id("person")]);
    }

    #[test]
    fn empty_entries_and_empty_vocabularies_match_nothing() {
        assert_eq!(Vocabulary::new("").len(), 0);
        assert_eq!(ids_of("", "s"), [UNKNOWN]);
        assert_eq!(Vocabulary::new("a\n\nb").position(b""), None);
        assert_eq!(Vocabulary::new("a\n\nb").len(), 3);
    }
}
