//! How far a run is, on the standard error output.

use std::io::IsTerminal;

use indicatif::{ProgressBar, ProgressStyle};
use motionette_host::console::remark;

/// A bar on a terminal; lines alone elsewhere.
pub struct Progress {
    bar: Option<ProgressBar>,
}

impl Progress {
    /// Shows nothing yet.
    #[expect(clippy::new_without_default, reason = "it looks at the terminal")]
    pub fn new() -> Self {
        let bar = std::io::stderr().is_terminal().then(|| {
            let style = ProgressStyle::with_template("{bar:30} {pos}/{len} steps, {per_sec}, {eta} left");
            ProgressBar::new(0).with_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()))
        });
        Self { bar }
    }

    /// Shows that `done` steps of `expected()` are done.
    pub fn show(&self, done: u64, expected: impl FnOnce() -> u64) {
        if let Some(bar) = &self.bar {
            bar.set_length(expected());
            bar.set_position(done);
        }
    }

    /// Writes a line, above the bar where there is one.
    pub fn line(&self, text: &str) {
        match &self.bar {
            Some(bar) => bar.println(text),
            None => remark(text),
        }
    }

    /// Takes the bar away.
    pub fn finish(&self) {
        if let Some(bar) = &self.bar {
            bar.finish_and_clear();
        }
    }
}
