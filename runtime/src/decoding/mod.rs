//! Tokens to motion features: codebooks and the convolutional VQ decoder, with the gradient back to the embeddings.

pub mod codebook;
pub mod decoder;
