//! What a device says of a prompt, with the words that the shipped model knows.

use motionette::Model;
use motionette_link::message::{PHRASE_BYTES, Understood};

#[repr(C, align(16))]
struct Aligned<T: ?Sized>(T);

static SHIPPED: &Aligned<[u8]> = &Aligned(*include_bytes!("../../models/nano.blob"));

fn understood(text: &str) -> Option<(String, f32)> {
    let model = Model::open(&SHIPPED.0).expect("the shipped model");
    Understood::of(&model, None, text).map(|it| (it.phrase.to_string(), it.score))
}

#[test]
fn words_that_are_known_and_their_share() {
    let of = |phrase: &str, score| Some((phrase.to_owned(), score));
    assert_eq!(understood("A person waves."), of("a person waves", 1.0));
    assert_eq!(understood("a xyzzy person, QWERTZ!"), of("a person", 0.5));
    assert_eq!(understood("xyzzy"), of("", 0.0));
    assert_eq!(understood(" ?! "), None);
    assert_eq!(understood(""), None);
}

/// A phrase is cut between words, and all words count whether they are named or not.
#[test]
fn long_prompts_are_cut_between_words() {
    for words in 1..60 {
        let text = "person walks ".repeat(words) + "xyzzy";
        let (phrase, score) = understood(&text).expect("words");
        assert!(phrase.len() <= PHRASE_BYTES && text.starts_with(&phrase), "{phrase}");
        assert!(text[phrase.len()..].starts_with(' '), "{phrase}");
        // One more would not have fitted.
        assert!(phrase.len() + " person".len() > PHRASE_BYTES || phrase.split(' ').count() == 2 * words, "{phrase}");
        let expected = (2 * words) as f32 / (2 * words + 1) as f32;
        assert!((score - expected).abs() < 1e-6, "{score} instead of {expected}");
    }
}
