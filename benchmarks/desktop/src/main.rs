//! Times the runtime, candle and tract on the same network, one thread each, side by side in one run.
//!
//! `cargo xtask bench --desktop` builds and runs it.

mod candle;
mod decoder;
mod engine;
mod network;
mod ours;
mod planner;
mod report;
mod timing;
mod tract;

use std::hint::black_box;
use std::path::PathBuf;
use std::time::Duration;

use anyhow::{Context, Result, bail};
use candle_core::{Device, Tensor, Var};
use clap::Parser;
use motionette::representation::humanml3d;
use motionette::{Model, Planning};
use motionette_host::blob::BlobFile;
use motionette_host::checkpoint::{self, PriorCheckpoint, TokenizerCheckpoint};
use motionette_host::output::write_atomic;
use tract_core::internal::{IntoTValue, TValue, Tensor as TractTensor, tvec};

use candle::{Candle, Form};
use network::{DecoderCase, PlannerCase, difference};
use report::{Check, Library, Machine, Report, Row, Timed};
use timing::{Contender, race};
use tract::{Runnable, Tract};

/// Largest difference between a peer and the reference.
const TOLERANCE: f64 = 1e-3;

/// Times the runtime, candle and tract on the same network.
#[derive(Parser)]
struct Options {
    /// The runtime's model.
    #[arg(long, value_name = "FILE", default_value = "models/nano.blob")]
    blob: PathBuf,
    /// Its f32 tokenizer, for the peers.
    #[arg(long, value_name = "FILE", default_value = "models/nano.safetensors")]
    checkpoint: PathBuf,
    /// Its f32 text encoder and planner, for the peers.
    #[arg(long, value_name = "FILE", default_value = "models/nano.prior.safetensors")]
    prior: PathBuf,
    /// Seconds a row is timed.
    #[arg(long, default_value_t = 15.0)]
    seconds: f64,
    /// Folder for desktop.md and desktop.json; without AVX-512 VNNI they are named desktop-avxvnni, without that desktop-avx2, without AVX2
    /// desktop-portable.
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Print one machine-readable object as the last line.
    #[arg(long)]
    json: bool,
}

fn main() -> Result<()> {
    // SAFETY: nothing has started another thread yet.
    unsafe { std::env::set_var("RAYON_NUM_THREADS", "1") };
    let options = Options::parse();
    let blob = BlobFile::open(&options.blob).with_context(|| format!("reading {}", options.blob.display()))?;
    let (tokenizer, prior) = (checkpoint::load(&options.checkpoint)?, checkpoint::prior::load(&options.prior)?);
    prior.check_tokenizer(&tokenizer)?;

    let bench = Bench {
        blob: &blob,
        model: blob.model()?,
        tokenizer,
        prior,
        budget: Duration::try_from_secs_f64(options.seconds)?,
    };
    let mut checks = Vec::new();
    let mut desktop = bench.decoder(&mut checks)?;
    let planner = bench.planner_peers(&mut checks)?;
    desktop.extend(bench.planner(&planner, &mut checks)?);
    desktop.push(bench.request(&planner, &mut checks)?);

    let report = Report { desktop, checks, machine: Machine::here() };
    println!("{}", report.page());
    if let Some(folder) = &options.out {
        let name = report.machine.report();
        write_atomic(folder.join(format!("{name}.md")), |to| to.write_all(report.page().as_bytes()))?;
        let json = serde_json::to_string_pretty(&report)?;
        write_atomic(folder.join(format!("{name}.json")), |to| writeln!(to, "{json}"))?;
    }
    if options.json {
        println!("{}", serde_json::to_string(&report)?);
    }
    Ok(())
}

/// What all rows share.
struct Bench<'b> {
    blob: &'b BlobFile,
    model: Model<'b>,
    tokenizer: TokenizerCheckpoint,
    prior: PriorCheckpoint,
    budget: Duration,
}

