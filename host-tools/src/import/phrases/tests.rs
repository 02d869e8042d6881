use std::path::PathBuf;

use super::*;
use crate::import::actions::Actions;

fn file(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs").join(name)
}

fn shipped() -> Phrases {
    Phrases::read(file("phrases.toml")).unwrap()
}

fn exchanged(sentence: &str) -> String {
    let parts = sentence.split_inclusive(|c: char| !c.is_ascii_lowercase());
    let pairs = [("left", "right"), ("counterclockwise", "clockwise")];
    let one = |part: &str| {
        let (word, end) = part.split_at(part.trim_end_matches(|c: char| !c.is_ascii_lowercase()).len());
        let other = pairs.iter().find_map(|(a, b)| {
            let stem = |from: &str, to: &str| {
                word.strip_prefix(from)
                    .filter(|rest| ["", "ward", "wards"].contains(rest))
                    .map(|rest| format!("{to}{rest}"))
            };
            stem(a, b).or_else(|| stem(b, a))
        });
        other.unwrap_or_else(|| word.to_owned()) + end
    };
    parts.map(one).collect()
}

#[test]
fn every_action_and_style_has_twenty_templates() {
    let phrases = shipped();
    let actions = Actions::read(file("actions.toml")).unwrap();
    assert_eq!(actions.actions.len(), 100);
    for action in &actions.actions {
        assert!(phrases.templates(&action.name) >= 20, "{}", action.name);
    }
    assert_eq!(phrases.styles.len(), 19);
    for style in &phrases.styles {
        assert!(style.templates().count() >= 20, "{}", style.name);
        assert!(style.accept.iter().all(|other| phrases.styles.iter().any(|style| style.name == *other)));
    }
}

/// Every word of a sentence about an action alone is among its words, but for what fills slots.
#[test]
fn words_of_an_action_are_those_of_its_sentences() {
    let shipped = shipped();
    let you = shipped.who[shipped.you].clone();
    let frames = [vec!["{do}".into()], vec!["{thing}".into()]];
    let phrases = Phrases { who: vec![you], you: 0, frames, ..shipped.clone() };
    let slots: BTreeSet<&str> =
        "left right clockwise counterclockwise you your yourself are were the".split(' ').collect();
    for action in ["run", "raise-up-left-hand", "stand"] {
        let known = phrases.words(action);
        for number in 0..200 {
            let sentence = phrases.sentence(action, Side::Left, None, &mut Stream::new(number)).unwrap();
            for word in sentence.split([' ', ',']).filter(|word| !word.is_empty() && !slots.contains(word)) {
                assert!(known.contains(word), "{word:?} of {sentence:?}");
            }
        }
    }
    let run = shipped.words("run");
    assert!(["run", "runs", "running", "ran"].iter().all(|form| run.contains(*form)) && !run.contains("themself"));
    assert!(phrases.words("amble").is_empty());
}

/// What a phrase bank stores: every action and side that somebody can ask for has a sentence that is short enough, and says the side where the
/// action's name does.
#[test]
fn every_action_has_a_plain_sentence_of_its_side() {
    let phrases = shipped();
    for action in &phrases.actions {
        for side in [Side::Left, Side::Right, Side::None] {
            let named = action.name.contains("{side}");
            let says = |template: &String| template.contains("{side}") || template.contains("{clock}");
            if (side == Side::None && named) || (side != Side::None && !action.kinds[0].iter().any(says)) {
                continue;
            }
            let plain = phrases.plain(&action.name, side);
            let plain = plain.unwrap_or_else(|| panic!("no plain sentence for {} {side}", action.name));
            let clock = if side == Side::Left { "counterclockwise" } else { "clockwise" };
            let words: Vec<&str> = plain.split(' ').collect();
            assert!(plain.len() <= 64, "{plain:?}");
            assert!(!named || words.contains(&side.to_string().as_str()) || words.contains(&clock), "{plain:?}");
        }
    }
}

#[test]
fn the_other_side_is_the_same_sentence_exchanged() {
    let phrases = shipped();
    let actions = Actions::read(file("actions.toml")).unwrap();
    let mut sided = 0;
    for action in &actions.actions {
        let mirrored = exchanged(&action.name);
        for seed in 0..200 {
            let say = |name: &str, side| phrases.sentence(name, side, Some("happy"), &mut Stream::new(seed)).unwrap();
            let (left, right) = (say(&action.name, Side::Left), say(&mirrored, Side::Right));
            assert_eq!(exchanged(&left), right);
            assert_eq!(exchanged(&right), left);
            sided += usize::from(left != right);
            let neither = phrases.sentence(&action.name, Side::None, None, &mut Stream::new(seed)).unwrap();
            assert!(!neither.contains(['{', '}', '(', ')', '*', '|']) && !neither.is_empty(), "{neither}");
            assert!(action.name != mirrored || exchanged(&neither) == neither, "{neither}");
        }
    }
    assert!(sided > 2_000);
}

