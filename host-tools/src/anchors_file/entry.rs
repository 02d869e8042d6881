//! One object of the list: its fields, then an anchor.

use motionette::{Anchor, Target};

use super::Error;
use crate::entries::{self, Entry, Fault};

/// Fields an anchor may have.
pub(super) const FIELDS: [&str; 6] = ["time", "frame", "root", "planar_root", "joint", "position"];

/// The anchor in a motion of `frame_rate` frames a second, or what is wrong with the object.
pub(super) fn anchor(entry: &Entry, index: usize, frame_rate: u16) -> Result<Anchor, Error> {
    let fault = |fault: Fault| Error::of(index, fault);
    let [time, frame, root, planar_root, joint, position] = entry.fields(&FIELDS).map_err(fault)?;
    let frame = entries::frame(time, frame, frame_rate).map_err(fault)?;
    let given: Vec<&'static str> = [
        root.map(|_| "root"),
        planar_root.map(|_| "planar_root"),
        joint.map(|_| "joint").or(position.map(|_| "position")),
    ]
    .into_iter()
    .flatten()
    .collect();
    if given.len() > 1 {
        return Err(Error::SeveralTargets { index, fields: given });
    }
    const THREE: &str = "a list of three numbers [x, y, z]";
    let target = match (root, planar_root, joint, position) {
        (Some(at), ..) => Target::Root(entries::coordinates("root", THREE, at).map_err(fault)?),
        (_, Some(at), ..) => {
            Target::PlanarRoot(entries::coordinates("planar_root", "a list of two numbers [x, z]", at).map_err(fault)?)
        }
        (_, _, Some(name), Some(at)) => Target::Joint {
            joint: entries::joint("joint", name).map_err(fault)?,
            position: entries::coordinates("position", THREE, at).map_err(fault)?,
        },
        (_, _, Some(_), None) => return Err(Error::Half { index, field: "joint", missing: "position" }),
        (_, _, None, Some(_)) => return Err(Error::Half { index, field: "position", missing: "joint" }),
        (None, None, None, None) => return Err(Error::NoTarget { index }),
    };
    Ok(Anchor { frame, target })
}
