//! The reference's analytical gradients against finite differences, in f64.

use motionette_host::checkpoint::{Config, Statistics, Tensor, TensorMap, TokenizerCheckpoint};
use motionette_host::reference::objective::{Objective, Weights};
use motionette_host::reference::recover::{self, CHANNELS, JOINTS};
use motionette_host::reference::{Anchor, DecodePath, Target};

/// Step of the central differences; the error is of the order of its square.
const STEP: f64 = 1e-5;

/// Deterministic numbers in -1..1.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (self.0 >> 33) as f64 / f64::from(1_u32 << 30) - 1.0
    }

    fn take(&mut self, n: usize, scale: f64) -> Vec<f64> {
        (0..n).map(|_| self.next() * scale).collect()
    }
}

/// Looks as far ahead as back.
const SYMMETRICAL: &str = "[]";
/// Some convolutions look ahead, most less far than back.
const MOSTLY_CAUSAL: &str = "[0, 4, 0, 1, 1, 0, 2, 0, 0, 1, 0]";

/// A small random decoder: width 5, codes 4 wide, dilations 9, 3, 1, whose convolutions look ahead so far.
fn checkpoint(right: &str) -> TokenizerCheckpoint {
    let config = Config::from_json(&format!(
        r#"{{"width": 5, "encoder_width": 5, "code_dim": 4, "codes": 3, "quantizers": 1, "depth": 3,
            "dilations": [9, 3, 1], "right": {right}, "down_t": 2, "features": 67, "fps": 20.0}}"#,
    ))
    .expect("a configuration");
    let mut numbers = Numbers(7);
    let mut map = TensorMap::default();
    let mut add = |name: &str, shape: &[usize]| {
        let fan: usize = shape.iter().skip(1).product::<usize>().max(1);
        let data = numbers.take(shape.iter().product(), (3.0 / fan as f64).sqrt()).iter().map(|&v| v as f32).collect();
        map.insert(name, Tensor { shape: shape.to_vec(), data });
    };
    let mut conv = |name: &str, outputs: usize, inputs: usize, kernel: usize| {
        add(&format!("{name}.weight"), &[outputs, inputs, kernel]);
        add(&format!("{name}.bias"), &[outputs]);
    };
    conv("decoder.model.0", 5, 4, 3);
    for s in [2, 3] {
        for b in 0..3 {
            conv(&format!("decoder.model.{s}.0.model.{b}.conv1"), 5, 5, 3);
            conv(&format!("decoder.model.{s}.0.model.{b}.conv2"), 5, 5, 1);
        }
        conv(&format!("decoder.model.{s}.2"), 5, 5, 3);
    }
    conv("decoder.model.4", 5, 5, 3);
    conv("decoder.model.6", 67, 5, 3);
    add("quantizer.layers.0.codebook", &[3, 4]);
    let mut checkpoint = TokenizerCheckpoint::build(&map, config).expect("a whole checkpoint");
    let mut numbers = Numbers(11);
    let std = (0..67).map(|c| if c < 3 { 0.05 } else { 0.3 }).collect();
    checkpoint.statistics = Some(Statistics { mean: numbers.take(67, 0.2), std });
    checkpoint
}

#[test]
fn recovery_of_joints() {
    let (frames, channels) = (7, CHANNELS + 2);
    let mut numbers = Numbers(3);
    let features = numbers.take(frames * channels, 0.7);
    let weights: Vec<[[f64; 3]; JOINTS]> =
        (0..frames).map(|_| core::array::from_fn(|_| core::array::from_fn(|_| numbers.next()))).collect();
    let value = |f: &[f64]| -> f64 {
        let joints = recover::joints(f, channels);
        let flat = |m: &[[[f64; 3]; JOINTS]]| m.as_flattened().as_flattened().to_vec();
        flat(&joints).iter().zip(&flat(&weights)).map(|(a, b)| a * b).sum()
    };
    let gradient = recover::joints_backward(&features, channels, &weights);
    for i in 0..features.len() {
        let mut moved = features.clone();
        moved[i] += STEP;
        let above = value(&moved);
        moved[i] -= 2.0 * STEP;
        let numeric = (above - value(&moved)) / (2.0 * STEP);
        let (t, c) = (i / channels, i % channels);
        assert!(
            (numeric - gradient[i]).abs() < 1e-7 * (1.0 + numeric.abs()),
            "frame {t} channel {c}: {numeric} {}",
            gradient[i]
        );
    }
}

