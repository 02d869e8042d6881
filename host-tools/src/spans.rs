//! Spans of a timeline: what was understood of each, as fields with stable names and in words, and what to do about one that is refused.

use motionette::{LEAST_SPAN, Model, Prompt, PromptError, PromptStats, Span, TimelineError};
use serde::Serialize;

use crate::console;
use crate::scene_file::names_of_parts;

/// A span as it was understood. Names are stable: reports in JSON have these.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct HeardSpan {
    /// What moves, by the names of timeline files.
    pub parts: Vec<&'static str>,
    /// First frame.
    pub first_frame: u16,
    /// Frames.
    pub frames: u16,
    /// What they do, in words; null where a stored prompt says it.
    pub text: Option<String>,
    /// The name of the stored prompt that says it; null where words do.
    pub prompt: Option<String>,
    /// What the prompt was understood as, or the first of its clauses; null of a model that was not taught it.
    pub understood: Option<String>,
    /// Words of it that the model does not know.
    pub unknown_words: Vec<String>,
}

impl HeardSpan {
    /// The spans of a request, with what a motion heard of each.
    #[must_use]
    pub fn of_all(model: &Model<'_>, spans: &[Span<'_>], heard: &[PromptStats]) -> Vec<Self> {
        let of = |(span, heard): (&Span<'_>, &PromptStats)| {
            let (text, prompt) = match span.prompt {
                Prompt::Text(text) => (Some(text), None),
                Prompt::Bank(name) => (None, Some(name)),
                Prompt::Vector(_) => (None, None),
            };
            HeardSpan {
                parts: names_of_parts(span.parts),
                first_frame: span.first,
                frames: span.frames,
                text: text.map(str::to_owned),
                prompt: prompt.map(str::to_owned),
                understood: heard.understood.map(|understood| model.in_words(understood).to_string()),
                unknown_words: text.map_or_else(Vec::new, |text| console::unknown_words(model, text)),
            }
        };
        spans.iter().zip(heard).map(of).collect()
    }

    /// What it says: its text, or the name of its prompt.
    #[must_use]
    pub fn says(&self) -> &str {
        self.text.as_deref().or(self.prompt.as_deref()).unwrap_or("a vector")
    }

    /// The span in words, in a motion of `frame_rate` frames a second.
    #[must_use]
    pub fn line(&self, frame_rate: u16) -> String {
        let seconds = |frame: u32| f64::from(frame) / f64::from(frame_rate.max(1));
        let (from, to) =
            (seconds(self.first_frame.into()), seconds(u32::from(self.first_frame) + u32::from(self.frames)));
        let parts = self.parts.join(", ").replace('_', " ");
        let mut line = format!("{parts}, {from:.2} to {to:.2} s: {}", self.says());
        if let Some(understood) = &self.understood {
            line += &format!("; understood as: {understood}");
        }
        if !self.unknown_words.is_empty() {
            line += &format!("; words the vocabulary does not have: {}", self.unknown_words.join(", "));
        }
        line
    }
}

/// What to do about a timeline that `model` refuses, to be put behind the complaint; nothing where that says it. `settable`: the motion is as
/// long as the user says.
#[must_use]
pub fn instead(model: &Model<'_>, error: TimelineError, settable: bool) -> String {
    let seconds = |frames: usize| frames as f64 / f64::from(model.frame_rate().max(1));
    match error {
        TimelineError::TooMany { .. } => "; leave some out".to_owned(),
        TimelineError::NoParts { .. } => "; name some".to_owned(),
        TimelineError::TooShort { .. } => format!("; give it {} s or more", seconds(usize::from(LEAST_SPAN))),
        TimelineError::OutOfRange { end, frames, .. } => {
            let longest = model.max_tokens() * model.frames_per_token();
            match settable && end <= longest {
                true => format!("; end it within {} s, or give --seconds {}", seconds(frames), seconds(end)),
                false => format!("; end it within {} s", seconds(frames)),
            }
        }
        TimelineError::Overlap { parts, .. } => {
            format!("; have one end where the other begins, or take {parts} out of one")
        }
        TimelineError::Prompt { error, .. } => {
            let stored = || model.text().map(|text| text.bank().names().collect::<Vec<_>>()).unwrap_or_default();
            match error {
                PromptError::NoEncoder { stored: 1.. } | PromptError::Vectors { stored: 1.., .. } => {
                    format!("; give its prompt, one of {}", stored().join(", "))
                }
                PromptError::NotStored { stored: 1.. } => format!("; it stores {}", stored().join(", ")),
                PromptError::OnlyUnknownWords { .. } => {
                    "; `motionette inspect --vocabulary` lists what it knows".to_owned()
                }
                _ => String::new(),
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_span_in_words() {
        let span = HeardSpan {
            parts: vec!["upper_body", "left_leg"],
            first_frame: 20,
            frames: 45,
            text: Some("a person waves".to_owned()),
            prompt: None,
            understood: None,
            unknown_words: Vec::new(),
        };
        assert_eq!(span.line(20), "upper body, left leg, 1.00 to 3.25 s: a person waves");
        let unknown_words = vec!["zebra".to_owned(), "quagga".to_owned()];
        let stored = HeardSpan { text: None, prompt: Some("wave".to_owned()), unknown_words, ..span };
        let stored = HeardSpan { understood: Some("a person waves (0.90)".to_owned()), ..stored };
        assert_eq!(
            stored.line(20),
            "upper body, left leg, 1.00 to 3.25 s: wave; understood as: a person waves (0.90); words the vocabulary does not have: \
             zebra, quagga"
        );
        let last = HeardSpan { first_frame: u16::MAX, frames: u16::MAX, ..stored };
        assert!(last.line(20).contains("3276.75 to 6553.50 s"), "{}", last.line(20));
    }
}
