//! The reconstruction objective and its gradient with respect to the decoder's output, in plain loops.
//!
//! All terms are needed in metres and over time, which takes many passes over the batch as framework operations and one here.
//! For a crop of T frames with normalised output y, target x (error e = y - x), standard deviations s and `D = s e`:
//!
//! * features: `mean_t sum_c w_c smooth_l1(e_tc)`, w_c = share of the channel's group / channels of the group
//! * position: `mean_{t,j} |D_tj|` over the 21 local joint positions (root-aligned error, metres)
//! * square: `mean_{t,j} |D_tj|^2`, same joints
//! * velocity: `mean_{t,j} |D_{t+1,j} - D_tj|`, same joints
//! * bones: `mean_{t,j} | |b_tj(y)| - |b_tj(x)| |` over the 21 bones, `b` from a joint's parent to the joint (metres)
//! * root: `mean_t |p(y)_t - p(x)_t|` on the floor after roll-out (EQUATIONS section 1)
//! * heading: `mean_t |2 (a(y)_t - a(x)_t)|` after roll-out
//!
//! Distances are `sqrt(d^2 + eps^2) - eps`, so that the gradient at zero is zero. Means run over all valid frames of the batch; the roll-out
//! starts with every crop. In crops with synthetic legs the channels of legs and contacts ([`of_legs`]) have an error of zero in all terms but
//! two, and other joints weigh as much as in other crops: their features have a faint weight, `made_up` times the usual one, and bones keep
//! their lengths. Left free altogether they grow without end and take the training with them (seen at step 12,000). They are to move smoothly:
//!
//! * legs: `mean_{t,j} |y_{t+1,j} - 2 y_tj + y_{t-1,j}|` over knees, ankles and feet in metres, of crops with synthetic legs alone

use motionette_host::motion::features::{HEIGHT, PLANAR_VELOCITY, POSITIONS, YAW_VELOCITY, of_legs};
use motionette_host::motion::{JOINTS, skeleton};

use super::batch::Batch;
use super::config::{FEATURES, LossWeights};
use crate::normalization::{GROUPS, Normalization};

/// Rounds the corner of distances, metres or radians.
const EPSILON: f32 = 1e-3;

/// Values of the terms, unweighted, and their weighted sum.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Terms {
    /// Smooth-L1 on normalised features.
    pub features: f32,
    /// Root-aligned joint error, metres.
    pub position: f32,
    /// Its mean square, square metres.
    #[serde(default)]
    pub square: f32,
    /// Its change from frame to frame, metres.
    pub velocity: f32,
    /// Error of the bones' lengths, metres.
    #[serde(default)]
    pub bones: f32,
    /// Change of the velocity of legs that nothing else is said of, metres.
    #[serde(default)]
    pub legs: f32,
    /// Root error on the floor within crops, metres.
    pub root: f32,
    /// Heading error within crops, radians.
    pub heading: f32,
    /// Weighted sum.
    pub total: f32,
}

/// The objective with everything that stays the same during a run.
pub struct Objective {
    weights: LossWeights,
    channel_weights: [f32; FEATURES],
    /// Channels of legs and contacts.
    leg: [bool; FEATURES],
    normalization: Normalization,
}

impl Objective {
    /// For features normalised by `normalization`.
    pub fn new(weights: &LossWeights, normalization: &Normalization) -> Self {
        let mut channel_weights = [0.0; FEATURES];
        for (group, share) in GROUPS.iter().zip(weights.groups) {
            channel_weights[group.clone()].fill(share / group.len() as f32);
        }
        let leg = std::array::from_fn(of_legs);
        Self { weights: weights.clone(), channel_weights, leg, normalization: normalization.clone() }
    }

