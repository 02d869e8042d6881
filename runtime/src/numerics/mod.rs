//! Numbers: angles within a turn, vectors and rotations, hashes over bits, the seeded random stream.

pub(crate) mod angle;
pub mod hash;
pub(crate) mod rotation;
pub(crate) mod vector;
