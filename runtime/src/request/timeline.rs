//! A body-part timeline: prompts of their own for parts of the body, each over a span of one motion (ControlMM 4.4).

use core::fmt;

use super::prompt::{Prompt, PromptError};

/// Most spans of a request.
pub const MAX_SPANS: usize = 8;
/// Spans of a request of this build: none without cargo feature `timeline`.
pub const LINKED_SPANS: usize = if cfg!(feature = "timeline") { MAX_SPANS } else { 0 };
/// Frames of a span at least: two tokens, less is over before it is seen.
pub const LEAST_SPAN: u16 = 8;

/// Parts of the body, a set. What is not in it goes on as it would without the span.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct BodyParts(u8);

/// The trunk above the pelvis: never without head and arms, which it carries.
const TRUNK: u8 = 32;

impl BodyParts {
    /// No part: the beginning of a set.
    pub const NONE: Self = Self(0);
    /// How the head is held on the neck.
    pub const HEAD: Self = Self(1);
    /// Left shoulder, elbow and wrist, as the chest carries them.
    pub const LEFT_ARM: Self = Self(2);
    /// Right shoulder, elbow and wrist, as the chest carries them.
    pub const RIGHT_ARM: Self = Self(4);
    /// Left knee, ankle and foot, as the pelvis carries them.
    pub const LEFT_LEG: Self = Self(8);
    /// Right knee, ankle and foot, as the pelvis carries them.
    pub const RIGHT_LEG: Self = Self(16);
    /// All above the pelvis: spine, chest, head and both arms.
    pub const UPPER_BODY: Self = Self(TRUNK | 7);
    /// Both arms.
    pub const ARMS: Self = Self(6);
    /// Both legs.
    pub const LEGS: Self = Self(24);
    /// Names of the sets above, from the smallest.
    pub const NAMED: [(&str, Self); 8] = [
        ("head", Self::HEAD),
        ("left_arm", Self::LEFT_ARM),
        ("right_arm", Self::RIGHT_ARM),
        ("left_leg", Self::LEFT_LEG),
        ("right_leg", Self::RIGHT_LEG),
        ("arms", Self::ARMS),
        ("legs", Self::LEGS),
        ("upper_body", Self::UPPER_BODY),
    ];

    /// The parts of both.
    #[must_use]
    pub const fn and(self, other: Self) -> Self {
        Self(self.0 | other.0)
    }

    /// The parts that are in both.
    #[must_use]
    pub const fn common(self, other: Self) -> Self {
        Self(self.0 & other.0)
    }

    /// Whether there is none.
    #[must_use]
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Whether it has all parts of `other`.
    #[must_use]
    pub const fn has(self, other: Self) -> bool {
        self.0 & other.0 == other.0
    }

    /// Directions of bones that a span of these parts keeps for each of its frames.
    #[must_use]
    pub fn directions(self) -> usize {
        crate::representation::posture::count(self)
    }

    /// Joints that a span of these parts moves, as bits.
    #[must_use]
    pub fn joints(self) -> u32 {
        crate::representation::posture::joints(self)
    }

    /// The set as bits, as [`BodyParts::from_bits`] takes it: head 1, left arm 2, right arm 4, left leg 8, right leg 16, trunk 32.
    #[must_use]
    pub const fn bits(self) -> u8 {
        self.0
    }

    /// The set of these bits; `None` for bits that no part has, and for a trunk without the head and arms that it carries.
    #[must_use]
    pub const fn from_bits(bits: u8) -> Option<Self> {
        let carried = bits & TRUNK == 0 || bits & 7 == 7;
        if bits < 64 && carried { Some(Self(bits)) } else { None }
    }

    /// The set of one of [`BodyParts::NAMED`], in any case, with `_`, `-` or a space between words.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        let plain = |byte: u8| if matches!(byte, b' ' | b'-') { b'_' } else { byte.to_ascii_lowercase() };
        let found = Self::NAMED.iter().find(|(known, _)| known.bytes().eq(name.bytes().map(plain)));
        found.map(|(_, parts)| *parts)
    }
}

/// A prompt of its own for some parts of the body, over some frames of the motion.
///
/// What it asks for is planned as a motion of its own that long, of which these parts are taken; at both ends, but not at those of the
/// motion, half a second at most leads over. All else is bit by bit what it would be without the span, as far as nothing edits
/// the motion behind it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Span<'r> {
    /// What moves.
    pub parts: BodyParts,
    /// First frame.
    pub first: u16,
    /// Frames, [`LEAST_SPAN`] or more.
    pub frames: u16,
    /// What they do, one clause whatever it says: a span each for what is to be done one behind the other.
    pub prompt: Prompt<'r>,
}

impl<'r> Span<'r> {
    /// `parts` do what `text` says over `frames` frames from `first` on.
    #[must_use]
    pub const fn new(parts: BodyParts, first: u16, frames: u16, text: &'r str) -> Self {
        Span { parts, first, frames, prompt: Prompt::Text(text) }
    }

    /// The frame behind the last.
    #[must_use]
    pub const fn end(&self) -> usize {
        self.first as usize + self.frames as usize
    }

    /// Whether it and `other` move one part at one frame.
    const fn overlaps(&self, other: &Span<'_>) -> bool {
        let apart = self.end() <= other.first as usize || other.end() <= self.first as usize;
        !apart && !self.parts.common(other.parts).is_empty()
    }
}

