//! Stances: when a foot stands, and what keeps it where it stands.

use crate::numerics::vector::{Vector, dot, subtract};
use crate::representation::Pose;

/// A foot that stands is under this height, metres.
const HEIGHT: f32 = 0.05;
/// And moves no farther than this over the floor from one frame to the next, metres.
const STEP: f32 = 0.04;
/// Stances so few frames apart are one.
const GAP: usize = 2;
/// A stance lasts so many frames at least.
const SHORTEST: usize = 3;
/// Beyond the first and last stance, offsets fade over so many frames.
const FADE: usize = 10;

/// How firmly a stance is held: all the way.
pub const HELD: u8 = 255;

/// Marks the frames in which `foot` stands: [`HELD`], all others 0.
pub fn mark(poses: &[Pose], foot: usize, marks: &mut [u8]) {
    invariant!(marks.len() == poses.len(), "{} marks for {} frames", marks.len(), poses.len());
    marks.fill(0);
    let at = |pose: &Pose| pose.get(foot).copied().unwrap_or_default();
    let mut last = None;
    for (pair, t) in poses.windows(2).zip(0..) {
        let [before, after] = pair else { continue };
        let ([ax, ay, az], [bx, by, bz]) = (at(before), at(after));
        let step = (bx - ax) * (bx - ax) + (bz - az) * (bz - az);
        if ay < HEIGHT && by < HEIGHT && step < STEP * STEP {
            // A gap that is small enough belongs to the stance around it.
            let from = match last {
                Some(last) if t <= last + GAP + 1 => last,
                _ => t,
            };
            part_mut!(marks, from..t + 2).fill(HELD);
            last = Some(t + 1);
        }
    }
    let mut from = 0;
    while let Some((a, b)) = next_run(marks, from) {
        if b - a < SHORTEST {
            part_mut!(marks, a..b).fill(0);
        }
        from = b;
    }
}

/// The next stretch of marked frames at or behind `from`: its first frame and the first behind it.
#[must_use]
pub fn next_run(marks: &[u8], from: usize) -> Option<(usize, usize)> {
    let a = from + marks.get(from..)?.iter().position(|mark| *mark != 0)?;
    let rest = marks.get(a..)?;
    let b = a + rest.iter().position(|mark| *mark == 0).unwrap_or(rest.len());
    Some((a, b))
}

/// Offsets where nothing is marked, from those where something is: between two stretches the curve that leaves the one and arrives at the
/// other with their slopes, beyond the first and the last a fade to nothing. All are zero where nothing is marked at all.
pub fn fill(offsets: &mut [Vector], marks: &[u8]) {
    let frames = offsets.len();
    let marked = |t: usize| marks.get(t).is_some_and(|mark| *mark != 0);
    let get = |offsets: &[Vector], t: usize| offsets.get(t).copied().unwrap_or_default();
    let mut left: Option<usize> = None;
    let mut t = 0;
    while t < frames {
        if marked(t) {
            left = Some(t);
            t += 1;
            continue;
        }
        let right = next_run(marks, t).map(|(a, _)| a);
        let end = right.unwrap_or(frames);
        for (i, slot) in (t..end).enumerate() {
            let value = match (left, right) {
                (None, None) => [0.0; 3],
                (Some(a), None) => faded(get(offsets, a), slot - a),
                (None, Some(b)) => faded(get(offsets, b), b - slot),
                (Some(a), Some(b)) => {
                    let gap = (b - a) as f32;
                    let slope = |inside: bool, from: usize, to: usize| {
                        let change = subtract(get(offsets, to), get(offsets, from));
                        change.map(|change| if inside { change * gap } else { 0.0 })
                    };
                    let leaving = slope(a > 0 && marked(a - 1), a.saturating_sub(1), a);
                    let arriving = slope(marked(b + 1), b, b + 1);
                    hermite(get(offsets, a), leaving, get(offsets, b), arriving, (i + t - a) as f32 / gap)
                }
            };
            if let Some(slot) = offsets.get_mut(slot) {
                *slot = value;
            }
        }
        t = end;
    }
}

/// What is left of an offset so many frames away from where it holds.
fn faded(offset: Vector, frames: usize) -> Vector {
    let s = if frames < FADE { 1.0 - frames as f32 / FADE as f32 } else { 0.0 };
    offset.map(|value| value * (s * s * (3.0 - 2.0 * s)))
}

