//! Token sequences of real test motions that come with the simulator, with anchors that pull them away from themselves.
//!
//! The file holds token ids and anchors, no motion: what they decode to is what the model makes of them. It is made by
//! `motionette-sim bundle` and belongs to one checkpoint, whose hash it names.

use anyhow::{Context, bail};
use clap::Args;
use motionette::{Anchor, Model, Request};
use motionette_host::console::say;
use motionette_host::dataset::Dataset;
use motionette_host::reference::Tokenizer;
use motionette_host::reference::bridge::runtime_token;
use motionette_host::{anchors_file, checkpoint, output};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::path::PathBuf;

use crate::session;

/// The clips that are built in.
const BUILT_IN: &str = include_str!("../assets/clips.json");

/// One motion.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct Clip {
    /// Its name in the dataset.
    pub id: String,
    /// What it shows.
    pub caption: String,
    /// Motion tokens.
    pub tokens: Vec<u16>,
    /// Anchors, as in an anchors file.
    pub anchors: Value,
}

impl Clip {
    /// The anchors in a motion of `frame_rate` frames a second.
    ///
    /// # Errors
    /// When they cannot be read.
    pub fn anchors(&self, frame_rate: u16) -> anyhow::Result<Vec<Anchor>> {
        anchors_file::parse(&self.anchors.to_string(), frame_rate)
            .with_context(|| format!("anchors of the bundled clip {}", self.id))
    }
}

/// All bundled motions.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct SampleClips {
    /// SHA-256 of the checkpoint that made the tokens.
    pub checkpoint: String,
    /// Licence of the motions that the tokens were made from.
    pub licence: String,
    /// The motions; the first is the default.
    pub clips: Vec<Clip>,
}

impl SampleClips {
    /// The clips that are built in.
    ///
    /// # Errors
    /// When it cannot be read (a mistake in the build).
    pub fn built_in() -> anyhow::Result<Self> {
        serde_json::from_str(BUILT_IN).context("the built-in clips cannot be read")
    }

    /// The clip called `id`, or the first.
    ///
    /// # Errors
    /// When there is none of that name; the message lists those there are.
    pub fn clip(&self, id: Option<&str>) -> anyhow::Result<&Clip> {
        let found = match id {
            None => self.clips.first(),
            Some(id) => self.clips.iter().find(|clip| clip.id == id),
        };
        found.with_context(|| {
            let names: Vec<&str> = self.clips.iter().map(|clip| clip.id.as_str()).collect();
            format!("no bundled clip is called {:?}; there are: {}", id.unwrap_or(""), names.join(", "))
        })
    }
}

/// Make the bundled token sequences anew from a dataset and a checkpoint.
///
/// Example: motionette-sim bundle --dataset data/pack.mds --clips bnr2_walk_masculine_023
#[derive(Debug, Args)]
pub struct Cmd {
    /// Dataset file (`motionette import`).
    #[arg(long)]
    dataset: PathBuf,
    /// Checkpoint whose encoder makes the tokens.
    #[arg(long, default_value = "models/nano.safetensors")]
    checkpoint: PathBuf,
    /// Blob that decodes them, to place the anchors.
    #[arg(long, default_value = "models/nano.blob")]
    blob: PathBuf,
    /// Names of clips, the default one first.
    #[arg(long, value_delimiter = ',', required = true)]
    clips: Vec<String>,
    /// File to write.
    #[arg(short, long, default_value = "firmware-sim/assets/clips.json")]
    out: PathBuf,
}

impl Cmd {
    /// Encodes the clips, places anchors, writes the file.
    ///
    /// # Errors
    /// When a file cannot be read or written, or a clip is not there.
    pub fn run(self) -> anyhow::Result<()> {
        let dataset = Dataset::load(&self.dataset)?;
        let tokenizer = Tokenizer::<f32>::new(&checkpoint::load(&self.checkpoint)?);
        let blob = motionette_host::blob::BlobFile::open(&self.blob)?;
        let model = blob.model()?;
        let mut clips = Vec::new();
        for id in &self.clips {
            let Some(clip) = dataset.iter().find(|clip| clip.info.id == *id) else {
                bail!("the dataset has no clip called {id:?}");
            };
            let frames = clip.frames().min(model.max_tokens() * model.frames_per_token());
            let columns = clip.features.len() / clip.frames().max(1);
            let ids = tokenizer.encode(&clip.features[..frames * columns])?;
            let tokens: Vec<u16> = ids.into_iter().map(runtime_token).collect();
            let anchors = placed(&model, &tokens).with_context(|| format!("clip {id}"))?;
            let caption = clip.info.captions.first().map(|c| c.text.clone()).unwrap_or_default();
            clips.push(Clip {
                id: id.clone(),
                caption,
                tokens,
                anchors: serde_json::from_str(&anchors_file::text(&anchors)?)?,
            });
        }
        let samples = SampleClips {
            checkpoint: checkpoint::file_hash(&self.checkpoint)?,
            licence: "Token ids of Bandai-Namco Research motions, CC BY-NC 4.0; see models/README.md".into(),
            clips,
        };
        let text = serde_json::to_string_pretty(&samples)?;
        output::write_atomic(&self.out, |file| writeln!(file, "{text}"))?;
        say(&format!("{} clips to {}", samples.clips.len(), self.out.display()));
        Ok(())
    }
}

/// Anchors beside the motion of `tokens`: the root is led to one side, the wrists and at the end the head elsewhere, each
/// 15 to 35 cm from where the motion goes by itself.
fn placed(model: &Model<'_>, tokens: &[u16]) -> anyhow::Result<Vec<Anchor>> {
    let frames = session::run(model, &Request::tokens(tokens), |_| ())?.joints;
    let at = |share: f64| ((frames.len() - 1) as f64 * share).round() as usize;
    let moved = |share: f64, joint: usize, by: [f32; 3]| {
        let frame = at(share);
        let [x, y, z] = frames[frame][joint];
        // To the millimetre, as a person would write it.
        (frame as u16, [x + by[0], y + by[1], z + by[2]].map(|v| (v * 1000.0).round() / 1000.0))
    };
    let (left_wrist, right_wrist) = (20, 21);
    let mut anchors = Vec::new();
    for (share, by) in [(0.5, [0.22, 0.0, 0.1]), (1.0, [0.35, 0.0, -0.1])] {
        let (frame, position) = moved(share, 0, by);
        anchors.push(Anchor::root(frame, position));
    }
    for (share, joint, by) in [(0.35, right_wrist, [-0.1, 0.2, 0.15]), (0.75, left_wrist, [0.3, 0.15, 0.1])] {
        let (frame, position) = moved(share, joint, by);
        anchors.push(Anchor::joint(frame, joint as u8, position));
    }
    anchors.sort_by_key(|anchor| anchor.frame);
    Ok(anchors)
}
