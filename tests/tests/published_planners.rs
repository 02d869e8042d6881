//! Published planners in the runtime, converted from their own checkpoints: logits against the reference's given the same tokens, and whole
//! runs against PyTorch's ids.

use std::ops::ControlFlow;
use std::path::Path;

use motionette::codec::codebook::Codebooks;
use motionette::generation::tokens::{PlanningLimits, Session};
use motionette::memory::Arena;
use motionette::numerics::hash::Stream;
use motionette::request::prompt::Prompt;
use motionette::{
    Fixed, Generator, Length, Model, Observer, Planning, PlanningError, Progress, ROWS, Request, Sampling,
    StreamLimits, StreamPlan,
};
use motionette_host::blob::BlobFile;
use motionette_host::checkpoint::{self, PublishedPlanner, published};
use motionette_host::convert::{self, CardText, Options, PublishedSource, bank};
use motionette_host::reference::published as reference;
use motionette_host::reference::published::draw::Choice;
use motionette_host::reference::{masked, tmd};
use motionette_tests::published::floats;
use motionette_tests::shared;

/// What logits may lose with weights of 16 bits, as planners are converted, and of 8: share of positions whose likeliest class is the
/// reference's at least, and root mean square of the errors as a share of the range at most. Random weights have many near ties and the
/// fixtures few positions: with 8 bits one of them is 5 %.
const BUDGETS: [(u8, f64, f64); 2] = [(16, 0.999, 0.0005), (8, 0.94, 0.01)];

fn ids(folder: &Path, name: &str) -> Vec<usize> {
    let bytes = std::fs::read(folder.join("golden").join(format!("{name}.npy"))).expect(name);
    let ids: Vec<i64> = npyz::NpyFile::new(&bytes[..]).expect(name).into_vec().expect(name);
    ids.into_iter().map(|id| usize::try_from(id).unwrap_or(usize::from(Codebooks::NONE))).collect()
}

fn short(ids: &[usize]) -> Vec<u16> {
    ids.iter().map(|&id| id as u16).collect()
}

fn load(folder: &Path, name: &str) -> PublishedPlanner {
    published::load(&folder.join(name), None).unwrap_or_else(|e| panic!("{e}"))
}

/// A blob of a tokenizer and its planners.
fn blob(
    folder: &Path,
    tokenizer: &str,
    planner: &PublishedPlanner,
    residual: Option<&PublishedPlanner>,
    bits: u8,
) -> BlobFile {
    let path = folder.join(tokenizer);
    let checkpoint = checkpoint::load(&path).unwrap_or_else(|e| panic!("{e}"));
    let residual = residual.map(|residual| match residual {
        PublishedPlanner::Residual(residual) => residual,
        other => panic!("{other:?}"),
    });
    let rows = floats(folder, if residual.is_some() { "mask_cond" } else { "t2mgpt_greedy_stop_cond" });
    let stored = [bank::Entry { name: "stored".into(), unknown: Vec::new(), rows }];
    let source = PublishedSource { planner, residual, bank: &stored };
    let card = CardText { name: "published".into(), ..CardText::default() };
    let options = Options { wide_layers: true, wide_planner: bits == 16, ..Options::PLAIN };
    let conversion = convert::convert_published(&checkpoint, &source, &options, &[], &card, |_| ());
    BlobFile::new(conversion.unwrap_or_else(|e| panic!("{e}")).blob, &path).expect("a blob the runtime accepts")
}

fn momask(folder: &Path, bits: u8) -> (BlobFile, reference::Mask<f32>, reference::Residual<f32>) {
    let (mask, residual) = (load(folder, "mask.tar"), load(folder, "res.tar"));
    let blob = blob(folder, "rvq.tar", &mask, Some(&residual), bits);
    match (mask, residual) {
        (PublishedPlanner::Mask(mask), PublishedPlanner::Residual(residual)) => {
            (blob, reference::Mask::new(&mask), reference::Residual::new(&residual))
        }
        other => panic!("{other:?}"),
    }
}

