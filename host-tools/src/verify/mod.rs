//! Does the quantised runtime do what the f32 reference does? (`motionette verify`, DESIGN section 6.)
//!
//! Both decode the same embeddings `u`: those that the runtime made from the tokens of real clips. So the comparison measures the decoder
//! and no solver. Where the two solvers end for the same anchors is reported separately ([`solvers`]). [`layers`] says which layer the
//! error comes from.

pub mod layers;
pub mod planner;
pub mod solvers;

use std::collections::HashSet;

use motionette::blob::{Corruption, TextTable, TransformerConfig};
use motionette::{Bones, Generator, Request, Understood};
use serde::Serialize;

use crate::agreement::Agreement;
use crate::blob::{self, BlobFile};
use crate::checkpoint::prior::Sizes;
use crate::checkpoint::words::hash;
use crate::checkpoint::{ControlCheckpoint, PriorCheckpoint, TokenizerCheckpoint};
use crate::dataset::{Dataset, Split, captioned};
use crate::motion::Pose;
use crate::reference::bridge::runtime_token;
use crate::reference::decode_path::DecodePathError;
use crate::reference::tokenizer::EncodeError;
use crate::reference::{DecodePath, Tokenizer};

/// Mean root-aligned joint error allowed, millimetres.
pub const MEAN_BUDGET_MM: f64 = 1.0;
/// 99th percentile of it allowed.
pub const P99_BUDGET_MM: f64 = 8.0;
/// Mean root drift at the end of 5 s allowed.
pub const DRIFT_MEAN_BUDGET_MM: f64 = 10.0;
/// 95th percentile of it allowed.
pub const DRIFT_P95_BUDGET_MM: f64 = 30.0;

/// Verification could not be carried out. (A missed budget is no error but a result.)
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The blob.
    #[error(transparent)]
    Blob(#[from] blob::Error),
    /// The checkpoint lacks what a motion needs.
    #[error(transparent)]
    DecodePath(#[from] DecodePathError),
    /// Blob and checkpoint are not of one model.
    #[error(
        "blob and checkpoint are different models: {what} is {blob} in the blob and {checkpoint} in the checkpoint"
    )]
    Mismatch {
        /// Which size differs.
        what: &'static str,
        /// Its value in the blob.
        blob: usize,
        /// Its value in the checkpoint.
        checkpoint: usize,
    },
    /// The blob has no text or no planner.
    #[error("the blob has no planner; convert it with --prior")]
    NoPlanner,
    /// The blob has no anchor control.
    #[error("the blob has no anchor control; convert it with --control")]
    NoControl,
    /// The runtime refused a caption.
    #[error("the caption of clip {clip}: {source}")]
    Prompt {
        /// The clip's name.
        clip: String,
        /// Why.
        source: motionette::request::prompt::PromptError,
    },
    /// The runtime refused anchors of a clip.
    #[error("the anchors of clip {clip}: {source}")]
    Anchors {
        /// The clip's name.
        clip: String,
        /// Why.
        source: motionette::request::conditions::AnchorError,
    },
    /// The planner took more memory than it said.
    #[error("the runtime's planner says: {0}")]
    Arena(motionette::memory::ArenaTooSmall),
    /// No captioned clip to compare planners with.
    #[error(transparent)]
    Captioned(#[from] captioned::Error),
    /// A clip could not be encoded.
    #[error("clip {clip}: {source}")]
    Encode {
        /// Its name.
        clip: String,
        /// Why.
        source: EncodeError,
    },
    /// No clip to verify with.
    #[error("the dataset has no {split:?} clip of at least {least} frames; choose another split or dataset")]
    NoClips {
        /// The split asked for.
        split: Split,
        /// Shortest useful clip.
        least: usize,
    },
    /// The runtime refused a request.
    #[error("clip {clip}: the runtime says: {source}")]
    Runtime {
        /// Its name.
        clip: String,
        /// Why.
        source: motionette::Error,
    },
}

/// A token sequence to decode.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Sequence {
    /// Name of the clip.
    pub id: String,
    /// `[L][Q]`
    pub tokens: Vec<u16>,
}

