//! Between the reference's types and the runtime's: tokens and anchors. Types only; no number is computed here but by rounding.

use motionette::codec::codebook::Codebooks;
use motionette::{Anchor as RuntimeAnchor, Target as RuntimeTarget};

use super::{Anchor, Target};

/// A reference id as the runtime's token; what is no code (-1) adds nothing there either.
#[must_use]
pub fn runtime_token(id: i64) -> u16 {
    u16::try_from(id).unwrap_or(Codebooks::NONE)
}

/// The runtime's form of an anchor; coordinates rounded to f32.
#[must_use]
pub fn runtime_anchor(anchor: &Anchor) -> RuntimeAnchor {
    let f32s = |p: [f64; 3]| p.map(|v| v as f32);
    let target = match anchor.target {
        Target::Root(p) => RuntimeTarget::Root(f32s(p)),
        Target::PlanarRoot([x, z]) => RuntimeTarget::PlanarRoot([x as f32, z as f32]),
        Target::Joint { joint, position } => RuntimeTarget::Joint { joint: joint as u8, position: f32s(position) },
    };
    RuntimeAnchor { frame: anchor.frame as u16, target }
}

/// The runtime's form of anchors, in their order.
#[must_use]
pub fn runtime_anchors(anchors: &[Anchor]) -> Vec<RuntimeAnchor> {
    anchors.iter().map(runtime_anchor).collect()
}

/// The reference's form of an anchor.
#[must_use]
pub fn reference_anchor(anchor: &RuntimeAnchor) -> Anchor {
    let target = match anchor.target {
        RuntimeTarget::Root(p) => Target::Root(p.map(f64::from)),
        RuntimeTarget::PlanarRoot(p) => Target::PlanarRoot(p.map(f64::from)),
        RuntimeTarget::Joint { joint, position } => {
            Target::Joint { joint: usize::from(joint), position: position.map(f64::from) }
        }
    };
    Anchor { frame: usize::from(anchor.frame), target }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn anchors_survive_the_way_there_and_back() {
        let given = [
            RuntimeAnchor::root(7, [0.1, 0.9, -2.5]),
            RuntimeAnchor::planar_root(0, [-0.3, 4.0]),
            RuntimeAnchor::joint(195, 21, [0.2, 1.5, 0.75]),
        ];
        for anchor in given {
            assert_eq!(runtime_anchor(&reference_anchor(&anchor)), anchor);
        }
    }
}
