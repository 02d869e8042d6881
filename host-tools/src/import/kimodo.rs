//! Constraint files of Kimodo (NVIDIA, arXiv 2603.15546) as anchors.
//!
//! A constraint file is a JSON list of sets, each with a `type`, `frame_indices [T]` at 30 frames a second, and numbers for
//! those frames. Metres, y up, the motion starts at x = z = 0 facing +z, the body's left is +x: as here.
//!
//! | type | field | anchors |
//! |---|---|---|
//! | `root2d` | `smooth_root_2d [T][2]` | Planar-root |
//! | `fullbody` | `root_positions [T][3]` | Root-3D |
//! | `left-hand`, `right-hand`, `left-foot`, `right-foot`, `end-effector` with `joint_names` | `root_positions [T][3]` | Root-3D, since Kimodo holds the hips as well |
//! | the same | `global_joints_positions [T][J][3]`, if there | Body-point: wrist or ankle |
//!
//! A pose is written as `local_joints_rot`, rotations of a skeleton that is not in the file: from these no position follows,
//! so they are left out, and headings (`global_root_heading`) are, because no family takes them. [`Imported::left_out`] names
//! both. `global_joints_positions` is what Kimodo calls those positions in memory and what its bridges to other programs
//! write (types `fullbody-global` and `ee-global`); the number of joints says which of its skeletons it is.

use std::path::{Path, PathBuf};

use motionette::{Anchor, Joint, Target};
use serde_json::{Map, Value};

use crate::anchors_file;
use crate::input;
use crate::motion::FPS;

/// Frames a second of Kimodo's models.
pub const KIMODO_FPS: f64 = 30.0;

/// Joints of Kimodo's skeletons, and which of them are pelvis, left and right wrist, left and right ankle: SMPL-X, SOMA
/// with 30 and with 77 joints.
const SKELETONS: [(usize, [usize; 5]); 3] =
    [(22, [0, 20, 21, 7, 8]), (30, [0, 13, 19, 24, 28]), (77, [0, 14, 42, 69, 74])];
/// The five by their names here and in `joint_names`.
const PARTS: [(Joint, &str); 5] = [
    (Joint::Pelvis, "Hips"),
    (Joint::LeftWrist, "LeftHand"),
    (Joint::RightWrist, "RightHand"),
    (Joint::LeftAnkle, "LeftFoot"),
    (Joint::RightAnkle, "RightFoot"),
];

/// What is wrong, and where. `set` counts the file's constraint sets from 0.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The file cannot be read.
    #[error("cannot read the constraint file {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Not JSON, or not a list.
    #[error("{message}; a constraint file is a list [{{\"type\": \"root2d\", \"frame_indices\": [...], ...}}, ...]")]
    Json {
        /// What the reader said, with line and column.
        message: String,
    },
    /// A kind of set that nobody knows.
    #[error(
        "set {set}: unknown type {found:?}; types are root2d, fullbody, left-hand, right-hand, left-foot, right-foot, end-effector"
    )]
    UnknownType {
        /// The set.
        set: usize,
        /// Its type.
        found: String,
    },
    /// A field lacks, or holds something else than it should.
    #[error("set {set}: {field} must be {expected}")]
    Field {
        /// The set.
        set: usize,
        /// The field.
        field: &'static str,
        /// What it should be.
        expected: &'static str,
    },
    /// As many entries as frames are needed.
    #[error("set {set}: {field} has {found} entries, frame_indices has {frames}")]
    Length {
        /// The set.
        set: usize,
        /// The field.
        field: &'static str,
        /// Its entries.
        found: usize,
        /// Frames of the set.
        frames: usize,
    },
    /// A frame that no motion has.
    #[error("set {set}: frame {frame} lies outside any motion")]
    Frame {
        /// The set.
        set: usize,
        /// The frame.
        frame: i64,
    },
    /// A skeleton that is none of Kimodo's human ones.
    #[error("set {set}: global_joints_positions has {found} joints; known are 22 (SMPL-X), 30 and 77 (SOMA)")]
    Skeleton {
        /// The set.
        set: usize,
        /// Its joints.
        found: usize,
    },
    /// Nothing in the file says where the body is.
    #[error("no constraint of the file says where a part of the body is")]
    Nothing,
    /// The anchors are no request: too many of them, or out of reach.
    #[error("these anchors make no request; if there are too many, take fewer with --every SECONDS")]
    Anchors(#[source] anchors_file::Error),
}

