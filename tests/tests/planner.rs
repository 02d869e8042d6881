//! The planner against an f64 oracle on small random models: text encoder, length, logits, and the sampler's marginals.

use motionette::blob::{Activation, Corruption, Norm};
use motionette::generation::tokens::tmd::{Metric, Tmd};
use motionette::generation::tokens::{PlanningLimits, Session};
use motionette::memory::Arena;
use motionette::numerics::hash::Stream;
use motionette::{Fixed, Generator, Length, Model, Observer, Planning, Prompt, ROWS, Request, Sampling, Stop};
use motionette_tests::naive_prior::{self, Rows, Scene};
use motionette_tests::tiny::{PriorShape, Shape, Tiny};
use std::ops::ControlFlow;

const PROMPT: &str = "A person, waving the left hand!";
/// Its ids in the default vocabulary: `waving` is no form of `waves`, `the` is unknown.
const IDS: [u16; 6] = [2, 3, 1, 1, 6, 7];

/// Runs `work` in a session of `tiny`.
fn session<T>(
    tiny: &Tiny,
    tokens: usize,
    limits: PlanningLimits,
    work: impl FnOnce(&mut Session<'_, '_, '_>) -> T,
) -> T {
    let model = Model::open(tiny.bytes()).expect("the blob opens");
    let modules = model.planning().expect("the blob plans");
    let bytes = modules.bytes(tokens, &limits, ROWS).all();
    let mut words = vec![0u128; bytes / 16];
    let mut arena = Arena::new(bytemuck::cast_slice_mut(&mut words));
    let mut session = Session::new(modules, &mut arena, tokens, &limits, ROWS).expect("the planned bytes suffice");
    assert_eq!(arena.used(), bytes, "planned bytes are what a session takes");
    work(&mut session)
}

fn shapes() -> Vec<Shape> {
    let base = PriorShape::default();
    let with = |prior: PriorShape| Shape { prior: Some(prior), ..Shape::with_prior() };
    let mut post = base.clone();
    post.text.norm = Norm::Post;
    post.planner = motionette::blob::TransformerConfig { norm: Norm::Post, heads: 1, layers: 3, ..post.planner };
    let mut relu = base.clone();
    relu.text = motionette::blob::TransformerConfig { activation: Activation::Relu, heads: 1, layers: 2, ..relu.text };
    relu.planner.activation = Activation::Relu;
    relu.planner.heads = 4;
    let mut wide = base.clone();
    wide.planner = motionette::blob::TransformerConfig { width: 24, heads: 3, layers: 1, hidden: 50, ..wide.planner };
    vec![with(base), with(post), with(relu), with(wide), with(PriorShape::packed()), with(PriorShape::masked())]
}

/// The same scene, every other token that is not given masked, where the model knows masks.
fn masked(shape: &Shape, mut scene: Scene) -> Scene {
    if shape.prior.as_ref().is_some_and(|prior| prior.corruption == Corruption::Masks) {
        let free = (0..scene.tokens.len()).filter(|i| !scene.fixed.contains(i)).step_by(2);
        free.collect::<Vec<_>>().into_iter().for_each(|i| scene.tokens[i] = shape.codes);
    }
    scene
}

fn scenes() -> Vec<Scene> {
    vec![
        Scene { tokens: vec![4], ..Scene::default() },
        Scene { tokens: vec![1, 7, 3, 10, 0, 2, 5], time: 0.25, ..Scene::default() },
        Scene { tokens: vec![9, 9, 1, 0, 6], time: 0.5, fixed: vec![0, 3], start_open: true, ..Scene::default() },
        Scene { tokens: (0..13).map(|i| i % 11).collect(), time: 0.999, end_open: true, ..Scene::default() },
    ]
}

fn planning<'p>(scene: &Scene, fixed: &'p mut Vec<Fixed>, guidance: f32) -> Planning<'p> {
    *fixed = scene.fixed.iter().map(|&i| Fixed { position: i as u16, token: scene.tokens[i] }).collect();
    Planning { guidance, fixed, start_open: scene.start_open, end_open: scene.end_open, ..Planning::DEFAULT }
}

