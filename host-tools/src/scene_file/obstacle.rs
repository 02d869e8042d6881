//! One object of the list of obstacles: its fields, then an obstacle.

use motionette::{ALL_JOINTS, Course, Keyframe, Obstacle, Shape};

use super::{Error, Place};
use crate::entries::{self, Entry, Fault, Node};

/// Forms by name.
pub(super) const SHAPES: [&str; 5] = ["sphere", "capsule", "cylinder", "box", "plane"];
/// Fields an obstacle may have.
const FIELDS: [&str; 10] =
    ["sphere", "capsule", "cylinder", "box", "plane", "at", "velocity", "keyframes", "margin", "joints"];
/// What is kept away from a surface where nothing is said, metres.
const MARGIN: f32 = 0.05;
/// No obstacle is larger, metres.
const LARGEST: f32 = 100.0;
/// Three numbers.
const THREE: &str = "a list of three numbers [x, y, z]";

/// How an obstacle moves, with its keyframes.
#[derive(Debug, Clone, PartialEq)]
pub enum OwnedCourse {
    /// Its middle stays there, metres.
    Still([f32; 3]),
    /// Its middle goes on at one speed.
    Moving {
        /// The middle at frame 0, metres.
        from: [f32; 3],
        /// Metres a second.
        velocity: [f32; 3],
    },
    /// Its middle goes from keyframe to keyframe in straight lines.
    Keyframes(Vec<Keyframe>),
}

/// A body that the figure keeps clear of, with its keyframes.
#[derive(Debug, Clone, PartialEq)]
pub struct OwnedObstacle {
    /// Its form, around its middle.
    pub shape: Shape,
    /// Where its middle is.
    pub course: OwnedCourse,
    /// How far the figure keeps away from its surface, metres.
    pub margin: f32,
    /// The joints that keep clear, bit j for joint j, each with the bone from its parent.
    pub joints: u32,
}

impl OwnedObstacle {
    /// As a request takes it.
    #[must_use]
    pub fn borrowed(&self) -> Obstacle<'_> {
        let course = match &self.course {
            OwnedCourse::Still(at) => Course::Still(*at),
            OwnedCourse::Moving { from, velocity } => Course::Moving { from: *from, velocity: *velocity },
            OwnedCourse::Keyframes(keyframes) => Course::Keyframes(keyframes),
        };
        Obstacle { shape: self.shape, course, margin: self.margin, joints: self.joints }
    }
}

