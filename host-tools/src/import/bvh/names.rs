//! What the name of a joint says: a part of the body and a side.
//!
//! Programs call the same joint `mixamorig:LeftUpLeg`, `Bip01 L Thigh`, `thigh.L`, `lThigh`, `DEF-thigh.L`, `lfemur`. A name is cut into
//! words at case changes, digits and punctuation; a word that is a side is taken out; the longest end of the rest that is known names
//! the part. What comes before it (`mixamorig`, `DEF`, `CC Base`) is a prefix, and the fewer words it has the better the name fits.

/// A side of the body.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Side {
    /// The subject's left.
    Left,
    /// The subject's right.
    Right,
}

/// What a joint is called after. Some words mean different joints in different skeletons ([`super::guess`] decides): `hip` may be the
/// pelvis' own, `leg` and `arm` upper or lower, `foot` the ankle or the toes' base, `shoulder` the collar bone or the shoulder.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Part {
    Hip,
    Thigh,
    Leg,
    Shin,
    Ankle,
    Foot,
    Toe,
    Collar,
    Shoulder,
    UpperArm,
    Forearm,
    Wrist,
    Hand,
    Pelvis,
    Neck,
    Head,
}

/// Parts that have a side, each with the words for it, run together in lower case.
const SIDED: [(Part, &[&str]); 13] = [
    (Part::Hip, &["hip", "hipjoint"]),
    (Part::Thigh, &["thigh", "upleg", "upperleg", "femur", "thighbend"]),
    (Part::Leg, &["leg"]),
    (Part::Shin, &["shin", "calf", "knee", "lowerleg", "lowleg", "loleg", "tibia", "shank"]),
    (Part::Ankle, &["ankle"]),
    (Part::Foot, &["foot"]),
    (Part::Toe, &["toe", "toes", "toebase", "ball", "forefoot"]),
    (Part::Collar, &["collar", "clavicle", "clav"]),
    (Part::Shoulder, &["shoulder"]),
    (Part::UpperArm, &["arm", "upperarm", "uparm", "shldr", "shldrbend", "humerus"]),
    (Part::Forearm, &["forearm", "lowerarm", "lowarm", "loarm", "elbow", "radius", "forearmbend"]),
    (Part::Wrist, &["wrist"]),
    (Part::Hand, &["hand"]),
];

/// Parts of the middle.
const CENTRAL: [(Part, &[&str]); 3] = [
    (Part::Pelvis, &["pelvis", "hips", "hip"]),
    (Part::Neck, &["neck", "lowerneck", "necklower", "neckbase", "necktwist"]),
    (Part::Head, &["head"]),
];

/// Words at the end that say only that it is a joint.
const NOISE: [&str; 6] = ["joint", "jnt", "jt", "bone", "bind", "skel"];

/// A name, understood.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Meaning {
    /// The side; `None` for the middle.
    pub side: Option<Side>,
    /// The part.
    pub part: Part,
    /// Words before it.
    pub prefix: usize,
}

/// What a name says, if anything.
pub(super) fn meaning(name: &str) -> Option<Meaning> {
    let mut words = words(name);
    let at = words.iter().position(|word| side(word).is_some());
    let side_word = at.map(|at| words.remove(at));
    while words.last().is_some_and(|word| NOISE.contains(&word.as_str()) || is_number(word)) {
        words.pop();
    }
    match side_word {
        Some(word) => find(&words, &SIDED).map(|(part, prefix)| Meaning { side: side(&word), part, prefix }),
        None => find(&words, &CENTRAL)
            .map(|(part, prefix)| Meaning { side: None, part, prefix })
            .or_else(|| words.last().and_then(|word| run_together(word, words.len() - 1))),
    }
}

/// `lfemur`, `rightupleg`: a side and a part without a border.
fn run_together(word: &str, prefix: usize) -> Option<Meaning> {
    [("left", Side::Left), ("right", Side::Right), ("l", Side::Left), ("r", Side::Right)].into_iter().find_map(
        |(letters, side)| {
            let rest = [word.strip_prefix(letters)?.to_owned()];
            find(&rest, &SIDED).map(|(part, _)| Meaning { side: Some(side), part, prefix })
        },
    )
}

/// The part that the longest end of the words names, and how many words come before.
fn find(words: &[String], table: &[(Part, &[&str])]) -> Option<(Part, usize)> {
    (0..words.len()).find_map(|start| {
        let end = words[start..].concat();
        table.iter().find(|(_, names)| names.contains(&end.as_str())).map(|(part, _)| (*part, start))
    })
}

fn side(word: &str) -> Option<Side> {
    match word {
        "l" | "left" | "lft" => Some(Side::Left),
        "r" | "right" | "rgt" => Some(Side::Right),
        _ => None,
    }
}

fn is_number(word: &str) -> bool {
    word.bytes().all(|b| b.is_ascii_digit())
}

/// The name of a joint without its namespace (`mixamorig:Hips`, `Armature|Hips`).
pub(super) fn plain(name: &str) -> &str {
    name.rsplit([':', '|']).next().unwrap_or(name)
}

/// A name without its numbers: what the joints of a chain have in common.
pub(super) fn stem(name: &str) -> Vec<String> {
    words(name).into_iter().filter(|word| !is_number(word)).collect()
}