/// Largest and root mean square difference of two sets of logits, each position's mean taken off.
fn difference(got: &Rows, want: &Rows) -> (f64, f64) {
    let (mut worst, mut squares, mut count) = (0.0f64, 0.0, 0.0);
    for (got, want) in got.iter().zip(want) {
        for (g, w) in got.iter().zip(want) {
            worst = worst.max((g - w).abs());
            squares += (g - w).powi(2);
            count += 1.0;
        }
    }
    (worst, f64::sqrt(squares / count))
}

fn spread(rows: &Rows) -> f64 {
    let all: Vec<f64> = rows.iter().flatten().copied().collect();
    let mean = all.iter().sum::<f64>() / all.len() as f64;
    (all.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / all.len() as f64).sqrt()
}

#[test]
fn logits_agree_with_the_oracle_for_every_shape_and_scene() {
    for (seed, shape) in shapes().into_iter().enumerate() {
        let tiny = Tiny::new(shape.clone(), 70 + seed as u64);
        for scene in scenes().into_iter().map(|scene| masked(&shape, scene)) {
            for guidance in [1.0f32, 2.5, 0.0] {
                let limits =
                    PlanningLimits { words: IDS.len(), steps: 1, guided: guidance != 1.0, anchors: false, clauses: 1 };
                let mut fixed = Vec::new();
                let planning = planning(&scene, &mut fixed, guidance);
                let got: Rows = session(&tiny, scene.tokens.len(), limits, |session| {
                    let heard = session
                        .read(&Prompt::Text(PROMPT), &mut || ControlFlow::Continue(()))
                        .unwrap()
                        .continue_value()
                        .unwrap();
                    assert_eq!((heard.words, heard.unknown_words), (6, 2));
                    assert!(
                        session
                            .pass(&scene.tokens, scene.time as f32, &planning, &mut || ControlFlow::Continue(()))
                            .is_continue()
                    );
                    let row = |i| session.logits(i).iter().map(|&v| f64::from(v)).collect();
                    (0..scene.tokens.len()).map(row).collect()
                });
                let (memory, pooled) = naive_prior::encode(&tiny, &IDS);
                let text = naive_prior::logits(&tiny, &scene, &memory, &pooled);
                let (memory, pooled) = naive_prior::encode(&tiny, &[0]);
                let none = naive_prior::logits(&tiny, &scene, &memory, &pooled);
                let g = f64::from(guidance);
                let mix = |(t, n): (&Vec<f64>, &Vec<f64>)| t.iter().zip(n).map(|(t, n)| n + g * (t - n)).collect();
                let want: Rows = text.iter().zip(&none).map(mix).collect();
                // int8 keys and values: a percent of the spread, more where guidance stretches the difference.
                let (worst, rms) = difference(&got, &want);
                let unit = spread(&want) * (1.0 + g);
                assert!(
                    rms < 0.02 * unit && worst < 0.1 * unit,
                    "{shape:?} {scene:?} {guidance}: {worst} {rms} {unit}"
                );
                // What the test would notice: another text, another time, another boundary.
                let (memory, pooled) = naive_prior::encode(&tiny, &[5, 2]);
                let other = naive_prior::logits(&tiny, &scene, &memory, &pooled);
                let moved = Scene { time: 0.77, end_open: !scene.end_open, ..scene.clone() };
                let (memory, pooled) = naive_prior::encode(&tiny, &IDS);
                let moved = naive_prior::logits(&tiny, &moved, &memory, &pooled);
                if guidance == 1.0 {
                    for wrong in [&other, &moved, &none] {
                        assert!(difference(&got, wrong).1 > 0.03 * unit, "{shape:?} {scene:?}");
                    }
                    if scene.tokens.contains(&shape.codes) {
                        let tokens = scene.tokens.iter().map(|&token| token.min(shape.codes - 1)).collect();
                        let (memory, pooled) = naive_prior::encode(&tiny, &IDS);
                        let unmasked = naive_prior::logits(&tiny, &Scene { tokens, ..scene.clone() }, &memory, &pooled);
                        assert!(difference(&got, &unmasked).1 > 0.03 * unit, "{shape:?} {scene:?}");
                    }
                }
            }
        }
    }
}

