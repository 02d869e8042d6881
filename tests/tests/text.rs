//! Requests by text through the generator, on small random models: replay, options, given tokens, memory, stops, bad input.

use motionette::blob::{Corruption, Error as BlobError, TransformerConfig};
use motionette::generation::tokens::sampling::SamplingError;
use motionette::generation::tokens::{PlanningError, PlanningLimits, Session};
use motionette::numerics::hash::Stream;
use motionette::refining::Config;
use motionette::request::conditions::AnchorSet;
use motionette::request::prompt::PromptError;
use motionette::text::words::MAX_PROMPT;
use motionette::{
    Anchor, Error, Fixed, Generator, Length, Model, Motion, Observer, Planning, Progress, Prompt, Request, Sampling,
    Schedule, Stage, Stop,
};
use motionette::{LEAST_ROWS, MOST_ROWS, ROWS};
use motionette_tests::naive_prior;
use motionette_tests::tiny::{PriorShape, Shape, Tiny};
use std::ops::ControlFlow;

const CODES: u16 = 11;

fn tiny() -> Tiny {
    Tiny::new(Shape::with_prior(), 31)
}

/// Makes a generator in fresh memory and hands it to `work`.
fn with<T>(tiny: &Tiny, work: impl FnOnce(&mut Generator<'_>) -> T) -> T {
    let mut words = vec![0u128; (1 << 20) / 16];
    let model = Model::open(tiny.bytes()).expect("the blob opens");
    let mut generator = Generator::new(model, bytemuck::cast_slice_mut(&mut words)).expect("default floating point");
    work(&mut generator)
}

fn base() -> Request<'static> {
    Request::text("a person waves the left hand").length(Length::Tokens(6)).seed(5).steps(4).unrefined()
}

fn tokens(generator: &mut Generator<'_>, request: &Request<'_>) -> Vec<u16> {
    generator.generate(request, &mut ()).expect("the request is valid").tokens().to_vec()
}

/// Keeps the tokens of every step.
#[derive(Default, Clone, PartialEq, Debug)]
struct Trace(Vec<Vec<u16>>);

impl Observer for Trace {
    fn tokens(&mut self, step: u16, tokens: &[u16]) {
        assert_eq!(usize::from(step), self.0.len(), "steps count from 0");
        self.0.push(tokens.to_vec());
    }
}

fn trace(generator: &mut Generator<'_>, request: &Request<'_>) -> Vec<Vec<u16>> {
    let mut trace = Trace::default();
    let last = generator.generate(request, &mut trace).expect("the request is valid").tokens().to_vec();
    assert_eq!(trace.0.last(), Some(&last), "the motion is that of the last tokens");
    trace.0
}

#[test]
fn a_motion_comes_with_its_tokens_and_what_was_understood() {
    with(&tiny(), |generator| {
        let model = generator.model().clone();
        let motion = generator.generate(&base(), &mut ()).unwrap();
        assert_eq!((motion.words(), motion.unknown_words()), (6, 1), "`the` is unknown");
        assert_eq!(motion.tokens().len(), 6);
        assert_eq!(motion.frames().len(), 24);
        let mut u = vec![0.0; 6 * model.decoder().code_width()];
        model.codebooks().embed(motion.tokens(), &mut u).unwrap();
        assert_eq!(motion.u(), u);
        let (planned, hash) = (motion.tokens().to_vec(), motion.hash());
        let again = generator.generate(&Request::tokens(&planned).unrefined(), &mut ()).unwrap();
        assert_eq!((again.hash(), again.tokens(), again.words()), (hash, planned.as_slice(), 0));
        let embedded = generator.generate(&Request::embeddings(&u).unrefined(), &mut ()).unwrap();
        assert_eq!((embedded.hash(), embedded.tokens()), (hash, [].as_slice()));
        let bank = generator.generate(&Request::bank("wave").seed(5), &mut ()).unwrap();
        assert_eq!((bank.words(), bank.unknown_words()), (3, 0));
        let longer = generator.generate(&base().frames(25), &mut ()).unwrap();
        assert_eq!(longer.frames().len(), 28, "frames go up to whole tokens");
    });
}