/// Something that has no anchor.
#[derive(Debug, Clone, PartialEq, Eq, serde::Serialize)]
pub struct LeftOut {
    /// The set, counted from 0.
    pub set: usize,
    /// Its type.
    pub kind: String,
    /// What of it.
    pub what: String,
}

/// What came of a file.
#[derive(Debug, Clone, PartialEq)]
pub struct Imported {
    /// Anchors by rising frame.
    pub anchors: Vec<Anchor>,
    /// What has no anchor.
    pub left_out: Vec<LeftOut>,
    /// Entries that fell on the frame of another and gave way: see [`parse`].
    pub merged: usize,
}

/// Reads a constraint file.
///
/// # Errors
/// [`Error::Read`], else as [`parse`].
pub fn read(path: &Path, fps: f64, every: f64) -> Result<Imported, Error> {
    let text =
        input::read_text(path, input::WRITTEN).map_err(|source| Error::Read { path: path.to_path_buf(), source })?;
    parse(&text, fps, every)
}

/// Parses the text of a constraint file whose frames are `fps` a second. Of the pelvis' anchors, those closer than `every`
/// seconds behind the one before are left away, but for the last: a drawn path has one every frame, a request takes 32.
///
/// Where two entries fall on one frame and joint (30 frames a second go to 20), one that fixes the height stays before one
/// that does not (Kimodo's `root2d` follows a smoothed path, the pelvis sways about it), then the one nearer in time.
///
/// # Errors
/// [`Error`], with the set and the field.
pub fn parse(text: &str, fps: f64, every: f64) -> Result<Imported, Error> {
    let sets: Vec<Map<String, Value>> =
        serde_json::from_str(text).map_err(|error| Error::Json { message: error.to_string() })?;
    let (mut entries, mut left_out) = (Vec::new(), Vec::new());
    for (set, fields) in sets.iter().enumerate() {
        Set { set, fields, fps }.read(&mut entries, &mut left_out)?;
    }
    let found = entries.len();
    let mut entries = one_each(entries);
    let merged = found - entries.len();
    thin(&mut entries, every);
    if entries.is_empty() {
        return Err(Error::Nothing);
    }
    let anchors: Vec<Anchor> = entries.into_iter().map(|entry| entry.anchor).collect();
    anchors_file::check(&anchors, usize::from(u16::MAX) + 1).map_err(Error::Anchors)?;
    Ok(Imported { anchors, left_out, merged })
}

/// An anchor, and how far its frame is from the time it was given for, millionths of a frame.
#[derive(Debug, Clone, Copy)]
struct Entry {
    anchor: Anchor,
    off: u32,
}

impl Entry {
    fn joint(&self) -> u8 {
        match self.anchor.target {
            Target::Joint { joint, .. } => joint,
            Target::Root(_) | Target::PlanarRoot(_) => Joint::Pelvis as u8,
        }
    }

    fn place(&self) -> (u16, u8) {
        (self.anchor.frame, self.joint())
    }

    fn is_planar(&self) -> bool {
        matches!(self.anchor.target, Target::PlanarRoot(_))
    }
}

/// The best entry of each frame and joint, in order.
fn one_each(mut entries: Vec<Entry>) -> Vec<Entry> {
    entries.sort_by(|a, b| a.place().cmp(&b.place()).then(a.is_planar().cmp(&b.is_planar())).then(a.off.cmp(&b.off)));
    entries.dedup_by_key(|entry| entry.place());
    entries
}

