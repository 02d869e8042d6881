//! Anchors met in the motion itself: the edit of `refining::motion_space`, in f64 over whole motions.
//!
//! The model is a Gaussian prior on what is added: velocities of the root with covariance `N(s - s'; 0, 4) / 100`, heights with a Matern 3/2
//! of 6 frames and 5 cm, each chain's own way with a Gaussian of 6 frames. Covariances of the path are double sums here, systems are dense,
//! every pose of a repetition is made anew from the generated motion.
//!
//! | file | what |
//! |---|---|
//! | [`mod@limbs`] | limbs of two bones whose end or middle is put somewhere |
//! | [`mod@stances`] | when feet stand, and what happens in between |
//! | [`mod@strain`] | how far an edit takes a motion |

pub mod limbs;
pub mod stances;
pub mod strain;

use std::collections::BTreeMap;
use std::ops::Range;

use nalgebra::{DMatrix, Vector3};

use super::anchors::Anchor;
use super::recover::JOINTS;
use limbs::{bend, reach};
use stances::{fill, stances};

pub use stances::standing;
pub use strain::strain;

/// A joint's place or a way, metres.
type Vector = Vector3<f64>;
/// A pose.
type Pose = [Vector; JOINTS];

const ROUNDS: usize = 6;
const MORE_ROUNDS: usize = 16;
const MET: f64 = 0.0005;
const RIDGE: f64 = 2e-5;
const OWN_RIDGE: f64 = 1e-3;
const HEIGHT: f64 = 0.05;
const NEAR: usize = 8;
/// Joints that a lean moves, in the order in which they lean.
const UPPER: [usize; 13] = [3, 6, 9, 12, 13, 14, 15, 16, 17, 18, 19, 20, 21];
/// Joints of the trunk, the one that leads first.
const LEADERS: [usize; 8] = [9, 6, 16, 17, 13, 14, 12, 15];

/// Settings of the edit.
#[derive(Debug, Clone, Copy)]
pub struct Exact {
    /// Speed that may be added, metres a second.
    pub added_speed: f64,
    /// Whether feet stay where they stand.
    pub planted: bool,
}

/// What moves for an anchor: the joint at the end of a chain, and by which of its chains.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
enum Chain {
    Body,
    /// About the pelvis.
    Lean(usize),
    /// By the bones next to it: knees and elbows about their limb's root, ankles and wrists by two bones, toes about their ankle, neck, head,
    /// collar bones and shoulders on the upper spine.
    Limb(usize),
}

fn chain(anchor: &Anchor, anchors: &[Anchor]) -> Chain {
    let joint = anchor.joint();
    let meanwhile = |within: usize, other: &dyn Fn(usize) -> bool| {
        anchors.iter().any(|a| a.frame.abs_diff(anchor.frame) <= within && a.joint() != joint && other(a.joint()))
    };
    let rank = |joint: usize| LEADERS.iter().position(|leader| *leader == joint);
    match joint {
        // Toes go with their ankle, but where that has an anchor of its own.
        10 | 11 if !meanwhile(2, &|other| other + 3 == joint) => Chain::Limb(joint - 3),
        4 | 5 | 7 | 8 | 10 | 11 | 18..=21 => Chain::Limb(joint),
        _ => match rank(joint) {
            None => Chain::Body,
            Some(own) if ![6, 9].contains(&joint) && meanwhile(12, &|o| rank(o).is_some_and(|o| o < own)) => {
                Chain::Limb(joint)
            }
            Some(_) => Chain::Lean(joint),
        },
    }
}

/// Standard deviations of a chain's own way, over the floor and in height.
fn own_way(chain: Chain) -> [f64; 2] {
    match chain {
        Chain::Body => [0.0, 0.0],
        Chain::Lean(_) | Chain::Limb(12 | 15) => [0.08, 0.03],
        Chain::Limb(7 | 8 | 10 | 11) => [0.15, 0.5],
        Chain::Limb(18..=21) => [0.15, 0.3],
        Chain::Limb(_) => [0.1, 0.1],
    }
}

