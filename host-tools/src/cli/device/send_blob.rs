//! `motionette device send-blob`: another model for the device.

use std::path::PathBuf;

use anyhow::Result;
use clap::Args;
use motionette_link::message::Hello;
use serde_json::{Value, json};

use super::{Session, report};
use crate::blob::BlobFile;
use crate::cli::{bar, say};

/// Sends a blob into the slot that is not active; the device verifies it and takes it from then on.
#[derive(Debug, Args)]
pub(super) struct Cmd {
    /// The blob.
    blob: PathBuf,
}

impl Cmd {
    pub(super) fn run(self, client: &mut Session, hello: &Hello) -> Result<Value> {
        // What the runtime refuses here it would refuse there, after minutes.
        let blob = BlobFile::open(&self.blob)?;
        let bar = bar(blob.bytes().len() as u64, "bytes");
        let sent = client.update(hello, blob.bytes(), &mut |next| bar.set_position(u64::from(next)));
        bar.finish_and_clear();
        let (active, sent) = sent?;
        let what = if sent { "sent, verified and active" } else { "active already" };
        say(&format!("{}: {what}, slot {}, {} bytes", self.blob.display(), active.slot, active.length));
        Ok(json!({
            "blob": report::blob(&active),
            "sent": sent,
            "repeated_requests": client.repeated(),
            "skipped_frames": client.skipped().total(),
        }))
    }
}