#[test]
fn stored_prompts_and_lengths_agree_with_the_oracle() {
    for words in [PriorShape::default().words, vec![]] {
        let bank = vec![("<none>", 2), ("wave", 3), ("stand still", 1)];
        let shape = Shape { prior: Some(PriorShape { bank, words, ..PriorShape::default() }), ..Shape::with_prior() };
        let tiny = Tiny::new(shape, 81);
        let scene = &scenes()[1];
        for (index, name, rows) in [(1, "wave", 3), (2, "stand still", 1), (0, "<none>", 2)] {
            let limits = PlanningLimits { words: rows, steps: 1, guided: true, anchors: false, clauses: 1 };
            let (got, length): (Rows, usize) = session(&tiny, 7, limits, |session| {
                let heard = session
                    .read(&Prompt::Bank(name), &mut || ControlFlow::Continue(()))
                    .unwrap()
                    .continue_value()
                    .unwrap();
                assert_eq!((usize::from(heard.words), heard.unknown_words), (rows, 0));
                let planning = Planning { guidance: 1.5, ..Planning::DEFAULT };
                assert!(
                    session
                        .pass(&scene.tokens, scene.time as f32, &planning, &mut || ControlFlow::Continue(()))
                        .is_continue()
                );
                let row = |i| session.logits(i).iter().map(|&v| f64::from(v)).collect();
                ((0..7).map(row).collect(), session.predicted_length())
            });
            let (memory, pooled) = naive_prior::stored(&tiny, index);
            let text = naive_prior::logits(&tiny, scene, &memory, &pooled);
            let p = naive_prior::lengths(&tiny, &pooled);
            let median = (1..=p.len()).find(|&n| p[..n].iter().sum::<f64>() >= 0.5).unwrap();
            assert_eq!(length, median, "{name}");
            let (memory, pooled) = if tiny.prior.as_ref().unwrap().encoder.is_some() {
                naive_prior::encode(&tiny, &[0])
            } else {
                naive_prior::stored(&tiny, 0)
            };
            let none = naive_prior::logits(&tiny, scene, &memory, &pooled);
            let mix = |(t, n): (&Vec<f64>, &Vec<f64>)| t.iter().zip(n).map(|(t, n)| n + 1.5 * (t - n)).collect();
            let want: Rows = text.iter().zip(&none).map(mix).collect();
            let (_, rms) = difference(&got, &want);
            assert!(rms < 0.03 * spread(&want), "{name}: {rms} of {}", spread(&want));
        }
    }
}

/// Upper 1e-6 quantile of the chi-square distribution (Wilson and Hilferty's approximation).
fn threshold(degrees: f64) -> f64 {
    let s = 2.0 / (9.0 * degrees);
    degrees * (1.0 - s + 4.753 * s.sqrt()).powi(3)
}

/// Pearson's statistic over cells that expect at least five, the rest put together; and the degrees of freedom.
fn chi_square(counts: &[f64], expected: &[f64]) -> (f64, f64) {
    let total: f64 = counts.iter().sum();
    let (mut statistic, mut cells, mut rest) = (0.0, 0.0, (0.0, 0.0));
    for (count, p) in counts.iter().zip(expected) {
        let e = p * total;
        if e >= 5.0 {
            statistic += (count - e).powi(2) / e;
            cells += 1.0;
        } else {
            rest = (rest.0 + count, rest.1 + e);
        }
    }
    if rest.1 > 0.5 || rest.0 > 0.0 {
        let e = rest.1.max(1e-3);
        statistic += (rest.0 - e).powi(2) / e;
        cells += 1.0;
    }
    (statistic, f64::max(cells - 1.0, 1.0))
}

