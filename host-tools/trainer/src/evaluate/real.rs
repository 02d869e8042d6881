//! Real motion: what the tables compare with, and how good the judge is.

use std::collections::BTreeMap;
use std::fmt;

use motionette_host::dataset::{Dataset, Split};
use motionette_host::motion::Pose;
use serde::{Deserialize, Serialize};

use super::codec::Codec;
use super::prompt::{MAX_TOKENS, Motion, Prompt, labelled, prompts};
use super::retrieval;
use crate::evaluator::judge::Judge;
use crate::evaluator::{Error, motion};
use crate::random::Random;
use crate::tokenizer::config::{FEATURES, FRAMES_PER_TOKEN};

/// Random candidates of R-precision are drawn this many times for every clip.
const ROUNDS: u64 = 8;
/// Streams of random numbers that join and draw motions.
const STREAM: u64 = 1 << 41;
/// Motions of at most so many tokens are compared apart: 5 s.
pub const SHORT_TOKENS: usize = 25;

/// What the judge says about the labelled clips of one split.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Report {
    /// Number of clips.
    pub clips: usize,
    /// Share whose actor is, or may be, in the training split; null where the dataset does not say.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub known_actor: Option<f64>,
    /// Share whose action is named right.
    pub action_accuracy: f64,
    /// Share whose style is named right, of those that have one; 0 when none has.
    pub style_accuracy: f64,
    /// Mean over the actions of the share of their clips whose action is named right.
    pub mean_action_accuracy: f64,
    /// The same for styles; 0 when no clip has one.
    pub mean_style_accuracy: f64,
    /// R-precision: share whose own sentence is the nearest of 32.
    pub top1: f64,
    /// Among the nearest two.
    pub top2: f64,
    /// Among the nearest three.
    pub top3: f64,
    /// Mean distance of motion and sentence.
    pub mm_dist: f64,
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} clips, action {:.3} (mean over actions {:.3}), style {:.3} (mean over styles {:.3}), \
             R-precision {:.3} {:.3} {:.3}, distance {:.3}",
            self.clips,
            self.action_accuracy,
            self.mean_action_accuracy,
            self.style_accuracy,
            self.mean_style_accuracy,
            self.top1,
            self.top2,
            self.top3,
            self.mm_dist
        )?;
        self.known_actor.map_or(Ok(()), |share| write!(f, ", {:.0} % known actors", 100.0 * share))
    }
}

/// Measures the labelled clips of a split.
///
/// # Errors
/// [`Error::NoMotion`], [`Error::Features`].
pub fn measure(judge: &Judge, dataset: &Dataset, split: Split) -> Result<Report, Error> {
    let prompts = prompts(dataset, split);
    if prompts.is_empty() {
        return Err(Error::NoMotion { split });
    }
    let prepare = |prompt: &Prompt| {
        let clip = dataset.clip(prompt.clip);
        motion::prepare(clip.joints)
            .map_err(|source| Error::Features { name: format!("clip {}", clip.info.id), source })
    };
    let prepared = prompts.iter().map(prepare).collect::<Result<Vec<_>, _>>()?;
    let judgements = judge.motions(&prepared.iter().collect::<Vec<_>>());
    let captions: Vec<&str> = prompts.iter().map(|prompt| prompt.caption.as_str()).collect();
    let texts = judge.texts(&captions);
    let texts: Vec<&[f64]> = texts.iter().map(Vec::as_slice).collect();
    let motions: Vec<&[f64]> = judgements.iter().map(|judgement| judgement.embedding.as_slice()).collect();
    let labels: Vec<usize> = prompts.iter().map(|prompt| prompt.label).collect();
    let mut hits = [0usize; 3];
    for round in 0..ROUNDS {
        for rank in retrieval::ranks(&motions, &texts, &labels, &mut Random::new(0, round)) {
            hits.iter_mut().skip(rank).for_each(|count| *count += 1);
        }
    }
    let clips = prompts.len();
    let pairs = || prompts.iter().zip(&judgements);
    let actions = Shares::of(pairs().map(|(p, judged)| (p.content.as_str(), judged.content)));
    let styles = Shares::of(pairs().filter_map(|(p, judged)| Some((p.style.as_deref()?, judged.style))));
    let [top1, top2, top3] = hits.map(|count| count as f64 / (ROUNDS as usize * clips) as f64);
    let facts = prompts.iter().filter_map(|prompt| dataset.clips[prompt.clip].facts.as_ref());
    let told = facts.clone().count();
    let known = facts.filter(|facts| facts.known_actor).count();
    Ok(Report {
        clips,
        known_actor: (told > 0).then(|| known as f64 / told as f64),
        action_accuracy: actions.whole,
        style_accuracy: styles.whole,
        mean_action_accuracy: actions.mean,
        mean_style_accuracy: styles.mean,
        top1,
        top2,
        top3,
        mm_dist: motions.iter().zip(&texts).map(|(m, t)| retrieval::distance(m, t)).sum::<f64>() / clips as f64,
    })
}

