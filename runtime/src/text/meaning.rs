//! What a prompt was understood as: of the phrases that the model was taught, the likeliest.
//!
//! `p_i = 1 / (1 + exp(-(w_i pooled + b_i)))`, one for each phrase; phrases of actions come before those of styles.

use super::words::Vocabulary;
use crate::blob::{Error, MAX_BANK, PhraseBank, Tensors};
use crate::nn::block::BlockScratch;
use crate::nn::exp::exp;
use crate::nn::linear::Linear;

/// Likeliest actions that are named.
pub const NEAREST: usize = 3;
/// A style is named from this probability on.
const STYLED: f32 = 0.5;

/// The phrases of a blob.
#[derive(Debug, Clone, Copy)]
pub struct Meanings<'a> {
    phrases: Vocabulary<'a>,
    actions: usize,
    threshold: f32,
    head: Linear<'a>,
}

/// A phrase of the model with its probability.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Guess {
    /// Number of the phrase: [`crate::Model::phrase`] says it.
    pub phrase: u16,
    /// How likely the prompt means it, 0 to 1.
    pub score: f32,
}

/// What a prompt was understood as.
#[derive(Debug, Clone, Copy, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Understood {
    /// The likeliest actions, the first of them first; behind the last that the model knows [`Guess::NONE`].
    pub actions: [Guess; NEAREST],
    /// The style, where one is likely.
    pub style: Option<Guess>,
    /// Whether the first action is likely enough to be what was meant; otherwise the model has hardly learnt what was asked for.
    pub sure: bool,
}

impl Guess {
    /// No phrase at all.
    pub const NONE: Self = Guess { phrase: u16::MAX, score: 0.0 };
}

impl<'a> Meanings<'a> {
    /// Reads the layer of the phrases from the next tensors; `None` for a bank without phrases.
    ///
    /// # Errors
    /// Any [`Error`] of a tensor; [`Error::Config`] of a count.
    pub fn open(tensors: &mut Tensors<'a>, bank: &PhraseBank<'a>, width: u16) -> Result<Option<Self>, Error> {
        let PhraseBank::Meanings { phrases, actions, threshold, .. } = *bank else { return Ok(None) };
        let phrases = Vocabulary::new(phrases);
        let found = u32::try_from(phrases.len()).unwrap_or(u32::MAX);
        if found == 0 || found > MAX_BANK as u32 {
            return Err(Error::Config { what: "text.bank.phrases", found, limit: MAX_BANK as u32 });
        }
        if actions == 0 || u32::from(actions) > found {
            return Err(Error::Config { what: "text.bank.actions", found: u32::from(actions), limit: found });
        }
        let head = Linear::open(tensors, width, found as u16)?;
        Ok(Some(Meanings { phrases, actions: usize::from(actions), threshold, head }))
    }

    /// Phrases there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.head.outputs()
    }

    /// Whether there are none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The layer: pooled vector to a logit a phrase.
    #[must_use]
    pub const fn head(&self) -> &Linear<'a> {
        &self.head
    }

    /// The phrase of that number.
    #[must_use]
    pub fn phrase(&self, number: u16) -> Option<&'a str> {
        let phrase = self.phrases.entries().nth(usize::from(number))?;
        core::str::from_utf8(phrase).ok()
    }

    /// What a prompt with this pooled vector was understood as; works in `logits`, of which there is one a phrase.
    pub fn understand(&self, pooled: &[f32], logits: &mut [f32], scratch: &mut BlockScratch<'_>) -> Understood {
        scratch.linear(&self.head, pooled, logits);
        let mut nearest = [Guess::NONE; NEAREST];
        let mut style = Guess::NONE;
        for (phrase, logit) in logits.iter().enumerate() {
            let guess = Guess { phrase: u16::try_from(phrase).unwrap_or(u16::MAX), score: sigmoid(*logit) };
            if phrase < self.actions {
                insert(&mut nearest, guess);
            } else if guess.score > style.score {
                style = guess;
            }
        }
        let sure = nearest.first().is_some_and(|first| first.score >= self.threshold);
        Understood { actions: nearest, style: (style.score >= STYLED).then_some(style), sure }
    }
}

impl Understood {
    /// The likeliest action.
    #[must_use]
    pub const fn action(&self) -> Guess {
        let [first, ..] = self.actions;
        first
    }
}

/// Puts a guess where it belongs among those that are likelier; of two that are as likely the first stays before.
fn insert(nearest: &mut [Guess; NEAREST], mut guess: Guess) {
    for place in nearest {
        if guess.score > place.score || place.phrase == Guess::NONE.phrase {
            core::mem::swap(place, &mut guess);
        }
    }
}

fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + exp(-x))
}