#[test]
fn objective_with_all_terms_through_decoder_and_recovery() {
    for right in [SYMMETRICAL, MOSTLY_CAUSAL] {
        check_objective(&checkpoint(right));
    }
}

fn check_objective(checkpoint: &TokenizerCheckpoint) {
    let decode_path = DecodePath::<f64>::new(checkpoint).expect("statistics");
    let tokens = 9;
    let mut numbers = Numbers(5);
    let origin = numbers.take(tokens * 4, 1.0);
    let u: Vec<f64> = origin.iter().map(|o| o + 0.3 * numbers.next()).collect();
    let anchors = [
        Anchor { frame: 0, target: Target::Root([0.1, 0.9, -0.2]) },
        Anchor { frame: 17, target: Target::PlanarRoot([0.5, 0.4]) },
        Anchor { frame: 17, target: Target::Joint { joint: 20, position: [0.2, 1.4, 0.3] } },
        Anchor { frame: 35, target: Target::Joint { joint: 15, position: [-0.3, 1.6, 0.8] } },
    ];
    let off = Weights { smoothness: 0.0, trust: 0.0, feasibility: 0.0, max_step: 0.001 };
    for (name, weights) in [
        ("anchors", off),
        ("smoothness", Weights { smoothness: 50.0, ..off }),
        ("trust", Weights { trust: 3.0, ..off }),
        ("feasibility", Weights { feasibility: 200.0, ..off }),
        ("all", Weights { smoothness: 5.0, trust: 0.1, feasibility: 20.0, max_step: 0.01 }),
    ] {
        let objective = Objective::new(&decode_path, &anchors, weights, &origin);
        let (_, pass) = objective.value(&u);
        let gradient = objective.gradient(&u, &pass);
        let largest = gradient.iter().fold(0.0_f64, |m, g| m.max(g.abs()));
        assert!(largest > 1e-3, "{name}: the gradient vanishes, nothing is tested");
        for i in 0..u.len() {
            let mut moved = u.clone();
            moved[i] += STEP;
            let above = objective.value(&moved).0;
            moved[i] -= 2.0 * STEP;
            let numeric = (above - objective.value(&moved).0) / (2.0 * STEP);
            assert!(
                (numeric - gradient[i]).abs() < 1e-6 * (1.0 + largest),
                "{name}, u[{i}]: {numeric} {}",
                gradient[i]
            );
        }
    }
}

#[test]
fn single_precision_gradient_agrees_with_double() {
    let checkpoint = checkpoint(MOSTLY_CAUSAL);
    let (double, single) =
        (DecodePath::<f64>::new(&checkpoint).expect("f64"), DecodePath::<f32>::new(&checkpoint).expect("f32"));
    let u = Numbers(9).take(9 * 4, 1.0);
    let narrow: Vec<f32> = u.iter().map(|&v| v as f32).collect();
    let anchors = [Anchor { frame: 30, target: Target::Joint { joint: 21, position: [0.4, 1.0, 0.2] } }];
    let (a, b) = (
        Objective::new(&double, &anchors, Weights::default(), &u),
        Objective::new(&single, &anchors, Weights::default(), &narrow),
    );
    let (exact, rounded) = (a.gradient(&u, &a.value(&u).1), b.gradient(&narrow, &b.value(&narrow).1));
    let largest = exact.iter().fold(0.0_f64, |m, g| m.max(g.abs()));
    for (e, r) in exact.iter().zip(&rounded) {
        assert!((e - f64::from(*r)).abs() < 1e-5 * largest, "{e} {r}");
    }
}
