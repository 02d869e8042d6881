//! Words with vectors, phrases that prompts are understood as, guidance in one pass: against the oracle, on small random models.

use motionette::generation::tokens::{Planning, PlanningLimits, Session};
use motionette::memory::Arena;
use motionette::request::prompt::{Prompt, PromptStats};
use motionette::text::words::{UNKNOWN, Words};
use motionette::{Generator, Guess, Length, Model, ROWS, Request, Understood};
use motionette_link::message;
use motionette_tests::naive_prior::{self, Rows, Scene};
use motionette_tests::tiny::{PriorShape, Shape, THRESHOLD, Tiny};
use std::ops::ControlFlow;

const PROMPT: &str = "a Person's waving, the left hand!";

fn tiny(prior: PriorShape, seed: u64) -> Tiny {
    Tiny::new(Shape { prior: Some(prior), ..Shape::with_prior() }, seed)
}

/// Ids of a prompt's words by their place in the shape's list.
fn ids(tiny: &Tiny, words: &[&str]) -> Vec<u16> {
    let list = &tiny.shape.prior.as_ref().unwrap().words;
    words.iter().map(|word| list.iter().position(|w| w == word).unwrap() as u16).collect()
}

/// What a session heard, and the logits of one pass.
fn pass(tiny: &Tiny, prompt: &str, scene: &Scene, guidance: f32) -> (PromptStats, Rows) {
    let model = Model::open(tiny.bytes()).unwrap();
    let mut memory = vec![0u128; 1 << 14];
    let mut arena = Arena::new(bytemuck::cast_slice_mut(&mut memory));
    let limits = PlanningLimits { words: 7, steps: 1, guided: guidance != 1.0, anchors: false, clauses: 1 };
    let modules = model.planning().unwrap();
    let mut session = Session::new(modules, &mut arena, scene.tokens.len(), &limits, ROWS).unwrap();
    let heard = session.read(&Prompt::Text(prompt), &mut || ControlFlow::Continue(())).unwrap();
    let planning = Planning { guidance, ..Planning::DEFAULT };
    let passed = session.pass(&scene.tokens, scene.time as f32, &planning, &mut || ControlFlow::Continue(()));
    assert!(passed.is_continue());
    let row = |i| session.logits(i).iter().map(|&v| f64::from(v)).collect();
    (heard.continue_value().unwrap(), (0..scene.tokens.len()).map(row).collect())
}

fn error(got: &Rows, want: &Rows) -> f64 {
    let squares = got.iter().flatten().zip(want.iter().flatten()).map(|(a, b)| (a - b).powi(2));
    let power: f64 = want.iter().flatten().map(|v| v * v).sum();
    (squares.sum::<f64>() / power).sqrt()
}

#[test]
fn words_are_found_by_their_hashes_in_every_form() {
    let tiny = tiny(PriorShape::understanding(), 5);
    let model = Model::open(tiny.bytes()).unwrap();
    let known = *model.text().unwrap().encoder().unwrap().vocabulary();
    let found: Vec<u16> = Words::new(PROMPT).map(|word| known.id(&word)).collect();
    let [a, person, waves, left, hand] = ids(&tiny, &["a", "person", "waves", "left", "hand"])[..] else { panic!() };
    // `waving` has no form that is there: `wav`, `wave`, `wavs`.
    assert_eq!(found, [a, person, UNKNOWN, UNKNOWN, left, hand]);
    assert_ne!(waves, UNKNOWN);
    assert_eq!(known.len(), 8);
    let text = |prompt: &str| Words::new(prompt).map(|word| known.id(&word)).collect::<Vec<u16>>();
    assert_eq!(text("runs running RUN lefts"), [ids(&tiny, &["run", "run", "run"]), vec![left]].concat());
    assert_eq!(text("<none> <unknown>"), [UNKNOWN; 2], "what stands for words is no word");
}

