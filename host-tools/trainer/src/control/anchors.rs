//! Anchors drawn from real motion: where a body was is where it is to be.

use std::collections::BTreeSet;

use motionette_host::motion::Pose;
use motionette_host::reference::{Anchor, Target};
use serde::{Deserialize, Serialize};

use crate::random::Random;

/// Joints by which a body is usually led: feet, head, hands.
pub const EXTREMITIES: [usize; 5] = [7, 8, 15, 20, 21];

/// What the anchors of a request control.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// The pelvis in space.
    Root3d,
    /// The pelvis on the ground plane.
    Planar,
    /// Joints in space.
    Body,
    /// All of them.
    Mixed,
}

/// The three families of the paper's tables.
pub const FAMILIES: [Kind; 3] = [Kind::Root3d, Kind::Planar, Kind::Body];

/// `count` anchors at random frames of `joints`, fewer when there are not so many frames; sorted by frame. Body-point anchors take a joint
/// of `controlled` each.
pub fn draw(kind: Kind, count: usize, joints: &[Pose], controlled: &[usize], random: &mut Random) -> Vec<Anchor> {
    let bodies = controlled.len().max(1);
    let places = match kind {
        Kind::Root3d | Kind::Planar => joints.len(),
        Kind::Body => joints.len() * bodies,
        Kind::Mixed => joints.len() * (1 + bodies),
    };
    let mut taken = BTreeSet::new();
    let mut anchors = Vec::new();
    while anchors.len() < count.min(places) {
        let frame = random.below(joints.len());
        let joint = match kind {
            Kind::Root3d | Kind::Planar => 0,
            Kind::Body => controlled[random.below(bodies)],
            Kind::Mixed if random.unit() < 0.5 => 0,
            Kind::Mixed => controlled[random.below(bodies)],
        };
        let planar = kind == Kind::Planar || (kind == Kind::Mixed && random.unit() < 0.5);
        if !taken.insert((frame, joint)) {
            continue;
        }
        let position = joints[frame][joint].map(f64::from);
        let target = match joint {
            0 if planar => Target::PlanarRoot([position[0], position[2]]),
            0 => Target::Root(position),
            _ => Target::Joint { joint, position },
        };
        anchors.push(Anchor { frame, target });
    }
    anchors.sort_by_key(|anchor| (anchor.frame, anchor.joint()));
    anchors
}

/// Anchors of an example of training: any kind, one of `counts`, joints one, several or all.
pub fn example(counts: &[usize], joints: &[Pose], random: &mut Random) -> Vec<Anchor> {
    let kind = [Kind::Root3d, Kind::Planar, Kind::Body, Kind::Mixed][random.below(4)];
    let count = counts[random.below(counts.len())];
    let joint = |random: &mut Random| {
        if random.unit() < 0.6 { EXTREMITIES[random.below(EXTREMITIES.len())] } else { 1 + random.below(21) }
    };
    let controlled: Vec<usize> = match random.below(3) {
        0 => vec![joint(random)],
        1 => (0..1 + random.below(4)).map(|_| joint(random)).collect::<BTreeSet<_>>().into_iter().collect(),
        _ => EXTREMITIES.to_vec(),
    };
    draw(kind, count, joints, &controlled, random)
}

/// `joints` with a path `factor` times as long, from where it begins; the body stays as it is.
pub fn scaled(joints: &[Pose], factor: f32) -> Vec<Pose> {
    let Some(start) = joints.first().map(|pose| pose[0]) else { return Vec::new() };
    let moved = |pose: &Pose| {
        let by = [0, 2].map(|axis| (factor - 1.0) * (pose[0][axis] - start[axis]));
        pose.map(|[x, y, z]| [x + by[0], y, z + by[1]])
    };
    joints.iter().map(moved).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn anchors_are_places_of_the_motion_and_differ() {
        let joints: Vec<Pose> = (0..9).map(|t| std::array::from_fn(|j| [t as f32, j as f32, (t * j) as f32])).collect();
        let mut random = Random::new(5, 5);
        for kind in [Kind::Root3d, Kind::Planar, Kind::Body, Kind::Mixed] {
            for count in [1, 4, 32] {
                let anchors = draw(kind, count, &joints, &EXTREMITIES, &mut random);
                let places = if matches!(kind, Kind::Root3d | Kind::Planar) { 9 } else { 45 };
                assert_eq!(anchors.len(), count.min(places));
                let distinct: BTreeSet<_> = anchors.iter().map(|a| (a.frame, a.joint())).collect();
                assert_eq!(distinct.len(), anchors.len());
                assert!(anchors.iter().all(|a| a.error(&joints) == 0.0));
                assert!(anchors.is_sorted_by_key(|a| a.frame));
                let root = anchors.iter().filter(|a| a.joint() == 0).count();
                match kind {
                    Kind::Root3d => assert!(anchors.iter().all(|a| matches!(a.target, Target::Root(_)))),
                    Kind::Planar => assert!(anchors.iter().all(|a| matches!(a.target, Target::PlanarRoot(_)))),
                    Kind::Body => assert_eq!(root, 0),
                    Kind::Mixed => assert!(count < 32 || (root > 0 && root < anchors.len())),
                }
            }
        }
        assert!(!example(&[8], &joints, &mut random).is_empty());
    }

    #[test]
    fn a_longer_path_keeps_body_start_and_height() {
        let joints: Vec<Pose> = (0..5)
            .map(|t| std::array::from_fn(|j| [1.0 + t as f32, 0.1 * (t + j) as f32, j as f32 - t as f32]))
            .collect();
        let longer = scaled(&joints, 1.5);
        assert_eq!((longer[0], longer[4][0]), (joints[0], [7.0, joints[4][0][1], -6.0]));
        for (before, after) in joints.iter().zip(&longer) {
            for (b, a) in before.iter().zip(after) {
                let offsets = [0, 1, 2].map(|axis| ((a[axis] - after[0][axis]) - (b[axis] - before[0][axis])).abs());
                assert!(offsets.iter().all(|d| *d < 1e-5) && a[1] == b[1]);
            }
        }
        assert!(scaled(&[], 2.0).is_empty());
    }
}
