//! The reference's prior against formulas written out anew.

mod common;

use common::checkpoints::{prior, prior_checkpoint, tokenizer_checkpoint};
use common::naive::{Naive, close};
use motionette::numerics::hash::Stream;
use motionette_host::reference::planner::Window;
use motionette_host::reference::tmd::{Sampling, Schedule, Settings, Tmd};
use motionette_host::reference::{Prior, Real};

const VARIANTS: [(&str, &str); 4] = [("pre", "gelu"), ("pre", "relu"), ("post", "gelu"), ("post", "relu")];

fn forward<T: Real>(limit: f64) {
    let tokenizer = tokenizer_checkpoint();
    for (seed, (norm, activation)) in VARIANTS.into_iter().enumerate() {
        let map = prior(seed as u64);
        let naive = Naive { map, post: norm == "post", relu: activation == "relu" };
        let reference = Prior::<T>::new(&prior_checkpoint(seed as u64, norm, activation), &tokenizer);
        let words = [3_u16, 4, 1, 7, 2];
        let encoded = reference.text.encode(&words);
        let (memory, pooled) = naive.text(&words);
        close(&encoded.memory, &memory, limit, "memory");
        close(&encoded.pooled, &vec![pooled.clone()], limit, "pooled");
        let lengths = naive.linear("text.length", &vec![pooled]);
        close(&reference.text.length_logits(&encoded.pooled), &lengths, limit, "length");

        let context = reference.planner.context(&encoded, 1.0);
        for (z, time, row, open) in [
            (&[5_u16, 0, 2, 2, 4, 1, 3][..], 0.0, 0, (false, false)),
            (&[1], 0.5, 16, (true, false)),
            (&[0, 5, 4], 0.25 - 1e-9, 7, (false, true)),
            (&[3, 3, 1, 0, 2], 1.0, 31, (true, true)),
        ] {
            let fixed: Vec<bool> = (0..z.len()).map(|i| i % 3 == 2).collect();
            let window = Window { fixed: &fixed, start_open: open.0, end_open: open.1 };
            let logits = reference.planner.logits(&context, z, time, window);
            close(
                &logits,
                &naive.planner(&words, z, row, &fixed, open, None),
                limit,
                &format!("{norm} {activation} {z:?}"),
            );
        }
    }
}

#[test]
fn forward_in_double_precision() {
    forward::<f64>(1e-11);
}

#[test]
fn forward_in_single_precision() {
    forward::<f32>(2e-5);
}

#[test]
fn guidance_goes_from_the_unconditional_prompt_through_the_text() {
    let reference = Prior::<f64>::new(&prior_checkpoint(4, "pre", "gelu"), &tokenizer_checkpoint());
    let naive = Naive { map: prior(4), post: false, relu: false };
    let (words, z, fixed) = ([3_u16, 5], [4_u16, 2, 0, 1], [false; 4]);
    let with = naive.planner(&words, &z, 12, &fixed, (false, false), None);
    let without = naive.planner(&[0], &z, 12, &fixed, (false, false), None);
    for guidance in [0.0_f32, 1.0, 2.5] {
        let blend = |(a, b): (&f64, &f64)| b + f64::from(guidance) * (a - b);
        let expected = with.iter().zip(&without).map(|(a, b)| a.iter().zip(b).map(blend).collect()).collect();
        let logits = reference.logits(&reference.guided(&words, guidance), &z, 0.4, &[]);
        close(&logits, &expected, 1e-11, &format!("guidance {guidance}"));
    }
}

#[test]
fn length_is_the_median_of_the_classes() {
    let reference = Prior::<f64>::new(&prior_checkpoint(5, "post", "relu"), &tokenizer_checkpoint());
    for words in [&[3_u16, 4][..], &[2], &[8, 3, 5, 1]] {
        let pooled = reference.text.encode(words).pooled;
        let p: Vec<f64> = reference.text.length_logits(&pooled).iter().map(|l| l.exp()).collect();
        let whole: f64 = p.iter().sum();
        let length = reference.length(words);
        let below = |n: usize| p[..n].iter().sum::<f64>() / whole;
        assert!(below(length - 1) < 0.5 && below(length) >= 0.5, "{length}");
    }
}

