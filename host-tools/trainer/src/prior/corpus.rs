//! Motions as tokens with their sentences, and the examples that are drawn from them.

use std::collections::BTreeMap;

use burn::tensor::{Device, Tensor, TensorData};
use motionette_host::dataset::{ClipView, Dataset, Label, Split};
use motionette_host::motion::Pose;
use motionette_host::motion::features::{Bones, Options, extract};
use motionette_host::motion::mirror::mirror_joints;
use motionette_host::parallel;
use motionette_host::reference::recover::{self, CHANNELS};
use motionette_host::reference::scaffold::{Statistics, VALUES};

use super::Error;
use super::config::{Config, MAX_TOKENS};
use super::corruption::Metric;
use super::model::Example;
use super::sentences::{NORMAL, Said, Sentences};
use crate::random::Random;
use crate::tokenizer::checkpoint::Checkpoint;
use crate::tokenizer::config::{FEATURES, FRAMES_PER_TOKEN};
use crate::tokenizer::model::Network;
use crate::tokenizer::quantizer::nearest;

/// Steps whose examples are drawn together and sorted by length, so that little of a batch is padding.
const POOL: u64 = 8;
/// Candidates of which the best continuation of a joined motion is taken.
const CONTINUATIONS: usize = 12;
/// Tokens that a sequence shows of each of its motions, 1 s.
const LEAST_OF_EACH: usize = 5;
/// Sentences about each motion that are measured.
const SENTENCES: usize = 4;
/// Streams of random numbers of sentences that mean nothing.
const NONSENSE_STREAM: u64 = 1 << 42;

/// A clip or its mirrored twin.
struct Motion {
    clip: usize,
    mirrored: bool,
    /// Tokens from frame 0, 1, 2 and 3 on: the same motion, cut at other places.
    phases: Vec<Vec<u16>>,
    /// What its joints are recovered from, `[T][CHANNELS]`.
    channels: Vec<f32>,
}

/// A token and where it is from.
#[derive(Clone, Copy)]
struct Piece {
    token: u16,
    place: Place,
}

/// An example with what the networks should say of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Labelled {
    /// What they see.
    pub example: Example,
    /// The clean tokens.
    pub clean: Vec<u16>,
    /// Length of the whole motion, where it is shown whole.
    pub length: Option<usize>,
    /// What its sentence means, where that is known.
    pub meanings: Option<Vec<usize>>,
    /// Where every token is from.
    places: Vec<Place>,
}

/// Where a token's frames begin.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Place {
    motion: usize,
    frame: usize,
}

/// Running sums of counts to the power of 1 - `balance`.
fn sums(counts: impl Iterator<Item = usize>, balance: f64) -> Vec<f64> {
    let add = |sum: &mut f64, count: usize| {
        *sum += (count as f64).powf(1.0 - balance);
        Some(*sum)
    };
    counts.scan(0.0, add).collect()
}

/// A place in running sums, as often as they say.
fn place(sums: &[f64], random: &mut Random) -> usize {
    let at = random.unit() * sums.last().copied().unwrap_or_default();
    sums.partition_point(|sum| *sum <= at).min(sums.len().saturating_sub(1))
}

/// What examples are made from.
pub struct Material<'d> {
    /// Clips.
    pub dataset: &'d Dataset,
    /// What makes tokens of them.
    pub tokenizer: &'d Checkpoint,
    /// What is said of them.
    pub sentences: Sentences,
}

impl<'d> Material<'d> {
    /// The training split with its mirrored twins.
    ///
    /// # Errors
    /// [`Error::NoMotion`] when no clip has a caption and a token, [`Error::Mirror`] when features of a twin cannot be extracted.
    pub fn training(&self) -> Result<Corpus<'d>, Error> {
        Corpus::new(self, Split::Train, true)
    }

    /// The validation split, where there is one.
    ///
    /// # Errors
    /// [`Error::NoMotion`] when no clip of it has a caption and a token.
    pub fn held_out(&self) -> Result<Option<Corpus<'d>>, Error> {
        let any = self.dataset.split(Split::Val).next().is_some();
        any.then(|| Corpus::new(self, Split::Val, false)).transpose()
    }
}

