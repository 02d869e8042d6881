//! The rows that enter a planner's first block.

use super::transformer::Input;
#[cfg(feature = "masked")]
use crate::blob::Corruption;
use crate::blob::{Error, Guidance, PlannerConfig, Tensors};
use crate::nn::conv1d::larger;
use crate::nn::embedding::{Embedding, add_row};
use crate::nn::linear::Linear;

/// Time embeddings: time `t` takes number `floor(TIMES t)`.
pub const TIMES: u16 = 32;
/// Begin and end of a motion, each whole or open.
const BOUNDARIES: u16 = 4;
/// Rows of the strength of guidance, 0 to 4.
pub const STRENGTHS: u16 = 5;

/// What row 0 is made of beside what the text says, and the rows of tokens.
// There is no heap to put the large variant on.
#[allow(clippy::large_enum_variant)]
#[derive(Debug, Clone, Copy)]
pub enum Inputs<'a> {
    /// Of a planner that is told the time, of noisy tokens or masked ones. Its token embeddings are the weights of its logits.
    Timed(Timed<'a>),
    /// Of one that knows tokens and places alone.
    #[cfg(any(feature = "masked", feature = "autoregressive"))]
    Placed(Placed<'a>),
}

/// Row 0 `+= time[floor(32 t)] + boundary[2 start_open + end_open]`, and where guidance takes one pass
/// `+ (1 - f) guidance[i] + f guidance[i + 1]`, `i + f` the strength of guidance, 0 to 4;
/// row 1 + i `= token[z_i] + position[i] + end[L - 1 - i]` (the last only when the motion ends there) `+ fixed` (only where
/// token i is given). `token[V]` is the row of a masked token.
#[derive(Debug, Clone, Copy)]
pub struct Timed<'a> {
    time: Embedding<'a>,
    boundary: Embedding<'a>,
    position: Embedding<'a>,
    end: Embedding<'a>,
    fixed: Embedding<'a>,
    /// Rows by the strength of guidance, where it takes one pass.
    guidance: Option<Embedding<'a>>,
    /// The row of token V, where tokens are masked.
    #[cfg(feature = "masked")]
    mask: Option<Embedding<'a>>,
}

/// Row 1 + i `= token[z_i] + position[i]`.
#[cfg(any(feature = "masked", feature = "autoregressive"))]
#[derive(Debug, Clone, Copy)]
pub struct Placed<'a> {
    token: Embedding<'a>,
    position: Embedding<'a>,
}

impl<'a> Timed<'a> {
    /// Reads the tables from the next tensors.
    ///
    /// # Errors
    /// Any [`Error`] of a tensor.
    pub fn open(tensors: &mut Tensors<'a>, config: &PlannerConfig) -> Result<Self, Error> {
        let (width, max_tokens) = (config.transformer.width, config.max_tokens);
        let mut table = |rows| Embedding::open(tensors, rows, width);
        let (time, boundary) = (table(TIMES)?, table(BOUNDARIES)?);
        let (position, end, fixed) = (table(max_tokens)?, table(max_tokens)?, table(1)?);
        let guidance = match config.guidance {
            Guidance::TwoPass => None,
            Guidance::OnePass => Some(table(STRENGTHS)?),
        };
        Ok(Timed {
            time,
            boundary,
            position,
            end,
            fixed,
            guidance,
            #[cfg(feature = "masked")]
            mask: match config.corruption {
                Corruption::Near { .. } => None,
                Corruption::Masks => Some(table(1)?),
            },
        })
    }

    /// Adds what token `number` is.
    fn add_token(&self, number: usize, token: &Linear<'_>, row: &mut [f32]) {
        #[cfg(feature = "masked")]
        if let (Some(mask), true) = (&self.mask, number == token.outputs()) {
            return mask.add(0, row);
        }
        add_row(token.row(number), row);
    }

    /// A bound of what a token is.
    fn token_bound(&self, token: &Linear<'_>) -> f32 {
        #[cfg(feature = "masked")]
        if let Some(mask) = &self.mask {
            return larger(token.largest(), mask.bound());
        }
        token.largest()
    }