#[test]
fn replay_is_exact_in_any_memory_and_after_anything() {
    let tiny = tiny();
    let requests = [
        base(),
        base().guidance(1.0).sampling(Sampling::Gumbel { temperature: 0.7 }),
        base().length(Length::Predicted).schedule(Schedule::Cosine),
        Request::bank("stand still").steps(2).length(Length::Tokens(13)),
    ];
    let first: Vec<(u64, Vec<u16>)> = requests
        .iter()
        .map(|request| {
            with(&tiny, |generator| {
                let motion = generator.generate(request, &mut ()).unwrap();
                (motion.hash(), motion.tokens().to_vec())
            })
        })
        .collect();
    let mut dirty = vec![0xA5u8; 1 << 20];
    let model = Model::open(tiny.bytes()).unwrap();
    let mut generator = Generator::new(model, &mut dirty[3..]).unwrap();
    for _ in 0..2 {
        for (request, (hash, tokens)) in requests.iter().zip(&first).rev() {
            let motion = generator.generate(request, &mut ()).unwrap();
            assert_eq!((motion.hash(), motion.tokens()), (*hash, tokens.as_slice()));
        }
    }
}

#[test]
fn every_option_does_what_its_name_says() {
    with(&tiny(), |generator| {
        let plain = trace(generator, &base());
        assert_eq!(plain.len(), 4, "steps");
        assert_eq!(trace(generator, &base().steps(9)).len(), 9);
        // Options that change the draws change the tokens of some seed; those that are off do not.
        let differs = |generator: &mut Generator<'_>, a: Request<'_>, b: Request<'_>| {
            (0..20).any(|seed| trace(generator, &a.seed(seed)) != trace(generator, &b.seed(seed)))
        };
        let b = base();
        assert_ne!(trace(generator, &b), trace(generator, &b.seed(999)));
        assert!(differs(generator, b, b.guidance(4.0)));
        assert!(differs(generator, b, b.schedule(Schedule::Cosine)));
        assert!(differs(generator, b, b.guidance(1.0)) && differs(generator, b, b.guidance(0.0)));
        assert!(differs(generator, b, Request { source: Request::text("run").source, ..b }), "the text counts");
        assert!(!differs(generator, b, b.sampling(Sampling::default())));
        let sample = |temperature, top_k, top_p| b.sampling(Sampling::Sample { temperature, top_k, top_p });
        assert!(differs(generator, b, sample(3.0, 0, 1.0)));
        assert!(differs(generator, b, sample(1.0, 2, 1.0)) && !differs(generator, b, sample(1.0, CODES, 1.0)));
        assert!(differs(generator, b, sample(1.0, 0, 0.3)));
        // Without the text, guidance 0 hears nothing of it.
        let deaf = b.guidance(0.0);
        let other = Request { source: Request::text("run").source, ..deaf };
        assert!(!differs(generator, deaf, other), "guidance 0 is the motion without text");
        // Top-1 is greedy up to ties, and greedy draws nothing for proposals: only the changes' draws are shared out anew.
        let greedy = b.sampling(Sampling::Greedy).steps(1);
        assert_eq!(tokens(generator, &greedy.seed(3)).len(), 6);
        let cold = sample(1e-3, 1, 1.0).steps(1);
        assert!(!differs(generator, greedy, cold), "in one step the draws do not matter");
        // Open ends are another scene.
        let open = |start_open, end_open| Planning { start_open, end_open, ..greedy.planning };
        for planning in [open(true, false), open(false, true), open(true, true)] {
            assert!(differs(generator, greedy, greedy.planned(planning)));
        }
    });
}

