//! Limbs of two bones.

use super::Vector;

/// Middle and end of a limb of two bones whose end is put at `target`, or as near as it reaches.
pub fn reach([root, middle, end]: [Vector; 3], target: Vector, pole: Vector) -> (Vector, Vector) {
    let (upper, lower) = ((middle - root).norm(), (end - middle).norm());
    let had = (end - root).norm();
    let most = (0.9995 * (upper + lower)).max(had);
    let least = ((upper - lower).abs() + 0.02).min(had);
    let from = if had > 1e-6 { (end - root) / had } else { -Vector::y() };
    let wanted = (target - root).norm();
    let to = if wanted > 1e-6 { (target - root) / wanted } else { from };
    let reach = wanted.min(most).max(least);
    let along = (upper * upper - lower * lower + reach * reach) / (2.0 * reach);
    let across = (upper * upper - along * along).max(0.0).sqrt();
    let side = middle - root + pole;
    let side = side - from * side.dot(&from);
    let side = side - (from + to) * (side.dot(&to) / (1.0 + from.dot(&to) + 1e-6));
    let side = side - to * side.dot(&to);
    let other = if to.x.abs() < 0.7 { Vector::x() } else { Vector::z() };
    let side = if side.norm() > 1e-6 { side.normalize() } else { to.cross(&other).normalize() };
    (root + to * along + side * across, root + to * reach)
}

/// Middle and end of a limb whose middle is turned towards `target` about its root; the end stays as near as it can.
pub fn bend([root, middle, end]: [Vector; 3], target: Vector) -> (Vector, Vector) {
    let turned = |direction: Vector, bone: Vector| {
        if direction.norm() > 1e-6 { direction.normalize() * bone.norm() } else { bone }
    };
    let at = root + turned(target - root, middle - root);
    (at, at + turned(end - at, end - middle))
}