#[test]
fn rows_of_vectors_and_one_pass_agree_with_the_oracle() {
    for (seed, one_pass) in [(11, true), (12, false), (13, true)] {
        let tiny = tiny(PriorShape { one_pass, ..PriorShape::understanding() }, seed);
        let scene = Scene { tokens: vec![3, 0, 10, 7, 7], time: 0.3, ..Scene::default() };
        let words = ids(&tiny, &["a", "person", "<unknown>", "<unknown>", "left", "hand"]);
        for guidance in [1.0f32, 2.0, 2.75, 0.5, 4.0, 9.0] {
            let (heard, got) = pass(&tiny, PROMPT, &scene, guidance);
            assert_eq!((heard.words, heard.unknown_words), (6, 2));
            let logits = |words: &[u16], strength: f64| {
                let (memory, pooled) = naive_prior::encode(&tiny, words);
                naive_prior::logits(&tiny, &Scene { strength, ..scene.clone() }, &memory, &pooled)
            };
            let strength = f64::from(guidance);
            let want: Rows = if one_pass {
                logits(&words, strength)
            } else {
                let (with, without) = (logits(&words, 1.0), logits(&[0], 1.0));
                let mix =
                    |(a, b): (&Vec<f64>, &Vec<f64>)| a.iter().zip(b).map(|(a, b)| b + strength * (a - b)).collect();
                with.iter().zip(&without).map(mix).collect()
            };
            let bound = if one_pass { 0.03 } else { 0.03 * (1.0 + strength) };
            assert!(error(&got, &want) < bound, "{guidance}: {}", error(&got, &want));
            // What the test would notice: other words, another strength.
            if one_pass {
                let other = logits(&ids(&tiny, &["a", "run"]), strength);
                let weaker = logits(&words, if guidance >= 4.0 { 3.0 } else { strength + 1.0 });
                let own = error(&got, &want);
                assert!(error(&got, &other) > 3.0 * own && error(&got, &weaker) > 2.0 * own, "{guidance}: {own}");
            }
        }
    }
}

#[test]
fn one_pass_takes_less_memory_and_half_the_work() {
    let needs = |one_pass| {
        let tiny = tiny(PriorShape { one_pass, ..PriorShape::understanding() }, 3);
        let model = Model::open(tiny.bytes()).unwrap();
        let modules = model.planning().unwrap();
        let limits = PlanningLimits { words: 7, steps: 5, guided: true, anchors: false, clauses: 1 };
        (modules.bytes(13, &limits, ROWS).all(), modules.macs(13, &limits))
    };
    let ((one, one_work), (two, two_work)) = (needs(true), needs(false));
    assert!(one < two && one_work < two_work * 6 / 10, "{one} {two} bytes, {one_work} {two_work} products");
}

#[test]
fn a_prompt_is_understood_as_its_likeliest_phrases() {
    let (mut sure, mut unsure, mut styled) = (0, 0, 0);
    for seed in 20..40 {
        let tiny = tiny(PriorShape::understanding(), seed);
        let model = Model::open(tiny.bytes()).unwrap();
        let (prior, words) = (tiny.shape.prior.as_ref().unwrap(), ids(&tiny, &["run", "<unknown>", "hand"]));
        let scene = Scene { tokens: vec![1, 2], ..Scene::default() };
        let heard = pass(&tiny, "run these hands", &scene, 2.0).0.understood.unwrap();
        let (_, pooled) = naive_prior::encode(&tiny, &words);
        let want = naive_prior::meanings(&tiny, &pooled);
        let mut order: Vec<usize> = (0..usize::from(prior.actions)).collect();
        order.sort_by(|a, b| want[*b].total_cmp(&want[*a]));
        for (guess, place) in heard.actions.iter().zip(order) {
            assert!((f64::from(guess.score) - want[usize::from(guess.phrase)]).abs() < 0.02, "{heard:?} {want:?}");
            assert!(f64::from(guess.score) > want[place] - 0.04, "{heard:?} {want:?}");
        }
        let best = want[..4].iter().copied().fold(0.0, f64::max);
        let threshold = f64::from(THRESHOLD);
        if (best - threshold).abs() > 0.02 {
            assert_eq!(heard.sure, best > threshold, "{want:?}");
        }
        let style = want[4..].iter().copied().fold(0.0, f64::max);
        if (style - 0.5).abs() > 0.02 {
            assert_eq!(heard.style.is_some(), style > 0.5, "{want:?}");
        }
        if let Some(style) = heard.style {
            assert!(["angrily", "sadly"].contains(&model.phrase(style.phrase).unwrap()));
        }
        assert_eq!(model.phrase(heard.action().phrase), prior.phrases.get(usize::from(heard.action().phrase)).copied());
        assert_eq!((model.phrase(6), model.phrase(u16::MAX)), (None, None));
        sure += usize::from(heard.sure);
        unsure += usize::from(!heard.sure);
        styled += usize::from(heard.style.is_some());
    }
    assert!(
        sure > 2 && unsure > 2 && styled > 2 && styled < 20,
        "{sure} {unsure} {styled}: the models say all there is to say"
    );
}

