//! `motionette inspect`: what is in a blob.

use std::path::PathBuf;

use anyhow::{Context, Result};
use clap::Args;
use serde_json::Value;

use super::model::{CheckpointFiles, grouped};
use super::say;
use crate::blob::BlobFile;
use crate::checkpoint::{control, prior};
use crate::inspect::{self, ControlInfo, Inspection, LayerInfo, PriorInfo};

/// Joints of the left leg in the skeleton below the hip: knee, ankle.
const LEG: [usize; 2] = [4, 7];

/// Shows every tensor of a blob, its size and range, the work of every layer, and what quantisation cost it.
///
/// Example: motionette inspect nano.blob --checkpoint nano.safetensors
#[derive(Debug, Args)]
pub(super) struct Cmd {
    /// The blob.
    blob: PathBuf,
    /// The checkpoint it came from: adds the quantisation error of every layer.
    #[arg(long, value_name = "FILE")]
    checkpoint: Option<PathBuf>,
    #[command(flatten)]
    files: CheckpointFiles,
    /// The prior it came from: adds the quantisation error of text encoder and planner.
    #[arg(long, value_name = "FILE")]
    prior: Option<PathBuf>,
    /// The control it came from: adds the quantisation error of the anchor control.
    #[arg(long, value_name = "FILE")]
    control: Option<PathBuf>,
    /// List the words of the vocabulary.
    #[arg(long)]
    vocabulary: bool,
}

impl Cmd {
    pub(super) fn run(self) -> Result<Value> {
        let blob = BlobFile::open(&self.blob)?;
        let checkpoint = self.checkpoint.as_ref().map(|path| self.files.load(path)).transpose()?;
        if let Some(checkpoint) = &checkpoint {
            crate::verify::check_same_model(&blob, checkpoint)?;
        }
        let prior = self.prior.as_deref().map(prior::load).transpose().context("reading the prior")?;
        let prior = prior.map(|prior| crate::verify::same_words(&blob, prior)).transpose()?;
        let control = self.control.as_deref().map(control::load).transpose().context("reading the control")?;
        if let Some(control) = &control {
            crate::verify::check_same_control(&blob, control)?;
        }
        let inspection = inspect::inspect(&blob, checkpoint.as_ref(), prior.as_ref(), control.as_ref())?;
        show(&inspection);
        if self.vocabulary {
            let words = inspection.prior.as_ref().map_or(&[][..], |p| &p.vocabulary);
            let phrases = inspection.prior.as_ref().map_or(&[][..], |p| &p.phrases);
            say(&format!("\n{} words\n{}", words.len(), words.join(" ")));
            if !phrases.is_empty() {
                say(&format!("\n{} phrases\n{}", phrases.len(), phrases.join("\n")));
            }
        }
        Ok(serde_json::to_value(&inspection)?)
    }
}

