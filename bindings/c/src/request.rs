//! What is to be made, as C says it.

use core::ffi::c_char;

use motionette::MAX_PROMPT;
use motionette::refining::Config;
use motionette::{Anchor, AnchorList, Bones, JOINTS, Prompt, Request, Source};

use crate::conditions::{mtn_obstacle, mtn_track};
use crate::error::{mtn_error, mtn_result};
use crate::pointer::{clamped, place, slice};
use crate::timeline::mtn_span;

/// Joints of the body skeleton.
pub const MTN_JOINTS: usize = 22;
/// Most anchors of a request.
pub const MTN_MAX_ANCHORS: usize = 32;

const _: () = assert!(MTN_JOINTS == JOINTS && MTN_MAX_ANCHORS == motionette::MAX_ANCHORS);

/// What an anchor holds: one of `MTN_FAMILY_*`.
pub type mtn_family = u8;
/// The pelvis at `[x, y, z]`.
pub const MTN_FAMILY_ROOT3D: mtn_family = 0;
/// The pelvis above `[x, _, z]`, its height free.
pub const MTN_FAMILY_PLANAR: mtn_family = 1;
/// A joint at `[x, y, z]`.
pub const MTN_FAMILY_JOINT: mtn_family = 2;

/// Part of the body, time and place that the motion must pass through.
#[repr(C)]
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct mtn_anchor {
    /// Wanted position `[x, y, z]`, metres.
    pub position: [f32; 3],
    /// Frame at which it must be met, 0 is the first.
    pub frame: u16,
    /// What is to be there.
    pub family: mtn_family,
    /// Which `mtn_joint`, for `MTN_FAMILY_JOINT`; otherwise not looked at.
    pub joint: u8,
}

/// One motion to be made: begin with `mtn_request_default`, then set one of `text`, `stored`, `vector` and `tokens`.
///
/// The library reads what is pointed to during `mtn_generate` only.
#[repr(C)]
#[derive(Debug, Clone, Copy)]
pub struct mtn_request {
    /// Prompt, UTF-8, at most 4096 bytes and a zero behind them; or null.
    pub text: *const c_char,
    /// Name of a prompt that the blob stores, likewise; or null.
    pub stored: *const c_char,
    /// Prompt as a vector of the encoder that the model was trained with, `vector_count` numbers, for models that take no words (MoMask's,
    /// T2M-GPT's); or null. Say `mtn_request_for` for them.
    pub vector: *const f32,
    /// Numbers in `vector`, as `mtn_model_vector_width` says.
    pub vector_count: usize,
    /// Motion tokens `[L][Q]` for the model's Q quantizers (4 frames a token), instead of a prompt; or null.
    pub tokens: *const u16,
    /// Numbers in `tokens`.
    pub token_count: usize,
    /// Anchors in any order; may be null when there are none.
    pub anchors: *const mtn_anchor,
    /// Anchors, at most `MTN_MAX_ANCHORS`.
    pub anchor_count: usize,
    /// Seed of the planner; the same request, seed and blob give the same bits on every machine.
    pub seed: u64,
    /// Weight of text and anchors in the planner, 0 to 100; 1 is off and halves its work.
    pub guidance: f32,
    /// Length, taken to the next whole token; 0: what the text suggests. Of no account for tokens.
    pub frames: u16,
    /// Planner steps, 1 to 1000.
    pub steps: u16,
    /// Decoder evaluations of the refinement onto the anchors; 0: anchors are for the planner only, unless `exact` is set.
    pub evaluations: u16,
    /// Not 0: the planner does not see the anchors, they only refine.
    pub unconditioned: u16,
    /// Not 0: the joints are edited behind the decoder, after `evaluations` of it, which may then be 0, until the anchors are met; feet
    /// stay where they stand, with anchors and without.
    pub exact: u16,
    /// Not 0: of this edit, feet do not stay where they stand.
    pub free_feet: u16,
    /// Skeleton of the body that moves, a robot's: offset of each of the `MTN_JOINTS` joints from its parent at rest, `[22][3]`, metres, y up,
    /// the left at +x, in the order of `mtn_joint`; anchors, tracks and obstacles are in its world. Null: the model's own.
    pub bones: *const [[f32; 3]; MTN_JOINTS],
    /// Where joints are to be at many frames; may be null when there are none. The planner sees some of their places as anchors. With
    /// tracks or obstacles, `exact` must be set.
    pub tracks: *const mtn_track,
    /// Tracks, at most `MTN_MAX_TRACKS`.
    pub track_count: usize,
    /// What the figure keeps clear of; may be null when there is nothing.
    pub obstacles: *const mtn_obstacle,
    /// Obstacles, at most `MTN_MAX_OBSTACLES`.
    pub obstacle_count: usize,
    /// What parts of the body do instead, over spans of the motion, each with a prompt of its own; may be null when there are none. They are
    /// planned with `steps` and `guidance`; anchors, tracks and obstacles are met by what comes of all of it.
    pub timeline: *const mtn_span,
    /// Spans, at most `MTN_MAX_SPANS`.
    pub span_count: usize,
}

