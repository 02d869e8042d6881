// motionette: motion generation on microcontrollers, as a C library. C99, needs no libc and no heap.
//
// Made from bindings/c/src by `cargo xtask c --write-header`; do not edit.
//
// Lengths are metres, y is up; a motion starts with the pelvis at x = z = 0, facing +z, the
// body's left is +x. A frame is one of `frame_rate` (20) a second.
//
// Memory: the caller owns all of it. Blob, arena, model and generator must stay where they are for as long as the model
// or generator is used; the library keeps pointers to them, never frees, and has no state of its own.
// Threads: one object is used by one thread at a time; different generators may run at once, also of one blob.
// Interrupts: nothing here masks them, nothing here is for use inside them.
// Floating point: round to nearest, subnormal numbers and NaN payloads on (FPSCR as after reset on Cortex-M).

#ifndef MOTIONETTE_H
#define MOTIONETTE_H

#include <stddef.h>
#include <stdint.h>

// Words of `mtn_model`'s storage.
#define MTN_MODEL_WORDS 640

// Rows that pass through a layer at a time unless a generator is told otherwise.
#define MTN_ROWS 8

// Joints of the body skeleton.
#define MTN_JOINTS 22

// Most anchors of a request.
#define MTN_MAX_ANCHORS 32

// Most tracks of a request.
#define MTN_MAX_TRACKS 24

// Most obstacles of a request.
#define MTN_MAX_OBSTACLES 16

// Most keyframes of a request, those of all its obstacles together.
#define MTN_MAX_KEYFRAMES 64

// All joints, as `joints` of an obstacle has them.
#define MTN_ALL_JOINTS 4194303

// Most spans of a request.
#define MTN_MAX_SPANS 8

// Words of `mtn_generator`'s storage.
#define MTN_GENERATOR_WORDS 640

// Likeliest actions of `mtn_understood`.
#define MTN_NEAREST 3

// Most clauses of a prompt, done one behind the other ("walk, then wave"), beside the first.
#define MTN_FURTHER_CLAUSES 2

// In place of a phrase's number: no phrase.
#define MTN_NO_PHRASE 65535

// In place of an obstacle's number: no obstacle.
#define MTN_NO_OBSTACLE 65535

