//! How a file is to be read: which joints, which unit, which way is up, where it begins.

use super::guess;
use super::mapping::{self, Mapping, Place, Up};
use super::unit::{self, Stated};
use super::{Bvh, Problem, Reading, Unit, kinematics, plausible, resample};
use crate::motion::quaternion::{self as q, Vector};
use crate::motion::{JOINTS, Pose};

/// Frames looked at to see which way is up.
const GLANCES: usize = 50;
const HEAD: usize = 15;
const ANKLES: [usize; 2] = [7, 8];

/// What was decided.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Choice {
    /// Name of the mapping.
    pub mapping: String,
    /// Where each of the 22 comes from.
    pub sources: [Place; JOINTS],
    /// What a unit of the file is.
    pub unit: Unit,
    /// The axis that points up.
    pub up: Up,
    /// The first frame that belongs to the motion.
    pub first: usize,
    /// What the user should know about it.
    pub notes: Vec<String>,
}

impl Choice {
    /// What the user says, else a built-in table, else a guess.
    pub fn of(bvh: &Bvh, reading: &Reading) -> Result<Self, Problem> {
        let mut notes = Vec::new();
        let table = if reading.mapping.is_none() { Some(Mapping::detect(bvh)) } else { None };
        let (mapping, closest) = match (&reading.mapping, &table) {
            (Some(mapping), _) | (None, Some(Ok(mapping))) => (Some(mapping), None),
            (None, Some(Err(closest))) => (None, Some(closest)),
            (None, None) => (None, None),
        };
        let first = mapping.map_or(0, |mapping| mapping.drop_frames);
        if first >= bvh.frames() {
            return Err(Problem::NothingLeft { dropped: first });
        }
        let at = kinematics::positions(bvh, &resample::original(bvh, first));
        let sources = match mapping {
            Some(mapping) => mapping.resolve(bvh)?,
            None => {
                let sources = guess::guess(bvh, &at).map_err(|unclear| no_mapping(bvh, &unclear, closest))?;
                let described = guess::described(&sources, bvh);
                notes.push(format!("joints guessed from their names (--mapping FILE.json corrects it): {described}"));
                sources
            }
        };
        let body = sources.map(|place| place.of(&at));
        let height = unit::height(&body);
        plausible::has_size(&body, height)?;
        let stated = match (reading.unit, mapping.and_then(|mapping| mapping.unit)) {
            (Some(unit), _) => Stated::ByUser(unit),
            (None, Some(unit)) if reading.mapping.is_some() => Stated::ByUser(unit),
            (None, Some(unit)) => Stated::ByTable(unit),
            (None, None) => Stated::Nowhere,
        };
        let (unit, note) = unit::choose(stated, height)?;
        notes.extend(note);
        let up = match &reading.mapping {
            Some(mapping) => mapping.up,
            None => upright(bvh, &sources, first),
        };
        if reading.mapping.is_none() && up == Up::Z {
            notes.push("z points up (a mapping with \"up\": \"y\" says otherwise)".into());
        }
        let mapping = mapping.map_or_else(|| "guessed".to_owned(), |mapping| mapping.name.clone());
        Ok(Self { mapping, sources, unit, up, first, notes })
    }

    /// The 22 joints in metres, y up, from a file's global positions.
    pub fn pose(&self, at: &[Vector]) -> Pose {
        self.sources.map(|place| {
            let [x, y, z] = q::scale(place.of(at), self.unit.metres());
            let upright = match self.up {
                Up::Y => [x, y, z],
                Up::Z => [x, z, -y],
            };
            upright.map(|x| x as f32)
        })
    }
}

fn no_mapping(bvh: &Bvh, unclear: &[&str], closest: Option<&(Mapping, Vec<String>)>) -> Problem {
    let (closest, missing) =
        closest.map_or_else(Default::default, |(table, missing)| (table.name.clone(), missing.join(", ")));
    Problem::NoMapping {
        unclear: unclear.join(", ").into(),
        closest: closest.into(),
        missing,
        present: mapping::present(bvh),
    }
}

/// z where the body stands along it both at rest and in the motion; lying bodies and twisted rest poses keep y.
fn upright(bvh: &Bvh, sources: &[Place; JOINTS], first: usize) -> Up {
    let standing = |at: &[Vector]| {
        let [left, right] = ANKLES.map(|ankle| sources[ankle].of(at));
        q::subtract(sources[HEAD].of(at), q::scale(q::add(left, right), 0.5))
    };
    let along_z = |v: Vector| v[2] > 2.0 * v[1].abs();
    let mut rest: Vec<Vector> = Vec::with_capacity(bvh.joints.len());
    for joint in &bvh.joints {
        rest.push(q::add(joint.parent.map_or([0.0; 3], |parent| rest[parent]), joint.offset));
    }
    let step = (bvh.frames() - first).div_ceil(GLANCES);
    let frames = (first..bvh.frames()).step_by(step.max(1));
    let seen = frames.map(|frame| standing(&kinematics::positions(bvh, &resample::original(bvh, frame))));
    let mean = seen.fold([0.0; 3], q::add);
    if along_z(standing(&rest)) && along_z(mean) { Up::Z } else { Up::Y }
}