/// Why a timeline was refused. `index` counts in the caller's list.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum TimelineError {
    /// More spans than a request may carry.
    TooMany {
        /// Length of the caller's list.
        spans: usize,
        /// Most spans allowed.
        limit: usize,
    },
    /// A span without parts.
    NoParts {
        /// Span at fault.
        index: u8,
    },
    /// A span of fewer than [`LEAST_SPAN`] frames.
    TooShort {
        /// Span at fault.
        index: u8,
        /// Its frames.
        frames: u16,
    },
    /// A span that ends behind the end of the motion.
    OutOfRange {
        /// Span at fault.
        index: u8,
        /// The frame behind its last.
        end: usize,
        /// Frames of the motion.
        frames: usize,
    },
    /// Two spans that move one part at one frame.
    Overlap {
        /// The earlier span of the two in the caller's list.
        first: u8,
        /// The later one.
        second: u8,
        /// The parts that both move.
        parts: BodyParts,
    },
    /// A span whose prompt was refused.
    Prompt {
        /// Span at fault.
        index: u8,
        /// Why.
        error: PromptError,
    },
}

impl fmt::Display for BodyParts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mut left = *self;
        let mut separator = "";
        for (name, parts) in Self::NAMED.iter().rev() {
            if left.has(*parts) {
                write!(f, "{separator}{name}")?;
                (left, separator) = (Self(left.0 & !parts.0), ", ");
            }
        }
        if separator.is_empty() { f.write_str("no part") } else { Ok(()) }
    }
}

impl fmt::Display for TimelineError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::TooMany { spans, limit } => write!(f, "{spans} spans given, a timeline has at most {limit}"),
            Self::NoParts { index } => write!(f, "span {index} moves no part of the body"),
            Self::TooShort { index, frames } => {
                write!(f, "span {index} has {frames} frames, a span has at least {LEAST_SPAN}")
            }
            Self::OutOfRange { index, end, frames } => {
                write!(f, "span {index} ends with frame {end}, the motion has {frames} frames at most")
            }
            Self::Overlap { first, second, parts } => {
                write!(f, "spans {first} and {second} both move {parts} at the same time")
            }
            Self::Prompt { index, error } => write!(f, "span {index}: {error}"),
        }
    }
}

impl core::error::Error for TimelineError {}

/// Checks spans on their own and against each other, for a motion of at most `frames` frames.
///
/// # Errors
/// The first span at fault, [`TimelineError`].
#[inline(never)]
pub fn check(spans: &[Span<'_>], frames: usize) -> Result<(), TimelineError> {
    if spans.len() > MAX_SPANS {
        return Err(TimelineError::TooMany { spans: spans.len(), limit: MAX_SPANS });
    }
    for (index, span) in (0u8..).zip(spans) {
        if span.parts.is_empty() {
            return Err(TimelineError::NoParts { index });
        }
        if span.frames < LEAST_SPAN {
            return Err(TimelineError::TooShort { index, frames: span.frames });
        }
        if span.end() > frames {
            return Err(TimelineError::OutOfRange { index, end: span.end(), frames });
        }
        let earlier = (0u8..).zip(spans).take(usize::from(index));
        if let Some((first, other)) = { earlier }.find(|(_, other)| other.overlaps(span)) {
            let parts = other.parts.common(span.parts);
            return Err(TimelineError::Overlap { first, second: index, parts });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::string::ToString;

    #[test]
    fn names_and_bits_of_parts() {
        for (name, parts) in BodyParts::NAMED {
            assert_eq!(BodyParts::named(name), Some(parts));
            assert_eq!(BodyParts::named(&name.replace('_', " ").to_uppercase()), Some(parts));
            assert_eq!(BodyParts::from_bits(parts.bits()), Some(parts));
            assert_eq!(parts.to_string(), name);
        }
        assert_eq!(BodyParts::named("tail"), None);
        assert_eq!(BodyParts::NONE.to_string(), "no part");
        assert_eq!(BodyParts::HEAD.and(BodyParts::LEGS).to_string(), "legs, head");
        // A trunk carries head and arms, and there are six bits.
        assert_eq!((0..=255).filter(|bits| BodyParts::from_bits(*bits).is_some()).count(), 32 + 4);
    }

    #[test]
    fn spans_at_fault_are_named() {
        let span = |parts, first, frames| Span::new(parts, first, frames, "a person waves");
        let arm = span(BodyParts::RIGHT_ARM, 10, 20);
        assert_eq!(check(&[arm, span(BodyParts::RIGHT_ARM, 30, 8)], 38), Ok(()), "one behind the other");
        assert_eq!(check(&[arm, span(BodyParts::LEFT_ARM, 0, 38)], 38), Ok(()), "side by side");
        assert_eq!(
            check(&[span(BodyParts::HEAD, 0, 8), arm, span(BodyParts::UPPER_BODY, 29, 8)], 38),
            Err(TimelineError::Overlap { first: 1, second: 2, parts: BodyParts::RIGHT_ARM })
        );
        assert_eq!(check(&[arm, span(BodyParts::NONE, 0, 8)], 38), Err(TimelineError::NoParts { index: 1 }));
        assert_eq!(check(&[span(BodyParts::HEAD, 0, 7)], 38), Err(TimelineError::TooShort { index: 0, frames: 7 }));
        let beyond = Err(TimelineError::OutOfRange { index: 0, end: 30, frames: 29 });
        assert_eq!(check(&[arm], 29), beyond);
        let last = span(BodyParts::HEAD, u16::MAX, u16::MAX);
        assert_eq!(check(&[last], 196), Err(TimelineError::OutOfRange { index: 0, end: 131_070, frames: 196 }));
        assert_eq!(check(&[arm; MAX_SPANS + 1], 196), Err(TimelineError::TooMany { spans: 9, limit: 8 }));
    }
}
