//! What a request is made from: a prompt, a bundled token sequence, or the user's BVH file through the reference encoder.

use crate::sample_clips::SampleClips;
use anyhow::Context;
use motionette::{Anchor, Anchors, Joint};
use motionette_host::checkpoint::TokenizerCheckpoint;
use motionette_host::import::bvh::{self, Reading};
use motionette_host::motion::{FEATURES, Pose, features};
use motionette_host::reference::Tokenizer;
use motionette_host::reference::bridge::runtime_token;
use motionette_host::scene_file::{OwnedObstacle, OwnedSpan, OwnedTrack};
use std::path::Path;

/// What the motion comes from.
#[derive(Debug, Clone, PartialEq)]
pub enum Content {
    /// Words; the runtime plans the tokens.
    Prompt(String),
    /// Motion tokens `[L][Q]`.
    Tokens(Vec<u16>),
}

/// A motion to run.
#[derive(Debug, Clone)]
pub struct Source {
    /// Its name.
    pub name: String,
    /// What it shows.
    pub caption: String,
    /// What it comes from.
    pub content: Content,
    /// Anchors that come with it.
    pub anchors: Vec<Anchor>,
    /// Where joints are to be at many frames.
    pub tracks: Vec<OwnedTrack>,
    /// What the body keeps clear of.
    pub obstacles: Vec<OwnedObstacle>,
    /// What parts of the body do instead.
    pub timeline: Vec<OwnedSpan>,
    /// The recording itself, where there is one.
    pub recorded: Option<Vec<Pose>>,
    /// What the user should know about how it was read.
    pub notes: Vec<String>,
}

/// What is made when nothing is said.
pub const DEFAULT_PROMPT: &str = "a person walks forward";

/// A prompt, without anchors.
#[must_use]
pub fn prompt(text: &str) -> Source {
    Source {
        name: "text".into(),
        caption: text.to_owned(),
        content: Content::Prompt(text.to_owned()),
        anchors: Vec::new(),
        tracks: Vec::new(),
        obstacles: Vec::new(),
        timeline: Vec::new(),
        recorded: None,
        notes: Vec::new(),
    }
}

/// The motion of the default job: the default prompt, led to the left of where it goes by itself, with the right hand raised on the way,
/// by a model of `frame_rate` frames a second.
///
/// # Errors
/// When the anchors cannot be made (a mistake in the build, or a model without frames).
pub fn default_job(frame_rate: u16) -> anyhow::Result<Source> {
    let anchors = Anchors::new()
        .planar_root_at(2.0, [0.3, 2.2])
        .joint_at(3.5, Joint::RightWrist, [0.3, 1.15, 4.15])
        .root_at(4.95, [1.1, 0.92, 5.4]);
    Ok(Source { anchors: anchors.by_frame(frame_rate)?.to_vec(), ..prompt(DEFAULT_PROMPT) })
}

/// A bundled clip for a model of `frame_rate` frames a second.
///
/// # Errors
/// When there is none of that name.
pub fn bundled(id: Option<&str>, frame_rate: u16) -> anyhow::Result<Source> {
    let samples = SampleClips::built_in()?;
    let clip = samples.clip(id)?;
    Ok(Source {
        name: clip.id.clone(),
        caption: clip.caption.clone(),
        content: Content::Tokens(clip.tokens.clone()),
        anchors: clip.anchors(frame_rate)?,
        tracks: Vec::new(),
        obstacles: Vec::new(),
        timeline: Vec::new(),
        recorded: None,
        notes: Vec::new(),
    })
}

/// The user's recording, cut to the model's longest motion.
///
/// # Errors
/// When it cannot be read, is no body, or is too short.
pub fn recording(
    path: &Path,
    reading: &Reading,
    checkpoint: &TokenizerCheckpoint,
    max_tokens: usize,
) -> anyhow::Result<Source> {
    let recording = bvh::load(path, reading)?;
    let processed = features::process(&recording.joints, &features::Options::default())
        .with_context(|| format!("{}: no features can be extracted", path.display()))?;
    let per_token = checkpoint.config.frames_per_token();
    let frames = processed.joints.len().min(max_tokens * per_token) / per_token * per_token;
    let mut notes =
        vec![format!("joints by the mapping {}, {} frames at 20 fps", recording.mapping, processed.joints.len())];
    notes.extend(recording.notes);
    if processed.joints.len() > max_tokens * per_token {
        notes.push(format!("cut to the model's longest motion, {frames} frames"));
    }
    let ids = Tokenizer::<f32>::new(checkpoint).encode(&processed.features[..frames.max(1) * FEATURES]).with_context(
        || format!("{}: the clip cannot be encoded (it needs at least {per_token} frames)", path.display()),
    )?;
    let name = path.file_stem().map_or_else(|| "recording".into(), |stem| stem.to_string_lossy().into_owned());
    Ok(Source {
        caption: format!("recorded in {}", path.file_name().unwrap_or_default().to_string_lossy()),
        name,
        content: Content::Tokens(ids.into_iter().map(runtime_token).collect()),
        anchors: Vec::new(),
        tracks: Vec::new(),
        obstacles: Vec::new(),
        timeline: Vec::new(),
        recorded: Some(processed.joints[..frames].to_vec()),
        notes,
    })
}