fn t2mgpt(folder: &Path, bits: u8) -> (BlobFile, reference::Gpt<f32>) {
    let gpt = load(folder, "t2mgpt_trans.pth");
    let blob = blob(folder, "t2mgpt_vq.pth", &gpt, None, bits);
    match gpt {
        PublishedPlanner::Gpt(gpt) => (blob, reference::Gpt::new(&gpt)),
        other => panic!("{other:?}"),
    }
}

/// A session of the blob's planner that has read `vector`.
fn with_session<R>(
    blob: &BlobFile,
    vector: &[f32],
    tokens: usize,
    planning: &Planning<'_>,
    work: impl FnOnce(&mut Session<'_, '_, '_>) -> R,
) -> R {
    let model = blob.model().expect("checked");
    let modules = model.planning().expect("a planner");
    let limits =
        PlanningLimits { words: 0, steps: planning.steps, guided: planning.guided(), anchors: false, clauses: 1 };
    let mut memory = vec![0_u128; modules.bytes(tokens, &limits, ROWS).all().div_ceil(16)];
    let mut arena = Arena::new(bytemuck::cast_slice_mut(&mut memory));
    let mut session = Session::new(modules, &mut arena, tokens, &limits, ROWS).expect("as planned");
    let read = session.read(&Prompt::Vector(vector), &mut go_on).expect("a vector of that width");
    assert!(read.is_continue());
    work(&mut session)
}

fn go_on() -> ControlFlow<motionette::Stop> {
    ControlFlow::Continue(())
}

fn largest(logits: &[f32]) -> usize {
    (0..logits.len()).max_by(|&a, &b| logits[a].total_cmp(&logits[b]).then(b.cmp(&a))).expect("classes")
}

/// Share of rows of so many classes with the same likeliest one, and the error's root mean square as a share of the range.
fn compare(what: &str, ours: &[f32], exact: &[f32], classes: usize) -> (f64, f64) {
    assert_eq!(ours.len(), exact.len(), "{what}");
    let rows = ours.chunks_exact(classes).zip(exact.chunks_exact(classes));
    let same = rows.clone().filter(|(a, b)| largest(a) == largest(b)).count() as f64 / rows.len() as f64;
    let squares: f64 = ours.iter().zip(exact).map(|(a, b)| f64::from(a - b).powi(2)).sum();
    let (least, most) = exact.iter().fold((f32::MAX, f32::MIN), |(l, m), &v| (l.min(v), m.max(v)));
    let share = (squares / ours.len() as f64).sqrt() / f64::from(most - least);
    eprintln!("{what}: top-1 {:.1} %, error {:.2} % of the range", 100.0 * same, 100.0 * share);
    (same, share)
}

fn agrees(what: &str, ours: &[f32], exact: &[f32], classes: usize, (bits, least, most): (u8, f64, f64)) {
    let (same, share) = compare(&format!("{what}, {bits} bits"), ours, exact, classes);
    assert!(same >= least && share <= most, "{what}, {bits} bits: top-1 {same}, error {share}");
}

#[test]
fn masked_logits_given_the_same_tokens() {
    let Some(folder) = shared("published") else { return };
    for budget in BUDGETS {
        let (blob, mask, _) = momask(&folder, budget.0);
        let vector = floats(&folder, "mask_cond");
        // Without the padding at the end, which the runtime never sees: its length is the motion's.
        let tokens = &ids(&folder, "mask_ids")[..44];
        for guidance in [1.0, 4.0] {
            let planning = Planning { guidance, ..Planning::DEFAULT };
            let ours = with_session(&blob, &vector, tokens.len(), &planning, |session| -> Vec<f32> {
                assert!(session.pass(&short(tokens), 0.0, &planning, &mut go_on).is_continue());
                (0..tokens.len()).flat_map(|i| session.logits(i).to_vec()).collect()
            });
            let exact =
                if guidance == 1.0 { mask.logits(tokens, Some(&vector)) } else { mask.guided(tokens, &vector, 4.0) };
            agrees(&format!("mask, guidance {guidance}"), &ours, &exact, mask.codes, budget);
        }
    }
}

/// Every step of PyTorch's recorded run: what the network read then gives the logits it gave then.
#[test]
fn masked_logits_in_every_step_of_a_run() {
    let Some(folder) = shared("published") else { return };
    for budget in BUDGETS {
        let (blob, mask, _) = momask(&folder, budget.0);
        let (vector, inputs) = (floats(&folder, "mask_cond"), ids(&folder, "sample_ids_in"));
        let golden = floats(&folder, "sample_logits_cfg4");
        let length = golden.len() / mask.codes / 10;
        let planning = Planning { guidance: 4.0, ..Planning::DEFAULT };
        let ours: Vec<f32> = with_session(&blob, &vector, length, &planning, |session| {
            let step = |tokens: &[usize]| -> Vec<f32> {
                assert!(session.pass(&short(tokens), 0.0, &planning, &mut go_on).is_continue());
                (0..length).flat_map(|i| session.logits(i).to_vec()).collect()
            };
            inputs.chunks_exact(length).flat_map(step).collect()
        });
        agrees("mask, ten steps", &ours, &golden, mask.codes, budget);
    }
}

#[test]
fn residual_logits_given_the_same_tokens() {
    let Some(folder) = shared("published") else { return };
    for budget in BUDGETS {
        let (blob, _, residual) = momask(&folder, budget.0);
        let (vector, all) = (floats(&folder, "mask_cond"), ids(&folder, "res_ids"));
        let tokens = &all[..44 * residual.quantizers];
        let planning = Planning { guidance: 4.0, ..Planning::DEFAULT };
        for quantizer in 1..residual.quantizers {
            let ours = with_session(&blob, &vector, 44, &planning, |session| {
                let mut numbers = short(tokens);
                assert!(session.detail(&Prompt::Vector(&vector), quantizer, &numbers, &mut go_on).is_continue());
                let mut ours: Vec<f32> = Vec::new();
                let see = &mut |logits: &[f32]| ours.extend(logits);
                session.draw_detail(quantizer, &planning, &mut Stream::new(0), &mut numbers, see);
                ours
            });
            let exact = residual.guided(tokens, quantizer, &vector, 5.0);
            agrees(&format!("residual {quantizer}"), &ours, &exact, residual.codes + 1, budget);
        }
    }
}

#[test]
fn autoregressive_logits_given_the_same_tokens() {
    let Some(folder) = shared("published") else { return };
    for budget in BUDGETS {
        let (blob, gpt) = t2mgpt(&folder, budget.0);
        for (vector, tokens) in
            [("t2mgpt_cond", "t2mgpt_prefix_ids"), ("t2mgpt_greedy_full_cond", "t2mgpt_greedy_full_ids")]
        {
            let (vector, tokens) = (floats(&folder, vector), ids(&folder, tokens));
            // The last of them is never read: there is no place behind it.
            let tokens = &tokens[..tokens.len().min(49)];
            let planning = Planning { guidance: 1.0, ..Planning::DEFAULT };
            let ours: Vec<f32> = with_session(&blob, &vector, 50, &planning, |session| {
                let rows = core::iter::once(0).chain(tokens.iter().map(|&token| token as u16)).enumerate();
                let row = |(at, token)| match session.extend(token, at, &mut go_on) {
                    ControlFlow::Continue(logits) => logits.to_vec(),
                    ControlFlow::Break(stop) => panic!("{stop:?}"),
                };
                rows.flat_map(row).collect()
            });
            agrees("T2M-GPT", &ours, &gpt.logits(tokens, &vector), gpt.codes + 1, budget);
        }
    }
}

fn generate<'r>(blob: &BlobFile, request: &Request<'r>) -> Result<Vec<u16>, motionette::Error> {
    let model = blob.model().expect("checked");
    let plan = Generator::new(model.clone(), &mut [])?.plan(request)?;
    let mut memory = vec![0_u128; plan.arena_bytes.div_ceil(16)];
    let mut generator = Generator::new(model, bytemuck::cast_slice_mut(&mut memory))?;
    let motion = generator.generate(request, &mut ())?;
    assert!(motion.arena_used <= plan.arena_bytes);
    Ok(motion.tokens().to_vec())
}