    /// Terms of a batch and the gradient of the weighted sum.
    ///
    /// `output` and `gradient` are `[B][window][F]` as the batch's features; the gradient is zero beyond the end of a crop.
    pub fn evaluate(&self, output: &[f32], batch: &Batch, window: usize, gradient: &mut [f32]) -> Terms {
        gradient.fill(0.0);
        let frames: usize = batch.lengths.iter().sum();
        let frames = frames.max(1) as f32;
        let mut terms = Terms::default();
        let size = window * FEATURES;
        let crops =
            output.chunks_exact(size).zip(batch.features.chunks_exact(size)).zip(gradient.chunks_exact_mut(size));
        let mut measured = vec![0.0; size];
        for (((y, x), g), (length, synthetic)) in crops.zip(batch.lengths.iter().zip(&batch.synthetic_legs)) {
            let valid = length * FEATURES;
            let own = &y[..valid];
            let mut y = own;
            if *synthetic {
                // Where nothing was measured the output is right as it is. The root's path has no channel among these.
                for (i, value) in measured[..valid].iter_mut().enumerate() {
                    *value = if self.leg[i % FEATURES] { x[i] } else { y[i] };
                }
                y = &measured[..valid];
            }
            let output = Output { own, compared: y, synthetic: *synthetic };
            self.crop(&output, &x[..valid], &mut g[..valid], 1.0 / frames, &mut terms);
            if *synthetic {
                self.smooth(own, &mut g[..valid], 1.0 / frames, &mut terms);
            }
        }
        let w = &self.weights;
        terms.total = terms.features
            + w.position * terms.position
            + w.square * terms.square
            + w.velocity * terms.velocity
            + w.bones * terms.bones
            + w.legs * terms.legs
            + w.root * terms.root
            + w.heading * terms.heading;
        terms
    }

    /// Adds the terms of one crop, each frame with weight `share`.
    fn crop(&self, output: &Output<'_>, x: &[f32], gradient: &mut [f32], share: f32, terms: &mut Terms) {
        let Output { own, compared: y, synthetic } = *output;
        let std = &self.normalization.std;
        let joints = POSITIONS.len() / 3;
        let per_joint = share / joints as f32;
        let mut previous = [0.0f32; POSITIONS.end - POSITIONS.start];
        for (t, (y, x)) in y.chunks_exact(FEATURES).zip(x.chunks_exact(FEATURES)).enumerate() {
            let row = t * FEATURES;
            for c in 0..FEATURES {
                let (e, weight) = match synthetic && self.leg[c] {
                    true => (own[row + c] - x[c], self.weights.made_up * self.channel_weights[c]),
                    false => (y[c] - x[c], self.channel_weights[c]),
                };
                let (value, slope) = smooth_l1(e);
                terms.features += share * weight * value;
                gradient[row + c] += share * weight * slope;
            }
            let mut current = [0.0f32; POSITIONS.end - POSITIONS.start];
            for (k, c) in POSITIONS.enumerate() {
                current[k] = std[c] * (y[c] - x[c]);
            }
            for joint in 0..joints {
                let d: [f32; 3] = std::array::from_fn(|i| current[3 * joint + i]);
                let (value, slope) = distance(d);
                terms.position += per_joint * value;
                terms.square += per_joint * d.iter().map(|d| d * d).sum::<f32>();
                for i in 0..3 {
                    let c = POSITIONS.start + 3 * joint + i;
                    let slope = self.weights.position * slope[i] + self.weights.square * 2.0 * d[i];
                    gradient[row + c] += per_joint * slope * std[c];
                }
                if t == 0 {
                    continue;
                }
                let d: [f32; 3] = std::array::from_fn(|i| current[3 * joint + i] - previous[3 * joint + i]);
                let (value, slope) = distance(d);
                terms.velocity += per_joint * value;
                for i in 0..3 {
                    let c = POSITIONS.start + 3 * joint + i;
                    let g = self.weights.velocity * per_joint * slope[i] * std[c];
                    gradient[row + c] += g;
                    gradient[row - FEATURES + c] -= g;
                }
            }
            previous = current;
            self.bones(
                &own[row..row + FEATURES],
                x,
                &mut gradient[row..row + FEATURES],
                share / (JOINTS - 1) as f32,
                terms,
            );
        }
        self.roll_out(y, x, gradient, share, terms);
    }

