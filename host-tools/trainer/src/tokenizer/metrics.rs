//! What a tokenizer keeps of a motion: joint errors, drift of the root, use of the codebook.
//!
//! Clips go whole through encoder, nearest codes and decoder (the first 196 frames of longer ones, cut to whole tokens), one at
//! a time, as a device decodes them. Errors compare recovered joints with the dataset's; of clips with synthetic legs, all joints but knees,
//! ankles and feet.

use burn::tensor::{Device, Tensor, TensorData};
use motionette_host::dataset::{ClipView, Dataset, Split};
use motionette_host::metrics::{foot_skating, jerk};
use motionette_host::motion::{FPS, JOINTS, Pose, recover, skeleton};
use serde::{Deserialize, Serialize};

use super::Error;
use super::checkpoint::Checkpoint;
use super::config::{FEATURES, FRAMES_PER_TOKEN, MAX_FRAMES};
use super::model::Network;
use super::quantizer::{Usage, nearest};

/// Frames after which drift is compared between clips of different lengths: 5 s.
const DRIFT_FRAME: usize = 100;

/// Figures of one subset of one split. Joint errors are means over frames, drifts are means over clips.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Split the clips belong to.
    pub split: Split,
    /// Subset the clips belong to.
    pub subset: String,
    /// Number of clips.
    pub clips: usize,
    /// Number of frames.
    pub frames: usize,
    /// Share of the clips whose actor is, or may be, in the training split; null where the dataset does not say.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub known_actor: Option<f64>,
    /// Mean distance of the 21 joints other than the pelvis after moving the pelvis of every frame into place, mm. Errors of
    /// heading count.
    pub mpjpe_root_mm: f64,
    /// The same in the root's own frame, without errors of heading, mm.
    pub mpjpe_local_mm: f64,
    /// Mean distance of all 22 joints in the room, drift included, mm.
    pub mpjpe_global_mm: f64,
    /// Distance of the root on the floor at the last frame, mm.
    pub drift_end_mm: f64,
    /// The same after 5 s, over clips that are that long, mm; null when none is.
    pub drift_5s_mm: Option<f64>,
    /// Error of the heading at the last frame, degrees.
    pub heading_end_deg: f64,
    /// 99th percentile of the error of a bone's length in a frame, mm; null in reports from before it was measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub bones_p99_mm: Option<f64>,
    /// Mean jerk over the clips' frames.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub jerk: Option<Compared>,
    /// Share of frames in which a foot skates, over clips whose feet were measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub skating: Option<Compared>,
    /// Codes that occur.
    pub codes_used: usize,
    /// The same as a share of the codebook.
    pub codes_used_share: f64,
    /// Exponential of the entropy of code frequencies.
    pub perplexity: f64,
}

/// A figure of the decoded motions beside that of the clips themselves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Compared {
    /// Of what the decoder gives.
    pub decoded: f64,
    /// Of the clips.
    pub real: f64,
}

impl Compared {
    fn add(&mut self, figure: impl Fn(&[Pose]) -> f64, decoded: &[Pose], real: &[Pose], frames: usize) {
        self.decoded += frames as f64 * figure(decoded);
        self.real += frames as f64 * figure(real);
    }

    fn over(self, frames: usize) -> Option<Self> {
        let n = frames as f64;
        (frames > 0).then(|| Self { decoded: self.decoded / n, real: self.real / n })
    }
}

/// Sums of one subset.
#[derive(Default)]
struct Sums {
    clips: usize,
    frames: usize,
    /// Clips whose actors are known to be in the training split or not, and those that are.
    told: usize,
    known: usize,
    root: f64,
    local: f64,
    global: f64,
    drift_end: f64,
    drift_5s: f64,
    clips_5s: usize,
    heading: f64,
    /// Errors of every measured bone in every frame, mm.
    bones: Vec<f32>,
    jerk: Compared,
    skating: Compared,
    /// Frames whose feet were measured.
    footed: usize,
    counts: Vec<u64>,
}