/// The whole sampler restated: the stream as it is documented, transitions in f64, logits from a session.
#[test]
fn the_stream_and_the_steps_are_those_that_are_documented() {
    // Reading anchors borrows the room of the logits: that leaves nothing behind.
    let tiny = Tiny::new(Shape { prior: Some(PriorShape::with_control()), ..Shape::with_prior() }, 31);
    let model = Model::open(tiny.bytes()).unwrap();
    let width = usize::from(tiny.shape.code_width);
    let all = [Anchor::root(10, [0.2, 0.9, 0.3]), Anchor::joint(20, 20, [0.2, 1.2, 0.3])];
    let fixed = [Fixed { position: 2, token: 7 }, Fixed { position: 4, token: 0 }];
    let mut equal = 0;
    for seed in 0..30u64 {
        let sampling = match seed % 3 {
            0 => Sampling::Greedy,
            1 => Sampling::Sample { temperature: 1.5, top_k: 0, top_p: 1.0 },
            _ => Sampling::Gumbel { temperature: 0.8 },
        };
        let anchors = if seed % 2 == 0 { all.as_slice() } else { &[] };
        let request = base().seed(seed).sampling(sampling).fixed(&fixed).steps(5).anchors(anchors);
        let got = with(&tiny, |generator| trace(generator, &request));

        let limits = PlanningLimits { words: 6, steps: 5, guided: true, anchors: true, clauses: 1 };
        let modules = model.planning().unwrap();
        let mut words = vec![0u128; modules.bytes(6, &limits, ROWS).all() / 16];
        let mut arena = motionette::memory::Arena::new(bytemuck::cast_slice_mut(&mut words));
        let mut session = Session::new(modules, &mut arena, 6, &limits, ROWS).unwrap();
        let _ = session.read(&Prompt::Text("a person waves the left hand"), &mut || ControlFlow::Continue(())).unwrap();
        assert!(
            session.anchor(&AnchorSet::new(anchors, 24).unwrap(), 6, &mut || ControlFlow::Continue(())).is_continue()
        );
        let mut stream = Stream::new(seed);
        let given = |i: usize| fixed.iter().find(|f| usize::from(f.position) == i).map(|f| f.token);
        let mut z: Vec<u16> = (0..6)
            .map(|i| {
                let drawn = stream.below(u32::from(CODES)) as u16;
                given(i).unwrap_or(drawn)
            })
            .collect();
        let mut want = Vec::new();
        for step in 0..5u16 {
            let (t, h) = (f64::from(step) / 5.0, 0.2);
            assert!(session.pass(&z, t as f32, &request.planning, &mut || ControlFlow::Continue(())).is_continue());
            for i in 0..6 {
                let logits: Vec<f64> = session.logits(i).iter().map(|&l| f64::from(l)).collect();
                let largest = |l: &[f64]| (0..l.len()).rev().max_by(|&a, &b| l[a].total_cmp(&l[b])).unwrap();
                let proposal = match sampling {
                    Sampling::Greedy => largest(&logits),
                    Sampling::Sample { temperature, .. } => {
                        let scaled: Vec<f64> = logits.iter().map(|l| l / f64::from(temperature)).collect();
                        inverse(&naive_prior::softmax(&scaled), f64::from(stream.unit()))
                    }
                    Sampling::Gumbel { temperature } => {
                        let noisy =
                            logits.iter().map(|l| l - f64::from(temperature) * (-f64::from(stream.unit()).ln()).ln());
                        largest(&noisy.collect::<Vec<_>>())
                    }
                };
                let (update, choice) = (f64::from(stream.unit()), f64::from(stream.unit()));
                if given(i).is_some() {
                    continue;
                }
                if step == 4 {
                    z[i] = proposal as u16;
                    continue;
                }
                let present = usize::from(z[i]);
                let beta = |t: f64| naive_prior::beta(t, 3.0, 0.9);
                let mut to = naive_prior::transition(&tiny.codes, width, (present, proposal), (t, h), beta);
                let change = 1.0 - to[present];
                if update < change {
                    to[present] = 0.0;
                    let moved: Vec<f64> = to.iter().map(|p| p / change).collect();
                    z[i] = inverse(&moved, choice) as u16;
                }
            }
            want.push(z.clone());
        }
        equal += usize::from(got == want);
    }
    // f32 and f64 may fall on two sides of a draw, rarely.
    assert!(equal >= 28, "only {equal} of 30 requests follow the restated sampler");
}

/// The place where the running sum of `p` passes `unit`.
fn inverse(p: &[f64], unit: f64) -> usize {
    let mut sum = 0.0;
    for (i, p) in p.iter().enumerate() {
        sum += p;
        if sum > unit && *p > 0.0 {
            return i;
        }
    }
    p.iter().rposition(|&p| p > 0.0).unwrap_or(0)
}

