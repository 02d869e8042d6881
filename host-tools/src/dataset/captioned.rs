//! Clips with captions as a planner sees them: words, tokens and, if asked for, anchors where the clip itself passes.

use motionette::numerics::hash::Stream;

use super::{ClipView, Dataset, Split};
use crate::checkpoint::TokenizerCheckpoint;
use crate::motion::{JOINTS, Pose};
use crate::reference::bridge::runtime_token;
use crate::reference::prior::Guided;
use crate::reference::tokenizer::EncodeError;
use crate::reference::{Anchor, Prior, Target, Tokenizer};

/// Tokens a clip needs.
const LEAST_TOKENS: usize = 2;
/// Most anchors of a motion.
const MOST_ANCHORS: usize = 8;

/// A dataset gave no captioned motions.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// No clip that the planner can read.
    #[error("the dataset has no {split:?} clip with a caption of the vocabulary; choose another split or dataset")]
    NoCaptions {
        /// The split asked for.
        split: Split,
    },
    /// A clip could not be encoded.
    #[error("clip {clip}: {source}")]
    Encode {
        /// Its name.
        clip: String,
        /// Why.
        source: EncodeError,
    },
}

/// A real motion with its caption.
#[derive(Debug, Clone, PartialEq)]
pub struct CaptionedMotion {
    /// Name of the clip.
    pub id: String,
    /// Its caption.
    pub prompt: String,
    /// Word ids of the caption.
    pub words: Vec<u16>,
    /// Its tokens.
    pub tokens: Vec<u16>,
    /// Anchors that the planner sees; none for a planner without anchor control.
    pub anchors: Vec<Anchor>,
    /// Where it lies in a longer motion.
    pub place: Place,
}

/// Where a motion lies in a longer one; a whole motion by default.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Place {
    /// Tokens at its beginning that are given.
    pub given: usize,
    /// It begins in the middle of another.
    pub start_open: bool,
    /// It goes on behind its end.
    pub end_open: bool,
}

impl CaptionedMotion {
    /// What the motion is planned from.
    #[must_use]
    pub fn guided(&self, prior: &Prior<f32>, guidance: f32) -> Guided<f32> {
        let Place { start_open, end_open, .. } = self.place;
        let mut guided = prior.guided(&self.words, guidance);
        (guided.start_open, guided.end_open) = (start_open, end_open);
        prior.through(guided, &self.anchors, self.tokens.len())
    }
}

/// At most `count` clips of `split` with a caption that the prior can read, spread evenly over it; with `anchored`, one to eight anchors
/// each where the clip itself passes.
///
/// # Errors
/// [`Error::NoCaptions`], [`Error::Encode`].
pub fn choose(
    tokenizer: &TokenizerCheckpoint,
    prior: &Prior<f32>,
    dataset: &Dataset,
    split: Split,
    count: usize,
    anchored: bool,
) -> Result<Vec<CaptionedMotion>, Error> {
    let per_token = tokenizer.config.frames_per_token();
    let readable = |clip: &ClipView<'_>| {
        let caption = clip.info.captions.iter().find_map(|c| {
            // Captions of a part of a clip say nothing of the whole.
            let words = prior.text.read(&c.text).ok().filter(|_| c.from == 0.0 && c.to == 0.0)?;
            Some((c.text.clone(), words.ids))
        });
        caption.filter(|_| clip.frames() >= LEAST_TOKENS * per_token)
    };
    let clips: Vec<_> = dataset.split(split).filter_map(|clip| readable(&clip).map(|c| (clip, c))).collect();
    if clips.is_empty() || count == 0 {
        return Err(Error::NoCaptions { split });
    }
    let wanted = count.min(clips.len());
    let chosen: Vec<_> = (0..wanted).map(|i| (i, &clips[i * clips.len() / wanted])).collect();
    let encoder = Tokenizer::<f32>::new(tokenizer);
    let encode = |&(i, (clip, (prompt, words))): &(usize, &(ClipView<'_>, (String, Vec<u16>)))| {
        let frames = clip.frames().min(prior.planner.max_tokens * per_token);
        let id = clip.info.id.clone();
        match encoder.encode(&clip.features[..frames * tokenizer.config.features]) {
            Ok(ids) => {
                let tokens: Vec<u16> = ids.into_iter().map(runtime_token).collect();
                let anchors = match clip.joints.get(..tokens.len() * per_token) {
                    Some(joints) if anchored => place(joints, 1 + i % MOST_ANCHORS, i as u64),
                    _ => Vec::new(),
                };
                Ok(CaptionedMotion {
                    id,
                    prompt: prompt.clone(),
                    words: words.clone(),
                    tokens,
                    anchors,
                    place: Place::default(),
                })
            }
            Err(source) => Err(Error::Encode { clip: id, source }),
        }
    };
    crate::parallel::map(&chosen, encode).into_iter().collect()
}

/// At most `count` anchors where a motion itself passes, families in turn beginning with one of `seed`'s, frames and joints drawn; of two
/// for one joint at one frame the first stays.
fn place(motion: &[Pose], count: usize, seed: u64) -> Vec<Anchor> {
    let mut random = Stream::new(seed);
    let mut anchors: Vec<Anchor> = Vec::new();
    for n in (seed as usize..).take(count) {
        let frame = random.below(motion.len() as u32) as usize;
        let joint = if n % 3 == 2 { 1 + random.below(JOINTS as u32 - 1) as usize } else { 0 };
        let [x, y, z] = motion[frame][joint].map(f64::from);
        let target = match n % 3 {
            0 => Target::Root([x, y, z]),
            1 => Target::PlanarRoot([x, z]),
            _ => Target::Joint { joint, position: [x, y, z] },
        };
        if !anchors.iter().any(|a| (a.frame, a.joint()) == (frame, joint)) {
            anchors.push(Anchor { frame, target });
        }
    }
    anchors
}