/// Reports for every subset of `splits`, in order of first appearance. Clips shorter than one token are left out.
///
/// # Errors
/// [`Error::NoMotion`] when a split has no clip to measure.
pub fn evaluate(checkpoint: &Checkpoint, dataset: &Dataset, splits: &[Split]) -> Result<Vec<Report>, Error> {
    let device = Device::flex();
    let network = Network::new(&checkpoint.config.architecture, &checkpoint.parameters, false, &device);
    let mut reports = Vec::new();
    for split in splits {
        let mut subsets: Vec<(String, Sums)> = Vec::new();
        for clip in dataset.split(*split).filter(|clip| clip.frames() >= FRAMES_PER_TOKEN) {
            let place = subsets.iter().position(|(name, _)| *name == clip.info.subset).unwrap_or_else(|| {
                let counts = vec![0; checkpoint.config.architecture.codes];
                subsets.push((clip.info.subset.clone(), Sums { counts, ..Sums::default() }));
                subsets.len() - 1
            });
            measure(checkpoint, &network, &clip, &device, &mut subsets[place].1);
        }
        if subsets.is_empty() {
            return Err(Error::NoMotion { split: *split });
        }
        reports.extend(subsets.into_iter().map(|(subset, sums)| sums.report(*split, subset)));
    }
    Ok(reports)
}

/// A clip through encoder, nearest codes and decoder.
pub(super) struct Decoded {
    ids: Vec<u16>,
    features: Vec<f32>,
    /// As many frames as whole tokens stand for, of [`MAX_FRAMES`] at most.
    pub joints: Vec<Pose>,
}

/// What the tokenizer makes of a clip of a token or more.
pub(super) fn decoded(checkpoint: &Checkpoint, network: &Network, clip: &ClipView<'_>, device: &Device) -> Decoded {
    let frames = clip.frames().min(MAX_FRAMES) / FRAMES_PER_TOKEN * FRAMES_PER_TOKEN;
    let dim = checkpoint.config.architecture.code_dim;
    let features = checkpoint.normalization.apply(&clip.features[..frames * FEATURES]);
    let x = Tensor::from_data(TensorData::new(features, [1, frames, FEATURES]), device);
    let latents = values(network.encode(x, None));
    let ids = nearest(&checkpoint.codebook, dim, &latents);
    let u: Vec<f32> =
        ids.iter().flat_map(|id| checkpoint.codebook[usize::from(*id) * dim..][..dim].iter().copied()).collect();
    let u = Tensor::from_data(TensorData::new(u, [1, ids.len(), dim]), device);
    let features = checkpoint.normalization.restore(&values(network.decode(u, None)));
    let joints = recover::joints(&features).expect("the decoder gives whole rows");
    Decoded { ids, features, joints }
}

fn measure(checkpoint: &Checkpoint, network: &Network, clip: &ClipView<'_>, device: &Device, sums: &mut Sums) {
    let Decoded { ids, features: decoded, joints } = decoded(checkpoint, network, clip, device);
    let frames = joints.len();
    for id in ids {
        sums.counts[usize::from(id)] += 1;
    }
    if let Some(facts) = &clip.info.facts {
        sums.told += 1;
        sums.known += usize::from(facts.known_actor);
    }
    let wanted = Wanted {
        joints: &clip.joints[..frames],
        features: &clip.features[..frames * FEATURES],
        synthetic_legs: clip.info.synthetic_legs(),
    };
    sums.add(&joints, &decoded, &wanted);
}

fn values(tensor: Tensor<3>) -> Vec<f32> {
    tensor.into_data().try_into_vec().expect("networks compute in f32")
}

/// What should have been decoded.
struct Wanted<'c> {
    joints: &'c [Pose],
    features: &'c [f32],
    synthetic_legs: bool,
}