/// Leaves away pelvis entries less than `every` seconds behind the one before, but for the last.
fn thin(entries: &mut Vec<Entry>, every: f64) {
    let last = entries.iter().rev().find(|entry| entry.joint() == 0).map(|entry| entry.anchor.frame);
    let mut before: Option<u16> = None;
    entries.retain(|entry| {
        let frame = entry.anchor.frame;
        let close = before.is_some_and(|before| f64::from(frame - before) < every * FPS);
        let keep = entry.joint() != 0 || !close || Some(frame) == last;
        if keep && entry.joint() == 0 {
            before = Some(frame);
        }
        keep
    });
}

/// One constraint set.
struct Set<'f> {
    set: usize,
    fields: &'f Map<String, Value>,
    fps: f64,
}

impl Set<'_> {
    fn read(&self, entries: &mut Vec<Entry>, left_out: &mut Vec<LeftOut>) -> Result<(), Error> {
        let set = self.set;
        let kind = self.fields.get("type").and_then(Value::as_str);
        let kind = kind.ok_or(Error::Field { set, field: "type", expected: "the name of a constraint type" })?;
        let mut leave = |what: String| left_out.push(LeftOut { set, kind: kind.to_owned(), what });
        let frames = self.frames()?;
        let parts: Vec<Joint> = match kind {
            "root2d" => {
                let path: Vec<[f32; 2]> = self.rows("smooth_root_2d", "a list of [x, z] in metres", frames.len())?;
                entries.extend(frames.iter().zip(path).map(|(frame, p)| frame.entry(Target::PlanarRoot(p))));
                if self.fields.contains_key("global_root_heading") {
                    leave("global_root_heading: no family of anchors takes headings".into());
                }
                return Ok(());
            }
            "fullbody" | "fullbody-global" => PARTS.iter().skip(1).map(|(joint, _)| *joint).collect(),
            "left-hand" => vec![Joint::LeftWrist],
            "right-hand" => vec![Joint::RightWrist],
            "left-foot" => vec![Joint::LeftAnkle],
            "right-foot" => vec![Joint::RightAnkle],
            "end-effector" | "ee-global" => self.named(&mut leave)?,
            _ => return Err(Error::UnknownType { set, found: kind.chars().take(60).collect() }),
        };
        let positions = self.positions(frames.len())?;
        if let Some(positions) = &positions {
            for (frame, row) in frames.iter().zip(positions) {
                for ((joint, _), position) in PARTS.iter().zip(*row) {
                    if *joint == Joint::Pelvis {
                        entries.push(frame.entry(Target::Root(position)));
                    } else if parts.contains(joint) {
                        entries.push(frame.entry(Target::Joint { joint: u8::from(*joint), position }));
                    }
                }
            }
            if kind.starts_with("fullbody") {
                leave("global_joints_positions: taken are pelvis, wrists and ankles".into());
            }
        } else {
            let roots: Vec<[f32; 3]> = self.rows("root_positions", "a list of [x, y, z] in metres", frames.len())?;
            entries.extend(frames.iter().zip(roots).map(|(frame, p)| frame.entry(Target::Root(p))));
            leave(format!(
                "local_joints_rot: where {} follows from Kimodo's skeleton, which the file does not hold; the pelvis is taken",
                if kind == "fullbody" { "the joints are" } else { "hands and feet are" }
            ));
        }
        Ok(())
    }

    /// The frames of the set.
    fn frames(&self) -> Result<Vec<Frame>, Error> {
        let set = self.set;
        let wrong = || Error::Field { set, field: "frame_indices", expected: "a list of whole numbers" };
        let list = self.fields.get("frame_indices").and_then(Value::as_array).ok_or_else(wrong)?;
        let frame = |value: &Value| {
            let frame = value.as_i64().ok_or_else(wrong)?;
            let exact = frame as f64 * FPS / self.fps;
            let nearest = exact.round();
            if !(0.0..=f64::from(u16::MAX)).contains(&nearest) || frame < 0 {
                return Err(Error::Frame { set, frame });
            }
            Ok(Frame { number: nearest as u16, off: (1e6 * (exact - nearest).abs()).round() as u32 })
        };
        list.iter().map(frame).collect()
    }

    /// Parts that `joint_names` lists; the others are left out.
    fn named(&self, leave: &mut impl FnMut(String)) -> Result<Vec<Joint>, Error> {
        let wrong = || Error::Field {
            set: self.set,
            field: "joint_names",
            expected: "a list of names such as \"LeftHand\" and \"RightFoot\"",
        };
        let names = self.fields.get("joint_names").and_then(Value::as_array).ok_or_else(wrong)?;
        let mut parts = Vec::new();
        for name in names {
            let name = name.as_str().ok_or_else(wrong)?;
            match PARTS.iter().find(|(_, known)| *known == name) {
                Some((joint, _)) => parts.push(*joint),
                None => leave(format!(
                    "joint {:?}: no joint here is known to be the same",
                    name.chars().take(60).collect::<String>()
                )),
            }
        }
        Ok(parts)
    }

    /// Pelvis, wrists and ankles of each frame, if the set holds positions.
    fn positions(&self, frames: usize) -> Result<Option<Vec<[[f32; 3]; 5]>>, Error> {
        const FIELD: &str = "global_joints_positions";
        let expected = "a list of frames of joints [x, y, z] in metres";
        let set = self.set;
        let Some(value) = self.fields.get(FIELD) else { return Ok(None) };
        let wrong = || Error::Field { set, field: FIELD, expected };
        let list = value.as_array().ok_or_else(wrong)?;
        if list.len() != frames {
            return Err(Error::Length { set, field: FIELD, found: list.len(), frames });
        }
        let pose = |value: &Value| {
            let joints = value.as_array().ok_or_else(wrong)?;
            let (_, columns) = SKELETONS
                .iter()
                .find(|(count, _)| *count == joints.len())
                .ok_or(Error::Skeleton { set, found: joints.len() })?;
            let mut pose = [[0.0; 3]; 5];
            for (to, column) in pose.iter_mut().zip(columns) {
                *to = numbers(&joints[*column]).ok_or_else(wrong)?;
            }
            Ok(pose)
        };
        list.iter().map(pose).collect::<Result<_, _>>().map(Some)
    }

    /// The rows of a field, one a frame.
    fn rows<const N: usize>(
        &self,
        field: &'static str,
        expected: &'static str,
        frames: usize,
    ) -> Result<Vec<[f32; N]>, Error> {
        let set = self.set;
        let wrong = || Error::Field { set, field, expected };
        let list = self.fields.get(field).and_then(Value::as_array).ok_or_else(wrong)?;
        if list.len() != frames {
            return Err(Error::Length { set, field, found: list.len(), frames });
        }
        list.iter().map(|row| numbers(row).ok_or_else(wrong)).collect()
    }
}

