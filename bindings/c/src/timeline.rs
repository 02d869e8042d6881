//! The timeline of a request, as C says it: prompts of their own for parts of the body.

use core::ffi::c_char;

use motionette::{BodyParts, LINKED_SPANS, PromptStats, Span};

use crate::conditions::check_count;
use crate::error::{mtn_error, mtn_result, of_span};
use crate::generator::mtn_understood;
use crate::pointer::{clamped, slice};
use crate::request::{Prompts, mtn_request};

/// Most spans of a request.
pub const MTN_MAX_SPANS: usize = 8;

const _: () = assert!(MTN_MAX_SPANS == motionette::MAX_SPANS);

/// Parts of the body: `MTN_PART_*`, joined by `|`.
pub type mtn_parts = u8;
/// How the head is held on the neck.
pub const MTN_PART_HEAD: mtn_parts = 1;
/// Left shoulder, elbow and wrist, as the chest carries them.
pub const MTN_PART_LEFT_ARM: mtn_parts = 2;
/// Right shoulder, elbow and wrist, as the chest carries them.
pub const MTN_PART_RIGHT_ARM: mtn_parts = 4;
/// Left knee, ankle and foot, as the pelvis carries them.
pub const MTN_PART_LEFT_LEG: mtn_parts = 8;
/// Right knee, ankle and foot, as the pelvis carries them.
pub const MTN_PART_RIGHT_LEG: mtn_parts = 16;
/// Both arms.
pub const MTN_PART_ARMS: mtn_parts = 6;
/// Both legs.
pub const MTN_PART_LEGS: mtn_parts = 24;
/// All above the pelvis: spine, chest, head and both arms.
pub const MTN_PART_UPPER_BODY: mtn_parts = 39;

const _: () = assert!(MTN_PART_ARMS == BodyParts::ARMS.bits() && MTN_PART_LEGS == BodyParts::LEGS.bits());
const _: () = assert!(MTN_PART_UPPER_BODY == BodyParts::UPPER_BODY.bits());

/// A prompt of its own for some parts of the body, over some frames of the motion: set one of `text`, `stored` and `vector`, as of a request.
/// What is not of these parts moves as it would without the span.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct mtn_span {
    /// What they do, one clause whatever it says; or null.
    pub text: *const c_char,
    /// Name of a prompt that the blob stores; or null.
    pub stored: *const c_char,
    /// Prompt as a vector, `vector_count` numbers; or null.
    pub vector: *const f32,
    /// Numbers in `vector`.
    pub vector_count: usize,
    /// First frame.
    pub first: u16,
    /// Frames, 8 or more.
    pub frames: u16,
    /// What moves. Two spans may not move one part at one frame.
    pub parts: mtn_parts,
}

/// What was understood of the prompt of a span.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct mtn_heard {
    /// What it was understood as; `mtn_understood_in_words` says it in words.
    pub understood: mtn_understood,
    /// Its words.
    pub words: u16,
    /// Of these, words that the model does not know.
    pub unknown_words: u16,
}

impl mtn_heard {
    pub(crate) const NOTHING: Self = mtn_heard { understood: mtn_understood::NOTHING, words: 0, unknown_words: 0 };
}

impl From<PromptStats> for mtn_heard {
    fn from(PromptStats { words, unknown_words, understood }: PromptStats) -> Self {
        let understood = understood.map_or(mtn_understood::NOTHING, mtn_understood::from);
        mtn_heard { understood, words, unknown_words }
    }
}

/// Room for the spans of a request.
pub(crate) type Spans<'r> = [Span<'r>; LINKED_SPANS];

/// Room in which there is none.
pub(crate) const fn no_spans<'r>() -> Spans<'r> {
    [Span::new(BodyParts::NONE, 0, 0, ""); LINKED_SPANS]
}

/// The request's spans in the runtime's form, in `room`.
///
/// # Safety
/// The spans, and what they point to, MUST be readable and unchanged for `'r`.
pub(crate) unsafe fn fill_spans<'a, 'r>(
    request: &mtn_request,
    room: &'a mut Spans<'r>,
) -> Result<&'a [Span<'r>], mtn_result> {
    let count = request.span_count;
    check_count(count, MTN_MAX_SPANS, cfg!(feature = "timeline"), mtn_error::TooManySpans)?;
    // SAFETY: the caller vouches for them.
    let given = unsafe { slice(request.timeline, count, 1) }?;
    for (index, (to, from)) in room.iter_mut().zip(given).enumerate() {
        let mtn_span { text, stored, vector, vector_count, first, frames, parts } = *from;
        let at = |error: mtn_error, found| mtn_result { index: clamped(index), found, ..error.into() };
        let parts = BodyParts::from_bits(parts).ok_or(at(mtn_error::SpanParts, u32::from(parts)))?;
        let prompts = Prompts { text, stored, vector, vector_count };
        if prompts.count() != 1 {
            return Err(mtn_result { limit: 1, ..at(mtn_error::SpanSource, prompts.count()) });
        }
        // SAFETY: the caller vouches for it.
        let prompt = unsafe { prompts.prompt() }.map_err(|refused| of_span(index, refused))?;
        *to = Span { parts, first, frames, prompt };
    }
    Ok(room.get(..count).unwrap_or(&[]))
}