/// One split as tokens.
pub struct Corpus<'d> {
    dataset: &'d Dataset,
    motions: Vec<Motion>,
    /// Motions of the same labels and the same side.
    alike: BTreeMap<(Label<'d>, bool), Vec<usize>>,
    sentences: Sentences,
    /// Motions by the actions of their clips, and of each by its styles, twins with them.
    by_action: Vec<Vec<Vec<usize>>>,
}

/// How often motions are drawn, as running sums.
struct Shares {
    actions: Vec<f64>,
    /// For each action, of its styles.
    styles: Vec<Vec<f64>>,
}

impl<'d> Corpus<'d> {
    /// Encodes the clips of `split` and, when `twins`, their mirrored twins.
    fn new(material: &Material<'d>, split: Split, twins: bool) -> Result<Self, Error> {
        let Material { dataset, tokenizer, .. } = *material;
        let usable = |clip: &ClipView<'_>| {
            clip.info.split == split && clip.frames() >= FRAMES_PER_TOKEN && !clip.info.captions.is_empty()
        };
        let indices: Vec<usize> = (0..dataset.clips.len()).filter(|index| usable(&dataset.clip(*index))).collect();
        if indices.is_empty() {
            return Err(Error::NoMotion { split });
        }
        let device = Device::flex();
        let network = Network::new(&tokenizer.config.architecture, &tokenizer.parameters, false, &device);
        let features = |(index, twin): &(usize, bool)| -> Result<Vec<f32>, Error> {
            let clip = dataset.clip(*index);
            if !twin {
                return Ok(clip.features.to_vec());
            }
            let options = Options { bones: Bones::Keep, ..Options::default() };
            extract(&mirror_joints(clip.joints), &options)
                .map_err(|source| Error::Mirror { clip: clip.info.id.clone(), source })
        };
        let sides: &[bool] = if twins { &[false, true] } else { &[false] };
        let all: Vec<(usize, bool)> = indices.iter().flat_map(|i| sides.iter().map(|side| (*i, *side))).collect();
        let mut motions = Vec::with_capacity(all.len());
        let mut alike: BTreeMap<(Label<'d>, bool), Vec<usize>> = BTreeMap::new();
        let mut by_action: BTreeMap<&str, BTreeMap<&str, Vec<usize>>> = BTreeMap::new();
        for ((clip, mirrored), features) in all.iter().zip(parallel::map(&all, features)) {
            let features = features?;
            let channels = features.chunks_exact(FEATURES).flat_map(|row| &row[..CHANNELS]).copied().collect();
            let features = tokenizer.normalization.apply(&features);
            let encode = |first: usize| tokens(tokenizer, &network, &features[first * FEATURES..], &device);
            let phases: Vec<Vec<u16>> = (0..FRAMES_PER_TOKEN).map(encode).filter(|tokens| !tokens.is_empty()).collect();
            // Those that nobody named are a group of their own.
            let info = &dataset.clips[*clip];
            let styles = by_action.entry(info.action().unwrap_or_default()).or_default();
            styles.entry(info.style().unwrap_or_default()).or_default().push(motions.len());
            if let Some(label) = info.label() {
                alike.entry((label, *mirrored)).or_default().push(motions.len());
            }
            motions.push(Motion { clip: *clip, mirrored: *mirrored, phases, channels });
        }
        let by_action = by_action.into_values().map(|styles| styles.into_values().collect()).collect();
        Ok(Self { dataset, motions, alike, sentences: material.sentences.clone(), by_action })
    }

    /// Motions, twins included.
    pub fn motions(&self) -> usize {
        self.motions.len()
    }

    /// Tokens, twins included, counted once a motion.
    pub fn tokens(&self) -> usize {
        self.motions.iter().map(|motion| motion.phases[0].len()).sum()
    }

    /// Mean and deviation of the places of joints over all motions, metres from where each begins.
    pub fn statistics(&self) -> Statistics {
        let mut sums = vec![(0.0f64, 0.0f64); VALUES];
        let mut count = 0.0f64;
        for motion in &self.motions {
            for pose in recover::joints(&motion.channels, CHANNELS) {
                count += 1.0;
                for ((sum, square), x) in sums.iter_mut().zip(pose.as_flattened()) {
                    *sum += f64::from(*x);
                    *square += f64::from(*x) * f64::from(*x);
                }
            }
        }
        let mean = |sum: f64| sum / count.max(1.0);
        let deviation =
            |(sum, square): &(f64, f64)| (mean(*square) - mean(*sum) * mean(*sum)).max(0.0).sqrt().max(1e-2);
        Statistics {
            mean: sums.iter().map(|(sum, _)| mean(*sum) as f32).collect(),
            std: sums.iter().map(|moments| deviation(moments) as f32).collect(),
        }
    }

