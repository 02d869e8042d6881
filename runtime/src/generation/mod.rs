//! Motion from nothing: each family of generators has a room.
//!
//! - [`tokens`]: motion tokens, drawn step by step from a network's logits; a codec makes motion of them.

pub mod tokens;
