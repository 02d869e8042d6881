//! BVH files as other programs write them: one body under the names, hierarchies and units of many, moved by seeded angles. Where every
//! joint is, is computed here with matrices.

use std::fmt::Write as _;

use motionette_host::motion::{JOINTS, skeleton};

use super::Random;

type Vector = [f64; 3];
type Matrix = [Vector; 3];

/// Names and hierarchy of a program. `{}` stands for the side. A joint's second word is the point of the body where it lies.
pub struct Scheme {
    /// The program.
    pub name: &'static str,
    /// Left and right in names.
    pub sides: [&'static str; 2],
    /// Metres a unit.
    pub unit: f64,
    /// Whether z points up.
    pub z_up: bool,
    /// Joints above the pelvis, at the pelvis; the spine hangs on the last of them where `spine_above` is set.
    pub roots: &'static [&'static str],
    /// See `roots`.
    pub spine_above: bool,
    /// The pelvis.
    pub pelvis: &'static str,
    /// From the pelvis down.
    pub leg: &'static [(&'static str, &'static str)],
    /// From the pelvis up, with the share of the way to the neck.
    pub spine: &'static [(&'static str, f64)],
    /// From the last of the spine.
    pub neck: &'static [(&'static str, &'static str)],
    /// From the last of the spine.
    pub arm: &'static [(&'static str, &'static str)],
}

/// Places at rest, left side, metres, y up.
fn point(name: &str) -> Vector {
    match name {
        "pelvis" => [0.0, 0.95, 0.0],
        "hip" => [0.09, 0.87, 0.0],
        "thigh" => [0.095, 0.67, 0.0],
        "knee" => [0.1, 0.48, 0.01],
        "ankle" => [0.1, 0.09, -0.02],
        "foot" => [0.11, 0.02, 0.11],
        "neck" => [0.0, 1.5, 0.0],
        "head" => [0.0, 1.6, 0.02],
        "top" => [0.0, 1.72, 0.03],
        "collar" => [0.04, 1.42, 0.0],
        "shoulder" => [0.18, 1.42, 0.0],
        "arm" => [0.31, 1.42, 0.0],
        "elbow" => [0.45, 1.42, 0.0],
        "wrist" => [0.7, 1.42, 0.0],
        "finger" => [0.8, 1.42, 0.01],
        other => panic!("no point {other}"),
    }
}

/// What lies at the end of a limb that has no joint there: its End Site.
fn beyond(name: &str) -> &'static str {
    match name {
        "ankle" => "foot",
        "elbow" => "wrist",
        "neck" => "head",
        "head" => "top",
        _ => "",
    }
}

struct Node {
    name: String,
    parent: Option<usize>,
    at: Vector,
    /// SMPL joint here.
    smpl: Option<usize>,
    end_site: bool,
}

/// A file and where those of the 22 are that it has itself, metres, y up.
pub struct Foreign {
    /// The file.
    pub text: String,
    /// `[frame][joint]`; `None` for what the skeleton lacks (parts of the spine, collar bones).
    pub joints: Vec<[Option<Vector>; JOINTS]>,
    /// Their names in the file.
    pub names: Vec<Option<String>>,
}

impl Scheme {
    /// All joints and End Sites in the order of the file: depth first.
    fn nodes(&self) -> Vec<Node> {
        let mut nodes = Vec::new();
        let mut top = None;
        for name in self.roots {
            top = Some(add(&mut nodes, name, top, point("pelvis"), None));
        }
        let pelvis = add(&mut nodes, self.pelvis, top, point("pelvis"), Some(0));
        let mut chest = if self.spine_above { top.unwrap_or(pelvis) } else { pelvis };
        for (name, share) in self.spine {
            let (from, to) = (point("pelvis"), point("neck"));
            let at = std::array::from_fn(|c| from[c] + share * (to[c] - from[c]));
            chest = add(&mut nodes, name, Some(chest), at, None);
        }
        for (chain, from) in [(self.leg, pelvis), (self.arm, chest)] {
            for (side, word, sign) in [("left_", self.sides[0], 1.0), ("right_", self.sides[1], -1.0)] {
                limb(&mut nodes, chain, from, |name| name.replace("{}", word), (side, sign));
            }
        }
        limb(&mut nodes, self.neck, chest, str::to_owned, ("", 1.0));
        let mut order = Vec::new();
        depth_first(&nodes, 0, &mut order);
        let place = |old: usize| order.iter().position(|&index| index == old);
        let parents: Vec<Option<usize>> = order.iter().map(|&old| nodes[old].parent.and_then(place)).collect();
        let mut nodes: Vec<Option<Node>> = nodes.into_iter().map(Some).collect();
        let sorted = order.iter().zip(parents);
        sorted.filter_map(|(&old, parent)| Some(Node { parent, ..nodes[old].take()? })).collect()
    }