    /// The lengths of the bones of one frame.
    fn bones(&self, y: &[f32], x: &[f32], gradient: &mut [f32], per_bone: f32, terms: &mut Terms) {
        let Normalization { mean, std } = &self.normalization;
        // Of each joint's coordinates in the root's frame, which channel holds them: the pelvis has its height alone.
        let channel = |joint: usize, axis: usize| match (joint, axis) {
            (0, 1) => Some(HEIGHT),
            (0, _) => None,
            _ => Some(POSITIONS.start + 3 * (joint - 1) + axis),
        };
        let bone = |row: &[f32], joint: usize| -> [f32; 3] {
            let at = |joint, axis| channel(joint, axis).map_or(0.0, |c| row[c] * std[c] + mean[c]);
            std::array::from_fn(|axis| at(joint, axis) - at(skeleton::PARENTS[joint], axis))
        };
        for joint in 1..JOINTS {
            let (length, direction) = distance(bone(y, joint));
            let (wanted, _) = distance(bone(x, joint));
            let (value, slope) = distance([length - wanted, 0.0, 0.0]);
            terms.bones += per_bone * value;
            let slope = self.weights.bones * per_bone * slope[0];
            for axis in 0..3 {
                for (end, sign) in [(joint, 1.0), (skeleton::PARENTS[joint], -1.0)] {
                    if let Some(c) = channel(end, axis) {
                        gradient[c] += sign * slope * direction[axis] * std[c];
                    }
                }
            }
        }
    }

    /// How legs change their velocity.
    fn smooth(&self, y: &[f32], gradient: &mut [f32], share: f32, terms: &mut Terms) {
        let std = &self.normalization.std;
        let share = share / skeleton::LEGS.len() as f32;
        let frames = y.len() / FEATURES;
        for t in 1..frames.saturating_sub(1) {
            for joint in skeleton::LEGS {
                let first = POSITIONS.start + 3 * (joint - 1);
                let value = |t: usize, axis: usize| y[t * FEATURES + first + axis];
                let change =
                    |axis| std[first + axis] * (value(t + 1, axis) - 2.0 * value(t, axis) + value(t - 1, axis));
                let (value, slope) = distance(std::array::from_fn(change));
                terms.legs += share * value;
                for (axis, slope) in slope.into_iter().enumerate() {
                    let slope = self.weights.legs * share * slope * std[first + axis];
                    for (t, factor) in [(t + 1, 1.0), (t, -2.0), (t - 1, 1.0)] {
                        gradient[t * FEATURES + first + axis] += factor * slope;
                    }
                }
            }
        }
    }

    /// The two terms of the root's path.
    fn roll_out(&self, y: &[f32], x: &[f32], gradient: &mut [f32], share: f32, terms: &mut Terms) {
        let predicted = self.path(y);
        let wanted = self.path(x);
        let frames = predicted.len();
        // Gradients of the objective with respect to the root's position and heading angle at every frame.
        let mut by_position = vec![[0.0f32; 2]; frames];
        let mut by_angle = vec![0.0f32; frames + 1];
        for t in 0..frames {
            let d = [
                predicted[t].position[0] - wanted[t].position[0],
                0.0,
                predicted[t].position[1] - wanted[t].position[1],
            ];
            let (value, slope) = distance(d);
            terms.root += share * value;
            by_position[t] = [share * self.weights.root * slope[0], share * self.weights.root * slope[2]];
            let (value, slope) = distance([2.0 * (predicted[t].angle - wanted[t].angle), 0.0, 0.0]);
            terms.heading += share * value;
            by_angle[t] = share * self.weights.heading * 2.0 * slope[0];
        }
        let std = &self.normalization.std;
        let [vx, vz] = [PLANAR_VELOCITY.start, PLANAR_VELOCITY.start + 1];
        // Positions after frame t depend on v[t] and, through a[t + 1], on all yaw velocities up to w[t].
        let mut later_position = [0.0f32; 2];
        for t in (0..frames).rev() {
            let (sin, cos) = predicted[t].rotation;
            let v = predicted[t].velocity;
            let [gx, gz] = later_position;
            gradient[t * FEATURES + vx] += (cos * gx - sin * gz) * std[vx];
            gradient[t * FEATURES + vz] += (sin * gx + cos * gz) * std[vz];
            // theta = -2 a[t + 1]; x' = cos v_x + sin v_z, z' = cos v_z - sin v_x.
            let by_theta = gx * (cos * v[1] - sin * v[0]) - gz * (sin * v[1] + cos * v[0]);
            by_angle[t + 1] += -2.0 * by_theta;
            later_position[0] += by_position[t][0];
            later_position[1] += by_position[t][1];
        }
        let mut later_angle = 0.0f32;
        for t in (0..frames).rev() {
            later_angle += by_angle[t + 1];
            gradient[t * FEATURES + YAW_VELOCITY] += later_angle * std[YAW_VELOCITY];
        }
    }

