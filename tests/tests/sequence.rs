//! A prompt of several clauses: each is what a request of its own makes behind the given end of the one before.

use motionette::generation::tokens::CONTEXT;
use motionette::{Anchor, Fixed, Generator, Length, Model, Observer, Planning, Progress, Request, Stage, Stop, Target};
use motionette_tests::tiny::{PriorShape, Shape, Tiny};
use std::ops::ControlFlow;

const SEED_STEP: u64 = 0x9E37_79B9_7F4A_7C15;

fn tiny() -> Tiny {
    let shape = Shape { prior: Some(PriorShape::understanding()), ..Shape::with_prior() };
    Tiny::new(shape, 31)
}

fn with<T>(tiny: &Tiny, work: impl FnOnce(&mut Generator<'_>) -> T) -> T {
    let mut memory = vec![0u128; (1 << 20) / 16];
    let model = Model::open(tiny.bytes()).unwrap();
    work(&mut Generator::new(model, bytemuck::cast_slice_mut(&mut memory)).unwrap())
}

/// The tokens of `clauses`, each made by a request of its own whose beginning is given; `length` in tokens, if the whole has one.
fn by_requests(
    generator: &mut Generator<'_>,
    clauses: &[&str],
    length: Option<usize>,
    base: &Planning<'_>,
) -> Vec<u16> {
    let all = length.unwrap_or(generator.model().max_tokens());
    let mut tokens: Vec<u16> = Vec::new();
    for (k, clause) in clauses.iter().enumerate() {
        let left = all - tokens.len();
        let share = left.div_ceil(clauses.len() - k);
        let last = k + 1 == clauses.len();
        let alone = Request::text(clause).planned(Planning { length: Length::Predicted, ..*base });
        let predicted = generator.generate(&alone, &mut ()).unwrap().tokens().len();
        let count = if last && length.is_some() { left } else { predicted.min(share) };
        let context = tokens.len().min(CONTEXT);
        let before = tokens.len() - context;
        let given: Vec<Fixed> =
            tokens[before..].iter().enumerate().map(|(i, &token)| Fixed { position: i as u16, token }).collect();
        let planning = Planning {
            length: Length::Tokens((context + count) as u16),
            seed: base.seed.wrapping_add((k as u64).wrapping_mul(SEED_STEP)),
            fixed: &given,
            start_open: before > 0,
            end_open: !last,
            ..*base
        };
        let motion = generator.generate(&Request::text(clause).planned(planning), &mut ()).unwrap();
        assert_eq!(motion.tokens()[..context], tokens[before..]);
        tokens.extend(&motion.tokens()[context..]);
    }
    tokens
}

#[test]
fn each_clause_is_planned_behind_the_end_of_the_one_before() {
    let tiny = tiny();
    with(&tiny, |generator| {
        let prompt = "waves, then run run; left hand";
        let clauses = ["waves", "run run", "left hand"];
        for (seed, guidance, length) in
            [(3, 2.0, None), (u64::MAX - 5, 1.0, Some(13)), (8, 2.0, Some(5)), (1, 2.0, Some(2))]
        {
            let given = length.map_or(Length::Predicted, |length: usize| Length::Tokens(length as u16));
            let base = Planning { seed, guidance, steps: 4, length: given, ..Planning::default() };
            // Of two tokens nothing is left for the third clause.
            let clauses = if length == Some(2) { &clauses[..2] } else { &clauses[..] };
            let prompt = if length == Some(2) { "waves, then run run" } else { prompt };
            let want = by_requests(generator, clauses, length, &base);
            let motion = generator.generate(&Request::text(prompt).planned(base), &mut ()).unwrap();
            assert_eq!(motion.tokens(), want, "length {length:?}");
            assert_eq!(length.unwrap_or(want.len()), want.len());
            assert_eq!(
                (usize::from(motion.words()), motion.unknown_words()),
                (prompt.replace("then ", "").split(' ').count(), 0)
            );
            assert_eq!(1 + motion.then().count(), clauses.len());
        }
        // What is asked for last is done first where "after" says so.
        let base = Planning { seed: 4, steps: 3, ..Planning::default() };
        let swapped = generator
            .generate(&Request::text("a hand after running").planned(base), &mut ())
            .unwrap()
            .tokens()
            .to_vec();
        assert_eq!(swapped, by_requests(generator, &["running", "a hand"], None, &base));
    });
}

#[test]
fn what_each_clause_means_is_told() {
    let tiny = tiny();
    with(&tiny, |generator| {
        let alone = |generator: &mut Generator<'_>, prompt| {
            generator.generate(&Request::text(prompt).steps(1), &mut ()).unwrap().understood().unwrap()
        };
        let want = ["waves", "run", "left hand"].map(|clause| alone(generator, clause));
        let motion = generator.generate(&Request::text("waves, then run, then left hand").steps(1), &mut ()).unwrap();
        let got: Vec<_> = motion.understood().into_iter().chain(motion.then()).collect();
        assert_eq!(got, want);
    });
}