/// Greedy runs are those of PyTorch, to the stop class and to the end of the block; a planner that ends before it began is an error.
#[test]
fn autoregressive_runs() {
    let Some(folder) = shared("published") else { return };
    let (blob, _) = t2mgpt(&folder, 16);
    let vectors = ["stop", "full", "none"].map(|run| floats(&folder, &format!("t2mgpt_greedy_{run}_cond")));
    let greedy = |vector| Request::prompt(Prompt::Vector(vector)).sampling(Sampling::Greedy);
    for (run, vector) in ["stop", "full"].into_iter().zip(&vectors) {
        let tokens = generate(&blob, &greedy(vector)).expect("a motion");
        assert_eq!(tokens, short(&ids(&folder, &format!("t2mgpt_greedy_{run}_ids"))), "{run}");
    }
    let nothing = generate(&blob, &greedy(&vectors[2])).expect_err("no motion");
    assert_eq!(nothing, motionette::Error::Planning(PlanningError::Nothing));
    // A length that is given is kept, the stop class or not.
    for length in [1, 7, 40, 50] {
        let tokens = generate(&blob, &greedy(&vectors[0]).length(Length::Tokens(length))).expect("a motion");
        assert_eq!(tokens.len(), usize::from(length));
    }
    // What is given stands where it was given, and what comes before it does not change.
    let fixed = [Fixed { position: 3, token: 17 }, Fixed { position: 30, token: 5 }];
    let (free, held) = (greedy(&vectors[0]), greedy(&vectors[0]).fixed(&fixed));
    let (free, held) = (generate(&blob, &free).expect("a motion"), generate(&blob, &held).expect("a motion"));
    assert_eq!((&held[..3], held[3], held[30]), (&free[..3], 17, 5));
}

