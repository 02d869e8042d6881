//! Conditions as they are sent.

use core::fmt;

use motionette::{
    Course, MAX_OBSTACLES, MAX_SPANS, MAX_TRACKS, Obstacle, ObstacleError, Prompt, PromptError, Shape, Span,
    TimelineError, Track, TrackError,
};

use super::{
    BOX, CAPSULE, CYLINDER, FORMAT, HEADER, KEYFRAME, KEYFRAMES, MASKED, MOVING, OBSTACLE, PLANE, SPAN, SPHERE, STILL,
    STORED, TEXT, TRACK, VECTOR, WITH_KEYFRAMES,
};
use crate::message::TEXT_BYTES;

/// Conditions that are to be sent: fields of [`motionette::Request`].
#[derive(Debug, Clone, Copy, Default)]
pub struct Given<'g> {
    /// Where joints are to be at many frames.
    pub tracks: &'g [Track<'g>],
    /// What the figure keeps clear of.
    pub obstacles: &'g [Obstacle<'g>],
    /// What parts of the body do instead, over spans of the motion.
    pub timeline: &'g [Span<'g>],
    /// The prompt as a vector of the encoder that the model was trained with.
    pub vector: Option<&'g [f32]>,
}

/// Why conditions cannot be sent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Unfit {
    /// Too many tracks, one that is too long, or a mask of another length than the positions.
    Track(TrackError),
    /// Too many obstacles.
    Obstacle(ObstacleError),
    /// Too many keyframes.
    Keyframes {
        /// Keyframes of all obstacles.
        found: usize,
        /// Most there may be.
        limit: usize,
    },
    /// The vector of the prompt is empty or too long.
    Vector {
        /// Its numbers.
        found: usize,
        /// Most there may be.
        limit: usize,
    },
    /// Too many spans, or one whose prompt is too long.
    Timeline(TimelineError),
    /// The prompt of a span is a vector that is too long.
    SpanVector {
        /// Span at fault.
        index: u8,
        /// Numbers of its vector.
        found: usize,
        /// Most there may be.
        limit: usize,
    },
}

impl fmt::Display for Unfit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Unfit::Track(error) => error.fmt(f),
            Unfit::Obstacle(error) => error.fmt(f),
            Unfit::Keyframes { found, limit } => {
                write!(f, "the obstacles have {found} keyframes, a request over the link has at most {limit}")
            }
            Unfit::Vector { found, limit } => {
                write!(f, "the prompt is a vector of {found} numbers, a request over the link takes 1 to {limit}")
            }
            Unfit::Timeline(error) => error.fmt(f),
            Unfit::SpanVector { index, found, limit } => {
                write!(f, "span {index}: the prompt is a vector of {found} numbers, the link takes up to {limit}")
            }
        }
    }
}

impl core::error::Error for Unfit {
    fn source(&self) -> Option<&(dyn core::error::Error + 'static)> {
        match self {
            Unfit::Track(error) => Some(error),
            Unfit::Obstacle(error) => Some(error),
            Unfit::Timeline(error) => Some(error),
            _ => None,
        }
    }
}

/// Most positions of a track, and numbers of a vector.
const MOST: usize = u16::MAX as usize;