/// Statistic over its threshold: above 1 the hypothesis is refused.
fn refusal(counts: &[f64], expected: &[f64]) -> f64 {
    let (statistic, degrees) = chi_square(counts, expected);
    statistic / threshold(degrees)
}

#[test]
fn a_step_has_the_marginals_of_equations_21_to_23() {
    let tiny = Tiny::new(Shape { codes: 9, code_width: 3, ..Shape::default() }, 17);
    let model = Model::open(tiny.bytes()).unwrap();
    let mut units = vec![0.0; Metric::len(model.codebooks())];
    let metric = Metric::new(model.codebooks(), &mut units);
    let (mut distances, mut weights) = ([0.0; 9], [0.0; 9]);
    for x in 0..9u16 {
        metric.distances(x, &mut distances);
        for (i, d) in distances.iter().enumerate() {
            let want = naive_prior::distance(&tiny.codes, 3, i, usize::from(x));
            assert!((f64::from(*d) - want).abs() < 1e-5, "dist({i}, {x}) = {d}, not {want}");
        }
    }
    let tmd = Tmd { c: 3.0, a: 0.9 };
    let mut stream = Stream::new(4);
    let (mut right, mut wrong) = (0.0f64, [0.0f64; 4]);
    for (present, proposal) in [(0u16, 1u16), (5, 2), (8, 3), (4, 7)] {
        for (t, h) in [(0.0f32, 0.1f32), (0.3, 0.1), (0.7, 0.1), (0.2, 0.5)] {
            let step = tmd.stride(t, t + h);
            let mut counts = [0.0; 9];
            for _ in 0..30_000 {
                let draws = (stream.unit(), stream.unit());
                let next = metric.advance(present, proposal, &step, draws, &mut distances, &mut weights);
                counts[usize::from(next)] += 1.0;
            }
            let expect = |beta: &dyn Fn(f64) -> f64, pair: (u16, u16)| {
                let pair = (usize::from(pair.0), usize::from(pair.1));
                naive_prior::transition(&tiny.codes, 3, pair, (f64::from(t), f64::from(h)), beta)
            };
            let pair = (present, proposal);
            right = right.max(refusal(&counts, &expect(&|t| naive_prior::beta(t, 3.0, 0.9), pair)));
            let mistakes = [
                expect(&|t| naive_prior::beta(t, 3.0, 0.8), pair),
                expect(&|t| naive_prior::beta(t, 2.7, 0.9), pair),
                expect(&|t| 3.0 * t, pair),
                expect(&|t| naive_prior::beta(t, 3.0, 0.9), (proposal, present)),
            ];
            for (wrong, mistake) in wrong.iter_mut().zip(&mistakes) {
                *wrong = wrong.max(refusal(&counts, mistake));
            }
        }
    }
    assert!(right < 1.0, "the marginals are refused: {right}");
    assert!(wrong.iter().all(|w| *w > 1.0), "the test does not notice every wrong one: {wrong:?}");
}

#[test]
fn small_steps_follow_the_rates_themselves() {
    // P(change to i) -> h u_t(i | x_t, x^) with the derivative of beta in closed form: equation 21 without our discretisation.
    let tiny = Tiny::new(Shape { codes: 6, code_width: 3, ..Shape::default() }, 18);
    let (t, h) = (0.4, 1e-4);
    let slope = 3.0 * 0.9 * f64::powf(t / (1.0 - t), 0.9 - 1.0) / f64::powi(1.0 - t, 2);
    let d = |i: usize, x: usize| naive_prior::distance(&tiny.codes, 3, i, x);
    let beta = naive_prior::beta(t, 3.0, 0.9);
    let q = naive_prior::softmax(&(0..6).map(|i| -beta * d(i, 2)).collect::<Vec<_>>());
    let want = naive_prior::transition(&tiny.codes, 3, (5, 2), (t, h), |t| naive_prior::beta(t, 3.0, 0.9));
    for i in (0..6).filter(|&i| i != 5) {
        let rate = h * q[i] * slope * (d(5, 2) - d(i, 2)).max(0.0);
        assert!((want[i] - rate).abs() <= 2e-3 * rate + 1e-12, "{i}: {} and {rate}", want[i]);
    }
}