// What went wrong. The numbers of `mtn_result` that a code sets stand beside it; the others are 0.
enum mtn_error
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : int32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    // Nothing.
    MTN_ERROR_NONE = 0,
    // A pointer is null. `index`: the argument, from 0; pointers inside a request count as it.
    MTN_ERROR_NULL_POINTER = 1,
    // A pointer is not aligned. `index`: the argument; `found`: its remainder; `limit`: alignment, bytes.
    MTN_ERROR_MISALIGNED = 2,
    // A length runs over the end of the address space. `index`: the argument; `found`: the length.
    MTN_ERROR_LENGTH = 3,
    // Model or generator was never opened, could not be opened, or is a copy. `index`: the argument.
    MTN_ERROR_NOT_OPENED = 4,
    // The generator is at work: a callback used it. `index`: the argument.
    MTN_ERROR_BUSY = 5,
    // The blob does not begin on a 16-byte boundary. `found`: remainder; `limit`: 16.
    MTN_ERROR_BLOB_MISALIGNED = 10,
    // Too few bytes: the blob was cut short. `found`: bytes there are; `limit`: bytes needed.
    MTN_ERROR_BLOB_TRUNCATED = 11,
    // This is no blob. `found`: its first four bytes; `limit`: those of a blob, both read as little-endian numbers.
    MTN_ERROR_NOT_A_BLOB = 12,
    // Another format version: `motionette convert OLD.blob -o NEW.blob` lifts an older blob. `found`: its major
    // version; `limit`: the one that is understood.
    MTN_ERROR_BLOB_VERSION = 13,
    // Lengths in the header contradict each other.
    MTN_ERROR_BLOB_HEADER = 14,
    // The blob was damaged. `found`: CRC-32 of its bytes; `limit`: the one it should have.
    MTN_ERROR_BLOB_CHECKSUM = 15,
    // The manifest cannot be read.
    MTN_ERROR_BLOB_MANIFEST = 16,
    // A configuration value is not supported; `motionette inspect` on the desk says which. `found`: the value (its
    // bits, where it is no whole number); `limit`: the largest allowed.
    MTN_ERROR_BLOB_CONFIG = 17,
    // A tensor is missing, or has a wrong place, shape or value. `index`: the tensor; `found` and `limit`: its
    // elements and how many there should be, where the shape is wrong.
    MTN_ERROR_BLOB_TENSOR = 18,
    // The weights could overflow. `index`: the tensor.
    MTN_ERROR_BLOB_UNBOUNDED = 19,
    // A section of the manifest is of a kind that came later: the blob needs a newer library; `motionette inspect` on
    // the desk says which section. `found`: the kind; `limit`: the newest one that is known.
    MTN_ERROR_BLOB_UNKNOWN = 20,
    // The blob or the request needs a family that this library was built without, a cargo feature of `bindings/c`;
    // `motionette inspect` on the desk says which the blob needs.
    MTN_ERROR_BLOB_NOT_LINKED = 21,
    // The arena is too small. `found`: bytes from its first 16-byte boundary; `limit`: bytes the request needs.
    MTN_ERROR_ARENA_TOO_SMALL = 30,
    // Floating point is not in its default state: rounding mode, flush-to-zero or default-NaN bits are set.
    MTN_ERROR_FLOATING_POINT = 31,
    // A request has either a text, or a stored prompt, or a vector, or tokens. `found`: how many of them are set; `limit`: 1.
    MTN_ERROR_SOURCE = 32,
    // No tokens, too many, or numbers that are no whole tokens. `found`: how many; `limit`: most tokens of the
    // model.
    MTN_ERROR_TOKEN_COUNT = 33,
    // A token that the codebook does not have. `index`: its place; `found`: the token; `limit`: codes there are.
    MTN_ERROR_TOKEN_OUT_OF_RANGE = 34,
    // The progress callback asked to abort.
    MTN_ERROR_ABORTED = 35,
    // A bone of the request's skeleton is no number, or none that a body has. `index`: its joint.
    MTN_ERROR_BONE = 36,
    // The model has no planner: it makes no motion from text.
    MTN_ERROR_NO_PLANNER = 40,
    // The model has no text encoder, only stored prompts. `found`: how many.
    MTN_ERROR_NO_TEXT_ENCODER = 41,
    // The prompt is not UTF-8. `index`: the first byte that is wrong.
    MTN_ERROR_PROMPT_NOT_UTF8 = 42,
    // The prompt has no words.
    MTN_ERROR_PROMPT_EMPTY = 43,
    // The prompt has too many bytes. `limit`: how many are read.
    MTN_ERROR_PROMPT_TOO_LONG = 44,
    // The prompt has too many words. `found`: how many; `limit`: most the model takes.
    MTN_ERROR_PROMPT_TOO_MANY_WORDS = 45,
    // The model knows none of the words. `found`: how many there are.
    MTN_ERROR_PROMPT_UNKNOWN_WORDS = 46,
    // The model stores no prompt of that name. `found`: prompts it stores.
    MTN_ERROR_PROMPT_NOT_STORED = 47,
    // The motion is too long. `found`: tokens asked for (4 frames each); `limit`: most the model allows.
    MTN_ERROR_MOTION_LENGTH = 48,
    // No planner steps, or too many. `found`: steps; `limit`: most there may be.
    MTN_ERROR_STEPS = 49,
    // Guidance is not a number from 0 to 100.
    MTN_ERROR_GUIDANCE = 50,
    // The model takes no words: prompts are vectors of another encoder. `found`: prompts it stores; `limit`: numbers of a vector.
    MTN_ERROR_PROMPT_VECTORS = 51,
    // The model takes prompts in words, not as vectors.
    MTN_ERROR_PROMPT_NO_VECTORS = 52,
    // The vector is of another encoder. `found`: its numbers; `limit`: numbers of one that the model takes.
    MTN_ERROR_PROMPT_VECTOR_WIDTH = 53,
    // A number of the vector is not finite or too large. `index`: its place.
    MTN_ERROR_PROMPT_VECTOR_VALUE = 54,
    // All numbers of the vector are zero.
    MTN_ERROR_PROMPT_VECTOR_ZERO = 55,
    // The planner ended the motion before its first token: give a length, or another seed.
    MTN_ERROR_MOTION_EMPTY = 56,
    // Too many anchors. `found`: how many; `limit`: most there may be.
    MTN_ERROR_TOO_MANY_ANCHORS = 60,
    // `index`: the anchor; `found`: its family, which is none of `MTN_FAMILY_*`.
    MTN_ERROR_UNKNOWN_FAMILY = 61,
    // An anchor lies behind the end of the motion. `index`: the anchor; `found`: its frame; `limit`: frames of the
    // motion.
    MTN_ERROR_ANCHOR_FRAME = 62,
    // There is no such joint. `index`: the anchor; `found`: its joint; `limit`: joints there are.
    MTN_ERROR_ANCHOR_JOINT = 63,
    // A coordinate is NaN or infinite. `index`: the anchor.
    MTN_ERROR_ANCHOR_NOT_FINITE = 64,
    // A coordinate is too large. `index`: the anchor; `limit`: largest magnitude, metres.
    MTN_ERROR_ANCHOR_TOO_FAR = 65,
    // Two anchors want one joint in two places at one frame. `index`: the second; `found`: the first.
    MTN_ERROR_ANCHOR_CONFLICT = 66,
    // Too many tokens to be refined. `found`: tokens; `limit`: most the refinement takes.
    MTN_ERROR_REFINEMENT_LENGTH = 67,
    // The refinement met numbers that are not finite.
    MTN_ERROR_REFINEMENT_NOT_FINITE = 68,
    // This machine computes other bits than the one that wrote the blob.
    MTN_ERROR_SELF_TEST_FAILED = 80,
    // The blob carries no self-test.
    MTN_ERROR_NO_SELF_TEST = 81,
    // Something that this version has no code for.
    MTN_ERROR_OTHER = 99,
    // Too many tracks. `found`: how many; `limit`: most there may be.
    MTN_ERROR_TOO_MANY_TRACKS = 100,
    // `index`: the track; `found`: its axes, of which some are none of `MTN_AXIS_*`; `limit`: `MTN_AXES_ALL`.
    MTN_ERROR_TRACK_AXES = 101,
    // Nothing of a track counts: no positions, a mask without any, or no axis. `index`: the track.
    MTN_ERROR_TRACK_NOTHING = 102,
    // There is no such joint. `index`: the track; `found`: its joint; `limit`: joints there are.
    MTN_ERROR_TRACK_JOINT = 103,
    // A track goes on behind the end of the motion. `index`: the track; `found`: frame of its last position; `limit`: frames of the
    // motion.
    MTN_ERROR_TRACK_FRAME = 104,
    // A coordinate is NaN, infinite or too large. `index`: the track; `found`: frame of the position; `limit`: largest magnitude, metres.
    MTN_ERROR_TRACK_POSITION = 105,
    // A tolerance that is negative, not a number or too large. `index`: the track; `limit`: the largest, metres.
    MTN_ERROR_TRACK_TOLERANCE = 106,
    // Two tracks want one joint in two places at one frame. `index`: the second; `found`: the first; `limit`: the frame.
    MTN_ERROR_TRACK_CONFLICT = 107,
    // A track and an anchor want one joint in two places at one frame. `index`: the track; `found`: the anchor; `limit`: the frame.
    MTN_ERROR_TRACK_ANCHOR_CONFLICT = 108,
    // Tracks and obstacles are met by the edit behind the decoder alone: set `exact`.
    MTN_ERROR_NOT_EXACT = 109,
    // Limits with more tracked joints than a body has. `found`: how many; `limit`: joints there are.
    MTN_ERROR_TRACKED_JOINTS = 110,
    // Too many obstacles. `found`: how many; `limit`: most there may be.
    MTN_ERROR_TOO_MANY_OBSTACLES = 120,
    // `index`: the obstacle; `found`: its shape, which is none of `MTN_SHAPE_*`.
    MTN_ERROR_UNKNOWN_SHAPE = 121,
    // `index`: the obstacle; `found`: its course, which is none of `MTN_COURSE_*`.
    MTN_ERROR_UNKNOWN_COURSE = 122,
    // A size is not above 0 or too large, or a plane has no direction. `index`: the obstacle; `limit`: the largest, metres.
    MTN_ERROR_OBSTACLE_SIZE = 123,
    // A margin that is negative, not a number or too large. `index`: the obstacle; `limit`: the largest, metres.
    MTN_ERROR_OBSTACLE_MARGIN = 124,
    // A place or velocity is NaN, infinite or too large. `index`: the obstacle; `limit`: largest magnitude, metres.
    MTN_ERROR_OBSTACLE_PLACE = 125,
    // It moves too fast. `index`: the obstacle; `found`: its speed, rounded up; `limit`: the largest; both metres a second.
    MTN_ERROR_OBSTACLE_SPEED = 126,
    // No keyframes, or one that is not behind the one before it. `index`: the obstacle; `found`: the keyframe.
    MTN_ERROR_OBSTACLE_KEYFRAMES = 127,
    // Too many keyframes in the obstacles together. `index`: the obstacle that has one too many; `found`: keyframes of all up to it, its
    // own included; `limit`: most there may be.
    MTN_ERROR_TOO_MANY_KEYFRAMES = 128,
    // No joint keeps clear of it, or one that there is not. `index`: the obstacle.
    MTN_ERROR_OBSTACLE_JOINTS = 129,
    // An anchor lies inside it. `index`: the obstacle; `found`: the anchor.
    MTN_ERROR_ANCHOR_INSIDE = 130,
    // A track passes through it. `index`: the obstacle; `found`: the track; `limit`: the first frame at which it is inside.
    MTN_ERROR_TRACK_INSIDE = 131,
    // Too many spans. `found`: how many; `limit`: most there may be.
    MTN_ERROR_TOO_MANY_SPANS = 140,
    // `index`: the span; `found`: its parts, of which some are none of `MTN_PART_*`, or a trunk without head and arms.
    MTN_ERROR_SPAN_PARTS = 141,
    // A span moves no part of the body. `index`: the span.
    MTN_ERROR_SPAN_NOTHING = 142,
    // A span is too short. `index`: the span; `found`: its frames; `limit`: the fewest there may be.
    MTN_ERROR_SPAN_FRAMES = 143,
    // A span goes on behind the end of the motion. `index`: the span; `found`: the frame behind its last; `limit`: frames of the motion.
    MTN_ERROR_SPAN_END = 144,
    // Two spans move one part at one frame. `index`: the second; `found`: the first; `limit`: the parts that both move.
    MTN_ERROR_SPAN_OVERLAP = 145,
    // A span has either a text, or a stored prompt, or a vector. `index`: the span; `found`: how many of them are set; `limit`: 1.
    MTN_ERROR_SPAN_SOURCE = 146,
    // A span's prompt was refused. `index`: the span; `found`: the code of a request with that prompt, of which `mtn_error_message` says what
    // it is; `limit`: the `limit` of that code, or the `index` where it has one.
    MTN_ERROR_SPAN_PROMPT = 147,
    // Limits with spans and without words: spans are planned from prompts. `found`: spans.
    MTN_ERROR_SPAN_WORDS = 148,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum mtn_error mtn_error;
