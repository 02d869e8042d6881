//! Joint positions to binary glTF 2.0.
//!
//! The file holds a skeleton of 22 nodes under the names of [`skeleton::NAMES`], in metres, y up, facing +z as glTF wants it; an
//! animation that moves and turns every node; and a skinned mesh with a slim octahedron a bone, so that viewers have something to show.
//! [The parent module](super) says how rotations are chosen; as every node's place is animated too, nodes pass through the motion's
//! positions exactly.

use std::collections::BTreeMap;
use std::io::{self, Write};

use gltf_json as json;
use json::accessor::{ComponentType, GenericComponentType, Type};
use json::animation::{Channel, Interpolation, Property, Sampler, Target};
use json::mesh::Semantic;
use json::validation::{Checked, USize64};
use json::{Accessor, Index, Root, buffer};
use serde_json::json as value;

use super::rig::{self, Bones, Rig, children};
use crate::motion::quaternion::{self as q, Vector};
use crate::motion::{JOINTS, Pose, skeleton};

/// Where the widest part of a bone lies on it, and its distance from the middle, shares of the length.
const WIDEST: [f64; 2] = [0.15, 0.08];

/// Writes a motion as GLB.
///
/// `joints` are global positions, metres, y up; `frame_time` is in seconds.
///
/// # Errors
/// As [`super::write_bvh`]; [`io::ErrorKind::InvalidInput`] also for a motion that does not fit into a file of 4 GiB.
pub fn write_glb(joints: &[Pose], frame_time: f64, out: &mut dyn Write) -> io::Result<()> {
    rig::check(joints, frame_time)?;
    let rig = Rig::of(joints);
    let rest = standing(&rig);
    let mut file = File::default();
    file.skeleton(&rig, &rest);
    file.body(&rest);
    file.animation(joints, frame_time, &rig);
    file.write(out)
}

/// Places of the joints at rest, metres: the lowest at y = 0.
fn standing(rig: &Rig) -> [Vector; JOINTS] {
    let mut rest = rig.rest;
    for j in 1..JOINTS {
        rest[j] = q::add(rest[skeleton::PARENTS[j]], rest[j]);
    }
    let low = rest.iter().map(|p| p[1]).fold(f64::INFINITY, f64::min);
    rest.map(|[x, y, z]| [x, y - low, z])
}

/// A document and its bytes.
#[derive(Default)]
struct File {
    root: Root,
    bytes: Vec<u8>,
}

fn node(joint: usize) -> Index<json::Node> {
    Index::new(joint as u32)
}

fn single(v: Vector) -> [f32; 3] {
    v.map(|x| x as f32)
}

impl File {
    /// Appends rows of numbers. With `bounds`, their smallest and largest values are noted.
    fn accessor<T: bytemuck::NoUninit, const N: usize>(
        &mut self,
        rows: &[[T; N]],
        (component, kind): (ComponentType, Type),
        target: Option<buffer::Target>,
        bounds: Option<fn(&T) -> f32>,
    ) -> Index<Accessor> {
        let bytes: &[u8] = bytemuck::cast_slice(rows.as_flattened());
        let view = self.root.push(buffer::View {
            buffer: Index::new(0),
            byte_length: USize64::from(bytes.len()),
            byte_offset: Some(USize64::from(self.bytes.len())),
            byte_stride: None,
            name: None,
            target: target.map(Checked::Valid),
            extensions: None,
            extras: Default::default(),
        });
        self.bytes.extend_from_slice(bytes);
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let bound = |pick: fn(f32, f32) -> f32| {
            let of = |read: fn(&T) -> f32, i: usize| rows.iter().map(|row| read(&row[i])).reduce(pick);
            bounds.map(|read| value!((0..N).map(|i| of(read, i)).collect::<Vec<_>>()))
        };
        let (min, max) = (bound(f32::min), bound(f32::max));
        self.root.push(Accessor {
            buffer_view: Some(view),
            byte_offset: None,
            count: USize64::from(rows.len()),
            component_type: Checked::Valid(GenericComponentType(component)),
            type_: Checked::Valid(kind),
            min,
            max,
            name: None,
            normalized: false,
            sparse: None,
            extensions: None,
            extras: Default::default(),
        })
    }

