//! Layers over quantised rows: forward, and input gradient where the solver needs it.
//!
//! Layout is channels-last: a sequence is `[rows][channels]`. A layer quantises its input rows to int16 with one
//! dynamic scale a row, multiplies in integers, and writes f32 rows.

pub mod activation;
pub mod attention;
pub mod block;
pub mod conv1d;
pub mod embedding;
pub mod encoder;
mod epilogue;
pub mod exp;
pub mod linear;
pub mod mask;
pub mod norm;
pub mod output;
pub mod quantise;
pub mod residual;
pub mod softmax;
mod sums;