/// A request for nothing yet: five steps, guidance 2, exact anchors, planted feet, the model's own body, seed 0, the length that the text
/// suggests, neither tracks nor obstacles nor a timeline.
#[unsafe(no_mangle)]
pub extern "C" fn mtn_request_default() -> mtn_request {
    let planning = motionette::Planning::DEFAULT;
    mtn_request {
        text: core::ptr::null(),
        stored: core::ptr::null(),
        vector: core::ptr::null(),
        vector_count: 0,
        tokens: core::ptr::null(),
        token_count: 0,
        anchors: core::ptr::null(),
        anchor_count: 0,
        seed: planning.seed,
        guidance: planning.guidance,
        frames: 0,
        steps: planning.steps,
        evaluations: Config::DEFAULT.evaluations,
        unconditioned: 0,
        exact: u16::from(Config::DEFAULT.exact.is_some()),
        free_feet: 0,
        bones: core::ptr::null(),
        tracks: core::ptr::null(),
        track_count: 0,
        obstacles: core::ptr::null(),
        obstacle_count: 0,
        timeline: core::ptr::null(),
        span_count: 0,
    }
}

/// Anchors of a request in the runtime's form.
pub(crate) struct Anchors {
    items: [Anchor; MTN_MAX_ANCHORS],
    count: usize,
}

impl Anchors {
    /// # Safety
    /// The request's anchors MUST be readable.
    pub(crate) unsafe fn new(request: &mtn_request) -> Result<Self, mtn_result> {
        let (found, limit) = (clamped(request.anchor_count), clamped(MTN_MAX_ANCHORS));
        if found > limit {
            return Err(mtn_result { found, limit, ..mtn_error::TooManyAnchors.into() });
        }
        // SAFETY: the caller vouches for them.
        let given = unsafe { slice(request.anchors, request.anchor_count, 1) }?;
        let mut anchors = Anchors { items: [Anchor::root(0, [0.0; 3]); MTN_MAX_ANCHORS], count: given.len() };
        for (index, (to, from)) in anchors.items.iter_mut().zip(given).enumerate() {
            let mtn_anchor { position, frame, family, joint } = *from;
            let [x, _, z] = position;
            *to = match family {
                MTN_FAMILY_ROOT3D => Anchor::root(frame, position),
                MTN_FAMILY_PLANAR => Anchor::planar_root(frame, [x, z]),
                MTN_FAMILY_JOINT => Anchor::joint(frame, joint, position),
                _ => {
                    let (index, found) = (clamped(index), u32::from(family));
                    return Err(mtn_result { index, found, ..mtn_error::UnknownFamily.into() });
                }
            };
        }
        Ok(anchors)
    }

    fn as_slice(&self) -> &[Anchor] {
        self.items.get(..self.count).unwrap_or(&[])
    }
}

/// A prompt as C says it: one of three pointers that is set.
pub(crate) struct Prompts {
    pub(crate) text: *const c_char,
    pub(crate) stored: *const c_char,
    pub(crate) vector: *const f32,
    pub(crate) vector_count: usize,
}

