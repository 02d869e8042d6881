//! Motion tokens to features of the representation: codebooks, and the decoder behind them.

pub mod codebook;
pub mod vq;
