//! Which joints of a file are which of the 22, guessed from their names and the hierarchy.
//!
//! Names tell the limbs ([`super::names`]): of the joints that may be hip, knee, ankle and toes of a side, those are taken that hang on
//! one another. The spine is what lies between pelvis and neck, whatever it is called: three joints are taken as they are, of more or fewer
//! the three SMPL joints are points on the line through them, at their shares of HumanML3D's skeleton. What a skeleton lacks is put where it
//! must be: toes, wrists and the head at the next joint or End Site, collar bones between chest and shoulder.

use super::mapping::{Place, Source};
use super::names::{self, Part, Side};
use super::{Bvh, Joint};
use crate::motion::quaternion::{self as q, Vector};
use crate::motion::{JOINTS, uniform};

/// Candidates looked at for one part: hostile files may call every joint the same.
const MOST_CANDIDATES: usize = 6;
/// Share of the way from the chest to the shoulder at which a collar bone begins where the file has none.
const COLLAR: f64 = 0.4;

/// Where each of the 22 comes from; else the parts of the body that the names do not tell. `at` holds the joints' positions in a frame.
pub(super) fn guess(bvh: &Bvh, at: &[Vector]) -> Result<[Place; JOINTS], Vec<&'static str>> {
    let body = Body::new(bvh);
    let legs = [Side::Left, Side::Right].map(|side| body.leg(side));
    let arms = [Side::Left, Side::Right].map(|side| body.arm(side));
    let mut unclear = Vec::new();
    for (found, part) in [
        (legs[0].is_some(), "the left leg"),
        (legs[1].is_some(), "the right leg"),
        (arms[0].is_some(), "the left arm"),
        (arms[1].is_some(), "the right arm"),
    ] {
        if !found {
            unclear.push(part);
        }
    }
    let ([Some(left_leg), Some(right_leg)], [Some(left_arm), Some(right_arm)]) = (legs, arms) else {
        return Err(unclear);
    };
    let pelvis = body.pelvis(left_leg.hip, right_leg.hip).ok_or(vec!["the pelvis"])?;
    let chest = body.common(left_arm.top(), right_arm.top());
    let (neck, head) = chest.and_then(|chest| body.neck_and_head(chest)).ok_or(vec!["the neck and head"])?;
    let [spine1, spine2, spine3] = body.spine(pelvis, neck, at);
    let collar = |arm: &Arm| match arm.collar {
        // A collar bone that begins in the middle of the chest.
        Some(collar) if q::length(q::subtract(at[collar], spine3.of(at))) > 1e-3 * body.size(pelvis, neck, at) => {
            Place::joint(collar)
        }
        collar => Place { from: collar.or(body.parent(arm.shoulder)).unwrap_or(neck), to: arm.shoulder, at: COLLAR },
    };
    Ok([
        Place::joint(pelvis),
        Place::joint(left_leg.hip),
        Place::joint(right_leg.hip),
        spine1,
        Place::joint(left_leg.knee),
        Place::joint(right_leg.knee),
        spine2,
        Place::joint(left_leg.ankle),
        Place::joint(right_leg.ankle),
        spine3,
        Place::joint(left_leg.toes),
        Place::joint(right_leg.toes),
        Place::joint(neck),
        collar(&left_arm),
        collar(&right_arm),
        Place::joint(head),
        Place::joint(left_arm.shoulder),
        Place::joint(right_arm.shoulder),
        Place::joint(left_arm.elbow),
        Place::joint(right_arm.elbow),
        Place::joint(left_arm.wrist),
        Place::joint(right_arm.wrist),
    ])
}

/// The guess as a user can check it: `left_hip = thigh.L`.
pub(super) fn described(sources: &[Place; JOINTS], bvh: &Bvh) -> String {
    let name = |joint: usize| bvh.joints[joint].name.as_str();
    let one = |(place, smpl): (&Place, &str)| match place.source(bvh) {
        Source::Joint(joint) => format!("{smpl} = {joint}"),
        Source::Between { at, .. } => {
            format!("{smpl} = {:.0} % from {} to {}", 100.0 * at, name(place.from), name(place.to))
        }
    };
    sources.iter().zip(crate::motion::skeleton::NAMES).map(one).collect::<Vec<_>>().join(", ")
}

struct Leg {
    hip: usize,
    knee: usize,
    ankle: usize,
    toes: usize,
}

struct Arm {
    collar: Option<usize>,
    shoulder: usize,
    elbow: usize,
    wrist: usize,
}

impl Arm {
    fn top(&self) -> usize {
        self.collar.unwrap_or(self.shoulder)
    }
}

