//! Training examples: motions with sentences and labels, their mirrored twins, random batches.

use std::collections::{BTreeMap, BTreeSet};

use motionette_host::dataset::{Dataset, Side, Split};
use motionette_host::motion::mirror::mirror_joints;
use motionette_host::motion::{FEATURES, Pose};
use motionette_host::parallel;

use super::Error;
use super::config::{Config, MAX_FRAMES, MIN_FRAMES};
use super::{legs, motion};
use crate::normalization::Normalization;
use crate::prior::captions::{UNKNOWN, Vocabulary, mirrored};
use crate::random::Random;

/// Motions that are looked at for legs.
const DONORS: usize = 8;
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
    synthetic_legs: bool,
}

/// The training split with its mirrored twins.
pub struct Corpus {
    examples: Vec<Example>,
    /// Places of those whose legs were recorded.
    with_legs: Vec<usize>,
    /// For every example, the number of those of its action, or of its style where that is rarer.
    alike: Vec<usize>,
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
    synthetic_legs: bool,
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
                let (style, synthetic_legs) = (style.clone(), clip.info.synthetic_legs());
                Ok(Raw { joints, features: prepared.features, captions, content, side, style, synthetic_legs })
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
        let normalization = Normalization::of_measured(raw.iter().map(|r| (r.features.as_slice(), r.synthetic_legs)));
        let example = |raw: Raw| Example {
            features: normalization.apply(&raw.features),
            captions: raw.captions.iter().map(|caption| encoded(&labels.vocabulary, caption, max_words)).collect(),
            content: raw.content.and_then(|name| labels.contents.binary_search(&name).ok()),
            style: raw.style.and_then(|name| labels.styles.binary_search(&name).ok()),
            side: raw.side,
            synthetic_legs: raw.synthetic_legs,
            joints: raw.joints,
        };
        let examples: Vec<Example> = raw.into_iter().map(example).collect();
        let with_legs = (0..examples.len()).filter(|place| !examples[*place].synthetic_legs).collect();
        Ok(Self { with_legs, alike: alike(&examples), examples, labels, normalization })
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

    /// A batch of `config.batch` pairs: whole motions, crops at a slightly other tempo, and motions of one label joined; legs as the
    /// configuration says.
    ///
    /// # Errors
    /// [`Error::Features`] when a changed motion has no features.
    pub fn batch(&self, config: &Config, random: &mut Random) -> Result<Batch, Error> {
        let draw = self.weighted(config.balance);
        let mut motions = Vec::with_capacity(config.batch);
        let (mut sentences, mut contents, mut sides, mut styles) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        for _ in 0..config.batch {
            let example = &self.examples[draw.place(random)];
            let mut rows = self.changed(example, config, random)?;
            self.change_legs(&mut rows, example.synthetic_legs, config, random);
            motions.push(rows);
            sentences.push(example.captions[random.below(example.captions.len())].clone());
            contents.push(example.content);
            sides.push(example.side);
            styles.push(example.style);
        }
        let Padded { features, lengths } = padded(&motions);
        Ok(Batch { features, lengths, sentences, contents, sides, styles })
    }

    /// Normalised rows of an example: whole, a crop at another tempo, or with others of its label behind it.
    fn changed(&self, example: &Example, config: &Config, random: &mut Random) -> Result<Vec<f32>, Error> {
        let kind = random.unit();
        let joints = if kind < config.joined && example.content.is_some() {
            self.joined(example, random)
        } else if kind < config.joined + config.cropped {
            cropped(&example.joints, config.tempo, random)
        } else {
            return Ok(example.features.clone());
        };
        let prepared =
            motion::prepare(&joints).map_err(|source| Error::Features { name: "a changed motion".into(), source })?;
        Ok(self.normalization.apply(&prepared.features))
    }

    /// Hides legs, or exchanges synthetic ones for those of a motion whose root moves much like this one's.
    fn change_legs(&self, rows: &mut [f32], synthetic: bool, config: &Config, random: &mut Random) {
        let chance = random.unit();
        if !synthetic {
            if chance < config.hidden_legs {
                legs::hide(rows);
            }
            return;
        }
        let donors = if chance < config.exchanged_legs && !self.with_legs.is_empty() { DONORS } else { 0 };
        let drawn = (0..donors).map(|_| self.with_legs[random.below(self.with_legs.len())]);
        match legs::nearest(rows, drawn.map(|place| self.examples[place].features.as_slice())) {
            Some(donor) => legs::replace(rows, donor),
            None => legs::hide(rows),
        }
    }

    /// Examples with the weights that `balance` gives them.
    fn weighted(&self, balance: f64) -> Weighted {
        let mut sum = 0.0;
        let weight = |alike: &usize| {
            sum += (*alike as f64).powf(-balance);
            sum
        };
        Weighted { sums: self.alike.iter().map(weight).collect() }
    }

    /// Motions of the example's label, itself first, one after another up to a random length.
    fn joined(&self, example: &Example, random: &mut Random) -> Vec<Pose> {
        let shortest = example.joints.len().min(MAX_FRAMES - 1);
        let frames = shortest + 1 + random.below(MAX_FRAMES - shortest);
        motion::grown(&example.joints, frames, || {
            // A few draws find one of the same label; the rare labels repeat their own.
            let mut others = (0..64).map(|_| &self.examples[random.below(self.examples.len())]);
            let label = |e: &Example| (e.content, e.side, e.style, e.synthetic_legs);
            let other = others.find(|other| label(other) == label(example));
            &other.unwrap_or(example).joints
        })
    }
}

/// Places that are drawn with their own probabilities.
struct Weighted {
    /// Sums of the weights up to and with each place.
    sums: Vec<f64>,
}

impl Weighted {
    /// A place, with a probability in proportion to its weight.
    fn place(&self, random: &mut Random) -> usize {
        let at = random.unit() * self.sums.last().copied().unwrap_or_default();
        self.sums.partition_point(|sum| *sum <= at).min(self.sums.len().saturating_sub(1))
    }
}

/// For every example, the number of those of its action, or of its style where that is rarer; of all that have neither for these.
fn alike(examples: &[Example]) -> Vec<usize> {
    let (mut contents, mut styles) = (BTreeMap::new(), BTreeMap::new());
    for example in examples {
        *contents.entry(example.content).or_insert(0usize) += 1;
        *styles.entry(example.style).or_insert(0usize) += 1;
    }
    let of_style = |example: &Example| example.style.map_or(usize::MAX, |_| styles[&example.style]);
    examples.iter().map(|example| contents[&example.content].min(of_style(example))).collect()
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
