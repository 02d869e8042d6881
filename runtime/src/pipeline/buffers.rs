//! The buffers of a request, declared once: a plan measures them, a run takes them.

use crate::codec::vq::decoder::Workspace;
use crate::memory::{Arena, ArenaTooSmall};
use crate::model::Model;
use crate::pipeline::plan::Limits;
use crate::refining;
#[cfg(feature = "tracks")]
use crate::refining::motion_space::dense::DenseScratch;
use crate::refining::motion_space::{Exact, Scratch};
use crate::representation::humanml3d::{POSITION_CHANNELS, Path, ROOT_CHANNELS};

/// Feature channels that the solver may have to decode for so many anchors.
const fn solver_channels(anchors: usize) -> usize {
    ROOT_CHANNELS + 3 * refining::most_joints(anchors)
}

/// Numbers of a frame in the buffer for features and their gradient.
const fn feature_columns(limits: &Limits) -> usize {
    let solver = if limits.bends() { 2 * solver_channels(limits.anchors) } else { 0 };
    if solver > POSITION_CHANNELS { solver } else { POSITION_CHANNELS }
}

/// Tokens `[L][Q]` of the longest motion inside `limits`; they lie below everything.
pub(crate) fn tokens<'a>(
    model: &Model<'_>,
    limits: &Limits,
    arena: &mut Arena<'a>,
) -> Result<&'a mut [u16], ArenaTooSmall> {
    arena.take(limits.tokens * model.codebooks().quantizers())
}

/// DecodingBytes of [`Decoding`] by purpose.
#[derive(Debug, Clone, Copy, Default)]
pub(crate) struct DecodingBytes {
    pub embeddings: usize,
    pub features: usize,
    pub path: usize,
    pub gates: usize,
    pub decoder: usize,
}

/// What embeddings become joints in, while they are refined and when they are decoded at last.
#[derive(Debug)]
pub(crate) struct Decoding<'a> {
    /// Embeddings `[L][du]`.
    pub u: &'a mut [f32],
    /// Features, and their gradient while the motion is refined.
    pub features: &'a mut [f32],
    pub path: Path<'a>,
    pub work: Workspace<'a>,
    pub bytes: DecodingBytes,
}

impl<'a> Decoding<'a> {
    /// Takes them for motions inside `limits`.
    pub fn take(model: &Model<'_>, limits: &Limits, arena: &mut Arena<'a>) -> Result<Self, ArenaTooSmall> {
        let decoder = model.decoder();
        let frames = limits.tokens * model.frames_per_token();
        let begin = arena.used();
        let u = arena.take(limits.tokens * decoder.code_width())?;
        let embeddings = arena.used() - begin;
        let features = arena.take(frames * feature_columns(limits))?;
        let of_features = arena.used() - begin - embeddings;
        let path = Path::take(arena, frames, true)?;
        let of_path = arena.used() - begin - embeddings - of_features;
        let work = decoder.workspace(arena, limits.tokens, POSITION_CHANNELS, limits.rows)?;
        let gates = decoder.gate_bytes(limits.tokens);
        let of_decoder = arena.used() - begin - embeddings - of_features - of_path - gates;
        let bytes = DecodingBytes { embeddings, features: of_features, path: of_path, gates, decoder: of_decoder };
        Ok(Decoding { u, features, path, work, bytes })
    }
}

/// What an edit in motion space works in.
#[derive(Debug)]
pub(crate) enum EditScratch<'a> {
    /// Onto anchors alone.
    Sparse(Scratch<'a>),
    /// Onto rows at any number of frames.
    #[cfg(feature = "tracks")]
    Dense(DenseScratch<'a>),
}

/// What the edit in motion space works in, in the solver's place; nothing where there is nothing to edit.
pub(crate) fn edit<'a>(
    model: &Model<'_>,
    limits: &Limits,
    arena: &mut Arena<'a>,
) -> Result<Option<(Exact, EditScratch<'a>)>, ArenaTooSmall> {
    let Some(exact) = limits.edits() else { return Ok(None) };
    let frames = limits.tokens * model.frames_per_token();
    #[cfg(feature = "tracks")]
    if limits.tracked > 0 {
        return Ok(Some((exact, EditScratch::Dense(DenseScratch::take(frames, limits.tracked, arena)?))));
    }
    Ok(Some((exact, EditScratch::Sparse(Scratch::take(frames, limits.anchors, arena)?))))
}

/// What the solver works in, behind [`Decoding`]; nothing without anchors.
pub(crate) fn solver<'a>(
    model: &Model<'_>,
    limits: &Limits,
    arena: &mut Arena<'a>,
) -> Result<Arena<'a>, ArenaTooSmall> {
    let &Limits { tokens, anchors, ref refinement, .. } = limits;
    let shape = refining::ProblemShape { tokens, width: model.decoder().code_width(), anchors };
    arena.part(if limits.bends() { refining::scratch_bytes(shape, refinement) } else { 0 })
}