    fn fill(&self, input: &Input<'_>, text: &[f32], token: &Linear<'_>, x: &mut [f32]) {
        let Input { tokens, time, planning } = *input;
        let mut rows = x.chunks_exact_mut(token.inputs().max(1));
        if let Some(row) = rows.next() {
            begin(text, row);
            let number = (time * f32::from(TIMES)) as usize;
            let last = usize::from(TIMES) - 1;
            self.time.add(if number < last { number } else { last }, row);
            self.boundary.add(2 * usize::from(planning.start_open) + usize::from(planning.end_open), row);
            if let Some(table) = &self.guidance {
                add_strength(table, planning.guidance, row);
            }
        }
        for (i, (number, row)) in tokens.iter().zip(rows).enumerate() {
            row.fill(0.0);
            self.add_token(usize::from(*number), token, row);
            self.position.add(i, row);
            if !planning.end_open {
                self.end.add(tokens.len().saturating_sub(i + 1), row);
            }
            if planning.fixed_at(i).is_some() {
                self.fixed.add(0, row);
            }
        }
    }
}

#[cfg(any(feature = "masked", feature = "autoregressive"))]
impl<'a> Placed<'a> {
    /// Reads the tables from the next tensors.
    ///
    /// # Errors
    /// Any [`Error`] of a tensor.
    pub fn open(tensors: &mut Tensors<'a>, width: u16, tokens: u16, max_tokens: u16) -> Result<Self, Error> {
        let token = Embedding::open(tensors, tokens, width)?;
        Ok(Placed { token, position: Embedding::open(tensors, max_tokens, width)? })
    }

    /// The row of a token at a position.
    pub fn row(&self, token: u16, position: usize, row: &mut [f32]) {
        row.fill(0.0);
        self.token.add(usize::from(token), row);
        self.position.add(position, row);
    }
}

impl Inputs<'_> {
    /// A bound of row 0, without what the text says, and of the others; `token` makes the logits.
    pub(super) fn bounds(&self, token: &Linear<'_>) -> (f32, f32) {
        match self {
            Inputs::Timed(timed) => {
                let guidance = timed.guidance.map_or(0.0, |table| table.bound());
                let others =
                    timed.position.bound() + timed.end.bound() + timed.fixed.bound() + timed.token_bound(token);
                (timed.time.bound() + timed.boundary.bound() + guidance, others)
            }
            #[cfg(any(feature = "masked", feature = "autoregressive"))]
            Inputs::Placed(placed) => (0.0, placed.token.bound() + placed.position.bound()),
        }
    }

    /// Whether the strength of guidance is told to them.
    pub(super) const fn know_guidance(&self) -> bool {
        match self {
            Inputs::Timed(timed) => timed.guidance.is_some(),
            #[cfg(any(feature = "masked", feature = "autoregressive"))]
            Inputs::Placed(_) => false,
        }
    }

    /// Rows `x [1 + L][d]`; the text says `text [d]` to the first.
    pub(super) fn fill(&self, input: &Input<'_>, text: &[f32], token: &Linear<'_>, x: &mut [f32]) {
        match self {
            Inputs::Timed(timed) => timed.fill(input, text, token, x),
            #[cfg(any(feature = "masked", feature = "autoregressive"))]
            Inputs::Placed(placed) => {
                let mut rows = x.chunks_exact_mut(token.inputs().max(1));
                if let Some(row) = rows.next() {
                    begin(text, row);
                }
                for (i, (number, row)) in input.tokens.iter().zip(rows).enumerate() {
                    placed.row(*number, i, row);
                }
            }
        }
    }
}

/// Row 0 begins with what the text says.
pub(super) fn begin(text: &[f32], row: &mut [f32]) {
    for (to, from) in row.iter_mut().zip(text) {
        *to = *from;
    }
}

/// The larger bound of any row.
pub(super) fn largest((first, others): (f32, f32), text: f32) -> f32 {
    larger(others, first + text)
}

/// Adds what stands between two rows of strengths; strengths beyond the table count as its last.
#[inline(never)]
fn add_strength(table: &Embedding<'_>, strength: f32, row: &mut [f32]) {
    let last = usize::from(STRENGTHS) - 1;
    let below = strength as usize;
    let below = if below < last { below } else { last - 1 };
    let share = if strength < last as f32 { strength - below as f32 } else { 1.0 };
    for (place, share) in [(below, 1.0 - share), (below + 1, share)] {
        let (weights, scale) = table.row(place);
        add_row((weights, scale * share), row);
    }
}
