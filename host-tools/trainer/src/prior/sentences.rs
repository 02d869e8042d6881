//! What is said of motions in training, and what it is to be understood as.

use std::collections::{BTreeMap, BTreeSet};

use motionette::numerics::hash::Stream;
use motionette_host::checkpoint::WordTable;
use motionette_host::checkpoint::prior::Meaning;
use motionette_host::dataset::{ClipView, Dataset, Side, Split};
use motionette_host::import::phrases::Phrases;

use super::captions::{UNCONDITIONAL, UNKNOWN, Vocabulary, mirrored, words};
use super::config::Config;
use super::state::Sources;
use crate::random::Random;

/// Share of phrases with a misspelt word.
const MISSPELT: f64 = 0.03;
/// The style that is none.
pub const NORMAL: &str = "normal";
/// Words that say a side.
const SIDES: [&str; 4] = ["left", "right", "clockwise", "counterclockwise"];
/// A phrase that is held out is drawn again so often; then there is a caption in its place.
const DRAWS: usize = 8;
/// Sentences about nothing that a body does; `*` is a word that neither captions nor phrases have.
const NONSENSE: [&str; 12] = [
    "* * *",
    "* * * * *",
    "the * is *",
    "a person * the *",
    "how to * a *",
    "what is the * of * ?",
    "the * and the * *",
    "* of the * *",
    "my * * every *",
    "why do * * ?",
    "please * the * of this *",
    "* * in * and * * with * *",
];

/// A sentence with what it means.
#[derive(Clone, Debug, PartialEq)]
pub struct Said {
    /// Numbers of its words.
    pub words: Vec<usize>,
    /// Which of [`Sentences::meanings`] it has; none where nobody knows.
    pub meanings: Option<Vec<usize>>,
}

impl Said {
    /// Nothing, the unconditional side of guidance.
    pub fn nothing() -> Self {
        Self { words: vec![UNCONDITIONAL], meanings: None }
    }
}

/// What is done, on which side.
type Deed = (String, Side);

/// What a clip or its mirrored twin shows, where the dataset says it.
fn deed(clip: &ClipView<'_>, twin: bool) -> Option<Deed> {
    let (action, side) = (clip.info.action()?, clip.info.side());
    Some(if twin { (mirrored(action).replace(' ', "-"), side.mirrored()) } else { (action.to_owned(), side) })
}

/// Captions and phrases, with the words that have a number.
#[derive(Clone, Debug)]
pub struct Sentences {
    /// Words that have a number.
    pub vocabulary: Vocabulary,
    /// What sentences may mean, actions before styles.
    pub meanings: Vec<Meaning>,
    phrases: Option<Phrases>,
    /// Numbers of words that no caption and no phrase has; empty without a word table.
    strange: Vec<usize>,
    /// Sentences, as [`plain`] writes them, that are never said.
    held_out: BTreeSet<String>,
}

impl Sentences {
    /// About the training split of `dataset`: its captions and, where there are some, `phrases` about its actions. The words are those of
    /// `table`, or else of the captions and their mirror images.
    pub fn new(dataset: &Dataset, table: Option<&WordTable>, phrases: Option<Phrases>) -> Self {
        let train = || dataset.split(Split::Train);
        let vocabulary = match table {
            Some(table) => Vocabulary::with(table.words.iter().cloned()),
            None => {
                let captions = train().flat_map(|clip| clip.info.captions.iter());
                let both: Vec<String> = captions.flat_map(|c| [c.text.clone(), mirrored(&c.text)]).collect();
                Vocabulary::of(both.iter().map(String::as_str))
            }
        };
        let strange = table.map_or_else(Vec::new, |table| strange(&table.tiers));
        let meanings = phrases.as_ref().map_or_else(Vec::new, |phrases| meanings(dataset, phrases));
        Self { vocabulary, meanings, phrases, strange, held_out: BTreeSet::new() }
    }

    /// The same sentences with the words and meanings of a prior that was trained.
    #[must_use]
    pub fn of_prior(self, prior: &Sources) -> Self {
        let strange = strange(&prior.word_tiers);
        Self { vocabulary: prior.vocabulary(), meanings: prior.meanings.clone(), strange, ..self }
    }