/// The obstacle in a motion of `frame_rate` frames a second, or what is wrong with the object.
pub(super) fn obstacle(entry: &Entry, index: usize, frame_rate: u16) -> Result<OwnedObstacle, Error> {
    let reader = Reader { place: Place::obstacle(index) };
    let [sphere, capsule, cylinder, sides, plane, at, velocity, keyframes, margin, joints] =
        reader.of(entry.fields(&FIELDS))?;
    let forms = [sphere, capsule, cylinder, sides, plane];
    let given = SHAPES.into_iter().zip(forms).filter_map(|(name, form)| Some((name, form?)));
    let given: Vec<(&'static str, &Node)> = given.collect();
    let [(name, form)] = given[..] else {
        return Err(Error::Shape { index, fields: given.into_iter().map(|(name, _)| name).collect() });
    };
    let (shape, middle) = reader.shape(name, form)?;
    let both = |first, second| Error::Both { place: reader.place, first, second };
    let at = match (at, middle) {
        (Some(_), Some(_)) => return Err(both("at", "capsule's from and to")),
        (Some(at), None) => Some(reader.of(entries::coordinates("at", THREE, at))?),
        (None, middle) => middle,
    };
    let course = match (at, velocity, keyframes) {
        (_, Some(_), Some(_)) => return Err(both("velocity", "keyframes")),
        (Some(_), None, Some(_)) if middle.is_none() => return Err(both("at", "keyframes")),
        (_, None, Some(keyframes)) => OwnedCourse::Keyframes(reader.keyframes(keyframes, frame_rate)?),
        (None, ..) => return Err(reader.missing("at", r#""at": [x, y, z], or keyframes"#)),
        (Some(from), Some(velocity), None) => {
            OwnedCourse::Moving { from, velocity: reader.of(entries::coordinates("velocity", THREE, velocity))? }
        }
        (Some(at), None, None) => OwnedCourse::Still(at),
    };
    let margin = margin.map(|margin| reader.of(entries::number("margin", "a number of metres", margin))).transpose()?;
    let margin = margin.unwrap_or(MARGIN);
    if !(0.0..=1.0).contains(&margin) {
        return Err(Error::Range { place: reader.place, field: "margin", value: margin, range: "0 to 1 m" });
    }
    let joints = joints.map_or(Ok(ALL_JOINTS), |joints| reader.of(mask(joints)))?;
    Ok(OwnedObstacle { shape, course, margin, joints })
}

/// Joints by their names, bit j for joint j.
fn mask(value: &Node) -> Result<u32, Fault> {
    let mismatch = || entries::wrong("joints", "a list of names of joints, at least one", value);
    let names = value.as_list().filter(|names| !names.is_empty()).ok_or_else(mismatch)?;
    names.iter().try_fold(0, |mask, name| Ok(mask | 1 << entries::joint("joints", name)?))
}

/// Reads fields of one obstacle.
struct Reader {
    place: Place,
}

impl Reader {
    /// The same with its place.
    fn of<T>(&self, result: Result<T, Fault>) -> Result<T, Error> {
        result.map_err(|fault| Error::Field { place: self.place, fault })
    }

    const fn missing(&self, field: &'static str, example: &'static str) -> Error {
        Error::Missing { place: self.place, field, example }
    }

    /// The form of this name, and its middle, where that is said together with it.
    fn shape(&self, name: &'static str, form: &Node) -> Result<(Shape, Option<[f32; 3]>), Error> {
        let expected = "an object with its sizes";
        let form = form.as_entry().ok_or_else(|| entries::wrong(name, expected, form));
        let form = self.of(form)?;
        Ok(match name {
            "sphere" => {
                let [radius] = self.of(form.fields(&["radius"]))?;
                (Shape::Sphere { radius: self.size("radius", radius)? }, None)
            }
            "capsule" => {
                let [radius, from, to] = self.of(form.fields(&["radius", "from", "to"]))?;
                let radius = self.size("radius", radius)?;
                let from = from.ok_or(self.missing("from", r#""from": [x, y, z], one end of its middle line"#))?;
                let to = to.ok_or(self.missing("to", r#""to": [x, y, z], the other end of its middle line"#))?;
                let from = self.of(entries::coordinates::<3>("from", THREE, from))?;
                let to = self.of(entries::coordinates::<3>("to", THREE, to))?;
                let halves = |sign: f32| std::array::from_fn(|axis| 0.5 * to[axis] + sign * 0.5 * from[axis]);
                (Shape::Capsule { half: halves(-1.0), radius }, Some(halves(1.0)))
            }
            "cylinder" => {
                let [radius, height] = self.of(form.fields(&["radius", "height"]))?;
                let (radius, height) = (self.size("radius", radius)?, self.size("height", height)?);
                (Shape::Cylinder { radius, half_height: 0.5 * height }, None)
            }
            "box" => {
                let [size] = self.of(form.fields(&["size"]))?;
                let size = size.ok_or(self.missing("size", r#""size": [x, y, z]"#))?;
                let size: [f32; 3] = self.of(entries::coordinates("size", THREE, size))?;
                for value in size {
                    self.sized("size", value)?;
                }
                (Shape::Box { half: size.map(|value| 0.5 * value) }, None)
            }
            _ => {
                let [normal] = self.of(form.fields(&["normal"]))?;
                let normal = normal.ok_or(self.missing("normal", r#""normal": [x, y, z], towards the free side"#))?;
                let normal: [f32; 3] = self.of(entries::coordinates("normal", THREE, normal))?;
                let long = normal.iter().map(|value| value * value).sum::<f32>().sqrt();
                if !(long > 1e-3 && long <= 1e3) {
                    let range = "a direction, best of length 1";
                    return Err(Error::Range { place: self.place, field: "normal's length", value: long, range });
                }
                (Shape::Plane { normal }, None)
            }
        })
    }

    /// A size in metres.
    fn size(&self, field: &'static str, value: Option<&Node>) -> Result<f32, Error> {
        let value = value.ok_or(self.missing(field, "it in metres"))?;
        let value = self.of(entries::number(field, "a number of metres", value))?;
        self.sized(field, value)
    }

    fn sized(&self, field: &'static str, value: f32) -> Result<f32, Error> {
        if value > 0.0 && value <= LARGEST {
            return Ok(value);
        }
        Err(Error::Range { place: self.place, field, value, range: "above 0 and at most 100 m" })
    }

    fn keyframes(&self, value: &Node, frame_rate: u16) -> Result<Vec<Keyframe>, Error> {
        let mismatch = || entries::wrong("keyframes", "a list of objects with time and position, at least one", value);
        let list = self.of(value.as_list().filter(|list| !list.is_empty()).ok_or_else(mismatch))?;
        let mut keyframes: Vec<Keyframe> = Vec::new();
        for (number, node) in list.iter().enumerate() {
            let one = Reader { place: self.place.keyframe(number) };
            let entry = node.as_entry().ok_or_else(|| entries::wrong("it", "an object with time and position", node));
            let [time, frame, position] = one.of(one.of(entry)?.fields(&["time", "frame", "position"]))?;
            let frame = one.of(entries::frame(time, frame, frame_rate))?;
            let position = position.ok_or(one.missing("position", r#""position": [x, y, z]"#))?;
            let position = one.of(entries::coordinates("position", THREE, position))?;
            if keyframes.last().is_some_and(|before| frame <= before.frame) {
                return Err(Error::KeyframeOrder { index: self.place.index, keyframe: number, frame });
            }
            keyframes.push(Keyframe { frame, position });
        }
        Ok(keyframes)
    }
}
