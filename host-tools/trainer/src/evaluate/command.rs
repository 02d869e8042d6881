//! `motionette-train evaluate`: measures generated motion and writes the table.

use std::path::PathBuf;

use anyhow::{Context, ensure};
use motionette::Model;
use motionette::representation::rigid::Body;
use motionette_host::blob::BlobFile;
use motionette_host::checkpoint::file_hash;
use motionette_host::console::remark;
use motionette_host::dataset::{Dataset, Split};
use motionette_host::motion::Pose;
use motionette_host::motion::features::{Bones, Options, extract};
use motionette_host::motion::mirror::mirror_joints;
use motionette_host::{metrics, parallel};

use super::codec::Codec;
use super::control::bench::{Bench, Store};
use super::control::page::Page;
use super::control::tables::Course;
use super::figures::Yardstick;
use super::prior::Generate;
use super::prompt;
use super::prompt::Motion;
use super::report::{self, Facts};
use super::sample::judged;
use super::{generators, obstacles, prior, prompts, real};
use crate::control;
use crate::control::frozen::Frozen;
use crate::control::sampling::Planner;
use crate::evaluator::judge::Judge;
use crate::harness::options::finish;
use crate::tokenizer::config::{FEATURES, FRAMES_PER_TOKEN};

/// Which table.
#[derive(clap::ValueEnum, Clone, Copy, Debug, PartialEq, Eq)]
pub enum Table {
    /// Text to motion: real motion, tokenizer, f32 reference, int8 runtime, shuffled text.
    Prior,
    /// Anchors, own and foreign: the controlled generator, exact, quasi-Newton steps, RouteSolver at 200 and 500.
    Frontier,
    /// Controls trained in different ways (give them with --control), without refinement.
    Components,
    /// Plain updates, interval basis with uniform activity, RouteSolver.
    Refinement,
    /// RouteSolver's basis and activity taken apart.
    Mechanism,
    /// Six joints: prior with solver, controlled generator, both.
    Sparse,
    /// Tracks of a joint, and of several, at 1, 2 and 5 frames, a quarter and all of them: the planner alone, and with the edit.
    Density,
    /// Seconds, decoder evaluations and work of a sample, one thread.
    Runtime,
    /// Obstacles in the way, at rest and moving: collisions, goals reached (the scenes of --scenes).
    Obstacles,
    /// Of which strain to warn: of the validation split, whose actions are lost when motions are edited onto anchors.
    Strain,
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
    #[arg(long, value_enum, required_unless_present = "prompts")]
    pub table: Option<Table>,
    /// Judges the motions of these prompts instead: lines of {"text", "actions", "styles"}.
    #[arg(long, value_name = "FILE", conflicts_with = "table")]
    pub prompts: Option<PathBuf>,
    /// The table of actions, for prompts.
    #[arg(long, value_name = "FILE", default_value = "docs/actions.toml")]
    pub actions: PathBuf,
    /// The phrases that text encoders are trained with, for prompts.
    #[arg(long, value_name = "FILE", default_value = "docs/phrases.toml")]
    pub phrases: PathBuf,
    /// Dataset file.
    #[arg(long, value_name = "FILE", default_value = "data/pack2.mds")]
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
    /// Motions for every caption; 5 for the prior's table, which needs 2 at least, 3 for the others and for prompts.
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..))]
    pub seeds: Option<u64>,
    /// Uses only so many captions or prompts, spread evenly; 100 for the tables of anchors.
    #[arg(long, value_name = "COUNT", value_parser = clap::value_parser!(u64).range(2..))]
    pub limit: Option<u64>,
    /// A trained control for the table of components, several times; as it is named there and its checkpoint.
    #[arg(long, value_name = "NAME=FILE")]
    pub control: Vec<String>,
    /// Where motions of the tables of anchors are kept, so that a long table can go on.
    #[arg(long, value_name = "FILE", default_value = "data/evaluate/control.jsonl")]
    pub store: PathBuf,
    /// Scenes for the table of obstacles; drawn for the blob and written where there is no such file.
    #[arg(long, value_name = "FILE", default_value = "docs/obstacle-scenes.jsonl")]
    pub scenes: PathBuf,
    /// Instructions of a Cortex-M7 a multiply-accumulate, for the table of the runtime.
    #[arg(long, default_value_t = 1.21)]
    pub instructions_per_mac: f64,
    /// Prints the table's JSON on the last line.
    #[arg(long)]
    pub json: bool,
}

impl Args {
    /// How much is measured, and of what, as far as the command line says so.
    pub(super) fn chosen(&self) -> String {
        let mut flags = String::new();
        for (flag, value) in [("--seeds", self.seeds), ("--limit", self.limit)] {
            flags += &value.map_or_else(String::new, |value| format!(" {flag} {value}"));
        }
        self.control.iter().for_each(|control| flags += &format!(" --control {control}"));
        flags
    }
}

