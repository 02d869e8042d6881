//! Sentences for training: their words, their mirror images, and paraphrases of template captions.

use std::collections::{BTreeMap, BTreeSet};

use motionette::text::words::Words;
use motionette_host::dataset::ClipView;

use crate::random::Random;

/// Id of the empty prompt, the unconditional side of guidance.
pub const UNCONDITIONAL: usize = 0;
/// Id of every word that the vocabulary lacks.
pub const UNKNOWN: usize = 1;

/// Words of a sentence, as a device reads them.
pub fn words(text: &str) -> Vec<String> {
    Words::new(text).map(|word| word.as_str().to_owned()).collect()
}

/// Known words in the order of their ids.
#[derive(Clone, Debug, PartialEq)]
pub struct Vocabulary {
    /// Words; 0 is the empty prompt, 1 the unknown word.
    pub words: Vec<String>,
    ids: BTreeMap<String, usize>,
}

impl Vocabulary {
    /// Of all words of these sentences, in alphabetic order.
    pub fn of<'t>(sentences: impl Iterator<Item = &'t str>) -> Self {
        let found: BTreeSet<String> = sentences.flat_map(words).collect();
        Self::new(["<none>", "<unknown>"].map(String::from).into_iter().chain(found).collect())
    }

    /// Of words in the order of their ids.
    pub fn new(words: Vec<String>) -> Self {
        let ids = words.iter().enumerate().map(|(id, word)| (word.clone(), id)).collect();
        Self { words, ids }
    }

    /// Ids of a sentence's words, at most `limit`.
    pub fn encode(&self, text: &str, limit: usize) -> Vec<usize> {
        let id = |word: String| self.ids.get(&word).copied().unwrap_or(UNKNOWN);
        words(text).into_iter().take(limit).map(id).collect()
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

/// Adjectives for the style names of the label templates.
const ADJECTIVES: [(&str, &[&str]); 19] = [
    ("active", &["energetic", "lively", "active"]),
    ("normal", &[""]),
    ("feminine", &["feminine"]),
    ("youthful", &["youthful", "young"]),
    ("masculine", &["masculine"]),
    ("masculinity", &["masculine"]),
    ("exhausted", &["exhausted", "tired", "weary"]),
    ("tired", &["tired"]),
    ("elderly", &["elderly", "old"]),
    ("old", &["old", "elderly"]),
    ("angry", &["angry", "furious"]),
    ("childish", &["childish"]),
    ("giant", &["giant", "huge"]),
    ("happy", &["happy", "cheerful"]),
    ("musical", &["musical"]),
    ("not-confident", &["timid", "unsure", "shy"]),
    ("proud", &["proud"]),
    ("chimpira", &["thuggish"]),
    ("sad", &["sad", "unhappy"]),
];
/// Who may move.
const NOUNS: [&str; 6] = ["person", "human", "figure", "robot", "character", "man"];
/// How the templates begin.
const SUBJECTS: [&str; 4] = ["a person ", "the person ", "someone ", "a figure "];
/// How the templates say that nothing is special.
const PLAIN: [&str; 3] = [" naturally", " in a normal way", " in a normal manner"];

/// Other ways to say what template captions say: the style as an adjective of the subject, or no subject at all, as a command.
#[derive(Clone, Debug, Default)]
pub struct Paraphrases {
    /// Style-free predicates of every content.
    predicates: BTreeMap<String, Vec<String>>,
}

fn predicate(caption: &str) -> Option<&str> {
    let caption = caption.trim_end_matches('.');
    SUBJECTS.iter().find_map(|subject| caption.strip_prefix(subject))
}

impl Paraphrases {
    /// Learns the predicates from clips with an action in the style `normal`.
    pub fn of<'d>(clips: impl Iterator<Item = ClipView<'d>>) -> Self {
        let mut predicates: BTreeMap<String, BTreeSet<String>> = BTreeMap::new();
        for clip in clips.filter(|clip| clip.info.style() == Some("normal")) {
            let Some(content) = clip.info.action() else { continue };
            let found = clip.info.captions.iter().filter_map(|caption| predicate(&caption.text));
            let bare = found.map(|p| PLAIN.iter().find_map(|plain| p.strip_suffix(plain)).unwrap_or(p).to_owned());
            predicates.entry(content.to_owned()).or_default().extend(bare);
        }
        Self { predicates: predicates.into_iter().map(|(c, set)| (c, set.into_iter().collect())).collect() }
    }

    /// All words that a paraphrase may use.
    pub fn words(&self) -> impl Iterator<Item = &str> {
        let adjectives = ADJECTIVES.iter().flat_map(|(_, words)| words.iter().copied());
        let used = adjectives.chain(NOUNS).chain(["a", "an"]);
        used.filter(|_| !self.predicates.is_empty())
    }

    /// `caption` said in another way, drawn at random; itself where the labels allow none.
    pub fn draw(&self, clip: &ClipView<'_>, caption: &str, random: &mut Random) -> String {
        let choice = random.below(20);
        if choice < 3 {
            return predicate(caption).unwrap_or(caption).to_owned();
        }
        let style = ADJECTIVES.iter().find(|(style, _)| Some(*style) == clip.info.style());
        let predicates = clip.info.action().and_then(|content| self.predicates.get(content));
        let (Some((_, adjectives)), Some(predicates), true) = (style, predicates, choice < 8) else {
            return caption.to_owned();
        };
        let adjective = adjectives[random.below(adjectives.len())];
        let noun = NOUNS[random.below(NOUNS.len())];
        let predicate = &predicates[random.below(predicates.len())];
        let article = if adjective.starts_with(['a', 'e', 'i', 'o', 'u']) { "an" } else { "a" };
        if adjective.is_empty() {
            format!("a {noun} {predicate}")
        } else {
            format!("{article} {adjective} {noun} {predicate}")
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;

    #[test]
    fn sentences_become_ids_and_unknown_words_are_marked() {
        let vocabulary = Vocabulary::of(["A person waves.", "it's over"].into_iter());
        assert_eq!(vocabulary.words, ["<none>", "<unknown>", "a", "it's", "over", "person", "waves"]);
        assert_eq!(vocabulary.encode("It's a PERSON, juggling!", 9), [3, 2, 5, UNKNOWN]);
        assert_eq!(vocabulary.encode("a person waves", 2), [2, 5]);
    }

    #[test]
    fn a_mirror_swaps_sides_and_swaps_them_back() {
        let text = "walks left then waves the right hand";
        assert_eq!(mirrored(text), "walks right then waves the left hand");
        assert_eq!(mirrored(&mirrored(text)), text);
    }

    #[test]
    fn paraphrases_keep_action_and_style() {
        let mut dataset = testing::dataset(2, 20);
        for (clip, (style, text)) in dataset.clips.iter_mut().zip([
            ("normal", "a person waves the left hand in a normal way."),
            ("exhausted", "someone waves the left hand as if exhausted."),
        ]) {
            clip.labels = serde_json::json!({"content": "wave-left-hand", "style": style});
            clip.captions = vec![motionette_host::dataset::Caption {
                text: text.into(),
                from: 0.0,
                to: 0.0,
                source: "label_template".into(),
            }];
        }
        let paraphrases = Paraphrases::of(dataset.iter());
        let clip = dataset.clip(1);
        let mut random = Random::new(1, 1);
        let said: BTreeSet<String> =
            (0..2000).map(|_| paraphrases.draw(&clip, &clip.info.captions[0].text, &mut random)).collect();
        assert!(said.contains("a weary robot waves the left hand"), "{said:?}");
        assert!(said.contains("waves the left hand as if exhausted"), "{said:?}");
        let known = Vocabulary::of(
            paraphrases.words().chain(dataset.iter().flat_map(|c| c.info.captions.iter().map(|c| c.text.as_str()))),
        );
        assert!(said.iter().all(|s| s.contains("left hand") && !known.encode(s, 99).contains(&UNKNOWN)), "{said:?}");
    }
}