/// Keeps what the first planner step left.
#[derive(Default)]
struct First {
    tokens: Vec<u16>,
}

impl Observer for First {
    fn tokens(&mut self, step: u16, tokens: &[u16]) {
        if step == 0 {
            self.tokens = tokens.to_vec();
        }
    }

    fn progress(&mut self, progress: motionette::Progress) -> ControlFlow<Stop> {
        // Nothing behind the first step is of interest.
        if progress.evaluation > 1 { ControlFlow::Break(Stop::Abort) } else { ControlFlow::Continue(()) }
    }
}

#[test]
fn the_first_step_of_whole_requests_has_the_marginals_of_the_sampler() {
    const SEEDS: u64 = 12_000;
    let prior = PriorShape::default();
    let shape = Shape { codes: 5, prior: Some(prior), ..Shape::with_prior() };
    let tiny = Tiny::new(shape, 23);
    let width = usize::from(tiny.shape.code_width);
    let base = Request::text("a person waves").length(Length::Tokens(1)).guidance(1.0).steps(2);
    // P(z_1) = 1/V sum over z_0 and proposals of p(proposal | z_0) P(z_0 -> z_1 | proposal).
    let expected = |temperature: f64, c: f64| {
        let mut p = vec![0.0; 5];
        for z in 0..5u16 {
            let limits = PlanningLimits { words: 3, steps: 1, guided: false, anchors: false, clauses: 1 };
            let logits: Vec<f64> = session(&tiny, 1, limits, |session| {
                let _ = session.read(&Prompt::Text("a person waves"), &mut || ControlFlow::Continue(())).unwrap();
                let planning = Planning { guidance: 1.0, ..Planning::DEFAULT };
                assert!(session.pass(&[z], 0.0, &planning, &mut || ControlFlow::Continue(())).is_continue());
                session.logits(0).iter().map(|&v| f64::from(v) / temperature).collect()
            });
            for (proposal, share) in naive_prior::softmax(&logits).into_iter().enumerate() {
                let beta = |t: f64| naive_prior::beta(t, c, 0.9);
                let pair = (usize::from(z), proposal);
                let to = naive_prior::transition(&tiny.codes, width, pair, (0.0, 0.5), beta);
                for (p, to) in p.iter_mut().zip(to) {
                    *p += share * to / 5.0;
                }
            }
        }
        p
    };
    let model = Model::open(tiny.bytes()).unwrap();
    let mut arena = vec![0u8; 1 << 20];
    let mut generator = Generator::new(model, &mut arena).unwrap();
    let mut counts = |sampling: Sampling| {
        let mut counts = [0.0; 5];
        for seed in 0..SEEDS {
            let mut first = First::default();
            let _ = generator.generate(&base.seed(seed).sampling(sampling), &mut first);
            counts[usize::from(first.tokens[0])] += 1.0;
        }
        counts
    };
    for temperature in [1.0f32, 4.0] {
        let sampled = counts(Sampling::Sample { temperature, top_k: 0, top_p: 1.0 });
        let gumbel = counts(Sampling::Gumbel { temperature });
        for counts in [sampled, gumbel] {
            let right = refusal(&counts, &expected(f64::from(temperature), 3.0));
            assert!(right < 1.0, "{temperature}: {right}");
            let wrong = refusal(&counts, &expected(f64::from(temperature), 0.3));
            assert!(wrong > 1.0, "{temperature}: a wrong beta is not noticed ({wrong})");
        }
    }
}
