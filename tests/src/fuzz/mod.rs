//! A seeded, structure-aware fuzzer for what comes from outside: blobs, tokens, anchors, settings and streams for the runtime;
//! recordings, anchor, constraint and checkpoint files for the host tools.
//!
//! Every case is made from `(seed, case number)` alone, so a failure is repeated by those two numbers. A case fails when
//! anything panics, or when the runtime returns a number that is not finite, takes another amount of memory than it planned,
//! or leaves a generator behind that no longer gives the right motion.

pub mod blobs;
pub mod files;
pub mod requests;
pub mod streams;

use std::panic::{self, AssertUnwindSafe};

use motionette::blob::{Activation, ControlConfig, Norm, TransformerConfig};
use motionette::hash::Stream;

use crate::tiny::{PriorShape, Shape, Tiny};

/// Largest blob of the corpus, bytes.
pub const MAX_BLOB: usize = 16 * 1024;

/// Small models of different shapes, each under [`MAX_BLOB`] bytes, with a name.
#[must_use]
pub fn corpus() -> Vec<(&'static str, Tiny)> {
    let base = Shape { width: 2, code_width: 2, codes: 5, dilations: vec![1], wide: 0, ..Shape::default() };
    let block = TransformerConfig {
        width: 4,
        heads: 2,
        layers: 1,
        hidden: 3,
        norm: Norm::Pre,
        activation: Activation::Gelu,
        epsilon: 1e-5,
    };
    let post = TransformerConfig { width: 2, heads: 1, norm: Norm::Post, activation: Activation::Relu, ..block };
    let prior = PriorShape {
        text: block,
        planner: TransformerConfig { width: 6, heads: 3, layers: 2, ..block },
        ..PriorShape::default()
    };
    let bank = vec![("<none>", 1), ("wave", 2)];
    let stored = PriorShape { words: vec![], bank, text: post, planner: post, ..prior.clone() };
    let scaffold = TransformerConfig { width: 3, heads: 3, ..block };
    let control = ControlConfig { scaffold, frame_width: 2, rank: 1, context: true, families: 7 };
    let controlled = PriorShape { control: Some(control), ..prior.clone() };
    let two = Some(ControlConfig { scaffold: post, context: false, families: 5, ..control });
    let unplanned = PriorShape { planned: false, ..prior.clone() };
    let with = |prior: PriorShape| Shape { max_tokens: 6, prior: Some(prior), ..base.clone() };
    let shapes = [
        ("narrow", base.clone()),
        ("wide-rows", Shape { wide: 4, ..base.clone() }),
        ("all-wide", Shape { width: 1, wide: 263, ..base.clone() }),
        ("residual-quantizers", Shape { quantizers: 3, codes: 3, ..base.clone() }),
        ("published-dilations", Shape { dilations: vec![9, 3, 1], stages: 1, ..base.clone() }),
        ("one-stage", Shape { stages: 1, code_width: 5, ..base.clone() }),
        ("three-stages", Shape { stages: 3, max_tokens: 24, ..base.clone() }),
        ("one-token", Shape { max_tokens: 1, codes: 1, ..base.clone() }),
        ("planner", with(prior)),
        ("stored-prompts", with(stored.clone())),
        ("text-without-planner", with(unplanned)),
        ("anchors", with(controlled)),
        ("anchors-of-two-families", with(PriorShape { control: two, ..stored })),
    ];
    shapes.into_iter().enumerate().map(|(seed, (name, shape))| (name, Tiny::new(shape, seed as u64))).collect()
}

/// What a run of the fuzzer saw.
#[derive(Debug, Default, Clone, Copy, PartialEq, Eq)]
pub struct Tally {
    /// Cases.
    pub cases: u64,
    /// Mutated blobs that were refused.
    pub blobs_refused: u64,
    /// Mutated blobs that opened.
    pub blobs_opened: u64,
    /// Requests that were refused.
    pub requests_refused: u64,
    /// Requests that gave a motion.
    pub motions: u64,
    /// Of these, motions whose planner saw anchors.
    pub conditioned: u64,
    /// Streams whose motion was compared with the whole.
    pub streams: u64,
    /// Files that were refused.
    pub files_refused: u64,
    /// Files that were read.
    pub files_read: u64,
}

/// One failed case.
#[derive(Debug)]
pub struct Failure {
    /// Number of the case.
    pub case: u64,
    /// What went wrong.
    pub what: String,
}

/// Runs cases `first..first + cases` of `seed`, until the first failure.
///
/// # Errors
/// [`Failure`].
pub fn run(seed: u64, first: u64, cases: u64, progress: impl FnMut(u64)) -> Result<Tally, Failure> {
    let corpus = corpus();
    let mut tally = Tally::default();
    drive(first, cases, progress, |case| one(&corpus, seed, case, &mut tally))?;
    tally.cases = cases;
    Ok(tally)
}

/// Calls `one` for each case until one fails; a panic is a failure of its case.
///
/// # Errors
/// [`Failure`].
pub fn drive(
    first: u64,
    cases: u64,
    mut progress: impl FnMut(u64),
    mut one: impl FnMut(u64) -> Result<(), String>,
) -> Result<(), Failure> {
    // The panic is reported with its case; the default hook would print it a second time, without.
    let hook = panic::take_hook();
    panic::set_hook(Box::new(|_| {}));
    let outcome = (first..first.saturating_add(cases)).try_for_each(|case| {
        progress(case - first);
        let result = panic::catch_unwind(AssertUnwindSafe(|| one(case))).unwrap_or_else(|payload| {
            let text = payload.downcast_ref::<String>().map(String::as_str);
            let text = text.or_else(|| payload.downcast_ref::<&str>().copied()).unwrap_or("no message");
            Err(format!("panicked: {text}"))
        });
        result.map_err(|what| Failure { case, what })
    });
    panic::set_hook(hook);
    outcome
}

/// Runs one case.
fn one(corpus: &[(&str, Tiny)], seed: u64, case: u64, tally: &mut Tally) -> Result<(), String> {
    let mut random = Stream::new(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(case));
    let (name, tiny) = &corpus[random.below(corpus.len() as u32) as usize];
    match random.below(6) {
        0 | 1 => blobs::case(tiny, &mut random, tally).map_err(|what| format!("mutation of the blob `{name}`: {what}")),
        2 | 3 => {
            requests::case(tiny, &mut random, tally).map_err(|what| format!("request on the blob `{name}`: {what}"))
        }
        4 => streams::case(tiny, &mut random, tally).map_err(|what| format!("stream on the blob `{name}`: {what}")),
        _ => files::case(&mut random, tally),
    }
}
