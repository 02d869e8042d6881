//! One object of the list of tracks: its fields, then a track.

use motionette::Track;

use super::{Error, Place};
use crate::entries::{self, Entry, Fault, Node};

/// Fields a track may have.
const FIELDS: [&str; 8] = ["joint", "time", "frame", "positions", "mask", "axes", "tolerance", "frame_rate"];
/// Names of the axes.
pub(super) const AXES: [char; 3] = ['x', 'y', 'z'];
/// Most positions a second.
const FASTEST: f32 = 10_000.0;
/// A frame that is no farther from a position than this share of their distance is at the position: times are decimal, frames are not.
const NEAR: f64 = 1e-6;

/// Positions; none where the joint is free.
type Places = Vec<Option<[f32; 3]>>;

/// Where a joint is to be, a frame at a time, with its positions.
#[derive(Debug, Clone, PartialEq)]
pub struct OwnedTrack {
    /// Joint in SMPL order, 0 to 21.
    pub joint: u8,
    /// Frame of the first position.
    pub first: u16,
    /// Which of x, y, z count.
    pub axes: [bool; 3],
    /// Which positions count, 0 for those that do not; `None`: all.
    pub mask: Option<Vec<u8>>,
    /// Where the joint is to be, one a frame, metres; 0 where that does not count.
    pub positions: Vec<[f32; 3]>,
    /// How loosely it is followed, metres.
    pub tolerance: f32,
}

impl OwnedTrack {
    /// As a request takes it.
    #[must_use]
    pub fn borrowed(&self) -> Track<'_> {
        Track {
            joint: self.joint,
            first: self.first,
            axes: self.axes,
            mask: self.mask.as_deref(),
            positions: &self.positions,
            tolerance: self.tolerance,
        }
    }

    /// Whether a position counts.
    pub(super) fn counts(&self, number: usize) -> bool {
        self.mask.as_ref().is_none_or(|mask| mask.get(number).is_some_and(|counts| *counts != 0))
    }
}