impl Sums {
    fn add(&mut self, decoded: &[Pose], decoded_features: &[f32], wanted: &Wanted<'_>) {
        let Wanted { joints: wanted, features, synthetic_legs } = *wanted;
        let measured: Vec<usize> = (1..JOINTS).filter(|j| !(synthetic_legs && skeleton::LEGS.contains(j))).collect();
        let count = measured.len() as f64;
        let frames = wanted.len();
        self.clips += 1;
        self.frames += frames;
        let error = |a: &Pose, b: &Pose, j: usize| {
            let parent = skeleton::PARENTS[j];
            1e3 * (distance(a[j], a[parent]) - distance(b[j], b[parent])).abs() as f32
        };
        let bones = decoded.iter().zip(wanted).flat_map(|(a, b)| measured.iter().map(move |j| error(a, b, *j)));
        self.bones.extend(bones);
        self.jerk.add(|motion| jerk(motion, FPS), decoded, wanted, frames);
        if !synthetic_legs {
            self.skating.add(|motion| foot_skating(motion, 0.0), decoded, wanted, frames);
            self.footed += frames;
        }
        let mut angle = 0.0f64;
        for t in 0..frames {
            let (a, b) = (&decoded[t], &wanted[t]);
            let offset: [f32; 3] = std::array::from_fn(|i| b[0][i] - a[0][i]);
            let turn = 2.0 * angle;
            let (sin, cos) = (turn.sin() as f32, turn.cos() as f32);
            let (mut root, mut local, mut global) = (0.0, 0.0, distance(a[0], b[0]));
            for (p, q) in measured.iter().map(|j| (&a[*j], &b[*j])) {
                global += distance(*p, *q);
                root += distance([p[0] + offset[0], p[1] + offset[1], p[2] + offset[2]], *q);
                let r: [f32; 3] = std::array::from_fn(|i| p[i] - a[0][i]);
                let turned = [cos * r[0] + sin * r[2] + b[0][0], r[1] + b[0][1], cos * r[2] - sin * r[0] + b[0][2]];
                local += distance(turned, *q);
            }
            self.root += root / count;
            self.local += local / count;
            self.global += global / (count + 1.0);
            if t == DRIFT_FRAME {
                self.drift_5s += planar(a[0], b[0]);
                self.clips_5s += 1;
            }
            if t + 1 == frames {
                self.drift_end += planar(a[0], b[0]);
                self.heading += turn.abs().to_degrees();
            }
            // Joints turn by -2 a[t]: what the decoder turned too far is taken back.
            angle += f64::from(decoded_features[t * FEATURES]) - f64::from(features[t * FEATURES]);
        }
    }

    fn report(mut self, split: Split, subset: String) -> Report {
        let frames = self.frames as f64;
        let clips = self.clips as f64;
        let usage = Usage::of(&self.counts);
        let rank = (0.99 * self.bones.len().saturating_sub(1) as f64).round() as usize;
        let bones = (!self.bones.is_empty()).then(|| *self.bones.select_nth_unstable_by(rank, f32::total_cmp).1);
        Report {
            split,
            subset,
            clips: self.clips,
            frames: self.frames,
            known_actor: (self.told > 0).then(|| self.known as f64 / self.told as f64),
            mpjpe_root_mm: 1e3 * self.root / frames,
            mpjpe_local_mm: 1e3 * self.local / frames,
            mpjpe_global_mm: 1e3 * self.global / frames,
            drift_end_mm: 1e3 * self.drift_end / clips,
            drift_5s_mm: (self.clips_5s > 0).then(|| 1e3 * self.drift_5s / self.clips_5s as f64),
            heading_end_deg: self.heading / clips,
            bones_p99_mm: bones.map(f64::from),
            jerk: self.jerk.over(self.frames),
            skating: self.skating.over(self.footed),
            codes_used: usage.used,
            codes_used_share: usage.used as f64 / self.counts.len() as f64,
            perplexity: usage.perplexity,
        }
    }
}

