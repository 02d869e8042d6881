//! What was measured, as a table, a page and one JSON object.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use anyhow::{Context, Result};
use serde::Serialize;

use crate::timing::quantile;

/// Instruction sets that the runtime has its widest kernels for.
const AVX2: &str = "AVX2";
const VNNI: &str = "AVX-512 VNNI";
const AVX_VNNI: &str = "AVX-VNNI";

/// Who computes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Library {
    /// The int8 runtime.
    Ours,
    /// candle in f32.
    Candle,
    /// tract in f32.
    Tract,
}

/// Timings of one contender.
pub struct Timed {
    /// Who.
    pub library: Library,
    /// How it computes, where a library has several ways.
    pub how: &'static str,
    /// Seconds a run, one a round.
    pub seconds: Vec<f64>,
}

/// One line of the table. Times are medians over rounds; a library with several ways counts by its fastest.
#[derive(Debug, Serialize)]
pub struct Row {
    /// Short name.
    pub name: &'static str,
    /// What was run.
    pub what: String,
    /// The runtime.
    pub ours_ms: f64,
    /// candle.
    pub candle_ms: f64,
    /// tract.
    pub tract_ms: f64,
    /// Time of the faster peer / ours: median over rounds.
    pub ratio: f64,
    /// 95 % of the rounds lie between these.
    pub ratio_range: [f64; 2],
    /// The faster peer.
    pub faster_peer: &'static str,
    /// Rounds.
    pub rounds: usize,
    /// Every way that was timed, milliseconds.
    pub ways_ms: BTreeMap<String, f64>,
}

impl Row {
    /// Sums timings up.
    ///
    /// # Errors
    /// When a library is missing.
    pub fn new(name: &'static str, what: String, timed: &[Timed]) -> Result<Self> {
        let median = |t: &Timed| 1e3 * quantile(&t.seconds, 0.5);
        let fastest = |library: Library| {
            let ways = timed.iter().filter(|t| t.library == library);
            ways.min_by(|a, b| median(a).total_cmp(&median(b))).with_context(|| format!("{library:?} was not timed"))
        };
        let (ours, candle, tract) = (fastest(Library::Ours)?, fastest(Library::Candle)?, fastest(Library::Tract)?);
        let (faster_peer, peer) = if median(candle) < median(tract) { ("candle", candle) } else { ("tract", tract) };
        let ratios: Vec<f64> = peer.seconds.iter().zip(&ours.seconds).map(|(peer, ours)| peer / ours).collect();
        Ok(Self {
            name,
            what,
            ours_ms: median(ours),
            candle_ms: median(candle),
            tract_ms: median(tract),
            ratio: quantile(&ratios, 0.5),
            ratio_range: [quantile(&ratios, 0.025), quantile(&ratios, 0.975)],
            faster_peer,
            rounds: ratios.len(),
            ways_ms: timed.iter().map(|t| (t.how.to_owned(), median(t))).collect(),
        })
    }
}

/// A result held against the f32 reference before anything was timed.
#[derive(Debug, Serialize)]
pub struct Check {
    /// Who and how.
    pub how: String,
    /// What.
    pub result: &'static str,
    /// Largest absolute difference.
    pub difference: f64,
    /// Largest magnitude of the reference.
    pub largest: f64,
}

/// The machine and the build.
#[derive(Debug, Serialize)]
pub struct Machine {
    /// Model of the processor, as the system names it.
    pub cpu: String,
    /// Instruction sets that matter here and that it has.
    pub instructions: Vec<&'static str>,
    /// `RUSTFLAGS` of the build.
    pub rustflags: &'static str,
    /// Versions of the libraries, as locked.
    pub versions: BTreeMap<&'static str, String>,
    /// Threads.
    pub threads: usize,
}

impl Machine {
    /// This one.
    #[must_use]
    pub fn here() -> Self {
        let field = |text: &str, key: &str| {
            text.lines()
                .find_map(|line| line.split_once(':').filter(|(k, _)| k.trim() == key))
                .map(|(_, v)| v.trim().to_owned())
        };
        let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
        let [name, family, model] =
            ["model name", "cpu family", "model"].map(|key| field(&info, key).unwrap_or_else(|| "unknown".into()));
        let versions = ["candle-core", "candle-nn", "gemm", "tract-core"].map(|name| (name, locked(name)));
        Self {
            cpu: format!("{name}, family {family}, model {model}"),
            instructions: instructions(),
            rustflags: option_env!("RUSTFLAGS").unwrap_or(""),
            versions: versions.into(),
            threads: 1,
        }
    }

    /// Name of the report's files: machines whose widest kernels differ have one each.
    #[must_use]
    pub fn report(&self) -> &'static str {
        let has = |name| self.instructions.contains(&name);
        match [VNNI, AVX_VNNI, AVX2].map(has) {
            [true, ..] => "desktop",
            [_, true, _] => "desktop-avxvnni",
            [.., true] => "desktop-avx2",
            _ => "desktop-portable",
        }
    }
}

