//! Training examples: motions with sentences and labels, their mirrored twins, random batches.

use std::collections::BTreeSet;

use motionette_host::dataset::{Dataset, Side, Split};
use motionette_host::motion::mirror::mirror_joints;
use motionette_host::motion::{FEATURES, Pose};
use motionette_host::parallel;

use super::Error;
use super::config::{Config, MAX_FRAMES, MIN_FRAMES};
use super::motion;
use crate::normalization::Normalization;
use crate::prior::captions::{UNKNOWN, Vocabulary, mirrored};
use crate::random::Random;

/// Shortest part of a motion that a crop keeps.
const SHORTEST_CROP: f64 = 0.5;

/// What the heads and the text encoder can name.
#[derive(Clone, Debug, PartialEq)]
pub struct Labels {
    /// Words.
    pub vocabulary: Vocabulary,
    /// Actions, in alphabetical order.
    pub contents: Vec<String>,
    /// Styles, in alphabetical order.
    pub styles: Vec<String>,
}

/// One motion of the corpus.
struct Example {
    joints: Vec<Pose>,
    /// Normalised, of the whole motion.
    features: Vec<f32>,
    /// Numbers of the words of every sentence.
    captions: Vec<Vec<usize>>,
    content: Option<usize>,
    side: Side,
    style: Option<usize>,
}

/// The training split with its mirrored twins.
pub struct Corpus {
    examples: Vec<Example>,
    labels: Labels,
    normalization: Normalization,
}

/// Motions and sentences of one step, in pairs.
#[derive(Clone, Debug, PartialEq)]
pub struct Batch {
    /// `[B][window][263]` normalised features, zero beyond a motion's end; the window is a multiple of 8.
    pub features: Vec<f32>,
    /// `[B]` valid rows.
    pub lengths: Vec<usize>,
    /// `[B]` numbers of the words.
    pub sentences: Vec<Vec<usize>>,
    /// `[B]` content, where there is one.
    pub contents: Vec<Option<usize>>,
    /// `[B]` side of the content.
    pub sides: Vec<Side>,
    /// `[B]` style, where there is one.
    pub styles: Vec<Option<usize>>,
}

/// An example before normalisation.
struct Raw {
    joints: Vec<Pose>,
    features: Vec<f32>,
    captions: Vec<String>,
    content: Option<String>,
    side: Side,
    style: Option<String>,
}

impl Corpus {
    /// Takes every captioned clip of the training split that lasts three tokens, and its mirrored twin.
    ///
    /// # Errors
    /// [`Error::NoMotion`] when there is none, [`Error::Features`] when one has no features.
    pub fn new(dataset: &Dataset, max_words: usize) -> Result<Self, Error> {
        let clips: Vec<_> = dataset
            .split(Split::Train)
            .filter(|clip| clip.frames() >= MIN_FRAMES && !clip.info.captions.is_empty())
            .collect();
        if clips.is_empty() {
            return Err(Error::NoMotion { split: Split::Train });
        }
        let both = parallel::map(&clips, |clip| -> Result<[Raw; 2], Error> {
            let captions: Vec<String> = clip.info.captions.iter().map(|caption| caption.text.clone()).collect();
            let (content, side) = (clip.info.action(), clip.info.side());
            let style = clip.info.style().map(str::to_owned);
            let raw = |joints: &[Pose], captions, content, side| -> Result<Raw, Error> {
                let prepared = motion::prepare(joints)
                    .map_err(|source| Error::Features { name: format!("clip {}", clip.info.id), source })?;
                let joints = joints[..joints.len().min(MAX_FRAMES)].to_vec();
                Ok(Raw { joints, features: prepared.features, captions, content, side, style: style.clone() })
            };
            let twins = captions.iter().map(|caption| mirrored(caption)).collect();
            let other_side = |label: &str| mirrored(label).replace(' ', "-");
            Ok([
                raw(clip.joints, captions, content.map(str::to_owned), side)?,
                raw(&mirror_joints(clip.joints), twins, content.map(other_side), side.mirrored())?,
            ])
        });
        let mut raw = Vec::with_capacity(2 * clips.len());
        for pair in both {
            raw.extend(pair?);
        }
        let sorted = |values: BTreeSet<&String>| values.into_iter().cloned().collect::<Vec<_>>();
        let labels = Labels {
            vocabulary: Vocabulary::of(raw.iter().flat_map(|r| &r.captions).map(String::as_str)),
            contents: sorted(raw.iter().filter_map(|r| r.content.as_ref()).collect()),
            styles: sorted(raw.iter().filter_map(|r| r.style.as_ref()).collect()),
        };
        let normalization = Normalization::of(raw.iter().map(|r| r.features.as_slice()));
        let example = |raw: Raw| Example {
            features: normalization.apply(&raw.features),
            captions: raw.captions.iter().map(|caption| encoded(&labels.vocabulary, caption, max_words)).collect(),
            content: raw.content.and_then(|name| labels.contents.binary_search(&name).ok()),
            style: raw.style.and_then(|name| labels.styles.binary_search(&name).ok()),
            side: raw.side,
            joints: raw.joints,
        };
        let examples = raw.into_iter().map(example).collect();
        Ok(Self { examples, labels, normalization })
    }

