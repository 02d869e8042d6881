//! What came of tracks and obstacles: as figures with stable names, and in words.

use motionette::refining::{Clearance, Followed, TrackingError};
use motionette::{Obstacle, Track};
use serde::Serialize;

use crate::motion::skeleton;

/// Figures of a motion with tracks or obstacles. Names are stable: reports in JSON have these.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Following {
    /// Tracks.
    pub tracks: usize,
    /// Distance of the generated motion from its tracks; null without tracks.
    pub track_error_before: Option<TrackError>,
    /// Distance of the edited motion.
    pub track_error_after: Option<TrackError>,
    /// Positions that ask for more speed than a body adds, and are followed as far as it allows.
    pub hurried_positions: u16,
    /// Positions behind the end of a motion whose length the prompt decided.
    pub positions_beyond_end: usize,
    /// Obstacles.
    pub obstacles: usize,
    /// How near the generated motion came to an obstacle; null without obstacles.
    pub clearance_before: Option<Nearest>,
    /// How near the edited motion comes.
    pub clearance_after: Option<Nearest>,
}

/// How far a motion is from its tracks.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct TrackError {
    /// Mean distance over all positions that count, on the axes that do, centimetres.
    pub mean_cm: f64,
    /// Largest distance.
    pub worst_cm: f64,
    /// Track with the largest distance, counted from 0.
    pub worst_track: u16,
    /// Its joint.
    pub worst_joint: &'static str,
    /// Its frame.
    pub worst_frame: u16,
    /// The same in seconds.
    pub worst_seconds: f64,
}

/// Where a motion comes nearest to what it keeps clear of, measured by how much of the margin is left.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Nearest {
    /// Whether all of every margin is kept, but for [`Clearance::TOLERANCE`].
    pub kept: bool,
    /// Distance from the surface there, centimetres; negative inside.
    pub distance_cm: f64,
    /// By how much that is less than the margin; negative where all of the margin is kept.
    pub missing_cm: f64,
    /// The obstacle, counted from 0.
    pub obstacle: u16,
    /// The joint, or the one at the end of the bone.
    pub joint: &'static str,
    /// The frame.
    pub frame: u16,
    /// The same in seconds.
    pub seconds: f64,
}

/// Why the planner saw no places of these tracks, where that lies in the tracks themselves: it sees anchors alone, which say x, y and z, or
/// x and z of the pelvis.
#[must_use]
pub fn unseen_because(tracks: &[Track<'_>]) -> Option<&'static str> {
    let seen = |track: &Track<'_>| track.axes == [true; 3] || track.joint == 0 && track.axes == [true, false, true];
    let why = "it sees tracks of x, y and z, and of x and z of the pelvis";
    (!tracks.iter().any(seen)).then_some(why)
}

fn name(joint: u8) -> &'static str {
    skeleton::NAMES.get(usize::from(joint)).copied().unwrap_or("no joint")
}

fn seconds(frame: u16, frame_rate: u16) -> f64 {
    f64::from(frame) / f64::from(frame_rate.max(1))
}

impl Following {
    /// What came of them in a motion of `frames` frames, `frame_rate` a second; `None` where nothing was asked for.
    #[must_use]
    pub fn of(
        followed: Option<&Followed>,
        (tracks, obstacles): (&[Track<'_>], &[Obstacle<'_>]),
        frames: usize,
        frame_rate: u16,
    ) -> Option<Self> {
        let followed = followed?;
        let error = |error: TrackingError| TrackError {
            mean_cm: 100.0 * f64::from(error.mean),
            worst_cm: 100.0 * f64::from(error.worst),
            worst_track: error.worst_track,
            worst_joint: tracks.get(usize::from(error.worst_track)).map_or("no joint", |track| name(track.joint)),
            worst_frame: error.worst_frame,
            worst_seconds: seconds(error.worst_frame, frame_rate),
        };
        let nearest = |clearance: Clearance| Nearest {
            kept: clearance.kept(),
            distance_cm: 100.0 * f64::from(clearance.least),
            missing_cm: 100.0 * f64::from(clearance.missing),
            obstacle: clearance.obstacle,
            joint: name(clearance.joint),
            frame: clearance.frame,
            seconds: seconds(clearance.frame, frame_rate),
        };
        let beyond = |track: &Track<'_>| {
            let end = usize::from(track.first) + track.positions.len();
            (frames..end).filter(|frame| track.at(*frame).is_some()).count()
        };
        Some(Following {
            tracks: tracks.len(),
            track_error_before: followed.before.map(error),
            track_error_after: followed.after.map(error),
            hurried_positions: followed.hurried,
            positions_beyond_end: tracks.iter().map(beyond).sum(),
            obstacles: obstacles.len(),
            clearance_before: followed.clearance_before.map(nearest),
            clearance_after: followed.clearance.map(nearest),
        })
    }

    /// The frame at which the generated motion was farthest from its tracks, or, without them, deepest in an obstacle.
    #[must_use]
    pub fn hardest(&self) -> Option<u16> {
        let track = self.track_error_before.as_ref().map(|error| error.worst_frame);
        track.or(self.clearance_before.as_ref().map(|nearest| nearest.frame))
    }

    /// The figures for a person to read: what of, and what came of it.
    #[must_use]
    pub fn lines(&self) -> Vec<(&'static str, String)> {
        let mut lines = Vec::new();
        if let (Some(before), Some(after)) = (&self.track_error_before, &self.track_error_after) {
            let (mean, left) = (before.mean_cm, after.mean_cm);
            let TrackError { worst_cm, worst_track, worst_joint, worst_frame, worst_seconds, .. } = after;
            let joint = worst_joint.replace('_', " ");
            lines.push((
                "tracks",
                format!(
                    "{}: {mean:.2} cm off before, {left:.2} cm after; at most {worst_cm:.2} cm, track {worst_track} \
                     ({joint}) at frame {worst_frame}, {worst_seconds:.2} s",
                    self.tracks
                ),
            ));
        }
        if let (Some(before), Some(after)) = (&self.clearance_before, &self.clearance_after) {
            lines.push(("obstacles", format!("{}: before, {before}; after, {after}", self.obstacles)));
        }
        lines
    }

    /// What the user should know about them.
    #[must_use]
    pub fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        if self.hurried_positions > 0 {
            notes.push(format!(
                "note: {} positions of tracks ask for more speed than a body adds, and are followed as far as it allows",
                self.hurried_positions
            ));
        }
        if self.positions_beyond_end > 0 {
            notes.push(format!(
                "warning: {} positions of tracks lie behind the end of the motion, whose length the prompt decided; give --seconds",
                self.positions_beyond_end
            ));
        }
        if let Some(nearest) = self.clearance_after.as_ref().filter(|nearest| !nearest.kept) {
            let hit = if nearest.distance_cm < 0.0 { "the body is in an obstacle" } else { "the body comes too near" };
            notes.push(format!("warning: the scene could not be cleared, {hit}: {nearest}"));
        }
        notes
    }
}

