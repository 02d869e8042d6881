//! Options that several model commands share.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use clap::Args;

use crate::checkpoint::{self, Companions, TokenizerCheckpoint};

/// Files that belong to a published checkpoint. Our own checkpoints need none of them.
#[derive(Debug, Args)]
pub(super) struct CheckpointFiles {
    /// Option file of a published checkpoint; else opt.txt or t2mgpt_args.json beside it.
    #[arg(long, value_name = "FILE")]
    options: Option<PathBuf>,
    /// Mean of the features (mean.npy); else beside the checkpoint or in meta/ there.
    #[arg(long, value_name = "FILE")]
    mean: Option<PathBuf>,
    /// Standard deviation of the features (std.npy), likewise.
    #[arg(long, value_name = "FILE")]
    std: Option<PathBuf>,
}

impl CheckpointFiles {
    /// Whether any was named.
    pub(super) const fn given(&self) -> bool {
        self.options.is_some() || self.mean.is_some() || self.std.is_some()
    }

    pub(super) fn load(&self, path: &Path) -> Result<TokenizerCheckpoint> {
        let companions = Companions { options: self.options.clone(), mean: self.mean.clone(), std: self.std.clone() };
        checkpoint::load_with(path, &companions).context("reading the checkpoint")
    }
}

/// `1234567` as `1 234 567`.
pub(super) fn grouped(n: u64) -> String {
    let digits = n.to_string();
    let mut out = String::new();
    for (i, c) in digits.chars().enumerate() {
        if i > 0 && (digits.len() - i).is_multiple_of(3) {
            out.push(' ');
        }
        out.push(c);
    }
    out
}

#[cfg(test)]
mod tests {
    #[test]
    fn digits_are_grouped_by_three() {
        for (n, text) in [(0, "0"), (999, "999"), (1000, "1 000"), (1_234_567, "1 234 567")] {
            assert_eq!(super::grouped(n), text);
        }
    }
}