/// A name in lower-case words; digits are words of their own.
fn words(name: &str) -> Vec<String> {
    let letters: Vec<char> = plain(name).chars().collect();
    let mut words: Vec<String> = Vec::new();
    let mut open = false;
    for (i, &c) in letters.iter().enumerate() {
        if !c.is_alphanumeric() {
            open = false;
            continue;
        }
        let before = i.checked_sub(1).map(|i| letters[i]);
        let border = before.is_some_and(|before| {
            // "upLeg", "LHip" before the H, and digits from letters.
            (before.is_lowercase() && c.is_uppercase())
                || (before.is_uppercase() && c.is_uppercase() && letters.get(i + 1).is_some_and(|c| c.is_lowercase()))
                || before.is_numeric() != c.is_numeric()
        });
        if border || !open {
            words.push(String::new());
        }
        open = true;
        if let Some(word) = words.last_mut() {
            word.extend(c.to_lowercase());
        }
    }
    words
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_many_programs_say_the_same() {
        use Part::{
            Ankle, Collar, Foot, Forearm, Hand, Head, Hip, Leg, Neck, Pelvis, Shin, Shoulder, Thigh, Toe, UpperArm,
            Wrist,
        };
        let left = [
            (
                Thigh,
                "mixamorig:LeftUpLeg mixamorig_LeftUpLeg Character1_LeftUpLeg thigh.L DEF-thigh.L lThigh lThighBend lfemur CC_Base_L_Thigh UpperLeg_L J_Bip_L_UpperLeg LeftThigh upperleg01.L thigh_l Bip01~L~Thigh",
            ),
            (Hip, "LeftHip L_Hip left_hip m_avg_L_Hip LHipJoint lhipjoint HipLeft"),
            (Leg, "LeftLeg leg.L"),
            (
                Shin,
                "LeftKnee L_Knee left_knee shin.L lShin ltibia CC_Base_L_Calf calf_l LowerLeg_L LeftLowerLeg Bip001~L~Calf",
            ),
            (Ankle, "L_Ankle LeftAnkle left_ankle"),
            (Foot, "LeftFoot foot.L lFoot lfoot Foot_L L_Foot left_foot"),
            (Toe, "LeftToeBase LeftToe toe.L lToe ltoes Toes_L ball_l toe1-1.L Bip01~L~Toe0"),
            (Collar, "LeftCollar lCollar lclavicle clavicle_l L_Collar Bip01~L~Clavicle"),
            (Shoulder, "LeftShoulder shoulder.L Shoulder_L L_Shoulder ShoulderLeft"),
            (UpperArm, "LeftArm upper_arm.L lShldr lShldrBend lhumerus UpperArm_L LeftUpperArm upperarm_l"),
            (Forearm, "LeftForeArm forearm.L lForeArm lForearmBend lradius LowerArm_L lowerarm_l LeftElbow"),
            (Wrist, "LeftWrist L_Wrist lwrist"),
            (Hand, "LeftHand hand.L lHand lhand Hand_L"),
        ];
        for (part, names) in left {
            for name in names.split(' ').map(|name| name.replace('~', " ")) {
                let found = meaning(&name).map(|meaning| (meaning.side, meaning.part));
                assert_eq!(found, Some((Some(Side::Left), part)), "{name}");
            }
        }
        let middle = [
            (Pelvis, "Hips mixamorig:Hips pelvis CC_Base_Pelvis hip Bip01~Pelvis"),
            (Neck, "Neck neck_01 lowerneck CC_Base_NeckTwist01 neckLower neck1"),
            (Head, "Head mixamorig_Head head"),
        ];
        for (part, names) in middle {
            for name in names.split(' ').map(|name| name.replace('~', " ")) {
                let found = meaning(&name).map(|meaning| (meaning.side, meaning.part));
                assert_eq!(found, Some((None, part)), "{name}");
            }
        }
        let right = ["RightUpLeg", "thigh.R", "rfemur", "R_Thigh", "Thigh_r"];
        assert!(right.iter().all(|name| meaning(name).is_some_and(|m| m.side == Some(Side::Right) && m.part == Thigh)));
    }

    #[test]
    fn twists_fingers_ends_and_the_spine_say_nothing() {
        for name in [
            "LeftHandThumb1",
            "LeftHandIndex2",
            "LeftUpLegRoll",
            "CC_Base_L_CalfTwist01",
            "upperarm_twist_01_l",
            "HeadTop_End",
            "LeftToe_End",
            "Bip01 L Toe0Nub",
            "Spine",
            "Spine1",
            "lowerback",
            "LowerBack",
            "root",
            "rig",
            "L5",
            "",
            "::",
            "Left",
            "eye.L",
        ] {
            assert_eq!(meaning(name), None, "{name}");
        }
    }

    #[test]
    fn a_prefix_counts_against_a_name() {
        let prefix = |name| meaning(name).map(|meaning| meaning.prefix);
        assert_eq!([prefix("foot_l"), prefix("ik_foot_l"), prefix("CC_Base_L_Foot")], [Some(0), Some(1), Some(2)]);
    }
}