    /// The batch of a step: drawn with the other steps of its pool, sorted by length, every step a stretch of them.
    pub fn batch(&self, config: &Config, metric: &Metric, step: u64) -> Vec<Labelled> {
        let mut random = Random::new(config.seed, step / POOL);
        let shares = self.shares(config);
        let mut pool: Vec<Labelled> =
            (0..config.batch * POOL as usize).map(|_| self.draw(config, metric, &shares, &mut random)).collect();
        pool.sort_by_key(|labelled| labelled.clean.len());
        let mut order: Vec<usize> = (0..POOL as usize).collect();
        for i in (1..order.len()).rev() {
            order.swap(i, random.below(i + 1));
        }
        let first = order[(step % POOL) as usize] * config.batch;
        pool.drain(first..first + config.batch).collect()
    }

    /// One example: a motion, perhaps joined, perhaps cropped, perhaps with fixed tokens, corrupted at a random time.
    fn draw(&self, config: &Config, metric: &Metric, shares: &Shares, random: &mut Random) -> Labelled {
        let index = self.pick(shares, random);
        let motion = &self.motions[index];
        let mut pieces = self.pieces(index, random.below(motion.phases.len()));
        let (mut joined, mut said) = (false, None);
        if config.sequences > 0.0 && random.unit() < config.sequences {
            said = self.sequence(index, &mut pieces, metric, shares, config, random);
            joined = said.is_some();
        } else if random.unit() < config.joins {
            joined = self.join(motion, &mut pieces, metric, random);
        }
        // Of one that is a sequence of actions all is shown.
        let crops = if said.is_some() { 0.0 } else { config.crops };
        let whole = pieces.len();
        let (mut start, mut end) = (0, whole);
        if whole > MAX_TOKENS || (random.unit() < crops && whole > 4) {
            let shortest = 4.min(whole);
            let length = shortest + random.below(whole.min(MAX_TOKENS) - shortest + 1);
            let length = if whole > MAX_TOKENS { length.max(MAX_TOKENS / 2) } else { length };
            // Ends of motions are rare among uniform crops; a third of the crops begin or end there.
            start = match random.below(6) {
                0 => 0,
                1 => whole - length,
                _ => random.below(whole - length + 1),
            };
            end = start + length;
        }
        let clean: Vec<u16> = pieces[start..end].iter().map(|piece| piece.token).collect();
        let places = pieces[start..end].iter().map(|piece| piece.place).collect();
        let fixed = fixed(clean.len(), random.unit() < config.fixed, random);
        let t = random.unit() as f32;
        let z = metric.corrupt(&clean, &fixed, t, random);
        let sequence = said.is_some();
        let said = said
            .unwrap_or_else(|| self.sentences.draw(&self.dataset.clip(motion.clip), motion.mirrored, config, random));
        let length = (start == 0 && end == whole && (sequence || !joined)).then_some(whole);
        let example =
            Example { words: said.words, z, fixed, t, start_open: start > 0, end_open: end < whole, strength: 1.0 };
        Labelled { example, clean, length, meanings: said.meanings, places }
    }

    /// The tokens of a motion from frame `phase` on.
    fn pieces(&self, motion: usize, phase: usize) -> Vec<Piece> {
        let tokens = self.motions[motion].phases[phase].iter().enumerate();
        tokens
            .map(|(i, token)| Piece { token: *token, place: Place { motion, frame: phase + FRAMES_PER_TOKEN * i } })
            .collect()
    }