/// A model of two actions names two.
#[test]
fn actions_that_are_not_there_are_not_named() {
    let tiny = tiny(PriorShape { actions: 2, ..PriorShape::understanding() }, 22);
    let scene = Scene { tokens: vec![1, 2], ..Scene::default() };
    let [first, second, third] = pass(&tiny, "run", &scene, 2.0).0.understood.unwrap().actions;
    assert!(first.score >= second.score && second.score > 0.0 && first.phrase + second.phrase == 1);
    assert_eq!(third, Guess::NONE);
}

/// Through the generator, for text and stored prompts; nothing where there is no prompt, or nobody taught the model.
#[test]
fn motions_say_what_was_understood() {
    let understood = |prior: PriorShape, request: &Request<'_>| {
        let tiny = tiny(prior, 21);
        let mut memory = vec![0u128; (1 << 20) / 16];
        let model = Model::open(tiny.bytes()).unwrap();
        let mut generator = Generator::new(model, bytemuck::cast_slice_mut(&mut memory)).unwrap();
        generator.generate(request, &mut ()).unwrap().understood()
    };
    let text = Request::text("a person runs").length(Length::Tokens(4)).steps(2);
    assert!(understood(PriorShape::understanding(), &text).is_some());
    assert!(understood(PriorShape::understanding(), &Request::bank("wave").steps(2)).is_some());
    assert!(understood(PriorShape::understanding(), &Request::tokens(&[1, 2, 3])).is_none());
    assert!(understood(PriorShape::default(), &text).is_none());
}

/// What a device's reply and a sentence for people say, by hand from the numbers of the phrases.
#[test]
fn what_was_understood_in_words() {
    let tiny = tiny(PriorShape::understanding(), 21);
    let model = Model::open(tiny.bytes()).unwrap();
    let guess = |phrase, score| Guess { phrase, score };
    let actions = [guess(2, 0.861), guess(0, 0.5), guess(3, 0.004)];
    let plain = Understood { actions, style: None, sure: true };
    let styled = Understood { style: Some(guess(4, 0.7)), ..plain };
    let unsure = Understood { sure: false, ..styled };
    let words = |understood| model.in_words(understood).to_string();
    assert_eq!(words(plain), "a person stands (0.86)");
    assert_eq!(words(styled), "a person stands, angrily (0.86)");
    let nearest = "hardly anything; nearest: a person stands (0.86), a person waves (0.50), a person hops (0.00)";
    assert_eq!(words(unsure), nearest);
    assert_eq!(words(Understood { actions: [guess(1, 1.0); 3], ..plain }), "a person runs (1.00)");
    let few = Understood { actions: [guess(0, 0.5), Guess::NONE, Guess::NONE], ..unsure };
    assert_eq!(words(few), "hardly anything; nearest: a person waves (0.50)");
    let reply = |understood| message::Understood::of(&model, Some(understood), "a run").unwrap();
    assert_eq!((reply(plain).phrase.as_str(), reply(plain).score), ("a person stands", 0.861));
    assert_eq!(reply(styled).phrase.as_str(), "a person stands, angrily");
    assert!(message::Understood::of(&model, Some(Understood { actions: [guess(60, 0.9); 3], ..plain }), "").is_none());
    // A model that was not taught says which words it knows.
    let both =
        message::Understood::of(&model, [plain, Understood { actions: [guess(1, 0.25); 3], ..plain }], "").unwrap();
    assert_eq!((both.phrase.as_str(), both.score), ("a person stands, then a person runs", 0.25));
    let long = message::Understood::of(&model, [styled, styled, styled], "").unwrap();
    assert_eq!(long.phrase.as_str(), "a person stands, angrily, then a person stands, angrily, then a ");
    let words = message::Understood::of(&model, None, "a xyzzy run").unwrap();
    assert_eq!((words.phrase.as_str(), words.score), ("a run", 2.0 / 3.0));
}