    /// A node a joint, in the order of the joints, and the scene.
    fn skeleton(&mut self, rig: &Rig, rest: &[Vector; JOINTS]) {
        for j in 0..JOINTS {
            let below: Vec<_> = children(j).map(node).collect();
            let place = if j == 0 { rest[0] } else { rig.rest[j] };
            self.root.push(json::Node {
                name: Some(skeleton::NAMES[j].to_owned()),
                translation: Some(single(place)),
                children: (!below.is_empty()).then_some(below),
                ..json::Node::default()
            });
        }
    }

    /// The mesh, the skin that ties it to the nodes, and the scene.
    fn body(&mut self, rest: &[Vector; JOINTS]) {
        let (mut positions, mut normals, mut joints) = (Vec::new(), Vec::new(), Vec::new());
        for j in 1..JOINTS {
            let parent = skeleton::PARENTS[j];
            for triangle in octahedron(rest[parent], rest[j]) {
                let [a, b, c] = triangle;
                let normal = q::cross(q::subtract(b, a), q::subtract(c, a));
                let normal = single(q::direction(normal).unwrap_or([0.0, 1.0, 0.0]));
                for corner in triangle {
                    positions.push(single(corner));
                    normals.push(normal);
                    joints.push([parent as u8, 0, 0, 0]);
                }
            }
        }
        let weights = vec![[1.0f32, 0.0, 0.0, 0.0]; joints.len()];
        let vertices = Some(buffer::Target::ArrayBuffer);
        let attributes = BTreeMap::from([
            (
                Checked::Valid(Semantic::Positions),
                self.accessor(&positions, (ComponentType::F32, Type::Vec3), vertices, Some(|x| *x)),
            ),
            (
                Checked::Valid(Semantic::Normals),
                self.accessor(&normals, (ComponentType::F32, Type::Vec3), vertices, None),
            ),
            (
                Checked::Valid(Semantic::Joints(0)),
                self.accessor(&joints, (ComponentType::U8, Type::Vec4), vertices, None),
            ),
            (
                Checked::Valid(Semantic::Weights(0)),
                self.accessor(&weights, (ComponentType::F32, Type::Vec4), vertices, None),
            ),
        ]);
        let mesh = self.root.push(json::Mesh {
            name: Some("body".to_owned()),
            primitives: vec![json::mesh::Primitive {
                attributes,
                indices: None,
                material: None,
                mode: Checked::Valid(json::mesh::Mode::Triangles),
                targets: None,
                extensions: None,
                extras: Default::default(),
            }],
            weights: None,
            extensions: None,
            extras: Default::default(),
        });
        // Columns of a matrix that takes a joint's place at rest to the origin.
        let back = rest
            .map(single)
            .map(|[x, y, z]| [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, -x, -y, -z, 1.0f32]);
        let inverse_bind_matrices = Some(self.accessor(&back, (ComponentType::F32, Type::Mat4), None, None));
        let skin = self.root.push(json::Skin {
            name: Some("body".to_owned()),
            inverse_bind_matrices,
            joints: (0..JOINTS).map(node).collect(),
            skeleton: Some(node(0)),
            extensions: None,
            extras: Default::default(),
        });
        let name = Some("body".to_owned());
        let body = self.root.push(json::Node { name, mesh: Some(mesh), skin: Some(skin), ..json::Node::default() });
        let nodes = vec![node(0), body];
        let scene = json::Scene { name: None, nodes, extensions: None, extras: Default::default() };
        self.root.scene = Some(self.root.push(scene));
    }

