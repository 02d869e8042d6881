//! The runtime's solver and the reference's own on the same anchors: they differ by method and rounding, so this is reported, not gated.

use motionette::numerics::hash::Stream;
use motionette::refining::Config;
use motionette::{Bones, Request};
use serde::Serialize;

use crate::agreement::Agreement;
use crate::blob::BlobFile;
use crate::reference::bridge::runtime_anchors;
use crate::reference::interval_basis::Basis;
use crate::reference::objective::Weights;
use crate::reference::route_solver::Settings;
use crate::reference::{Anchor, DecodePath, Target, anchors::control_error, quasi_newton};

use super::{Error, Sequence, run};

/// SMPL wrists.
const WRISTS: [u8; 2] = [20, 21];
/// How far anchors are pulled away from the motion, metres.
const PULL: f32 = 0.15;
const CENTIMETRES: f64 = 100.0;

/// Both solvers on some clips; means over clips.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Clips compared.
    pub clips: usize,
    /// Decoder evaluations each may spend.
    pub evaluations: u16,
    /// Control error before, centimetres.
    pub before_cm: f64,
    /// After the runtime's solver, as the runtime measures it.
    pub runtime_cm: f64,
    /// The runtime's result decoded by the reference.
    pub runtime_in_reference_cm: f64,
    /// After the reference's solver.
    pub reference_cm: f64,
    /// Root-aligned joint distance of the two results, mean, millimetres.
    pub difference_mm: f64,
}

/// Puts four anchors (two root, two wrist) 15 cm beside the motion of each of the first `count` long enough clips.
///
/// # Errors
/// [`Error`].
pub fn compare(
    blob: &BlobFile,
    decode_path: &DecodePath<f32>,
    sequences: &[Sequence],
    count: usize,
) -> Result<Report, Error> {
    let config = Config::fast(20);
    let quantizers = blob.model()?.codebooks().quantizers();
    let mut chosen: Vec<&Sequence> = sequences.iter().filter(|s| s.tokens.len() >= 8 * quantizers).collect();
    chosen.truncate(count);
    let mut report = Report {
        clips: chosen.len(),
        evaluations: config.evaluations,
        before_cm: 0.0,
        runtime_cm: 0.0,
        runtime_in_reference_cm: 0.0,
        reference_cm: 0.0,
        difference_mm: 0.0,
    };
    let mut agreement = Agreement::default();
    let share = CENTIMETRES / chosen.len().max(1) as f64;
    for (seed, sequence) in chosen.iter().enumerate() {
        let request = Request::tokens(&sequence.tokens).bones(Bones::Decoded).unrefined();
        let plain = run(blob, &sequence.id, &request)?;
        let anchors = place(&plain.joints, seed as u64);
        let given = runtime_anchors(&anchors);
        let bent = run(blob, &sequence.id, &request.through(&given).refined(config))?;
        let settings = Settings {
            basis: Basis::Affine,
            weights: Weights {
                smoothness: f64::from(config.smoothness),
                trust: f64::from(config.trust),
                feasibility: f64::from(config.feasibility),
                max_step: f64::from(config.max_step),
            },
            ..Settings::default()
        };
        let own = quasi_newton::solve(decode_path, &anchors, &plain.u, &settings, usize::from(config.evaluations));
        report.before_cm += share * own.error_before;
        report.runtime_cm += share * control_error(&anchors, &bent.joints);
        report.runtime_in_reference_cm += share * control_error(&anchors, &decode_path.forward(&bent.u).joints);
        report.reference_cm += share * own.error_after;
        agreement.add(&sequence.id, &bent.joints, &own.joints);
    }
    agreement.finish();
    report.difference_mm = agreement.mean_mm;
    Ok(report)
}

/// Two root and two wrist anchors, each pulled [`PULL`] metres in a direction of its own.
fn place(motion: &[crate::motion::Pose], seed: u64) -> Vec<Anchor> {
    let mut random = Stream::new(seed);
    let last = motion.len() - 1;
    (0..4_usize)
        .map(|n| {
            let frame = last * (n + 1) / 4;
            let joint = if n % 2 == 0 { 0 } else { WRISTS[n / 2] };
            let angle = core::f32::consts::TAU * random.unit();
            let p = motion[frame][usize::from(joint)];
            let position = [p[0] + PULL * angle.cos(), p[1], p[2] + PULL * angle.sin()].map(f64::from);
            let target = match joint {
                0 => Target::Root(position),
                joint => Target::Joint { joint: usize::from(joint), position },
            };
            Anchor { frame, target }
        })
        .collect()
}
