//! Where the error of quantisation comes from, layer by layer.

use serde::Serialize;

use crate::agreement::Agreement;
use crate::blob::BlobFile;
use crate::checkpoint::TokenizerCheckpoint;
use crate::motion::Pose;
use crate::reference::recover::CHANNELS;
use crate::reference::{DecodePath, Decoder, Trace};

use super::Error;

/// Clips that the layers are measured on.
const CLIPS: usize = 12;

/// Error by layer.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Quantised weights, exact arithmetic, against the checkpoint: growth of the error along the decoder.
    pub stages: Vec<Stage>,
    /// Each layer quantised alone.
    pub alone: Vec<Alone>,
    /// What the runtime's own arithmetic (int16 activations) adds: runtime against its own weights in the reference, mean, millimetres.
    pub arithmetic_mean_mm: f64,
    /// The same, root drift at the end of 5 s, mean.
    pub arithmetic_drift_mm: f64,
}

/// Error at the output of a stage.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Stage {
    /// Name in the checkpoint.
    pub name: String,
    /// Root mean square of the error, as a share of that of the signal.
    pub relative_error: f64,
}

/// Error at the joints when one layer alone is quantised.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Alone {
    /// Name of the layer.
    pub name: String,
    /// Mean root-aligned joint error, millimetres.
    pub mean_mm: f64,
    /// Mean root drift at the end of 5 s, millimetres.
    pub drift_mm: f64,
}

/// Measures on the first clips of `motions` (embeddings and what the runtime made of them).
///
/// # Errors
/// [`Error`].
pub fn measure(
    blob: &BlobFile,
    checkpoint: &TokenizerCheckpoint,
    motions: &[(Vec<f32>, Vec<Pose>)],
) -> Result<Report, Error> {
    // Long clips first: drift needs 5 s.
    let mut chosen: Vec<&(Vec<f32>, Vec<Pose>)> = motions.iter().collect();
    chosen.sort_by_key(|(u, _)| core::cmp::Reverse(u.len()));
    chosen.truncate(CLIPS);
    let weights = blob.dequantised(&checkpoint.decoder)?;
    let exact = DecodePath::<f32>::new(checkpoint)?;
    let rounded = DecodePath::<f32>::new(&TokenizerCheckpoint { decoder: weights.clone(), ..checkpoint.clone() })?;
    let exact_joints: Vec<Vec<Pose>> = crate::parallel::map(&chosen, |(u, _)| exact.forward(u).joints);

    let mut arithmetic = Agreement::default();
    for (u, joints) in &chosen {
        arithmetic.add("", joints, &rounded.forward(u).joints);
    }
    arithmetic.finish();

    let indices: Vec<usize> = (0..weights.convolutions().len()).collect();
    let alone = crate::parallel::map(&indices, |&i| -> Result<Alone, Error> {
        let mut decoder = checkpoint.decoder.clone();
        let name = weights.convolutions()[i].name.clone();
        decoder.convolutions_mut()[i].clone_from(weights.convolutions()[i]);
        let decode_path = DecodePath::<f32>::new(&TokenizerCheckpoint { decoder, ..checkpoint.clone() })?;
        let mut agreement = Agreement::default();
        for ((u, _), joints) in chosen.iter().zip(&exact_joints) {
            agreement.add("", &decode_path.forward(u).joints, joints);
        }
        agreement.finish();
        Ok(Alone { name, mean_mm: agreement.mean_mm, drift_mm: agreement.drift_mean_mm })
    });
    Ok(Report {
        stages: stages(&exact.decoder, &rounded.decoder, checkpoint.config.down_t, &chosen),
        alone: alone.into_iter().collect::<Result<_, _>>()?,
        arithmetic_mean_mm: arithmetic.mean_mm,
        arithmetic_drift_mm: arithmetic.drift_mean_mm,
    })
}

/// Square error and square signal at every stage.
fn stages(
    exact: &Decoder<f32>,
    rounded: &Decoder<f32>,
    count: usize,
    motions: &[&(Vec<f32>, Vec<Pose>)],
) -> Vec<Stage> {
    let mut sums = vec![(0.0, 0.0); count + 3];
    for (u, _) in motions {
        let (a, b) = (exact.forward(u), rounded.forward(u));
        for (sum, (a, b)) in sums.iter_mut().zip(outputs(&a).into_iter().zip(outputs(&b))) {
            for (&a, &b) in a.iter().zip(b) {
                let (a, b) = (f64::from(a), f64::from(b));
                sum.0 += (a - b) * (a - b);
                sum.1 += a * a;
            }
        }
    }
    let mut names: Vec<String> =
        (0..count + 3).map(|i| format!("decoder.model.{}", if i == 0 { 0 } else { i + 1 })).collect();
    if let Some(last) = names.last_mut() {
        *last = format!("decoder.model.{} (channels 0..{CHANNELS})", count + 4);
    }
    let share = |(error, signal): (f64, f64)| if signal > 0.0 { (error / signal).sqrt() } else { 0.0 };
    names.into_iter().zip(sums).map(|(name, s)| Stage { name, relative_error: share(s) }).collect()
}

fn outputs(trace: &Trace<f32>) -> Vec<&[f32]> {
    let mut all: Vec<&[f32]> = vec![&trace.input];
    all.extend(trace.stages.iter().map(Vec::as_slice));
    all.extend([trace.hidden.as_slice(), &trace.features]);
    all
}