struct Point {
    frame: usize,
    chain: Chain,
    way: [f64; 2],
    soft: f64,
    loose: f64,
}

struct Solver<'a> {
    generated: Vec<Pose>,
    anchors: &'a [Anchor],
    points: Vec<Point>,
    step: f64,
    planted: bool,
    /// `[a][b]` covariance of the path at frames a and b.
    path: Vec<Vec<f64>>,
    /// Rows: the path at a frame less that at another.
    rows: Vec<(usize, usize)>,
    weights: Vec<[f64; 2]>,
    heights: Vec<f64>,
    own: Vec<Vector>,
    rest: Vec<Vector>,
    /// A foot's stances with how firmly each is held.
    stances: [Vec<(Range<usize>, f64)>; 2],
    shift: Vec<Vector>,
    put: [Vec<Vector>; 2],
}

/// The motion `[T]` with its anchors met, and each anchor's looseness. `anchors` are distinct, in order of frames and joints.
#[must_use]
pub fn edited(
    motion: &[[[f64; 3]; JOINTS]],
    anchors: &[Anchor],
    settings: Exact,
    frame_rate: f64,
) -> (Vec<[[f64; 3]; JOINTS]>, Vec<f64>) {
    let generated: Vec<Pose> = motion.iter().map(|pose| pose.map(Vector::from)).collect();
    let mut solver = Solver::new(generated, anchors, settings, frame_rate);
    solver.run();
    let out = (0..motion.len()).map(|t| solver.pose(t).map(|v| [v.x, v.y, v.z])).collect();
    (out, solver.points.iter().map(|point| point.loose).collect())
}

fn gaussian(x: f64, width: f64) -> f64 {
    (-0.5 * (x / width).powi(2)).exp()
}

/// Between two frames of a limb's own way.
fn limb(a: usize, b: usize) -> f64 {
    gaussian(a as f64 - b as f64, 6.0)
}

/// Between two frames of the height.
fn tall(a: usize, b: usize) -> f64 {
    let r = 3f64.sqrt() * a.abs_diff(b) as f64 / 6.0;
    (1.0 + r) * (-r).exp()
}

/// `(A + ridge * mean diagonal) x = b`.
fn solve(mut a: DMatrix<f64>, ridge: f64, b: DMatrix<f64>) -> DMatrix<f64> {
    let added = ridge * a.trace() / a.nrows().max(1) as f64;
    for i in 0..a.nrows() {
        a[(i, i)] += added;
    }
    a.lu().solve(&b).unwrap_or_else(|| DMatrix::zeros(b.nrows(), b.ncols()))
}

impl<'a> Solver<'a> {
    fn new(generated: Vec<Pose>, anchors: &'a [Anchor], settings: Exact, frame_rate: f64) -> Self {
        let frames = generated.len();
        let density = |x: f64| 0.01 * gaussian(x, 4.0) / (4.0 * (2.0 * std::f64::consts::PI).sqrt());
        let mut path = vec![vec![0.0; frames]; frames];
        for a in 1..frames {
            for b in 1..frames {
                // One more term in each sum than the neighbour above has.
                let row: f64 = (0..b).map(|s| density((a - 1) as f64 - s as f64)).sum();
                path[a][b] = path[a - 1][b] + row;
            }
        }
        let last = anchors.iter().map(|anchor| anchor.frame).max().unwrap_or(0);
        let end = frames.saturating_sub(1);
        let near = end.min(last + 9);
        let mut rows: Vec<(usize, usize)> = anchors.iter().map(|anchor| (anchor.frame, 0)).collect();
        rows.extend((near > last + 1).then_some((near, last)));
        rows.extend((end > near && end > last + 1).then_some((end, last)));
        let point = |anchor: &Anchor| {
            let chain = chain(anchor, anchors);
            Point { frame: anchor.frame, chain, way: own_way(chain), soft: 1.0, loose: 0.0 }
        };
        let stances = [10, 11].map(|toe| if settings.planted { stances(&generated, toe) } else { Vec::new() });
        let mut solver = Self {
            anchors,
            points: anchors.iter().map(point).collect(),
            step: (settings.added_speed / frame_rate).max(0.001),
            planted: settings.planted,
            path,
            weights: vec![[0.0; 2]; rows.len()],
            rows,
            heights: vec![0.0; anchors.len()],
            own: vec![Vector::zeros(); anchors.len()],
            rest: vec![Vector::zeros(); frames],
            stances,
            shift: Vec::new(),
            put: [Vec::new(), Vec::new()],
            generated,
        };
        solver.build();
        solver
    }

