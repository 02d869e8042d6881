//! The reference's anchor control against formulas written out anew: one softmax over the planner's own rows and those of the anchors.

mod common;

use common::checkpoints::{control, control_checkpoint, control_config, prior, prior_checkpoint, tokenizer_checkpoint};
use common::naive::{Matrix, Naive, close};
use motionette_host::checkpoint::{ControlCheckpoint, ControlConfig, TensorMap};
use motionette_host::reference::scaffold::{self, Statistics};
use motionette_host::reference::tmd::Settings;
use motionette_host::reference::{Anchor, Control, Prior, Real, Target};

const RATE: f64 = 20.0;
const ALL: &str = r#"["root3d", "planar", "body"]"#;

/// One anchor of every family, two of them at one frame, within 20 frames.
fn anchors() -> [Anchor; 4] {
    [
        Anchor { frame: 2, target: Target::Root([0.1, 0.9, 0.2]) },
        Anchor { frame: 11, target: Target::PlanarRoot([0.6, 1.5]) },
        Anchor { frame: 11, target: Target::Joint { joint: 20, position: [0.4, 1.3, 1.2] } },
        Anchor { frame: 19, target: Target::Joint { joint: 20, position: [-0.4, 0.3, 2.2] } },
    ]
}

fn features(checkpoint: &ControlCheckpoint, anchors: &[Anchor], tokens: usize) -> Matrix {
    let Statistics { mean, std } = checkpoint.statistics.clone();
    let features: Vec<f64> = scaffold::features(anchors, 4 * tokens, RATE, &Statistics { mean, std });
    features.chunks(scaffold::WIDTH).map(<[f64]>::to_vec).collect()
}

fn merged(a: TensorMap, b: &TensorMap) -> TensorMap {
    b.iter().fold(a, |mut all, (name, tensor)| {
        all.insert(name, tensor.clone());
        all
    })
}

fn forward<T: Real>(limit: f64) {
    let variants = [("pre", "gelu", true), ("pre", "relu", false), ("post", "gelu", false), ("post", "relu", true)];
    for (seed, (norm, activation, context)) in (0_u64..).zip(variants) {
        let config = control_config(seed, norm, activation, context, ALL);
        let config = ControlConfig::from_json(&config).expect("a good configuration");
        let map = control(seed, context);
        let checkpoint = ControlCheckpoint::build(&map, config).expect("a good checkpoint");
        let naive = Naive { map: merged(prior(seed), &map), post: norm == "post", relu: activation == "relu" };
        let (base, tokenizer) = (prior_checkpoint(seed, norm, activation), tokenizer_checkpoint());
        checkpoint.check_prior(&base, &tokenizer).expect("its own prior");
        let reference = Prior::<T>::new(&base, &tokenizer).controlled(&checkpoint, RATE);

        let c = features(&checkpoint, &anchors(), 5);
        let flat: Vec<T> = c.concat().into_iter().map(T::from_f64).collect();
        let encoder = reference.control.as_ref().expect("a control");
        close(&encoder.encode(&flat), &naive.scaffold(&c), limit, "scaffold");

        let (words, z, fixed) = ([3_u16, 4, 1], [5_u16, 0, 2, 4, 1], [false, false, true, false, false]);
        for (start_open, end_open) in [(false, false), (true, true)] {
            for guidance in [1.0_f32, 2.5] {
                let planner = |words: &[u16], c| naive.planner(words, &z, 12, &fixed, (start_open, end_open), c);
                let blend = |(a, b): (&f64, &f64)| b + f64::from(guidance) * (a - b);
                // What guides is text and anchors together.
                let (with, without) = (planner(&words, Some(&c)), planner(&[0], None));
                let expected = with.iter().zip(&without).map(|(a, b)| a.iter().zip(b).map(blend).collect()).collect();
                let mut guided = reference.through(reference.guided(&words, guidance), &anchors(), z.len());
                (guided.start_open, guided.end_open) = (start_open, end_open);
                let logits = reference.logits(&guided, &z, 0.4, &fixed);
                close(&logits, &expected, limit, &format!("{norm} {activation} guidance {guidance}"));
            }
        }
    }
}

#[test]
fn forward_in_double_precision() {
    forward::<f64>(1e-11);
}

#[test]
fn forward_in_single_precision() {
    forward::<f32>(5e-5);
}

#[test]
fn without_anchors_nothing_changes() {
    let (base, tokenizer) = (prior_checkpoint(1, "pre", "gelu"), tokenizer_checkpoint());
    let plain = Prior::<f32>::new(&base, &tokenizer);
    let controlled = plain.clone().controlled(&control_checkpoint(2, 1), RATE);
    let (words, z) = ([3_u16, 5], [4_u16, 2, 0, 1, 3]);
    let through = |prior: &Prior<f32>, anchors: &[Anchor]| {
        let guided = prior.through(prior.guided(&words, 2.0), anchors, z.len());
        (prior.logits(&guided, &z, 0.4, &[]), prior.sample(&guided, z.len(), &Settings::default()))
    };
    let expected = through(&plain, &[]);
    assert_eq!(through(&controlled, &[]), expected);
    assert_eq!(through(&plain, &anchors()), expected, "no control");
    assert_ne!(through(&controlled, &anchors()).0, expected.0);
}

#[test]
fn anchors_of_other_families_are_not_seen() {
    let config = control_config(1, "pre", "gelu", true, r#"["body", "root3d"]"#);
    let config = ControlConfig::from_json(&config).expect("a good configuration");
    let checkpoint = ControlCheckpoint::build(&control(2, true), config).expect("a good checkpoint");
    let (control, [root, planar, wrist, late]) = (Control::<f64>::new(&checkpoint, RATE), anchors());
    assert_eq!(anchors().map(|a| control.sees(&a)), [true, false, true, true]);
    assert_eq!(control.context(&[planar], 5), None);
    assert_eq!(control.context(&anchors(), 5), control.context(&[root, wrist, late], 5));
    let all = Control::<f64>::new(&control_checkpoint(2, 1), RATE);
    assert_ne!(all.context(&anchors(), 5), control.context(&anchors(), 5));
}
