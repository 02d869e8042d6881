//! Mutated files for the host tools: BVH recordings, anchor files, constraint files, checkpoints. Each is read or refused, never more.

use std::fmt::Display;

use motionette::numerics::hash::Stream;
use motionette_host::import::{bvh, kimodo};
use motionette_host::{anchors_file, checkpoint};

use super::Tally;

/// Frames a second of the motion that anchors are read for.
const FRAME_RATE: u16 = 20;

/// A recording of two frames with what the format allows: three channel orders, an End Site, a position channel on a joint.
const BVH: &str = "HIERARCHY
ROOT Hips
{
  OFFSET 0.0 90.5 0.0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Yrotation Xrotation
  JOINT Spine
  {
    OFFSET 0.0 12.0 -1.5
    CHANNELS 3 Xrotation Yrotation Zrotation
    JOINT Hand
    {
      OFFSET 30.0 0.0 0.0
      CHANNELS 4 Yposition Yrotation Zrotation Xrotation
      End Site
      {
        OFFSET 5.0 0.0 0.0
      }
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.0333333
0 91 0 1 2 3 4 5 6 7 8 9 10
1 92 1 1.5 -2 3e1 4 5 6 7 8 9 10
";

/// An anchor of each kind.
const ANCHORS: &str = r#"{"anchors": [
  {"time": 2.0, "root": [1.2, 0.9, 2.0]},
  {"frame": 70, "joint": "right_wrist", "position": [0.4, 1.3, 2.5]},
  {"time": 4.0, "planar_root": [2.0, 3.5]}
]}"#;

/// Constraint sets of each kind, positions of 22 joints among them.
const CONSTRAINTS: &str = r#"[
  {"type": "root2d", "frame_indices": [0, 30, 60], "smooth_root_2d": [[0, 0], [0.5, 0], [1, 0.1]], "global_root_heading": [[1, 0], [1, 0], [0, 1]]},
  {"type": "fullbody", "frame_indices": [90], "local_joints_rot": [[[0, 0, 0], [0, 0.1, 0]]], "root_positions": [[0, 0.9, 1.5]]},
  {"type": "right-hand", "frame_indices": [45], "local_joints_rot": [[[0, 0, 0]]], "root_positions": [[0, 0.9, 1]]},
  {"type": "end-effector", "joint_names": ["LeftHand", "RightFoot", "Hips"], "frame_indices": [15], "global_joints_positions": [[
    [0, 0.9, 0], [0, 1, 0], [0, 1, 0], [0, 1, 0], [0, 1, 0], [0, 1, 0], [0, 1, 0], [0, 0.1, 0], [0, 0.1, 0], [0, 1, 0], [0, 1, 0],
    [0, 1, 0], [0, 1, 0], [0, 1, 0], [0, 1, 0], [0, 1, 0], [0, 1, 0], [0, 1, 0], [0, 1, 0], [0, 1, 0], [0.2, 1.4, 0], [0, 1, 0]]]}
]"#;

/// Words that readers of text stumble over.
const WORDS: [&str; 24] = [
    "0.25",
    "3",
    "12.5",
    "1",
    "NaN",
    "inf",
    "-1",
    "1e999",
    "99999999999999999999",
    "0",
    "-0.0",
    "{",
    "}",
    "[",
    "]",
    "\"",
    "End Site",
    "JOINT",
    "CHANNELS 300",
    "Frames: 4000000000",
    "Frame Time: 0",
    "\u{feff}",
    "ROOT",
    "\0",
];

/// Reads one mutated file.
///
/// # Errors
/// A refusal without words.
pub fn case(random: &mut Stream, tally: &mut Tally) -> Result<(), String> {
    let times = 1 + random.below(2);
    match random.below(4) {
        0 => {
            let text = mutated_text(BVH, times, random);
            note("recording", bvh::parse(&text).map_err(|(_, problem)| problem), tally)
        }
        1 => {
            let text = mutated_text(ANCHORS, times, random);
            note("anchor file", anchors_file::parse(&text, FRAME_RATE), tally)
        }
        2 => {
            let text = mutated_text(CONSTRAINTS, times, random);
            let imported = kimodo::parse(&text, kimodo::KIMODO_FPS, 0.0);
            if let Ok(imported) = &imported {
                anchors_file::text(&imported.anchors).map_err(|error| format!("imported, but no file: {error}"))?;
            }
            note("constraint file", imported, tally)
        }
        _ => {
            let mut bytes = safetensors_file();
            for _ in 0..times {
                mutate_bytes(&mut bytes, random);
            }
            note("checkpoint", checkpoint::tensors_of(&bytes), tally)
        }
    }
}

fn note<T, E: Display>(what: &str, result: Result<T, E>, tally: &mut Tally) -> Result<(), String> {
    match result {
        Ok(_) => tally.files_read += 1,
        Err(error) if error.to_string().is_empty() => return Err(format!("{what} refused without words")),
        Err(_) => tally.files_refused += 1,
    }
    Ok(())
}

/// `text` with `times` words or lines replaced, removed or repeated.
fn mutated_text(text: &str, times: u32, random: &mut Stream) -> String {
    let mut words: Vec<String> = text.split_inclusive([' ', '\n', ',']).map(str::to_owned).collect();
    for _ in 0..times {
        let at = random.below(words.len().max(1) as u32) as usize;
        let word = WORDS[random.below(WORDS.len() as u32) as usize];
        match random.below(5) {
            0 => words.truncate(at),
            1 if at < words.len() => drop(words.remove(at)),
            2 if at < words.len() => words.insert(at, words[at].clone()),
            3 => words.insert(at.min(words.len()), format!("{word} ")),
            _ => {
                if let Some(slot) = words.get_mut(at) {
                    let end: String = slot.chars().filter(|c| c.is_whitespace() || *c == ',').collect();
                    *slot = format!("{word}{end}");
                }
            }
        }
    }
    words.concat()
}

/// A safetensors file with two tensors and metadata.
fn safetensors_file() -> Vec<u8> {
    let header = r#"{"__metadata__":{"format":"motionette-tokenizer","version":"1"},"a":{"dtype":"F32","shape":[2,3],"data_offsets":[0,24]},"b":{"dtype":"I64","shape":[1],"data_offsets":[24,32]}}"#;
    let mut bytes = (header.len() as u64).to_le_bytes().to_vec();
    bytes.extend(header.as_bytes());
    bytes.extend((0..32).map(|i| i as u8));
    bytes
}

fn mutate_bytes(bytes: &mut Vec<u8>, random: &mut Stream) {
    let at = random.below(bytes.len().max(1) as u32) as usize;
    match random.below(4) {
        0 => bytes.truncate(at),
        1 if at < bytes.len() => drop(bytes.remove(at)),
        2 => bytes.insert(at.min(bytes.len()), b"09,:{}[]\"-"[random.below(10) as usize]),
        _ => {
            if let Some(byte) = bytes.get_mut(at) {
                *byte = if random.below(2) == 0 {
                    random.next_u32() as u8
                } else {
                    b"0123456789"[random.below(10) as usize]
                };
            }
        }
    }
}
