//! `motionette recover`: joint positions from features.

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use clap::Args;
use serde_json::{Value, json};

use super::say;
use crate::import::npy;
use crate::motion::{FEATURES, JOINTS, recover};
use crate::output::write_atomic;

/// Computes global joint positions from HumanML3D features.
///
/// Example: motionette recover new_joint_vecs/012314.npy -o joints.npy
#[derive(Debug, Args)]
pub(super) struct Cmd {
    /// Unnormalised features, a NumPy array [frames, 263] of float32 or float64.
    features: PathBuf,
    /// Where to write the joints, a NumPy array [frames, 22, 3] of float32, metres.
    #[arg(short, long, value_name = "FILE")]
    output: PathBuf,
}

impl Cmd {
    pub(super) fn run(self) -> Result<Value> {
        let array = npy::read(&self.features)?;
        ensure!(
            array.shape.len() == 2 && array.shape[1] == FEATURES,
            "{} has shape {:?}; features have shape [frames, {FEATURES}]",
            self.features.display(),
            array.shape
        );
        if let Some(index) = array.data.iter().position(|x| !x.is_finite()) {
            let (frame, channel) = (index / FEATURES, index % FEATURES);
            anyhow::bail!(
                "{}: frame {frame}, channel {channel} is not finite; repair the file",
                self.features.display()
            );
        }
        let joints = recover::joints_f64(&array.data)?;
        let flat: Vec<f32> = joints.as_flattened().as_flattened().iter().map(|&x| x as f32).collect();
        write_atomic(&self.output, |w| npy::write(w, &[joints.len(), JOINTS, 3], &flat))
            .context("writing the joints")?;
        say(&format!("{} frames of {JOINTS} joints to {}", joints.len(), self.output.display()));
        Ok(json!({"output": super::shown(&self.output), "frames": joints.len(), "joints": JOINTS}))
    }
}