/// Runs the command.
///
/// # Errors
/// Anything that is wrong with arguments, files or generators, with context.
pub fn run(args: &Args) -> anyhow::Result<()> {
    if let Some(file) = &args.prompts {
        return prompts::command::run(args, file);
    }
    let table = args.table.context("give --table or --prompts")?;
    if table == Table::Obstacles {
        return obstacles(args);
    }
    let dataset = Dataset::load(&args.data)?;
    let judge = Judge::load(&args.evaluator)
        .context("the evaluator cannot be used; make one with motionette-train evaluator")?;
    let codec = Codec::load(&args.tokenizer)?;
    if table != Table::Prior {
        return anchored(args, table, &dataset, &judge, &codec);
    }
    let seeds = args.seeds.unwrap_or(5);
    ensure!(seeds >= 2, "--seeds {seeds}: the prior's table compares motions of one caption, give 2 or more");
    remark("tokens of the training split");
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
    let bench = prior::Bench {
        judge: &judge,
        codec: &codec,
        dataset: &dataset,
        training: &training,
        generators: &generators,
        seeds,
    };
    let limit = args.limit.map_or(usize::MAX, |count| usize::try_from(count).unwrap_or(usize::MAX));
    let tables = bench.tables(limit, &remark)?;
    let facts = Facts {
        seeds,
        files: hashes(&files)?,
        command: format!("motionette-train evaluate --table prior{}", args.generation.flags()),
        generation: args.generation.facts(),
    };
    report::save(&args.out, &tables, &facts)?;
    remark(&args.out.join("prior.md").display().to_string());
    finish(args.json, &report::json(&tables, &facts))
}

/// The table of obstacles.
fn obstacles(args: &Args) -> anyhow::Result<()> {
    let facts = Facts {
        seeds: 1,
        files: hashes(&[&args.blob])?,
        command: "motionette-train evaluate --table obstacles".into(),
        generation: args.generation.facts(),
    };
    let table = obstacles::table(&BlobFile::open(&args.blob)?, &args.scenes, &facts, &args.out)?;
    remark(&args.out.join("obstacles.md").display().to_string());
    finish(args.json, &table)
}

/// The tables of anchor control.
fn anchored(args: &Args, table: Table, dataset: &Dataset, judge: &Judge, codec: &Codec) -> anyhow::Result<()> {
    let seeds = args.seeds.unwrap_or(3);
    let limit = args.limit.map_or(100, |count| usize::try_from(count).unwrap_or(usize::MAX));
    let mut files = vec![&args.data, &args.evaluator, &args.tokenizer, &args.blob];
    // Choices are made on other clips than figures.
    let split = if table == Table::Strain { Split::Val } else { Split::Test };
    let mut chosen = prompt::prompts(dataset, split);
    if limit < chosen.len() {
        chosen = (0..limit).map(|i| chosen[i * chosen.len() / limit].clone()).collect();
    }
    let clips = prompt::composition(dataset, &chosen, split);
    let real = real::motions(dataset, &chosen, codec)?;
    let captions: Vec<&str> = chosen.iter().map(|prompt| prompt.caption.as_str()).collect();
    let yardstick = Yardstick {
        texts: judge.texts(&captions),
        real: judged(judge, &chosen, &real, &[])?.into_iter().map(|motion| motion.embedding).collect(),
        rounds: seeds as usize,
        prompts: chosen,
    };
    let controls = args.control.iter().map(|text| {
        let (name, file) = text.split_once('=').with_context(|| format!("--control {text}: write NAME=FILE"))?;
        Ok((name.to_owned(), PathBuf::from(file)))
    });
    let controls: Vec<(String, PathBuf)> = controls.collect::<anyhow::Result<_>>()?;
    let mut planners = Vec::new();
    for (name, file) in &controls {
        let frozen = Frozen::load(&args.prior, &args.tokenizer)?;
        let prior = control::state::Sources::of(&dataset.hash, &frozen).prior;
        let trained = control::checkpoint::load(file, &frozen, &prior)
            .with_context(|| format!("the control {} cannot be used", file.display()))?;
        let key = format!("{name}@{}", file_hash(file)?);
        planners.push((key, Planner::new(frozen, Some(trained))));
        files.push(file);
    }
    let blob = BlobFile::open(&args.blob)?;
    let (real, moved) = targets(&blob.model()?, &real);
    // What was judged by another judge, or of another split, is another group.
    let (blob_hash, judge_hash) = (file_hash(&args.blob)?, file_hash(&args.evaluator)?);
    let identity = format!("{blob_hash} {} {split} {} {judge_hash} {:?}", dataset.hash, real.len(), args.generation);
    let store = Store::open(&args.store)?;
    let mut bench =
        Bench { judge, yardstick, real, blob: &blob, identity, planners, generation: args.generation, store };
    let course = Course { seeds, say: &remark };
    let (name, title, entries) = match table {
        Table::Prior | Table::Obstacles => return Ok(()),
        Table::Frontier => ("frontier", "What refinement makes of anchors", bench.frontier(&course)?),
        Table::Components => ("components", "How anchors reach the planner", bench.components(&course)?),
        Table::Refinement => ("refinement", "Ways to refine", bench.refinement(&course)?),
        Table::Mechanism => ("mechanism", "RouteSolver taken apart", bench.mechanism(&course)?),
        Table::Sparse => ("sparse", "Six joints at five frames", bench.sparse(&course)?),
        Table::Density => ("density", "Joints on tracks", bench.density(&course)?),
        Table::Strain => ("strain", "Of which strain to warn", bench.strain(&course)?),
        Table::Runtime => ("runtime", "What a sample costs", bench.runtime(&course, args.instructions_per_mac)?),
    };
    let notes = format!(
        "{}, of their own lengths, seeds: {seeds}; anchors are places at random frames, the same for every row: of the \
         clip itself (own), or of another one of about the same length and another label from the same start and heading (foreign), either put on the \
         model's skeleton first, which moves a joint by {:.1} cm on average. All rows are the int8 runtime's but those of `components` that name a control, which are the trainer's f32 \
         networks. Figures are means with half the width of a 95 % bootstrap interval over the clips. {}",
        clips,
        100.0 * moved,
        remarks(table)
    );
    let facts = Facts {
        seeds,
        files: hashes(&files)?,
        command: format!("motionette-train evaluate --table {name}{}{}", args.chosen(), args.generation.flags()),
        generation: args.generation.facts(),
    };
    let page = Page { name, title, notes, entries: &entries, facts: &facts };
    page.save(&args.out)?;
    remark(&args.out.join(format!("{name}.md")).display().to_string());
    finish(args.json, &page.json())
}