impl Prompts {
    /// How many are set.
    pub(crate) fn count(&self) -> u32 {
        [self.text.is_null(), self.stored.is_null(), self.vector.is_null()].map(|null| u32::from(!null)).iter().sum()
    }

    /// The prompt, of which one is set.
    ///
    /// # Safety
    /// What it points to MUST be readable and unchanged for `'r`.
    pub(crate) unsafe fn prompt<'r>(&self) -> Result<Prompt<'r>, mtn_result> {
        Ok(if !self.text.is_null() {
            // SAFETY: the caller vouches for the text.
            Prompt::Text(unsafe { text(self.text) }?)
        } else if !self.stored.is_null() {
            // SAFETY: the caller vouches for the name.
            Prompt::Bank(unsafe { text(self.stored) }?)
        } else {
            // SAFETY: the caller vouches for the vector.
            Prompt::Vector(unsafe { slice(self.vector, self.vector_count, 1) }?)
        })
    }
}

impl mtn_request {
    /// The runtime's request, without tracks, obstacles and timeline.
    ///
    /// # Safety
    /// What the request points to MUST be readable and unchanged for `'r`.
    pub(crate) unsafe fn resolved<'r>(&self, anchors: &'r Anchors) -> Result<Request<'r>, mtn_result> {
        let mtn_request { text, stored, vector, vector_count, .. } = *self;
        let prompts = Prompts { text, stored, vector, vector_count };
        let source = match (prompts.count(), u32::from(!self.tokens.is_null())) {
            // SAFETY: the caller vouches for what it points to.
            (1, 0) => Source::Text(unsafe { prompts.prompt() }?),
            // SAFETY: the caller vouches for the tokens.
            (0, 1) => Source::Tokens(unsafe { slice(self.tokens, self.token_count, 1) }?),
            (prompts, tokens) => {
                return Err(mtn_result { found: prompts + tokens, limit: 1, ..mtn_error::Source.into() });
            }
        };
        let mut request = Request { source, ..Request::tokens(&[]) }.steps(self.steps).guidance(self.guidance);
        request = request.seed(self.seed);
        if self.frames > 0 {
            request = request.frames(self.frames);
        }
        request.anchors = AnchorList::Frames(anchors.as_slice());
        request.planning.conditioned = self.unconditioned == 0;
        request.refinement = refinement(self.evaluations, self.exact, self.free_feet);
        if !self.bones.is_null() {
            // SAFETY: the caller vouches for the skeleton.
            let bones = unsafe { slice(self.bones, 1, 1) }?;
            request.bones = bones.first().map_or(Bones::Model, Bones::Given);
        }
        Ok(request)
    }
}

/// How anchors are met; `None` leaves them to the planner.
pub(crate) fn refinement(evaluations: u16, exact: u16, free_feet: u16) -> Option<Config> {
    let config = Config::fast(evaluations);
    match exact {
        0 => (evaluations > 0).then_some(config),
        _ if free_feet == 0 => Some(config.exactly()),
        _ => Some(config.exactly().free_feet()),
    }
}

/// A text that ends with a zero byte. Bytes behind the longest prompt are not read.
///
/// # Safety
/// The bytes up to the zero, or as many as the longest prompt has and one more, MUST be readable and unchanged for
/// `'r`.
unsafe fn text<'r>(text: *const c_char) -> Result<&'r str, mtn_result> {
    let start = place(text, 1)?.cast::<u8>();
    let mut length = 0;
    // SAFETY: no zero came before, so the byte is readable.
    while unsafe { start.wrapping_add(length).read() } != 0 {
        length += 1;
        if length > MAX_PROMPT {
            let (found, limit) = (clamped(length), clamped(MAX_PROMPT));
            return Err(mtn_result { found, limit, ..mtn_error::PromptTooLong.into() });
        }
    }
    // SAFETY: all of these bytes have just been read.
    let bytes = unsafe { slice(start, length, 1) }?;
    core::str::from_utf8(bytes)
        .map_err(|e| mtn_result { index: clamped(e.valid_up_to()), ..mtn_error::PromptNotUtf8.into() })
}
