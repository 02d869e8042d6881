//! A motion that goes on: tokens come in segments, frames come out as they become final.

use super::observer::{Stage, Watch};
use super::{Error, Generator, Observer};
use crate::JOINTS;
use crate::arena::{Arena, ArenaTooSmall};
use crate::decoding::codebook::Codebooks;
use crate::decoding::decoder::Interrupted;
use crate::decoding::stream::{self, CHUNK};
use crate::model::Model;
use crate::motion::humanml3d::{Features, POSITION_CHANNELS, Path, Root, channels};
use crate::plan::{JOINT_COLUMNS, StreamLimits, StreamPlan};
use crate::refining::Stop;

/// A frame: the position of each joint, metres.
pub type Frame = [[f32; 3]; JOINTS];

/// A running motion of any length, in the generator's arena.
///
/// Tokens are queued by [`MotionStream::push`]; [`MotionStream::frames`] takes them through the decoder, a few at
/// a time, and hands out the frames that have become final: the same bits, in the same frame of reference, as
/// [`Generator::generate`] would give for all tokens at once. The output lags behind the tokens by the decoder's radius
/// ([`StreamPlan::latency_frames`]); the rest comes after [`MotionStream::finish`].
#[derive(Debug)]
pub struct MotionStream<'g, 'a> {
    model: &'g Model<'a>,
    decoder: stream::Stream<'g>,
    /// The last tokens, oldest first; those at the end have not been decoded yet.
    tokens: &'g mut [u16],
    path: Path<'g>,
    /// `[n][22][3]`
    joints: &'g mut [f32],
    root: Root,
    /// Tokens that have come, of those in `tokens`.
    known: usize,
    /// Tokens that have not been decoded.
    queued: usize,
    /// Tokens of the chunk in work, the first of the queued ones.
    chunk: usize,
    /// Frames of decoded tokens that have not become final.
    held: usize,
    finished: bool,
}

impl<'a> Generator<'a> {
    /// Begins a motion that is made piece by piece. It starts at the origin facing +z, as any other does.
    ///
    /// # Errors
    /// [`Error::Arena`], and [`Error::Tokens`] when no token fits `limits`.
    pub fn stream(&mut self, limits: &StreamLimits) -> Result<MotionStream<'_, 'a>, Error> {
        let model = &self.model;
        let decoder = model.decoder();
        if limits.tokens == 0 || limits.tokens > model.max_tokens() {
            return Err(Error::Tokens { found: limits.tokens, limit: model.max_tokens() });
        }
        let mut arena = Arena::new(self.arena);
        let too_small =
            |e: ArenaTooSmall| Error::Arena(ArenaTooSmall { needed: StreamPlan::new(model, limits).arena_bytes, ..e });
        let tokens = arena.take(limits.tokens * model.codebooks().quantizers()).map_err(too_small)?;
        let frames = CHUNK * model.frames_per_token();
        let mut take = |count| arena.take::<f32>(count).map_err(too_small);
        let path = Path {
            cos: take(frames)?,
            sin: take(frames)?,
            x: take(frames)?,
            z: take(frames)?,
            d_angle: &mut [],
            d_x: &mut [],
            d_z: &mut [],
        };
        let joints = take(frames * JOINT_COLUMNS)?;
        let decoder = decoder.stream(&mut arena, POSITION_CHANNELS).map_err(too_small)?;
        Ok(MotionStream {
            model,
            decoder,
            tokens,
            path,
            joints,
            root: Root::default(),
            known: 0,
            queued: 0,
            chunk: 0,
            held: 0,
            finished: false,
        })
    }
}

impl MotionStream<'_, '_> {
    /// Tokens that can be queued now.
    #[must_use]
    pub fn room(&self) -> usize {
        let capacity = self.tokens.len() / self.model.codebooks().quantizers().max(1);
        if self.finished { 0 } else { capacity.saturating_sub(self.queued) }
    }

    /// Frames that [`MotionStream::frames`] can hand out before it needs more tokens.
    #[must_use]
    pub fn frames_ahead(&self) -> usize {
        let frames = self.queued * self.model.frames_per_token() + self.held;
        if self.finished { frames } else { frames.saturating_sub(self.model.decoder().radius_frames()) }
    }

    /// Moves the origin below the root of the next frame, leaving the axes as they are: far from the origin an f32
    /// resolves less (0.06 mm at 1 km), so a motion that walks for hours should do this now and then. Returns where the
    /// new origin lies in the old frame, `[x, z]`, metres.
    pub const fn rebase(&mut self) -> [f32; 2] {
        self.root.rebase()
    }