    /// The body in frames of 1/20 s, turning and bending everywhere by up to `bend` degrees.
    pub fn moved(&self, frames: usize, bend: f64, random: &mut Random) -> Foreign {
        let nodes = self.nodes();
        let mut text = String::from("HIERARCHY\n");
        self.block(&nodes, 0, &mut text);
        let _ = writeln!(text, "MOTION\nFrames: {frames}\nFrame Time: 0.05");
        let mut joints = Vec::new();
        for frame in 0..frames {
            let mut placed: Vec<(Vector, Matrix)> = Vec::new();
            let mut row = Vec::new();
            for (index, node) in nodes.iter().enumerate() {
                let mut turn = IDENTITY;
                let offset = node.parent.map_or(node.at, |parent| difference(node.at, nodes[parent].at));
                let mut place = offset;
                if index == 0 {
                    let step = 0.03 * frame as f64;
                    place = [offset[0] + step, offset[1], offset[2] + 2.0 * step];
                    row.extend(self.in_file(place));
                }
                if !node.end_site {
                    // About the file's own axes, in the order of its channels: z, x, y.
                    let angles = random.vector().map(|x| bend * x);
                    let about = |axis, degrees| self.of_file(&about(axis, degrees));
                    turn = product(&about(2, angles[0]), &product(&about(0, angles[1]), &about(1, angles[2])));
                    row.extend(angles);
                }
                if let Some(parent) = node.parent {
                    let (origin, above) = &placed[parent];
                    place = std::array::from_fn(|r| origin[r] + (0..3).map(|c| above[r][c] * place[c]).sum::<f64>());
                    turn = product(above, &turn);
                }
                placed.push((place, turn));
            }
            let row: Vec<String> = row.iter().map(|x| format!("{x:.6}")).collect();
            let _ = writeln!(text, "{}", row.join(" "));
            let mut known = [None; JOINTS];
            nodes.iter().zip(&placed).filter_map(|(node, placed)| Some((node.smpl?, placed.0))).for_each(
                |(j, place)| {
                    known[j] = Some(place);
                },
            );
            joints.push(known);
        }
        let name = |j| nodes.iter().find(|node| node.smpl == Some(j)).map(|node| node.name.clone());
        Foreign { text, joints, names: (0..JOINTS).map(name).collect() }
    }

    fn block(&self, nodes: &[Node], index: usize, text: &mut String) {
        let node = &nodes[index];
        let offset = node.parent.map_or([0.0; 3], |parent| difference(node.at, nodes[parent].at));
        let [x, y, z] = self.in_file(offset);
        let head = match (node.end_site, node.parent) {
            (true, _) => "End Site".to_owned(),
            (false, None) => format!("ROOT {}", node.name),
            (false, Some(_)) => format!("JOINT {}", node.name),
        };
        let _ = writeln!(text, "{head}\n{{\nOFFSET {x:.6} {y:.6} {z:.6}");
        if !node.end_site {
            let places = if index == 0 { "6 Xposition Yposition Zposition" } else { "3" };
            let _ = writeln!(text, "CHANNELS {places} Zrotation Xrotation Yrotation");
        }
        (index + 1..nodes.len()).filter(|&j| nodes[j].parent == Some(index)).for_each(|j| self.block(nodes, j, text));
        text.push_str("}\n");
    }

    /// Metres, y up, in the file's unit and axes.
    fn in_file(&self, [x, y, z]: Vector) -> Vector {
        let axes = if self.z_up { [x, -z, y] } else { [x, y, z] };
        axes.map(|x| x / self.unit)
    }

    /// A rotation of the file's axes in ours.
    fn of_file(&self, turn: &Matrix) -> Matrix {
        if !self.z_up {
            return *turn;
        }
        let into = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]];
        let back = std::array::from_fn(|r| std::array::from_fn(|c| into[c][r]));
        product(&into, &product(turn, &back))
    }
}

const IDENTITY: Matrix = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];

fn add(nodes: &mut Vec<Node>, name: &str, parent: Option<usize>, at: Vector, smpl: Option<usize>) -> usize {
    nodes.push(Node { name: name.to_owned(), parent, at, smpl, end_site: false });
    nodes.len() - 1
}

fn depth_first(nodes: &[Node], index: usize, order: &mut Vec<usize>) {
    order.push(index);
    (index + 1..nodes.len()).filter(|&j| nodes[j].parent == Some(index)).for_each(|j| depth_first(nodes, j, order));
}

/// A chain of joints and its End Site; `side` is the beginning of the SMPL names and the sign of x.
fn limb(
    nodes: &mut Vec<Node>,
    chain: &[(&str, &str)],
    from: usize,
    named: impl Fn(&str) -> String,
    (side, sign): (&str, f64),
) {
    let smpl = |place: &str| skeleton::NAMES.iter().position(|known| *known == format!("{side}{place}"));
    let mirrored = |[x, y, z]: Vector| [sign * x, y, z];
    let mut parent = from;
    for (name, place) in chain {
        // The pelvis is a joint of its own.
        let joint = if *place == "pelvis" { None } else { smpl(place) };
        parent = add(nodes, &named(name), Some(parent), mirrored(point(place)), joint);
    }
    let Some((name, place)) = chain.last() else { return };
    let (at, joint) = match beyond(place) {
        "" => (point(place).map(|x| 1.02 * x), None),
        next => (point(next), smpl(next)),
    };
    let end = add(nodes, &format!("{} End Site", named(name)), Some(parent), mirrored(at), joint);
    nodes[end].end_site = true;
}

fn difference(a: Vector, b: Vector) -> Vector {
    std::array::from_fn(|c| a[c] - b[c])
}

fn about(axis: usize, degrees: f64) -> Matrix {
    let (sin, cos) = degrees.to_radians().sin_cos();
    let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
    let mut m = [[0.0; 3]; 3];
    (m[axis][axis], m[i][i], m[i][j], m[j][i], m[j][j]) = (1.0, cos, -sin, sin, cos);
    m
}

fn product(a: &Matrix, b: &Matrix) -> Matrix {
    std::array::from_fn(|r| std::array::from_fn(|c| (0..3).map(|k| a[r][k] * b[k][c]).sum()))
}
