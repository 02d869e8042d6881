//! Which part of the body an anchor moves.
//!
//! Every joint hangs on a chain that can bring it somewhere: knees, ankles, elbows and wrists on their limbs, toes on their ankles, what is
//! above the pelvis on a lean of the trunk. Where two anchors of one moment would pull at one chain, the one nearer to the pelvis has it,
//! and the other gets what is left: toes turn about their ankle, neck and head about the upper spine, a shoulder at the end of its
//! collar bone.

use crate::request::conditions::Observed;

/// Anchors of the trunk are of one moment when they are no farther apart than this, frames.
const TRUNK_MOMENT: u16 = 12;
/// Anchors of one foot.
const FOOT_MOMENT: u16 = 2;

/// Left or right.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Side {
    /// The body's left.
    Left,
    /// The body's right.
    Right,
}

/// What moves for an anchor.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Part {
    /// The whole body, rigidly: pelvis, hips and the lowest joint of the spine.
    Body,
    /// The trunk leans about the pelvis until that joint is there.
    Lean(u8),
    /// Neck and head, on the upper spine.
    Neck(u8),
    /// A collar bone, with the arm that hangs on it.
    Collar(Side, u8),
    /// A knee, turned about its hip.
    Knee(Side),
    /// An ankle, by hip and knee; the toes go along.
    Ankle(Side),
    /// Toes, turned about their ankle.
    Toes(Side),
    /// An elbow, turned about its shoulder.
    Elbow(Side),
    /// A wrist, by shoulder and elbow.
    Wrist(Side),
}

impl Part {
    /// What moves for `anchor`, one of `anchors`.
    pub fn of<'s>(anchor: &Observed, mut anchors: impl Iterator<Item = &'s Observed>) -> Self {
        let joint = anchor.joint;
        let side = if matches!(joint, 4 | 7 | 10 | 13 | 16 | 18 | 20) { Side::Left } else { Side::Right };
        let mut meanwhile = |moment: u16, other: &dyn Fn(u8) -> bool| {
            anchors.any(|a| a.frame.abs_diff(anchor.frame) <= moment && a.joint != joint && other(a.joint))
        };
        match joint {
            4 | 5 => Part::Knee(side),
            7 | 8 => Part::Ankle(side),
            10 | 11 if meanwhile(FOOT_MOMENT, &|other| other + 3 == joint) => Part::Toes(side),
            10 | 11 => Part::Ankle(side),
            18 | 19 => Part::Elbow(side),
            20 | 21 => Part::Wrist(side),
            _ => match rank(joint) {
                None => Part::Body,
                Some(own) if meanwhile(TRUNK_MOMENT, &|other| rank(other).is_some_and(|rank| rank < own)) => {
                    match joint {
                        12 | 15 => Part::Neck(joint),
                        13 | 14 | 16 | 17 => Part::Collar(side, joint),
                        _ => Part::Lean(joint),
                    }
                }
                Some(_) => Part::Lean(joint),
            },
        }
    }

    /// A bit of its own for each part.
    #[must_use]
    pub const fn bit(self) -> u64 {
        let place = match self {
            Part::Body => 0,
            Part::Lean(joint) => 1 + joint,
            Part::Neck(joint) => 24 + joint / 15,
            Part::Collar(_, joint) => 13 + joint,
            Part::Knee(side) => 32 + side as u8,
            Part::Ankle(side) => 34 + side as u8,
            Part::Toes(side) => 36 + side as u8,
            Part::Elbow(side) => 38 + side as u8,
            Part::Wrist(side) => 40 + side as u8,
        };
        1u64.wrapping_shl(place as u32)
    }

    /// How far the part goes its own way while the root takes the rest, metres: standard deviations over the floor and in height.
    #[must_use]
    pub const fn own_way(self) -> [f32; 2] {
        match self {
            Part::Body => [0.0, 0.0],
            Part::Lean(_) | Part::Neck(_) => [0.08, 0.03],
            Part::Collar(..) | Part::Knee(_) => [0.1, 0.1],
            Part::Ankle(_) | Part::Toes(_) => [0.15, 0.5],
            Part::Elbow(_) | Part::Wrist(_) => [0.15, 0.3],
        }
    }
}

/// Which of the trunk's joints leads when several are anchored.
const fn rank(joint: u8) -> Option<u8> {
    Some(match joint {
        9 => 0,
        6 => 1,
        16 => 2,
        17 => 3,
        13 => 4,
        14 => 5,
        12 => 6,
        15 => 7,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Anchor;
    use crate::request::conditions::AnchorSet;
    use std::vec::Vec;

    fn parts(anchors: &[(u16, u8)]) -> Vec<Part> {
        let list: Vec<Anchor> = anchors.iter().map(|(frame, joint)| Anchor::joint(*frame, *joint, [0.0; 3])).collect();
        let mut set = AnchorSet::EMPTY;
        set.fill(crate::request::conditions::AnchorList::Frames(&list), 20, 196).unwrap();
        set.iter().map(|anchor| Part::of(anchor, set.iter())).collect()
    }

    #[test]
    fn every_joint_has_its_part_and_those_nearer_to_the_pelvis_lead() {
        use Part::*;
        use Side::*;
        assert_eq!(parts(&[(0, 0), (1, 1), (2, 2), (3, 3)]), [Body; 4]);
        assert_eq!(
            parts(&[(0, 4), (20, 8), (40, 18), (60, 21)]),
            [Knee(Left), Ankle(Right), Elbow(Left), Wrist(Right)]
        );
        assert_eq!(parts(&[(0, 10), (30, 11)]), [Ankle(Left), Ankle(Right)]);
        assert_eq!(
            parts(&[(10, 7), (12, 10), (14, 11), (40, 10)]),
            [Ankle(Left), Toes(Left), Ankle(Right), Ankle(Left)]
        );
        assert_eq!(
            parts(&[(0, 15), (30, 15), (31, 9), (60, 12), (61, 15)]),
            [Lean(15), Neck(15), Lean(9), Lean(12), Neck(15)]
        );
        assert_eq!(parts(&[(5, 16), (5, 17), (50, 17)]), [Lean(16), Collar(Right, 17), Lean(17)]);
    }

    #[test]
    fn every_part_has_a_bit_of_its_own() {
        use Part::*;
        use Side::*;
        let mut all = Vec::from([Body, Neck(12), Neck(15)]);
        all.extend([3, 6, 9, 12, 13, 14, 15, 16, 17].map(Lean));
        for side in [Left, Right] {
            all.extend([Knee(side), Ankle(side), Toes(side), Elbow(side), Wrist(side)]);
        }
        all.extend([Collar(Left, 13), Collar(Right, 14), Collar(Left, 16), Collar(Right, 17)]);
        assert_eq!(all.iter().fold(0u64, |bits, part| bits | part.bit()).count_ones() as usize, all.len());
    }
}
