//! Damaged and hostile controls, and controls of something else: every one gives a typed error that names what, where, expected and
//! found.

mod common;

use std::collections::HashMap;

use common::checkpoints::{
    bytes, control, control_config, control_metadata, names_every_damaged_tensor, names_other_metadata,
    prior_checkpoint, tokenizer_checkpoint,
};
use motionette_host::checkpoint::prior::{Part, weights_hash};
use motionette_host::checkpoint::{ControlCheckpoint, ErrorKind, TensorMap, control as checkpoint};
use motionette_host::reference::anchors::Family;
use sha2::{Digest, Sha256};

const ALL: &str = r#"["root3d", "planar", "body"]"#;

fn read(map: &TensorMap, metadata: HashMap<String, String>) -> Result<ControlCheckpoint, ErrorKind> {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("x.control.safetensors");
    std::fs::write(&path, bytes(map, metadata)).expect("written");
    checkpoint::load(&path).map_err(|error| {
        assert!(error.to_string().contains("x.control.safetensors"), "{error}");
        error.kind
    })
}

fn refused(map: &TensorMap, metadata: HashMap<String, String>) -> ErrorKind {
    read(map, metadata).expect_err("a bad control was read")
}

fn good() -> HashMap<String, String> {
    control_metadata(&control_config(3, "pre", "gelu", true, ALL))
}

