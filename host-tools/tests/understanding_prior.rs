//! Priors whose words have vectors, that know meanings and are guided in one pass: read, refused, converted, inspected, verified, asked.

mod common;

use std::collections::HashMap;

use common::bench::{Bench, list};
use common::checkpoints::{
    DIMS, bytes, names_every_damaged_tensor, prior_metadata, tokenizer_checkpoint, understanding, understanding_config,
};
use motionette_host::blob::BlobFile;
use motionette_host::checkpoint::prior::{self, WordRows};
use motionette_host::checkpoint::words::hash;
use motionette_host::checkpoint::{ErrorKind, PriorCheckpoint, TensorMap};
use motionette_host::reference::Prior;
use motionette_host::verify;

fn read(map: &TensorMap, metadata: HashMap<String, String>) -> Result<PriorCheckpoint, ErrorKind> {
    prior::from_bytes(&bytes(map, metadata), "x").map_err(|error| error.kind)
}

fn good() -> HashMap<String, String> {
    prior_metadata(&understanding_config())
}

fn bench() -> Bench {
    let bench = Bench::new();
    bench.write("u.prior.safetensors", &bytes(&understanding(3), good()));
    bench
}

/// Rows of the reference by hand: `projection (number * scale) + bias`, and rows of their own for the two words without a vector.
#[test]
fn a_vector_becomes_a_row() {
    let checkpoint = read(&understanding(3), good()).expect("a good prior");
    let WordRows::Vectors(vectors) = &checkpoint.text.table else { panic!("words have vectors") };
    let reference = Prior::<f64>::with_codebook(&checkpoint, &tokenizer_checkpoint().codebooks[0]);
    // Two texts of a word each differ by the words' rows alone: what is encoded of the first is that of the row.
    let word = checkpoint.config.vocabulary.iter().position(|word| word == "waves").expect("a word");
    let row: Vec<f64> = (0..8)
        .map(|n| {
            let weights = &vectors.projection.weight[n * DIMS..][..DIMS];
            let numbers = &vectors.numbers[(word - 2) * DIMS..][..DIMS];
            let sum: f64 = weights.iter().zip(numbers).map(|(w, v)| f64::from(*w) * f64::from(*v)).sum();
            sum * f64::from(vectors.scales[word - 2]) + f64::from(vectors.projection.bias[n])
        })
        .collect();
    let mut plain = checkpoint.clone();
    let mut special = vectors.clone();
    special.special.weight[8..].iter_mut().zip(&row).for_each(|(to, from)| *to = *from as f32);
    plain.text.table = WordRows::Vectors(special);
    let other = Prior::<f64>::with_codebook(&plain, &tokenizer_checkpoint().codebooks[0]);
    let (a, b) = (reference.text.encode(&[word as u16]), other.text.encode(&[1]));
    assert!(a.memory.iter().zip(&b.memory).all(|(a, b)| (a - b).abs() < 1e-5), "{:?} {:?}", a.memory, b.memory);
    assert!(reference.text.encode(&[1]).memory != a.memory);
    let p = reference.text.meanings(&a.pooled);
    assert!(p.len() == 3 && p.iter().all(|p| *p > 0.0 && *p < 1.0));
}

#[test]
fn damaged_ones_are_refused_by_what_is_wrong() {
    names_every_damaged_tensor(&understanding(3), |map| read(map, good()).expect_err("a bad prior was read"));
    let broken = |name: &str, value: f32| {
        let mut map = understanding(3);
        let mut tensor = map.find(name).expect(name).clone();
        tensor.data[1] = value;
        map.insert(name, tensor);
        read(&map, good()).expect_err(name).to_string()
    };
    assert!(broken("text.vectors.weight", 1.5).contains("whole"));
    assert!(broken("text.vectors.weight", 8.0).contains("-7 to 7"));
    assert!(broken("text.scales.weight", -0.25).contains("positive"));
    assert!(broken("text.scales.weight", 0.1).contains("half precision"));
    let config = understanding_config();
    let (first, last) =
        ("\"style\": false, \"phrase\": \"a person walks\"", "\"style\": true, \"phrase\": \"tiredly\"");
    for (from, to, words) in [
        ("\"word_vectors\": 16", "\"word_vectors\": 12", "a multiple of 16"),
        ("[0, 0, 0, 0, 0, 1, 2]", "[0, 0, 0]", "word_tiers"),
        ("\"threshold\": 0.6", "\"threshold\": 1.0", "threshold"),
        (first, &first.replace("false", "true"), "before styles"),
        (last, &last.replace("tiredly", ""), "phrases of 1 to 64 bytes"),
        (last, &last.replace("tiredly", &"x".repeat(65)), "phrases of 1 to 64 bytes"),
        ("\"waves\", \"carry\"", "\"carry\", \"waves\"", "in the order of their hashes"),
    ] {
        assert!(config.contains(from), "{from}");
        let kind = read(&understanding(3), prior_metadata(&config.replacen(from, to, 1))).expect_err(to);
        assert!(kind.to_string().contains(words), "{words:?} not in: {kind}");
    }
}