    /// Joints of the real motion behind an example, [`FRAMES_PER_TOKEN`] frames a token, metres, from the origin facing +z. Joined
    /// motions go on where the first ends.
    pub fn joints(&self, labelled: &Labelled) -> Vec<Pose> {
        let rows = |Place { motion, frame }: &Place| {
            &self.motions[*motion].channels[frame * CHANNELS..][..FRAMES_PER_TOKEN * CHANNELS]
        };
        recover::joints(&labelled.places.iter().flat_map(rows).copied().collect::<Vec<f32>>(), CHANNELS)
    }

    /// Joints of another real motion, at most `frames` of them, fewer only where no motion is as long.
    pub fn foreign(&self, frames: usize, random: &mut Random) -> Vec<Pose> {
        let long = |motion: &&Motion| motion.channels.len() >= frames * CHANNELS;
        let count = self.motions.iter().filter(long).count();
        let found = match count {
            0 => self.motions.iter().max_by_key(|motion| motion.channels.len()),
            _ => self.motions.iter().filter(long).nth(random.below(count)),
        };
        let Some(motion) = found else { return Vec::new() };
        recover::joints(&motion.channels[..motion.channels.len().min(frames * CHANNELS)], CHANNELS)
    }

    /// Appends another motion of the same labels where its tokens go on best; at most [`MAX_TOKENS`] in all.
    fn join(&self, motion: &Motion, pieces: &mut Vec<Piece>, metric: &Metric, random: &mut Random) -> bool {
        let Some(label) = self.dataset.clips[motion.clip].label() else { return false };
        let Some(group) = self.alike.get(&(label, motion.mirrored)) else { return false };
        let Some(last) = pieces.last().map(|piece| piece.token) else { return false };
        let room = MAX_TOKENS.saturating_sub(pieces.len());
        let mut best: Option<(f32, [usize; 3])> = None;
        for _ in 0..CONTINUATIONS {
            let index = group[random.below(group.len())];
            let phase = random.below(self.motions[index].phases.len());
            let other = &self.motions[index].phases[phase];
            for first in 0..=other.len() / 3 {
                let first = first.min(other.len() - 1);
                let distance = metric.distance(last, other[first]);
                if other.len() - first <= room && best.is_none_or(|(least, _)| distance < least) {
                    best = Some((distance, [index, phase, first]));
                }
            }
        }
        let Some((_, [index, phase, first])) = best else { return false };
        pieces.extend_from_slice(&self.pieces(index, phase)[first..]);
        true
    }

    /// How often motions of each action, and of each style of it, are drawn.
    fn shares(&self, config: &Config) -> Shares {
        let actions = self.by_action.iter().map(|styles| styles.iter().map(Vec::len).sum());
        let styles = |styles: &Vec<Vec<usize>>| sums(styles.iter().map(Vec::len), config.style_balance);
        Shares { actions: sums(actions, config.balance), styles: self.by_action.iter().map(styles).collect() }
    }

    /// A motion: its action by `shares`, then its style, then any of these.
    fn pick(&self, shares: &Shares, random: &mut Random) -> usize {
        let action = place(&shares.actions, random);
        let motions = &self.by_action[action][place(&shares.styles[action], random)];
        motions[random.below(motions.len())]
    }

    /// Lets a motion of another action follow where its tokens go on best; what is said of the two, or nothing where nothing follows. Both
    /// are as long as they are, or cut where together they would be too long.
    fn sequence(
        &self,
        first: usize,
        pieces: &mut Vec<Piece>,
        metric: &Metric,
        shares: &Shares,
        config: &Config,
        random: &mut Random,
    ) -> Option<Said> {
        let clip = |index: usize| self.dataset.clip(self.motions[index].clip);
        let action = |index: usize| clip(index).info.action();
        let plain = |index: usize| clip(index).info.style().is_none_or(|style| style == NORMAL);
        if !plain(first) || pieces.len() < LEAST_OF_EACH {
            return None;
        }
        // As much of the first as leaves room for the second.
        let most = MAX_TOKENS / 2 + random.below(MAX_TOKENS / 4);
        let kept = pieces.len().min(most);
        let last = pieces.get(kept - 1)?.token;
        let room = MAX_TOKENS - kept;
        let mut best: Option<(f32, [usize; 3])> = None;
        for _ in 0..CONTINUATIONS {
            let index = self.pick(shares, random);
            if action(index) == action(first) || !plain(index) {
                continue;
            }
            let phase = random.below(self.motions[index].phases.len());
            let tokens = &self.motions[index].phases[phase];
            for begin in 0..=tokens.len() / 3 {
                let distance = tokens.get(begin).map_or(f32::INFINITY, |token| metric.distance(last, *token));
                if tokens.len() >= begin + LEAST_OF_EACH && best.is_none_or(|(least, _)| distance < least) {
                    best = Some((distance, [index, phase, begin]));
                }
            }
        }
        let (_, [second, phase, begin]) = best?;
        let twins = [first, second].map(|index| (clip(index), self.motions[index].mirrored));
        let said = self.sentences.sequence([(&twins[0].0, twins[0].1), (&twins[1].0, twins[1].1)], config, random)?;
        pieces.truncate(kept);
        let rest = self.pieces(second, phase);
        pieces.extend(rest.into_iter().skip(begin).take(room));
        Some(said)
    }