    fn run(&mut self) {
        if self.anchors.is_empty() {
            return;
        }
        for round in 0..MORE_ROUNDS {
            let off: Vec<f64> = self.lacks(f64::INFINITY).iter().map(Vector::norm).collect();
            let open = off.iter().zip(&self.points).any(|(off, point)| *off > MET && point.loose == 0.0);
            if (!open || round >= ROUNDS) && !self.loosen() {
                break;
            }
            for (point, off) in self.points.iter_mut().zip(&off) {
                if round > 0 && *off > MET && point.loose == 0.0 {
                    point.soft *= 0.1;
                }
            }
            self.round();
        }
        let lacks = self.lacks(self.step);
        let last: BTreeMap<usize, Vector> = (self.points.iter().zip(lacks))
            .filter(|(point, lack)| point.chain == Chain::Body && point.loose == 0.0 && lack.norm() <= 0.03)
            .map(|(point, lack)| (point.frame, lack))
            .collect();
        if !last.is_empty() {
            let known: Vec<bool> = (0..self.generated.len()).map(|t| last.contains_key(&t)).collect();
            let offsets = (0..known.len()).map(|t| last.get(&t).copied().unwrap_or_default()).collect();
            self.rest = fill(offsets, &known);
            self.build();
            self.sweep();
        }
    }

    /// What the anchors lack, each at most so far as speed allows from the first frame on.
    fn lacks(&self, step: f64) -> Vec<Vector> {
        let lack = |anchor: &Anchor| {
            let mut at = self.pose(anchor.frame)[anchor.joint()];
            let mut target = Vector::from(anchor.position());
            if !anchor.fixes_height() {
                (at.y, target.y) = (0.0, 0.0);
            }
            let whole = target - at;
            let most = step * (anchor.frame + NEAR) as f64;
            if whole.norm() > most { whole * (most / whole.norm()) } else { whole }
        };
        self.anchors.iter().map(lack).collect()
    }

    fn noise(&self, row: usize) -> f64 {
        let (plus, minus) = self.rows[row];
        match self.points.get(row) {
            Some(point) => point.loose * self.path[plus][plus],
            None => (0.015 * (plus - minus) as f64).powi(2),
        }
    }

    /// Of two anchors' own ways, over the floor (0) or in height (1).
    fn ways(&self, i: usize, j: usize, axis: usize) -> f64 {
        let (Some(a), Some(b)) = (self.points.get(i), self.points.get(j)) else { return 0.0 };
        let same = f64::from(u8::from(a.chain == b.chain));
        same * a.way[axis] * b.way[axis] * a.soft * b.soft * limb(a.frame, b.frame)
    }

