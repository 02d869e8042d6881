//! Numbers: angles within a turn, hashes over bits, the seeded random stream.

pub(crate) mod angle;
pub mod hash;