#else
typedef int32_t mtn_error;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// A stage of the work.
enum mtn_stage
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint32_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    // Reading the prompt.
    MTN_STAGE_READING,
    // Planning tokens.
    MTN_STAGE_PLANNING,
    // Bending the motion onto its anchors.
    MTN_STAGE_REFINING,
    // Decoding the final motion.
    MTN_STAGE_DECODING,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum mtn_stage mtn_stage;
#else
typedef uint32_t mtn_stage;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// A joint of the body skeleton; its number is that of the SMPL order.
enum mtn_joint
#if defined(__cplusplus) || __STDC_VERSION__ >= 202311L
  : uint8_t
#endif // defined(__cplusplus) || __STDC_VERSION__ >= 202311L
 {
    MTN_JOINT_PELVIS = 0,
    MTN_JOINT_LEFT_HIP = 1,
    MTN_JOINT_RIGHT_HIP = 2,
    MTN_JOINT_SPINE1 = 3,
    MTN_JOINT_LEFT_KNEE = 4,
    MTN_JOINT_RIGHT_KNEE = 5,
    MTN_JOINT_SPINE2 = 6,
    MTN_JOINT_LEFT_ANKLE = 7,
    MTN_JOINT_RIGHT_ANKLE = 8,
    MTN_JOINT_SPINE3 = 9,
    MTN_JOINT_LEFT_FOOT = 10,
    MTN_JOINT_RIGHT_FOOT = 11,
    MTN_JOINT_NECK = 12,
    MTN_JOINT_LEFT_COLLAR = 13,
    MTN_JOINT_RIGHT_COLLAR = 14,
    MTN_JOINT_HEAD = 15,
    MTN_JOINT_LEFT_SHOULDER = 16,
    MTN_JOINT_RIGHT_SHOULDER = 17,
    MTN_JOINT_LEFT_ELBOW = 18,
    MTN_JOINT_RIGHT_ELBOW = 19,
    MTN_JOINT_LEFT_WRIST = 20,
    MTN_JOINT_RIGHT_WRIST = 21,
};
#ifndef __cplusplus
#if __STDC_VERSION__ >= 202311L
typedef enum mtn_joint mtn_joint;
#else
typedef uint8_t mtn_joint;
#endif // __STDC_VERSION__ >= 202311L
#endif // __cplusplus

