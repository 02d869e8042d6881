//! What is asked of a generator, and what comes back.

use std::collections::BTreeMap;

use motionette_host::dataset::{ClipView, Dataset, Label, Split};
use motionette_host::motion::Pose;

use crate::evaluator::config::MIN_FRAMES;
use crate::prior::captions::words;
use crate::tokenizer::config::{FRAMES_PER_TOKEN, MAX_FRAMES};

/// Longest motion of a model, tokens.
pub const MAX_TOKENS: usize = MAX_FRAMES / FRAMES_PER_TOKEN;

/// A sentence about a clip of the test split, and how long the motion is to be.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Prompt {
    /// Index of the clip in the dataset.
    pub clip: usize,
    /// The sentence.
    pub caption: String,
    /// Action it asks for.
    pub content: String,
    /// Style it asks for, where it asks for one.
    pub style: Option<String>,
    /// Number of the triple of action, side and style.
    pub label: usize,
    /// Length that is asked for, tokens.
    pub tokens: usize,
}

/// A motion of some origin.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// Global joints, metres; four frames a token.
    pub joints: Vec<Pose>,
    /// Its tokens.
    pub tokens: Vec<u16>,
}

/// The clips of a split that a table is about, with their place in the dataset: of an action that is scored, captioned, three tokens or
/// more.
pub fn labelled(dataset: &Dataset, split: Split) -> Vec<(usize, ClipView<'_>)> {
    let fits = |clip: &ClipView<'_>| {
        clip.info.split == split
            && clip.frames() >= MIN_FRAMES
            && !clip.info.captions.is_empty()
            && clip.info.action().is_some()
            && clip.info.scored()
    };
    dataset.iter().enumerate().filter(|(_, clip)| fits(clip)).collect()
}

/// Words of the longest caption that is asked for, as many as the models of every preset read.
const MAX_WORDS: usize = 32;

/// One prompt for every labelled clip of a split: caption i of clip i, modulo their number, of those that are not too long to be read, and
/// the clip's own length in tokens, at most 49.
pub fn prompts(dataset: &Dataset, split: Split) -> Vec<Prompt> {
    let mut labels: Vec<Option<Label<'_>>> = Vec::new();
    let prompt = |(index, (place, clip)): (usize, (usize, ClipView<'_>))| {
        let label = dataset.clips[place].label();
        let number = labels.iter().position(|known| *known == label).unwrap_or_else(|| {
            labels.push(label);
            labels.len() - 1
        });
        let captions = || clip.info.captions.iter().map(|caption| caption.text.as_str());
        let short: Vec<&str> = captions().filter(|text| words(text).len() <= MAX_WORDS).collect();
        // A clip has a caption; one that is too long is refused where it is read.
        let asked = if short.is_empty() { captions().collect() } else { short };
        Prompt {
            clip: place,
            caption: asked[index % asked.len()].to_owned(),
            content: clip.info.action().unwrap_or_default().to_owned(),
            style: clip.info.style().map(str::to_owned),
            label: number,
            tokens: (clip.frames() / FRAMES_PER_TOKEN).min(MAX_TOKENS),
        }
    };
    labelled(dataset, split).into_iter().enumerate().map(prompt).collect()
}

/// Places of prompts by the subset of their clips.
pub fn by_subset<'d>(dataset: &'d Dataset, prompts: &[Prompt]) -> BTreeMap<&'d str, Vec<usize>> {
    let mut places: BTreeMap<&str, Vec<usize>> = BTreeMap::new();
    for (place, prompt) in prompts.iter().enumerate() {
        places.entry(&dataset.clips[prompt.clip].subset).or_default().push(place);
    }
    places
}

/// What the clips of prompts are, in words: `426 clips of the test split (403 of `bnr`, 23 of `cmu`)`.
pub fn composition(dataset: &Dataset, prompts: &[Prompt], split: Split) -> String {
    let subsets = by_subset(dataset, prompts);
    let counts: Vec<String> = subsets.iter().map(|(name, places)| format!("{} of `{name}`", places.len())).collect();
    format!("{} clips of the {split} split ({})", prompts.len(), counts.join(", "))
}