impl Given<'_> {
    /// Whether there is nothing to send.
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.tracks.is_empty() && self.obstacles.is_empty() && self.timeline.is_empty() && self.vector.is_none()
    }

    /// Whether they can be sent.
    ///
    /// # Errors
    /// [`Unfit`].
    pub fn check(&self) -> Result<(), Unfit> {
        let (tracks, obstacles) = (self.tracks.len(), self.obstacles.len());
        if tracks > MAX_TRACKS {
            return Err(Unfit::Track(TrackError::TooMany { tracks, limit: MAX_TRACKS }));
        }
        for (index, track) in self.tracks.iter().enumerate() {
            let positions = track.positions.len();
            if positions > MOST {
                let frame = usize::from(track.first).saturating_add(positions - 1);
                return Err(Unfit::Track(TrackError::FrameOutOfRange { index, frame, frames: MOST }));
            }
            match track.mask {
                Some(mask) if mask.len() != positions => {
                    return Err(Unfit::Track(TrackError::Mask { index, found: mask.len(), positions }));
                }
                _ => {}
            }
        }
        if obstacles > MAX_OBSTACLES {
            return Err(Unfit::Obstacle(ObstacleError::TooMany { obstacles, limit: MAX_OBSTACLES }));
        }
        let found = self.obstacles.iter().map(keyframes).fold(0, usize::saturating_add);
        if found > KEYFRAMES {
            return Err(Unfit::Keyframes { found, limit: KEYFRAMES });
        }
        check_timeline(self.timeline)?;
        match self.vector.map(<[f32]>::len) {
            Some(found @ 0) => Err(Unfit::Vector { found, limit: MOST }),
            Some(found) if found > MOST => Err(Unfit::Vector { found, limit: MOST }),
            _ => Ok(()),
        }
    }

    /// Bytes of these conditions on the wire.
    ///
    /// # Errors
    /// [`Unfit`].
    pub fn bytes(&self) -> Result<u32, Unfit> {
        self.check()?;
        let track =
            |track: &Track<'_>| TRACK + 3 * track.positions.len() + track.mask.map_or(0, |mask| mask.len().div_ceil(4));
        let obstacle = |obstacle: &Obstacle<'_>| {
            let shape = match obstacle.shape {
                Shape::Sphere { .. } => 1,
                Shape::Cylinder { .. } => 2,
                Shape::Box { .. } | Shape::Plane { .. } => 3,
                Shape::Capsule { .. } => 4,
            };
            let course = match obstacle.course {
                Course::Still(_) => 3,
                Course::Moving { .. } => 6,
                Course::Keyframes(frames) => KEYFRAME * frames.len(),
            };
            OBSTACLE + shape + course
        };
        let tracks: usize = self.tracks.iter().map(track).sum();
        let obstacles: usize = self.obstacles.iter().map(obstacle).sum();
        let span = |span: &Span<'_>| match span.prompt {
            Prompt::Text(text) | Prompt::Bank(text) => SPAN + text.len().div_ceil(4),
            Prompt::Vector(vector) => SPAN + vector.len(),
        };
        let spans: usize = self.timeline.iter().map(span).sum();
        let words = HEADER + self.vector.map_or(0, <[f32]>::len) + tracks + obstacles + spans;
        // No more than 24 tracks of 64 Ki positions, and nine vectors as long.
        Ok(4 * words as u32)
    }

    /// Puts these conditions, as they are sent, behind what `out` holds.
    ///
    /// # Errors
    /// [`Unfit`]; `out` is as before.
    pub fn write(&self, out: &mut impl Extend<u8>) -> Result<(), Unfit> {
        let mut out = Out(out);
        out.word(self.bytes()?);
        out.bytes([FORMAT, self.tracks.len() as u8, self.obstacles.len() as u8, self.timeline.len() as u8]);
        let vector = self.vector.unwrap_or_default();
        out.word(vector.len() as u32);
        out.numbers(vector);
        for track in self.tracks {
            let axes = track.axes.iter().zip([1, 2, 4]).filter(|(counts, _)| **counts);
            let flags = axes.fold(0, |flags, (_, axis)| flags | axis);
            let [low, high] = track.first.to_le_bytes();
            out.bytes([track.joint, if track.mask.is_some() { flags | MASKED } else { flags }, low, high]);
            out.word(track.positions.len() as u32);
            out.numbers(&[track.tolerance]);
            for position in track.positions {
                out.numbers(position);
            }
            out.filled(track.mask.unwrap_or_default());
        }
        for obstacle in self.obstacles {
            out.obstacle(obstacle);
        }
        for span in self.timeline {
            out.span(span);
        }
        Ok(())
    }
}