    /// Number of motions, mirrored ones included.
    pub fn motions(&self) -> usize {
        self.examples.len()
    }

    /// What there is to name.
    pub fn labels(&self) -> &Labels {
        &self.labels
    }

    /// Mean and deviation of the features.
    pub fn normalization(&self) -> &Normalization {
        &self.normalization
    }

    /// A batch of `config.batch` pairs: whole motions, crops at a slightly other tempo, and motions of one label joined.
    ///
    /// # Errors
    /// [`Error::Features`] when a changed motion has no features.
    pub fn batch(&self, config: &Config, random: &mut Random) -> Result<Batch, Error> {
        let mut motions = Vec::with_capacity(config.batch);
        let (mut sentences, mut contents, mut sides, mut styles) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for _ in 0..config.batch {
            let example = &self.examples[random.below(self.examples.len())];
            let kind = random.unit();
            let changed = if kind < config.joined && example.content.is_some() {
                Some(self.joined(example, random))
            } else if kind < config.joined + config.cropped {
                Some(cropped(&example.joints, config.tempo, random))
            } else {
                None
            };
            motions.push(match changed {
                Some(joints) => {
                    let prepared = motion::prepare(&joints)
                        .map_err(|source| Error::Features { name: "a changed motion".into(), source })?;
                    self.normalization.apply(&prepared.features)
                }
                None => example.features.clone(),
            });
            sentences.push(example.captions[random.below(example.captions.len())].clone());
            contents.push(example.content);
            sides.push(example.side);
            styles.push(example.style);
        }
        let Padded { features, lengths } = padded(&motions);
        Ok(Batch { features, lengths, sentences, contents, sides, styles })
    }

    /// Motions of the example's label, itself first, one after another up to a random length.
    fn joined(&self, example: &Example, random: &mut Random) -> Vec<Pose> {
        let shortest = example.joints.len().min(MAX_FRAMES - 1);
        let frames = shortest + 1 + random.below(MAX_FRAMES - shortest);
        motion::grown(&example.joints, frames, || {
            // A few draws find one of the same label; the rare labels repeat their own.
            let mut others = (0..64).map(|_| &self.examples[random.below(self.examples.len())]);
            let other =
                others.find(|o| o.content == example.content && o.side == example.side && o.style == example.style);
            &other.unwrap_or(example).joints
        })
    }
}

/// Numbers of a sentence's first `max_words` words; the unknown word for a sentence without any.
pub(super) fn encoded(vocabulary: &Vocabulary, sentence: &str, max_words: usize) -> Vec<usize> {
    let mut numbers = vocabulary.encode(sentence, max_words);
    if numbers.is_empty() {
        numbers.push(UNKNOWN);
    }
    numbers
}

/// At least half of a motion at a tempo up to `tempo` faster or slower.
fn cropped(joints: &[Pose], tempo: f64, random: &mut Random) -> Vec<Pose> {
    let shortest = ((SHORTEST_CROP * joints.len() as f64) as usize).clamp(MIN_FRAMES.min(joints.len()), joints.len());
    let length = shortest + random.below(joints.len() - shortest + 1);
    let start = random.below(joints.len() - length + 1);
    motion::at_tempo(&joints[start..start + length], 1.0 + tempo * random.symmetric())
}

/// Motions of one batch.
pub(super) struct Padded {
    /// `[B][window][263]`, zero beyond a motion's end; the window is the longest length, rounded up to a multiple of 8.
    pub(super) features: Vec<f32>,
    /// `[B]` valid rows.
    pub(super) lengths: Vec<usize>,
}

/// Rows of features `[T][263]`, one motion after another.
pub(super) fn padded(motions: &[Vec<f32>]) -> Padded {
    let lengths: Vec<usize> = motions.iter().map(|motion| motion.len() / FEATURES).collect();
    let window = lengths.iter().max().map_or(0, |longest| longest.next_multiple_of(8));
    let mut features = vec![0.0; motions.len() * window * FEATURES];
    for (place, motion) in features.chunks_exact_mut((window * FEATURES).max(1)).zip(motions) {
        place[..motion.len()].copy_from_slice(motion);
    }
    Padded { features, lengths }
}