/// Codes on the plane at known angles.
fn plane() -> (Vec<f32>, Vec<f64>) {
    let angles: Vec<f64> = [0.0, 0.3, 0.9, 1.7, 2.6, -1.1].to_vec();
    let codes = angles.iter().enumerate().flat_map(|(i, a)| {
        let length = 0.5 + i as f64;
        [(length * a.cos()) as f32, (length * a.sin()) as f32]
    });
    (codes.collect(), angles)
}

#[test]
fn corruption_has_the_marginals_of_the_metric() {
    let (codes, angles) = plane();
    let tmd = Tmd::<f64>::new(&codes, 2, 3.0, 0.9);
    for (x, t) in [(1_u16, 0.1), (4, 0.35), (0, 0.6)] {
        let beta = 3.0 * f64::powf(t / (1.0 - t), 0.9);
        let weights: Vec<f64> =
            angles.iter().map(|a| (-beta * (2.0 - 2.0 * (a - angles[usize::from(x)]).cos()).powi(2)).exp()).collect();
        let whole: f64 = weights.iter().sum();
        for (q, w) in tmd.marginal(x, t).iter().zip(&weights) {
            assert!((q - w / whole).abs() < 1e-6, "{q} {}", w / whole);
        }
        let mut stream = Stream::new(9);
        let drawn = tmd.corrupt(&[x; 20_000], t, &mut stream);
        let mut chi = 0.0;
        for (i, w) in weights.iter().enumerate() {
            let (count, expected) =
                (drawn.iter().filter(|&&d| usize::from(d) == i).count() as f64, 20_000.0 * w / whole);
            chi += if expected > 1.0 { (count - expected).powi(2) / expected } else { 0.0 };
        }
        // 99.9 % of chi-square with five degrees of freedom.
        assert!(chi < 20.5, "{chi}");
    }
}

#[test]
fn one_step_of_the_sampler_has_the_rates_of_the_equation() {
    let (codes, angles) = plane();
    let tmd = Tmd::<f64>::new(&codes, 2, 3.0, 0.9);
    let dist = |i: usize, j: usize| (2.0 - 2.0 * (angles[i] - angles[j]).cos()).powi(2);
    let beta = |t: f64| if t > 0.0 { 3.0 * (t / (1.0 - t)).powf(0.9) } else { 0.0 };
    let (proposal, n) = (2_usize, 20_000);
    // Where a position goes in the first of two steps, by where it came from.
    let mut counts = [[0.0_f64; 6]; 6];
    let mut before = Vec::new();
    let settings = Settings { seed: 3, steps: 2, sampling: Sampling::Greedy, ..Settings::default() };
    let trace = tmd.sample(n, &settings, |z, time| {
        if time == 0.0 {
            before = z.to_vec();
        }
        z.iter().flat_map(|_| (0..6).map(|i| if i == proposal { 1.0 } else { 0.0 })).collect()
    });
    assert!(trace[1].iter().all(|&z| usize::from(z) == proposal), "the last step takes the proposal");
    for (from, to) in before.iter().zip(&trace[0]) {
        counts[usize::from(*from)][usize::from(*to)] += 1.0;
    }
    let q: Vec<f64> = (0..6).map(|i| (-beta(0.25) * dist(i, proposal)).exp()).collect();
    let whole: f64 = q.iter().sum();
    for (x, counts) in counts.iter().enumerate() {
        let rates: Vec<f64> = (0..6).map(|i| q[i] / whole * (dist(x, proposal) - dist(i, proposal)).max(0.0)).collect();
        let sum: f64 = rates.iter().sum();
        let update = 1.0 - (-(beta(0.5) - beta(0.0)) * sum).exp();
        let total: f64 = counts.iter().sum();
        let mut chi = 0.0;
        for i in 0..6 {
            let moved = if sum > 0.0 { update * rates[i] / sum } else { 0.0 };
            let expected = total * (moved + if i == x { 1.0 - update } else { 0.0 });
            if expected < 1e-9 {
                assert_eq!(counts[i], 0.0, "{x} to {i}");
            } else {
                chi += (counts[i] - expected).powi(2) / expected.max(1.0);
            }
        }
        assert!(chi < 20.5, "from {x}: {chi} {counts:?}");
    }
}

