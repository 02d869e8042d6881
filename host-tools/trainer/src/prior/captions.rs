//! Words of sentences, and their mirror images.

use std::collections::{BTreeMap, BTreeSet};

use motionette::text::words::Words;
use motionette_host::reference::text;

/// Id of the empty prompt, the unconditional side of guidance.
pub const UNCONDITIONAL: usize = 0;
/// Id of every word that the vocabulary lacks.
pub const UNKNOWN: usize = 1;

/// Words of a sentence, as a device reads them.
pub fn words(text: &str) -> Vec<String> {
    Words::new(text).map(|word| word.as_str().to_owned()).collect()
}

/// Known words in the order of their ids.
#[derive(Clone, Debug)]
pub struct Vocabulary {
    /// Words; 0 is the empty prompt, 1 the unknown word.
    pub words: Vec<String>,
    ids: BTreeMap<String, usize>,
    /// The same words, found in other forms as well.
    forms: text::Vocabulary,
}

impl PartialEq for Vocabulary {
    fn eq(&self, other: &Self) -> bool {
        self.words == other.words
    }
}

impl Vocabulary {
    /// Of all words of these sentences, in alphabetic order.
    pub fn of<'t>(sentences: impl Iterator<Item = &'t str>) -> Self {
        let found: BTreeSet<String> = sentences.flat_map(words).collect();
        Self::with(found.into_iter())
    }

    /// Of these words, behind the empty prompt and the unknown word.
    pub fn with(words: impl Iterator<Item = String>) -> Self {
        Self::new(["<none>", "<unknown>"].map(String::from).into_iter().chain(words).collect())
    }

    /// Of words in the order of their ids.
    pub fn new(words: Vec<String>) -> Self {
        let ids = words.iter().enumerate().map(|(id, word)| (word.clone(), id)).collect();
        Self { ids, forms: text::Vocabulary::new(&words), words }
    }

    /// Ids of a sentence's words, at most `limit`; words stand for themselves alone.
    pub fn encode(&self, text: &str, limit: usize) -> Vec<usize> {
        let id = |word: String| self.ids.get(&word).copied().unwrap_or(UNKNOWN);
        words(text).into_iter().take(limit).map(id).collect()
    }

    /// Ids of a sentence's words, at most `limit`, as a device finds them: in other forms as well.
    pub fn read(&self, text: &str, limit: usize) -> Vec<usize> {
        self.forms.read(text).ids.into_iter().take(limit).map(usize::from).collect()
    }
}

/// Words that change places in a mirror.
const SIDES: [(&str, &str); 4] =
    [("left", "right"), ("leftward", "rightward"), ("leftwards", "rightwards"), ("clockwise", "counterclockwise")];

/// The sentence about the mirrored motion.
pub fn mirrored(text: &str) -> String {
    let other = |word: &str| {
        let swapped = SIDES.iter().find_map(|(a, b)| match word {
            _ if word == *a => Some(*b),
            _ if word == *b => Some(*a),
            _ => None,
        });
        swapped.unwrap_or(word).to_owned()
    };
    words(text).iter().map(|word| other(word)).collect::<Vec<_>>().join(" ")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sentences_become_ids_and_unknown_words_are_marked() {
        let vocabulary = Vocabulary::of(["A person waves.", "it's over"].into_iter());
        assert_eq!(vocabulary.words, ["<none>", "<unknown>", "a", "it's", "over", "person", "waves"]);
        assert_eq!(vocabulary.encode("It's a PERSON, juggling!", 9), [3, 2, 5, UNKNOWN]);
        assert_eq!(vocabulary.encode("a person waves", 2), [2, 5]);
        assert_eq!(vocabulary.encode("a persons", 2), [2, UNKNOWN]);
        assert_eq!(vocabulary.read("a persons waves", 2), [2, 5]);
    }

    #[test]
    fn a_mirror_swaps_sides_and_swaps_them_back() {
        let text = "walks left then waves the right hand";
        assert_eq!(mirrored(text), "walks right then waves the left hand");
        assert_eq!(mirrored(&mirrored(text)), text);
    }
}