/// The cubic from `a` to `b` with slopes over the whole gap, at the share `s` of it.
fn hermite(a: Vector, leaving: Vector, b: Vector, arriving: Vector, s: f32) -> Vector {
    let (s2, s3) = (s * s, s * s * s);
    let weights = [2.0 * s3 - 3.0 * s2 + 1.0, s3 - 2.0 * s2 + s, 3.0 * s2 - 2.0 * s3, s3 - s2];
    let mut out = [0.0; 3];
    for (slot, (((a, leaving), b), arriving)) in out.iter_mut().zip(a.iter().zip(leaving).zip(b).zip(arriving)) {
        *slot = dot4(weights, [*a, leaving, b, arriving]);
    }
    out
}

fn dot4([a, b, c, d]: [f32; 4], [x, y, z, w]: [f32; 4]) -> f32 {
    dot([a, b, c], [x, y, z]) + d * w
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::JOINTS;
    use std::{string::String, vec, vec::Vec};

    fn poses(foot: &[Vector]) -> Vec<Pose> {
        foot.iter().map(|at| std::array::from_fn(|j| if j == 10 { *at } else { [9.0; 3] })).take(foot.len()).collect()
    }

    fn marked(foot: &[Vector]) -> String {
        assert_eq!(JOINTS, 22);
        let mut marks = vec![7; foot.len()];
        mark(&poses(foot), 10, &mut marks);
        marks.iter().map(|mark| char::from(b'0' + mark / HELD)).collect()
    }

    #[test]
    fn a_foot_stands_while_it_is_low_and_slow() {
        // x of each frame in centimetres, y 2 cm but where it says otherwise.
        let foot = |x: &[i32], high: &[usize]| -> Vec<Vector> {
            let y = |t: usize| if high.contains(&t) { 0.06 } else { 0.02 };
            x.iter().enumerate().map(|(t, x)| [*x as f32 * 0.01, y(t), 1.0]).collect()
        };
        assert_eq!(marked(&foot(&[0, 1, 2, 3, 30, 60, 90, 120, 121, 122], &[])), "1111000111");
        let short = [0, 0, 0, 30, 60, 90, 120, 120, 150, 180, 210, 240, 240, 240];
        assert_eq!(marked(&foot(&short, &[])), "11100000000111");
        assert_eq!(marked(&foot(&[0; 9], &[4])), "111111111", "a gap of two frames");
        assert_eq!(marked(&foot(&[0; 12], &[4, 5, 6])), "111100011111");
        assert_eq!(marked(&foot(&[0, 5, 10, 15], &[])), "0000");
        assert_eq!([marked(&[]), marked(&[[0.0; 3]]), marked(&[[0.0; 3]; 2])], ["", "0", "00"]);
    }

    #[test]
    fn runs_are_found_in_order() {
        let marks = [0, 1, 1, 0, 1];
        assert_eq!(
            [next_run(&marks, 0), next_run(&marks, 2), next_run(&marks, 3)],
            [Some((1, 3)), Some((2, 3)), Some((4, 5))]
        );
        assert_eq!([next_run(&marks, 5), next_run(&marks, 9), next_run(&[], 0)], [None; 3]);
    }

    /// A straight line goes on straight through a gap, ends fade, and what holds is left alone.
    #[test]
    fn gaps_are_filled_with_the_slopes_around_them() {
        let line = |t: usize| [0.1 * t as f32, -0.2 * t as f32, 1.0];
        let marks: Vec<u8> = (0..40).map(|t| u8::from((10..14).contains(&t) || (20..26).contains(&t))).collect();
        let mut offsets: Vec<Vector> = (0..40).map(|t| if marks[t] == 1 { line(t) } else { [f32::NAN; 3] }).collect();
        fill(&mut offsets, &marks);
        for (t, offset) in offsets.iter().enumerate().take(26).skip(10) {
            for (got, want) in offset.iter().zip(line(t)) {
                assert!((got - want).abs() < 1e-4, "frame {t}: {offset:?}");
            }
        }
        assert_eq!([offsets[0], offsets[39], offsets[35]], [[0.0; 3]; 3]);
        assert!((offsets[5][2] - 0.5).abs() < 1e-5 && (offsets[30][2] - 0.5).abs() < 1e-5, "half way");
        let mut nothing = vec![[3.0; 3]; 5];
        fill(&mut nothing, &[0; 5]);
        assert_eq!(nothing, [[0.0; 3]; 5]);
    }
}
