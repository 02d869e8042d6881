//! Training motions and random crops of them.

use std::collections::BTreeMap;

use motionette_host::dataset::{ClipView, Dataset, Split};
use motionette_host::motion::features::{Bones, Options, extract};
use motionette_host::motion::mirror::mirror_joints;
use motionette_host::parallel;

use super::Error;
use super::config::{FEATURES, FRAMES_PER_TOKEN};
use crate::normalization::Normalization;
use crate::random::Random;

/// The training split with its mirrored twin, normalised.
pub struct Corpus {
    motions: Vec<Vec<f32>>,
    /// Whether the legs of each are made up.
    synthetic_legs: Vec<bool>,
    /// Running number of frames, for drawing a motion in proportion to its length.
    frames_before: Vec<usize>,
    frames: usize,
    /// Running mass of the motions, where rare actions are drawn more often; empty where all frames are drawn alike.
    mass: Vec<f64>,
    normalization: Normalization,
}

/// Crops of one step.
pub struct Batch {
    /// `[B][window][F]` normalised features, zero beyond a crop's end.
    pub features: Vec<f32>,
    /// `[B]` valid frames, multiples of 4.
    pub lengths: Vec<usize>,
    /// `[B]` whether legs and contacts are made up and nothing is to be learned from them.
    pub synthetic_legs: Vec<bool>,
}