#[test]
fn given_tokens_stay_whatever_the_sampling() {
    let samplings = [
        Sampling::Greedy,
        Sampling::default(),
        Sampling::Sample { temperature: 5.0, top_k: 3, top_p: 0.9 },
        Sampling::Gumbel { temperature: 1.0 },
    ];
    let fixed = [Fixed { position: 0, token: 4 }, Fixed { position: 5, token: 10 }, Fixed { position: 0, token: 4 }];
    with(&tiny(), |generator| {
        for sampling in samplings {
            for steps in [1, 2, 7] {
                let request = base().sampling(sampling).steps(steps).fixed(&fixed);
                for tokens in trace(generator, &request) {
                    assert_eq!((tokens[0], tokens[5]), (4, 10), "{sampling:?}");
                }
            }
            // Everything given: what comes out is what went in.
            let all: Vec<Fixed> = (0..6).map(|position| Fixed { position, token: (position * 7) % CODES }).collect();
            let want: Vec<u16> = all.iter().map(|f| f.token).collect();
            assert_eq!(tokens(generator, &base().sampling(sampling).fixed(&all)), want);
        }
        // Given tokens are seen by their neighbours.
        let other = [Fixed { position: 0, token: 1 }, Fixed { position: 5, token: 2 }];
        let inner = |tokens: Vec<u16>| tokens[1..5].to_vec();
        let differs = (0..20).any(|seed| {
            inner(tokens(generator, &base().seed(seed).fixed(&fixed)))
                != inner(tokens(generator, &base().seed(seed).fixed(&other)))
        });
        assert!(differs);
    });
}

#[test]
fn more_rows_at_a_time_take_more_memory_and_give_the_same_motion() {
    let controlled = Tiny::new(Shape { prior: Some(PriorShape::with_control()), ..Shape::with_prior() }, 33);
    let anchors = [Anchor::root(41, [0.1, 0.9, 0.2]), Anchor::root(3, [0.0, 0.9, 0.0])];
    with(&controlled, |generator| {
        let request = base().length(Length::Tokens(13)).through(&anchors).refined(Config::fast(4));
        let mut made = |rows: usize| {
            generator.set_rows(rows);
            let plan = generator.plan(&request).unwrap();
            let motion = generator.generate(&request, &mut ()).unwrap();
            assert_eq!((motion.arena_used, motion.unconditioned_anchors()), (plan.arena_bytes, 0));
            (motion.hash(), plan.planning.all(), plan.decoder_bytes)
        };
        let least = made(LEAST_ROWS);
        let mut before = least;
        for rows in LEAST_ROWS + 1..=MOST_ROWS {
            let now = made(rows);
            assert_eq!(now.0, before.0, "{rows} rows");
            assert!(now.1 > before.1 && now.2 >= before.2, "{rows} rows: {now:?}, one less: {before:?}");
            before = now;
        }
        assert_eq!([made(0), made(usize::MAX)], [least, before]);
    });
}

#[test]
fn predicted_length_follows_the_text_and_gives_way_to_anchors_and_given_tokens() {
    // Length heads of random models: find one that predicts something short.
    let (tiny, predicted) = (0..50)
        .find_map(|seed| {
            let tiny = Tiny::new(Shape::with_prior(), 300 + seed);
            let (_, pooled) = naive_prior::encode(&tiny, &[2, 3, 5]);
            let p = naive_prior::lengths(&tiny, &pooled);
            let median = (1..=13usize).find(|&n| p[..n].iter().sum::<f64>() >= 0.5)?;
            let clear = p[..median].iter().sum::<f64>() > 0.52;
            (median < 6 && clear).then_some((tiny, median))
        })
        .expect("one of fifty random models is short-spoken");
    with(&tiny, |generator| {
        let request = Request::text("a person runs").steps(2);
        let mut count = |request: &Request<'_>| {
            let plan = generator.plan(request).unwrap();
            let motion = generator.generate(request, &mut ()).unwrap();
            assert_eq!(motion.arena_used, plan.arena_bytes);
            assert_eq!(motion.frames().len(), 4 * motion.tokens().len());
            assert!(motion.joints().iter().all(|v| v.is_finite()));
            motion.tokens().len()
        };
        assert_eq!(count(&request), predicted);
        let fixed = [Fixed { position: 8, token: 3 }];
        assert_eq!(count(&request.fixed(&fixed)), 9);
        let anchors = [Anchor::root(41, [0.1, 0.9, 0.2]), Anchor::root(3, [0.0, 0.9, 0.0])];
        assert_eq!(count(&request.through(&anchors).refined(Config::fast(3))), 11);
        assert_eq!(count(&request.fixed(&fixed).through(&anchors).refined(Config::fast(3))), 11);
        let last = [Fixed { position: 12, token: 3 }];
        assert_eq!(count(&request.fixed(&last)), 13);
    });
}