    fn round(&mut self) {
        let (lacks, n) = (self.lacks(self.step), self.points.len());
        let path = |a: usize, b: usize| self.path[a][b];
        let system = DMatrix::from_fn(self.rows.len(), self.rows.len(), |i, j| {
            let ((p, m), (q, l)) = (self.rows[i], self.rows[j]);
            path(p, q) - path(p, l) - path(m, q)
                + path(m, l)
                + self.ways(i, j, 0)
                + if i == j { self.noise(i) } else { 0.0 }
        });
        let right = DMatrix::from_fn(self.rows.len(), 2, |i, c| {
            let (plus, minus) = self.rows[i];
            let lack = lacks.get(i).copied().unwrap_or_else(|| self.shift[minus] - self.shift[plus]);
            lack[2 * c] - self.noise(i) * self.weights[i][c]
        });
        // The runtime's system always has two rows for the tail; those that say nothing count for the ridge.
        let ridge = RIDGE * self.rows.len() as f64 / (n + 2) as f64;
        let found = solve(system, ridge, right);
        let height = |i: usize| self.anchors[i].fixes_height();
        let system = DMatrix::from_fn(n, n, |i, j| {
            let both = if height(i) && height(j) {
                HEIGHT.powi(2) * tall(self.points[i].frame, self.points[j].frame) + self.ways(i, j, 1)
            } else {
                0.0
            };
            let own = HEIGHT.powi(2) * if height(i) { self.points[i].loose } else { 1.0 };
            both + if i == j { own } else { 0.0 }
        });
        let right = DMatrix::from_fn(n, 1, |i, _| lacks[i].y - self.points[i].loose * self.heights[i]);
        let heights = solve(system, RIDGE, right);
        for (i, weight) in self.weights.iter_mut().enumerate() {
            *weight = [weight[0] + found[(i, 0)], weight[1] + found[(i, 1)]];
        }
        for (i, weight) in self.heights.iter_mut().enumerate() {
            *weight += HEIGHT.powi(2) * heights[(i, 0)];
        }
        self.build();
        self.sweep();
    }

    fn sweep(&mut self) {
        for _ in 0..2 {
            let (lacks, n) = (self.lacks(self.step), self.points.len());
            let body = |i: usize| self.points[i].chain == Chain::Body;
            let system = DMatrix::from_fn(n, n, |i, j| {
                let (a, b) = (&self.points[i], &self.points[j]);
                let shared = if a.chain == b.chain && !body(i) { limb(a.frame, b.frame) } else { 0.0 };
                shared + if i == j { if body(i) { 1.0 } else { a.loose } } else { 0.0 }
            });
            let right = DMatrix::from_fn(n, 3, |i, c| {
                (if body(i) { 0.0 } else { lacks[i][c] }) - self.points[i].loose * self.own[i][c]
            });
            let found = solve(system, OWN_RIDGE, right);
            for (i, own) in self.own.iter_mut().enumerate() {
                *own += Vector::new(found[(i, 0)], found[(i, 1)], found[(i, 2)]);
            }
        }
    }

    /// Path and feet of the present weights.
    fn build(&mut self) {
        let shift = |t: usize| {
            let mut shift = self.rest[t];
            for ((plus, minus), [x, z]) in self.rows.iter().zip(&self.weights) {
                let covariance = self.path[t][*plus] - self.path[t][*minus];
                shift += Vector::new(x * covariance, 0.0, z * covariance);
            }
            for (point, weight) in self.points.iter().zip(&self.heights) {
                shift.y += weight * tall(t, point.frame);
            }
            shift
        };
        self.shift = (0..self.generated.len()).map(shift).collect();
        self.put = [(0, 10), (1, 11)].map(|(side, toe)| match self.planted {
            true => self.foot(&self.stances[side], toe),
            false => vec![Vector::zeros(); self.generated.len()],
        });
    }