impl Corpus {
    /// Takes every clip of the training split that holds at least one token, and its mirrored twin.
    ///
    /// # Errors
    /// [`Error::NoMotion`] when there is none, [`Error::Mirror`] when features cannot be extracted from mirrored joints.
    pub fn new(dataset: &Dataset) -> Result<Self, Error> {
        let clips: Vec<ClipView<'_>> =
            dataset.split(Split::Train).filter(|clip| clip.frames() > FRAMES_PER_TOKEN).collect();
        if clips.is_empty() {
            return Err(Error::NoMotion { split: Split::Train });
        }
        let twin = |clip: &ClipView<'_>| {
            let options = Options { bones: Bones::Keep, ..Options::default() };
            extract(&mirror_joints(clip.joints), &options)
                .map_err(|source| Error::Mirror { clip: clip.info.id.clone(), source })
        };
        let twins = parallel::map(&clips, twin);
        let mut motions = Vec::with_capacity(2 * clips.len());
        let mut synthetic_legs = Vec::with_capacity(2 * clips.len());
        for (clip, twin) in clips.iter().zip(twins) {
            motions.push(clip.features.to_vec());
            motions.push(twin?);
            synthetic_legs.extend([clip.info.synthetic_legs(); 2]);
        }
        let normalization =
            Normalization::of_measured(motions.iter().map(Vec::as_slice).zip(synthetic_legs.iter().copied()));
        let mut frames_before = Vec::with_capacity(motions.len());
        let mut frames = 0;
        for motion in &mut motions {
            *motion = normalization.apply(motion);
            frames_before.push(frames);
            frames += motion.len() / FEATURES;
        }
        Ok(Self { motions, synthetic_legs, frames_before, frames, mass: Vec::new(), normalization })
    }

    /// The same, with frames of rare actions drawn more often: by the number of their action's frames to the power of minus `balance`. Clips
    /// without an action count as one.
    #[must_use]
    pub fn balanced(mut self, dataset: &Dataset, balance: f64) -> Self {
        if balance == 0.0 {
            return self;
        }
        let clips = dataset.split(Split::Train).filter(|clip| clip.frames() > FRAMES_PER_TOKEN);
        let actions: Vec<&str> = clips.flat_map(|clip| [clip.info.action().unwrap_or_default(); 2]).collect();
        let mut frames: BTreeMap<&str, f64> = BTreeMap::new();
        for (action, motion) in actions.iter().zip(&self.motions) {
            *frames.entry(action).or_default() += (motion.len() / FEATURES) as f64;
        }
        let mut sum = 0.0;
        let running = actions.iter().zip(&self.motions).map(|(action, motion)| {
            sum += (motion.len() / FEATURES) as f64 * frames[action].powf(-balance);
            sum
        });
        self.mass = running.collect();
        self
    }

    /// A motion, in proportion to its frames, or to what they weigh.
    fn draw(&self, random: &mut Random) -> usize {
        let Some(total) = self.mass.last() else {
            let frame = random.below(self.frames);
            return self.frames_before.partition_point(|before| *before <= frame) - 1;
        };
        let at = random.unit() * total;
        self.mass.partition_point(|sum| *sum <= at).min(self.mass.len() - 1)
    }

    /// Mean and deviation of the motions.
    pub fn normalization(&self) -> &Normalization {
        &self.normalization
    }

    /// Number of motions, mirrored ones included.
    pub fn motions(&self) -> usize {
        self.motions.len()
    }

    /// Number of frames, mirrored ones included.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// `size` crops of up to `window` frames: motions in proportion to their length, starts uniform but with the mass that would hang
    /// over an end moved to that end, so that first and last frames of clips are seen as often as others.
    pub fn batch(&self, size: usize, window: usize, random: &mut Random) -> Batch {
        let mut features = vec![0.0; size * window * FEATURES];
        let mut lengths = Vec::with_capacity(size);
        let mut synthetic_legs = Vec::with_capacity(size);
        for crop in features.chunks_exact_mut(window * FEATURES) {
            let index = self.draw(random);
            let motion = &self.motions[index];
            let frames = motion.len() / FEATURES;
            let length = window.min(frames / FRAMES_PER_TOKEN * FRAMES_PER_TOKEN);
            let room = frames - length;
            let start = (random.below(room + length) as isize - length as isize / 2).clamp(0, room as isize) as usize;
            crop[..length * FEATURES].copy_from_slice(&motion[start * FEATURES..(start + length) * FEATURES]);
            lengths.push(length);
            synthetic_legs.push(self.synthetic_legs[index]);
        }
        Batch { features, lengths, synthetic_legs }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;

    #[test]
    fn crops_are_pieces_of_motions_padded_with_zeros() {
        let dataset = testing::dataset(6, 40);
        let corpus = Corpus::new(&dataset).unwrap();
        assert_eq!(corpus.motions(), 2 * dataset.split(Split::Train).count());
        let batch = corpus.batch(50, 32, &mut Random::new(1, 1));
        let mut padded = 0;
        for (crop, length) in batch.features.chunks(32 * FEATURES).zip(&batch.lengths) {
            assert!(length % 4 == 0 && *length > 0);
            padded += usize::from(*length < 32);
            let (valid, rest) = crop.split_at(length * FEATURES);
            assert!(rest.iter().all(|x| *x == 0.0));
            let found = corpus.motions.iter().any(|m| m.windows(valid.len()).step_by(FEATURES).any(|w| w == valid));
            assert!(found, "a crop is not a piece of a motion");
        }
        assert!(padded > 0 && padded < 50, "the example has short and long clips");
    }

    #[test]
    fn crops_of_a_kinect_and_of_its_twin_have_synthetic_legs() {
        let dataset = testing::kinect(&testing::dataset(6, 40), &["figure2"]);
        let corpus = Corpus::new(&dataset).unwrap();
        let batch = corpus.batch(60, 32, &mut Random::new(3, 1));
        let own = |index: usize| corpus.normalization.apply(dataset.clip(index).features);
        let mut counts = [0; 2];
        for (crop, (length, synthetic)) in
            batch.features.chunks(32 * FEATURES).zip(batch.lengths.iter().zip(&batch.synthetic_legs))
        {
            let valid = &crop[..length * FEATURES];
            let is_of = |index| own(index).windows(valid.len()).step_by(FEATURES).any(|w| w == valid);
            counts[usize::from(*synthetic)] += 1;
            assert!(!is_of(2) || *synthetic);
            assert!(![0, 1, 3].into_iter().any(is_of) || !*synthetic);
        }
        assert!(counts.iter().all(|count| *count > 5), "{counts:?}");
    }

    /// Two actions, one of which has a single clip: unbalanced it is drawn as often as its frames say, balanced by 1 as often as the other.
    #[test]
    fn rare_actions_are_drawn_more_often() {
        let mut dataset = testing::dataset(6, 40);
        let rare = dataset.clips.iter().position(|clip| clip.split == Split::Train).unwrap();
        for (index, clip) in dataset.clips.iter_mut().enumerate() {
            clip.facts = None;
            clip.labels = serde_json::json!({"content": if index == rare { "dance" } else { "walk" }});
        }
        let share = |balance: f64| {
            let corpus = Corpus::new(&dataset).unwrap().balanced(&dataset, balance);
            let mut random = Random::new(7, 2);
            let drawn = (0..4000).filter(|_| corpus.draw(&mut random) < 2).count();
            drawn as f64 / 4000.0
        };
        let corpus = Corpus::new(&dataset).unwrap();
        let own = corpus.motions[0].len() * 2 / FEATURES;
        let alike = own as f64 / corpus.frames as f64;
        assert!((share(0.0) - alike).abs() < 0.03 && (share(1.0) - 0.5).abs() < 0.03, "{alike}");
        let (rare, often) = (alike.sqrt(), (1.0 - alike).sqrt());
        assert!((share(0.5) - rare / (rare + often)).abs() < 0.03);
    }

    #[test]
    fn batches_repeat_with_the_seed() {
        let corpus = Corpus::new(&testing::dataset(4, 30)).unwrap();
        let draw = |stream| corpus.batch(3, 16, &mut Random::new(9, stream)).features;
        assert_eq!(draw(1), draw(1));
        assert_ne!(draw(1), draw(2));
    }

    #[test]
    fn no_training_clips_is_a_typed_error() {
        let mut dataset = testing::dataset(3, 20);
        dataset.clips.iter_mut().for_each(|clip| clip.split = Split::Test);
        assert!(matches!(Corpus::new(&dataset), Err(Error::NoMotion { split: Split::Train })));
    }
}