    /// At most `count` sentences that mean nothing, of a step's random numbers.
    pub fn nonsense(&self, config: &Config, step: u64, count: usize) -> Vec<Said> {
        let mut random = Random::new(config.seed, NONSENSE_STREAM + step);
        (0..count).filter_map(|_| self.sentences.nonsense(&mut random)).collect()
    }

    /// A few sentences about each motion whose action is known, every word as it was said.
    pub fn sentences(&self, config: &Config, random: &mut Random) -> Vec<Said> {
        let config = Config { text_dropout: 0.0, word_dropout: 0.0, ..config.clone() };
        let motions = self.motions.iter().flat_map(|motion| std::iter::repeat_n(motion, SENTENCES));
        let said = motions.map(|m| self.sentences.draw(&self.dataset.clip(m.clip), m.mirrored, &config, random));
        said.filter(|said| said.meanings.is_some()).collect()
    }

    /// Every whole motion of at most [`MAX_TOKENS`] with its first caption, corrupted at time `t`: the same for every call.
    pub fn whole(&self, metric: &Metric, max_words: usize, t: f32) -> Vec<Labelled> {
        let mut examples = Vec::new();
        for (index, motion) in self.motions.iter().enumerate() {
            let clean: Vec<u16> = motion.phases[0].iter().copied().take(MAX_TOKENS).collect();
            let mut random = Random::new(index as u64, u64::from(t.to_bits()));
            let words = self.sentences.first(&self.dataset.clip(motion.clip), motion.mirrored, max_words);
            let end_open = motion.phases[0].len() > MAX_TOKENS;
            let fixed = vec![false; clean.len()];
            let z = metric.corrupt(&clean, &fixed, t, &mut random);
            let length = (!end_open).then_some(clean.len());
            let example = Example { words, z, fixed, t, start_open: false, end_open, strength: 1.0 };
            let places = (0..clean.len()).map(|i| Place { motion: index, frame: FRAMES_PER_TOKEN * i }).collect();
            examples.push(Labelled { example, clean, length, meanings: None, places });
        }
        examples.sort_by_key(|labelled| labelled.clean.len());
        examples
    }
}

/// Tokens of normalised features.
fn tokens(tokenizer: &Checkpoint, network: &Network, features: &[f32], device: &Device) -> Vec<u16> {
    let frames = features.len() / FEATURES / FRAMES_PER_TOKEN * FRAMES_PER_TOKEN;
    if frames == 0 {
        return Vec::new();
    }
    let x = TensorData::new(features[..frames * FEATURES].to_vec(), [1, frames, FEATURES]);
    let latents = network.encode(Tensor::from_data(x, device), None);
    let latents: Vec<f32> = latents.into_data().try_into_vec().expect("networks compute in f32");
    nearest(&tokenizer.codebook, tokenizer.config.architecture.code_dim, &latents)
}

/// Which of `length` tokens are fixed: a beginning, an end, both, or single ones; never all.
fn fixed(length: usize, wanted: bool, random: &mut Random) -> Vec<bool> {
    let mut fixed = vec![false; length];
    if !wanted || length < 2 {
        return fixed;
    }
    let (first, second) = (1 + random.below(length - 1), 1 + random.below(length - 1));
    match random.below(5) {
        // To continue a motion is what streaming does all the time.
        0 | 1 => fixed[..first].fill(true),
        2 => fixed[first..].fill(true),
        3 => {
            let (from, to) = (first.min(second), first.max(second));
            fixed[..from].fill(true);
            fixed[to..].fill(true);
        }
        _ => {
            let share = random.unit();
            fixed.iter_mut().for_each(|f| *f = random.unit() < share);
        }
    }
    if fixed.iter().all(|f| *f) {
        fixed[random.below(length)] = false;
    }
    fixed
}

