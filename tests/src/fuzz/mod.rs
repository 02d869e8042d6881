//! A seeded, structure-aware fuzzer for what comes from outside: blobs, tokens, anchors, settings and streams for the runtime;
//! recordings, anchor, constraint and checkpoint files for the host tools.
//!
//! Every case is made from `(seed, case number)` alone, so a failure is repeated by those two numbers, and the number of
//! threads changes nothing: a run that fails names the first of its cases that does. A case fails when
//! anything panics, or when the runtime returns a number that is not finite, takes another amount of memory than it planned,
//! or leaves a generator behind that no longer gives the right motion.

pub mod blobs;
pub mod files;
pub mod requests;
pub mod streams;

use std::ops::AddAssign;
use std::panic::{self, AssertUnwindSafe};
use std::sync::Mutex;
use std::sync::atomic::{AtomicU64, Ordering};
use std::thread;

use motionette::blob::{Activation, ControlConfig, Corruption, Norm, TransformerConfig};
use motionette::numerics::hash::Stream;
use motionette::{Generator, Model, Request};

use crate::tiny::{PrefixShape, PriorShape, Shape, Tiny};

/// Largest blob of the corpus without anchor control, bytes.
pub const MAX_BLOB: usize = 8 * 1024 + 512;
/// Largest one with it. Its layers alone, each a channel wide, leave no room for the other 263 channels' constants in
/// [`MAX_BLOB`].
pub const MAX_CONTROLLED_BLOB: usize = 10 * 1024 + 512;

/// Small models of different shapes, each under [`MAX_BLOB`] or [`MAX_CONTROLLED_BLOB`] bytes, with a name.
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
    let slim = TransformerConfig { width: 2, heads: 2, hidden: 1, ..block };
    let whole = TransformerConfig { width: 2, heads: 1, hidden: 16, ..block };
    let bank = vec![("<none>", 1), ("wave", 2)];
    let prior =
        PriorShape { text: slim, planner: TransformerConfig { width: 3, heads: 3, ..block }, ..PriorShape::default() };
    let stored = PriorShape { words: vec![], bank, text: post, planner: post, ..prior.clone() };
    let deep = PriorShape { planner: TransformerConfig { layers: 2, ..slim }, ..stored.clone() };
    let scaffold = TransformerConfig { width: 3, heads: 3, ..block };
    let control = ControlConfig { scaffold, frame_width: 1, rank: 1, context: true, families: 7 };
    let controlled = PriorShape { control: Some(control), ..prior.clone() };
    let two = Some(ControlConfig { scaffold: post, frame_width: 2, context: false, families: 5, ..control });
    let unplanned = PriorShape { text: block, planned: false, ..prior.clone() };
    let with = |prior: PriorShape| Shape { width: 1, stages: 1, max_tokens: 6, prior: Some(prior), ..base.clone() };
    let prefix = PrefixShape { masked: true, residual: false, wide: false, vector: 5, planner: post, guidance: 4.0 };
    let given =
        |prefix: PrefixShape| Shape { width: 1, stages: 1, max_tokens: 6, prefix: Some(prefix), ..base.clone() };
    let turns = PrefixShape { masked: false, planner: slim, guidance: 1.0, ..prefix };
    let whole_of_momask = given(PrefixShape { residual: true, wide: true, ..prefix });
    let shapes = [
        ("narrow", base.clone()),
        ("wide-rows", Shape { wide: 4, ..base.clone() }),
        ("all-wide", Shape { width: 1, wide: 263, ..base.clone() }),
        ("residual-quantizers", Shape { quantizers: 3, codes: 3, ..base.clone() }),
        ("published-dilations", Shape { dilations: vec![9, 3, 1], stages: 1, ..base.clone() }),
        ("one-stage", Shape { stages: 1, code_width: 5, ..base.clone() }),
        ("three-stages", Shape { stages: 3, max_tokens: 24, ..base.clone() }),
        ("one-token", Shape { max_tokens: 1, codes: 1, ..base.clone() }),
        ("planner", with(prior.clone())),
        ("planner-of-two-layers", with(deep)),
        ("stored-prompts", with(stored.clone())),
        ("text-without-planner", with(unplanned)),
        ("anchors", with(controlled.clone())),
        ("anchors-of-two-families", with(PriorShape { control: two, ..stored })),
        ("planner-of-four-bits", with(PriorShape { planner: whole, packed: true, ..prior })),
        ("causal", Shape { width: 1, ..base.clone() }.causal()),
        (
            "mostly-causal",
            Shape { width: 1, dilations: vec![9, 1], stages: 1, right: vec![1, 4, 0, 1, 0, 1], ..base.clone() },
        ),
        ("masked", given(prefix)),
        ("masked-and-residual", Shape { quantizers: 3, codes: 3, ..whole_of_momask }),
        ("autoregressive", given(turns)),
        ("autoregressive-of-16-bits", given(PrefixShape { wide: true, ..turns })),
        ("masked-words", with(PriorShape { corruption: Corruption::Masks, one_pass: true, ..controlled })),
    ];
    shapes.into_iter().enumerate().map(|(seed, (name, shape))| (name, Tiny::new(shape, seed as u64))).collect()
}