/// The track in a motion of `frame_rate` frames a second, or what is wrong with the object.
pub(super) fn track(entry: &Entry, index: usize, frame_rate: u16) -> Result<OwnedTrack, Error> {
    let place = Place::track(index);
    let fault = |fault: Fault| Error::Field { place, fault };
    let missing = |field, example| Error::Missing { place, field, example };
    let [joint, time, frame, positions, mask, axes, tolerance, rate] = entry.fields(&FIELDS).map_err(fault)?;
    let joint = joint.ok_or(missing("joint", r#""joint": "right_wrist""#))?;
    let joint = entries::joint("joint", joint).map_err(fault)?;
    let first = entries::frame(time, frame, frame_rate).map_err(fault)?;
    let positions = positions.ok_or(missing("positions", r#""positions": [[x, y, z], ...], one a frame"#))?;
    let places = places(positions).map_err(fault)?;
    let mask = mask.map(counts).transpose().map_err(fault)?;
    if let Some(mask) = mask.as_ref().filter(|mask| mask.len() != places.len()) {
        return Err(Error::Mask { index, found: mask.len(), positions: places.len() });
    }
    let masked = |number: usize| mask.as_ref().is_none_or(|mask| mask[number]);
    let places: Vec<_> = places.into_iter().enumerate().map(|(n, place)| place.filter(|_| masked(n))).collect();
    if places.iter().all(Option::is_none) {
        return Err(Error::Nothing { index });
    }
    let axes = axes.map_or(Ok([true; 3]), named_axes).map_err(fault)?;
    let tolerance =
        tolerance.map(|t| entries::number("tolerance", "a number of metres", t)).transpose().map_err(fault)?;
    let tolerance = tolerance.unwrap_or(0.0);
    if !(0.0..=1.0).contains(&tolerance) {
        return Err(Error::Range { place, field: "tolerance", value: tolerance, range: "0 to 1 m" });
    }
    let rate = rate.map(|rate| entries::number("frame_rate", "a number of positions a second", rate));
    let (first, places) = match rate.transpose().map_err(fault)? {
        None => (u64::from(first), places),
        Some(rate) if rate > 0.0 && rate <= FASTEST => {
            let start = match time {
                Some(time) => entries::seconds("time", time).map_err(fault)?,
                None => f64::from(first) / f64::from(frame_rate.max(1)),
            };
            resampled(index, &places, (start, f64::from(rate)), frame_rate)?
        }
        Some(value) => {
            return Err(Error::Range { place, field: "frame_rate", value, range: "above 0 and at most 10000" });
        }
    };
    let last = first + places.len() as u64 - 1;
    if last > u64::from(u16::MAX) {
        return Err(Error::TooLong { index, frame: last });
    }
    let all = places.iter().all(Option::is_some);
    let mask = (!all).then(|| places.iter().map(|place| u8::from(place.is_some())).collect());
    let positions = places.into_iter().map(Option::unwrap_or_default).collect();
    Ok(OwnedTrack { joint, first: first as u16, axes, mask, positions, tolerance })
}

/// Positions; none for `null`.
fn places(value: &Node) -> Result<Places, Fault> {
    const EXPECTED: &str = "a list of positions, each [x, y, z] or null";
    let list = value.as_list().ok_or_else(|| entries::wrong("positions", EXPECTED, value))?;
    let place = |node: &Node| {
        let place = || entries::coordinates("positions", EXPECTED, node).map(Some);
        if node.is_null() { Ok(None) } else { place() }
    };
    list.iter().map(place).collect()
}

/// The entries of a mask.
fn counts(value: &Node) -> Result<Vec<bool>, Fault> {
    let mismatch = |found: &Node| entries::wrong("mask", "a list of 0 and 1, one for each position", found);
    let list = value.as_list().ok_or_else(|| mismatch(value))?;
    let count = |node: &Node| match node.as_u64() {
        Some(0) => Ok(false),
        Some(1) => Ok(true),
        _ => Err(mismatch(node)),
    };
    list.iter().map(count).collect()
}

/// Axes by their letters.
fn named_axes(value: &Node) -> Result<[bool; 3], Fault> {
    let mismatch = || entries::wrong("axes", r#"some of the letters x, y and z, each once, as in "xz""#, value);
    let mut axes = [false; 3];
    for letter in value.as_str().filter(|letters| !letters.is_empty()).ok_or_else(mismatch)?.chars() {
        let axis = AXES.iter().position(|axis| *axis == letter).ok_or_else(mismatch)?;
        if std::mem::replace(&mut axes[axis], true) {
            return Err(mismatch());
        }
    }
    Ok(axes)
}

/// Positions that come `rate` a second from `start`, seconds, on, at the frames of a model: the first of these frames, and a place each, in a
/// straight line between two neighbours; none where one of these does not count.
fn resampled(
    index: usize,
    places: &[Option<[f32; 3]>],
    (start, rate): (f64, f64),
    frame_rate: u16,
) -> Result<(u64, Places), Error> {
    let frames = f64::from(frame_rate.max(1));
    let end = (start + (places.len() - 1) as f64 / rate) * frames;
    let [first, last] = [(start * frames - NEAR).ceil(), (end + NEAR).floor()];
    if last > f64::from(u16::MAX) {
        return Err(Error::TooLong { index, frame: last as u64 });
    }
    let at = |frame: u64| {
        let along = ((frame as f64 / frames - start) * rate).max(0.0);
        let near = along.round();
        if (along - near).abs() <= NEAR * (rate / frames).max(1.0) {
            return places.get(near as usize).copied().flatten();
        }
        let (before, share) = (along.floor() as usize, along.fract());
        let [a, b] = [before, before + 1].map(|number| places.get(number).copied().flatten());
        let (a, b) = (a?, b?);
        Some(std::array::from_fn(|axis| {
            (f64::from(a[axis]) + share * (f64::from(b[axis]) - f64::from(a[axis]))) as f32
        }))
    };
    // As integers: a range of floats is none.
    let (first, count) = (first as u64, (last - first + 1.0).max(0.0) as u64);
    let places: Places = (first..first + count).map(at).collect();
    if places.iter().all(Option::is_none) {
        return Err(Error::BetweenFrames { index, frame_rate });
    }
    Ok((first, places))
}