/// The decoder of a case in one of candle's forms.
struct CandleDecoder {
    engine: Candle,
    decoder: decoder::Decoder<Candle>,
    latent: Tensor,
    gradient: Tensor,
}

/// The decoder of a case in tract.
struct TractDecoder {
    forward: Runnable,
    /// Features and gradient.
    both: Runnable,
    latent: TValue,
    gradient: TValue,
}

/// The planner in both libraries.
struct PlannerPeers {
    case: PlannerCase,
    candle: planner::Planner<Candle>,
    rows: [Tensor; 2],
    tract: Runnable,
    inputs: [TValue; 2],
}

impl CandleDecoder {
    fn new(case: &DecoderCase, form: Form) -> Result<Self> {
        let mut engine = Candle(form);
        Ok(Self {
            decoder: decoder::Decoder::new(&mut engine, &case.weights)?,
            latent: engine.frames(&case.latent, case.width)?,
            gradient: engine.frames(&case.gradient, case.channels)?,
            engine,
        })
    }

    fn forward(&self) -> Result<Tensor> {
        Ok(self.decoder.forward(&mut { self.engine }, black_box(&self.latent))?.features)
    }

    fn gradient(&self) -> Result<Tensor> {
        let engine = &mut { self.engine };
        let pass = self.decoder.forward(engine, black_box(&self.latent))?;
        self.decoder.backward(engine, &pass, &self.gradient)
    }

    fn autograd(&self, latent: &Var) -> Result<Tensor> {
        { self.engine }.autograd(&self.decoder, black_box(latent), &self.gradient)
    }
}

impl TractDecoder {
    fn new(case: &DecoderCase) -> Result<Self> {
        let mut graph = Tract::default();
        let latent = graph.input([case.width, case.tokens])?;
        let decoder = decoder::Decoder::new(&mut graph, &case.weights)?;
        let pass = decoder.forward(&mut graph, &latent)?;
        let forward = graph.finish(&[pass.features])?;

        let mut graph = Tract::default();
        let latent = graph.input([case.width, case.tokens])?;
        let gradient = graph.input([case.channels, case.frames])?;
        let decoder = decoder::Decoder::new(&mut graph, &case.weights)?;
        let pass = decoder.forward(&mut graph, &latent)?;
        let back = decoder.backward(&mut graph, &pass, &gradient)?;
        let both = graph.finish(&[pass.features, back])?;

        let latent = tract::transposed(&case.latent, case.width)?.into_tvalue();
        let gradient = tract::transposed(&case.gradient, case.channels)?.into_tvalue();
        Ok(Self { forward, both, latent, gradient })
    }

    fn forward(&self) -> Result<TValue> {
        last(self.forward.run(tvec![black_box(&self.latent).clone()])?)
    }

    fn gradient(&self) -> Result<TValue> {
        last(self.both.run(tvec![black_box(&self.latent).clone(), self.gradient.clone()])?)
    }
}

fn last(mut outputs: tract_core::internal::TVec<TValue>) -> Result<TValue> {
    outputs.pop().context("a tract graph without output")
}

/// Numbers of a tract result `[channels][T]` as `[T][channels]`.
fn frames_of(value: &TValue) -> Result<Vec<f32>> {
    let turned = tract::transposed(&numbers_of(value)?, value.shape()[1])?;
    numbers_of(&turned.into_tvalue())
}

fn numbers_of(value: &TValue) -> Result<Vec<f32>> {
    let tensor: &TractTensor = value;
    Ok(tensor.to_plain_array_view::<f32>()?.iter().copied().collect())
}

