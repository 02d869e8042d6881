//! Numbers: angles within a turn, vectors, rotations and solid bodies, hashes over bits, the seeded random stream.

pub(crate) mod angle;
pub mod hash;
pub(crate) mod rotation;
pub mod solid;
pub(crate) mod vector;
