//! Damaged and hostile priors: every one gives a typed error that names what, where, expected and found.

mod common;

use std::collections::HashMap;

use common::checkpoints::{
    bytes, names_every_damaged_tensor, names_other_metadata, prior, prior_config, prior_metadata, tokenizer_checkpoint,
};
use motionette_host::checkpoint::{ErrorKind, TensorMap, prior as checkpoint};

fn read(map: &TensorMap, metadata: HashMap<String, String>) -> Result<checkpoint::PriorCheckpoint, ErrorKind> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("x.prior.safetensors");
    std::fs::write(&path, bytes(map, metadata)).expect("written");
    checkpoint::load(&path).map_err(|error| {
        assert!(error.to_string().contains("x.prior.safetensors"), "{error}");
        error.kind
    })
}

fn refused(map: &TensorMap, metadata: HashMap<String, String>) -> ErrorKind {
    read(map, metadata).expect_err("a bad prior was read")
}

fn good() -> HashMap<String, String> {
    prior_metadata(&prior_config("pre", "gelu"))
}

#[test]
fn the_whole_one_is_read_back_as_it_was() {
    let map = prior(3);
    let prior = read(&map, good()).expect("a good prior");
    assert_eq!((prior.text.layers.len(), prior.planner.layers.len()), (1, 2));
    assert_eq!(prior.planner.layers[1].cross.as_ref().map(|c| c.key_value.inputs), Some(8));
    let name = "planner.layers.1.cross.kv.weight";
    assert_eq!(
        prior.planner.layers[1].cross.as_ref().expect("cross").key_value.weight,
        map.find(name).expect(name).data
    );
    assert!(prior.text.layers[0].cross.is_none());
    prior.check_tokenizer(&tokenizer_checkpoint()).expect("its own tokenizer");
    // Every tensor is in one of the parts, once.
    let count: usize = [prior.text_parts(), prior.planner_parts()]
        .concat()
        .into_iter()
        .map(|part| if matches!(part, checkpoint::Part::Embedding(_)) { 1 } else { 2 })
        .sum();
    assert_eq!(count, map.len());
    let mut same = prior.clone();
    assert_eq!(same.parts_mut().len(), prior.text_parts().len() + prior.planner_parts().len());
}

#[test]
fn every_missing_misshapen_or_infinite_tensor_is_named() {
    names_every_damaged_tensor(&prior(3), |map| refused(map, good()));
}

#[test]
fn other_formats_versions_and_configurations() {
    let map = prior(3);
    names_other_metadata(&good(), "motionette-tokenizer", |metadata| refused(&map, metadata));

    let config = prior_config("pre", "gelu");
    for (from, to, words) in [
        ("\"pre\"", "\"batch\"", "`batch`, expected `pre` or `post`"),
        ("\"gelu\"", "\"swish\"", "`swish`, expected `gelu` or `relu`"),
        ("\"heads\": 3", "\"heads\": 5", "a divisor of the width 12"),
        ("\"heads\": 3", "\"heads\": 0", "planner.heads"),
        ("\"width\": 8", "\"width\": 99999999", "text.width"),
        ("\"layers\": 2", "\"layers\": 4000000000", "planner.layers"),
        ("\"max_tokens\": 49", "\"max_tokens\": 0", "max_tokens"),
        ("\"codes\": 6", "\"codes\": -6", "config"),
        ("1e-5", "0", "epsilon"),
        ("\"c\": 3.0", "\"c\": -1", "option `c`"),
        ("\"a\": 0.9", "\"a\": 1e300", "option `a`"),
        ("\"<none>\", ", "", "<none>"),
        ("\"walks\"", "\"waves\"", "vocabulary"),
        ("\"walks\"", "\"\"", "vocabulary"),
        ("\"walks\"", "\"two\\nlines\"", "vocabulary"),
        ("\"tokenizer\"", "\"other\"", "tokenizer"),
    ] {
        assert!(config.contains(from), "{from}");
        let kind = refused(&map, prior_metadata(&config.replacen(from, to, 1)));
        assert!(matches!(kind, ErrorKind::Option { .. }), "{to}: {kind}");
        assert!(kind.to_string().contains(words), "{words:?} not in: {kind}");
    }
    // A word more than the table has rows.
    let kind = refused(&map, prior_metadata(&config.replacen("\"walks\"", "\"walks\", \"more\"", 1)));
    assert!(matches!(&kind, ErrorKind::Shape { tensor, .. } if tensor == "text.embedding.weight"), "{kind}");
}

#[test]
fn another_tokenizer_is_refused() {
    let prior = read(&prior(3), good()).expect("a good prior");
    let mut other = tokenizer_checkpoint();
    other.codebooks[0][4] += 1e-6;
    let kind = prior.check_tokenizer(&other).expect_err("another codebook");
    assert!(matches!(&kind, ErrorKind::OtherTokenizer { expected, actual } if expected != actual), "{kind}");
    for (codes, code_dim, quantizers) in [(7, 3, 1), (6, 4, 1), (6, 3, 2)] {
        let mut other = tokenizer_checkpoint();
        (other.config.codes, other.config.code_dim, other.config.quantizers) = (codes, code_dim, quantizers);
        let kind = prior.check_tokenizer(&other).expect_err("other sizes");
        assert!(matches!(kind, ErrorKind::Option { .. }), "{kind}");
    }
}