/// Notes how far a result is from the reference. A peer must be near it.
fn check(
    checks: &mut Vec<Check>,
    library: Library,
    how: &str,
    result: &'static str,
    found: &[f32],
    expected: &[f32],
) -> Result<()> {
    let largest = expected.iter().fold(0.0, |most: f64, v| most.max(f64::from(v.abs())));
    let difference = difference(found, expected);
    eprintln!("{how}: {result} differ from the reference by at most {difference:.1e}, the largest is {largest:.2}");
    if library != Library::Ours && !(difference <= TOLERANCE * largest.max(1.0)) {
        bail!("{how} computes other {result} than the reference: they differ by {difference}");
    }
    checks.push(Check { how: how.to_owned(), result, difference, largest });
    Ok(())
}

/// Runs contenders in turn and sums them up.
fn row(name: &'static str, what: String, budget: Duration, contenders: Vec<(Library, Contender<'_>)>) -> Result<Row> {
    eprintln!("{name}: timing");
    let (libraries, mut contenders): (Vec<Library>, Vec<Contender<'_>>) = contenders.into_iter().unzip();
    let seconds = race(&mut contenders, budget)?;
    let timed: Vec<Timed> = libraries
        .into_iter()
        .zip(&contenders)
        .zip(seconds)
        .map(|((library, contender), seconds)| Timed { library, how: contender.name, seconds })
        .collect();
    Row::new(name, what, &timed)
}

/// Drops a result where the compiler cannot see it.
fn done<T>(result: Result<T>) -> Result<()> {
    result.map(|value| drop(black_box(value)))
}

impl Bench<'_> {
    fn decoder(&self, checks: &mut Vec<Check>) -> Result<Vec<Row>> {
        let channels = humanml3d::channels(u32::MAX);
        let case = DecoderCase::new(&self.tokenizer, &channels, self.model.max_tokens())?;
        let operator = CandleDecoder::new(&case, Form::Operator)?;
        let product = CandleDecoder::new(&case, Form::Product)?;
        let graph = TractDecoder::new(&case)?;
        let mut ours = ours::Decoder::new(&self.model, channels.clone())?;

        ours.forward(&case.latent)?;
        ours.backward(&case.gradient)?;
        check(checks, Library::Ours, "ours", "features", &ours.features, &case.features)?;
        check(checks, Library::Ours, "ours", "gradients", &ours.gradient, &case.latent_gradient)?;
        let variables = [Var::from_tensor(&operator.latent)?, Var::from_tensor(&product.latent)?];
        for (how, decoder, variable) in
            [("candle, operator", &operator, &variables[0]), ("candle, product", &product, &variables[1])]
        {
            let values = |tensor: &Tensor| decoder.engine.values(tensor);
            check(checks, Library::Candle, how, "features", &values(&decoder.forward()?)?, &case.features)?;
            check(checks, Library::Candle, how, "gradients", &values(&decoder.gradient()?)?, &case.latent_gradient)?;
            let autograd = values(&decoder.autograd(variable)?)?;
            check(checks, Library::Candle, &format!("{how}, autograd"), "gradients", &autograd, &case.latent_gradient)?;
        }
        check(checks, Library::Tract, "tract", "features", &frames_of(&graph.forward()?)?, &case.features)?;
        check(checks, Library::Tract, "tract", "gradients", &frames_of(&graph.gradient()?)?, &case.latent_gradient)?;

        let what = format!(
            "{} tokens to {} frames of the {} channels that joints depend on",
            case.tokens, case.frames, case.channels
        );
        let forward = row(
            "decoder_forward",
            format!("{what}."),
            self.budget,
            vec![
                (Library::Ours, Contender::new("ours", || ours.forward(black_box(&case.latent)))),
                (Library::Candle, Contender::new("candle, operator", || done(operator.forward()))),
                (Library::Tract, Contender::new("tract", || done(graph.forward()))),
                (Library::Candle, Contender::new("candle, product", || done(product.forward()))),
            ],
        )?;
        let mut ours_both = || {
            ours.forward(black_box(&case.latent))?;
            ours.backward(&case.gradient)
        };
        let gradient = row(
            "decoder_gradient",
            format!("{what}, and the gradient back to the tokens."),
            self.budget,
            vec![
                (Library::Ours, Contender::new("ours", &mut ours_both)),
                (Library::Candle, Contender::new("candle, operator", || done(operator.gradient()))),
                (
                    Library::Candle,
                    Contender::new("candle, operator, autograd", || done(operator.autograd(&variables[0]))),
                ),
                (Library::Tract, Contender::new("tract", || done(graph.gradient()))),
                (Library::Candle, Contender::new("candle, product", || done(product.gradient()))),
                (
                    Library::Candle,
                    Contender::new("candle, product, autograd", || done(product.autograd(&variables[1]))),
                ),
            ],
        )?;
        Ok(vec![forward, gradient])
    }

    fn planner_peers(&self, checks: &mut Vec<Check>) -> Result<PlannerPeers> {
        let guidance = Planning::DEFAULT.guidance;
        let case = PlannerCase::new(&self.prior, &self.tokenizer, ours::PROMPT, guidance, self.model.max_tokens())?;
        let memories = [&case.memories[0][..], &case.memories[1][..]];
        let shape = [case.rows[0].len() / case.width, case.width];

        let mut engine = Candle(Form::Product);
        let candle = planner::Planner::new(&mut engine, &self.prior, memories, guidance)?;
        let tensor = |rows: &[f32]| Tensor::from_slice(rows, (shape[0], shape[1]), &Device::Cpu);
        let rows = [tensor(&case.rows[0])?, tensor(&case.rows[1])?];

        let mut graph = Tract::default();
        let inputs = [graph.input(shape)?, graph.input(shape)?];
        let planner = planner::Planner::new(&mut graph, &self.prior, memories, guidance)?;
        let logits = planner.forward(&mut graph, [&inputs[0], &inputs[1]])?;
        let tract = graph.finish(&[logits])?;
        let value = |rows: &[f32]| TractTensor::from_shape(&shape, rows).map(IntoTValue::into_tvalue);
        let inputs = [value(&case.rows[0])?, value(&case.rows[1])?];

        let peers = PlannerPeers { case, candle, rows, tract, inputs };
        let logits = peers.candle_step()?.flatten_all()?.to_vec1()?;
        check(checks, Library::Candle, "candle", "logits", &logits, &peers.case.logits)?;
        check(checks, Library::Tract, "tract", "logits", &numbers_of(&peers.tract_step()?)?, &peers.case.logits)?;
        Ok(peers)
    }

    fn planner(&self, peers: &PlannerPeers, checks: &mut Vec<Check>) -> Result<Vec<Row>> {
        let tokens = &peers.case.tokens;
        let modules = self.model.planning().context("the blob has no planner")?;
        let mut ours = ours::Planner::new(modules, tokens.len())?;
        ours.step(tokens, network::TIME)?;
        check(checks, Library::Ours, "ours", "logits", &ours.logits(tokens.len()), &peers.case.logits)?;
        let passes = format!("guided, so two passes over {} tokens, and the logits of all of them", tokens.len());
        let mut timed = |name, ends, step: fn(&mut _, &[u16], f32) -> _| {
            let contenders = vec![
                (Library::Ours, Contender::new("ours", || step(&mut ours, black_box(tokens), network::TIME))),
                (Library::Candle, Contender::new("candle", || done(peers.candle_step()))),
                (Library::Tract, Contender::new("tract", || done(peers.tract_step()))),
            ];
            row(name, format!("{passes}. {ends}"), self.budget, contenders)
        };
        Ok(vec![
            timed(
                "planner_step",
                "Ours also draws a proposal and a step for every token; the peers stop at the logits.",
                ours::Planner::step,
            )?,
            timed(
                "planner_networks",
                "As much as the peers do, but that ours takes the most probable tokens as well.",
                ours::Planner::networks,
            )?,
        ])
    }

    fn request(&self, planner: &PlannerPeers, checks: &mut Vec<Check>) -> Result<Row> {
        let mut ours = ours::Whole::new(self.blob)?;
        let report = ours.generate()?;
        let (evaluations, gradients) = (report.evaluations, report.gradients);
        let tokens = self.model.max_tokens();
        let whole = DecoderCase::new(&self.tokenizer, &humanml3d::channels(u32::MAX), tokens)?;
        let anchored = DecoderCase::new(&self.tokenizer, &humanml3d::channels(ours::ANCHORED), tokens)?;
        let forms = |case| -> Result<[CandleDecoder; 2]> {
            Ok([CandleDecoder::new(case, Form::Operator)?, CandleDecoder::new(case, Form::Product)?])
        };
        let (whole_candle, anchored_candle) = (forms(&whole)?, forms(&anchored)?);
        let (whole_tract, anchored_tract) = (TractDecoder::new(&whole)?, TractDecoder::new(&anchored)?);
        for decoder in &anchored_candle {
            let found = decoder.engine.values(&decoder.gradient()?)?;
            check(checks, Library::Candle, "candle, request", "gradients", &found, &anchored.latent_gradient)?;
        }
        let found = frames_of(&anchored_tract.gradient()?)?;
        check(checks, Library::Tract, "tract, request", "gradients", &found, &anchored.latent_gradient)?;

        let work = Work { evaluations: evaluations.max(gradients), gradients };
        let candle = |form: usize| {
            let (whole, anchored) = (&whole_candle[form], &anchored_candle[form]);
            move || {
                work.run(
                    || done(planner.candle_step()),
                    || done(anchored.forward()),
                    || done(anchored.gradient()),
                    || done(whole.forward()),
                )
            }
        };
        let what = format!(
            "text and four anchors to {} frames: {} guided planner steps, {evaluations} decoder evaluations for the {} channels that the \
             anchors touch, {gradients} of them with the gradient, one last pass for all. Ours is the whole request; the peers only run \
             the networks so often: reading the text, what anchors tell the planner, sampling, the solver and the recovery of joints \
             are left out of their time.",
            whole.frames,
            ours::STEPS,
            anchored.channels
        );
        row(
            "request",
            what,
            2 * self.budget,
            vec![
                (Library::Ours, Contender::new("ours", || done(ours.generate()))),
                (Library::Candle, Contender::new("candle, operator", candle(0))),
                (
                    Library::Tract,
                    Contender::new("tract", || {
                        work.run(
                            || done(planner.tract_step()),
                            || done(anchored_tract.forward()),
                            || done(anchored_tract.gradient()),
                            || done(whole_tract.forward()),
                        )
                    }),
                ),
                (Library::Candle, Contender::new("candle, product", candle(1))),
            ],
        )
    }
}

/// What a request makes the networks do.
#[derive(Clone, Copy)]
struct Work {
    evaluations: u16,
    gradients: u16,
}

impl Work {
    /// The planner's steps, evaluations without and with gradient, the last pass.
    fn run(
        self,
        mut step: impl FnMut() -> Result<()>,
        mut evaluate: impl FnMut() -> Result<()>,
        mut gradient: impl FnMut() -> Result<()>,
        last: impl FnOnce() -> Result<()>,
    ) -> Result<()> {
        for _ in 0..ours::STEPS {
            step()?;
        }
        for _ in 0..self.evaluations - self.gradients {
            evaluate()?;
        }
        for _ in 0..self.gradients {
            gradient()?;
        }
        last()
    }
}

impl PlannerPeers {
    fn candle_step(&self) -> Result<Tensor> {
        let [text, none] = black_box(&self.rows);
        self.candle.forward(&mut Candle(Form::Product), [text, none])
    }

    fn tract_step(&self) -> Result<TValue> {
        let [text, none] = black_box(&self.inputs);
        last(self.tract.run(tvec![text.clone(), none.clone()])?)
    }
}