/// One figure against its budget.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Budget {
    /// What is measured.
    pub name: &'static str,
    /// The figure, millimetres.
    pub value_mm: f64,
    /// What is allowed.
    pub limit_mm: f64,
    /// Whether it is kept.
    pub met: bool,
}

/// The result of a verification.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Verification {
    /// Runtime against reference on the same `u`.
    pub agreement: Agreement,
    /// The figures against their budgets.
    pub budgets: Vec<Budget>,
    /// Where the error comes from.
    pub layers: layers::Report,
    /// What two solvers make of the same anchors; `None` when not asked for.
    pub solvers: Option<solvers::Report>,
    /// Planner against planner ([`planner::verify`]); `None` without a prior.
    pub planner: Option<planner::Report>,
    /// The same on anchors that the planner sees; `None` without a control.
    pub control: Option<planner::Report>,
}

impl Verification {
    /// Whether every budget is kept.
    #[must_use]
    pub fn passed(&self) -> bool {
        self.budgets.iter().all(|b| b.met) && self.planner.iter().chain(&self.control).all(|p| p.met)
    }
}

/// Tokens of at most `count` clips of `split`, spread evenly over it.
///
/// # Errors
/// [`Error::NoClips`], [`Error::Encode`].
pub fn sequences(
    checkpoint: &TokenizerCheckpoint,
    dataset: &Dataset,
    split: Split,
    count: usize,
    max_tokens: usize,
) -> Result<Vec<Sequence>, Error> {
    let least = 2 * checkpoint.config.frames_per_token();
    let clips: Vec<_> = dataset.split(split).filter(|c| c.frames() >= least).collect();
    if clips.is_empty() || count == 0 {
        return Err(Error::NoClips { split, least });
    }
    let wanted = count.min(clips.len());
    let chosen: Vec<_> = (0..wanted).map(|i| clips[i * clips.len() / wanted]).collect();
    let tokenizer = Tokenizer::<f32>::new(checkpoint);
    let encode = |clip: &crate::dataset::ClipView<'_>| {
        let frames = clip.frames().min(max_tokens * checkpoint.config.frames_per_token());
        let id = clip.info.id.clone();
        match tokenizer.encode(&clip.features[..frames * checkpoint.config.features]) {
            Ok(ids) => Ok(Sequence { id, tokens: ids.iter().map(|&i| runtime_token(i)).collect() }),
            Err(source) => Err(Error::Encode { clip: id, source }),
        }
    };
    crate::parallel::map(&chosen, encode).into_iter().collect()
}

/// Refuses a blob and a checkpoint of different sizes.
///
/// # Errors
/// [`Error::Mismatch`].
pub fn check_same_model(blob: &BlobFile, checkpoint: &TokenizerCheckpoint) -> Result<(), Error> {
    let manifest = blob.parts()?.manifest;
    let (d, c) = (manifest.codec.decoder(), &checkpoint.config);
    let sizes = [
        ("width", usize::from(d.width), c.width),
        ("code width", usize::from(d.code_width), c.code_dim),
        ("number of codes", usize::from(d.codes), c.codes),
        ("number of quantizers", usize::from(d.quantizers), c.quantizers),
        ("number of stages", usize::from(d.stages), c.down_t),
        ("number of residual blocks", d.dilations.len(), c.depth),
        ("number of features", usize::from(d.features), c.features),
    ];
    let right = d.padding.iter().map(|padding| usize::from(padding.right)).zip(c.right());
    let right = right.map(|(blob, checkpoint)| ("look-ahead of a convolution", blob, checkpoint));
    match sizes.into_iter().chain(right).find(|(_, blob, checkpoint)| blob != checkpoint) {
        Some((what, blob, checkpoint)) => Err(Error::Mismatch { what, blob, checkpoint }),
        None => Ok(()),
    }
}