#[test]
fn painted_memory_is_what_the_plan_says() {
    let small = tiny();
    // Planning the larger of the two, and the smaller.
    let mut prior = PriorShape::default();
    prior.planner = TransformerConfig { width: 128, heads: 4, layers: 5, hidden: 300, ..prior.planner };
    let large = Tiny::new(Shape { prior: Some(prior), ..Shape::with_prior() }, 32);
    let anchors = [Anchor::root(10, [0.2, 0.5, 0.3]), Anchor::joint(20, 20, [0.2, 0.5, 0.3])];
    let mut larger = [false; 2];
    for tiny in [&small, &large] {
        let model = Model::open(tiny.bytes()).unwrap();
        let requests = [
            base(),
            base().guidance(1.0),
            base().length(Length::Predicted),
            base().through(&anchors).refined(Config::fast(3)),
            Request::bank("wave").length(Length::Tokens(1)).unrefined(),
            Request::text("run").length(Length::Tokens(13)).unrefined(),
            Request::tokens(&[1, 2, 3]).unrefined(),
        ];
        for request in requests {
            let mut words = vec![0u128; 1 << 16];
            let memory: &mut [u8] = bytemuck::cast_slice_mut(&mut words);
            let used = |memory: &mut [u8]| {
                let mut generator = Generator::new(model.clone(), memory).unwrap();
                generator.generate(&request, &mut ()).map(|motion| motion.arena_used)
            };
            let plan = Generator::new(model.clone(), memory).unwrap().plan(&request).unwrap();
            let planned = plan.arena_bytes;
            if plan.planning.all() > 0 {
                larger[usize::from(planned == plan.token_bytes + plan.planning.all())] = true;
            }
            assert_eq!(used(&mut memory[..planned]), Ok(planned));
            match used(&mut memory[..planned - 1]) {
                Err(Error::Arena(e)) => assert_eq!((e.needed, e.available), (planned, planned - 1)),
                other => panic!("one byte less must be refused, got {other:?}"),
            }
            memory.fill(0xC3);
            assert_eq!(used(memory), Ok(planned));
            let high_water = memory.iter().rposition(|&b| b != 0xC3).unwrap() + 1;
            assert!(high_water <= planned && high_water + 16 > planned, "high-water {high_water}, planned {planned}");
        }
    }
    assert_eq!(larger, [true; 2], "both stages were once the larger one");
}

/// Answers `wish` at call number `at`, and counts calls.
struct Stopper {
    calls: usize,
    at: usize,
    wish: ControlFlow<Stop>,
    stage: Option<Stage>,
    steps: usize,
}

impl Stopper {
    fn new(at: usize, wish: ControlFlow<Stop>) -> Self {
        Stopper { calls: 0, at, wish, stage: None, steps: 0 }
    }
}

impl Observer for Stopper {
    fn progress(&mut self, progress: Progress) -> ControlFlow<Stop> {
        self.calls += 1;
        if self.calls == self.at {
            self.stage = Some(progress.stage);
            return self.wish;
        }
        ControlFlow::Continue(())
    }

    fn tokens(&mut self, _: u16, _: &[u16]) {
        self.steps += 1;
    }
}