/// A model of the corpus, opened once for all cases.
pub struct Entry<'a> {
    name: &'a str,
    /// The model; its bytes are what mutations begin with.
    pub model: Model<'a>,
    /// A least request: one position of tokens 0.
    pub plain: Vec<u16>,
    /// Hash of its motion, made in an arena that nobody has used.
    pub hash: u64,
}

impl<'a> Entry<'a> {
    /// Opens a model.
    ///
    /// # Errors
    /// Words of a refusal.
    pub fn new(name: &'a str, tiny: &'a Tiny) -> Result<Self, String> {
        let model = Model::open(tiny.bytes()).map_err(|e| e.to_string())?;
        let plain = vec![0; model.codebooks().quantizers()];
        let mut arena = vec![0u8; 1 << 18];
        let mut generator = Generator::new(model.clone(), &mut arena).map_err(|e| e.to_string())?;
        let motion = generator.generate(&Request::tokens(&plain), &mut ()).map_err(|e| e.to_string())?;
        let hash = motion.hash();
        Ok(Entry { name, model, plain, hash })
    }
}

/// Buffers of a thread, for one case after another.
#[derive(Default)]
pub struct Memory {
    /// A blob's.
    pub blob: Buffer,
    /// A generator's.
    pub arena: Buffer,
}

/// Aligned bytes.
#[derive(Default)]
pub struct Buffer {
    words: Vec<u128>,
}

impl Buffer {
    /// `length` bytes, all painted alike: what a case does cannot depend on the case before it.
    pub fn painted(&mut self, length: usize) -> &mut [u8] {
        let count = length.div_ceil(size_of::<u128>());
        if self.words.len() < count {
            self.words.resize(count, 0);
        }
        let bytes = &mut bytemuck::cast_slice_mut(&mut self.words)[..length];
        bytes.fill(0xA5);
        bytes
    }
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
    /// Motions with tracks or obstacles.
    pub led: u64,
    /// Motions with a timeline.
    pub parted: u64,
    /// Streams whose motion was compared with the whole.
    pub streams: u64,
    /// Files that were refused.
    pub files_refused: u64,
    /// Files that were read.
    pub files_read: u64,
}

impl AddAssign for Tally {
    fn add_assign(&mut self, other: Tally) {
        self.cases += other.cases;
        self.blobs_refused += other.blobs_refused;
        self.blobs_opened += other.blobs_opened;
        self.requests_refused += other.requests_refused;
        self.motions += other.motions;
        self.conditioned += other.conditioned;
        self.led += other.led;
        self.parted += other.parted;
        self.streams += other.streams;
        self.files_refused += other.files_refused;
        self.files_read += other.files_read;
    }
}

/// One failed case.
#[derive(Debug, PartialEq, Eq)]
pub struct Failure {
    /// Number of the case.
    pub case: u64,
    /// What went wrong.
    pub what: String,
}