/// A whole run of masked and residual planner against the reference, which is asked for the same random numbers: what is left is int8.
#[test]
fn masked_runs_with_the_same_random_numbers() {
    let Some(folder) = shared("published") else { return };
    let (blob, mask, residual) = momask(&folder, 16);
    let (vector, quantizers) = (floats(&folder, "mask_cond"), residual.quantizers);
    let (mut same, mut first, mut all) = (0, 0, 0);
    for seed in 0..6 {
        let length = 20 + 5 * seed as usize;
        let planning = Planning {
            length: Length::Tokens(length as u16),
            seed,
            steps: 10,
            guidance: 4.0,
            sampling: Sampling::Gumbel { temperature: 1.0 },
            ..Planning::DEFAULT
        };
        let ours = generate(&blob, &Request::prompt(Prompt::Vector(&vector)).planned(planning)).expect("a motion");
        let mut stream = Stream::new(seed);
        let settings = reference::masked::Settings { steps: 10, choice: Choice { temperature: 1.0, filter: 0.0 } };
        let run = reference::masked::plan(
            (length, mask.codes),
            &settings,
            |ids| mask.guided(ids, &vector, 4.0),
            |_, _, _| stream.unit(),
        );
        let base = &run.last().expect("steps").after;
        let mut exact = vec![0; length * quantizers];
        exact.chunks_exact_mut(quantizers).zip(base).for_each(|(position, &token)| position[0] = token);
        for quantizer in 1..quantizers {
            let logits = residual.guided(&exact, quantizer, &vector, 5.0);
            for (i, row) in logits.chunks_exact(residual.codes + 1).enumerate() {
                exact[i * quantizers + quantizer] = settings.choice.draw(row, || stream.unit());
            }
        }
        let exact: Vec<u16> =
            exact.into_iter().map(|id| if id < mask.codes { id as u16 } else { Codebooks::NONE }).collect();
        let pairs = ours.iter().zip(&exact);
        same += pairs.clone().filter(|(a, b)| a == b).count();
        first += pairs.step_by(quantizers).filter(|(a, b)| a == b).count();
        all += length;
    }
    let (first, same) = (first as f64 / all as f64, same as f64 / (all * quantizers) as f64);
    eprintln!("whole runs: {:.1} % of the first quantizer's tokens, {:.1} % of all", 100.0 * first, 100.0 * same);
    assert!(first > 0.8 && same > 0.6, "{first} {same}");
}