// An error and the numbers that explain it.
typedef struct mtn_result {
    // What went wrong; 0: nothing.
    mtn_error error;
    // Which one, counted from 0.
    uint32_t index;
    // What was found.
    uint32_t found;
    // What is allowed or needed.
    uint32_t limit;
} mtn_result;

// An opened blob. Opaque: give it zeroed storage (a `static` is), call `mtn_model_open`, and do not copy it.
typedef struct mtn_model {
    // Not for use: makes the alignment that of 64-bit numbers.
    uint64_t reserved;
    // Not for use.
    size_t opaque[MTN_MODEL_WORDS];
} mtn_model;

// What an anchor holds: one of `MTN_FAMILY_*`.
typedef uint8_t mtn_family;

// Part of the body, time and place that the motion must pass through.
typedef struct mtn_anchor {
    // Wanted position `[x, y, z]`, metres.
    float position[3];
    // Frame at which it must be met, 0 is the first.
    uint16_t frame;
    // What is to be there.
    mtn_family family;
    // Which `mtn_joint`, for `MTN_FAMILY_JOINT`; otherwise not looked at.
    uint8_t joint;
} mtn_anchor;

// Axes of which positions count: `MTN_AXIS_*`, added up.
typedef uint8_t mtn_axes;

// Where a joint is to be at many frames, up to all of them.
typedef struct mtn_track {
    // Where the joint is to be, `[count][3]`, metres, one position a frame. Those that do not count may hold any finite numbers.
    const float (*positions)[3];
    // Which positions count, `[count]`, not 0 for those that do; null: all.
    const uint8_t *mask;
    // Positions.
    size_t count;
    // How loosely it is followed: the standard deviation around it, 0 to 1 metres. 0: as exactly as can be.
    float tolerance;
    // Frame of the first position.
    uint16_t first;
    // Which `mtn_joint`.
    uint8_t joint;
    // Which axes of the positions count, `MTN_AXES_ALL` or some of `MTN_AXIS_*`; the others are free.
    mtn_axes axes;
} mtn_track;

// Where the middle of an obstacle is at a frame.
typedef struct mtn_keyframe {
    // The middle `[x, y, z]`, metres.
    float position[3];
    // The frame.
    uint16_t frame;
} mtn_keyframe;

// The form of an obstacle, around its middle: one of `MTN_SHAPE_*`.
typedef uint8_t mtn_shape;

// How an obstacle moves: one of `MTN_COURSE_*`.
typedef uint8_t mtn_course;

