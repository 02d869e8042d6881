//! What each step of quantisation buys: decodes the same tokens with the f32 decoder and with the decoder that the integers stand for.
//!
//! `cargo run --release -p motionette-host --example quantisation -- models/nano.safetensors data/pack.mds docs/results/quantisation.md`

use std::fmt::Write;
use std::path::Path;

use anyhow::{Context, Result, bail};
use motionette_host::agreement::Agreement;
use motionette_host::checkpoint::{self, TokenizerCheckpoint};
use motionette_host::convert::{self, Options, ROOT_ROWS, Rounding, calibration, decoder};
use motionette_host::dataset::{Dataset, Split};
use motionette_host::motion::Pose;
use motionette_host::output::write_atomic;
use motionette_host::parallel;
use motionette_host::reference::{DecodePath, Quantizer};
use motionette_host::verify;

/// Test clips decoded.
const CLIPS: usize = 100;

struct Bench {
    checkpoint: TokenizerCheckpoint,
    calibration: Vec<Vec<f32>>,
    /// Latents of test clips and what the f32 decoder makes of them.
    tests: Vec<(String, Vec<f32>, Vec<Pose>)>,
}

impl Bench {
    fn row(&self, name: &str, wide: usize, options: &Options) -> Result<String> {
        let layers = decoder::quantise(&self.checkpoint.decoder, wide, options, &self.calibration, |_| ());
        let weights = decoder::dequantised(&self.checkpoint.decoder, &layers);
        let decode_path = DecodePath::<f32>::new(&TokenizerCheckpoint { decoder: weights, ..self.checkpoint.clone() })?;
        let decoded = parallel::map(&self.tests, |(_, u, _)| decode_path.forward(u).joints);
        let mut a = Agreement::default();
        for ((id, _, exact), joints) in self.tests.iter().zip(&decoded) {
            a.add(id, joints, exact);
        }
        a.finish();
        let figures = [a.mean_mm, a.p99_mm, a.max_mm, a.drift_mean_mm, a.drift_p95_mm];
        let cells: Vec<String> = figures.iter().map(|v| format!("{v:.2}")).collect();
        eprintln!("{name}: {}", cells.join(" "));
        Ok(format!("| {name} | {} |\n", cells.join(" | ")))
    }
}

fn main() -> Result<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [checkpoint, dataset, output] = &arguments[..] else {
        bail!("give a checkpoint, a dataset and the table to write");
    };
    let checkpoint = checkpoint::load(Path::new(checkpoint))?;
    let dataset = Dataset::load(dataset)?;
    let sequences = verify::sequences(&checkpoint, &dataset, Split::Test, CLIPS, convert::MAX_TOKENS)?;
    let quantizer = Quantizer::<f32>::new(&checkpoint.codebooks, checkpoint.config.code_dim);
    let decode_path = DecodePath::<f32>::new(&checkpoint)?;
    let tests = sequences.iter().map(|s| -> Result<_> {
        let ids: Vec<i64> = s.tokens.iter().map(|&t| i64::from(t)).collect();
        let u = quantizer.decode(&ids)?;
        let joints = decode_path.forward(&u).joints;
        Ok((s.id.clone(), u, joints))
    });
    let tests = tests.collect::<Result<Vec<_>>>()?;
    let calibration = calibration::from_dataset(&checkpoint, &dataset)?;
    let bench = Bench { checkpoint, calibration, tests };

    let all = Options::default();
    let rows = [
        ("int8 everywhere, to nearest", 0, Options::PLAIN),
        ("root rows int16, to nearest", ROOT_ROWS, Options::PLAIN),
        ("+ bias correction", ROOT_ROWS, Options { bias_correction: true, ..Options::PLAIN }),
        ("+ scales of least cost", ROOT_ROWS, Options { rounding: Rounding::Clipped, refit: false, ..all }),
        ("error feedback alone", ROOT_ROWS, Options { refit: false, bias_correction: false, ..all }),
        ("error feedback + bias correction", ROOT_ROWS, Options { refit: false, ..all }),
        ("to nearest + refit", ROOT_ROWS, Options { rounding: Rounding::Nearest, ..all }),
        ("**error feedback + refit + bias correction** (default)", ROOT_ROWS, all),
        ("the same, root rows int8", 0, all),
    ];
    let mut table = String::new();
    let clips = bench.tests.len();
    writeln!(table, "# What each step of quantisation buys\n")?;
    writeln!(
        table,
        "{clips} test clips, {} calibration sequences from the train split; reference arithmetic, so that weights alone are measured. \
         Millimetres against the f32 decoder on the same tokens; drift is that of the root at the end of 5 s. Made by \
         `cargo run --release -p motionette-host --example quantisation`.\n",
        bench.calibration.len()
    )?;
    writeln!(table, "| weights | joint error, mean | 99th percentile | largest | drift, mean | 95th percentile |")?;
    writeln!(table, "|---|---|---|---|---|---|")?;
    for (name, wide, options) in rows {
        table.push_str(&bench.row(name, wide, &options)?);
    }
    write_atomic(output, |w| w.write_all(table.as_bytes())).context("writing the table")?;
    Ok(())
}