fn distance(a: [f32; 3], b: [f32; 3]) -> f64 {
    (0..3).map(|i| f64::from(a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
}

fn planar(a: [f32; 3], b: [f32; 3]) -> f64 {
    f64::from(a[0] - b[0]).hypot(f64::from(a[2] - b[2]))
}

/// The reports as a table for people.
pub fn table(reports: &[Report]) -> String {
    let mut text = String::from(
        "split subset clips frames | MPJPE mm: root-aligned   local  global | drift mm: end    5 s | heading | bones 99 % | jerk / real | skating, real | codes used | perplexity | known actor\n",
    );
    for r in reports {
        let told = |figure: Option<String>| figure.unwrap_or_else(|| "-".to_owned());
        let known_actor = told(r.known_actor.map(|share| format!("{:.0}%", 100.0 * share)));
        let drift_5s = told(r.drift_5s_mm.map(|d| format!("{d:.0}")));
        let bones = told(r.bones_p99_mm.map(|mm| format!("{mm:.1} mm")));
        let jerk = told(r.jerk.map(|jerk| format!("{:.2}", jerk.decoded / jerk.real)));
        let skating = told(r.skating.map(|s| format!("{:.1}, {:.1}%", 100.0 * s.decoded, 100.0 * s.real)));
        text += &format!(
            "{:<5} {:<6} {:>5} {:>6} | {:>22.1} {:>7.1} {:>7.1} | {:>13.0} {:>6} | {:>4.1} deg | {bones:>10} | {jerk:>11} | {skating:>13} | {:>4} {:>4.0}% | {:>10.0} | {known_actor}\n",
            r.split.to_string(),
            r.subset,
            r.clips,
            r.frames,
            r.mpjpe_root_mm,
            r.mpjpe_local_mm,
            r.mpjpe_global_mm,
            r.drift_end_mm,
            drift_5s,
            r.heading_end_deg,
            r.codes_used,
            100.0 * r.codes_used_share,
            r.perplexity,
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing;

    /// A decoder that makes known mistakes: joints shifted by 10 mm, root walking 2 mm a frame too fast, no turn.
    #[test]
    fn known_errors_give_known_figures() {
        let dataset = testing::dataset(1, 60);
        let clip = dataset.clip(0);
        let mut decoded = clip.joints.to_vec();
        for (t, pose) in decoded.iter_mut().enumerate() {
            for joint in pose.iter_mut() {
                joint[0] += 0.002 * t as f32;
            }
            for joint in &mut pose[1..] {
                joint[1] += 0.01;
            }
        }
        let mut sums = Sums { counts: vec![3, 1, 0, 0], ..Sums::default() };
        let wanted = Wanted { joints: clip.joints, features: clip.features, synthetic_legs: false };
        sums.add(&decoded, clip.features, &wanted);
        let report = sums.report(Split::Test, "x".into());
        let last = (clip.frames() - 1) as f64;
        assert!((report.mpjpe_root_mm - 10.0).abs() < 1e-2, "{report:?}");
        assert!((report.mpjpe_local_mm - 10.0).abs() < 1e-2);
        assert!((report.drift_end_mm - 2.0 * last).abs() < 1e-2);
        assert!(report.mpjpe_global_mm > last && report.mpjpe_global_mm < last + 10.0);
        assert_eq!((report.codes_used, report.codes_used_share), (2, 0.5));
        assert_eq!(report.drift_5s_mm, None);
        // Three bones begin at the pelvis, which stayed where it was; the error of a shift by 10 mm is what their slope makes of it.
        let bones = report.bones_p99_mm.unwrap();
        assert!(bones > 5.0 && bones <= 10.0 + 1e-2, "{bones}");
        let jerk = report.jerk.unwrap();
        assert!((jerk.decoded / jerk.real - 1.0).abs() < 1e-2, "a constant shift has no jerk: {jerk:?}");
    }

    /// One bone of 21 that is 7 mm too long in a few frames is beyond the 99th percentile, in all frames within it; a shaking wrist is
    /// jerk, feet that slide are skating, of measured feet alone.
    #[test]
    fn bones_jerk_and_skating_of_known_mistakes() {
        let dataset = testing::dataset(1, 60);
        let clip = dataset.clip(0);
        let report = |spoil: &dyn Fn(usize, &mut Pose), synthetic_legs: bool| {
            let mut decoded = clip.joints.to_vec();
            decoded.iter_mut().enumerate().for_each(|(t, pose)| spoil(t, pose));
            let mut sums = Sums { counts: vec![1], ..Sums::default() };
            sums.add(&decoded, clip.features, &Wanted { joints: clip.joints, features: clip.features, synthetic_legs });
            sums.report(Split::Test, "x".into())
        };
        let longer = |frames: usize| {
            move |t: usize, pose: &mut Pose| {
                let (elbow, wrist) = (pose[18], pose[20]);
                let length = distance(elbow, wrist) as f32;
                let stretch = if t < frames { 1.0 + 0.007 / length } else { 1.0 };
                pose[20] = std::array::from_fn(|i| elbow[i] + stretch * (wrist[i] - elbow[i]));
            }
        };
        assert!((report(&longer(60), false).bones_p99_mm.unwrap() - 7.0).abs() < 1e-2);
        assert!(report(&longer(3), false).bones_p99_mm.unwrap() < 1e-2);
        let shaken = report(&|t, pose| pose[20][0] += 0.04 * (t % 2) as f32, false).jerk.unwrap();
        assert!(shaken.decoded > 1.5 * shaken.real, "{shaken:?}");
        let slid = |t: usize, pose: &mut Pose| pose[10] = [0.03 * t as f32, 0.0, 0.0];
        assert_eq!(report(&slid, false).skating.unwrap().decoded, 1.0);
        assert_eq!(report(&slid, true).skating, None);
    }

    /// Where legs are synthetic their errors are none, and those of other joints weigh in full.
    #[test]
    fn synthetic_legs_are_not_measured() {
        let dataset = testing::dataset(1, 60);
        let clip = dataset.clip(0);
        let report = |lifted: &[usize], synthetic_legs: bool| {
            let mut decoded = clip.joints.to_vec();
            decoded.iter_mut().for_each(|pose| lifted.iter().for_each(|joint| pose[*joint][1] += 0.03));
            let mut sums = Sums { counts: vec![1], ..Sums::default() };
            sums.add(&decoded, clip.features, &Wanted { joints: clip.joints, features: clip.features, synthetic_legs });
            sums.report(Split::Test, "x".into()).mpjpe_root_mm
        };
        let near = |found: f64, wanted: f64| assert!((found - wanted).abs() < 1e-3, "{found} {wanted}");
        near(report(&[4, 5, 7, 8, 10, 11], true), 0.0);
        near(report(&[4, 5, 7, 8, 10, 11], false), 30.0 * 6.0 / 21.0);
        near(report(&[1, 20], true), 30.0 * 2.0 / 15.0);
    }

    /// Turning the whole motion faster changes the root-aligned error and leaves the local one.
    #[test]
    fn local_error_ignores_heading() {
        let dataset = testing::dataset(1, 60);
        let clip = dataset.clip(0);
        let mut turned = clip.features.to_vec();
        for row in turned.chunks_exact_mut(FEATURES) {
            row[0] += 0.01;
        }
        let mut sums = Sums { counts: vec![1], ..Sums::default() };
        let wanted = Wanted { joints: clip.joints, features: clip.features, synthetic_legs: false };
        sums.add(&recover::joints(&turned).unwrap(), &turned, &wanted);
        let report = sums.report(Split::Val, "x".into());
        assert!(report.mpjpe_local_mm < 0.05, "{report:?}");
        assert!(report.mpjpe_root_mm > 10.0);
        let wanted = (0.02 * (clip.frames() - 1) as f64).to_degrees();
        assert!((report.heading_end_deg - wanted).abs() < 0.1);
    }
}
