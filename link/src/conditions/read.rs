//! Conditions as they lie in memory, read.

use bytemuck::AnyBitPattern;
use heapless::Vec;
use motionette::{
    BodyParts, Course, Keyframe, MAX_OBSTACLES, MAX_SPANS, MAX_TRACKS, Obstacle, Prompt, Shape, Span, Track,
};

use super::{
    BOX, CAPSULE, CYLINDER, FORMAT, HEADER, KEYFRAME, KEYFRAMES, MASKED, MOVING, PLANE, SPHERE, STILL, STORED, TEXT,
    VECTOR, WITH_KEYFRAMES,
};
use crate::message::{ConditionsFault, TEXT_BYTES};

/// Conditions that lie whole in memory. Their form has been checked, what they ask for has not: the runtime checks that of a request.
#[derive(Debug, Clone, Copy)]
pub struct Conditions<'c> {
    tracks: Words<'c>,
    obstacles: Words<'c>,
    timeline: Words<'c>,
    counts: [usize; 3],
    vector: &'c [f32],
    bytes: usize,
}

impl<'c> Conditions<'c> {
    /// Reads the conditions at the beginning of `area`.
    ///
    /// # Errors
    /// [`ConditionsFault::Format`]: they are not of this format, or do not end where they say.
    pub fn open(area: &'c [u32]) -> Result<Self, ConditionsFault> {
        let bytes = area.first().map_or(0, |length| *length as usize);
        let whole = bytes.is_multiple_of(4).then(|| area.get(..bytes / 4)).flatten();
        let mut words = Words { all: whole.ok_or(ConditionsFault::Format { at: 0 })?, at: 0 };
        let [_, kinds, numbers] = words.array()?;
        let [format, counts @ ..] = kinds.to_le_bytes();
        let counts = counts.map(usize::from);
        let few = counts.iter().zip([MAX_TRACKS, MAX_OBSTACLES, MAX_SPANS]).all(|(count, most)| *count <= most);
        if format != FORMAT || !few || numbers >> 16 != 0 {
            return Err(fault(1));
        }
        let vector = cast(words.take(numbers as usize)?);
        let tracks = words;
        for _ in 0..counts[0] {
            words.track()?;
        }
        let obstacles = words;
        let mut keyframes = 0;
        for _ in 0..counts[1] {
            let at = words.at;
            keyframes += words.obstacle()?.keyframes().len();
            if keyframes > KEYFRAMES {
                return Err(fault(at));
            }
        }
        let timeline = words;
        for _ in 0..counts[2] {
            words.span()?;
        }
        if words.at != words.all.len() {
            return Err(fault(words.at));
        }
        Ok(Conditions { tracks, obstacles, timeline, counts, vector, bytes })
    }

    /// Their bytes.
    #[must_use]
    pub const fn bytes(&self) -> usize {
        self.bytes
    }

    /// The prompt's vector, where they have one.
    #[must_use]
    pub fn vector(&self) -> Option<&'c [f32]> {
        (!self.vector.is_empty()).then_some(self.vector)
    }

    /// The tracks, whose positions and masks stay where they lie.
    #[must_use]
    pub fn tracks(&self) -> Vec<Track<'c>, MAX_TRACKS> {
        let mut words = self.tracks;
        let mut tracks = Vec::new();
        for track in (0..self.counts[0]).map_while(|_| words.track().ok()) {
            // There are no more: they were counted.
            let _ = tracks.push(track);
        }
        tracks
    }

    /// The keyframes of all obstacles, one obstacle's behind the other's.
    #[must_use]
    pub fn keyframes(&self) -> Vec<Keyframe, KEYFRAMES> {
        let mut keyframes = Vec::new();
        for [frame, position @ ..] in self.bodies().flat_map(|body| body.keyframes()) {
            let _ = keyframes.push(Keyframe { frame: *frame as u16, position: position.map(f32::from_bits) });
        }
        keyframes
    }

    /// The obstacles, with [`Conditions::keyframes`] put in a place of the caller's.
    #[must_use]
    pub fn obstacles<'k>(&self, keyframes: &'k [Keyframe]) -> Vec<Obstacle<'k>, MAX_OBSTACLES> {
        let mut obstacles = Vec::new();
        let mut left = keyframes;
        for Body { shape, way, margin, joints } in self.bodies() {
            let course = match way {
                Way::Still(position) => Course::Still(position),
                Way::Moving([from, velocity]) => Course::Moving { from, velocity },
                Way::Keyframes(frames) => {
                    let (own, others) = left.split_at_checked(frames.len()).unwrap_or((left, &[]));
                    left = others;
                    Course::Keyframes(own)
                }
            };
            let _ = obstacles.push(Obstacle { shape, course, margin, joints });
        }
        obstacles
    }

    /// The spans of the timeline, whose prompts stay where they lie.
    #[must_use]
    pub fn timeline(&self) -> Vec<Span<'c>, MAX_SPANS> {
        let mut words = self.timeline;
        let mut timeline = Vec::new();
        for span in (0..self.counts[2]).map_while(|_| words.span().ok()) {
            let _ = timeline.push(span);
        }
        timeline
    }

    fn bodies(&self) -> impl Iterator<Item = Body<'c>> + use<'c> {
        let mut words = self.obstacles;
        (0..self.counts[1]).map_while(move |_| words.obstacle().ok())
    }
}

