//! `motionette-train evaluate`: measures generated motion and writes the table.

use std::path::PathBuf;

use anyhow::Context;
use motionette_host::checkpoint::file_hash;
use motionette_host::dataset::{Dataset, Split};
use motionette_host::motion::features::{Bones, Options, extract};
use motionette_host::motion::mirror::mirror_joints;
use motionette_host::parallel;

use super::codec::Codec;
use super::generators;
use super::prior::{Bench, Generate};
use super::report::{self, Facts};
use crate::evaluator::judge::Judge;
use crate::run::finish;
use crate::tokenizer::config::{FEATURES, FRAMES_PER_TOKEN};

/// Which table.
#[derive(clap::ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Table {
    /// Text to motion: real motion, tokenizer, f32 reference, int8 runtime, shuffled text.
    Prior,
}

/// Who generates motion.
#[derive(clap::ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Origin {
    /// Nobody.
    None,
    /// The f32 reference.
    Reference,
    /// The int8 runtime.
    Runtime,
}

/// Measures generated motion with the evaluator and writes the table as Markdown and JSON.
#[derive(clap::Args, Clone, Debug)]
pub struct Args {
    /// Which table.
    #[arg(long, value_enum)]
    pub table: Table,
    /// Dataset file.
    #[arg(long, value_name = "FILE", default_value = "data/pack.mds")]
    pub data: PathBuf,
    /// The evaluator's checkpoint.
    #[arg(long, value_name = "FILE", default_value = "models/evaluator.safetensors")]
    pub evaluator: PathBuf,
    /// The tokenizer's checkpoint.
    #[arg(long, value_name = "FILE", default_value = "models/nano.safetensors")]
    pub tokenizer: PathBuf,
    /// The prior's checkpoint, for the f32 reference.
    #[arg(long, value_name = "FILE", default_value = "models/nano.prior.safetensors")]
    pub prior: PathBuf,
    /// The quantised model, for the runtime.
    #[arg(long, value_name = "FILE", default_value = "models/nano.blob")]
    pub blob: PathBuf,
    /// Rows of generated motion that are made, `none` for none of them.
    #[arg(long, value_enum, value_delimiter = ',', default_value = "reference,runtime")]
    pub generate: Vec<Origin>,
    /// How motions are sampled.
    #[command(flatten)]
    pub generation: generators::Options,
    /// Folder of the table.
    #[arg(short, long, value_name = "FOLDER", default_value = "docs/results")]
    pub out: PathBuf,
    /// Motions for every caption, at least 2.
    #[arg(long, default_value_t = 5, value_parser = clap::value_parser!(u64).range(2..))]
    pub seeds: u64,
    /// Uses only so many captions, spread evenly.
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u64).range(2..))]
    pub limit: Option<u64>,
    /// Prints the table's JSON on the last line.
    #[arg(long)]
    pub json: bool,
}

/// Runs the command.
///
/// # Errors
/// Anything that is wrong with arguments, files or generators, with context.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let dataset = Dataset::load(&args.data)?;
    let judge = Judge::load(&args.evaluator)
        .context("the evaluator cannot be used; make one with motionette-train evaluator")?;
    let codec = Codec::load(&args.tokenizer)?;
    eprintln!("tokens of the training split");
    let training = training_tokens(&dataset, &codec);
    let mut files = vec![&args.data, &args.evaluator, &args.tokenizer];
    let mut generators: Vec<(&str, Box<Generate<'_>>)> = Vec::new();
    if args.generate.contains(&Origin::Reference) {
        files.push(&args.prior);
        generators.push(("reference", generators::reference(&args.prior, &args.tokenizer, args.generation)?));
    }
    if args.generate.contains(&Origin::Runtime) {
        files.push(&args.blob);
        generators
            .push(("runtime", generators::runtime(&args.blob, &[&args.tokenizer, &args.prior], args.generation)?));
    }
    let bench = Bench {
        judge: &judge,
        codec: &codec,
        dataset: &dataset,
        training: &training,
        generators: &generators,
        seeds: args.seeds,
    };
    let limit = args.limit.map_or(usize::MAX, |count| usize::try_from(count).unwrap_or(usize::MAX));
    let tables = bench.tables(limit, &|text| eprintln!("{text}"))?;
    let facts = Facts {
        seeds: args.seeds,
        files: hashes(&files)?,
        command: format!("motionette-train evaluate --table prior{}", args.generation.flags()),
        generation: args.generation.facts(),
    };
    report::save(&args.out, &tables, &facts)?;
    eprintln!("{}", args.out.join("prior.md").display());
    finish(args.json, &report::json(&tables, &facts))
}

/// Token sequences of the training split and of its mirrored twins, begun at each frame of a token.
fn training_tokens(dataset: &Dataset, codec: &Codec) -> Vec<Vec<u16>> {
    let clips: Vec<_> = dataset.split(Split::Train).collect();
    let options = Options { bones: Bones::Keep, ..Options::default() };
    let twins = parallel::map(&clips, |clip| extract(&mirror_joints(clip.joints), &options).unwrap_or_default());
    let motions: Vec<&[f32]> = clips.iter().map(|clip| clip.features).chain(twins.iter().map(Vec::as_slice)).collect();
    let begun = |features: &[f32], frame: usize| codec.encode(features.get(frame * FEATURES..).unwrap_or_default());
    motions.iter().flat_map(|features| (0..FRAMES_PER_TOKEN).map(|frame| begun(features, frame))).collect()
}

fn hashes(paths: &[&PathBuf]) -> anyhow::Result<Vec<(String, String)>> {
    let hash = |path: &&PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Ok((name, file_hash(path)?))
    };
    paths.iter().map(hash).collect()
}