/// A hierarchy whose names are understood.
struct Body<'a> {
    joints: &'a [Joint],
    meanings: Vec<Option<names::Meaning>>,
    depths: Vec<usize>,
    /// Whether a joint or one below it has a side.
    limbs: Vec<bool>,
}

impl<'a> Body<'a> {
    fn new(bvh: &'a Bvh) -> Self {
        let meaning = |joint: &Joint| if joint.end_site { None } else { names::meaning(&joint.name) };
        let mut depths: Vec<usize> = Vec::with_capacity(bvh.joints.len());
        for joint in &bvh.joints {
            depths.push(joint.parent.map_or(0, |parent| depths[parent] + 1));
        }
        let meanings: Vec<_> = bvh.joints.iter().map(meaning).collect();
        let mut limbs: Vec<bool> = meanings.iter().map(|m| m.is_some_and(|m| m.side.is_some())).collect();
        for (joint, parent) in bvh.joints.iter().enumerate().rev().filter_map(|(i, joint)| Some((i, joint.parent?))) {
            limbs[parent] |= limbs[joint];
        }
        Self { joints: &bvh.joints, meanings, depths, limbs }
    }

    fn parent(&self, joint: usize) -> Option<usize> {
        self.joints[joint].parent
    }

    /// All joints above one, the nearest first.
    fn above(&self, joint: usize) -> impl Iterator<Item = usize> {
        std::iter::successors(self.parent(joint), |&joint| self.parent(joint))
    }

    fn is_below(&self, joint: usize, other: usize) -> bool {
        self.depths[joint] > self.depths[other] && self.above(joint).any(|above| above == other)
    }

    /// The lowest joint above both or one of them.
    fn common(&self, a: usize, b: usize) -> Option<usize> {
        let above_b: Vec<usize> = std::iter::once(b).chain(self.above(b)).collect();
        std::iter::once(a).chain(self.above(a)).find(|joint| above_b.contains(joint))
    }

    fn children(&self, joint: usize) -> impl Iterator<Item = usize> {
        (joint + 1..self.joints.len()).filter(move |&child| self.parent(child) == Some(joint))
    }

    /// Joints that may be one of these parts: better words first, then fewer words before them, then higher in the hierarchy.
    fn candidates(&self, side: Option<Side>, parts: &[Part]) -> Vec<usize> {
        let of = |part: &Part| {
            let fits = |joint: &usize| self.meanings[*joint].is_some_and(|m| m.side == side && m.part == *part);
            let mut found: Vec<usize> = (0..self.joints.len()).filter(fits).collect();
            found.sort_by_key(|&joint| (self.meanings[joint].map(|m| m.prefix), self.depths[joint]));
            found.truncate(MOST_CANDIDATES);
            found
        };
        parts.iter().flat_map(of).collect()
    }

    /// The first choice of a joint a level that hang on one another.
    fn chain<const N: usize>(&self, levels: [Vec<usize>; N]) -> Option<[usize; N]> {
        let mut chosen = [0; N];
        self.choose(&levels, &mut chosen, 0).then_some(chosen)
    }

    fn choose(&self, levels: &[Vec<usize>], chosen: &mut [usize], level: usize) -> bool {
        let Some(candidates) = levels.get(level) else { return true };
        candidates.iter().any(|&joint| {
            let hangs = level == 0 || self.is_below(joint, chosen[level - 1]);
            chosen[level] = joint;
            hangs && self.choose(levels, chosen, level + 1)
        })
    }

    fn leg(&self, side: Side) -> Option<Leg> {
        let of = |parts: &[Part]| self.candidates(Some(side), parts);
        let [hip, knee] = [of(&[Part::Thigh, Part::Hip, Part::Leg]), of(&[Part::Shin, Part::Leg])];
        let [ankle, toes] = [of(&[Part::Ankle, Part::Foot]), of(&[Part::Toe, Part::Foot])];
        if let Some([hip, knee, ankle, toes]) = self.chain([hip.clone(), knee.clone(), ankle.clone(), toes]) {
            return Some(Leg { hip, knee, ankle, toes });
        }
        let [hip, knee, ankle] = self.chain([hip, knee, ankle])?;
        Some(Leg { hip, knee, ankle, toes: self.children(ankle).next()? })
    }

    fn arm(&self, side: Side) -> Option<Arm> {
        let of = |parts: &[Part]| self.candidates(Some(side), parts);
        let [shoulder, elbow] = [of(&[Part::UpperArm, Part::Shoulder]), of(&[Part::Forearm])];
        let wrist = of(&[Part::Wrist, Part::Hand]);
        let chain = self.chain([shoulder.clone(), elbow.clone(), wrist]).or_else(|| {
            let [shoulder, elbow] = self.chain([shoulder, elbow])?;
            Some([shoulder, elbow, self.children(elbow).next()?])
        });
        let [shoulder, elbow, wrist] = chain?;
        let collars = of(&[Part::Collar, Part::Shoulder]);
        let collar = collars.into_iter().find(|&collar| self.is_below(shoulder, collar));
        Some(Arm { collar, shoulder, elbow, wrist })
    }

