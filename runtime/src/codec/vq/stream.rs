//! Decoding a motion in segments, with the bits of `Decoder::forward` over the whole of it. The output lags by
//! [`Decoder::radius_frames`].

use super::chain::Chain;
use super::decoder::{ChunkShape, Decoder};
use super::layer::{Direction, Layer};
use super::step::ReluMask;
use crate::channels::Channels;
use crate::memory::{Arena, ArenaTooSmall};
use crate::nn::mask;
use crate::stop::{Check, Stop};
use core::ops::ControlFlow;

/// Tokens that pass through the decoder at a time, at most: weights are read once for so many.
pub const CHUNK: usize = 4;
/// All its rows are multiplied together in most layers.
const CHUNK_SHAPE: ChunkShape = ChunkShape { tokens: CHUNK, rows: 24 };

/// A motion being decoded. Its size depends on the decoder alone.
#[derive(Debug)]
pub struct Stream<'w> {
    chain: Chain<'w>,
    /// Of ReLUs; nobody reads them.
    gates: ReluMask<'w>,
}

impl<'a> Decoder<'a> {
    /// Frames by which the output lags behind the tokens: frame `t` is final when `(t + 1 + radius) / upsampling`
    /// tokens, rounded up, have come. For one motion the first frame comes with token [`Decoder::radius_tokens`], the
    /// token that the frame belongs to counted.
    #[must_use]
    pub fn radius_frames(&self) -> usize {
        self.layers().fold(0, |lag, (_, layer)| {
            let doubled = if let Layer::Upsample(_) = layer { lag } else { 0 };
            lag + doubled + layer.ahead(Direction::Forward)
        })
    }

    /// The same in tokens, rounded up: a token may change the frames of so many tokens before it.
    #[must_use]
    pub fn radius_tokens(&self) -> usize {
        self.radius_frames().div_ceil(self.upsampling().max(1))
    }

    /// Multiply-accumulates of one token that comes in chunks of `tokens`, between the ends of the motion; rounded up. A
    /// motion's ends cost nothing in addition.
    #[must_use]
    pub fn stream_macs(&self, tokens: usize, channels: &Channels) -> u64 {
        self.token_macs(channels) + self.chunk_macs().div_ceil(if tokens == 0 { 1 } else { tokens as u64 })
    }

    /// Arena bytes of what [`Decoder::stream`] keeps from chunk to chunk.
    #[must_use]
    pub fn tail_bytes(&self) -> usize {
        self.tails_bytes(Direction::Forward)
    }

    fn stream_gates(&self) -> usize {
        CHUNK * self.upsampling() * mask::words(self.width)
    }

    /// Arena bytes of [`Decoder::stream`] in all.
    #[must_use]
    pub fn stream_bytes(&self, channels: usize) -> usize {
        Arena::measure(|arena| self.stream(arena, channels))
    }

    /// Takes the buffers for a motion of any length with at most `channels` output channels, before its first token.
    ///
    /// # Errors
    /// [`ArenaTooSmall`].
    pub fn stream<'w>(&self, arena: &mut Arena<'w>, channels: usize) -> Result<Stream<'w>, ArenaTooSmall> {
        let chain = self.chain(arena, Direction::Forward, CHUNK_SHAPE, channels)?;
        let (bits, words) = (arena.take(self.stream_gates())?, mask::words(self.width));
        Ok(Stream { chain, gates: ReluMask { bits, words, kept: None } })
    }
}

impl Stream<'_> {
    /// The rows `[tokens][du]` that the next chunk is to be written to, at most [`CHUNK`]. Empty while a chunk
    /// that was interrupted waits to be carried on, and when the motion has ended.
    pub fn begin(&mut self, decoder: &Decoder<'_>, tokens: usize) -> &mut [f32] {
        self.chain.begin(decoder, tokens)
    }

    /// Says that no tokens will come any more: each [`Stream::advance`] from now on brings the rest of the motion nearer.
    /// A chunk that waits is still part of it.
    pub const fn end(&mut self) {
        self.chain.end();
    }

    /// Whether a chunk waits to be carried on.
    #[must_use]
    pub const fn waiting(&self) -> bool {
        self.chain.waiting()
    }

    /// Whether the whole motion has come out.
    #[must_use]
    pub const fn ended(&self) -> bool {
        self.chain.ended()
    }

    /// Passes the chunk through the decoder. Returns the frames that have become final, normalised features `[n][C]`, at
    /// most [`CHUNK`] times the upsampling; none is an answer as good as any.
    ///
    /// `channels` must be the same from the first chunk to the last.
    ///
    /// Breaks off when `check`, asked before every layer, says so. Nothing is lost: the next call carries on there.
    pub fn advance(
        &mut self,
        decoder: &Decoder<'_>,
        channels: &Channels,
        check: Check<'_>,
    ) -> ControlFlow<Stop, &mut [f32]> {
        self.chain.pass(decoder, channels, &mut self.gates, check)
    }
}