/// Real motions with the model's bones, and how far that moves a joint on average, metres.
fn targets(model: &Model<'_>, real: &[Motion]) -> (Vec<Vec<Pose>>, f64) {
    let body = Body::new(&model.skeleton().offsets());
    let posed: Vec<Vec<Pose>> =
        real.iter().map(|motion| motion.joints.iter().map(|pose| body.posed(pose)).collect()).collect();
    let moved = posed.iter().zip(real).map(|(posed, motion)| metrics::mpjpe(posed, &motion.joints));
    let mean = moved.sum::<f64>() / real.len().max(1) as f64;
    (posed, mean)
}

/// What a table's reader should know.
fn remarks(table: Table) -> &'static str {
    match table {
        Table::Prior | Table::Obstacles => "",
        Table::Frontier => {
            "`generator`: the controlled generator alone. `exact`: the edit in motion space, the default. `fast20`: quasi-Newton steps, 20 \
             decoder evaluations. `rs200`, `rs500`: RouteSolver as published with so many Adam steps. Means are over 2, 4, 8, 16 \
             and 32 anchors, those of RouteSolver over 2, 8 and 32. What works in the decoder is measured on its joints, as it is published; all \
             else has rigid bones."
        }
        Table::Components => {
            "Means over the three families and 2, 8 and 32 anchors, no refinement. `prior` does not know the anchors; `runtime` is \
             the shipped int8 model, which was trained for longer. Intervals are over clips and overlap: \
             the same clips turn or do not turn in every row."
        }
        Table::Refinement => "200 Adam steps each; means over 2, 8 and 32 anchors.",
        Table::Mechanism => "Body points, 200 Adam steps each; means over 2, 8 and 32 anchors.",
        Table::Strain => {
            "The edit in motion space on generated motions, all three families, 2, 8 and 32 anchors. *Warned*: share of all requests. *Actions lost*: of \
             the motions that the evaluator took for their action as they were generated, those that it takes for another one as they were \
             edited. Intervals are 1.96 standard errors."
        }
        Table::Density => {
            "Numbers are frames (1, 2, 5) or percent of them (25, 100); a mean is over all five. `generator` is the planner, which sees up to 32 places of the tracks, \
             alone; `+exact` with the edit behind the decoder. *cross*: pelvis and right wrist at all frames, wrists at a quarter, pelvis and feet at all, head and wrists at five, \
             all six joints at all frames. *Trajectories missed*: motions with a place more than 50 cm off; *places missed*: those places."
        }
        Table::Sparse => "Pelvis, feet, head and hands at five random frames: 30 anchors.",
        Table::Runtime => {
            "Four anchors, two kinds; one thread. Work is planned multiply-accumulates, scaled to the evaluations that were made; \
             instructions are that work times --instructions-per-mac (1.21 for each planned one were counted for the standard \
             request in the image that M4 and M7 run: cargo xtask bench). Intervals here are 1.96 standard errors."
        }
    }
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

/// Names and SHA-256 of files.
pub(super) fn hashes(paths: &[&PathBuf]) -> anyhow::Result<Vec<(String, String)>> {
    let hash = |path: &&PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        Ok((name, file_hash(path)?))
    };
    paths.iter().map(hash).collect()
}