/// Counts what it is told.
#[derive(Default)]
struct Counting {
    steps: Vec<u16>,
    evaluations: Vec<(u16, u16)>,
    abort_at: Option<usize>,
}

impl Observer for Counting {
    fn progress(&mut self, progress: Progress) -> ControlFlow<Stop> {
        if progress.stage == Stage::Planning {
            self.evaluations.push((progress.evaluation, progress.evaluations));
        }
        if self.abort_at.is_some_and(|at| self.steps.len() >= at) {
            ControlFlow::Break(Stop::Abort)
        } else {
            ControlFlow::Continue(())
        }
    }

    fn tokens(&mut self, step: u16, _: &[u16]) {
        self.steps.push(step);
    }
}

fn steps(generator: &mut Generator<'_>, request: &Request<'_>) -> Vec<u16> {
    let mut counting = Counting::default();
    generator.generate(request, &mut counting).unwrap();
    assert!(counting.evaluations.is_sorted(), "progress never goes back");
    let all = counting.steps.len() as u16;
    assert!(counting.evaluations.iter().all(|&(done, of)| of == all && (1..=all).contains(&done)));
    counting.steps
}

#[test]
fn a_prompt_stays_whole_where_it_cannot_be_parted() {
    let tiny = tiny();
    with(&tiny, |generator| {
        let parted = Request::text("a person waves, then run").steps(3);
        assert_eq!(steps(generator, &parted), [0, 1, 2, 3, 4, 5]);
        // A part without a known word, tokens that are given, a segment of a stream.
        assert_eq!(steps(generator, &Request::text("run, then xyzzy").steps(3)), [0, 1, 2]);
        let given = [Fixed { position: 1, token: 3 }];
        assert_eq!(steps(generator, &parted.fixed(&given)), [0, 1, 2]);
        let plan = |generator: &mut Generator<'_>, prompt| generator.plan(&Request::text(prompt).steps(3)).unwrap();
        let (one, two) = (plan(generator, "a person waves xx run"), plan(generator, "a person waves then run"));
        assert_eq!(one.arena_bytes, two.arena_bytes, "clauses cost no memory");
        let used = generator.generate(&Request::text("a person waves then run").steps(3), &mut ()).unwrap().arena_used;
        assert_eq!(used, two.arena_bytes);
        assert!(two.planning_macs > one.planning_macs);
    });
}

/// Stopped in the second clause, and able to go on at once.
#[test]
fn the_second_clause_can_be_stopped() {
    let tiny = tiny();
    with(&tiny, |generator| {
        let request = Request::text("a person waves, then run").steps(3);
        let whole = generator.generate(&request, &mut ()).unwrap().tokens().to_vec();
        let mut observer = Counting { abort_at: Some(4), ..Counting::default() };
        assert!(generator.generate(&request, &mut observer).is_err());
        assert_eq!(observer.steps, [0, 1, 2, 3]);
        assert_eq!(generator.generate(&request, &mut ()).unwrap().tokens(), whole);
    });
}

/// Anchors are met by refinement; the planner, which sees a clause at a time, is not told of them, and the motion reaches the last.
#[test]
fn anchors_of_several_clauses_only_refine() {
    let tiny = tiny();
    with(&tiny, |generator| {
        let frame = (generator.model().max_tokens() * generator.model().frames_per_token()) as u16 - 1;
        let anchors = [Anchor { frame, target: Target::Root([0.3, 0.9, 0.2]) }];
        let request = Request::text("a person waves, then run").steps(3).through(&anchors);
        let motion = generator.generate(&request, &mut ()).unwrap();
        assert_eq!((motion.frames().len(), motion.unconditioned_anchors()), (usize::from(frame) + 1, 1));
    });
}

/// A prompt that the model takes for one action, and for another one than each of its clauses, is planned as that: by what requests of their
/// own say that was understood.
#[test]
fn one_action_is_not_parted() {
    let tiny = tiny();
    with(&tiny, |generator| {
        let heard = |generator: &mut Generator<'_>, prompt: &str| {
            let motion = generator.generate(&Request::text(prompt).steps(1).fixed(&WHOLE), &mut ()).unwrap();
            motion.understood().filter(|understood| understood.sure).map(|understood| understood.action().phrase)
        };
        let words = ["a", "person", "waves", "run", "left", "hand"];
        let mut seen = [0, 0];
        for first in words {
            for second in words {
                let prompt = format!("{first} {second} then {second} {first} {first}");
                let clauses = [format!("{first} {second}"), format!("{second} {first} {first}")];
                let whole = heard(generator, &prompt);
                let one = whole.is_some() && clauses.iter().all(|clause| heard(generator, clause) != whole);
                let expected: &[u16] = if one { &[0, 1] } else { &[0, 1, 2, 3] };
                assert_eq!(steps(generator, &Request::text(&prompt).steps(2)), expected, "{prompt}");
                seen[usize::from(one)] += 1;
            }
        }
        assert!(seen.iter().all(|count| *count > 0), "{seen:?}");
    });
}

/// A given token leaves a prompt whole.
const WHOLE: [Fixed; 1] = [Fixed { position: 0, token: 0 }];