/// Runs cases `first..first + cases` of `seed` on so many threads. `progress` is told now and then how many are done.
///
/// # Errors
/// The [`Failure`] of the smallest number.
pub fn run(seed: u64, first: u64, cases: u64, threads: usize, progress: impl Fn(u64) + Sync) -> Result<Tally, Failure> {
    let corpus = corpus();
    let entries: Result<Vec<Entry<'_>>, String> =
        corpus.iter().map(|(name, tiny)| Entry::new(name, tiny).map_err(|what| format!("{name}: {what}"))).collect();
    let entries = entries.map_err(|what| Failure { case: first, what })?;
    let start = || (Tally::default(), Memory::default());
    let one = |(tally, memory): &mut (Tally, Memory), case| one(&entries, seed, case, memory, tally);
    let mut total = Tally::default();
    for (tally, _) in drive(first, cases, threads, progress, start, one)? {
        total += tally;
    }
    Ok(total)
}

/// Cases that a thread takes at once.
const CHUNK: u64 = 64;

/// Calls `one` for each case until one fails; a panic is a failure of its case. Each thread has a state of its own, which
/// comes back.
///
/// # Errors
/// The [`Failure`] of the smallest number: cases before it all run.
pub fn drive<S: Send>(
    first: u64,
    cases: u64,
    threads: usize,
    progress: impl Fn(u64) + Sync,
    start: impl Fn() -> S + Sync,
    one: impl Fn(&mut S, u64) -> Result<(), String> + Sync,
) -> Result<Vec<S>, Failure> {
    // The panic is reported with its case; the default hook would print it a second time, without.
    let hook = panic::take_hook();
    panic::set_hook(Box::new(|_| {}));
    let (next, done) = (AtomicU64::new(0), AtomicU64::new(0));
    // No case from here on needs to run.
    let end = AtomicU64::new(cases);
    let failure: Mutex<Option<Failure>> = Mutex::new(None);
    let work = || {
        let mut state = start();
        loop {
            let chunk = next.fetch_add(CHUNK, Ordering::Relaxed);
            let cases = chunk..chunk.saturating_add(CHUNK).min(end.load(Ordering::Relaxed));
            if cases.is_empty() {
                return state;
            }
            let count = cases.end - cases.start;
            for at in cases {
                let case = first.wrapping_add(at);
                if let Err(what) = caught(|| one(&mut state, case)) {
                    let mut failure = failure.lock().unwrap_or_else(|e| e.into_inner());
                    if at < end.load(Ordering::Relaxed) {
                        end.store(at, Ordering::Relaxed);
                        *failure = Some(Failure { case, what });
                    }
                    break;
                }
            }
            progress(done.fetch_add(count, Ordering::Relaxed) + count);
        }
    };
    let states = thread::scope(|scope| {
        let threads: Vec<_> = (0..threads.max(1)).map(|_| scope.spawn(work)).collect();
        threads.into_iter().filter_map(|thread| thread.join().ok()).collect()
    });
    panic::set_hook(hook);
    failure.into_inner().unwrap_or_else(|e| e.into_inner()).map_or(Ok(states), Err)
}

fn caught(one: impl FnOnce() -> Result<(), String>) -> Result<(), String> {
    panic::catch_unwind(AssertUnwindSafe(one)).unwrap_or_else(|payload| {
        let text = payload.downcast_ref::<String>().map(String::as_str);
        let text = text.or_else(|| payload.downcast_ref::<&str>().copied()).unwrap_or("no message");
        Err(format!("panicked: {text}"))
    })
}

/// Runs one case.
fn one(entries: &[Entry<'_>], seed: u64, case: u64, memory: &mut Memory, tally: &mut Tally) -> Result<(), String> {
    tally.cases += 1;
    let mut random = Stream::new(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15).wrapping_add(case));
    let entry = &entries[random.below(entries.len() as u32) as usize];
    let (what, result) = match random.below(6) {
        0 | 1 => ("mutation of", blobs::case(entry, &mut random, memory, tally)),
        2 | 3 => ("request on", requests::case(entry, &mut random, memory, tally)),
        4 => ("stream on", streams::case(entry, &mut random, memory, tally)),
        _ => return files::case(&mut random, tally),
    };
    result.map_err(|error| format!("{what} the blob `{}`: {error}", entry.name))
}
