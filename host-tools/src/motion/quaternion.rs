//! Unit quaternions `[w, x, y, z]` in f64, Hamilton product, active rotation of column vectors.
//!
//! Why not a library: these sums are the features of every dataset, and their order is part of the datasets' hashes. With nalgebra's
//! quaternions 1,358 of the 75.5 million features of the motion-capture pack change, with glam's 1,673, by 6e-8 at most: too little
//! to matter to anyone, and enough for another hash than the one that the shipped checkpoints name.

/// A vector of three.
pub type Vector = [f64; 3];
/// A quaternion `[w, x, y, z]`.
pub type Quaternion = [f64; 4];

/// The rotation that changes nothing.
pub const IDENTITY: Quaternion = [1.0, 0.0, 0.0, 0.0];

/// `a - b`.
pub fn subtract(a: Vector, b: Vector) -> Vector {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// `a + b`.
pub fn add(a: Vector, b: Vector) -> Vector {
    [a[0] + b[0], a[1] + b[1], a[2] + b[2]]
}

/// `s a`.
pub fn scale(a: Vector, s: f64) -> Vector {
    [a[0] * s, a[1] * s, a[2] * s]
}

/// Scalar product.
pub fn dot(a: Vector, b: Vector) -> f64 {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Vector product.
pub fn cross(a: Vector, b: Vector) -> Vector {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

/// Euclidean length.
pub fn length(a: Vector) -> f64 {
    dot(a, a).sqrt()
}

/// The vector of length one, or `None` when it has no direction (shorter than 1e-9).
pub fn direction(a: Vector) -> Option<Vector> {
    let n = length(a);
    (n > 1e-9).then(|| scale(a, 1.0 / n))
}

/// Hamilton product: first `b`, then `a`.
pub fn multiply(a: Quaternion, b: Quaternion) -> Quaternion {
    [
        a[0] * b[0] - a[1] * b[1] - a[2] * b[2] - a[3] * b[3],
        a[0] * b[1] + a[1] * b[0] + a[2] * b[3] - a[3] * b[2],
        a[0] * b[2] - a[1] * b[3] + a[2] * b[0] + a[3] * b[1],
        a[0] * b[3] + a[1] * b[2] - a[2] * b[1] + a[3] * b[0],
    ]
}

/// Inverse of a unit quaternion.
pub fn inverse(q: Quaternion) -> Quaternion {
    [q[0], -q[1], -q[2], -q[3]]
}

/// Rotates a vector: `q v q^-1`.
pub fn rotate(q: Quaternion, v: Vector) -> Vector {
    let axis = [q[1], q[2], q[3]];
    let t = scale(cross(axis, v), 2.0);
    add(add(v, scale(t, q[0])), cross(axis, t))
}

/// `q / |q|`; identity for a quaternion without a direction.
pub fn normalise(q: Quaternion) -> Quaternion {
    let n = (q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3]).sqrt();
    if n > 1e-12 { q.map(|x| x / n) } else { IDENTITY }
}

/// The shortest rotation that takes unit vector `from` to unit vector `to`.
///
/// For opposite vectors any half turn across `from` is shortest; the one whose axis is `from x` the coordinate axis it is furthest
/// from is taken (HumanML3D's own formula has no answer there).
pub fn between(from: Vector, to: Vector) -> Quaternion {
    let w = 1.0 + dot(from, to);
    if w < 1e-9 {
        let smallest = (0..3).min_by(|&a, &b| from[a].abs().total_cmp(&from[b].abs())).unwrap_or(0);
        let mut other = [0.0; 3];
        other[smallest] = 1.0;
        let axis = cross(from, other);
        return normalise([0.0, axis[0], axis[1], axis[2]]);
    }
    let v = cross(from, to);
    normalise([w, v[0], v[1], v[2]])
}

/// Rotation by `angle` radians about a unit axis.
pub fn about(axis: Vector, angle: f64) -> Quaternion {
    let (sin, cos) = (angle / 2.0).sin_cos();
    [cos, axis[0] * sin, axis[1] * sin, axis[2] * sin]
}

/// First two columns of the rotation matrix, one after the other: the continuous 6-D form.
pub fn to_6d(q: Quaternion) -> [f64; 6] {
    let x = rotate(q, [1.0, 0.0, 0.0]);
    let y = rotate(q, [0.0, 1.0, 0.0]);
    [x[0], x[1], x[2], y[0], y[1], y[2]]
}

/// The rotation of a 6-D form: the first column made a unit vector, the second made perpendicular to it. `None` when they do not span a plane.
pub fn from_6d(d: [f64; 6]) -> Option<Quaternion> {
    let x = direction([d[0], d[1], d[2]])?;
    let z = direction(cross(x, [d[3], d[4], d[5]]))?;
    Some(from_columns(x, cross(z, x), z))
}

/// The rotation whose matrix has these orthonormal columns. The largest component is computed first, so no division is by a small number.
pub fn from_columns(x: Vector, y: Vector, z: Vector) -> Quaternion {
    let (xx, yy, zz) = (x[0], y[1], z[2]);
    let squares = [1.0 + xx + yy + zz, 1.0 + xx - yy - zz, 1.0 - xx + yy - zz, 1.0 - xx - yy + zz];
    let largest = (0..4).max_by(|&a, &b| squares[a].total_cmp(&squares[b])).unwrap_or(0);
    let (wx, wy, wz) = (y[2] - z[1], z[0] - x[2], x[1] - y[0]);
    let (xy, xz, yz) = (x[1] + y[0], z[0] + x[2], y[2] + z[1]);
    let s = squares[largest];
    normalise(match largest {
        0 => [s, wx, wy, wz],
        1 => [wx, s, xy, xz],
        2 => [wy, xy, s, yz],
        _ => [wz, xz, yz, s],
    })
}

/// Spherical interpolation along the shorter arc, `t` in 0..=1.
pub fn slerp(a: Quaternion, b: Quaternion, t: f64) -> Quaternion {
    let mut cos: f64 = (0..4).map(|i| a[i] * b[i]).sum();
    let sign = if cos < 0.0 { -1.0 } else { 1.0 };
    cos *= sign;
    let (wa, wb) = if cos > 1.0 - 1e-9 {
        (1.0 - t, t)
    } else {
        let angle = cos.acos();
        (((1.0 - t) * angle).sin() / angle.sin(), (t * angle).sin() / angle.sin())
    };
    normalise(std::array::from_fn(|i| wa * a[i] + wb * sign * b[i]))
}