/// The word `at` makes no sense.
fn fault(at: usize) -> ConditionsFault {
    ConditionsFault::Format { at: u32::try_from(4 * at).unwrap_or(u32::MAX) }
}

/// Words as what they are, `T` being of whole words.
fn cast<T: AnyBitPattern>(words: &[u32]) -> &[T] {
    bytemuck::try_cast_slice(words).unwrap_or_default()
}

/// An obstacle whose keyframes still lie in memory.
struct Body<'c> {
    shape: Shape,
    way: Way<'c>,
    margin: f32,
    joints: u32,
}

enum Way<'c> {
    Still([f32; 3]),
    Moving([[f32; 3]; 2]),
    Keyframes(&'c [[u32; KEYFRAME]]),
}

impl<'c> Body<'c> {
    const fn keyframes(&self) -> &'c [[u32; KEYFRAME]] {
        match self.way {
            Way::Keyframes(frames) => frames,
            _ => &[],
        }
    }
}

/// Words, and where reading stands among them.
#[derive(Debug, Clone, Copy)]
struct Words<'c> {
    all: &'c [u32],
    at: usize,
}

impl<'c> Words<'c> {
    fn take(&mut self, count: usize) -> Result<&'c [u32], ConditionsFault> {
        let taken = self.all.get(self.at..).and_then(|left| left.get(..count)).ok_or(fault(self.all.len()))?;
        self.at += count;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u32; N], ConditionsFault> {
        let end = self.all.len();
        self.take(N)?.first_chunk().copied().ok_or(fault(end))
    }

    fn numbers<const N: usize>(&mut self) -> Result<[f32; N], ConditionsFault> {
        Ok(self.array()?.map(f32::from_bits))
    }

    /// Bytes that are filled up to whole words.
    fn bytes(&mut self, count: usize) -> Result<&'c [u8], ConditionsFault> {
        let bytes: &[u8] = cast(self.take(count.div_ceil(4))?);
        Ok(bytes.get(..count).unwrap_or_default())
    }

    fn text(&mut self, count: usize) -> Result<&'c str, ConditionsFault> {
        let at = self.at;
        core::str::from_utf8(self.bytes(count)?).map_err(|_| fault(at))
    }

    fn track(&mut self) -> Result<Track<'c>, ConditionsFault> {
        let at = self.at;
        let [what, count, tolerance] = self.array()?;
        let [joint, flags, first @ ..] = what.to_le_bytes();
        if flags > MASKED | 7 || count >> 16 != 0 {
            return Err(fault(at));
        }
        let count = count as usize;
        let positions = cast(self.take(3 * count)?);
        let mask = if flags & MASKED != 0 { Some(self.bytes(count)?) } else { None };
        let axes = [1, 2, 4].map(|axis| flags & axis != 0);
        let tolerance = f32::from_bits(tolerance);
        Ok(Track { joint, first: u16::from_le_bytes(first), axes, mask, positions, tolerance })
    }

    fn obstacle(&mut self) -> Result<Body<'c>, ConditionsFault> {
        let at = self.at;
        let [what, joints, margin] = self.array()?;
        let [shape, course, count @ ..] = what.to_le_bytes();
        let count = usize::from(u16::from_le_bytes(count));
        let shape = match shape {
            SPHERE => {
                let [radius] = self.numbers()?;
                Shape::Sphere { radius }
            }
            CAPSULE => {
                let [x, y, z, radius] = self.numbers()?;
                Shape::Capsule { half: [x, y, z], radius }
            }
            CYLINDER => {
                let [radius, half_height] = self.numbers()?;
                Shape::Cylinder { radius, half_height }
            }
            BOX => Shape::Box { half: self.numbers()? },
            PLANE => Shape::Plane { normal: self.numbers()? },
            _ => return Err(fault(at)),
        };
        let way = match (course, count) {
            (STILL, 0) => Way::Still(self.numbers()?),
            (MOVING, 0) => Way::Moving([self.numbers()?, self.numbers()?]),
            (WITH_KEYFRAMES, _) => {
                let frames: &[[u32; KEYFRAME]] = cast(self.take(KEYFRAME * count)?);
                if frames.iter().any(|[frame, ..]| frame >> 16 != 0) {
                    return Err(fault(at));
                }
                Way::Keyframes(frames)
            }
            _ => return Err(fault(at)),
        };
        Ok(Body { shape, way, margin: f32::from_bits(margin), joints })
    }

    fn span(&mut self) -> Result<Span<'c>, ConditionsFault> {
        let at = self.at;
        let [what, when] = self.array()?;
        let [parts, kind, count @ ..] = what.to_le_bytes();
        let [first, frames] = [when as u16, (when >> 16) as u16];
        let parts = BodyParts::from_bits(parts).ok_or(fault(at))?;
        let prompt = match (kind, usize::from(u16::from_le_bytes(count))) {
            (TEXT, count) if count <= TEXT_BYTES => Prompt::Text(self.text(count)?),
            (STORED, count) if count <= TEXT_BYTES => Prompt::Bank(self.text(count)?),
            (VECTOR, count) => Prompt::Vector(cast(self.take(count)?)),
            _ => return Err(fault(at)),
        };
        Ok(Span { parts, first, frames, prompt })
    }
}

const _: () = assert!(HEADER == 3, "as many as `Conditions::open` reads");