    /// Places and rotations of every node, frame by frame.
    fn animation(&mut self, joints: &[Pose], frame_time: f64, rig: &Rig) {
        let times: Vec<[f32; 1]> = (0..joints.len()).map(|frame| [(frame as f64 * frame_time) as f32]).collect();
        let input = self.accessor(&times, (ComponentType::F32, Type::Scalar), None, Some(|t| *t));
        let locals: Vec<_> = joints.iter().map(|pose| rig.pose(pose, Bones::Stretching).locals).collect();
        let (mut channels, mut samplers) = (Vec::new(), Vec::new());
        for j in 0..JOINTS {
            let places: Vec<[f32; 3]> = locals.iter().map(|local| single(local[j].0)).collect();
            let mut before = q::IDENTITY;
            let rotations = locals.iter().map(|local| {
                // Of the two quaternions of a rotation, the one nearer to the frame before.
                let r = local[j].1;
                let sign = if r.iter().zip(before).map(|(a, b)| a * b).sum::<f64>() < 0.0 { -1.0 } else { 1.0 };
                before = r.map(|x| sign * x);
                let [w, x, y, z] = before.map(|x| x as f32);
                [x, y, z, w]
            });
            let rotations: Vec<[f32; 4]> = rotations.collect();
            let places = self.accessor(&places, (ComponentType::F32, Type::Vec3), None, None);
            let rotations = self.accessor(&rotations, (ComponentType::F32, Type::Vec4), None, None);
            for (path, output) in [(Property::Translation, places), (Property::Rotation, rotations)] {
                let interpolation = Checked::Valid(Interpolation::Linear);
                let sampler = Sampler { input, output, interpolation, extensions: None, extras: Default::default() };
                let sampler = Index::push(&mut samplers, sampler);
                let path = Checked::Valid(path);
                let target = Target { node: node(j), path, extensions: None, extras: Default::default() };
                channels.push(Channel { sampler, target, extensions: None, extras: Default::default() });
            }
        }
        let name = Some("motion".to_owned());
        self.root.push(json::Animation { name, channels, samplers, extensions: None, extras: Default::default() });
    }

    /// The container: a header of 12 bytes, then a chunk of JSON and one of bytes, each with a head of 8 bytes.
    fn write(mut self, out: &mut dyn Write) -> io::Result<()> {
        self.root.asset.generator = Some("motionette".to_owned());
        self.root.push(json::Buffer {
            byte_length: USize64::from(self.bytes.len()),
            name: None,
            uri: None,
            extensions: None,
            extras: Default::default(),
        });
        let mut text = self.root.to_vec()?;
        text.resize(text.len().next_multiple_of(4), b' ');
        let size = |n: usize| u32::try_from(n).map(u32::to_le_bytes).map_err(|_| too_large());
        out.write_all(b"glTF")?;
        out.write_all(&2u32.to_le_bytes())?;
        out.write_all(&size(12 + 8 + text.len() + 8 + self.bytes.len())?)?;
        for (kind, chunk) in [(b"JSON", &text), (b"BIN\0", &self.bytes)] {
            out.write_all(&size(chunk.len())?)?;
            out.write_all(kind)?;
            out.write_all(chunk)?;
        }
        Ok(())
    }
}

fn too_large() -> io::Error {
    io::Error::new(io::ErrorKind::InvalidInput, "the motion is too long for one file; export a part of it")
}

/// Eight triangles, counter-clockwise from outside, from one end of a bone to the other.
fn octahedron(from: Vector, to: Vector) -> [[Vector; 3]; 8] {
    let bone = q::subtract(to, from);
    let along = q::direction(bone).unwrap_or([0.0, 1.0, 0.0]);
    let helper = if along[1].abs() < 0.9 { [0.0, 1.0, 0.0] } else { [1.0, 0.0, 0.0] };
    let side = q::direction(q::cross(along, helper)).unwrap_or([1.0, 0.0, 0.0]);
    let other = q::cross(along, side);
    let [place, width] = WIDEST.map(|share| share * q::length(bone));
    let middle = q::add(from, q::scale(along, place));
    let corner = |k: usize| {
        let (a, b) = [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)][k % 4];
        q::add(middle, q::add(q::scale(side, a * width), q::scale(other, b * width)))
    };
    std::array::from_fn(|i| match i {
        0..4 => [corner(i), corner(i + 1), to],
        _ => [corner(i + 1), corner(i), from],
    })
}