/// Whether spans can be sent.
fn check_timeline(spans: &[Span<'_>]) -> Result<(), Unfit> {
    if spans.len() > MAX_SPANS {
        return Err(Unfit::Timeline(TimelineError::TooMany { spans: spans.len(), limit: MAX_SPANS }));
    }
    for (index, span) in (0u8..).zip(spans) {
        match span.prompt {
            Prompt::Text(text) | Prompt::Bank(text) if text.len() > TEXT_BYTES => {
                let error = PromptError::TooLong { found: text.len(), limit: TEXT_BYTES };
                return Err(Unfit::Timeline(TimelineError::Prompt { index, error }));
            }
            Prompt::Vector(vector) if vector.len() > MOST => {
                return Err(Unfit::SpanVector { index, found: vector.len(), limit: MOST });
            }
            _ => {}
        }
    }
    Ok(())
}

/// Keyframes of an obstacle.
const fn keyframes(obstacle: &Obstacle<'_>) -> usize {
    match obstacle.course {
        Course::Keyframes(frames) => frames.len(),
        _ => 0,
    }
}

/// Where words go.
struct Out<'o, E>(&'o mut E);

impl<E: Extend<u8>> Out<'_, E> {
    fn bytes(&mut self, bytes: [u8; 4]) {
        self.0.extend(bytes);
    }

    /// Bytes, filled up to whole words.
    fn filled(&mut self, bytes: &[u8]) {
        for four in bytes.chunks(4) {
            let mut word = [0; 4];
            word.iter_mut().zip(four).for_each(|(to, byte)| *to = *byte);
            self.bytes(word);
        }
    }

    fn word(&mut self, word: u32) {
        self.bytes(word.to_le_bytes());
    }

    fn numbers(&mut self, numbers: &[f32]) {
        for number in numbers {
            self.word(number.to_bits());
        }
    }

    fn obstacle(&mut self, obstacle: &Obstacle<'_>) {
        let shape = match obstacle.shape {
            Shape::Sphere { .. } => SPHERE,
            Shape::Capsule { .. } => CAPSULE,
            Shape::Cylinder { .. } => CYLINDER,
            Shape::Box { .. } => BOX,
            Shape::Plane { .. } => PLANE,
        };
        let course = match obstacle.course {
            Course::Still(_) => STILL,
            Course::Moving { .. } => MOVING,
            Course::Keyframes(_) => WITH_KEYFRAMES,
        };
        // They were counted.
        let [low, high] = (keyframes(obstacle) as u16).to_le_bytes();
        self.bytes([shape, course, low, high]);
        self.word(obstacle.joints);
        self.numbers(&[obstacle.margin]);
        match obstacle.shape {
            Shape::Sphere { radius } => self.numbers(&[radius]),
            Shape::Capsule { half: [x, y, z], radius } => self.numbers(&[x, y, z, radius]),
            Shape::Cylinder { radius, half_height } => self.numbers(&[radius, half_height]),
            Shape::Box { half } => self.numbers(&half),
            Shape::Plane { normal } => self.numbers(&normal),
        }
        match obstacle.course {
            Course::Still(position) => self.numbers(&position),
            Course::Moving { from, velocity } => {
                self.numbers(&from);
                self.numbers(&velocity);
            }
            Course::Keyframes(frames) => {
                for key in frames {
                    self.word(u32::from(key.frame));
                    self.numbers(&key.position);
                }
            }
        }
    }
    fn span(&mut self, span: &Span<'_>) {
        let (kind, text, vector) = match span.prompt {
            Prompt::Text(text) => (TEXT, text, &[][..]),
            Prompt::Bank(name) => (STORED, name, &[][..]),
            Prompt::Vector(vector) => (VECTOR, "", vector),
        };
        // One of the two is empty, and neither is too long.
        let [low, high] = ((text.len() + vector.len()) as u16).to_le_bytes();
        self.bytes([span.parts.bits(), kind, low, high]);
        self.word(u32::from(span.first) | u32::from(span.frames) << 16);
        self.filled(text.as_bytes());
        self.numbers(vector);
    }
}
