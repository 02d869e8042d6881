//! First-order and quasi-Newton steps over plain slices. Nothing here knows of motion, tokens or anchors.

pub mod adam;
pub mod lbfgs;