    /// Where a foot is put, beside what is added to all joints.
    fn foot(&self, stances: &[(Range<usize>, f64)], toe: usize) -> Vec<Vector> {
        let frames = self.generated.len();
        let own: Vec<&Anchor> = (self.anchors.iter().zip(&self.points))
            .filter(|(anchor, point)| [toe, toe - 3].contains(&anchor.joint()) && point.loose == 0.0)
            .map(|(anchor, _)| anchor)
            .collect();
        let wanted = |anchor: &Anchor| Vector::from(anchor.position()) - self.generated[anchor.frame][anchor.joint()];
        let (mut known, mut put) = (vec![false; frames], vec![Vector::zeros(); frames]);
        for (stance, held) in stances {
            let count = stance.len() as f64;
            let mean = stance.clone().map(|t| self.generated[t][toe]).sum::<Vector>() / count;
            let inside: Vec<Vector> =
                own.iter().filter(|anchor| stance.contains(&anchor.frame)).map(|anchor| wanted(anchor)).collect();
            let mut whole = stance.clone().map(|t| self.shift[t]).sum::<Vector>() / count;
            whole.y = 0.0;
            if !inside.is_empty() {
                whole = inside.iter().sum::<Vector>() / inside.len() as f64;
            }
            for t in stance.clone() {
                let slid = mean - self.generated[t][toe];
                let mut offset = whole + 0.65 * Vector::new(slid.x, 0.0, slid.z) - self.shift[t];
                if inside.is_empty() {
                    offset *= *held;
                    let aside = offset.x.hypot(offset.z);
                    let share = if aside > 1e-6 { 0.15 * (aside / 0.15).tanh() / aside } else { 1.0 };
                    (offset.x, offset.z) = (offset.x * share, offset.z * share);
                }
                (known[t], put[t]) = (true, offset);
            }
        }
        for anchor in &own {
            if !known[anchor.frame] {
                (known[anchor.frame], put[anchor.frame]) = (true, wanted(anchor) - self.shift[anchor.frame]);
            }
        }
        let mut put = fill(put, &known);
        for (t, put) in put.iter_mut().enumerate() {
            let was = self.generated[t][toe].y;
            if !own.iter().any(|anchor| anchor.frame == t) {
                put.y = put.y.max(-was - self.shift[t].y);
            }
        }
        put
    }

    fn way(&self, t: usize, chain: Chain) -> Option<Vector> {
        let mut of = self.points.iter().zip(&self.own).filter(|(point, _)| point.chain == chain).peekable();
        of.peek()?;
        Some(of.map(|(point, own)| own * limb(t, point.frame)).sum())
    }

    /// The edited pose of a frame.
    fn pose(&self, t: usize) -> Pose {
        let mut p = self.generated[t].map(|joint| joint + self.shift[t]);
        let across = p[1] - p[2] + p[16] - p[17];
        let along = Vector::new(-across.z, 0.0, across.x);
        let forward = if along.norm() > 1e-6 { along.normalize() } else { Vector::z() };
        for (side, [hip, knee, ankle, toe]) in [[1, 4, 7, 10], [2, 5, 8, 11]].into_iter().enumerate() {
            let [of_knee, of_ankle, of_toe] = [knee, ankle, toe].map(|joint| self.way(t, Chain::Limb(joint)));
            if !self.planted && of_knee.is_none() && of_ankle.is_none() && of_toe.is_none() {
                continue;
            }
            let sole = p[toe] - p[ankle];
            let target = p[ankle] + self.put[side][t] + of_ankle.unwrap_or_default();
            (p[knee], p[ankle]) = reach([p[hip], p[knee], p[ankle]], target, forward * 0.02);
            if let Some(way) = of_knee {
                (p[knee], p[ankle]) = bend([p[hip], p[knee], p[ankle]], p[knee] + way);
            }
            p[toe] = p[ankle] + of_toe.map_or(sole, |way| (sole + way).normalize() * sole.norm());
        }
        for joint in UPPER {
            let Some(way) = self.way(t, Chain::Lean(joint)) else { continue };
            let from = p[joint] - p[0];
            let (a, b) = (from.normalize(), (from + way).normalize());
            // The shortest turn from a to b.
            let across = a.cross(&b);
            for moved in UPPER {
                let r = p[moved] - p[0];
                let once = across.cross(&r);
                p[moved] += once + across.cross(&once) / (1.0 + a.dot(&b));
            }
        }
        let (neck, head) = (self.way(t, Chain::Limb(12)), self.way(t, Chain::Limb(15)));
        if neck.is_some() || head.is_some() {
            let target = p[15] + head.unwrap_or_default();
            (p[12], p[15]) = reach([p[9], p[12], p[15]], target, forward * -0.02);
            (p[12], p[15]) = bend([p[9], p[12], p[15]], p[12] + neck.unwrap_or_default());
        }
        for [collar, shoulder, elbow, wrist] in [[13, 16, 18, 20], [14, 17, 19, 21]] {
            let [of_collar, of_shoulder] = [collar, shoulder].map(|joint| self.way(t, Chain::Limb(joint)));
            if of_collar.is_some() || of_shoulder.is_some() {
                let was = p[shoulder];
                let target = was + of_shoulder.unwrap_or_default();
                (p[collar], p[shoulder]) = reach([p[9], p[collar], was], target, Vector::zeros());
                let target = p[collar] + of_collar.unwrap_or_default();
                (p[collar], p[shoulder]) = bend([p[9], p[collar], p[shoulder]], target);
                let along = p[shoulder] - was;
                p[elbow] += along;
                p[wrist] += along;
            }
            let [of_elbow, of_wrist] = [elbow, wrist].map(|joint| self.way(t, Chain::Limb(joint)));
            if of_elbow.is_some() || of_wrist.is_some() {
                let target = p[wrist] + of_wrist.unwrap_or_default();
                (p[elbow], p[wrist]) = reach([p[shoulder], p[elbow], p[wrist]], target, forward * -0.02);
                if let Some(way) = of_elbow {
                    (p[elbow], p[wrist]) = bend([p[shoulder], p[elbow], p[wrist]], p[elbow] + way);
                }
            }
        }
        p
    }