// A body that joints, and the bones between them, keep clear of. Sizes that are not of its shape, and fields that are not of its course,
// are not looked at.
typedef struct mtn_obstacle {
    // Keyframes of `MTN_COURSE_KEYFRAMES`, each behind the one before it.
    const struct mtn_keyframe *keyframes;
    // How many there are, of all obstacles together at most `MTN_MAX_KEYFRAMES`.
    size_t keyframe_count;
    // The middle `[x, y, z]`, metres; of `MTN_COURSE_MOVING` at frame 0.
    float position[3];
    // Of `MTN_COURSE_MOVING`, metres a second, at most 20.
    float velocity[3];
    // Of sphere, capsule and cylinder, metres.
    float radius;
    // Of a cylinder: half of its height, metres.
    float half_height;
    // Of a capsule: from the middle to one end, metres. Of a box: half of each side, metres.
    float half[3];
    // Of a plane: which way is free, of any length but none.
    float normal[3];
    // How far the figure keeps away from its surface, 0 to 1 metres; 0.05 is a good one.
    float margin;
    // The joints that keep clear, `1 << joint` of each `mtn_joint` added up, each with the bone from its parent; `MTN_ALL_JOINTS` for the
    // whole figure.
    uint32_t joints;
    // Its form.
    mtn_shape shape;
    // How it moves.
    mtn_course course;
} mtn_obstacle;

// Parts of the body: `MTN_PART_*`, joined by `|`.
typedef uint8_t mtn_parts;

// A prompt of its own for some parts of the body, over some frames of the motion: set one of `text`, `stored` and `vector`, as of a request.
// What is not of these parts moves as it would without the span.
typedef struct mtn_span {
    // What they do, one clause whatever it says; or null.
    const char *text;
    // Name of a prompt that the blob stores; or null.
    const char *stored;
    // Prompt as a vector, `vector_count` numbers; or null.
    const float *vector;
    // Numbers in `vector`.
    size_t vector_count;
    // First frame.
    uint16_t first;
    // Frames, 8 or more.
    uint16_t frames;
    // What moves. Two spans may not move one part at one frame.
    mtn_parts parts;
} mtn_span;

// One motion to be made: begin with `mtn_request_default`, then set one of `text`, `stored`, `vector` and `tokens`.
//
// The library reads what is pointed to during `mtn_generate` only.
typedef struct mtn_request {
    // Prompt, UTF-8, at most 4096 bytes and a zero behind them; or null.
    const char *text;
    // Name of a prompt that the blob stores, likewise; or null.
    const char *stored;
    // Prompt as a vector of the encoder that the model was trained with, `vector_count` numbers, for models that take no words (MoMask's,
    // T2M-GPT's); or null. Say `mtn_request_for` for them.
    const float *vector;
    // Numbers in `vector`, as `mtn_model_vector_width` says.
    size_t vector_count;
    // Motion tokens `[L][Q]` for the model's Q quantizers (4 frames a token), instead of a prompt; or null.
    const uint16_t *tokens;
    // Numbers in `tokens`.
    size_t token_count;
    // Anchors in any order; may be null when there are none.
    const struct mtn_anchor *anchors;
    // Anchors, at most `MTN_MAX_ANCHORS`.
    size_t anchor_count;
    // Seed of the planner; the same request, seed and blob give the same bits on every machine.
    uint64_t seed;
    // Weight of text and anchors in the planner, 0 to 100; 1 is off and halves its work.
    float guidance;
    // Length, taken to the next whole token; 0: what the text suggests. Of no account for tokens.
    uint16_t frames;
    // Planner steps, 1 to 1000.
    uint16_t steps;
    // Decoder evaluations of the refinement onto the anchors; 0: anchors are for the planner only, unless `exact` is set.
    uint16_t evaluations;
    // Not 0: the planner does not see the anchors, they only refine.
    uint16_t unconditioned;
    // Not 0: the joints are edited behind the decoder, after `evaluations` of it, which may then be 0, until the anchors are met; feet
    // stay where they stand, with anchors and without.
    uint16_t exact;
    // Not 0: of this edit, feet do not stay where they stand.
    uint16_t free_feet;
    // Skeleton of the body that moves, a robot's: offset of each of the `MTN_JOINTS` joints from its parent at rest, `[22][3]`, metres, y up,
    // the left at +x, in the order of `mtn_joint`; anchors, tracks and obstacles are in its world. Null: the model's own.
    const float (*bones)[MTN_JOINTS][3];
    // Where joints are to be at many frames; may be null when there are none. The planner sees some of their places as anchors. With
    // tracks or obstacles, `exact` must be set.
    const struct mtn_track *tracks;
    // Tracks, at most `MTN_MAX_TRACKS`.
    size_t track_count;
    // What the figure keeps clear of; may be null when there is nothing.
    const struct mtn_obstacle *obstacles;
    // Obstacles, at most `MTN_MAX_OBSTACLES`.
    size_t obstacle_count;
    // What parts of the body do instead, over spans of the motion, each with a prompt of its own; may be null when there are none. They are
    // planned with `steps` and `guidance`; anchors, tracks and obstacles are met by what comes of all of it.
    const struct mtn_span *timeline;
    // Spans, at most `MTN_MAX_SPANS`.
    size_t span_count;
} mtn_request;