/// A frame of ours, and how far from it the given time is, millionths of a frame.
struct Frame {
    number: u16,
    off: u32,
}

impl Frame {
    fn entry(&self, target: Target) -> Entry {
        Entry { anchor: Anchor { frame: self.number, target }, off: self.off }
    }
}

/// `N` finite numbers.
fn numbers<const N: usize>(value: &Value) -> Option<[f32; N]> {
    let list = value.as_array().filter(|list| list.len() == N)?;
    let mut numbers = [0.0; N];
    for (to, value) in numbers.iter_mut().zip(list) {
        *to = value.as_f64().map(|v| v as f32).filter(|v| v.is_finite())?;
    }
    Some(numbers)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn imported(text: &str) -> Imported {
        parse(text, KIMODO_FPS, 0.0).expect(text)
    }

    fn refused(sets: &str) -> String {
        parse(
            &format!("[{{\"type\": \"root2d\", \"frame_indices\": [0], \"smooth_root_2d\": [[0, 0]]}}, {sets}]"),
            30.0,
            0.0,
        )
        .expect_err(sets)
        .to_string()
    }

    #[test]
    fn waypoints_become_planar_roots() {
        let text = r#"[{"type": "root2d", "frame_indices": [0, 30, 91], "smooth_root_2d": [[0, 0], [0.5, 0.25], [1, -1]],
            "global_root_heading": [[1, 0], [0, 1], [1, 0]]}]"#;
        let found = imported(text);
        let expected = [
            Anchor::planar_root(0, [0.0; 2]),
            Anchor::planar_root(20, [0.5, 0.25]),
            Anchor::planar_root(61, [1.0, -1.0]),
        ];
        assert_eq!((found.anchors.as_slice(), found.merged), (&expected[..], 0));
        assert_eq!(found.left_out.len(), 1);
        assert!(found.left_out[0].what.starts_with("global_root_heading"), "{:?}", found.left_out);
        let at_20 = parse(text, 20.0, 0.0).expect("another rate");
        assert_eq!(at_20.anchors[1].frame, 30);
    }

    #[test]
    fn poses_give_the_pelvis_and_the_rest_is_named() {
        let text = r#"[
            {"type": "fullbody", "frame_indices": [60], "local_joints_rot": [[[0, 0, 0]]], "root_positions": [[1, 0.9, 2]],
             "smooth_root_2d": [[1, 2]]},
            {"type": "left-hand", "frame_indices": [30], "local_joints_rot": [[[0, 0, 0]]], "root_positions": [[0, 0.8, 1]]}]"#;
        let found = imported(text);
        assert_eq!(found.anchors, [Anchor::root(20, [0.0, 0.8, 1.0]), Anchor::root(40, [1.0, 0.9, 2.0])]);
        let kinds: Vec<&str> = found.left_out.iter().map(|left| left.kind.as_str()).collect();
        assert_eq!(kinds, ["fullbody", "left-hand"]);
        assert!(found.left_out.iter().all(|left| left.what.starts_with("local_joints_rot")), "{:?}", found.left_out);
    }

    #[test]
    fn positions_become_joints_in_every_skeleton() {
        for (count, [pelvis, left_hand, _, _, right_foot]) in SKELETONS {
            let mut pose = vec![[0.0f32, 0.5, 0.0]; count];
            pose[pelvis] = [0.0, 0.9, 1.0];
            pose[left_hand] = [0.25, 1.5, 1.0];
            pose[right_foot] = [-0.125, 0.125, 1.0];
            let pose = serde_json::to_string(&pose).expect("numbers");
            let text = format!(
                r#"[{{"type": "end-effector", "joint_names": ["LeftHand", "RightFoot", "LeftToeBase"], "frame_indices": [15],
                     "global_joints_positions": [{pose}]}},
                   {{"type": "left-hand", "frame_indices": [30], "global_joints_positions": [{pose}]}}]"#
            );
            let found = imported(&text);
            let expected = [
                Anchor::root(10, [0.0, 0.9, 1.0]),
                Anchor::joint(10, 8, [-0.125, 0.125, 1.0]),
                Anchor::joint(10, 20, [0.25, 1.5, 1.0]),
                Anchor::root(20, [0.0, 0.9, 1.0]),
                Anchor::joint(20, 20, [0.25, 1.5, 1.0]),
            ];
            assert_eq!(found.anchors, expected, "{count} joints");
            assert_eq!(found.left_out.len(), 1);
            assert!(found.left_out[0].what.contains("LeftToeBase"), "{:?}", found.left_out);
        }
    }

    #[test]
    fn one_anchor_a_frame_and_joint() {
        // Frames 1 and 2 at 30 a second are 0.67 and 1.33 at 20, both nearest to 1; 3 is exactly 2.
        let text = r#"[{"type": "root2d", "frame_indices": [1, 2, 3], "smooth_root_2d": [[0, 1], [0, 2], [0, 3]]},
            {"type": "fullbody", "frame_indices": [3], "root_positions": [[0.01, 0.9, 3]]}]"#;
        let found = imported(text);
        assert_eq!(found.anchors, [Anchor::planar_root(1, [0.0, 1.0]), Anchor::root(2, [0.01, 0.9, 3.0])]);
        assert_eq!(found.merged, 2);
    }

    #[test]
    fn a_dense_path_is_thinned() {
        let frames: Vec<u16> = (0..100).collect();
        let path: Vec<[f32; 2]> = frames.iter().map(|frame| [0.0, f32::from(*frame)]).collect();
        let text = serde_json::json!([{"type": "root2d", "frame_indices": frames, "smooth_root_2d": path}]).to_string();
        let message = parse(&text, 30.0, 0.0).expect_err("too many").to_string();
        assert!(message.contains("--every"), "{message}");
        let found = parse(&text, 30.0, 0.5).expect("one each half second");
        let frames: Vec<u16> = found.anchors.iter().map(|anchor| anchor.frame).collect();
        assert_eq!(frames, [0, 10, 20, 30, 40, 50, 60, 66]);
    }

    #[test]
    fn mistakes_are_refused_with_set_and_field() {
        for (set, parts) in [
            (r#"{"frame_indices": [0]}"#, &["type must be"][..]),
            (r#"{"type": "root3d", "frame_indices": [0]}"#, &["unknown type \"root3d\"", "fullbody"]),
            (r#"{"type": "root2d", "smooth_root_2d": []}"#, &["frame_indices must be"]),
            (r#"{"type": "root2d", "frame_indices": [0.5], "smooth_root_2d": [[0, 0]]}"#, &["frame_indices must be"]),
            (r#"{"type": "root2d", "frame_indices": [-1], "smooth_root_2d": [[0, 0]]}"#, &["frame -1"]),
            (r#"{"type": "root2d", "frame_indices": [99999999], "smooth_root_2d": [[0, 0]]}"#, &["frame 99999999"]),
            (r#"{"type": "root2d", "frame_indices": [0, 1], "smooth_root_2d": [[0, 0]]}"#, &["has 1 entries", "has 2"]),
            (r#"{"type": "root2d", "frame_indices": [0], "smooth_root_2d": [[0, 0, 0]]}"#, &["[x, z]"]),
            (r#"{"type": "root2d", "frame_indices": [0], "smooth_root_2d": [[0, 1e39]]}"#, &["[x, z]"]),
            (r#"{"type": "fullbody", "frame_indices": [0]}"#, &["root_positions must be"]),
            (r#"{"type": "end-effector", "frame_indices": [0]}"#, &["joint_names must be"]),
            (r#"{"type": "left-hand", "frame_indices": [0], "global_joints_positions": [[[0, 0, 0]]]}"#, &["1 joints"]),
        ] {
            let message = refused(set);
            assert!(message.starts_with("set 1: "), "{message}");
            for part in parts {
                assert!(message.contains(part), "{set}: {message:?} lacks {part:?}");
            }
        }
        for text in ["", "{}", "[1]", "[{]"] {
            assert!(matches!(parse(text, 30.0, 0.0), Err(Error::Json { .. })), "{text}");
        }
        assert!(matches!(parse("[]", 30.0, 0.0), Err(Error::Nothing)));
        let far = r#"[{"type": "root2d", "frame_indices": [0], "smooth_root_2d": [[0, 1e9]]}]"#;
        assert!(matches!(parse(far, 30.0, 0.0), Err(Error::Anchors(_))));
    }
}