/// As in `2.31 cm inside obstacle 1, left foot at frame 40, 2.00 s`.
impl std::fmt::Display for Nearest {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { distance_cm, missing_cm, obstacle, frame, seconds, .. } = self;
        let joint = self.joint.replace('_', " ");
        match (self.kept, *distance_cm < 0.0) {
            (true, _) => write!(f, "all clear, at least {distance_cm:.2} cm")?,
            (false, false) => write!(f, "{distance_cm:.2} cm, {missing_cm:.2} cm less than its margin,")?,
            (false, true) => write!(f, "{:.2} cm inside", -distance_cm)?,
        }
        let of = if self.kept || *distance_cm >= 0.0 { " from" } else { "" };
        write!(f, "{of} obstacle {obstacle}, {joint} at frame {frame}, {seconds:.2} s")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use motionette::{Joint, Shape};

    fn followed(missing: f32, hurried: u16) -> Followed {
        let error = |mean: f32| Some(TrackingError { mean, worst: 2.0 * mean, worst_track: 0, worst_frame: 30 });
        let clearance = |missing: f32| Clearance { least: 0.05 - missing, missing, obstacle: 0, joint: 10, frame: 40 };
        Followed {
            before: error(0.25),
            after: error(0.005),
            hurried,
            clearance_before: Some(clearance(0.125)),
            clearance: Some(clearance(missing)),
        }
    }

    fn following(missing: f32, hurried: u16, frames: usize) -> Following {
        let positions = [[0.0; 3]; 50];
        let tracks = [Track::new(Joint::RightWrist, 10, &positions)];
        let obstacles = [Obstacle::new(Shape::Sphere { radius: 0.1 }, [0.0; 3])];
        Following::of(Some(&followed(missing, hurried)), (&tracks, &obstacles), frames, 20).expect("there are some")
    }

    #[test]
    fn what_is_kept_is_said_in_words() {
        let kept = following(0.0, 0, 60);
        assert_eq!(kept.lines(), [
            ("tracks", "1: 25.00 cm off before, 0.50 cm after; at most 1.00 cm, track 0 (right wrist) at frame 30, 1.50 s".to_owned()),
            ("obstacles", "1: before, 7.50 cm inside obstacle 0, left foot at frame 40, 2.00 s; after, all clear, at least 5.00 cm from obstacle 0, left foot at frame 40, 2.00 s".to_owned()),
        ]);
        assert_eq!(kept.notes(), [""; 0]);
        assert_eq!(Following::of(None, (&[], &[]), 60, 20), None);
    }

    #[test]
    fn what_could_not_be_done_is_a_warning() {
        let near = following(0.02, 7, 58);
        assert_eq!(near.positions_beyond_end, 2);
        assert_eq!(
            near.notes(),
            [
                "note: 7 positions of tracks ask for more speed than a body adds, and are followed as far as it allows",
                "warning: 2 positions of tracks lie behind the end of the motion, whose length the prompt decided; give --seconds",
                "warning: the scene could not be cleared, the body comes too near: 3.00 cm, 2.00 cm less than its margin, from obstacle 0, left foot at frame 40, 2.00 s",
            ]
        );
        let inside = &following(0.15, 0, 60).notes()[0];
        assert!(
            inside.ends_with("the body is in an obstacle: 10.00 cm inside obstacle 0, left foot at frame 40, 2.00 s"),
            "{inside}"
        );
    }
}