#[test]
fn stopping_at_any_observer_call_leaves_the_generator_as_it_was() {
    let anchors = [Anchor::root(10, [0.2, 0.9, 0.3]), Anchor::joint(20, 20, [0.2, 1.2, 0.3])];
    let fixed = [Fixed { position: 1, token: 6 }];
    let request = base().fixed(&fixed).steps(3).through(&anchors).refined(Config::fast(3));
    with(&tiny(), |generator| {
        let mut counter = Stopper::new(0, ControlFlow::Continue(()));
        let motion = generator.generate(&request, &mut counter).unwrap();
        let (hash, calls) = (motion.hash(), counter.calls);
        assert!(calls > 40, "{calls} calls");
        let mut seen = Vec::new();
        for at in 1..=calls {
            let mut stopper = Stopper::new(at, ControlFlow::Break(Stop::Abort));
            assert_eq!(generator.generate(&request, &mut stopper).map(|m| m.hash()), Err(Error::Aborted), "call {at}");
            assert_eq!(stopper.calls, at, "an abort is immediate");
            seen.extend(stopper.stage);

            let mut stopper = Stopper::new(at, ControlFlow::Break(Stop::Finish));
            let motion = generator.generate(&request, &mut stopper).unwrap_or_else(|e| panic!("call {at}: {e}"));
            assert!(motion.joints().iter().all(|v| v.is_finite()));
            assert_eq!((motion.tokens().len(), motion.tokens()[1]), (6, 6));
            let stage = stopper.stage.unwrap();
            if stage == Stage::Reading {
                assert_eq!(stopper.steps, 1, "the first proposals end a plan that was to finish before there were any");
            }
            if stage == Stage::Planning {
                assert!(stopper.steps >= 1 && stopper.steps <= 3);
            }
            if at % 5 == 0 {
                assert_eq!(generator.generate(&request, &mut ()).unwrap().hash(), hash, "behind call {at}");
            }
        }
        for stage in [Stage::Reading, Stage::Planning, Stage::Refining, Stage::Decoding] {
            assert!(seen.contains(&stage), "{stage:?}");
        }
        assert_eq!(generator.generate(&request, &mut ()).unwrap().hash(), hash);
    });
}

#[test]
fn finishing_takes_the_last_proposals() {
    // Finish at the second step's first layer: what comes out is the first step's proposal, as one step alone gives it.
    struct Second(bool);
    impl Observer for Second {
        fn progress(&mut self, progress: Progress) -> ControlFlow<Stop> {
            if progress.stage == Stage::Planning && progress.evaluation == 2 && !self.0 {
                self.0 = true;
                return ControlFlow::Break(Stop::Finish);
            }
            ControlFlow::Continue(())
        }
    }
    with(&tiny(), |generator| {
        for seed in 0..10 {
            let request = base().seed(seed).steps(6);
            let finished = generator.generate(&request, &mut Second(false)).unwrap().tokens().to_vec();
            // Time of the first step is 0 in both, and its draws stand at the same place of the stream.
            assert_eq!(finished, tokens(generator, &request.steps(1)), "seed {seed}");
        }
    });
}

