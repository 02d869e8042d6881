//! Which anchors no motion meets: a necessary condition in f64, that of pairs of anchors.
//!
//! A motion may differ from the one that was generated, `g`, by a way that grows by at most `v` metres a second for every joint. An anchor
//! that wants joint j at frame s displaced by `D` leaves it displaced by between `D - v |s - t|` and `D + v |s - t|` at frame t (as balls).
//! So two anchors of one joint contradict one another where their displacements differ by more than that, and two of different joints where
//! the places that are left for them are farther apart than the bones between them reach. The root is not displaced at frame 0.

use super::anchors::{Anchor, Target};
use super::recover::JOINTS;
use crate::motion::skeleton::PARENTS;

type Vector = [f64; 3];

/// How many anchors have to be left out at least, by the largest number of contradictions first, so that no two contradict one another: for
/// every anchor whether it is left out. `generated`: `[T]` joints, metres; `speed` in m/s.
#[must_use]
pub fn unreachable(generated: &[[Vector; JOINTS]], anchors: &[Anchor], speed: f64, frame_rate: f64) -> Vec<bool> {
    let Some(rest) = generated.first() else { return vec![false; anchors.len()] };
    // Seen from above where one of the two has no height.
    let apart = |a: Vector, b: Vector, flat: bool| {
        let height = if flat { 0.0 } else { a[1] - b[1] };
        (a[0] - b[0]).hypot(a[2] - b[2]).hypot(height)
    };
    let flat = |anchor: &Anchor| matches!(anchor.target, Target::PlanarRoot(_));
    let way = |frames: usize| speed * frames as f64 / frame_rate;
    let at = |joint: usize, frame: usize| generated.get(frame).map_or([0.0; 3], |pose| pose[joint]);
    let contradict = |a: &Anchor, b: &Anchor| {
        let (first, second, flat) = (a.joint(), b.joint(), flat(a) || flat(b));
        // Where b's joint would be at a's frame without a change of its displacement.
        let [here, there] = [at(second, a.frame), at(second, b.frame)];
        let target = b.position();
        let left: Vector = std::array::from_fn(|axis| here[axis] + target[axis] - there[axis]);
        let reach = if first == second { 0.0 } else { reach(rest, first, second) };
        apart(a.position(), left, flat) > reach + way(a.frame.abs_diff(b.frame)) + 1e-6
    };
    let strays = |a: &Anchor| a.joint() == 0 && apart(a.position(), at(0, a.frame), flat(a)) > way(a.frame) + 1e-6;
    let mut out: Vec<bool> = anchors.iter().map(strays).collect();
    loop {
        let contradictions = |i: usize| {
            let others = (0..anchors.len()).filter(|j| *j != i && !out[*j]);
            others.filter(|j| contradict(&anchors[i], &anchors[*j]) || contradict(&anchors[*j], &anchors[i])).count()
        };
        let left = (0..anchors.len()).filter(|i| !out[*i]);
        match left.map(|i| (contradictions(i), i)).max_by_key(|(count, i)| (*count, usize::MAX - i)) {
            Some((count, worst)) if count > 0 => out[worst] = true,
            _ => return out,
        }
    }
}

/// The bones between two joints, end to end, metres: they are never farther apart.
fn reach(pose: &[Vector; JOINTS], a: usize, b: usize) -> f64 {
    let (mut a, mut b, mut sum) = (a, b, 0.0);
    // A joint has a higher number than its parent.
    while a != b {
        let (child, parent) = if a > b { (a, PARENTS[a]) } else { (b, PARENTS[b]) };
        sum += (0..3).map(|axis| (pose[child][axis] - pose[parent][axis]).powi(2)).sum::<f64>().sqrt();
        if a > b { a = parent } else { b = parent }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::motion::uniform;

    fn still(frames: usize) -> Vec<[Vector; JOINTS]> {
        let offsets = uniform::body();
        let mut pose = [[0.0, 0.9, 0.0]; JOINTS];
        for joint in 1..JOINTS {
            pose[joint] = std::array::from_fn(|axis| pose[PARENTS[joint]][axis] + offsets[joint][axis]);
        }
        vec![pose; frames]
    }

    fn joint(frame: usize, joint: usize, position: Vector) -> Anchor {
        Anchor { frame, target: Target::Joint { joint, position } }
    }

    #[test]
    fn anchors_that_ask_for_too_much_are_left_out_and_no_others() {
        let motion = still(100);
        let wrist = motion[0][20];
        let moved = |by: f64| [wrist[0] + by, wrist[1], wrist[2]];
        let check = |anchors: &[Anchor]| unreachable(&motion, anchors, 5.0, 20.0);
        // 0.25 m a frame.
        assert_eq!(check(&[joint(10, 20, moved(0.0)), joint(14, 20, moved(0.99))]), [false, false]);
        assert_eq!(check(&[joint(10, 20, moved(0.0)), joint(14, 20, moved(1.01))]), [true, false]);
        // The one between two that agree.
        let three = [joint(10, 20, moved(0.0)), joint(12, 20, moved(2.0)), joint(14, 20, moved(0.0))];
        assert_eq!(check(&three), [false, true, false]);
        // Wrists are no farther apart than two arms and shoulders, at one frame, and as far as they get later on.
        let reach = reach(&motion[0], 20, 21);
        let aside = |by: f64| [motion[0][21][0] - by, motion[0][21][1], motion[0][21][2]];
        let apart = wrist[0] - motion[0][21][0];
        let both = |frame, by: f64| check(&[joint(10, 20, wrist), joint(frame, 21, aside(by))]);
        assert_eq!(both(10, reach - apart - 0.01), [false, false]);
        assert_eq!(both(10, reach - apart + 0.01).iter().filter(|out| **out).count(), 1);
        assert_eq!(both(12, reach - apart + 0.49), [false, false]);
        // The root begins where it was generated; seen from above its height says nothing.
        let root = |frame, x: f64| Anchor { frame, target: Target::PlanarRoot([x, 0.0]) };
        assert_eq!(check(&[root(4, 0.99), root(40, 9.9)]), [false, false]);
        assert_eq!(check(&[root(4, 1.01), root(40, 9.9)]), [true, false]);
        assert!(check(&[]).is_empty() && unreachable(&[], &[root(0, 0.0)], 5.0, 20.0) == [false]);
    }
}
