//! Tokens to motion features: codebooks and the convolutional VQ decoder, whole with the gradient back to the
//! embeddings, or in segments.

mod chain;
pub mod codebook;
pub mod decoder;
mod layer;
mod step;
pub mod stream;
