//! What a device says of a motion that it has made.

use motionette::refining::Followed;
use motionette::{Model, Motion, Words};
use serde::{Deserialize, Serialize};

use super::PHRASE_BYTES;

/// A phrase: as much of it as fits.
pub type Phrase = heapless::String<PHRASE_BYTES>;

/// What the device understood of a prompt.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Understood {
    /// The likeliest action, with the style behind a comma where one is likely; of a model that was not taught what prompts mean, what the
    /// motion was made of in words that it knows.
    pub phrase: Phrase,
    /// How likely that is what the prompt means, 0 to 1; without such teaching the share of its words that the model knows.
    pub score: f32,
}

impl Understood {
    /// What `model` understood of the prompt `text`, of whose clauses its motion says that they were `understood`: the phrases with `, then `
    /// between them, as far as there is room, and the least of their scores.
    #[must_use]
    pub fn of(
        model: &Model<'_>,
        understood: impl IntoIterator<Item = motionette::Understood>,
        text: &str,
    ) -> Option<Self> {
        let mut said: Option<Self> = None;
        for clause in understood {
            let action = clause.action();
            let words = model.phrase(action.phrase)?;
            let mut all = said.unwrap_or(Understood { phrase: Phrase::new(), score: action.score });
            if !all.phrase.is_empty() {
                push(&mut all.phrase, ", then ");
            }
            push(&mut all.phrase, words);
            if let Some(style) = clause.style.and_then(|style| model.phrase(style.phrase)) {
                push(&mut all.phrase, ", ");
                push(&mut all.phrase, style);
            }
            if action.score < all.score {
                all.score = action.score;
            }
            said = Some(all);
        }
        said.or_else(|| Self::of_words(model, text))
    }

    /// What `model` knows of the words of `text`, in their order, and the share of them that it knows; `None` when it reads no text or
    /// the text has no words. Words that do not fit a phrase are counted but not named.
    #[must_use]
    fn of_words(model: &Model<'_>, text: &str) -> Option<Self> {
        let (mut phrase, mut full) = (Phrase::new(), false);
        let (mut known, mut words) = (0u16, 0u16);
        for word in Words::new(text) {
            words = words.saturating_add(1);
            if !model.knows(&word)? {
                continue;
            }
            known = known.saturating_add(1);
            let space = if phrase.is_empty() { "" } else { " " };
            full |= phrase.len() + space.len() + word.as_str().len() > PHRASE_BYTES;
            if !full {
                // There is room.
                let _ = phrase.push_str(space).and_then(|()| phrase.push_str(word.as_str()));
            }
        }
        (words > 0).then(|| Understood { phrase, score: f32::from(known) / f32::from(words) })
    }
}

/// Adds `text`, or as much of it as fits.
fn push(phrase: &mut Phrase, text: &str) {
    for c in text.chars() {
        if phrase.push(c).is_err() {
            return;
        }
    }
}

/// How much the anchors ask of the motion, and which of them asks most.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Strain {
    /// What `value` is.
    pub measure: Measure,
    /// How much: 0 is nothing.
    pub value: f32,
    /// The anchor that causes most of it, counted in the request's list from 0.
    pub anchor: u16,
}

impl Strain {
    /// Of a motion that was edited onto its anchors: how far that takes it from what was generated. Of one whose tokens were bent: how far it
    /// still is from the anchor that it misses most.
    #[must_use]
    pub fn of(motion: &Motion<'_>) -> Option<Self> {
        if let Some(strain) = motion.strain() {
            return Some(Strain { measure: Measure::STRAIN, value: strain.value, anchor: strain.anchor });
        }
        let after = motion.refinement?.after?;
        Some(Strain { measure: Measure::DISTANCE, value: after.worst, anchor: after.worst_anchor })
    }
}

/// How far a motion is from its tracks: [`motionette::refining::TrackingError`] on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Tracking {
    /// Mean distance over all positions that count, on the axes that do, metres.
    pub mean: f32,
    /// Largest distance, metres.
    pub worst: f32,
    /// Track with the largest distance, counted in the request's list from 0.
    pub track: u16,
    /// Its frame.
    pub frame: u16,
    /// Positions that could not be followed as fast as they ask for.
    pub hurried: u16,
}

impl Tracking {
    /// Of a motion with tracks.
    #[must_use]
    pub fn of(motion: &Motion<'_>) -> Option<Self> {
        let Followed { after, hurried, .. } = followed(motion)?;
        after.map(|it| Tracking {
            mean: it.mean,
            worst: it.worst,
            track: it.worst_track,
            frame: it.worst_frame,
            hurried,
        })
    }
}

/// How far a motion keeps clear of its obstacles: [`motionette::refining::Clearance`] on the wire.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Clearance {
    /// Least distance from a surface, metres; negative inside.
    pub least: f32,
    /// By how much it is less than the obstacle's margin, metres; negative where all of the margin is kept.
    pub missing: f32,
    /// The obstacle, counted in the request's list from 0.
    pub obstacle: u16,
    /// The joint, or the one at the end of the bone.
    pub joint: u8,
    /// The frame.
    pub frame: u16,
}

impl Clearance {
    /// Of a motion with obstacles.
    #[must_use]
    pub fn of(motion: &Motion<'_>) -> Option<Self> {
        followed(motion)?.clearance.map(|it| Clearance {
            least: it.least,
            missing: it.missing,
            obstacle: it.obstacle,
            joint: it.joint,
            frame: it.frame,
        })
    }

    /// Whether the figure keeps clear of all obstacles; where it does not, there was no way for it.
    #[must_use]
    pub fn kept(&self) -> bool {
        self.missing <= motionette::refining::Clearance::TOLERANCE
    }
}

fn followed(motion: &Motion<'_>) -> Option<Followed> {
    motion.refinement?.edited?.followed
}

/// What a strain is measured in: a number, so that a host can read the reply of a device that measures something newer.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Measure(pub u8);

impl Measure {
    /// Distance of the refined motion from the anchor, metres.
    pub const DISTANCE: Measure = Measure(0);
    /// Distance of the edited motion from what was generated, [`motionette::refining::Strain`]: above
    /// [`WARNING`](motionette::refining::Strain::WARNING) it may no longer do what the prompt says.
    pub const STRAIN: Measure = Measure(1);
}
