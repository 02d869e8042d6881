//! The command line that all trainings share.

use std::path::{Path, PathBuf};

use anyhow::Context;
use motionette_host::console::say;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

use super::{Configuration, Error, State};

/// Files, settings and pace of a run. A training gives `out` its default with `mut_arg`, see [`with_default`].
#[derive(clap::Args, Clone, Debug)]
pub struct Options {
    /// Dataset file.
    #[arg(long, value_name = "FILE")]
    pub data: PathBuf,
    /// Where the checkpoint goes, with or without `.safetensors`; state and curves go beside it.
    #[arg(short, long, value_name = "FILE")]
    pub out: PathBuf,
    /// Changes one setting; parts are written `part.field`; may be repeated.
    #[arg(long, value_name = "FIELD=VALUE")]
    pub set: Vec<String>,
    /// Seed of weights, batches and all other random numbers of the run.
    #[arg(long)]
    pub seed: Option<u64>,
    /// Goes on with the run whose state lies beside the checkpoint.
    #[arg(long)]
    pub resume: bool,
    /// Steps between two points of the curves (and log lines).
    #[arg(long, default_value_t = 100, value_parser = clap::value_parser!(u64).range(1..))]
    pub log_every: u64,
    /// Points of the curves between two checkpoints with their figures on the validation split.
    #[arg(long, default_value_t = 10, value_parser = clap::value_parser!(u64).range(1..))]
    pub save_every: u64,
    /// Prints one JSON object on the last line.
    #[arg(long)]
    pub json: bool,
}

/// The end of a run.
#[derive(clap::Args, Clone, Copy, Debug)]
pub struct Length {
    /// Length of the run in steps.
    #[arg(long)]
    pub steps: Option<u64>,
    /// Length of the run in minutes; ignored when --steps is given.
    #[arg(long)]
    pub minutes: Option<f64>,
}

impl Length {
    /// Checks that the run ends.
    ///
    /// # Errors
    /// [`Error::NoEnd`].
    pub fn check(&self) -> Result<(), Error> {
        let by_clock = self.minutes.is_some_and(|minutes| minutes.is_finite() && minutes > 0.0);
        if self.steps.is_some() || by_clock { Ok(()) } else { Err(Error::NoEnd) }
    }

    /// Seconds of training, infinite without a limit.
    pub fn seconds(&self) -> f64 {
        self.minutes.unwrap_or(f64::INFINITY) * 60.0
    }
}

/// An argument of [`Options`] that this training has a default for, to use as `mut_arg("out", |arg| with_default(arg, "file"))`.
pub fn with_default(arg: clap::Arg, value: &'static str) -> clap::Arg {
    arg.required(false).default_value(value)
}

impl Options {
    /// Where the checkpoint goes: `out`, with `.safetensors` at its end.
    pub fn checkpoint(&self) -> PathBuf {
        with_suffix(&self.out)
    }

    /// Where the state goes.
    pub fn state_file(&self) -> PathBuf {
        self.checkpoint().with_extension("state.safetensors")
    }

    /// `config` with `--seed` and then every `--set` applied.
    ///
    /// # Errors
    /// A change that is not of the form FIELD=VALUE, names no setting or does not fit it; [`Error::Setting`].
    pub fn configured<C: Configuration>(&self, config: C) -> anyhow::Result<C> {
        let seed = self.seed.map(|seed| format!("seed={seed}"));
        let mut changes = seed.iter().chain(&self.set);
        Ok(changes.try_fold(config, |config, change| changed(&config, change))?.checked()?)
    }

    /// The state to go on from: a fresh one, or with `--resume` the stored one when it belongs to this configuration and these sources.
    ///
    /// # Errors
    /// Those of [`State::resume`] and of `fresh`.
    pub fn state<C: Configuration>(
        &self,
        config: &C,
        sources: &C::Sources,
        fresh: impl FnOnce() -> anyhow::Result<State<C>>,
    ) -> anyhow::Result<State<C>> {
        if !self.resume {
            return fresh();
        }
        State::resume(&self.state_file(), config, sources).context("the run cannot be resumed")
    }
}

/// The path with `.safetensors` at its end.
fn with_suffix(path: &Path) -> PathBuf {
    if path.extension().is_some_and(|e| e == "safetensors") {
        return path.to_path_buf();
    }
    let mut name = path.as_os_str().to_owned();
    name.push(".safetensors");
    name.into()
}

/// The configuration with one `field=value` applied; fields of parts are written `part.field`.
fn changed<C: Serialize + DeserializeOwned>(config: &C, change: &str) -> anyhow::Result<C> {
    let (field, value) = change.split_once('=').with_context(|| format!("--set {change}: write FIELD=VALUE"))?;
    let mut tree = json!(config);
    let (part, name) = field.rsplit_once('.').unwrap_or(("", field));
    let pointer: String = part.split_terminator('.').flat_map(|part| ["/", part]).collect();
    let unknown = || format!("--set {change}: there is no setting {field}");
    let place = tree.pointer_mut(&pointer).and_then(Value::as_object_mut).with_context(unknown)?;
    // A word needs no quotation marks.
    let value: Value = serde_json::from_str(value).unwrap_or_else(|_| json!(value));
    // A setting that is not written while it has its default is known to the configuration alone.
    let written = place.insert(name.to_owned(), value.clone()).is_some();
    serde_json::from_value(tree).map_err(|error| {
        let missing = !written && error.to_string().starts_with("unknown field");
        let what = if missing { unknown() } else { format!("--set {change}: {value} does not fit {field}") };
        anyhow::Error::new(error).context(what)
    })
}

/// Prints `facts` on the last line when they are asked for.
///
/// # Errors
/// None today; the signature lets commands end with it. That a line could not be written says [`motionette_host::console::finish`].
pub fn finish(json: bool, facts: &Value) -> anyhow::Result<()> {
    if json {
        say(&facts.to_string());
    }
    Ok(())
}