#[test]
fn the_whole_one_is_read_back_as_it_was() {
    let map = control(4, true);
    let mut read_back = read(&map, good()).expect("a good control");
    assert_eq!((read_back.layers.len(), read_back.anchors.len(), read_back.merge.inputs), (2, 2, 20));
    assert_eq!(read_back.config.families, [Family::Root3d, Family::PlanarRoot, Family::BodyPoint]);
    assert_eq!(read_back.statistics.std, map.find("control.std").expect("std").data);
    let name = "control.anchor.1.kv.weight";
    assert_eq!(read_back.anchors[1].key_value.weight, map.find(name).expect(name).data);
    // Every tensor but the statistics is in one of the parts, once.
    let tensors = |parts: &[Part<'_>]| -> usize {
        parts.iter().map(|part| if matches!(part, Part::Embedding(_)) { 1 } else { 2 }).sum()
    };
    assert_eq!(tensors(&read_back.parts()) + 2, map.len());
    assert_eq!(read_back.parts().len(), read_back.parts_mut().len());

    // Without dual context its tensors are not asked for.
    let map = control(4, false);
    let metadata = control_metadata(&control_config(3, "pre", "gelu", false, r#"["body"]"#));
    let read_back = read(&map, metadata).expect("a good control");
    assert!(read_back.context.is_none());
    assert_eq!(tensors(&read_back.parts()) + 2, map.len());
}

#[test]
fn every_missing_misshapen_or_infinite_tensor_is_named() {
    names_every_damaged_tensor(&control(4, true), |map| refused(map, good()));
}

#[test]
fn deviations_are_positive() {
    for value in [0.0, -0.5, 1e-42] {
        let mut map = control(4, true);
        let mut std = map.find("control.std").expect("std").clone();
        std.data[7] = value;
        map.insert("control.std", std);
        let kind = refused(&map, good());
        assert!(matches!(&kind, ErrorKind::Std { index: 7, value: v, .. } if *v == value), "{kind}");
        assert!(kind.to_string().contains("`control.std`"), "{kind}");
    }
}

#[test]
fn other_formats_versions_and_configurations() {
    let map = control(4, true);
    names_other_metadata(&good(), "motionette-prior", |metadata| refused(&map, metadata));

    let config = control_config(3, "pre", "gelu", true, ALL);
    for (from, to, words) in [
        ("\"pre\"", "\"batch\"", "`batch`, expected `pre` or `post`"),
        ("\"heads\": 2", "\"heads\": 5", "a divisor of the width 8"),
        ("\"heads\": 2", "\"heads\": 0", "scaffold.heads"),
        ("\"frame_width\": 5", "\"frame_width\": 0", "frame_width"),
        ("\"rank\": 3", "\"rank\": 99999999", "rank"),
        ("\"planner_width\": 12", "\"planner_width\": -12", "config"),
        ("\"planner_layers\": 2", "\"planner_layers\": 4000000000", "planner_layers"),
        ("\"max_tokens\": 49", "\"max_tokens\": 0", "max_tokens"),
        ("1e-5", "0", "epsilon"),
        (ALL, "[]", "families"),
        (ALL, r#"["body", "root3d", "body"]"#, "each once"),
        (ALL, r#"["channel"]"#, "channel"),
        ("\"context\": true", "\"context\": 2", "config"),
        ("\"prior\"", "\"other\"", "prior"),
    ] {
        assert!(config.contains(from), "{from}");
        let kind = refused(&map, control_metadata(&config.replacen(from, to, 1)));
        assert!(matches!(kind, ErrorKind::Option { .. }), "{to}: {kind}");
        assert!(kind.to_string().contains(words), "{words:?} not in: {kind}");
    }
}

#[test]
fn another_prior_or_tokenizer_is_refused() {
    let control = read(&control(4, true), good()).expect("a good control");
    let (prior, tokenizer) = (prior_checkpoint(3, "pre", "gelu"), tokenizer_checkpoint());
    control.check_prior(&prior, &tokenizer).expect("its own prior");

    let kind = control.check_prior(&prior_checkpoint(5, "pre", "gelu"), &tokenizer).expect_err("other weights");
    assert!(matches!(&kind, ErrorKind::OtherPrior { expected, actual } if expected != actual), "{kind}");
    let mut other = prior.clone();
    other.planner.norm.bias[3] += 1e-6;
    let kind = control.check_prior(&other, &tokenizer).expect_err("other weights");
    let ErrorKind::OtherPrior { expected, actual } = &kind else { panic!("{kind}") };
    assert!(kind.to_string().contains(expected) && kind.to_string().contains(actual), "{kind}");

    let mut other = prior.clone();
    other.config.tokenizer = "0".repeat(64);
    let kind = control.check_prior(&other, &tokenizer).expect_err("other tokens");
    assert!(matches!(&kind, ErrorKind::OtherTokenizer { actual, .. } if *actual == "0".repeat(64)), "{kind}");

    for (change, key) in [
        ((|c| c.planner.width = 24) as fn(&mut motionette_host::checkpoint::PriorConfig), "planner_width"),
        (|c| c.planner.layers = 3, "planner_layers"),
        (|c| c.max_tokens = 50, "max_tokens"),
    ] {
        let mut other = prior.clone();
        change(&mut other.config);
        let kind = control.check_prior(&other, &tokenizer).expect_err("other sizes");
        assert!(matches!(&kind, ErrorKind::Option { key: k, .. } if k == key), "{kind}");
    }
    let mut other = tokenizer_checkpoint();
    other.config.down_t = 3;
    let kind = control.check_prior(&prior, &other).expect_err("other sizes");
    assert!(matches!(&kind, ErrorKind::Option { key, .. } if key == "frames a token"), "{kind}");
}

#[test]
fn a_prior_is_named_by_all_of_its_weights() {
    let map = common::checkpoints::prior(3);
    let expected = prior_checkpoint(3, "pre", "gelu").weights_hash();
    let tensors = || map.iter().map(|(name, tensor)| (name, tensor.data.as_slice()));
    assert_eq!(weights_hash(tensors()), expected);
    assert_eq!(weights_hash(tensors().collect::<Vec<_>>().into_iter().rev()), expected, "whatever the order");
    // Names and numbers in the order of names, as one text of bytes.
    let mut all = Vec::new();
    for (name, values) in tensors() {
        all.extend_from_slice(name.as_bytes());
        values.iter().for_each(|v| all.extend(v.to_le_bytes()));
    }
    let hash: String = Sha256::digest(&all).iter().map(|b| format!("{b:02x}")).collect();
    assert_eq!(hash, expected);
}
