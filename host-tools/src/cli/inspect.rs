//! `motionette inspect`: what is in a blob.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use serde_json::Value;

use super::model::{CheckpointFiles, grouped};
use super::say;
use crate::blob_file::BlobFile;
use crate::inspect::{self, Inspection};

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
}

impl Cmd {
    pub(super) fn run(self) -> Result<Value> {
        let blob = BlobFile::open(&self.blob)?;
        let checkpoint = self.checkpoint.as_ref().map(|path| self.files.load(path)).transpose()?;
        if let Some(checkpoint) = &checkpoint {
            crate::verify::check_same_model(&blob, checkpoint)?;
        }
        let inspection = inspect::inspect(&blob, checkpoint.as_ref())?;
        show(&inspection);
        Ok(serde_json::to_value(&inspection)?)
    }
}

fn show(i: &Inspection) {
    say(&format!("{}  format {}  {} bytes", i.name, i.version, grouped(i.bytes as u64)));
    say(&format!("  decoder     {}", i.decoder));
    say(&format!("  motion      {} frames/s, at most {} tokens", i.frame_rate, i.max_tokens));
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
    say(
        "\nlayer                                   scales                    rows           MAC  weight error (rms, max)",
    );
    for l in &i.layers {
        let error = match (l.weight_error, l.weight_error_max) {
            (Some(rms), Some(max)) => format!("{:.3} %  {max:.5}", 100.0 * rms),
            _ => String::new(),
        };
        say(&format!(
            "{:<38}  {:.3e} .. {:.3e}  {:>6}  {:>12}  {error}",
            l.name,
            l.scale_min,
            l.scale_max,
            l.rows,
            grouped(l.macs)
        ));
    }
    say(&format!("{} MAC a forward pass of all channels", grouped(i.layers.iter().map(|l| l.macs).sum())));
}