fn show(i: &Inspection) {
    say(&format!("{}  format {}  {} bytes", i.name, i.version, grouped(i.bytes as u64)));
    let length = |[x, y, z]: [f32; 3]| (x * x + y * y + z * z).sqrt();
    let leg: f32 = LEG.iter().filter_map(|&joint| i.skeleton.get(joint)).map(|&bone| length(bone)).sum();
    say(&format!("  frames      {}, {} a second; a body with legs of {leg:.3} m", i.representation, i.frame_rate));
    say(&format!("  decoder     {}, {}", i.codec, i.decoder));
    say(&format!("  padding     {}", padding(&i.padding)));
    if let Some(p) = &i.prior {
        show_prior(p);
    }
    if let Some(c) = &i.control {
        show_control(c);
    }
    say(&format!("  tokens      {}, at most {} of {} frames", i.generator, i.max_tokens, i.frames_per_token));
    say(&format!(
        "  features    {} (of the runtime's cargo features; for requests with anchors, tracks, obstacles or a timeline also `editing`, `tracks`, `obstacles`, `timeline`)",
        i.features.join(", ")
    ));
    say(&format!("  licence     {}", i.licence));
    say(&format!("  data        {}", i.data));
    say(&format!("  checkpoint  {}", i.checkpoint));
    say(&format!("  self-test   {}", if i.self_test { "yes" } else { "none" }));
    say(
        "\ntensor                                              type   shape               bytes         min         max",
    );
    for t in &i.tensors {
        let shape = t.shape.map(|d| d.to_string()).join(" x ");
        say(&format!(
            "{:<50}  {:<5}  {:<16}  {:>8}  {:>10.4}  {:>10.4}",
            t.name, t.dtype, shape, t.bytes, t.min, t.max
        ));
    }
    layers(&i.layers);
    say(&format!("{} MAC a forward pass of all channels", grouped(i.layers.iter().map(|l| l.macs).sum())));
    if let Some(prior) = &i.prior {
        layers(&prior.layers);
        let work = |part: &str| prior.layers.iter().filter(|l| l.name.starts_with(part)).map(|l| l.macs).sum();
        say(&format!("{} MAC a text, {} MAC a planner pass", grouped(work("text.")), grouped(work("planner."))));
    }
    if let Some(control) = &i.control {
        layers(&control.layers);
        say(&format!("{} MAC the anchors of a request", grouped(control.layers.iter().map(|l| l.macs).sum())));
    }
}

/// Rows back and ahead of each convolution; once, where all look as far ahead as back.
fn padding(padding: &[[u16; 2]]) -> String {
    let symmetrical = padding.iter().all(|[left, right]| left == right);
    let each =
        padding.iter().map(|[left, right]| if symmetrical { left.to_string() } else { format!("{left}+{right}") });
    let each = each.collect::<Vec<_>>().join(" ");
    if symmetrical { format!("symmetrical, {each} rows either way") } else { format!("{each} rows back and ahead") }
}

fn show_control(c: &ControlInfo) {
    let context = if c.context { "dual context" } else { "no dual context" };
    let families: Vec<String> = c.families.iter().map(|f| f.to_string()).collect();
    say(&format!("  anchors     {}; frames of {}, rank {}, {context}", c.scaffold, c.frame_width, c.rank));
    say(&format!("  families    {}", families.join(", ")));
}

fn show_prior(p: &PriorInfo) {
    match &p.text {
        Some(text) => {
            let kind = p.table.unwrap_or_default();
            say(&format!("  text        {text}; table of {} {kind}, prompts of at most {}", p.words, p.max_words));
        }
        None => match p.vector {
            Some(width) => say(&format!("  text        vectors of {width} numbers, made elsewhere")),
            None => say("  text        no encoder"),
        },
    }
    if !p.bank.is_empty() {
        say(&format!("  prompts     {} stored: {}", p.bank.len(), p.bank.join(", ")));
    }
    if !p.phrases.is_empty() {
        say(&format!("  understood  as one of {} phrases", p.phrases.len()));
    }
    if let Some(planner) = &p.planner {
        say(&format!("  planner     {planner}, guided by {}", p.guidance.unwrap_or_default()));
    }
    if let Some(residual) = &p.residual {
        say(&format!("  residual    {residual}"));
    }
}

fn layers(layers: &[LayerInfo]) {
    say(
        "\nlayer                                   bits  scales                    rows           MAC  weight error (rms, max)",
    );
    for l in layers {
        let error = match (l.weight_error, l.weight_error_max) {
            (Some(rms), Some(max)) => format!("{:.3} %  {max:.5}", 100.0 * rms),
            _ => String::new(),
        };
        say(&format!(
            "{:<38}  {:>4}  {:.3e} .. {:.3e}  {:>6}  {:>12}  {error}",
            l.name,
            if l.wide > 0 { format!("16+{}", l.bits) } else { l.bits.to_string() },
            l.scale_min,
            l.scale_max,
            l.rows,
            grouped(l.macs)
        ));
    }
}