/// Tokens of one step from the same logits at every position.
fn proposals(logits: &[f64; 6], sampling: Sampling, n: usize) -> [f64; 6] {
    let tmd = Tmd::<f64>::new(&plane().0, 2, 3.0, 0.9);
    let settings = Settings { seed: 11, steps: 1, sampling, ..Settings::default() };
    let trace = tmd.sample(n, &settings, |z, _| z.iter().flat_map(|_| *logits).collect());
    let mut shares = [0.0; 6];
    trace[0].iter().for_each(|&z| shares[usize::from(z)] += 1.0 / n as f64);
    shares
}

#[test]
fn every_way_of_sampling_does_what_its_name_says() {
    let logits = [0.3, 1.2, 1.2, -0.5, 0.9, -2.0];
    let sample = |temperature, top_k, top_p| Sampling::Sample { temperature, top_k, top_p };
    let exp = |temperature: f64, kept: &[usize]| -> [f64; 6] {
        let e = logits.map(|l| (l / temperature).exp());
        let whole: f64 = kept.iter().map(|&i| e[i]).sum();
        core::array::from_fn(|i| if kept.contains(&i) { e[i] / whole } else { 0.0 })
    };
    let all = [0, 1, 2, 3, 4, 5];
    for (sampling, expected) in [
        (sample(1.0, 0, 1.0), exp(1.0, &all)),
        (sample(0.5, 0, 1.0), exp(0.5, &all)),
        (sample(1.0, 3, 1.0), exp(1.0, &[1, 2, 4])),
        // Both of the largest, though only one was asked for.
        (sample(1.0, 1, 1.0), exp(1.0, &[1, 2])),
        (sample(1.0, 100, 1.0), exp(1.0, &all)),
        (sample(2.0, 0, 0.7), exp(2.0, &[0, 1, 2, 4])),
        (sample(1.0, 0, 1e-6), exp(1.0, &[1, 2])),
        (sample(1.0, 3, 0.8), exp(1.0, &[1, 2, 4])),
        // max(logit / T + g) is distributed as the softmax at temperature T.
        (Sampling::Gumbel { temperature: 1.0 }, exp(1.0, &all)),
        (Sampling::Gumbel { temperature: 0.4 }, exp(0.4, &all)),
        (Sampling::Greedy, [0.0, 1.0, 0.0, 0.0, 0.0, 0.0]),
    ] {
        let shares = proposals(&logits, sampling, 40_000);
        for (share, expected) in shares.iter().zip(expected) {
            let deviation = (expected * (1.0 - expected) / 40_000.0).sqrt();
            assert!((share - expected).abs() <= 4.5 * deviation + 1e-9, "{sampling:?}: {share} {expected}");
        }
    }
}

#[test]
fn fixed_tokens_stay_and_leave_the_draws_of_the_others_alone() {
    let tmd = Tmd::<f64>::new(&plane().0, 2, 3.0, 0.9);
    let logits = |z: &[u16], _: f64| -> Vec<f64> { z.iter().flat_map(|_| [0.1, 0.4, -0.2, 0.0, 0.3, 0.2]).collect() };
    for schedule in [Schedule::Uniform, Schedule::Cosine] {
        let free = Settings { seed: 5, steps: 6, schedule, ..Settings::default() };
        let fixed = Settings { fixed: vec![(2, 5), (7, 0)], ..free.clone() };
        let (a, b) = (tmd.sample(9, &free, logits), tmd.sample(9, &fixed, logits));
        assert_eq!(a, tmd.sample(9, &free, logits), "a replay");
        assert_eq!((a.len(), b.len()), (6, 6));
        for (a, b) in a.iter().zip(&b) {
            assert_eq!((b[2], b[7]), (5, 0));
            assert!((0..9).filter(|i| ![2, 7].contains(i)).all(|i| a[i] == b[i]));
        }
        let times = Tmd::<f64>::times(schedule, 6);
        assert_eq!((times[0], times[6]), (0.0, 1.0));
        assert!(times.windows(2).all(|w| w[0] < w[1]));
    }
}