#[test]
fn bad_input_is_a_typed_error_and_the_generator_survives() {
    with(&tiny(), |generator| {
        let good = generator.generate(&base(), &mut ()).unwrap().hash();
        let long = "a ".repeat(5000);
        let one = "a".repeat(10_000);
        let spaced = format!("{}run", " ".repeat(MAX_PROMPT));
        let fixed = |position, token| [Fixed { position, token }];
        let (behind, beyond) = (fixed(6, 0), fixed(2, CODES));
        let conflict =
            [Fixed { position: 3, token: 1 }, Fixed { position: 2, token: 2 }, Fixed { position: 3, token: 2 }];
        let many = [Fixed { position: 0, token: 0 }; 14];
        let prompt = |e| Error::Prompt(e);
        let planning = |e| Error::Planning(e);
        let sample = |temperature, top_p| base().sampling(Sampling::Sample { temperature, top_k: 0, top_p });
        let cases: Vec<(Request<'_>, Error)> = vec![
            (Request::text(""), prompt(PromptError::Empty)),
            (Request::text(" ...!\n"), prompt(PromptError::Empty)),
            (Request::text("zebra quagga"), prompt(PromptError::OnlyUnknownWords { words: 2 })),
            (Request::text("<unknown>"), prompt(PromptError::OnlyUnknownWords { words: 1 })),
            (Request::text(&long), prompt(PromptError::TooLong { found: 10_000, limit: MAX_PROMPT })),
            (Request::text(&one), prompt(PromptError::TooLong { found: 10_000, limit: MAX_PROMPT })),
            (Request::text(&spaced), prompt(PromptError::TooLong { found: MAX_PROMPT + 3, limit: MAX_PROMPT })),
            (Request::text(&long[..200]), prompt(PromptError::TooManyWords { found: 100, limit: 7 })),
            (Request::text(&one[..4000]), prompt(PromptError::OnlyUnknownWords { words: 1 })),
            (Request::bank("jump"), prompt(PromptError::NotStored { stored: 2 })),
            (Request::bank(""), prompt(PromptError::NotStored { stored: 2 })),
            (base().length(Length::Tokens(0)), planning(PlanningError::Length { found: 0, limit: 13 })),
            (base().length(Length::Tokens(14)), planning(PlanningError::Length { found: 14, limit: 13 })),
            (base().frames(0), planning(PlanningError::Length { found: 0, limit: 13 })),
            (base().frames(53), planning(PlanningError::Length { found: 14, limit: 13 })),
            (base().steps(0), planning(PlanningError::Steps { found: 0, limit: 1000 })),
            (base().steps(1001), planning(PlanningError::Steps { found: 1001, limit: 1000 })),
            (base().guidance(-0.5), planning(PlanningError::Guidance { found: -0.5 })),
            (base().guidance(100.5), planning(PlanningError::Guidance { found: 100.5 })),
            (sample(0.0, 1.0), planning(PlanningError::Sampling(SamplingError::Temperature { found: 0.0 }))),
            (sample(1.0, 0.0), planning(PlanningError::Sampling(SamplingError::TopP { found: 0.0 }))),
            (sample(1.0, 1.5), planning(PlanningError::Sampling(SamplingError::TopP { found: 1.5 }))),
            (base().fixed(&behind), planning(PlanningError::FixedPosition { index: 0, position: 6, tokens: 6 })),
            (base().fixed(&beyond), planning(PlanningError::FixedToken { index: 0, token: 11, codes: 11 })),
            (base().fixed(&conflict), planning(PlanningError::FixedConflict { first: 0, second: 2 })),
            (base().fixed(&many), planning(PlanningError::TooManyFixed { found: 14, limit: 13 })),
        ];
        for (request, want) in cases {
            let got = generator.generate(&request, &mut ()).map(|_: Motion<'_>| ()).unwrap_err();
            assert_eq!(got, want);
            assert!(!got.to_string().is_empty());
            if !matches!(want, Error::Prompt(PromptError::OnlyUnknownWords { .. })) {
                assert_eq!(generator.plan(&request).unwrap_err(), want, "the plan says so as well");
            }
        }
        for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            let guidance = generator.generate(&base().guidance(bad), &mut ()).map(|_| ()).unwrap_err();
            assert!(matches!(guidance, Error::Planning(PlanningError::Guidance { .. })), "{guidance}");
            let temperature = generator.generate(&sample(bad, 1.0), &mut ()).map(|_| ()).unwrap_err();
            assert!(matches!(temperature, Error::Planning(PlanningError::Sampling(_))), "{temperature}");
            let top_p = generator.generate(&sample(1.0, bad), &mut ()).map(|_| ()).unwrap_err();
            assert!(matches!(top_p, Error::Planning(PlanningError::Sampling(_))), "{top_p}");
        }
        let late = [Anchor::root(24, [0.0; 3])];
        assert!(matches!(generator.generate(&base().through(&late), &mut ()), Err(Error::Anchors(_))));
        assert_eq!(generator.generate(&base(), &mut ()).unwrap().hash(), good);
    });
}

#[test]
fn blobs_without_encoder_or_planner_say_so() {
    let bank = vec![("<none>", 1), ("wave", 3)];
    let prior = PriorShape { words: vec![], bank, ..PriorShape::default() };
    let stored = Tiny::new(Shape { prior: Some(prior), ..Shape::with_prior() }, 33);
    with(&stored, |generator| {
        let refused = generator.generate(&base(), &mut ()).map(|_| ()).unwrap_err();
        assert_eq!(refused, Error::Prompt(PromptError::NoEncoder { stored: 2 }));
        assert_eq!(tokens(generator, &Request::bank("wave").length(Length::Tokens(3))).len(), 3);
    });
    let prior = PriorShape { planned: false, ..PriorShape::default() };
    let unplanned = Tiny::new(Shape { prior: Some(prior), ..Shape::with_prior() }, 34);
    for tiny in [unplanned, Tiny::new(Shape::default(), 35)] {
        with(&tiny, |generator| {
            for request in [base(), Request::bank("wave")] {
                let refused = generator.generate(&request, &mut ()).map(|_| ()).unwrap_err();
                assert_eq!(refused, Error::Planning(PlanningError::NoPlanner));
            }
            assert!(generator.generate(&Request::tokens(&[1, 2]), &mut ()).is_ok());
        });
    }
}

