//! What the rules look at: heights, headings and speeds of a motion.

use crate::motion::{JOINTS, Pose, skeleton, widened};

/// Joints by name.
pub(super) mod joint {
    pub const PELVIS: usize = 0;
    pub const NECK: usize = 12;
    pub const HEAD: usize = 15;
}

/// Joint numbers of one side: hip, knee, ankle, foot, shoulder, elbow, wrist.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limbs {
    pub hip: usize,
    pub knee: usize,
    pub ankle: usize,
    pub foot: usize,
    pub shoulder: usize,
    pub elbow: usize,
    pub wrist: usize,
}

/// Left, then right.
pub(super) const LIMBS: [Limbs; 2] = [
    Limbs { hip: 1, knee: 4, ankle: 7, foot: 10, shoulder: 16, elbow: 18, wrist: 20 },
    Limbs { hip: 2, knee: 5, ankle: 8, foot: 11, shoulder: 17, elbow: 19, wrist: 21 },
];

/// Height of the ankle and the flesh below it, added to the bones of the leg, metres.
const SOLE: f64 = 0.15;
/// Headings and velocities are means over so long, seconds: a step's sway does not show.
const SMOOTHING: f64 = 0.5;
/// The floor is as high as the lower foot in this share of the frames: a foot that sinks for a moment does not lower it.
const FLOOR_SHARE: f64 = 0.05;

/// A point or direction, `[x, y, z]`, metres.
pub(super) type Point = [f64; 3];

/// A motion with what is derived from it; every vector has one entry a frame.
pub(super) struct Body {
    /// Frames a second.
    pub fps: f64,
    /// Global joints, metres.
    pub joints: Vec<[Point; JOINTS]>,
    /// Height of the ground, metres.
    pub floor: f64,
    /// Length of an arm, shoulder to wrist, metres.
    pub arm: f64,
    /// Height of the pelvis over the ground as a share of the leg's length: about .95 when a person stands.
    pub height: Vec<f64>,
    /// Heading, radians, without jumps; it grows as the body turns left.
    pub heading: Vec<f64>,
    /// Horizontal velocity of the pelvis seen from the body, `[forward, left]`, m/s.
    pub velocity: Vec<[f64; 2]>,
    /// Speed over the ground of the slower of pelvis and feet, m/s: who rises from a chair or swings a leg does not get about.
    pub speed: Vec<f64>,
    /// Angle of the line from pelvis to neck from the vertical, degrees.
    pub lean: Vec<f64>,
    /// How far each foot's lower joint is above where it stands, `[left, right]`, metres.
    pub lift: Vec<[f64; 2]>,
}

impl Body {
    /// `None` for a motion that no rule can judge: fewer than three frames, values or a rate that are not finite.
    pub fn new(motion: &[Pose], fps: f64) -> Option<Self> {
        let finite = motion.iter().flatten().flatten().all(|x| x.is_finite());
        if motion.len() < 3 || !finite || !fps.is_finite() || fps <= 0.0 {
            return None;
        }
        let joints: Vec<[Point; JOINTS]> = widened(motion);
        let standing = |j: usize| quantile(joints.iter().map(|pose| pose[j][1]).collect(), FLOOR_SHARE);
        let floor = quantile(joints.iter().map(|pose| pose[10][1].min(pose[11][1])).collect(), FLOOR_SHARE);
        let first = &joints[0];
        let chain = |joints: &[usize]| -> f64 {
            joints.windows(2).map(|pair| length(minus(first[pair[0]], first[pair[1]]))).sum()
        };
        let leg = 0.5 * LIMBS.map(|l| chain(&[l.hip, l.knee, l.ankle])).iter().sum::<f64>() + SOLE;
        let arm = 0.5 * LIMBS.map(|l| chain(&[l.shoulder, l.elbow, l.wrist])).iter().sum::<f64>();
        let window = frames(SMOOTHING, fps);
        let mut heading: Vec<f64> = joints.iter().map(heading).collect();
        for t in 1..heading.len() {
            let turn = (heading[t] - heading[t - 1]).rem_euclid(std::f64::consts::TAU);
            let turn = if turn > std::f64::consts::PI { turn - std::f64::consts::TAU } else { turn };
            heading[t] = heading[t - 1] + turn;
        }
        let heading = smooth(&heading, window);
        let pelvis = |pose: &[Point; JOINTS], c: usize| pose[joint::PELVIS][c];
        let feet = |pose: &[Point; JOINTS], c: usize| 0.5 * (pose[LIMBS[0].ankle][c] + pose[LIMBS[1].ankle][c]);
        let over_ground = |place: &dyn Fn(&[Point; JOINTS], usize) -> f64| {
            [0, 2].map(|c| {
                let places: Vec<f64> = joints.iter().map(|pose| place(pose, c)).collect();
                slope(&smooth(&places, window), fps)
            })
        };
        let [x, z] = over_ground(&pelvis);
        let [feet_x, feet_z] = over_ground(&feet);
        let speed = (0..joints.len()).map(|t| x[t].hypot(z[t]).min(feet_x[t].hypot(feet_z[t]))).collect();
        let velocity = (0..joints.len())
            .map(|t| {
                let (sin, cos) = heading[t].sin_cos();
                [x[t] * sin + z[t] * cos, x[t] * cos - z[t] * sin]
            })
            .collect();
        let stands = LIMBS.map(|l| [(l.ankle, standing(l.ankle)), (l.foot, standing(l.foot))]);
        let lift = |pose: &[Point; JOINTS]| {
            stands.map(|foot| foot.iter().map(|(j, low)| pose[*j][1] - low).fold(f64::INFINITY, f64::min))
        };
        Some(Self {
            fps,
            floor,
            arm: arm.max(1e-3),
            height: joints.iter().map(|pose| (pose[joint::PELVIS][1] - floor) / leg).collect(),
            lean: joints.iter().map(|pose| from_vertical(minus(pose[joint::NECK], pose[joint::PELVIS]))).collect(),
            lift: joints.iter().map(lift).collect(),
            heading,
            velocity,
            speed,
            joints,
        })
    }

