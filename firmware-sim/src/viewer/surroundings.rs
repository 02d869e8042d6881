//! Tracks and obstacles as the page shows them, and how well the motions keep to them, frame by frame.

use crate::session::Conditions;
use motionette::representation::skeleton::{NAMES, PARENTS};
use motionette::{Course, JOINTS, Obstacle, Shape, Track};
use motionette_host::motion::Pose;
use serde::Serialize;

/// Points along a bone are so far apart, metres.
const SPACING: f32 = 0.05;

/// A track.
#[derive(Debug, Serialize)]
pub struct ShownTrack {
    /// Name of its joint.
    pub name: String,
    /// Joint index.
    pub joint: u8,
    /// Frame of the first position.
    pub first: u16,
    /// Which of x, y, z count.
    pub axes: [bool; 3],
    /// Where the joint is to be, one a frame, metres; null where it is free.
    pub positions: Vec<Option<[f32; 3]>>,
    /// Distance of the generated motion on the axes that count, centimetres, one a position; null where it is free.
    pub before_cm: Vec<Option<f32>>,
    /// Of the edited motion.
    pub after_cm: Vec<Option<f32>>,
}

/// An obstacle.
#[derive(Debug, Serialize)]
pub struct ShownObstacle {
    /// Name of its form.
    pub name: &'static str,
    /// Radius of a sphere, capsule or cylinder, metres; 0 for others.
    pub radius: f32,
    /// From its middle to an end of a capsule, to the top of a cylinder, to a corner of a box; a plane's normal. Metres; 0 for a sphere.
    pub half: [f32; 3],
    /// How far the body keeps away from it, metres.
    pub margin: f32,
    /// Where its middle is, metres; one a frame if it moves, else one.
    pub middles: Vec<[f32; 3]>,
}

/// How clear of all obstacles a motion is, one a frame.
#[derive(Debug, Serialize)]
pub struct Clearances {
    /// Distance from the nearest surface beyond its margin of the generated motion, centimetres; negative where it is too near.
    pub before_cm: Vec<f32>,
    /// Of the edited motion.
    pub after_cm: Vec<f32>,
}

/// What the motions were to meet.
#[derive(Debug, Clone, Copy)]
pub struct Surroundings<'s> {
    /// Tracks and obstacles.
    pub conditions: &'s Conditions<'s>,
    /// Frames a second.
    pub frame_rate: u16,
}

impl Surroundings<'_> {
    /// The tracks, as the generated motion and the edited one keep to them.
    #[must_use]
    pub fn tracks(self, [before, after]: [&[Pose]; 2]) -> Vec<ShownTrack> {
        let shown = |track: &Track<'_>| {
            let frames = usize::from(track.first)..usize::from(track.first) + track.positions.len();
            let errors = |motion: &[Pose]| {
                frames
                    .clone()
                    .map(|frame| error(track, frame, motion.get(frame)?))
                    .map(|e| e.map(|m| 100.0 * m))
                    .collect()
            };
            let joint = usize::from(track.joint).min(JOINTS - 1);
            ShownTrack {
                name: NAMES[joint].replace('_', " "),
                joint: track.joint,
                first: track.first,
                axes: track.axes,
                positions: frames.clone().map(|frame| track.at(frame)).collect(),
                before_cm: errors(before),
                after_cm: errors(after),
            }
        };
        self.conditions.tracks.iter().map(shown).collect()
    }

    /// The obstacles over a motion of so many frames.
    #[must_use]
    pub fn obstacles(self, frames: usize) -> Vec<ShownObstacle> {
        let shown = |obstacle: &Obstacle<'_>| {
            let (name, radius, half) = match obstacle.shape {
                Shape::Sphere { radius } => ("sphere", radius, [0.0; 3]),
                Shape::Capsule { half, radius } => ("capsule", radius, half),
                Shape::Cylinder { radius, half_height } => ("cylinder", radius, [0.0, half_height, 0.0]),
                Shape::Box { half } => ("box", 0.0, half),
                Shape::Plane { normal } => ("plane", 0.0, normal),
            };
            let count = if matches!(obstacle.course, Course::Still(_)) { 1 } else { frames };
            let middles = (0..count).map(|frame| obstacle.position(frame as u16, self.frame_rate)).collect();
            ShownObstacle { name, radius, half, margin: obstacle.margin, middles }
        };
        self.conditions.obstacles.iter().map(shown).collect()
    }

    /// How clear of them the generated motion and the edited one are.
    #[must_use]
    pub fn clearance(self, motions: [&[Pose]; 2]) -> Option<Clearances> {
        if self.conditions.obstacles.is_empty() {
            return None;
        }
        let curve = |motion: &[Pose]| {
            let frames = motion.iter().enumerate();
            frames.map(|(frame, pose)| 100.0 * self.nearest(frame as u16, pose)).collect()
        };
        let [before_cm, after_cm] = motions.map(curve);
        Some(Clearances { before_cm, after_cm })
    }

    /// Distance of a pose from the nearest surface beyond its margin, metres.
    fn nearest(self, frame: u16, pose: &Pose) -> f32 {
        let distance = |obstacle: &Obstacle<'_>| {
            let keeps = |joint: usize| obstacle.joints >> joint & 1 == 1;
            let bones = (0..JOINTS).filter(|joint| keeps(*joint)).flat_map(|joint| {
                let parent = usize::from(PARENTS[joint]);
                // A joint whose parent does not keep clear does so alone.
                along(pose[if keeps(parent) { parent } else { joint }], pose[joint])
            });
            let least =
                bones.map(|point| obstacle.distance(point, frame, self.frame_rate)).fold(f32::INFINITY, f32::min);
            least - obstacle.margin
        };
        self.conditions.obstacles.iter().map(distance).fold(f32::INFINITY, f32::min)
    }
}