/// Refuses a blob and a prior of different sizes.
///
/// # Errors
/// [`Error::NoPlanner`], [`Error::Mismatch`].
pub fn check_same_prior(blob: &BlobFile, prior: &PriorCheckpoint) -> Result<(), Error> {
    let manifest = blob.parts()?.manifest;
    let (Some(text), Some(planner)) = (manifest.text, manifest.generator.planner()) else {
        return Err(Error::NoPlanner);
    };
    let c = &prior.config;
    let mut pairs = vec![
        ("width of the text encoder", usize::from(text.width), c.text.width),
        ("longest prompt", usize::from(text.max_words), c.max_words),
        ("longest motion", usize::from(manifest.generator.max_tokens()), c.max_tokens),
        ("number of codes", usize::from(manifest.codec.decoder().codes), c.codes),
        (
            "whether tokens are masked",
            usize::from(planner.corruption == Corruption::Masks),
            usize::from(!c.corruption.is_near()),
        ),
    ];
    pairs.extend(text.encoder.words().into_iter().flat_map(|encoder| transformer(&encoder.transformer, c.text)));
    pairs.extend(transformer(&planner.transformer, c.planner));
    match text.encoder.words().map(|encoder| encoder.table) {
        None => {}
        Some(TextTable::Words(words)) => {
            let same = words.lines().zip(&c.vocabulary).take_while(|(a, b)| a == b).count();
            pairs.push(("number of words", words.lines().count(), c.vocabulary.len()));
            pairs.push(("number of words in the same order", same, c.vocabulary.len()));
        }
        Some(TextTable::Vectors { words, dims }) => {
            let known: HashSet<u32> = c.vocabulary.iter().map(|word| hash(word)).collect();
            let same = blob.word_hashes()?.iter().filter(|hash| known.contains(hash)).count();
            pairs.push(("numbers of a word's vector", usize::from(dims), c.word_vectors));
            pairs.push(("number of words that the other has", usize::from(words), same));
        }
    }
    match pairs.into_iter().find(|(_, blob, checkpoint)| blob != checkpoint) {
        Some((what, blob, checkpoint)) => Err(Error::Mismatch { what, blob, checkpoint }),
        None => Ok(()),
    }
}

/// The prior as `blob` holds it: of words with vectors those that the blob has.
///
/// # Errors
/// As [`check_same_prior`].
pub fn same_words(blob: &BlobFile, prior: PriorCheckpoint) -> Result<PriorCheckpoint, Error> {
    check_same_prior(blob, &prior)?;
    let kept: HashSet<u32> = blob.word_hashes()?.into_iter().collect();
    Ok(prior.with_words(|_, word| kept.contains(&hash(word))))
}

/// Refuses a blob and a control of different sizes.
///
/// # Errors
/// [`Error::NoControl`], [`Error::Mismatch`].
pub fn check_same_control(blob: &BlobFile, control: &ControlCheckpoint) -> Result<(), Error> {
    let manifest = blob.parts()?.manifest;
    let Some(found) = manifest.generator.control() else { return Err(Error::NoControl) };
    let c = &control.config;
    let families = c.families.iter().fold(0, |bits, family| bits | family.bit());
    let pairs = [
        ("longest motion", usize::from(manifest.generator.max_tokens()), c.max_tokens),
        ("width of a frame of the scaffold", usize::from(found.frame_width), c.frame_width),
        ("rank of the anchors' keys and values", usize::from(found.rank), c.rank),
        ("whether there is a dual context", usize::from(found.context), usize::from(c.context)),
        ("set of families", usize::from(found.families), usize::from(families)),
    ];
    match pairs
        .into_iter()
        .chain(transformer(&found.scaffold, c.scaffold))
        .find(|(_, blob, checkpoint)| blob != checkpoint)
    {
        Some((what, blob, checkpoint)) => Err(Error::Mismatch { what, blob, checkpoint }),
        None => Ok(()),
    }
}

