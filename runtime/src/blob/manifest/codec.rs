//! Motion tokens to frames.

use super::Reader;
use crate::nn::conv1d::Padding;
use heapless::Vec;
use serde::Serialize;

/// Upsampling stages a decoder may have (temporal factor 2 each).
pub const MAX_STAGES: usize = 3;
/// Residual blocks a stage may have.
pub const MAX_BLOCKS: usize = 4;
/// Convolutions with more than one tap that a decoder may have.
pub const MAX_CONVOLUTIONS: usize = 3 + MAX_STAGES * (MAX_BLOCKS + 1);

/// What makes frames of motion tokens.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub enum Codec {
    /// Codes of vector quantizers, summed, and a convolutional decoder.
    Vq(DecoderConfig),
}

/// Shape of the VQ decoder (EQUATIONS section 6, DESIGN section 3 "Topology").
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct DecoderConfig {
    /// Channels of every hidden layer.
    pub width: u16,
    /// Width of a code, `du`.
    pub code_width: u16,
    /// Codes in a codebook, `V`.
    pub codes: u16,
    /// Residual quantizers whose codes are summed.
    pub quantizers: u8,
    /// Upsampling stages, temporal factor `2^stages`.
    pub stages: u8,
    /// Dilations of a stage's residual blocks in order of execution.
    pub dilations: Vec<u8, MAX_BLOCKS>,
    /// Padding of each convolution with more than one tap, in order of execution.
    pub padding: Vec<Padding, MAX_CONVOLUTIONS>,
    /// Output features, `F`.
    pub features: u16,
}

impl Codec {
    pub(super) fn read(from: &mut Reader<'_>) -> Self {
        from.kind("codec", 1);
        Codec::Vq(DecoderConfig::read(from))
    }

    /// Frames a token.
    #[must_use]
    pub const fn frames_per_token(&self) -> usize {
        let Codec::Vq(decoder) = self;
        decoder.frames_per_token()
    }

    /// Shape of the VQ decoder.
    #[must_use]
    pub const fn decoder(&self) -> &DecoderConfig {
        let Codec::Vq(decoder) = self;
        decoder
    }
}

impl DecoderConfig {
    fn read(from: &mut Reader<'_>) -> Self {
        let (width, code_width, codes) = (from.short(), from.short(), from.short());
        let (quantizers, stages) = (from.byte(), from.byte());
        let count = from.length("codec.dilations", MAX_BLOCKS as u16);
        let mut dilations = Vec::new();
        while dilations.len() < usize::from(count) && dilations.push(from.byte()).is_ok() {}
        let count = from.length("codec.padding", MAX_CONVOLUTIONS as u16);
        let mut padding = Vec::new();
        let mut next = || Padding { left: from.short(), right: from.short() };
        while padding.len() < usize::from(count) && padding.push(next()).is_ok() {}
        DecoderConfig { width, code_width, codes, quantizers, stages, dilations, padding, features: from.short() }
    }

    /// Frames a token, `2^stages`.
    #[must_use]
    pub const fn frames_per_token(&self) -> usize {
        1_usize.wrapping_shl(self.stages as u32)
    }

    /// Dilation of each convolution with more than one tap, all of them three, in order of execution: what [`DecoderConfig::padding`]
    /// stands beside.
    pub fn convolutions(&self) -> impl Iterator<Item = u8> + '_ {
        let stage = || self.dilations.iter().copied().chain([1]);
        let stages = (0..self.stages).flat_map(move |_| stage());
        core::iter::once(1).chain(stages).chain([1, 1])
    }

    /// Symmetrical padding for [`DecoderConfig::convolutions`], as many as there is room for.
    #[must_use]
    pub fn symmetrical(&self) -> Vec<Padding, MAX_CONVOLUTIONS> {
        self.convolutions().map(|dilation| Padding::symmetrical(u16::from(dilation))).take(MAX_CONVOLUTIONS).collect()
    }
}