/// Points along a bone, its ends included.
fn along(start: [f32; 3], end: [f32; 3]) -> impl Iterator<Item = [f32; 3]> {
    let square: f32 = (0..3).map(|k| (end[k] - start[k]).powi(2)).sum();
    let parts = (square.sqrt() / SPACING).ceil().clamp(1.0, 1e3) as u16;
    (0..=parts).map(move |part| {
        let share = f32::from(part) / f32::from(parts);
        std::array::from_fn(|k| start[k] + share * (end[k] - start[k]))
    })
}

/// Distance of a pose from a track on the axes that count, metres; `None` where it is free.
fn error(track: &Track<'_>, frame: usize, pose: &Pose) -> Option<f32> {
    let (place, at) = (track.at(frame)?, pose.get(usize::from(track.joint))?);
    let off = (0..3).filter(|axis| track.axes[*axis]).map(|axis| (place[axis] - at[axis]).powi(2));
    Some(off.sum::<f32>().sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;
    use motionette::Joint;

    #[test]
    fn clearance_and_errors_of_a_body_that_stands_in_a_point() {
        let positions = [[0.0, 3.0, 4.0]; 2];
        let tracks = [
            Track::new(Joint::Head, 1, &positions).masked(&[1, 0]),
            Track::new(Joint::Head, 0, &positions).axes([true, false, true]),
        ];
        let obstacles = [Obstacle::new(Shape::Sphere { radius: 0.5 }, [0.0, 0.0, 2.0])];
        let conditions = Conditions { anchors: &[], tracks: &tracks, obstacles: &obstacles, timeline: &[] };
        let around = Surroundings { conditions: &conditions, frame_rate: 20 };
        let motion = vec![[[0.0; 3]; JOINTS]; 2];
        let clear = around.clearance([&motion, &motion]).expect("an obstacle");
        assert!(clear.after_cm.iter().all(|cm| (cm - 145.0).abs() < 1e-3) && clear.after_cm.len() == 2, "{clear:?}");
        let shown = around.tracks([&motion, &motion]);
        assert_eq!(shown[0].after_cm, [Some(500.0), None]);
        assert_eq!((&shown[0].positions[..], shown[0].name.as_str()), (&[Some([0.0, 3.0, 4.0]), None][..], "head"));
        assert_eq!(shown[1].before_cm, [Some(400.0); 2]);
        assert_eq!(around.obstacles(2)[0].middles, [[0.0, 0.0, 2.0]]);
    }
}