/// Sizes of a transformer in blob and checkpoint, by name.
fn transformer(t: &TransformerConfig, s: Sizes) -> [(&'static str, usize, usize); 4] {
    [
        ("width", usize::from(t.width), s.width),
        ("number of heads", usize::from(t.heads), s.heads),
        ("number of layers", usize::from(t.layers), s.layers),
        ("hidden width", usize::from(t.hidden), s.hidden),
    ]
}

/// Whether the blob's card names this checkpoint file (its SHA-256) among those it came from.
///
/// # Errors
/// [`Error::Blob`]; not after the blob was opened.
pub fn names_checkpoint(blob: &BlobFile, hash: &str) -> Result<bool, Error> {
    Ok(blob.parts()?.manifest.card.checkpoint.split('+').any(|h| h == hash))
}

/// A motion of the runtime, copied out of its arena.
#[derive(Debug, Clone)]
pub struct RuntimeMotion {
    /// Embeddings `[L][du]` it was decoded from.
    pub u: Vec<f32>,
    /// Tokens `[L][Q]` it was decoded from; empty for embeddings.
    pub tokens: Vec<u16>,
    /// Joints, metres.
    pub joints: Vec<Pose>,
    /// What the refinement did.
    pub refinement: Option<motionette::refining::Report>,
    /// Words of the prompt that the model does not know.
    pub unknown_words: u16,
    /// What the prompt was understood as.
    pub understood: Option<Understood>,
}

/// Runs one request in an arena of exactly the planned size.
///
/// # Errors
/// [`Error::Blob`], [`Error::Runtime`].
pub fn run(blob: &BlobFile, clip: &str, request: &Request<'_>) -> Result<RuntimeMotion, Error> {
    let failed = |source| Error::Runtime { clip: clip.to_owned(), source };
    let plan = Generator::new(blob.model()?, &mut []).and_then(|g| g.plan(request)).map_err(failed)?;
    let mut arena = vec![0_u128; plan.arena_bytes.div_ceil(16)];
    let mut generator = Generator::new(blob.model()?, bytemuck::cast_slice_mut(&mut arena)).map_err(failed)?;
    let motion = generator.generate(request, &mut ()).map_err(failed)?;
    Ok(RuntimeMotion {
        u: motion.u().to_vec(),
        tokens: motion.tokens().to_vec(),
        joints: motion.frames().to_vec(),
        refinement: motion.refinement,
        unknown_words: motion.unknown_words(),
        understood: motion.understood(),
    })
}

/// Verifies `blob` against `checkpoint` over `sequences`; `solver_clips` of them also compare the solvers. `progress` is called once a clip.
///
/// # Errors
/// [`Error`].
pub fn verify(
    blob: &BlobFile,
    checkpoint: &TokenizerCheckpoint,
    sequences: &[Sequence],
    solver_clips: usize,
    progress: impl Fn() + Sync,
) -> Result<Verification, Error> {
    check_same_model(blob, checkpoint)?;
    let decode_path = DecodePath::<f32>::new(checkpoint)?;
    let compared = crate::parallel::map(sequences, |s| -> Result<_, Error> {
        let motion = run(blob, &s.id, &Request::tokens(&s.tokens).bones(Bones::Decoded).unrefined())?;
        let reference = decode_path.forward(&motion.u).joints;
        progress();
        Ok((motion, reference))
    });
    let mut agreement = Agreement::default();
    let mut latents = Vec::new();
    for (sequence, result) in sequences.iter().zip(compared) {
        let (motion, reference) = result?;
        agreement.add(&sequence.id, &motion.joints, &reference);
        latents.push((motion.u, motion.joints));
    }
    agreement.finish();
    let layers = layers::measure(blob, checkpoint, &latents)?;
    let solvers =
        if solver_clips > 0 { Some(solvers::compare(blob, &decode_path, sequences, solver_clips)?) } else { None };
    let budgets = budgets(&agreement);
    Ok(Verification { agreement, budgets, layers, solvers, planner: None, control: None })
}

fn budgets(a: &Agreement) -> Vec<Budget> {
    [
        ("root-aligned joint error, mean", a.mean_mm, MEAN_BUDGET_MM),
        ("root-aligned joint error, 99th percentile", a.p99_mm, P99_BUDGET_MM),
        ("root drift at the end of 5 s, mean", a.drift_mean_mm, DRIFT_MEAN_BUDGET_MM),
        ("root drift at the end of 5 s, 95th percentile", a.drift_p95_mm, DRIFT_P95_BUDGET_MM),
    ]
    .into_iter()
    .map(|(name, value_mm, limit_mm)| Budget { name, value_mm, limit_mm, met: value_mm <= limit_mm })
    .collect()
}