#[test]
fn bad_configurations_are_refused_by_name() {
    let refused = |change: &dyn Fn(&mut PriorShape), shape: &dyn Fn(&mut Shape)| {
        let mut prior = PriorShape::default();
        change(&mut prior);
        let mut whole = Shape { prior: Some(prior), ..Shape::with_prior() };
        shape(&mut whole);
        let tiny = Tiny::new(whole, 36);
        let result = Model::open(tiny.bytes()).map(|_| ());
        result.unwrap_err()
    };
    let same: &dyn Fn(&mut Shape) = &|_| ();
    let config = |error: BlobError| match error {
        BlobError::Config { what, found, limit } => (what, found, limit),
        other => panic!("{other}"),
    };
    let number = |error: BlobError| match error {
        BlobError::Number { what, bits } => (what, f32::from_bits(bits)),
        other => panic!("{other}"),
    };
    let heads = config(refused(&|p| p.planner.heads = 3, same));
    assert_eq!(heads, ("transformer.heads that do not divide the width", 3, 8));
    assert_eq!(config(refused(&|p| p.planner.heads = 0, same)), ("transformer.heads", 0, 64));
    assert_eq!(config(refused(&|p| p.text.layers = 33, same)), ("transformer.layers", 33, 32));
    assert_eq!(config(refused(&|p| p.max_words = 257, same)), ("text.max_words", 257, 256));
    let words = config(refused(&|p| p.words = vec!["a", "b", "c"], same));
    assert_eq!(words.0, "text.encoder.table without <none> and <unknown>");
    let words = config(refused(&|p| p.words = vec![], same));
    assert_eq!(words.0, "text.bank without <none>");
    let rows = config(refused(&|p| p.bank = vec![("wave", 8)], same));
    assert_eq!(rows, ("rows of a stored prompt", 9, 8));
    let quantizers = config(refused(&|_| (), &|s| s.quantizers = 2));
    assert_eq!(quantizers, ("codec.quantizers with a planner", 2, 1));
    let tokens = config(refused(&|_| (), &|s| s.max_tokens = 256));
    assert_eq!(tokens, ("generator.max_tokens with a planner", 256, 255));
    let near = |c: f32, a: f32| refused(&move |p| p.corruption = Corruption::Near { c, a }, same);
    assert_eq!(number(near(-1.0, 0.9)), ("generator.c", -1.0));
    assert_eq!(number(near(3.0, 4.5)), ("generator.a", 4.5));
    assert_eq!(number(refused(&|p| p.text.epsilon = 0.0, same)), ("transformer.epsilon", 0.0));
    assert!(number(refused(&|p| p.planner.epsilon = f32::NAN, same)).1.is_nan());
}

#[test]
fn planned_work_is_that_of_the_layers() {
    let tiny = tiny();
    let model = Model::open(tiny.bytes()).unwrap();
    let modules = model.planning().unwrap();
    let (l, n, v, du) = (6u64, 5u64, 11u64, 6u64);
    let (dt, ht, d, h, layers) = (12u64, 10u64, 8u64, 14u64, 2u64);
    let text = |n: u64| n * (4 * dt * dt + 2 * n * dt + 2 * dt * ht);
    let read = |n: u64| text(n) + dt * d + layers * n * dt * 2 * d;
    let pass = |n: u64| layers * (1 + l) * (4 * d * d + 2 * (1 + l) * d + 2 * d * d + 2 * n * d + 2 * d * h);
    // Distances are computed for eight codes side by side.
    let (steps, side_by_side) = (4, v.next_multiple_of(8));
    let want = read(n) + read(1) + dt * 13 + steps * (pass(n) + pass(1) + l * (d * v + side_by_side * du));
    let limits = PlanningLimits { words: 5, steps: 4, guided: true, anchors: false, clauses: 1 };
    assert_eq!(modules.macs(6, &limits), want);
    let alone = read(n) + dt * 13 + steps * (pass(n) + l * (d * v + side_by_side * du));
    assert_eq!(modules.macs(6, &PlanningLimits { guided: false, ..limits }), alone);
}