    /// Root of a crop that starts at the origin.
    fn path(&self, normalised: &[f32]) -> Vec<RootFrame> {
        let Normalization { mean, std } = &self.normalization;
        let value = |row: &[f32], c: usize| row[c] * std[c] + mean[c];
        let (mut angle, mut position) = (0.0f32, [0.0f32; 2]);
        let mut path = Vec::with_capacity(normalised.len() / FEATURES);
        for row in normalised.chunks_exact(FEATURES) {
            let velocity = [value(row, PLANAR_VELOCITY.start), value(row, PLANAR_VELOCITY.start + 1)];
            let next = angle + value(row, YAW_VELOCITY);
            let (sin, cos) = (-2.0 * next).sin_cos();
            path.push(RootFrame { angle, position, velocity, rotation: (sin, cos) });
            angle = next;
            position[0] += cos * velocity[0] + sin * velocity[1];
            position[1] += cos * velocity[1] - sin * velocity[0];
        }
        path
    }
}

/// What the decoder made of a crop.
struct Output<'o> {
    /// As it is.
    own: &'o [f32],
    /// With the clip's own values where these are made up.
    compared: &'o [f32],
    /// Whether legs and contacts of the clip are made up.
    synthetic: bool,
}

/// The root at one frame.
struct RootFrame {
    /// Half of the heading, `a[t]`.
    angle: f32,
    /// x and z.
    position: [f32; 2],
    /// In the root's frame.
    velocity: [f32; 2],
    /// Sine and cosine of `-2 a[t + 1]`, which turns the velocity.
    rotation: (f32, f32),
}

fn smooth_l1(e: f32) -> (f32, f32) {
    if e.abs() < 1.0 { (0.5 * e * e, e) } else { (e.abs() - 0.5, e.signum()) }
}

