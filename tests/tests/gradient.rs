//! Input gradients of the runtime's decoder and recovery against central differences of the f64 oracle.

use motionette::Model;
use motionette::codec::Decode;
use motionette::codec::vq::decoder::ChunkShape;
use motionette::memory::Arena;
use motionette::numerics::hash::Stream;
use motionette::representation::humanml3d::{Path, channels};
use motionette::representation::{Features, Recover};
use motionette::{LEAST_ROWS, MOST_ROWS, ROWS};
use motionette_tests::naive;
use motionette_tests::tiny::{Shape, Tiny};
use std::ops::ControlFlow;

/// One term `d . position(joint, frame)` of a linear objective.
struct Term {
    joint: usize,
    frame: usize,
    d: [f32; 3],
}

/// `dJ/du` by the runtime for `J = sum of terms`.
fn runtime_gradient(model: &Model<'_>, u: &[f32], terms: &[Term], rows: usize) -> Vec<f32> {
    let decoder = model.decoder();
    let tokens = u.len() / decoder.code_width();
    let frames = tokens * decoder.upsampling();
    let joints = terms.iter().fold(0, |mask, term| mask | 1 << term.joint);
    let selected = channels(joints);
    let mut memory = vec![0u8; 1 << 22];
    let mut arena = Arena::new(&mut memory);
    let mut work = decoder.workspace(&mut arena, tokens, selected.count(), rows).unwrap();
    let mut take = |count| arena.take::<f32>(count).unwrap();
    let mut path = Path {
        cos: take(frames),
        sin: take(frames),
        x: take(frames),
        z: take(frames),
        d_angle: take(frames),
        d_x: take(frames),
        d_z: take(frames),
    };
    let values = take(frames * selected.count());
    let gradient = take(frames * selected.count());
    let mut check = || ControlFlow::Continue(());
    assert!(decoder.forward(u, &selected, values, &mut work, &mut check).is_continue());
    let (features, recovery) = (Features { values, channels: &selected }, model.recovery());
    recovery.integrate(features, &mut path);
    for term in terms {
        recovery.add_gradient(features, &mut path, gradient, (term.joint, term.frame), term.d);
    }
    recovery.integrate_gradient(features, &path, gradient);
    let mut du = vec![0.0; u.len()];
    assert!(decoder.backward(gradient, &selected, &mut du, &mut work, &mut check).is_continue());
    du
}

/// Every `stride`-th number of the same by central differences of the oracle.
fn oracle_gradient(tiny: &Tiny, u: &[f32], terms: &[Term], stride: usize) -> Vec<f64> {
    let objective = |u: &[f64]| -> f64 {
        let motion = naive::motion(tiny, u);
        let dot = |term: &Term| -> f64 {
            motion[term.frame][term.joint].iter().zip(term.d).map(|(p, d)| p * f64::from(d)).sum()
        };
        terms.iter().map(dot).sum()
    };
    let base: Vec<f64> = u.iter().map(|&v| f64::from(v)).collect();
    let step = 1e-6;
    (0..u.len())
        .step_by(stride)
        .map(|i| {
            let shifted = |by: f64| {
                let mut u = base.clone();
                u[i] += by;
                objective(&u)
            };
            (shifted(step) - shifted(-step)) / (2.0 * step)
        })
        .collect()
}

#[test]
fn gradients_agree_with_central_differences_for_every_shape() {
    let base = Shape::default();
    let chunk = ChunkShape::new(usize::MAX, ROWS).tokens;
    let shapes = [
        base.clone(),
        Shape { width: 33, code_width: 7, dilations: vec![9, 3, 1], ..base.clone() },
        Shape { width: 8, wide: 0, dilations: vec![2], stages: 1, ..base.clone() },
        Shape { width: 5, wide: 100, stages: 3, ..base.clone() },
        // Codes wider than a token's frames together.
        Shape { width: 8, code_width: 40, wide: 0, dilations: vec![1], stages: 1, ..base.clone() },
        // Decoders that look less far ahead than back.
        base.clone().causal(),
        Shape { dilations: vec![9, 3, 1], right: vec![1, 4, 3, 1, 0, 0, 2, 0, 1, 0, 1], ..base.clone() },
        Shape { stages: 3, dilations: vec![2], right: vec![0, 1, 1, 0, 0, 2, 1, 1, 0], ..base },
    ];
    for (seed, shape) in shapes.into_iter().enumerate() {
        let tiny = Tiny::new(shape.clone(), 40 + seed as u64);
        let model = Model::open(tiny.bytes()).unwrap();
        let mut random = Stream::new(seed as u64);
        for tokens in [1, 2, 5, chunk + 1, 2 * chunk + 3] {
            // Of long motions, which pass in chunks, a part: the oracle decodes them twice for each number.
            let stride = if tokens < chunk { 1 } else { 11 };
            let frames = tokens * model.frames_per_token();
            let u: Vec<f32> = (0..tokens * usize::from(shape.code_width)).map(|_| 2.0 * random.unit() - 1.0).collect();
            let mut signed = || 2.0 * random.unit() - 1.0;
            let many: Vec<Term> = [0usize, 3, 20, 21]
                .into_iter()
                .flat_map(|joint| [0, frames / 2, frames - 1].map(|frame| (joint, frame)))
                .map(|(joint, frame)| Term { joint, frame, d: [signed(), signed(), signed()] })
                .collect();
            let root_only = vec![Term { joint: 0, frame: frames - 1, d: [1.0, 0.5, -0.7] }];
            let joint_only = vec![Term { joint: 15, frame: frames / 2, d: [0.3, 0.0, 1.0] }];
            for terms in [many, root_only, joint_only] {
                let got = runtime_gradient(&model, &u, &terms, ROWS);
                for rows in [LEAST_ROWS, 13, MOST_ROWS] {
                    let same = runtime_gradient(&model, &u, &terms, rows);
                    assert!(
                        same.iter().map(|v| v.to_bits()).eq(got.iter().map(|v| v.to_bits())),
                        "{rows} rows at a time"
                    );
                }
                let want = oracle_gradient(&tiny, &u, &terms, stride);
                let norm = want.iter().map(|v| v * v).sum::<f64>().sqrt();
                let got = got.iter().step_by(stride);
                let error = got.zip(&want).map(|(a, b)| (f64::from(*a) - b).powi(2)).sum::<f64>().sqrt();
                // A ReLU whose input lies within the activations' rounding may fall on the other side.
                assert!(error <= 4e-3 * norm + 1e-7, "{shape:?}, {tokens} tokens: {error} of {norm}");
            }
        }
    }
}