#[cfg(test)]
mod tests {
    use motionette_host::dataset::{Facts, Side};

    use super::*;
    use crate::testing;

    /// Without facts, a clip's labels are what they were; with them, a left kick is not joined to a right one.
    #[test]
    fn motions_are_alike_in_action_side_and_style() {
        let folder = tempfile::tempdir().unwrap();
        testing::prepare_tokenizer(folder.path());
        let tokenizer = Checkpoint::load(&folder.path().join("tokenizer.safetensors")).unwrap();
        let groups = |dataset: &Dataset| {
            let sentences = Sentences::new(dataset, None, None);
            let material = Material { dataset, tokenizer: &tokenizer, sentences };
            let mut groups: Vec<usize> = material.training().unwrap().alike.values().map(Vec::len).collect();
            groups.sort_unstable();
            groups
        };
        let plain = testing::dataset(12, 48);
        assert!(groups(&plain).is_empty(), "no action, nothing to join");
        let alike = testing::with_facts(&plain, |_| testing::facts());
        assert_eq!(groups(&alike), [8, 8], "motions and their twins");
        let sides = testing::with_facts(&plain, |info| Facts {
            side: if info.id == "figure0" { Side::Left } else { Side::Right },
            ..testing::facts()
        });
        assert_eq!(groups(&sides), [1, 1, 7, 7]);
    }

    /// A style with one clip among eight is drawn as often as its clips say, or as often as the other, and actions likewise; balance of one
    /// leaves the other alone.
    #[test]
    fn rare_styles_are_drawn_more_often() {
        let folder = tempfile::tempdir().unwrap();
        testing::prepare_tokenizer(folder.path());
        let tokenizer = Checkpoint::load(&folder.path().join("tokenizer.safetensors")).unwrap();
        let plain = testing::dataset(12, 48);
        let dataset = testing::with_facts(&plain, |info| Facts {
            style: Some(if info.id == "figure0" { "old" } else { "happy" }.into()),
            ..testing::facts()
        });
        let sentences = Sentences::new(&dataset, None, None);
        let material = Material { dataset: &dataset, tokenizer: &tokenizer, sentences };
        let corpus = material.training().unwrap();
        let share = |style_balance: f64, balance: f64| {
            let config = Config { style_balance, balance, ..Config::preset("tiny").unwrap() };
            let shares = corpus.shares(&config);
            let mut random = Random::new(3, 9);
            let old = |index: usize| dataset.clips[corpus.motions[index].clip].id == "figure0";
            (0..4000).filter(|_| old(corpus.pick(&shares, &mut random))).count() as f64 / 4000.0
        };
        let clips = corpus.motions.len() as f64 / 2.0;
        for (style_balance, wanted) in [(0.0, 1.0 / clips), (1.0, 0.5), (0.5, 1.0 / (1.0 + (clips - 1.0).sqrt()))] {
            for balance in [0.0, 1.0] {
                let found = share(style_balance, balance);
                assert!((found - wanted).abs() < 0.03, "{style_balance}, {balance}: {found} {wanted}");
            }
        }
    }

    #[test]
    fn something_is_always_left_to_plan() {
        let mut random = Random::new(4, 4);
        let mut kinds = [0; 3];
        for _ in 0..2000 {
            let length = 1 + random.below(12);
            let wanted = random.unit() < 0.8;
            let fixed = fixed(length, wanted, &mut random);
            assert_eq!(fixed.len(), length);
            assert!(fixed.iter().any(|f| !f) && (wanted || fixed.iter().all(|f| !f)));
            kinds[0] += usize::from(fixed[0]);
            kinds[1] += usize::from(fixed[length - 1]);
            kinds[2] += usize::from(length > 2 && fixed[0] && fixed[length - 1]);
        }
        assert!(kinds.iter().all(|k| *k > 50), "{kinds:?}");
    }
}
