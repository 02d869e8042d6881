//! Masked tokens of a planner that reads words: which are masked again, what is given stays, and whole runs against the reference's process.

use motionette::generation::tokens::{PlanningLimits, SEED_STEP, Session};
use motionette::memory::Arena;
use motionette::numerics::hash::Stream;
use motionette::{
    Fixed, Generator, Length, Model, Observer, Planning, Progress, Prompt, ROWS, Request, Sampling, Schedule, Stop,
    StreamLimits,
};
use motionette_host::reference::masked::Masked;
use motionette_host::reference::tmd;
use motionette_tests::tiny::{PriorShape, Shape, Tiny};
use std::ops::ControlFlow;

const PROMPT: &str = "a person waves";

fn tiny(max_tokens: u16, prior: PriorShape) -> Tiny {
    Tiny::new(Shape { max_tokens, prior: Some(prior), ..Shape::with_prior() }, 40)
}

fn go_on() -> ControlFlow<Stop> {
    ControlFlow::Continue(())
}

/// Runs `work` in a session of `tiny` that has read the prompt.
fn session<T>(tiny: &Tiny, tokens: usize, guided: bool, work: impl FnOnce(&mut Session<'_, '_, '_>) -> T) -> T {
    let model = Model::open(tiny.bytes()).expect("the blob opens");
    let modules = model.planning().expect("the blob plans");
    let limits = PlanningLimits { words: 3, steps: 1, guided, anchors: false, clauses: 1 };
    let mut words = vec![0u128; modules.bytes(tokens, &limits, ROWS).all() / 16];
    let mut arena = Arena::new(bytemuck::cast_slice_mut(&mut words));
    let mut session = Session::new(modules, &mut arena, tokens, &limits, ROWS).expect("the planned bytes suffice");
    assert!(session.read(&Prompt::Text(PROMPT), &mut go_on).expect("known words").is_continue());
    work(&mut session)
}

/// Logits `[L][V]` of one pass.
fn logits(session: &mut Session<'_, '_, '_>, tokens: &[u16], time: f32, planning: &Planning<'_>) -> Vec<f32> {
    assert!(session.pass(tokens, time, planning, &mut go_on).is_continue());
    (0..tokens.len()).flat_map(|i| session.logits(i).to_vec()).collect()
}

fn softmax(row: &[f32]) -> Vec<f64> {
    let total: f64 = row.iter().map(|v| f64::from(*v).exp()).sum();
    row.iter().map(|v| f64::from(*v).exp() / total).collect()
}

/// Every step for every length to 49 and up to 20 steps, against a sort of all scores: how many are masked again, and that no one that is not
/// was less certain. What is given, or was drawn and kept, stays.
#[test]
fn the_least_certain_are_masked_again() {
    let tiny = tiny(49, PriorShape::masked());
    let mask = tiny.shape.codes;
    for length in 1..=49_usize {
        let given: Vec<Fixed> =
            (0..length).filter(|i| i % 7 == 2).map(|i| Fixed { position: i as u16, token: i as u16 % mask }).collect();
        session(&tiny, length, false, |session| {
            for steps in 1..=20_u16 {
                let fixed = if steps % 2 == 0 { &given[..] } else { &[] };
                let planning =
                    Planning { steps, guidance: 1.0, sampling: Sampling::Greedy, fixed, ..Planning::DEFAULT };
                let free = length - fixed.len();
                let (mut random, mut tokens) = (Stream::new(1), vec![0; length]);
                session.begin(&planning, &mut random, &mut tokens);
                let is_given = |i: usize| fixed.iter().find(|f| usize::from(f.position) == i).map(|f| f.token);
                assert!((0..length).all(|i| tokens[i] == is_given(i).unwrap_or(mask)));
                for step in 0..steps {
                    let before = tokens.clone();
                    let rows = logits(session, &before, session.time(&planning, step), &planning);
                    let rows: Vec<Vec<f64>> = rows.chunks(usize::from(mask)).map(softmax).collect();
                    let last = step + 1 == steps;
                    session.advance(&planning, (!last).then_some(step), &mut random, &mut tokens);
                    let again: Vec<usize> = (0..length).filter(|&i| tokens[i] == mask).collect();
                    let mut scores: Vec<f64> = (0..length)
                        .filter(|&i| before[i] == mask)
                        .map(|i| rows[i].iter().copied().fold(0.0, f64::max))
                        .collect();
                    // Those that were kept before come last.
                    scores.resize(free, 1e5);
                    scores.sort_by(f64::total_cmp);
                    let time = f64::from(step + 1) / f64::from(steps - 1);
                    let share = (std::f64::consts::FRAC_PI_2 * time).cos();
                    let wanted = if last { 0.0 } else { (share * free as f64).max(1.0).min(free as f64) };
                    let count = again.len();
                    // In singles a half may fall to either side.
                    let near = (count as f64 - wanted).abs() < 0.5 + 1e-5 && (count == 0) == (wanted == 0.0);
                    assert!(near, "{count}, not {wanted}: step {step} of {steps}, {length} tokens");
                    let bound = scores.get(count.wrapping_sub(1)).copied().unwrap_or(0.0);
                    for i in 0..length {
                        let score = rows[i].iter().copied().fold(0.0, f64::max);
                        match (before[i] == mask, tokens[i] == mask) {
                            (true, true) => assert!(score <= bound + 1e-6, "{i} is masked at {score}, not {bound}"),
                            (true, false) => {
                                assert!((rows[i][usize::from(tokens[i])] - score).abs() < 1e-6, "the likeliest");
                                assert!(score >= bound - 1e-6, "{i} stays at {score}, not {bound}");
                            }
                            (false, masked) => assert!(!masked && tokens[i] == before[i], "{i} was not masked"),
                        }
                    }
                    assert!((0..length).all(|i| is_given(i).is_none_or(|token| tokens[i] == token)));
                }
            }
        });
    }
}

/// Tokens after every step.
#[derive(Default)]
struct Steps(Vec<Vec<u16>>);

impl Observer for Steps {
    fn tokens(&mut self, _: u16, tokens: &[u16]) {
        self.0.push(tokens.to_vec());
    }

    fn progress(&mut self, _: Progress) -> ControlFlow<Stop> {
        ControlFlow::Continue(())
    }
}

/// Whole requests: every step's tokens are those of the reference's process, which is given the runtime's logits and the same seed.
#[test]
fn whole_runs_are_those_of_the_reference() {
    let samplings = [
        (Sampling::Greedy, tmd::Sampling::Greedy),
        (
            Sampling::Sample { temperature: 1.0, top_k: 0, top_p: 1.0 },
            tmd::Sampling::Sample { temperature: 1.0, top_k: 0, top_p: 1.0 },
        ),
        (
            Sampling::Sample { temperature: 1.4, top_k: 5, top_p: 0.9 },
            tmd::Sampling::Sample { temperature: 1.4, top_k: 5, top_p: 0.9 },
        ),
        (Sampling::Gumbel { temperature: 0.8 }, tmd::Sampling::Gumbel { temperature: 0.8 }),
    ];
    let given = [Fixed { position: 0, token: 4 }, Fixed { position: 5, token: 9 }];
    for prior in [PriorShape::masked(), PriorShape { one_pass: true, ..PriorShape::masked() }] {
        let tiny = tiny(13, prior);
        let model = Model::open(tiny.bytes()).expect("the blob opens");
        let meant = model.default_planning();
        assert_eq!((meant.steps, meant.guidance), (10, 2.0));
        assert_eq!(meant.sampling, Sampling::Sample { temperature: 1.0, top_k: 0, top_p: 1.0 });
        let mut arena = vec![0u8; 1 << 20];
        let mut generator = Generator::new(model, &mut arena).expect("default floating point");
        let mut reached = 0;
        for (n, (sampling, of_reference)) in samplings.into_iter().enumerate() {
            for (schedule, times) in
                [(Schedule::Uniform, tmd::Schedule::Uniform), (Schedule::Cosine, tmd::Schedule::Cosine)]
            {
                for (seed, (length, steps)) in [(13, 10), (9, 4), (7, 1), (6, 2), (12, 20)].into_iter().enumerate() {
                    let fixed = if n % 2 == seed % 2 { &given[..] } else { &[] };
                    let planning = Planning {
                        length: Length::Tokens(length),
                        seed: seed as u64,
                        steps,
                        schedule,
                        sampling,
                        fixed,
                        start_open: seed == 1,
                        end_open: seed == 2,
                        ..meant
                    };
                    let settings = tmd::Settings {
                        seed: planning.seed,
                        steps: usize::from(steps),
                        schedule: times,
                        sampling: of_reference,
                        fixed: fixed.iter().map(|f| (usize::from(f.position), f.token)).collect(),
                    };
                    let mut seen = Steps::default();
                    let request = Request::text(PROMPT).planned(planning);
                    let tokens = generator.generate(&request, &mut seen).expect("a motion").tokens().to_vec();
                    let process = Masked { codes: usize::from(tiny.shape.codes) };
                    let exact = session(&tiny, usize::from(length), true, |session| {
                        process.sample(usize::from(length), &settings, |tokens, time| {
                            logits(session, tokens, time as f32, &planning)
                        })
                    });
                    assert_eq!(seen.0, exact, "{planning:?}");
                    assert_eq!(Some(&tokens), exact.last());
                    assert!(fixed.iter().all(|f| exact.iter().all(|z| z[usize::from(f.position)] == f.token)));
                    reached += exact.iter().filter(|z| z.contains(&tiny.shape.codes)).count();
                }
            }
        }
        assert!(reached > 100, "hardly anything was masked again: {reached}");
    }
}

/// A stream's segments are requests whose first tokens are given.
#[test]
fn streams_go_on_behind_given_tokens() {
    let tiny = tiny(13, PriorShape::masked());
    let model = Model::open(tiny.bytes()).expect("the blob opens");
    let planning = Planning { seed: 11, steps: 5, ..model.default_planning() };
    let limits = PlanningLimits { words: 3, steps: 5, guided: true, anchors: false, clauses: 1 };
    let limits = StreamLimits { tokens: 13, planning: Some(limits), rows: ROWS };
    let mut arena = vec![0u8; 1 << 20];
    let mut generator = Generator::new(model.clone(), &mut arena).expect("default floating point");
    let mut stream = generator.stream(&limits).expect("a stream");
    let request = Request::text(PROMPT).planned(planning);
    for count in [5, 6] {
        stream.plan(&request.length(Length::Tokens(count)), &mut ()).expect("a segment");
        while stream.frames(&mut ()).expect("frames").is_some() {}
    }
    let tokens = stream.tokens().to_vec();
    let mut whole = |request: &Request<'_>| generator.generate(request, &mut ()).expect("a motion").tokens().to_vec();
    let first = whole(&request.planned(Planning { length: Length::Tokens(5), end_open: true, ..planning }));
    assert_eq!(tokens[..5], first);
    let given = first.iter().zip(0..).map(|(&token, position)| Fixed { position, token }).collect::<Vec<_>>();
    let next = Planning {
        length: Length::Tokens(11),
        seed: planning.seed.wrapping_add(SEED_STEP),
        fixed: &given,
        end_open: true,
        ..planning
    };
    assert_eq!(tokens[5..], whole(&request.planned(next))[5..]);
}

/// Clauses follow one another, each behind tokens of the one before that are never masked.
#[test]
fn clauses_are_planned_one_behind_the_other() {
    let tiny = tiny(30, PriorShape::masked());
    let model = Model::open(tiny.bytes()).expect("the blob opens");
    let meant = model.default_planning();
    let mut arena = vec![0u8; 1 << 20];
    let mut generator = Generator::new(model, &mut arena).expect("default floating point");
    let mut seen = Steps::default();
    let request = Request::text("a person waves, then run").planned(Planning { steps: 4, ..meant });
    let motion = generator.generate(&request, &mut seen).expect("a motion");
    assert_eq!(seen.0.len(), 8, "two clauses of four steps");
    let mask = tiny.shape.codes;
    assert!(motion.tokens().iter().all(|token| *token < mask));
    // Of the second clause the context was given: it is in no step masked.
    let known = seen.0[3].len();
    let context = known.min(8);
    assert!(seen.0[4..].iter().all(|step| step[..context] == seen.0[3][known - context..]));
    assert!(seen.0[4].contains(&mask) && !seen.0[7].contains(&mask));
}
