//! The planner at work: how it came to its tokens, and what the reference would have proposed in its place.

use crate::default_model;
use crate::session::Outcome;
use crate::viewer::ShownWord;
use anyhow::Context;
use motionette::generation::tokens::{CONTEXT, Fixed, Planning, SEED_STEP, TokenSampler};
use motionette::numerics::hash::Stream;
use motionette::text::words::{UNKNOWN, Words};
use motionette::{Anchor, Clauses, Model};
use motionette_host::blob::BlobFile;
use motionette_host::checkpoint::TokenizerCheckpoint;
use motionette_host::dataset::captioned::{CaptionedMotion, Place};
use motionette_host::reference::Prior;
use motionette_host::reference::bridge::reference_anchor;
use motionette_host::verify::planner;
use std::path::Path;

/// A prompt as the model read it, and how the planner compares with the reference.
pub struct Compared {
    /// The prompt.
    pub words: Vec<ShownWord>,
    /// Share of positions, of all steps, at which both find the same token most probable.
    pub agreement: f64,
    /// Tokens after each planner step, `[steps][L]`; none where the clause of a position is yet to come, or it is masked.
    pub steps: Vec<Vec<Option<u16>>>,
}

impl Compared {
    /// Words that the model does not know.
    pub fn unknown(&self) -> Vec<String> {
        self.words.iter().filter(|word| !word.known).map(|word| word.text.clone()).collect()
    }
}

/// What a clause was planned in.
struct Window<'o> {
    text: &'o str,
    /// Tokens of the motion before it.
    begin: usize,
    /// Of its tokens, those that come from the clause before.
    context: usize,
    /// Its tokens after each step.
    steps: &'o [Vec<u16>],
}

/// The clauses of a prompt with their windows.
fn windows<'o>(clauses: &Clauses<'o>, steps: &'o [Vec<u16>], each: usize) -> Vec<Window<'o>> {
    let mut known = 0;
    clauses
        .iter()
        .zip(steps.chunks(each.max(1)))
        .map(|(text, steps)| {
            let context = known.min(CONTEXT);
            let begin = known - context;
            known = begin + steps.first().map_or(0, Vec::len);
            Window { text, begin, context, steps }
        })
        .collect()
}

/// The checkpoints that a blob was made from, where they are not the default ones.
#[derive(Clone, Copy)]
pub struct Checkpoints<'c> {
    /// Text encoder and planner.
    pub prior: Option<&'c Path>,
    /// Anchor control.
    pub control: Option<&'c Path>,
}

