//! The convolutional decoder of VQ and residual VQ: whole with the gradient back to the embeddings, or in segments with the same bits.

mod chain;
pub mod decoder;
mod layer;
mod step;
pub mod stream;