// Largest request that is to be served.
typedef struct mtn_limits {
    // Frames of the motion; 0: the longest motion of the model, as a request of predicted length needs it.
    size_t frames;
    // Words of the prompt, 1 for one that is a vector; 0: the tokens are given.
    size_t words;
    // Anchors, at most `MTN_MAX_ANCHORS`.
    size_t anchors;
    // Planner steps; not looked at without words.
    uint16_t steps;
    // Decoder evaluations of the refinement; 0: anchors are for the planner only, unless `exact` is set.
    uint16_t evaluations;
    // As of a request.
    uint16_t exact;
    // As in a request.
    uint16_t free_feet;
    // Guidance; 1 is off and saves half of the planner's work. Not looked at without words.
    float guidance;
    // Rows that pass through a layer at a time, as `mtn_generator_set_rows` is told; 0: `MTN_ROWS`.
    size_t rows;
    // Joints that have rows at many frames, each counted once: those of tracks; beside tracks or obstacles those of anchors as well;
    // with obstacles up to six more, which lead the figure out. `MTN_JOINTS` is enough for every request. 0: neither tracks nor
    // obstacles. With them `exact` must be set.
    size_t tracked;
    // Spans of a timeline, at most `MTN_MAX_SPANS`, each as long as the motion and with a prompt of so many `words`, which must not be 0:
    // of the larger of prompt and spans where they differ, of the spans where the tokens are given.
    size_t spans;
} mtn_limits;

// Memory and work of the largest request inside some limits.
typedef struct mtn_plan {
    // Bytes of arena, from a 16-byte boundary, exactly. An arena that begins elsewhere needs up to 15 more.
    size_t arena_bytes;
    // Multiply-accumulates at most, in all.
    uint64_t macs;
    // Of these, multiply-accumulates of reading the prompt and planning tokens.
    uint64_t planning_macs;
    // Of these, multiply-accumulates of the final decoding; what is left is refinement.
    uint64_t decoding_macs;
    // Decoder evaluations at most, the final one included.
    uint32_t evaluations;
    // Decoder gradients at most.
    uint32_t gradients;
} mtn_plan;

// Makes motions of one model in one arena. Opaque: give it zeroed storage (a `static` is), call
// `mtn_generator_open`, and do not copy it.
typedef struct mtn_generator {
    // Not for use: makes the alignment that of 64-bit numbers.
    uint64_t reserved;
    // Not for use.
    size_t opaque[MTN_GENERATOR_WORDS];
} mtn_generator;

// What a progress callback wants: one of `MTN_FLOW_*`.
typedef uint32_t mtn_flow;

// How far the work is.
typedef struct mtn_progress {
    // The stage.
    mtn_stage stage;
    // Decoder evaluations begun in this stage; when planning, steps.
    uint16_t evaluation;
    // Decoder evaluations, or steps, this stage may take.
    uint16_t evaluations;
    // Mean distance from the anchors of the evaluation that has just been completed, metres; negative in all other
    // calls.
    float control_error;
} mtn_progress;

// Called at every layer boundary, hundreds of times a motion. `context` is what `mtn_generate` was given;
// `progress` is valid during the call only. It may take its time, but neither leave by `longjmp` nor use the same
// generator.
typedef mtn_flow (*mtn_progress_fn)(void *context, const struct mtn_progress *progress);

// A phrase that the model was taught, and how likely the prompt means it.
typedef struct mtn_guess {
    // Number of the phrase, the same for every prompt of one model, or `MTN_NO_PHRASE`.
    uint16_t phrase;
    // Probability, 0 to 1.
    float score;
} mtn_guess;

// What a prompt was understood as; `mtn_motion_understood` says it in words.
typedef struct mtn_understood {
    // The likeliest actions, the first of them first. All `MTN_NO_PHRASE`: there was no prompt, or the model was not taught what
    // prompts mean.
    struct mtn_guess actions[MTN_NEAREST];
    // The style, or `MTN_NO_PHRASE`.
    struct mtn_guess style;
    // 1: the first action is likely what was meant; 0: the model has hardly learnt what was asked for.
    uint8_t sure;
} mtn_understood;

// How far a motion is from its tracks.
typedef struct mtn_tracking {
    // Mean distance over all positions that count, on the axes that do, metres; negative without tracks.
    float mean;
    // Largest distance, metres; negative without tracks.
    float worst;
    // The track it is from, counted from 0.
    uint16_t track;
    // Its frame.
    uint16_t frame;
} mtn_tracking;

// How far a motion keeps clear of its obstacles, half frames counted.
typedef struct mtn_clearance {
    // Least distance from a surface, metres; negative inside, infinite without obstacles.
    float least;
    // By how much it is less than the obstacle's margin, metres; negative where all of the margin is kept, minus infinity without
    // obstacles. More than 0.005: the figure does not keep clear, since there was no way for it.
    float missing;
    // The obstacle it is from, counted from 0, or `MTN_NO_OBSTACLE`.
    uint16_t obstacle;
    // The frame.
    uint16_t frame;
    // The joint, or the one at the end of the bone.
    uint8_t joint;
} mtn_clearance;

// What was understood of the prompt of a span.
typedef struct mtn_heard {
    // What it was understood as; `mtn_understood_in_words` says it in words.
    struct mtn_understood understood;
    // Its words.
    uint16_t words;
    // Of these, words that the model does not know.
    uint16_t unknown_words;
} mtn_heard;