    /// Queues tokens, `[n][Q]` for `Q` quantizers. All of them or, with an error, none.
    ///
    /// # Errors
    /// [`Error::Finished`], [`Error::QueueFull`], [`Error::Tokens`] for an incomplete position,
    /// [`Error::TokenOutOfRange`].
    pub fn push(&mut self, tokens: &[u16]) -> Result<(), Error> {
        let codebooks = self.model.codebooks();
        let quantizers = codebooks.quantizers().max(1);
        let count = tokens.len() / quantizers;
        if self.finished {
            return Err(Error::Finished);
        }
        if !tokens.len().is_multiple_of(quantizers) {
            return Err(Error::Tokens { found: tokens.len(), limit: self.model.max_tokens() });
        }
        if count > self.room() {
            return Err(Error::QueueFull { found: count, room: self.room() });
        }
        let known = |&token: &u16| usize::from(token) < codebooks.codes() || token == Codebooks::NONE;
        if let Some((index, &token)) = tokens.iter().enumerate().find(|(_, token)| !known(token)) {
            return Err(Error::TokenOutOfRange { index, token, codes: codebooks.codes() as u16 });
        }
        // The oldest tokens make room for the new ones.
        let forget = (self.known * quantizers + tokens.len()).saturating_sub(self.tokens.len());
        let kept = (self.known * quantizers).saturating_sub(forget);
        for at in 0..kept {
            if let Some(&token) = self.tokens.get(at + forget)
                && let Some(to) = self.tokens.get_mut(at)
            {
                *to = token;
            }
        }
        for (to, from) in self.tokens.iter_mut().skip(kept).zip(tokens) {
            *to = *from;
        }
        self.known = kept / quantizers + count;
        self.queued += count;
        Ok(())
    }

    /// Says that the motion ends with the tokens queued so far; [`MotionStream::frames`] hands out the rest of it.
    pub const fn finish(&mut self) {
        self.finished = true;
    }

    /// Takes the next few tokens through the decoder and hands out the frames that have become final, at most
    /// [`StreamPlan::frames`] of them and perhaps none. `None`: all tokens have been decoded; after
    /// [`MotionStream::finish`] also all frames handed out.
    ///
    /// The observer is asked before every layer. [`Flow::Finish`](super::Flow::Finish) is granted by carrying on, since a
    /// chunk ends soon.
    ///
    /// # Errors
    /// [`Error::Aborted`] when the observer says so. Nothing is lost: the next call carries on where this one stopped.
    pub fn frames(&mut self, observer: &mut impl Observer) -> Result<Option<&[Frame]>, Error> {
        let decoder = self.model.decoder();
        let codebooks = self.model.codebooks();
        if !self.decoder.waiting() {
            self.chunk = self.queued.min(CHUNK);
            let rows = self.decoder.begin(decoder, self.chunk);
            let first = self.known.saturating_sub(self.queued) * codebooks.quantizers();
            let tokens = self.tokens.get(first..first + self.chunk * codebooks.quantizers()).unwrap_or(&[]);
            codebooks.embed(tokens, rows)?;
            if self.chunk == 0 {
                if !self.finished {
                    return Ok(None);
                }
                self.decoder.end();
                if self.decoder.ended() {
                    return Ok(None);
                }
            }
        }
        let mut watch = Watch { observer, stage: Stage::Decoding, evaluation: 1, evaluations: 1 };
        let mut check = || match watch.ask() {
            Err(Stop::Abort) => Err(Interrupted),
            Ok(()) | Err(Stop::Finish) => Ok(()),
        };
        let all = channels(u32::MAX);
        let values = self.decoder.advance(decoder, &all, &mut check).map_err(|Interrupted| Error::Aborted)?;
        let frames = values.len() / all.count().max(1);
        self.queued -= self.chunk;
        self.held = (self.held + self.chunk * self.model.frames_per_token()).saturating_sub(frames);

        let features = Features { values, channels: &all, mean: self.model.mean(), std: self.model.std() };
        features.integrate_from(&mut self.root, &mut self.path);
        let joints = self.joints.get_mut(..frames * JOINT_COLUMNS).unwrap_or(&mut []);
        features.joints(&self.path, joints);
        Ok(Some(bytemuck::try_cast_slice(joints).unwrap_or(&[])))
    }
}