/// Shares of what is named right; 0 of nothing.
struct Shares {
    /// Of all clips.
    whole: f64,
    /// Mean of the shares of every label.
    mean: f64,
}

impl Shares {
    /// Of pairs of the right label and the one that is named.
    fn of<'a>(pairs: impl Iterator<Item = (&'a str, &'a str)>) -> Self {
        let mut labels: BTreeMap<&str, [usize; 2]> = BTreeMap::new();
        for (label, named) in pairs {
            let [right, clips] = labels.entry(label).or_default();
            *right += usize::from(label == named);
            *clips += 1;
        }
        let share = |right: usize, clips: usize| right as f64 / clips.max(1) as f64;
        let sum = |of: fn(&[usize; 2]) -> usize| labels.values().map(of).sum();
        let mean = labels.values().map(|[right, clips]| share(*right, *clips)).sum::<f64>();
        Self { whole: share(sum(|l| l[0]), sum(|l| l[1])), mean: mean / labels.len().max(1) as f64 }
    }
}

/// The prompts' own clips, as long as the prompts say: cut, or with clips of the same label and split appended.
pub fn motions(dataset: &Dataset, prompts: &[Prompt], codec: &Codec) -> Result<Vec<Motion>, Error> {
    let own = |(index, prompt): (usize, &Prompt)| {
        let split = dataset.clips[prompt.clip].split;
        let others = Candidates::new(dataset, split, prompt);
        real(dataset, prompt, prompt.clip, &others, &mut Random::new(1, STREAM + index as u64), codec)
    };
    prompts.iter().enumerate().map(own).collect()
}

/// Other motions of the prompts' labels: clips of the training split, drawn anew for every seed.
///
/// Clips are taken on the prompt's side of 5 s where there are any. Where the split lacks the label, the action alone must agree, and
/// where it lacks that, any clip is taken.
pub fn resampled(dataset: &Dataset, prompts: &[Prompt], seed: u64, codec: &Codec) -> Result<Vec<Motion>, Error> {
    let draw = |(index, prompt): (usize, &Prompt)| {
        let others = Candidates::new(dataset, Split::Train, prompt);
        let random = &mut Random::new(seed, 2 * STREAM + index as u64);
        let first = others.draw(random).ok_or(Error::NoMotion { split: Split::Train })?;
        real(dataset, prompt, first, &others, random, codec)
    };
    prompts.iter().enumerate().map(draw).collect()
}

/// Clip `first`, and if it is shorter than the prompt says, `others` behind it. A drawn clip that is longer keeps its length up to
/// 49 tokens.
fn real(
    dataset: &Dataset,
    prompt: &Prompt,
    first: usize,
    others: &Candidates,
    random: &mut Random,
    codec: &Codec,
) -> Result<Motion, Error> {
    let clip = dataset.clip(first);
    let tokens = match prompt.tokens {
        MAX_TOKENS => MAX_TOKENS,
        _ => (clip.frames() / FRAMES_PER_TOKEN).min(MAX_TOKENS),
    };
    let frames = tokens * FRAMES_PER_TOKEN;
    if clip.frames() >= frames {
        let tokens = codec.encode(&clip.features[..frames * FEATURES]);
        return Ok(Motion { joints: clip.joints[..frames].to_vec(), tokens });
    }
    // Features have one row fewer than there are frames.
    let mut joints: Vec<Pose> =
        motion::grown(clip.joints, frames + 1, || dataset.clip(others.draw(random).unwrap_or(first)).joints);
    let prepared = motion::prepare(&joints)
        .map_err(|source| Error::Features { name: format!("clip {} with others", clip.info.id), source })?;
    joints.truncate(frames);
    Ok(Motion { joints, tokens: codec.encode(&prepared.features) })
}

/// Clips that can stand for a prompt's.
struct Candidates {
    clips: Vec<usize>,
}

impl Candidates {
    fn new(dataset: &Dataset, split: Split, prompt: &Prompt) -> Self {
        let all = labelled(dataset, split);
        let own = dataset.clips[prompt.clip].label();
        let action = |place: &usize| dataset.clips[*place].action() == Some(&prompt.content);
        let label = |place: &usize| dataset.clips[*place].label() == own;
        let short = dataset.clip(prompt.clip).frames() <= SHORT_TOKENS * FRAMES_PER_TOKEN;
        let side = |place: &usize| (dataset.clip(*place).frames() <= SHORT_TOKENS * FRAMES_PER_TOKEN) == short;
        let choose = |fits: &dyn Fn(&usize) -> bool| -> Vec<usize> {
            all.iter().map(|(place, _)| *place).filter(|place| fits(place)).collect()
        };
        let tests: [&dyn Fn(&usize) -> bool; 5] =
            [&|p| label(p) && side(p), &label, &|p| action(p) && side(p), &action, &|_| true];
        let clips = tests.into_iter().map(choose).find(|clips| !clips.is_empty()).unwrap_or_default();
        Self { clips }
    }

    fn draw(&self, random: &mut Random) -> Option<usize> {
        self.clips.get(random.below(self.clips.len())).copied()
    }
}
