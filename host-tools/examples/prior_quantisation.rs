//! What rounding the prior's weights costs, in reference arithmetic: agreement of the most probable tokens with the f32 prior.
//!
//! `cargo run --release -p motionette-host --example prior_quantisation -- TOKENIZER PRIOR DATASET`

use std::path::Path;

use anyhow::{Result, bail};
use motionette_host::checkpoint::{self, PriorCheckpoint, prior};
use motionette_host::convert::prior::{Inputs, dequantised, inputs, quantise};
use motionette_host::convert::{FourBits, Options, Rounding, calibration};
use motionette_host::dataset::captioned::{self, CaptionedMotion};
use motionette_host::dataset::{Dataset, Split};
use motionette_host::reference::Prior;
use motionette_host::reference::tmd::Settings;
use motionette_host::verify::planner;

/// Clips compared.
const CLIPS: usize = 60;

fn report(name: &str, cases: &[CaptionedMotion], exact: &Prior<f32>, other: &Prior<f32>) -> Result<()> {
    let logits = |case: &CaptionedMotion, z: &[u16], time: f64| -> Result<Vec<f32>> {
        Ok(other.logits(&other.guided(&case.words, 1.0), z, time, &[]))
    };
    let a = planner::agreement(cases, exact, logits, || ())?;
    let times: Vec<String> = a.times.iter().map(|t| format!("{:.2} % {:.5}", 100.0 * t.top1, t.divergence)).collect();
    println!("| {name} | {:.2} % | {} |", 100.0 * a.top1, times.join(" | "));
    Ok(())
}

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [tokenizer, weights, dataset] = &arguments[..] else { bail!("give a tokenizer, a prior and a dataset") };
    let tokenizer = checkpoint::load(Path::new(tokenizer))?;
    let weights = prior::load(Path::new(weights))?;
    let exact = Prior::<f32>::new(&weights, &tokenizer);
    let dataset = Dataset::load(dataset)?;
    let cases = captioned::choose(&tokenizer, &exact, &dataset, Split::Test, CLIPS, false)?;
    let prior = |weights: &PriorCheckpoint| Prior::<f32>::new(weights, &tokenizer);
    let rounded = dequantised(&weights, &quantise(&weights, None, &Options::PLAIN, &Inputs::new()));
    report("int8, to nearest", &cases, &exact, &prior(&rounded))?;
    let train = captioned::choose(&tokenizer, &exact, &dataset, Split::Train, calibration::CASES, false)?;
    let seen = inputs(&weights, &tokenizer, &train);
    for (name, rounding, bias_correction) in [
        ("planner 4-bit, to nearest", Rounding::Nearest, false),
        ("planner 4-bit, scales of least cost", Rounding::Clipped, false),
        ("planner 4-bit, error feedback", Rounding::Feedback, false),
        ("planner 4-bit, error feedback + bias correction", Rounding::Feedback, true),
    ] {
        let options =
            Options { rounding, bias_correction, ..Options { four_bits: FourBits::ALL, ..Options::default() } };
        let rounded = dequantised(&weights, &quantise(&weights, None, &options, &seen));
        report(name, &cases, &exact, &prior(&rounded))?;
    }
    // Each kind of tensor rounded alone.
    for kind in [
        "text.",
        "embedding",
        "position",
        "attention.qkv",
        "attention.out",
        "cross.",
        "ffn.in",
        "ffn.out",
        "planner.token",
    ] {
        let mut alone = weights.clone();
        let mut source = rounded.clone();
        for (to, from) in alone.parts_mut().into_iter().zip(source.parts_mut()) {
            match (to, from) {
                (prior::PartMut::Linear(to), prior::PartMut::Linear(from)) if to.name.contains(kind) => {
                    to.clone_from(from)
                }
                (prior::PartMut::Embedding(to), prior::PartMut::Embedding(from)) if to.name.contains(kind) => {
                    to.clone_from(from);
                }
                _ => {}
            }
        }
        report(kind, &cases, &exact, &prior(&alone))?;
    }
    let start = std::time::Instant::now();
    let other = prior(&rounded);
    for (guidance, steps) in [(1.0, 10), (2.0, 10)] {
        let settings = Settings { steps, ..Settings::default() };
        let tokens = |case: &CaptionedMotion, settings: &Settings| -> Result<Vec<u16>> {
            Ok(other.generate(&case.words, guidance, case.tokens.len(), settings))
        };
        let share = planner::free_running(&cases, &exact, guidance, &settings, tokens, || ())?;
        println!(
            "free running, guidance {guidance}: {:.1} % of tokens equal, {:.1} s",
            100.0 * share,
            start.elapsed().as_secs_f64()
        );
    }
    Ok(())
}