fn distance(d: [f32; 3]) -> (f32, [f32; 3]) {
    let length = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2] + EPSILON * EPSILON).sqrt();
    (length - EPSILON, d.map(|x| x / length))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;
    use motionette_host::motion::{Pose, recover};

    fn noise(n: usize, stream: u64) -> Vec<f32> {
        let mut random = Random::new(21, stream);
        (0..n).map(|_| random.symmetric() as f32).collect()
    }

    fn normalization() -> Normalization {
        let mean = noise(FEATURES, 1).iter().map(|x| 0.1 * x).collect();
        let std = noise(FEATURES, 2).iter().map(|x| 0.2 + 0.1 * x).collect();
        Normalization { mean, std }
    }

    fn weights() -> LossWeights {
        LossWeights {
            groups: [0.2, 0.1, 0.1, 0.3, 0.1, 0.1, 0.1],
            position: 1.3,
            square: 1.7,
            velocity: 0.7,
            bones: 0.9,
            legs: 0.8,
            made_up: 0.3,
            root: 1.1,
            heading: 0.6,
            commitment: 0.0,
        }
    }

    #[test]
    fn gradient_agrees_with_differences() {
        let objective = Objective::new(&weights(), &normalization());
        let (window, lengths) = (8, [8, 5]);
        let size = 2 * window * FEATURES;
        let (output, target) = (noise(size, 3), noise(size, 4));
        let mut gradient = vec![0.0; size];
        let batch = Batch { features: target, lengths: lengths.to_vec(), synthetic_legs: vec![false, true] };
        objective.evaluate(&output, &batch, window, &mut gradient);
        let value = |output: &[f32]| {
            let mut ignored = vec![0.0; size];
            f64::from(objective.evaluate(output, &batch, window, &mut ignored).total)
        };
        // All root channels, some of every other group, of legs as well; frames at both ends and in the padding.
        let channels = [0, 1, 2, HEIGHT, 4, 5, 6, 13, 40, 66, 67, 85, 150, 200, 205, 260];
        for crop in 0..2 {
            for t in [0, 1, 4, 5, 7] {
                for c in channels {
                    let i = (crop * window + t) * FEATURES + c;
                    let h = 2e-3;
                    let mut moved = output.clone();
                    moved[i] = output[i] + h;
                    let above = value(&moved);
                    moved[i] = output[i] - h;
                    let slope = (above - value(&moved)) / (2.0 * f64::from(h));
                    let error = (slope - f64::from(gradient[i])).abs();
                    assert!(
                        error < 2e-4 + 2e-2 * slope.abs(),
                        "crop {crop} frame {t} channel {c}: {slope} {}",
                        gradient[i]
                    );
                    if t >= lengths[crop] {
                        assert_eq!(gradient[i], 0.0);
                    }
                }
            }
        }
    }

    /// Root and position terms against joints that the host's own recovery computes.
    #[test]
    fn terms_agree_with_recovered_joints() {
        let normalization = normalization();
        let objective = Objective::new(&weights(), &normalization);
        let window = 12;
        let (output, target) = (noise(window * FEATURES, 5), noise(window * FEATURES, 6));
        let mut gradient = vec![0.0; output.len()];
        let terms = objective.evaluate(&output, &single(target.clone(), window, false), window, &mut gradient);
        let joints = |x: &[f32]| recover::joints(&normalization.restore(x)).unwrap();
        let (a, b) = (joints(&output), joints(&target));
        let root = |t: usize| (a[t][0][0] - b[t][0][0]).hypot(a[t][0][2] - b[t][0][2]);
        let mean = (0..window).map(root).sum::<f32>() / window as f32;
        assert!((terms.root - mean).abs() < 2e-3, "{} {mean}", terms.root);
        let measured = |joints: &[f32], t: usize| -> Vec<f32> {
            let row = &normalization.restore(joints)[t * FEATURES..][..FEATURES];
            row[4..4 + 3 * (JOINTS - 1)].to_vec()
        };
        let squares = |t: usize| -> f32 {
            measured(&output, t).iter().zip(&measured(&target, t)).map(|(a, b)| (a - b).powi(2)).sum()
        };
        let mean = (0..window).map(squares).sum::<f32>() / (window * (JOINTS - 1)) as f32;
        assert!((terms.square - mean).abs() < 2e-3, "{} {mean}", terms.square);
        let length = |pose: &Pose, j: usize| {
            let parent = pose[skeleton::PARENTS[j]];
            (0..3).map(|i| (pose[j][i] - parent[i]).powi(2)).sum::<f32>().sqrt()
        };
        let off = |t: usize| (1..JOINTS).map(|j| (length(&a[t], j) - length(&b[t], j)).abs()).sum::<f32>();
        let mean = (0..window).map(off).sum::<f32>() / (window * (JOINTS - 1)) as f32;
        assert!((terms.bones - mean).abs() < 2e-3, "{} {mean}", terms.bones);
    }

    fn single(features: Vec<f32>, length: usize, synthetic: bool) -> Batch {
        Batch { features, lengths: vec![length], synthetic_legs: vec![synthetic] }
    }

    /// Wrong legs and contacts cost nothing where they are synthetic, whatever else costs the same, but for their faint weight, lengths and
    /// smoothness.
    #[test]
    fn synthetic_legs_and_contacts_are_free() {
        let free = LossWeights { bones: 0.0, legs: 0.0, made_up: 0.0, ..weights() };
        let objective = Objective::new(&free, &normalization());
        let window = 8;
        let (output, target) = (noise(window * FEATURES, 8), noise(window * FEATURES, 9));
        let evaluate = |output: &[f32], synthetic: bool| {
            let mut gradient = vec![0.0; output.len()];
            let terms = objective.evaluate(output, &single(target.clone(), window, synthetic), window, &mut gradient);
            (terms, gradient)
        };
        // Written out: knees, ankles, feet are joints 4, 5, 7, 8, 10, 11; positions and rotations begin with joint 1.
        let mut legs = [false; FEATURES];
        for joint in [4, 5, 7, 8, 10, 11] {
            legs[4 + 3 * (joint - 1)..][..3].fill(true);
            legs[67 + 6 * (joint - 1)..][..6].fill(true);
            legs[193 + 3 * joint..][..3].fill(true);
        }
        legs[259..].fill(true);
        let (terms, gradient) = evaluate(&output, true);
        let (measured, by_measured) = evaluate(&output, false);
        let mut other_legs = output.clone();
        let mut right_legs = output.clone();
        for i in 0..output.len() {
            if legs[i % FEATURES] {
                other_legs[i] += 1.0;
                right_legs[i] = target[i];
                assert!(gradient[i] == 0.0 && by_measured[i] != 0.0, "channel {}", i % FEATURES);
            } else {
                assert_eq!(gradient[i], by_measured[i], "channel {}", i % FEATURES);
            }
        }
        assert_eq!(evaluate(&other_legs, true).0.total, terms.total);
        assert_eq!(evaluate(&right_legs, false).0.total, terms.total);
        assert!(measured.total > terms.total && evaluate(&other_legs, false).0 != measured);
    }

    /// Synthetic legs that stand still or move evenly cost nothing, those that shake do; others are compared with their clip instead.
    #[test]
    fn synthetic_legs_are_to_be_smooth() {
        let objective = Objective::new(&weights(), &normalization());
        let (window, still) = (9, noise(FEATURES, 3));
        let legs = |output: &[f32], synthetic: bool| {
            let mut gradient = vec![0.0; output.len()];
            let batch = single(vec![0.0; output.len()], window, synthetic);
            objective.evaluate(output, &batch, window, &mut gradient).legs
        };
        let mut output = still.repeat(window);
        assert!(legs(&output, true).abs() < 1e-6);
        // The left knee begins with channel 13.
        let std = normalization().std;
        (0..window).for_each(|t| output[t * FEATURES + 13] += 0.1 * t as f32);
        assert!(legs(&output, true).abs() < 1e-6, "even motion");
        output[4 * FEATURES + 13] += 0.5;
        // It leaves its line and returns: changes of 0.5, -1, 0.5, over six joints and nine frames.
        let wanted = 2.0 * 0.5 * std[13] * 2.0 / (6.0 * 9.0);
        assert!((legs(&output, true) - wanted).abs() < 1e-3, "{} {wanted}", legs(&output, true));
        assert_eq!(legs(&output, false), 0.0);
    }

    #[test]
    fn equal_motions_cost_nothing() {
        let objective = Objective::new(&weights(), &normalization());
        let output = noise(8 * FEATURES, 7);
        let mut gradient = vec![1.0; output.len()];
        let terms = objective.evaluate(&output, &single(output.clone(), 8, false), 8, &mut gradient);
        assert!(terms.total.abs() < 1e-6, "{terms:?}");
        assert!(gradient.iter().all(|g| g.abs() < 1e-6));
    }
}