/// Asks the reference what it would have proposed in the runtime's place, at every step. `anchors` are those that the planner was given.
pub fn compare(
    (prompt, planning): (&str, &Planning<'_>),
    anchors: &[Anchor],
    (blob, tokenizer, checkpoints): (&BlobFile, &TokenizerCheckpoint, Checkpoints<'_>),
    after: &Outcome,
) -> anyhow::Result<Compared> {
    let checkpoint = default_model::prior(checkpoints.prior)?;
    let checkpoint = motionette_host::verify::same_words(blob, checkpoint)?;
    let mut prior = Prior::<f32>::new(&checkpoint, tokenizer);
    if !anchors.is_empty() {
        let control = default_model::control(checkpoints.control)?;
        control.check_prior(&checkpoint, tokenizer).context("matching control and prior")?;
        motionette_host::verify::check_same_control(blob, &control)?;
        prior = prior.controlled(&control, tokenizer.config.fps);
    }
    let model = blob.model()?;
    let sampler = model.planner().context("the blob has no planner")?.sampler();
    let whole = after.steps.len() <= usize::from(planning.steps);
    let clauses = model.text().filter(|_| !whole).map_or(Clauses::whole(prompt), |text| text.clauses(prompt));
    let windows = windows(&clauses, &after.steps, usize::from(planning.steps));
    let codes = prior.planner.codes;
    let (mut same, mut positions) = (0, 0);
    for (number, window) in windows.iter().enumerate() {
        let Some(tokens) = window.steps.last() else { continue };
        let case = CaptionedMotion {
            id: "prompt".into(),
            prompt: window.text.to_owned(),
            words: prior.text.read(window.text)?.ids,
            tokens: tokens.clone(),
            anchors: anchors.iter().map(reference_anchor).collect(),
            place: Place { given: window.context, start_open: window.begin > 0, end_open: number + 1 < windows.len() },
        };
        let guided = case.guided(&prior, 1.0);
        let fixed: Vec<bool> = (0..tokens.len()).map(|position| position < window.context).collect();
        // The first step saw what the sampler begins with behind the tokens that were given, every other one what the step before it left.
        let mut stream = Stream::new(planning.seed.wrapping_add((number as u64).wrapping_mul(SEED_STEP)));
        let given: Vec<Fixed> =
            (0..).zip(&tokens[..window.context]).map(|(position, &token)| Fixed { position, token }).collect();
        let mut first = tokens.clone();
        sampler.begin(&Planning { fixed: &given, ..*planning }, codes, &mut stream, &mut first);
        for (k, tokens) in std::iter::once(&first).chain(window.steps).take(window.steps.len()).enumerate() {
            let time = f64::from(sampler.time(planning, k as u16));
            let (expected, found) =
                (prior.logits(&guided, tokens, time, &fixed), planner::logits(blob, &case, tokens, time)?);
            for (a, b) in expected.chunks_exact(codes).zip(found.chunks_exact(codes)).skip(window.context) {
                same += usize::from(planner::most_probable(a) == planner::most_probable(b));
                positions += 1;
            }
        }
    }
    let agreement = same as f64 / f64::from(positions.max(1));
    Ok(Compared { words: words(&model, prompt), agreement, steps: rows(&windows, after.tokens.len(), codes) })
}

/// The words of a prompt.
fn words(model: &Model<'_>, prompt: &str) -> Vec<ShownWord> {
    let vocabulary = model.text().and_then(|text| text.encoder()).map(|encoder| encoder.vocabulary());
    let known = |word: &_| vocabulary.is_some_and(|vocabulary| vocabulary.id(word) != UNKNOWN);
    Words::new(prompt).map(|word| ShownWord { text: word.as_str().to_owned(), known: known(&word) }).collect()
}

/// The motion's tokens of so many codes after each step of each window.
fn rows(windows: &[Window<'_>], tokens: usize, codes: usize) -> Vec<Vec<Option<u16>>> {
    let mut motion = vec![None; tokens];
    let mut rows = Vec::new();
    for window in windows {
        for step in window.steps {
            let tokens = step.iter().map(|&token| Some(token).filter(|token| usize::from(*token) < codes));
            motion.iter_mut().skip(window.begin).zip(tokens).for_each(|(to, token)| *to = token);
            rows.push(motion.clone());
        }
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn clauses_fill_the_motion_one_behind_the_other() {
        let clauses = Clauses::of("walk, then wave");
        let first = (0..10).collect::<Vec<u16>>();
        let second = [&first[2..], &[20, 21]].concat();
        let steps = [vec![7; 10], first.clone(), second.clone(), second.clone()];
        let windows = windows(&clauses, &steps, 2);
        let places: Vec<_> = windows.iter().map(|w| (w.text, w.begin, w.context, w.steps.len())).collect();
        assert_eq!(places, [("walk", 0, 0, 2), ("wave", 2, 8, 2)]);
        // A token behind the codes is masked, and so there is none.
        assert_eq!(rows(&windows, 12, 21)[2][10..], [Some(20), None]);
        let rows = rows(&windows, 12, 22);
        assert_eq!(rows.len(), 4);
        assert_eq!((rows[0][0], rows[1][9], rows[1][10]), (Some(7), Some(9), None));
        let whole: Vec<_> = first.iter().chain(&[20, 21]).map(|&token| Some(token)).collect();
        assert_eq!((&rows[2], &rows[3]), (&whole, &whole));
    }
}