/// How many positions are masked again, for every length and number of steps, against the formula in f64 and the reference.
#[test]
fn the_schedule_of_masks() {
    for steps in 2..=20_u16 {
        let planning = Planning { steps, ..Planning::DEFAULT };
        let times = masked::times(tmd::Schedule::Uniform, usize::from(steps));
        for length in 1..=49_usize {
            for step in 0..steps - 1 {
                let ours = motionette::generation::tokens::masked::masked(&planning, step, length);
                let exact = masked::masked(times[usize::from(step) + 1], length);
                assert_eq!(ours, exact, "step {step} of {steps}, {length} tokens");
            }
        }
    }
}

#[test]
fn given_tokens_stay_and_every_seed_is_another_motion() {
    let Some(folder) = shared("published") else { return };
    let (blob, ..) = momask(&folder, 16);
    let vector = floats(&folder, "mask_cond");
    let model = blob.model().expect("checked");
    assert_eq!(model.vector_width(), Some(512));
    let meant = model.default_planning();
    assert_eq!((meant.steps, meant.guidance), (10, 4.0));
    assert_eq!(meant.sampling, Sampling::Sample { temperature: 1.0, top_k: 7, top_p: 1.0 });
    let fixed = [Fixed { position: 0, token: 9 }, Fixed { position: 11, token: 33 }];
    let request = Request::prompt(Prompt::Vector(&vector)).planned(meant).length(Length::Tokens(16)).fixed(&fixed);
    let mut seen = std::collections::HashSet::new();
    for seed in 0..8 {
        let tokens = generate(&blob, &request.seed(seed)).expect("a motion");
        assert_eq!((tokens.len(), tokens[0], tokens[33]), (48, 9, 33));
        assert!(tokens.iter().all(|&token| token < 64 || token == Codebooks::NONE));
        assert!(tokens.iter().step_by(3).all(|&token| token < 64), "no mask is left");
        assert_eq!(tokens, generate(&blob, &request.seed(seed)).expect("a motion"), "the same again");
        assert!(seen.insert(tokens));
    }
    // Half precision of a stored prompt changes a few tokens at most.
    let stored = Request::bank("stored").planned(meant).length(Length::Tokens(16));
    assert_eq!(generate(&blob, &stored).expect("a motion").len(), 48);
}

#[test]
fn prompts_that_are_no_vectors_of_the_model_are_refused() {
    use motionette::request::prompt::PromptError;
    let Some(folder) = shared("published") else { return };
    let (blob, ..) = momask(&folder, 16);
    let good = floats(&folder, "mask_cond");
    let refused = |prompt: Prompt<'_>| match generate(&blob, &Request::prompt(prompt)) {
        Err(motionette::Error::Prompt(error)) => error,
        other => panic!("{other:?}"),
    };
    assert_eq!(refused(Prompt::Vector(&good[..511])), PromptError::VectorWidth { found: 511, width: 512 });
    assert_eq!(refused(Prompt::Vector(&[])), PromptError::VectorWidth { found: 0, width: 512 });
    assert_eq!(refused(Prompt::Vector(&[0.0; 512])), PromptError::ZeroVector);
    assert_eq!(refused(Prompt::Text("a person walks")), PromptError::Vectors { width: 512, stored: 1 });
    assert_eq!(refused(Prompt::Bank("walk")), PromptError::NotStored { stored: 1 });
    for bad in [f32::NAN, f32::INFINITY, -1e9] {
        let mut vector = good.clone();
        vector[100] = bad;
        assert_eq!(refused(Prompt::Vector(&vector)), PromptError::VectorValue { index: 100 });
    }
    let model = Model::open(blob.bytes()).expect("checked");
    assert!(model.planning().expect("a planner").text.takes_vectors());
}