    /// Loosens what asks for too much speed: anchors, and stances that a foot would have to hurry to.
    fn loosen(&mut self) -> bool {
        let frames = self.generated.len();
        let mut excess = vec![0.0f64; self.points.len()];
        let mut blame = |from: usize, to: usize, way: Vector, guilty: &dyn Fn(Chain) -> bool| {
            let times = way.norm() / self.step;
            for (excess, point) in excess.iter_mut().zip(&self.points) {
                if times > 1.0 && point.frame + NEAR >= from && point.frame <= to + NEAR && guilty(point.chain) {
                    *excess = excess.max(times);
                }
            }
        };
        for t in 1..frames {
            let path = self.shift[t] - self.shift[t - 1];
            let along = |chain| {
                let way = |t| self.way(t, chain).unwrap_or_default();
                path + way(t) - way(t - 1)
            };
            if 2.0 * path.norm() > self.step {
                let before = self.points.iter().map(|p| p.frame).filter(|f| *f <= t).max().unwrap_or(t);
                let behind = self.points.iter().map(|p| p.frame).filter(|f| *f >= t).min().unwrap_or(t);
                let (from, to) = match (t - before <= NEAR, behind - t <= NEAR) {
                    (true, false) => (before, before),
                    (false, true) => (behind, behind),
                    _ => (before, behind),
                };
                blame(from, to, path, &|_| true);
            }
            for point in self.points.iter().filter(|point| point.chain != Chain::Body) {
                blame(t, t, along(point.chain), &|chain| chain == point.chain);
            }
            for (put, ankle) in self.put.iter().zip([7, 8]) {
                let chain = Chain::Limb(ankle);
                blame(t, t, along(chain) + put[t] - put[t - 1], &|other| other == chain);
            }
        }
        let mut any = false;
        for (side, stances) in self.stances.iter_mut().enumerate() {
            let ends: Vec<usize> = stances.iter().skip(1).map(|(next, _)| next.start + 1).chain([frames]).collect();
            let mut from = 0;
            for ((stance, held), end) in stances.iter_mut().zip(ends) {
                let whole = |t: usize| self.shift[t] + self.put[side][t];
                // From the end of the stance before to the beginning of the next.
                let fastest = (from + 1..end).map(|t| (whole(t) - whole(t - 1)).norm()).fold(0.0, f64::max);
                from = stance.end;
                if fastest > self.step && *held > 2.0 / 255.0 {
                    // As firmly as a byte says.
                    *held = ((*held * 255.0 * self.step / fastest).floor() / 255.0).max(2.0 / 255.0);
                    any = true;
                }
            }
        }
        for (point, excess) in self.points.iter_mut().zip(excess).filter(|(_, excess)| *excess > 0.0) {
            point.loose = (excess.max(1.2) * if point.loose > 0.0 { point.loose } else { 0.02 }).min(1e6);
            any = true;
        }
        any
    }
}