#[test]
fn verbs_and_pronouns_agree() {
    let text = r#"
frames = { do = "{who} {does} {end}", thing = "{thing}" }
order = { two = "{who} {does1} before {doing2}" }
typos = { walks = "wlaks" }
verbs = { lie = "lies lying lay", be = "is being was" }
[[who]]
weight = 1
names = "WHO"
they = "he"
their = "his"
themself = "himself"
are = "is"
were = "was"
PLURAL
[[who]]
weight = 1
names = "you"
they = "you"
their = "your"
themself = "yourself"
are = "are"
were = "were"
plural = true
[[style]]
name = "proud"
adverb = "proudly"
adjective = ""
manner = "as if {they} ruled"
lead = ""
person = ""
[[action]]
name = "lift"
do = "*carry it, *hop, *lie, *be calm and *watch {themself}"
thing = "a lift"
say = ""
"#;
    let say = |who: &str, plural: &str, form| {
        let text = text.replace("WHO", who).replace("PLURAL", plural);
        let phrases = Phrases::parse(Path::new("p"), &text).unwrap();
        let mut stream = Stream::new(0);
        let mut sentence = Sentence::new(&phrases, "{who}", Side::None, &mut stream);
        sentence.group = &phrases.who[0];
        sentence.fill(&phrases.actions[0].kinds[DO][0], form, &mut stream)
    };
    assert_eq!(say("he", "", Form::Agree), "carries it, hops, lies, is calm and watches himself");
    assert_eq!(say("he", "", Form::Ing), "carrying it, hopping, lying, being calm and watching himself");
    assert_eq!(say("they", "plural = true", Form::Agree), "carry it, hop, lie, is calm and watch himself");
    assert_eq!(say("he", "", Form::Past), "carried it, hopped, lay, was calm and watched himself");
}

#[test]
fn regular_verbs() {
    let phrases = shipped();
    let he = phrases.who.iter().find(|group| group.names == ["he"]).unwrap();
    let they = phrases.who.iter().find(|group| group.names == ["they"]).unwrap();
    for (verb, third, ing, past) in [
        ("walk", "walks", "walking", "walked"),
        ("hop", "hops", "hopping", "hopped"),
        ("bow", "bows", "bowing", "bowed"),
        ("box", "boxes", "boxing", "boxed"),
        ("gallop", "gallops", "galloping", "galloped"),
        ("look", "looks", "looking", "looked"),
        ("hurry", "hurries", "hurrying", "hurried"),
        ("sway", "sways", "swaying", "swayed"),
        ("wave", "waves", "waving", "waved"),
        ("tiptoe", "tiptoes", "tiptoeing", "tiptoed"),
        ("die", "dies", "dying", "died"),
        ("sit", "sits", "sitting", "sat"),
        ("be", "is", "being", "was"),
    ] {
        let forms = [Form::Agree, Form::Ing, Form::Past].map(|form| phrases.inflect(verb, form, he));
        assert_eq!(forms, [third, ing, past]);
        assert_eq!(phrases.inflect(verb, Form::Base, he), verb);
        assert_eq!(phrases.inflect(verb, Form::Agree, they), if verb == "be" { "are" } else { verb });
    }
}

#[test]
fn two_actions_keep_their_order_and_sides() {
    let phrases = shipped();
    let (mut stream, mut misspelt) = (Stream::new(1), 0);
    for _ in 0..500 {
        let said = phrases.sequence(("turn-left", Side::None), ("kick", Side::Right), &mut stream).unwrap();
        assert!(!said.contains(['{', '*', '|']), "{said}");
        misspelt += usize::from(phrases.misspelt(&said, &mut stream) != said);
    }
    assert!(misspelt > 50);
    assert_eq!(phrases.sequence(("turn-left", Side::None), ("hover", Side::None), &mut stream), None);
    assert_eq!(phrases.sentence("walk", Side::None, Some("wooden"), &mut stream), None);
}

#[test]
fn what_is_wrong_is_named() {
    let text = std::fs::read_to_string(file("phrases.toml")).unwrap();
    let cases = [
        ("*sway {their} arms", "*sway {there} arms", "no slot {there}"),
        ("*walk the dog", "walk the dog", "no verb"),
        ("*walk the dog", "*walk (the dog", "brackets"),
        ("*walk the dog", "*walk left", "mirrored"),
        ("{do1}, then {do2}", "{do1}, then", "ending in 2"),
        ("arise = \"arises arising arose\"", "arise = \"arises\"", "three forms"),
        ("names = \"you\"", "names = \"thou\"", "the name `you`"),
    ];
    for (old, new, said) in cases {
        let wrong = text.replacen(old, new, 1);
        let error = Phrases::parse(Path::new("phrases.toml"), &wrong).unwrap_err();
        assert!(error.to_string().contains(said), "{error}");
        assert!(matches!(error, Error::Entry { line, .. } if line > 0), "{error}");
    }
    assert!(matches!(Phrases::parse(Path::new("p"), "who = 1"), Err(Error::Syntax { .. })));
    assert!(matches!(Phrases::read("no/such/file"), Err(Error::Read { .. })));
}