// A finished motion. Its arrays lie in the generator and its arena, until the generator is used again.
typedef struct mtn_motion {
    // Joint positions `[frames][22][3]`, metres: `joints[frame][MTN_JOINT_HEAD][1]` is the head's height.
    const float (*joints)[MTN_JOINTS][3];
    // Frames.
    size_t frames;
    // Tokens `[L][Q]` the motion was decoded from, before refinement.
    const uint16_t *tokens;
    // Numbers in `tokens`.
    size_t token_count;
    // Token embeddings `[L][du]` it was decoded from, refinement included.
    const float *embeddings;
    // Numbers in `embeddings`.
    size_t embedding_count;
    // Bytes of arena that were taken.
    size_t arena_used;
    // Mean distance from the anchors before refinement, metres; negative when it was not measured.
    float control_error_before;
    // The same after it.
    float control_error;
    // Largest distance from an anchor after it, metres; negative when it was not measured.
    float worst_error;
    // The anchor it is from, counted from 0.
    uint16_t worst_anchor;
    // Decoder evaluations of the refinement.
    uint16_t evaluations;
    // Anchors that ask for more speed than the edit of `exact` adds, and were met as far as it allows.
    uint16_t loosened_anchors;
    // Frames a second.
    uint16_t frame_rate;
    // Words of the prompt.
    uint16_t words;
    // Of these, words that the model does not know.
    uint16_t unknown_words;
    // Anchors that the planner did not see.
    uint16_t unconditioned_anchors;
    // What the prompt was understood as, or the first of its clauses.
    struct mtn_understood understood;
    // The same of its further clauses, in the order in which they are done; behind the last of them all `MTN_NO_PHRASE`.
    struct mtn_understood then[MTN_FURTHER_CLAUSES];
    // How far the generated motion was from the tracks.
    struct mtn_tracking tracking_before;
    // How far it is after the edit.
    struct mtn_tracking tracking;
    // How near the generated motion came to an obstacle.
    struct mtn_clearance clearance_before;
    // How near it comes after the edit.
    struct mtn_clearance clearance;
    // Positions of tracks that could not be followed as fast as they ask for.
    uint16_t hurried_positions;
    // What was understood of the prompts of the timeline's spans, in the request's order; null without a timeline.
    const struct mtn_heard *spans;
    // Spans.
    size_t span_count;
} mtn_motion;

// The pelvis at `[x, y, z]`.
#define MTN_FAMILY_ROOT3D 0

// The pelvis above `[x, _, z]`, its height free.
#define MTN_FAMILY_PLANAR 1

// A joint at `[x, y, z]`.
#define MTN_FAMILY_JOINT 2

// x, to the body's left at the start.
#define MTN_AXIS_X 1

// y, up.
#define MTN_AXIS_Y 2

// z, ahead at the start.
#define MTN_AXIS_Z 4

// All three.
#define MTN_AXES_ALL 7

// All points no farther from the middle than `radius`.
#define MTN_SHAPE_SPHERE 0

// All points no farther than `radius` from the stretch that reaches from the middle by `half` both ways.
#define MTN_SHAPE_CAPSULE 1

// A pillar that stands upright, of `radius` and `half_height`.
#define MTN_SHAPE_CYLINDER 2

// A box with sides along the axes, `half` of each.
#define MTN_SHAPE_BOX 3

// All that lies behind a plane through the middle; `normal` says which way is free.
#define MTN_SHAPE_PLANE 4

// Its middle stays at `position`.
#define MTN_COURSE_STILL 0

// Its middle is at `position` at frame 0 and goes on with `velocity`.
#define MTN_COURSE_MOVING 1

// Its middle goes from keyframe to keyframe in straight lines; before the first and behind the last it stays.
#define MTN_COURSE_KEYFRAMES 2

// How the head is held on the neck.
#define MTN_PART_HEAD 1

// Left shoulder, elbow and wrist, as the chest carries them.
#define MTN_PART_LEFT_ARM 2

// Right shoulder, elbow and wrist, as the chest carries them.
#define MTN_PART_RIGHT_ARM 4

// Left knee, ankle and foot, as the pelvis carries them.
#define MTN_PART_LEFT_LEG 8

// Right knee, ankle and foot, as the pelvis carries them.
#define MTN_PART_RIGHT_LEG 16

// Both arms.
#define MTN_PART_ARMS 6

// Both legs.
#define MTN_PART_LEGS 24

// All above the pelvis: spine, chest, head and both arms.
#define MTN_PART_UPPER_BODY 39

// Go on.
#define MTN_FLOW_CONTINUE 0

// Finish with the best so far: refinement ends, the motion is decoded and returned; planning ends with its last
// proposals.
#define MTN_FLOW_FINISH 1

// Stop at once, no motion. Any other number counts as this.
#define MTN_FLOW_ABORT 2