    /// The lowest joint of that name above both hips, else where the legs meet.
    fn pelvis(&self, left: usize, right: usize) -> Option<usize> {
        let named = self.candidates(None, &[Part::Pelvis]);
        let above_both = named.into_iter().filter(|&joint| self.is_below(left, joint) && self.is_below(right, joint));
        above_both.max_by_key(|&joint| self.depths[joint]).or_else(|| self.common(left, right))
    }

    /// By name, else what hangs on the chest and is no arm.
    fn neck_and_head(&self, chest: usize) -> Option<(usize, usize)> {
        let neck = self.candidates(None, &[Part::Neck]).first().copied();
        let heads = self.candidates(None, &[Part::Head]);
        let head = match neck {
            Some(neck) => heads.iter().copied().find(|&head| self.is_below(head, neck)),
            None => heads.first().copied(),
        };
        match (neck, head) {
            (Some(neck), Some(head)) => Some((neck, head)),
            (Some(neck), None) => Some((neck, self.children(neck).next()?)),
            (None, Some(head)) => match self.above(head).take_while(|&joint| joint != chest).last() {
                Some(neck) if self.is_below(head, chest) => Some((neck, head)),
                _ => Some((head, self.children(head).next()?)),
            },
            (None, None) => {
                let neck = self.children(chest).find(|&joint| !self.joints[joint].end_site && !self.limbs[joint])?;
                // The spine's own name going on (spine.004, spine.005, spine.006), not a face.
                let stem = |joint: usize| names::stem(&self.joints[joint].name);
                let next = |joint: usize| {
                    self.children(joint).find(|&child| !self.joints[child].end_site && stem(child) == stem(neck))
                };
                let head = std::iter::successors(next(neck), |&joint| next(joint)).last();
                Some((neck, head.or_else(|| self.children(neck).next())?))
            }
        }
    }

    /// Length of the line from the pelvis along the spine to the neck.
    fn size(&self, pelvis: usize, neck: usize, at: &[Vector]) -> f64 {
        let line = self.line(pelvis, neck);
        line.windows(2).map(|pair| q::length(q::subtract(at[pair[1]], at[pair[0]]))).sum()
    }

    /// Pelvis, what lies between, neck.
    fn line(&self, pelvis: usize, neck: usize) -> Vec<usize> {
        let mut line = vec![neck];
        line.extend(self.above(neck).take_while(|&joint| joint != pelvis && !self.is_below(pelvis, joint)));
        line.push(pelvis);
        line.reverse();
        line
    }

    fn spine(&self, pelvis: usize, neck: usize, at: &[Vector]) -> [Place; 3] {
        let small = 1e-3 * self.size(pelvis, neck, at);
        let apart = |a: usize, b: usize| q::length(q::subtract(at[a], at[b])) > small;
        let mut line = vec![pelvis];
        for joint in self.line(pelvis, neck).into_iter().skip(1) {
            // Joints in the same place are one.
            if line.last().is_none_or(|&last| apart(last, joint)) {
                line.push(joint);
            }
        }
        match (line.last(), line.len()) {
            // The last one fell together with the joint before.
            (Some(&last), 2..) if last != neck => drop(line.splice(line.len() - 1.., [neck])),
            _ => {}
        }
        if let [_, a, b, c, _] = line[..] {
            return [a, b, c].map(Place::joint);
        }
        let lengths = [3, 6, 9, 12].map(|joint| uniform::BONE_LENGTHS[joint]);
        let whole: f64 = lengths.iter().sum();
        let mut share = 0.0;
        [0, 1, 2].map(|i| {
            share += lengths[i] / whole;
            along(&line, share, at)
        })
    }
}

/// The point at a share of the length of a line through joints.
fn along(line: &[usize], share: f64, at: &[Vector]) -> Place {
    let length = |pair: &[usize]| q::length(q::subtract(at[pair[1]], at[pair[0]]));
    let mut left = share * line.windows(2).map(length).sum::<f64>();
    for pair in line.windows(2) {
        let bone = length(pair);
        if left <= bone && bone > 0.0 {
            return Place { from: pair[0], to: pair[1], at: left / bone };
        }
        left -= bone;
    }
    Place::joint(line.last().copied().unwrap_or_default())
}
