//! Latents like those that the decoder will receive: from tokens of training clips, or from random tokens where there is no dataset.

use motionette::numerics::hash::Stream;

use super::Error;
use crate::checkpoint::TokenizerCheckpoint;
use crate::dataset::{Dataset, Split};
use crate::reference::{Quantizer, Tokenizer};

/// Clips taken from the train split, spread evenly over it.
pub const CLIPS: usize = 192;
/// Captioned train clips on which a planner is calibrated, one pass each.
pub const CASES: usize = 128;
/// Random sequences when there is no data.
const RANDOM_SEQUENCES: usize = 48;
/// Tokens of a random sequence.
const RANDOM_TOKENS: usize = 24;
/// Fewest frames of a clip that is used: a handful of tokens.
const LEAST_FRAMES: usize = 32;
/// Share of tokens that are moved towards another code, as a solver would.
const MOVED_SHARE: f32 = 0.15;
/// How far they are moved.
const MOVED_DISTANCE: f32 = 0.5;

/// Latents `[L][du]` of at most [`CLIPS`] train clips, a share of their tokens moved off the codes.
///
/// # Errors
/// [`Error::NoCalibration`], [`Error::Calibration`].
pub fn from_dataset(checkpoint: &TokenizerCheckpoint, dataset: &Dataset) -> Result<Vec<Vec<f32>>, Error> {
    let clips: Vec<_> = dataset.split(Split::Train).filter(|c| c.frames() >= LEAST_FRAMES).collect();
    if clips.is_empty() {
        return Err(Error::NoCalibration { least: LEAST_FRAMES });
    }
    let tokenizer = Tokenizer::<f32>::new(checkpoint);
    let wanted = CLIPS.min(clips.len());
    let chosen: Vec<_> = (0..wanted).map(|i| clips[i * clips.len() / wanted]).collect();
    let encoded = crate::parallel::map(&chosen, |clip| {
        let frames = clip.frames().min(super::MAX_TOKENS * checkpoint.config.frames_per_token());
        tokenizer
            .encode(&clip.features[..frames * checkpoint.config.features])
            .map_err(|source| Error::Calibration { clip: clip.info.id.clone(), source })
    });
    let mut random = Stream::new(1);
    encoded.into_iter().map(|ids| Ok(latent(&tokenizer.quantizer, &ids?, &mut random))).collect()
}

/// Latents of random ids.
#[must_use]
pub fn random(checkpoint: &TokenizerCheckpoint) -> Vec<Vec<f32>> {
    let quantizer = Quantizer::<f32>::new(&checkpoint.codebooks, checkpoint.config.code_dim);
    let mut random = Stream::new(2);
    let mut sequence = || {
        let count = RANDOM_TOKENS * quantizer.quantizers();
        let ids: Vec<i64> = (0..count).map(|_| i64::from(random.below(quantizer.codes as u32))).collect();
        latent(&quantizer, &ids, &mut random)
    };
    (0..RANDOM_SEQUENCES).map(|_| sequence()).collect()
}

/// Sum of codes, some tokens moved part of the way to another code of the first codebook.
fn latent(quantizer: &Quantizer<f32>, ids: &[i64], random: &mut Stream) -> Vec<f32> {
    // Ids come from the encoder or from the range of the codebook; none is outside.
    let mut u = quantizer.decode(ids).unwrap_or_default();
    let layers = quantizer.quantizers();
    for row in u.chunks_exact_mut(quantizer.width) {
        if random.unit() >= MOVED_SHARE {
            continue;
        }
        let mut other = vec![crate::reference::quantizer::NOTHING; layers];
        if let Some(first) = other.first_mut() {
            *first = i64::from(random.below(quantizer.codes as u32));
        }
        let target = quantizer.decode(&other).unwrap_or_default();
        let share = MOVED_DISTANCE * random.unit();
        for (u, t) in row.iter_mut().zip(target) {
            *u += share * (t - *u);
        }
    }
    u
}