#ifdef __cplusplus
extern "C" {
#endif // __cplusplus

// One sentence about an error code, in English, static, zero-terminated. Any number is allowed.
const char *mtn_error_message(int32_t error);

// Opens a blob: checks header, checksum, manifest and every tensor, once. About one pass over its bytes.
//
// `blob`: `blob_bytes` bytes from a 16-byte boundary, read in place (flash will do); bytes behind the blob are
// ignored. They must not change or go away while `model`, or a generator of it, is in use.
//
// # Safety
// `model` is storage for one `mtn_model`; `blob` points to `blob_bytes` readable bytes.
struct mtn_result mtn_model_open(struct mtn_model *model, const void *blob, size_t blob_bytes);

// Sets steps and guidance of a request to what the model's planner is meant for. Other planners than that of
// `mtn_request_default` need it: MoMask's takes ten steps at guidance 4, T2M-GPT's is not guided.
//
// # Safety
// `model` is zeroed storage or one that `mtn_model_open` was called with; `request` is valid.
struct mtn_result mtn_request_for(const struct mtn_model *model, struct mtn_request *request);

// Numbers of a vector that the model takes as a prompt into `width`; 0 for models that take words.
//
// # Safety
// `model` is zeroed storage or one that `mtn_model_open` was called with; `width` is valid.
struct mtn_result mtn_model_vector_width(const struct mtn_model *model, size_t *width);

// Says what the largest request inside `limits` will need: bytes of arena, exactly, and multiply-accumulates at
// most.
//
// # Safety
// `model` is zeroed storage or one that `mtn_model_open` was called with; `limits` and `plan` are valid.
struct mtn_result mtn_model_plan(const struct mtn_model *model, const struct mtn_limits *limits, struct mtn_plan *plan);

// A request for nothing yet: five steps, guidance 2, exact anchors, planted feet, the model's own body, seed 0, the length that the text
// suggests, neither tracks nor obstacles nor a timeline.
struct mtn_request mtn_request_default(void);

// Makes a generator of `model` that works in `arena` and nowhere else.
//
// The generator has its own copy of the model's state: `model` may be used for something else afterwards, the blob
// may not. `arena`: `arena_bytes` bytes with any content, for this generator alone; how many, `mtn_model_plan` says.
//
// # Safety
// `generator` is storage for one `mtn_generator`; `model` is zeroed storage or one that `mtn_model_open` was called
// with; `arena` points to `arena_bytes` bytes.
struct mtn_result mtn_generator_open(struct mtn_generator *generator,
                                     const struct mtn_model *model,
                                     void *arena,
                                     size_t arena_bytes);

// Has `rows` rows of the planner pass through a layer at a time, and of the decoder half as many tokens more, from now on, instead of
// `MTN_ROWS`: 4 to 24, other numbers count as the nearest of these. Weights are read once for so many, so more are faster, most of
// all where the blob lies in slow flash; each takes room, which `mtn_model_plan` says for the same `rows` in its limits. The motion
// is the same.
//
// # Safety
// As of `mtn_generate`.
struct mtn_result mtn_generator_set_rows(struct mtn_generator *generator,
                                         size_t rows);

// Makes the motion of `request`. `progress` may be null; `context` is handed to it. On an error `motion` is left
// alone and the generator can be used again at once.
//
// # Safety
// `generator` is zeroed storage or one that `mtn_generator_open` was called with, used by one thread at a time;
// `request` and all it points to are readable; `motion` is room for one `mtn_motion`.
struct mtn_result mtn_generate(struct mtn_generator *generator,
                               const struct mtn_request *request,
                               mtn_progress_fn progress,
                               void *context,
                               struct mtn_motion *motion);

// Runs the self-test that the blob carries: decodes a motion and compares its hash, to prove that this machine
// computes the same bits as the one that wrote the blob. `MTN_ERROR_SELF_TEST_FAILED` when not,
// `MTN_ERROR_NO_SELF_TEST` without one.
//
// # Safety
// As of `mtn_generate`.
struct mtn_result mtn_self_test(struct mtn_generator *generator);

// Hash over every bit of embeddings and joints, into `hash`: equal on every machine for the same request and blob.
//
// # Safety
// `motion` came from `mtn_generate` and its generator has not been used since; `hash` is room for a number.
struct mtn_result mtn_motion_hash(const struct mtn_motion *motion, uint64_t *hash);

// What the prompt was understood as, in English, zero-terminated, into `text`: `a person waves the right hand, angrily (0.86)`, or
// `hardly anything; nearest: ...` and up to three phrases, `, then ` between clauses; empty where there is nothing to say. What does not fit
// into `bytes` is left out; 256 hold everything that the bundled models say of a clause.
//
// # Safety
// As of `mtn_generate`; `motion` came from this generator; `text` points to `bytes` bytes, at least 1.
struct mtn_result mtn_motion_understood(struct mtn_generator *generator,
                                        const struct mtn_motion *motion,
                                        char *text,
                                        size_t bytes);

// The same of one clause: of the prompt of a span, `motion.spans[i].understood`.
//
// # Safety
// As of `mtn_generate`; `understood` came from a motion of this generator; `text` points to `bytes` bytes, at least 1.
struct mtn_result mtn_understood_in_words(struct mtn_generator *generator,
                                          const struct mtn_understood *understood,
                                          char *text,
                                          size_t bytes);

#ifdef __cplusplus
}  // extern "C"
#endif  // __cplusplus

#endif  /* MOTIONETTE_H */