#[cfg(target_arch = "x86_64")]
fn instructions() -> Vec<&'static str> {
    let all = [
        (AVX2, is_x86_feature_detected!("avx2")),
        ("FMA", is_x86_feature_detected!("fma")),
        ("AVX-512F", is_x86_feature_detected!("avx512f")),
        (VNNI, is_x86_feature_detected!("avx512vnni")),
        (AVX_VNNI, is_x86_feature_detected!("avxvnni")),
    ];
    all.into_iter().filter_map(|(name, has)| has.then_some(name)).collect()
}

#[cfg(not(target_arch = "x86_64"))]
fn instructions() -> Vec<&'static str> {
    Vec::new()
}

/// Version of a package in this program's lock file.
fn locked(name: &str) -> String {
    let lock = include_str!("../Cargo.lock");
    let version =
        lock.split_once(&format!("name = \"{name}\"\nversion = \"")).and_then(|(_, rest)| rest.split_once('"'));
    version.map_or_else(|| "unknown".to_owned(), |(version, _)| version.to_owned())
}

/// Everything.
#[derive(Debug, Serialize)]
pub struct Report {
    /// The table.
    pub desktop: Vec<Row>,
    /// What was checked first.
    pub checks: Vec<Check>,
    /// Where.
    pub machine: Machine,
}

impl Report {
    /// The table in markdown.
    #[must_use]
    pub fn table(&self) -> String {
        let mut text = String::from(
            "| what | ours, ms | candle, ms | tract, ms | ratio | 95 % of rounds | rounds |\n|---|---|---|---|---|---|---|\n",
        );
        for row in &self.desktop {
            let Row {
                name, ours_ms, candle_ms, tract_ms, ratio, ratio_range: [low, high], faster_peer, rounds, ..
            } = row;
            let _ = writeln!(
                text,
                "| {name} | {ours_ms:.3} | {candle_ms:.3} | {tract_ms:.3} | {ratio:.2} ({faster_peer}) | {low:.2} to {high:.2} | {rounds} |"
            );
        }
        text
    }

    /// A page for people.
    #[must_use]
    pub fn page(&self) -> String {
        let Machine { cpu, instructions, rustflags, versions, .. } = &self.machine;
        let versions: Vec<String> = versions.iter().map(|(name, version)| format!("{name} {version}")).collect();
        let mut text = format!(
            "# Desktop speed against other libraries\n\n\
             Made by `cargo xtask bench --desktop --out docs/results`. The int8 runtime against candle and tract in f32, same topology, \
             same weights before quantisation, same length (49 tokens, 196 frames), one thread each. ratio = time of the faster peer / \
             ours; above 1 the runtime is faster.\n\n{}\n",
            self.table()
        );
        for Row { name, what, .. } in &self.desktop {
            let _ = writeln!(text, "- **{name}**: {what}");
        }
        let _ = write!(
            text,
            "\n## How\n\n\
             - {cpu} ({}); `RUSTFLAGS={rustflags}`; {}. The runtime needs no flags: it chooses its kernels when it runs.\n\
             - One thread: `RAYON_NUM_THREADS=1`, candle without mkl or accelerate, tract's executor `SingleThread`. candle's matrix \
             products use AVX-512 where there is one (gemm's feature `x86-v4`), which is off unless asked for; tract chooses its \
             kernels when it runs.\n\
             - Rounds are paired: all contenders run in turn in every round, in changing order. Times are processor \
             time of the whole process, medians over the rounds; ratios are formed in each round.\n\
             - A peer with several ways counts by its fastest. candle: its convolution operator, or one matrix product over the taps \
             side by side; gradients by its autograd, or by hand as convolutions with the taps reversed (its autograd computes the \
             gradients of the weights too, nobody can switch that off). tract has no autograd: forward and gradient are one graph \
             wired by hand.\n\
             - Ours takes 24 rows at a time (`Generator::set_rows`), for which a desktop has the memory; a firmware takes 8 unless \
             told otherwise.\n\
             - In the peers' favour: inputs lie ready in their own layout, embeddings are added up and the text is encoded beforehand. \
             Ours does all that within its time where the row needs it.\n\n\
             ## Every way, milliseconds\n\n| row | way | ms |\n|---|---|---|\n",
            instructions.join(", "),
            versions.join(", "),
        );
        for row in &self.desktop {
            for (way, ms) in &row.ways_ms {
                let _ = writeln!(text, "| {} | {way} | {ms:.3} |", row.name);
            }
        }
        text.push_str("\n## Checked first, against the f32 reference\n\n| who | result | largest difference | largest magnitude |\n|---|---|---|---|\n");
        for Check { how, result, difference, largest } in &self.checks {
            let _ = writeln!(text, "| {how} | {result} | {difference:.1e} | {largest:.2} |");
        }
        text.push_str(
            "\nA peer that differs by more than 0.001 (of the largest magnitude, where that is above 1) is not timed: the command fails. \
             The runtime's differences are those of its quantisation.\n",
        );
        text
    }
}
