//! The 22 joints by name.

use core::fmt;

use crate::JOINTS;
use crate::representation::skeleton::NAMES;

/// A joint of the body skeleton; its number is that of the SMPL order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
#[expect(missing_docs, reason = "the names say it")]
pub enum Joint {
    Pelvis = 0,
    LeftHip = 1,
    RightHip = 2,
    Spine1 = 3,
    LeftKnee = 4,
    RightKnee = 5,
    Spine2 = 6,
    LeftAnkle = 7,
    RightAnkle = 8,
    Spine3 = 9,
    LeftFoot = 10,
    RightFoot = 11,
    Neck = 12,
    LeftCollar = 13,
    RightCollar = 14,
    Head = 15,
    LeftShoulder = 16,
    RightShoulder = 17,
    LeftElbow = 18,
    RightElbow = 19,
    LeftWrist = 20,
    RightWrist = 21,
}

impl Joint {
    /// All of them by number.
    pub const ALL: [Joint; JOINTS] = [
        Joint::Pelvis,
        Joint::LeftHip,
        Joint::RightHip,
        Joint::Spine1,
        Joint::LeftKnee,
        Joint::RightKnee,
        Joint::Spine2,
        Joint::LeftAnkle,
        Joint::RightAnkle,
        Joint::Spine3,
        Joint::LeftFoot,
        Joint::RightFoot,
        Joint::Neck,
        Joint::LeftCollar,
        Joint::RightCollar,
        Joint::Head,
        Joint::LeftShoulder,
        Joint::RightShoulder,
        Joint::LeftElbow,
        Joint::RightElbow,
        Joint::LeftWrist,
        Joint::RightWrist,
    ];

    /// Number in SMPL order: the column of this joint in a frame of a motion.
    #[must_use]
    pub const fn index(self) -> usize {
        self as usize
    }

    /// Name, as in anchors files: `right_wrist`.
    #[must_use]
    pub fn name(self) -> &'static str {
        NAMES.get(self.index()).copied().unwrap_or("")
    }

    /// The joint of that name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Joint> {
        Joint::ALL.into_iter().find(|joint| joint.name() == name)
    }
}

impl From<Joint> for u8 {
    fn from(joint: Joint) -> u8 {
        joint as u8
    }
}

impl TryFrom<u8> for Joint {
    type Error = NoSuchJoint;

    fn try_from(number: u8) -> Result<Joint, NoSuchJoint> {
        Joint::ALL.get(usize::from(number)).copied().ok_or(NoSuchJoint(number))
    }
}

impl fmt::Display for Joint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A number that no joint has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct NoSuchJoint(pub u8);

impl fmt::Display for NoSuchJoint {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "joint {} does not exist, the skeleton has {JOINTS}", self.0)
    }
}

impl core::error::Error for NoSuchJoint {}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_names_and_order_agree() {
        for (number, joint) in Joint::ALL.into_iter().enumerate() {
            assert_eq!((joint.index(), joint.name()), (number, NAMES[number]));
            assert_eq!(Joint::try_from(u8::from(joint)), Ok(joint));
            assert_eq!(Joint::from_name(joint.name()), Some(joint));
            let debug = std::format!("{joint:?}").to_lowercase();
            assert_eq!(debug, joint.name().replace('_', ""), "variant and name");
        }
        assert_eq!(Joint::try_from(22), Err(NoSuchJoint(22)));
        assert_eq!(Joint::from_name("wrist"), None);
    }
}