    /// Number of frames.
    pub fn len(&self) -> usize {
        self.joints.len()
    }

    /// Number of frames in so many seconds, at least one.
    pub fn frames(&self, seconds: f64) -> usize {
        frames(seconds, self.fps)
    }

    /// A vector from one joint to another seen from the body, `[left, up, forward]`, metres.
    pub fn seen(&self, t: usize, from: usize, to: usize) -> Point {
        let [x, y, z] = minus(self.joints[t][to], self.joints[t][from]);
        let (sin, cos) = self.heading[t].sin_cos();
        [x * cos - z * sin, y, x * sin + z * cos]
    }

    /// Speed of one joint relative to another in each frame, m/s.
    pub fn relative_speed(&self, from: usize, to: usize) -> Vec<f64> {
        let at = |t: usize| minus(self.joints[t][to], self.joints[t][from]);
        let change = |t: usize| {
            let (a, b) = (t.saturating_sub(1), (t + 1).min(self.len() - 1));
            length(minus(at(b), at(a))) * self.fps / (b - a).max(1) as f64
        };
        (0..self.len()).map(change).collect()
    }

    /// Mean of a signal over its first and over its last `seconds`.
    pub fn ends(&self, signal: &[f64], seconds: f64) -> [f64; 2] {
        let n = self.frames(seconds).min(signal.len());
        [mean(&signal[..n]), mean(&signal[signal.len() - n..])]
    }
}

/// The direction that hips and shoulders face, radians from +z to +x.
fn heading(pose: &[Point; JOINTS]) -> f64 {
    let across = |a: usize, b: usize| minus(pose[a], pose[b]);
    let hips = across(skeleton::LEFT_HIP, skeleton::RIGHT_HIP);
    let shoulders = across(skeleton::LEFT_SHOULDER, skeleton::RIGHT_SHOULDER);
    let [x, z] = [hips[0] + shoulders[0], hips[2] + shoulders[2]];
    (-z).atan2(x)
}

fn frames(seconds: f64, fps: f64) -> usize {
    ((seconds * fps).round() as usize).max(1)
}

/// Angle from straight up, degrees.
pub(super) fn from_vertical(v: Point) -> f64 {
    (v[1] / length(v).max(1e-9)).clamp(-1.0, 1.0).acos().to_degrees()
}

/// The difference a - b.
pub(super) fn minus(a: Point, b: Point) -> Point {
    std::array::from_fn(|c| a[c] - b[c])
}

/// Euclidean length.
pub(super) fn length(v: Point) -> f64 {
    v.iter().map(|x| x * x).sum::<f64>().sqrt()
}

/// Arithmetic mean; 0 of nothing.
pub(super) fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// The value that a share of the values does not exceed; 0 of nothing.
pub(super) fn quantile(mut values: Vec<f64>, share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let place = (share * values.len().saturating_sub(1) as f64).round() as usize;
    values.get(place).copied().unwrap_or(0.0)
}

/// Means over a window around each frame, cut at the ends.
pub(super) fn smooth(values: &[f64], window: usize) -> Vec<f64> {
    let half = window / 2;
    let around = |t: usize| mean(&values[t.saturating_sub(half)..(t + half + 1).min(values.len())]);
    (0..values.len()).map(around).collect()
}

/// Change a second, by central differences.
fn slope(values: &[f64], fps: f64) -> Vec<f64> {
    let change = |t: usize| {
        let (a, b) = (t.saturating_sub(1), (t + 1).min(values.len() - 1));
        (values[b] - values[a]) * fps / (b - a).max(1) as f64
    };
    (0..values.len()).map(change).collect()
}

/// The runs of frames in which a condition holds, each `from..to`, of at least `least` frames.
pub(super) fn runs(holds: &[bool], least: usize) -> Vec<std::ops::Range<usize>> {
    let mut found = Vec::new();
    let mut from = 0;
    for run in holds.chunk_by(|a, b| a == b) {
        if run[0] && run.len() >= least {
            found.push(from..from + run.len());
        }
        from += run.len();
    }
    found
}

/// The runs of frames in which a condition holds, those put together that are at most `gap` frames apart.
pub(super) fn bridged(holds: &[bool], gap: usize) -> Vec<std::ops::Range<usize>> {
    let mut found: Vec<std::ops::Range<usize>> = Vec::new();
    for run in runs(holds, 1) {
        match found.last_mut() {
            Some(last) if run.start - last.end <= gap => last.end = run.end,
            _ => found.push(run),
        }
    }
    found
}

/// Where a signal turns back after it went at least `least` one way: frame and value of each turn, in order.
pub(super) fn reversals(values: &[f64], least: f64) -> Vec<(usize, f64)> {
    let mut turns = Vec::new();
    let (mut low, mut high) = ((0, f64::INFINITY), (0, f64::NEG_INFINITY));
    let mut direction = 0;
    for (t, value) in values.iter().enumerate() {
        if *value < low.1 {
            low = (t, *value);
        }
        if *value > high.1 {
            high = (t, *value);
        }
        if direction >= 0 && *value < high.1 - least {
            if direction > 0 {
                turns.push(high);
            }
            (direction, low) = (-1, (t, *value));
        } else if direction <= 0 && *value > low.1 + least {
            if direction < 0 {
                turns.push(low);
            }
            (direction, high) = (1, (t, *value));
        }
    }
    turns
}