    /// The same without these sentences, which are kept for tests.
    #[must_use]
    pub fn without<'t>(self, held_out: impl Iterator<Item = &'t str>) -> Self {
        Self { held_out: held_out.map(plain).collect(), ..self }
    }

    /// A phrase, unless it is held out.
    fn phrase(&self, mut draw: impl FnMut(&Phrases) -> Option<String>) -> Option<String> {
        let phrases = self.phrases.as_ref()?;
        (0..DRAWS).find_map(|_| draw(phrases).filter(|text| !self.held_out.contains(&plain(text))))
    }

    /// A sentence about a clip or its twin: nothing at all, a phrase, or one of its captions.
    pub fn draw(&self, clip: &ClipView<'_>, twin: bool, config: &Config, random: &mut Random) -> Said {
        if random.unit() < config.text_dropout {
            return Said::nothing();
        }
        let deed = deed(clip, twin);
        let phrased = random.unit() < config.phrases;
        let text = deed.as_ref().filter(|_| phrased).and_then(|(action, side)| {
            let style = clip.info.style().filter(|style| *style != NORMAL || random.unit() < 0.3);
            let (stream, misspelt) = (&mut Stream::new(random.bits()), random.unit() < MISSPELT);
            self.phrase(|phrases| {
                let text = phrases.sentence(action, *side, style, stream)?;
                Some(if misspelt { phrases.misspelt(&text, stream) } else { text })
            })
        });
        let text = text.unwrap_or_else(|| caption(clip, twin, random));
        let style = clip.info.style().filter(|style| *style != NORMAL);
        let meanings = deed.and_then(|(action, side)| {
            let mut all = vec![self.action(&action, side, &text)?];
            all.extend(style.and_then(|style| self.meanings.iter().position(|m| m.style && m.name == style)));
            Some(all)
        });
        self.said(&text, meanings, config, random)
    }

    /// A sentence about two motions, the first of which comes first; none where phrases lack one of them.
    pub fn sequence(&self, clips: [(&ClipView<'_>, bool); 2], config: &Config, random: &mut Random) -> Option<Said> {
        if random.unit() < config.text_dropout {
            return Some(Said::nothing());
        }
        let [(first, first_side), (second, second_side)] =
            [deed(clips[0].0, clips[0].1)?, deed(clips[1].0, clips[1].1)?];
        let stream = &mut Stream::new(random.bits());
        let text = self.phrase(|phrases| phrases.sequence((&first, first_side), (&second, second_side), stream))?;
        // Which of the two a word for a side belongs to is not known here.
        let plain = |action: &str, side| self.action(action, side, "");
        let meanings = plain(&first, first_side).into_iter().chain(plain(&second, second_side)).collect();
        Some(self.said(&text, Some(meanings), config, random))
    }

    /// Words that say nothing about a motion; none without a word table.
    pub fn nonsense(&self, random: &mut Random) -> Option<Said> {
        let strange = (!self.strange.is_empty()).then_some(&self.strange)?;
        let form = NONSENSE[random.below(NONSENSE.len())];
        let number = |word: &str| match word {
            "*" => strange[random.below(strange.len())],
            word => self.vocabulary.encode(word, 1).first().copied().unwrap_or(UNKNOWN),
        };
        Some(Said {
            words: form.split(' ').filter(|word| *word != "?").map(number).collect(),
            meanings: Some(Vec::new()),
        })
    }

    /// The first caption of a clip or its twin.
    pub fn first(&self, clip: &ClipView<'_>, twin: bool, max_words: usize) -> Vec<usize> {
        let text = &clip.info.captions[0].text;
        let text = if twin { mirrored(text) } else { text.clone() };
        let words = self.vocabulary.read(&text, max_words);
        if words.is_empty() { vec![UNCONDITIONAL] } else { words }
    }

    fn said(&self, text: &str, meanings: Option<Vec<usize>>, config: &Config, random: &mut Random) -> Said {
        let mut words = self.vocabulary.read(text, config.architecture.max_words);
        for word in &mut words {
            if random.unit() < config.word_dropout {
                *word = UNKNOWN;
            }
        }
        if words.is_empty() { Said::nothing() } else { Said { words, meanings } }
    }

    /// The meaning of a sentence about `action`: with its side where the sentence says one.
    fn action(&self, action: &str, side: Side, text: &str) -> Option<usize> {
        let (name, side) = self.phrases.as_ref()?.entry(action, side)?;
        let says = words(text).iter().any(|word| SIDES.contains(&word.as_str()));
        let find = |side: Side| self.meanings.iter().position(|m| !m.style && m.name == name && m.side == side);
        if says { find(side).or_else(|| find(Side::None)) } else { find(Side::None) }
    }
}

/// Numbers of the words that no caption and no phrase has, by the tiers of all.
fn strange(tiers: &[u8]) -> Vec<usize> {
    tiers.iter().enumerate().filter(|(_, tier)| **tier > 0).map(|(row, _)| row + UNKNOWN + 1).collect()
}

/// The words of a sentence, with single spaces.
fn plain(text: &str) -> String {
    words(text).join(" ")
}

/// One of a clip's captions, mirrored for its twin.
fn caption(clip: &ClipView<'_>, twin: bool, random: &mut Random) -> String {
    let text = &clip.info.captions[random.below(clip.info.captions.len())].text;
    if twin { mirrored(text) } else { text.clone() }
}

/// What sentences about the training split may mean: every action that has phrases, without a side and with each that its clips have, then
/// every style but the normal one.
fn meanings(dataset: &Dataset, phrases: &Phrases) -> Vec<Meaning> {
    let mut actions: BTreeMap<(String, Side), String> = BTreeMap::new();
    let mut styles: BTreeSet<&str> = BTreeSet::new();
    for clip in dataset.split(Split::Train) {
        for twin in [false, true] {
            let Some((action, side)) = deed(&clip, twin) else { continue };
            let Some((name, side)) = phrases.entry(&action, side) else { continue };
            for side in [Side::None, side].into_iter().filter(|side| *side != Side::Both) {
                let said = phrases.plain(name, side);
                if let Some(said) = said {
                    actions.insert((name.to_owned(), side), said);
                }
            }
        }
        styles.extend(clip.info.style().filter(|style| *style != NORMAL));
    }
    let actions = actions.into_iter().map(|((name, side), phrase)| Meaning { name, side, style: false, phrase });
    let styles = styles.into_iter().filter_map(|name| {
        let phrase = phrases.plain_style(name)?;
        Some(Meaning { name: name.to_owned(), side: Side::None, style: true, phrase })
    });
    actions.chain(styles).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;
    use motionette_host::dataset::Facts;

    fn phrases() -> Phrases {
        Phrases::read("../../docs/phrases.toml").unwrap()
    }

    fn table() -> WordTable {
        WordTable::read(std::path::Path::new("../../models/words.safetensors")).unwrap()
    }

    /// Clips of somebody who waves one hand or walks, some of them angrily.
    fn waving() -> Dataset {
        let deeds = [("wave-right-hand", Some("angry")), ("walk", None), ("wave-left-hand", Some("normal"))];
        let place =
            |info: &motionette_host::dataset::Clip| info.id.trim_start_matches("figure").parse::<usize>().unwrap();
        testing::with_facts(&testing::dataset(9, 24), |info| {
            let (action, style) = deeds[place(info) % 3];
            Facts { action: action.into(), style: style.map(str::to_owned), ..testing::facts() }
        })
    }

    fn config() -> Config {
        Config { phrases: 1.0, text_dropout: 0.0, word_dropout: 0.0, ..Config::preset("nano").unwrap() }
    }

    #[test]
    fn a_sentence_means_its_action_and_style_and_the_side_that_it_says() {
        let (dataset, table) = (waving(), table());
        let sentences = Sentences::new(&dataset, Some(&table), Some(phrases()));
        let name = |meaning: usize| {
            let Meaning { name, side, .. } = &sentences.meanings[meaning];
            format!("{name} {side}")
        };
        let words = &sentences.vocabulary.words;
        let mut random = Random::new(3, 3);
        let (mut sides, mut unsaid) = (0, 0);
        for twin in [false, true] {
            for _ in 0..300 {
                let said = sentences.draw(&dataset.clip(0), twin, &config(), &mut random);
                let text: Vec<&str> = said.words.iter().map(|id| words[*id].as_str()).collect();
                let meanings: Vec<String> = said.meanings.unwrap().into_iter().map(name).collect();
                let says = text.contains(&"left") || text.contains(&"right");
                let side = if twin { "left" } else { "right" };
                let wanted = if says { side } else { "none" };
                assert_eq!(meanings, [format!("wave-{{side}}-hand {wanted}"), "angry none".into()], "{text:?}");
                assert!(!says || text.contains(&side), "{text:?}");
                sides += usize::from(says);
                unsaid += usize::from(!says);
            }
        }
        assert!(sides > 100 && unsaid > 10, "{sides} {unsaid}");
        let walk = sentences.draw(&dataset.clip(1), false, &config(), &mut random);
        assert_eq!(walk.meanings.unwrap().into_iter().map(name).collect::<Vec<_>>(), ["walk none"]);
        let phrase = |name: &str, side: Side| {
            let meaning = sentences.meanings.iter().find(|m| m.name == name && m.side == side).unwrap();
            meaning.phrase.as_str()
        };
        assert_eq!(phrase("walk", Side::None), "a person walks");
        assert_eq!(phrase("wave-{side}-hand", Side::Right), "a person waves their right hand");
        assert_eq!(phrase("wave-{side}-hand", Side::None), "a person waves");
        assert!(sentences.meanings.iter().all(|m| m.phrase.len() <= 64));
        assert!(sentences.meanings.iter().all(|m| m.name != "normal"), "no style at all is no style");
    }

    #[test]
    fn a_sequence_means_both_and_says_the_first_first() {
        let (dataset, table) = (waving(), table());
        let sentences = Sentences::new(&dataset, Some(&table), Some(phrases()));
        let clips = [dataset.clip(1), dataset.clip(2)];
        let mut random = Random::new(5, 5);
        for _ in 0..50 {
            let said = sentences.sequence([(&clips[0], false), (&clips[1], true)], &config(), &mut random).unwrap();
            let names: Vec<&str> =
                said.meanings.unwrap().into_iter().map(|m| sentences.meanings[m].name.as_str()).collect();
            assert_eq!(names, ["walk", "wave-{side}-hand"]);
            assert!(said.words.len() > 3);
        }
    }

    /// Known words are found in other forms; nonsense holds no word of captions or phrases but those of its form.
    #[test]
    fn nonsense_means_nothing() {
        let (dataset, table) = (waving(), table());
        let sentences = Sentences::new(&dataset, Some(&table), Some(phrases()));
        let mut random = Random::new(7, 7);
        for _ in 0..200 {
            let said = sentences.nonsense(&mut random).unwrap();
            assert_eq!(said.meanings, Some(Vec::new()));
            assert!(said.words.len() >= 3 && said.words.iter().filter(|id| **id == UNKNOWN).count() == 0);
            let strange = |id: &&usize| table.tiers.get(**id - 2).is_some_and(|tier| *tier > 0);
            assert!(said.words.iter().filter(strange).count() >= 2);
        }
        assert!(Sentences::new(&dataset, None, Some(phrases())).nonsense(&mut random).is_none());
    }

    /// The sentence that is said most is never said where it is held out, however it is written.
    #[test]
    fn sentences_that_are_held_out_are_never_said() {
        let (dataset, table) = (waving(), table());
        let said = |held_out: &[String]| {
            let sentences = Sentences::new(&dataset, Some(&table), Some(phrases()));
            let sentences = sentences.without(held_out.iter().map(String::as_str));
            let mut random = Random::new(9, 9);
            let mut counts: BTreeMap<Vec<usize>, usize> = BTreeMap::new();
            for _ in 0..3000 {
                *counts.entry(sentences.draw(&dataset.clip(1), false, &config(), &mut random).words).or_default() += 1;
            }
            (sentences.vocabulary, counts)
        };
        let (vocabulary, counts) = said(&[]);
        let (most, count) = counts.iter().max_by_key(|(_, count)| **count).unwrap();
        assert!(*count > 3);
        let text = most.iter().map(|id| vocabulary.words[*id].as_str()).collect::<Vec<_>>().join("  ").to_uppercase();
        assert_eq!(vocabulary.read(&text, 32), *most, "its words stand for themselves");
        // Held out are words as they are written: other forms of them have the same numbers.
        let left = said(&[text + "!"]).1.get(most).copied().unwrap_or_default();
        assert!(left < *count, "{left} of {count}");
    }

    /// Without phrases there are captions, whose meaning nobody knows.
    #[test]
    fn captions_alone_mean_nothing_known() {
        let dataset = waving();
        let sentences = Sentences::new(&dataset, None, None);
        assert!(sentences.meanings.is_empty());
        let said = sentences.draw(&dataset.clip(0), false, &config(), &mut Random::new(1, 1));
        assert_eq!((said.words, said.meanings), (sentences.first(&dataset.clip(0), false, 32), None));
    }
}
