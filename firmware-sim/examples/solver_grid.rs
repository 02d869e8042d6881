//! The grid behind the solver's numbers: control error and quality on val clips for each family of anchors.
//!
//! Clips are encoded, some tokens are replaced at random, and anchors are taken from the recording itself, so the solver
//! has to undo what the wrong tokens did. Everything runs on the int8 runtime.
//!
//! ```sh
//! cargo run --release -p motionette-sim --example solver_grid -- --dataset data/pack.mds
//! ```

use clap::Parser;
use motionette::numerics::hash::Stream;
use motionette::refining::{Config, PerFamily};
use motionette::{Anchor, Request};
use motionette_host::blob::BlobFile;
use motionette_host::dataset::{Dataset, Split};
use motionette_host::reference::{Tokenizer, bridge};
use motionette_host::{checkpoint, metrics, parallel};
use motionette_sim::session;
use std::path::PathBuf;

/// Tries learning rates and ridges of RouteSolver as published, and budgets of the fast default.
#[derive(Debug, Parser)]
struct Arguments {
    /// Dataset whose val split is used.
    #[arg(long)]
    dataset: PathBuf,
    /// Checkpoint with the encoder.
    #[arg(long, default_value = "models/nano.safetensors")]
    checkpoint: PathBuf,
    /// Model.
    #[arg(long, default_value = "models/nano.blob")]
    blob: PathBuf,
    /// Clips.
    #[arg(long, default_value_t = 8)]
    clips: usize,
    /// Tokens of each clip.
    #[arg(long, default_value_t = 25)]
    tokens: usize,
    /// Anchors of each request.
    #[arg(long, default_value_t = 8)]
    anchors: usize,
    /// Share of tokens that are replaced.
    #[arg(long, default_value_t = 0.15)]
    corruption: f32,
    /// Steps of RouteSolver as published.
    #[arg(long, default_value_t = 200)]
    steps: u16,
    /// Learning rates to try.
    #[arg(long, value_delimiter = ',', default_value = "0.01,0.02,0.05,0.1")]
    rates: Vec<f32>,
    /// Ridges to try.
    #[arg(long, value_delimiter = ',', default_value = "0.3,1,3")]
    ridges: Vec<f32>,
}

/// A request whose answer is the recording.
struct Problem {
    tokens: Vec<u16>,
    anchors: Vec<Anchor>,
}

/// Means over the problems of one cell of the grid.
#[derive(Default)]
struct Cell {
    before_cm: f64,
    after_cm: f64,
    evaluations: f64,
    distance: f64,
    jerk: f64,
    skating: f64,
}

const FAMILIES: [&str; 3] = ["root", "planar", "body"];

fn main() -> anyhow::Result<()> {
    let arguments = Arguments::parse();
    let dataset = Dataset::load(&arguments.dataset)?;
    let blob = BlobFile::open(&arguments.blob)?;
    let tokenizer = Tokenizer::<f32>::new(&checkpoint::load(&arguments.checkpoint)?);
    println!("| family | solver | before, cm | after, cm | evaluations | distance | jerk | foot skating |");
    println!("|---|---|---|---|---|---|---|---|");
    for (family, name) in FAMILIES.iter().enumerate() {
        let problems = problems(&arguments, &dataset, &blob, &tokenizer, family)?;
        for budget in [10, 20, 40] {
            report(name, &format!("fast {budget}"), &measure(&blob, &problems, Config::fast(budget))?);
        }
        for &rate in &arguments.rates {
            for &ridge in &arguments.ridges {
                let learning_rate = PerFamily::all(rate);
                let config = Config { learning_rate, ridge, ..Config::published(arguments.steps) };
                let cell = measure(&blob, &problems, config)?;
                report(name, &format!("rs{} rate {rate} ridge {ridge}", arguments.steps), &cell);
            }
        }
    }
    Ok(())
}

/// Val clips with replaced tokens and anchors from the recording; wrists, head and feet for the body.
fn problems(
    arguments: &Arguments,
    dataset: &Dataset,
    blob: &BlobFile,
    tokenizer: &Tokenizer<f32>,
    family: usize,
) -> anyhow::Result<Vec<Problem>> {
    let model = blob.model()?;
    let frames = arguments.tokens * model.frames_per_token();
    let codes = model.codebooks().codes() as u32;
    let long: Vec<_> = dataset.split(Split::Val).filter(|clip| clip.frames() >= frames).collect();
    let mut random = Stream::new(family as u64);
    let mut problems = Vec::new();
    for i in 0..arguments.clips.min(long.len()) {
        let clip = &long[i * long.len() / arguments.clips.min(long.len())];
        let columns = clip.features.len() / clip.frames();
        let ids = tokenizer.encode(&clip.features[..frames * columns])?;
        let mut tokens: Vec<u16> = ids.into_iter().map(bridge::runtime_token).collect();
        for token in &mut tokens {
            if random.unit() < arguments.corruption {
                *token = random.below(codes) as u16;
            }
        }
        let anchors = (0..arguments.anchors)
            .map(|k| {
                let frame = (k + 1) * frames / arguments.anchors - 1;
                let joint = [0, 0, [20, 21, 15, 10][k % 4]][family];
                let [x, y, z] = clip.joints[frame][joint];
                match family {
                    0 => Anchor::root(frame as u16, [x, y, z]),
                    1 => Anchor::planar_root(frame as u16, [x, z]),
                    _ => Anchor::joint(frame as u16, joint as u8, [x, y, z]),
                }
            })
            .collect();
        problems.push(Problem { tokens, anchors });
    }
    Ok(problems)
}

/// Runs all problems with one configuration.
fn measure(blob: &BlobFile, problems: &[Problem], config: Config) -> anyhow::Result<Cell> {
    let model = blob.model()?;
    let solved = parallel::map(problems, |problem| -> anyhow::Result<Cell> {
        let before = session::run(&model, &Request::tokens(&problem.tokens), |_| ())?;
        let request = Request::tokens(&problem.tokens).through(&problem.anchors).refined(config);
        let after = session::run(&model, &request, |_| ())?;
        let error = |joints: &[_]| 100.0 * metrics::control_error(joints, &problem.anchors).unwrap_or(f64::NAN);
        Ok(Cell {
            before_cm: error(&before.joints),
            after_cm: error(&after.joints),
            evaluations: after.refinement.map_or(0.0, |r| f64::from(r.evaluations)),
            distance: session::distance(&after.u, &before.u),
            jerk: metrics::jerk(&after.joints, 20.0),
            skating: metrics::foot_skating(&after.joints, 0.0),
        })
    });
    let mut mean = Cell::default();
    let share = 1.0 / problems.len().max(1) as f64;
    for cell in solved {
        let cell = cell?;
        mean.before_cm += share * cell.before_cm;
        mean.after_cm += share * cell.after_cm;
        mean.evaluations += share * cell.evaluations;
        mean.distance += share * cell.distance;
        mean.jerk += share * cell.jerk;
        mean.skating += share * cell.skating;
    }
    Ok(mean)
}

fn report(family: &str, solver: &str, cell: &Cell) {
    let Cell { before_cm, after_cm, evaluations, distance, jerk, skating } = cell;
    println!(
        "| {family} | {solver} | {before_cm:.1} | {after_cm:.2} | {evaluations:.0} | {distance:.1} | {jerk:.0} | {skating:.3} |"
    );
}
