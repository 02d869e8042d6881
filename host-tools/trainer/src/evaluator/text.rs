//! Sentences as word numbers, and the sentences of mirrored motion.

use std::collections::BTreeSet;

/// Number of every word that is not in the vocabulary.
pub const UNKNOWN: usize = 0;

/// The words of a sentence: runs of letters, digits and apostrophes in lower case.
pub fn words(text: &str) -> Vec<String> {
    text.to_lowercase()
        .split(|c: char| !c.is_alphanumeric() && c != '\'')
        .filter(|word| !word.is_empty())
        .map(str::to_owned)
        .collect()
}

/// What a word or a part of a label becomes when left and right change places.
fn other_side(word: &str) -> &str {
    match word {
        "left" => "right",
        "right" => "left",
        "leftward" => "rightward",
        "rightward" => "leftward",
        "clockwise" => "counterclockwise",
        "counterclockwise" => "clockwise",
        other => other,
    }
}

/// The words of a sentence about the mirrored motion.
pub fn mirrored_words(words: &[String]) -> Vec<String> {
    words.iter().map(|word| other_side(word).to_owned()).collect()
}

/// The label (`walk-turn-left`) of the mirrored motion.
pub fn mirrored_label(label: &str) -> String {
    label.split('-').map(other_side).collect::<Vec<_>>().join("-")
}

/// Words by number; 0 is [`UNKNOWN`].
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Vocabulary {
    words: Vec<String>,
}

impl Vocabulary {
    /// All words of the sentences, in alphabetical order.
    pub fn of<'a>(sentences: impl Iterator<Item = &'a [String]>) -> Self {
        let known: BTreeSet<&String> = sentences.flatten().collect();
        Self { words: known.into_iter().cloned().collect() }
    }

    /// From a list in the order of the numbers, beginning with number 1.
    pub fn from_words(words: Vec<String>) -> Self {
        Self { words }
    }

    /// The list that [`Self::from_words`] takes; must be sorted.
    pub fn words(&self) -> &[String] {
        &self.words
    }

    /// How many numbers there are, [`UNKNOWN`] included.
    pub fn size(&self) -> usize {
        self.words.len() + 1
    }

    /// Numbers of words.
    pub fn numbers(&self, words: &[String]) -> Vec<usize> {
        words.iter().map(|word| self.words.binary_search(word).map_or(UNKNOWN, |index| index + 1)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn punctuation_separates_and_case_does_not_matter() {
        assert_eq!(words("A person's LEFT hand,  waves."), ["a", "person's", "left", "hand", "waves"]);
        assert!(words(" .,!").is_empty());
    }

    #[test]
    fn mirrored_twice_is_the_original() {
        assert_eq!(mirrored_label("walk-turn-left"), "walk-turn-right");
        assert_eq!(mirrored_label("raise-up-both-hands"), "raise-up-both-hands");
        for label in ["walk-left", "wave-right-hand", "upright", "dance-short"] {
            assert_eq!(mirrored_label(&mirrored_label(label)), label);
        }
        assert_eq!(mirrored_words(&words("turns right, upright")), ["turns", "left", "upright"]);
    }

    #[test]
    fn words_are_found_by_number() {
        let sentences = [words("b a"), words("c a")];
        let vocabulary = Vocabulary::of(sentences.iter().map(Vec::as_slice));
        assert_eq!(vocabulary.size(), 4);
        assert_eq!(vocabulary.numbers(&words("a c zebra b")), [1, 3, UNKNOWN, 2]);
        assert_eq!(Vocabulary::from_words(vocabulary.words().to_vec()), vocabulary);
    }
}