/// A stream's segments are requests whose first tokens are given, those of the first quantizer alone; the others are drawn anew and only the new
/// ones count.
#[test]
fn streams_go_on_as_requests_with_given_tokens_do() {
    let models = motionette_tests::fuzz::corpus();
    let mut seen = 0;
    for (name, tiny) in models.iter().filter(|(_, tiny)| tiny.shape.prefix.is_some()) {
        let model = Model::open(tiny.bytes()).expect("it opens");
        let quantizers = model.codebooks().quantizers();
        let planning = Planning { seed: 11, ..model.default_planning() };
        let limits =
            PlanningLimits { words: 0, steps: planning.steps, guided: planning.guided(), anchors: false, clauses: 1 };
        let limits = StreamLimits { tokens: 6, planning: Some(limits), rows: ROWS };
        let plan = StreamPlan::new(&model, &limits).expect("a plan");
        let mut memory = vec![0_u128; plan.arena_bytes.div_ceil(16)];
        let mut generator = Generator::new(model.clone(), bytemuck::cast_slice_mut(&mut memory)).expect("a generator");
        let mut stream = generator.stream(&limits).expect("a stream");
        let request = Request::bank("wave").planned(planning);
        let mut frames = 0;
        for count in [3, 2] {
            stream.plan(&request.length(Length::Tokens(count)), &mut ()).expect(name);
            while let Some(more) = stream.frames(&mut ()).expect(name) {
                frames += more.len();
            }
        }
        let tokens = stream.tokens().to_vec();
        stream.finish();
        while let Some(more) = stream.frames(&mut ()).expect(name) {
            frames += more.len();
        }
        assert_eq!((tokens.len(), frames), (5 * quantizers, 5 * model.frames_per_token()), "{name}");

        let whole = |request: &Request<'_>| {
            let plan = Generator::new(model.clone(), &mut []).expect("a generator").plan(request).expect("a plan");
            let mut memory = vec![0_u128; plan.arena_bytes.div_ceil(16)];
            let mut generator =
                Generator::new(model.clone(), bytemuck::cast_slice_mut(&mut memory)).expect("a generator");
            generator.generate(request, &mut ()).expect(name).tokens().to_vec()
        };
        let first = whole(&request.length(Length::Tokens(3)));
        assert_eq!(tokens[..3 * quantizers], first, "{name}");
        let given = first.iter().step_by(quantizers).zip(0..).map(|(&token, position)| Fixed { position, token });
        let given: Vec<Fixed> = given.collect();
        let next = request.seed(11_u64.wrapping_add(0x9E37_79B9_7F4A_7C15)).fixed(&given).length(Length::Tokens(5));
        assert_eq!(tokens[3 * quantizers..], whole(&next)[3 * quantizers..], "{name}");
        seen += 1;
    }
    assert_eq!(seen, 4);
}

/// Asks for the end once, before there is anything to end with.
struct Impatient(bool);

impl Observer for Impatient {
    fn progress(&mut self, _: Progress) -> ControlFlow<motionette::Stop> {
        let first = core::mem::replace(&mut self.0, false);
        if first { ControlFlow::Break(motionette::Stop::Finish) } else { ControlFlow::Continue(()) }
    }
}

/// An end that was asked for too early is granted as soon as there is a motion: of a planner of a token at a time as soon as it is as
/// long as it must be.
#[test]
fn an_early_end_is_granted_when_there_is_a_motion() {
    let models = motionette_tests::fuzz::corpus();
    let (_, tiny) = models.iter().find(|(name, _)| *name == "autoregressive").expect("in the corpus");
    let model = Model::open(tiny.bytes()).expect("it opens");
    let request = Request::bank("wave").planned(model.default_planning()).sampling(Sampling::Greedy);
    let mut memory = vec![0_u128; 1 << 14];
    let mut generator = Generator::new(model, bytemuck::cast_slice_mut(&mut memory)).expect("a generator");
    let whole = generator.generate(&request, &mut ()).expect("a motion").tokens().to_vec();
    assert!(whole.len() > 1, "{whole:?}");
    let cut = generator.generate(&request, &mut Impatient(true)).expect("a motion").tokens().to_vec();
    assert_eq!(cut, whole[..1]);
}