#[test]
fn a_blob_keeps_words_meanings_and_one_pass() {
    let bench = bench();
    bench.succeeds("convert t.safetensors --prior u.prior.safetensors -o u.blob");
    let seen = bench.succeeds("inspect u.blob --vocabulary")["prior"].clone();
    assert_eq!(
        (seen["words"].as_u64(), seen["table"].as_str(), seen["guidance"].as_str()),
        (Some(7), Some("vectors"), Some("one pass"))
    );
    assert_eq!(list(&seen["phrases"]), ["a person walks", "a person waves", "tiredly"]);
    assert_eq!(list(&seen["vocabulary"]), Vec::<String>::new(), "a blob has hashes of its words alone");
    let checkpoint = prior::load(&bench.path("u.prior.safetensors")).expect("a prior");
    let blob = BlobFile::open(&bench.path("u.blob")).expect("a blob");
    let hashes: Vec<u32> = checkpoint.config.vocabulary[2..].iter().map(|word| hash(word)).collect();
    assert_eq!(blob.word_hashes().expect("checked"), hashes);
    assert_eq!(blob.bytes()[4..8], [4, 0, 1, 0], "format 4.1");
    verify::check_same_prior(&blob, &checkpoint).expect("its own");

    // Rare words can stay out; the prior without them is what the blob is held against.
    let made = bench.succeeds("convert t.safetensors --prior u.prior.safetensors --word-tier 0 -o few.blob");
    assert_eq!(made["words"].as_u64(), Some(7), "five with a vector, two without");
    let few = BlobFile::open(&bench.path("few.blob")).expect("a blob");
    assert_eq!(few.word_hashes().expect("checked"), hashes[..5]);
    let kept = verify::same_words(&few, checkpoint.clone()).expect("words of its own");
    assert_eq!(kept.config.vocabulary, checkpoint.config.vocabulary[..7]);
    assert_eq!(kept.weights_hash(), checkpoint.weights_hash(), "a control goes with any words");
}

/// What the runtime proposes and understands of the checkpoint, through every command.
#[test]
fn commands_say_what_was_understood() {
    let bench = bench();
    bench.succeeds("convert t.safetensors --prior u.prior.safetensors -o u.blob");
    let made = bench.makes(&[
        "generate",
        "--blob",
        "u.blob",
        "--text",
        "A tired person waves!",
        "--seconds",
        "2",
        "-o",
        "w.bvh",
    ]);
    let understood = made["understood"].as_str().expect("what was understood").to_owned();
    let checkpoint = prior::load(&bench.path("u.prior.safetensors")).expect("a prior");
    let reference = Prior::<f32>::with_codebook(&checkpoint, &tokenizer_checkpoint().codebooks[0]);
    let words = reference.text.read("A tired person waves!").expect("words").ids;
    let p = reference.text.meanings(&reference.text.encode(&words).pooled);
    let best = if p[0] > p[1] { 0 } else { 1 };
    let phrase = &checkpoint.config.meanings[best].phrase;
    if p[best] > 0.62 {
        assert!(understood.starts_with(phrase), "{understood} {p:?}");
    } else if p[best] < 0.58 {
        assert!(understood.starts_with(&format!("hardly anything; nearest: {phrase}")), "{understood} {p:?}");
    }
    bench.fails(
        &["generate", "--blob", "u.blob", "--text", "xyzzy plugh", "-o", "w.bvh"],
        &["none of the prompt's 2 words"],
    );
    bench.fails(&["generate", "--blob", "u.blob", "--text", " \t ", "-o", "w.bvh"], &["no words"]);
}
