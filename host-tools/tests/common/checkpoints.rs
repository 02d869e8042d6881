//! Small checkpoints for tests: a tokenizer, a prior of its tokens, and the prior's control.

use std::collections::HashMap;

use motionette_host::checkpoint::{ErrorKind, Tensor, TensorMap, TokenizerCheckpoint, control, prior};
use motionette_host::reference::scaffold;
use safetensors::{Dtype, tensor::TensorView};

use super::Random;

/// Sizes of the small tokenizer.
pub const TOKENIZER: &str = r#"{"width": 4, "encoder_width": 5, "code_dim": 3, "codes": 6, "quantizers": 1, "depth": 2,
    "dilations": [3, 1], "down_t": 2, "features": 263, "fps": 20, "preset": "small", "seed": 1, "steps": 2,
    "data_hash": "none", "metrics": [{"split": "val"}]}"#;

/// Every tensor of a tokenizer.
pub fn tokenizer() -> TensorMap {
    let mut map = TensorMap::default();
    let mut count = 0;
    let mut add = |name: &str, shape: &[usize]| {
        let data = (0..shape.iter().product::<usize>()).map(|i| ((i * 7 + count) % 23) as f32 / 23.0 - 0.4).collect();
        count += 1;
        map.insert(name, Tensor { shape: shape.to_vec(), data });
    };
    let mut conv = |name: String, outputs: usize, inputs: usize, kernel: usize| {
        add(&format!("{name}.weight"), &[outputs, inputs, kernel]);
        add(&format!("{name}.bias"), &[outputs]);
    };
    conv("encoder.model.0".into(), 5, 263, 3);
    conv("decoder.model.0".into(), 4, 3, 3);
    for s in [2, 3] {
        conv(format!("encoder.model.{s}.0"), 5, 5, 4);
        for b in 0..2 {
            for (part, width) in [("encoder", 5), ("decoder", 4)] {
                let stack = if part == "encoder" { 1 } else { 0 };
                conv(format!("{part}.model.{s}.{stack}.model.{b}.conv1"), width, width, 3);
                conv(format!("{part}.model.{s}.{stack}.model.{b}.conv2"), width, width, 1);
            }
        }
        conv(format!("decoder.model.{s}.2"), 4, 4, 3);
    }
    conv("encoder.model.4".into(), 3, 5, 3);
    conv("decoder.model.4".into(), 4, 4, 3);
    conv("decoder.model.6".into(), 263, 4, 3);
    add("quantizer.layers.0.codebook", &[6, 3]);
    add("mean", &[263]);
    map.insert("std", Tensor { shape: vec![263], data: vec![0.5; 263] });
    map
}

/// Metadata of a tokenizer with this configuration.
pub fn tokenizer_metadata(config: &str) -> HashMap<String, String> {
    metadata("motionette-tokenizer", config)
}

/// A safetensors file.
pub fn bytes(map: &TensorMap, metadata: HashMap<String, String>) -> Vec<u8> {
    let raw: Vec<(String, Vec<usize>, Vec<u8>)> = map
        .iter()
        .map(|(n, t)| (n.to_owned(), t.shape.clone(), t.data.iter().flat_map(|v| v.to_le_bytes()).collect()))
        .collect();
    let views = raw.iter().map(|(n, s, d)| (n.clone(), TensorView::new(Dtype::F32, s.clone(), d).expect("a view")));
    safetensors::serialize(views, Some(metadata)).expect("a file")
}

fn metadata(format: &str, config: &str) -> HashMap<String, String> {
    [("format", format), ("version", "1"), ("config", config)].map(|(k, v)| (k.to_owned(), v.to_owned())).into()
}

/// Metadata of a prior with this configuration.
pub fn prior_metadata(config: &str) -> HashMap<String, String> {
    metadata("motionette-prior", config)
}

/// The small tokenizer, checked.
pub fn tokenizer_checkpoint() -> TokenizerCheckpoint {
    let config = motionette_host::checkpoint::Config::from_json(TOKENIZER).expect("a good configuration");
    TokenizerCheckpoint::build(&tokenizer(), config).expect("a good checkpoint")
}

/// Sizes and vocabulary of a small prior of the small tokenizer's tokens. `norm`: pre or post; `activation`: gelu or relu.
pub fn prior_config(norm: &str, activation: &str) -> String {
    let hash = prior::codebook_hash(tokenizer_checkpoint().codebooks.iter().flatten());
    format!(
        r#"{{"vocabulary": ["<none>", "<unknown>", "a", "person", "walks", "waves", "carry", "run", "tired"], "max_words": 7,
    "max_tokens": 49, "codes": 6, "code_dim": 3, "text": {{"width": 8, "heads": 2, "layers": 1, "hidden": 13}},
    "planner": {{"width": 12, "heads": 3, "layers": 2, "hidden": 16}}, "epsilon": 1e-5, "norm": "{norm}",
    "activation": "{activation}", "c": 3.0, "a": 0.9, "tokenizer": "{hash}", "preset": "tiny", "seed": 1, "steps": 2,
    "data_hash": "none", "metrics": null}}"#
    )
}

/// Numbers within `size` of `middle`.
fn random_tensor(random: &mut Random, shape: &[usize], size: f64, middle: f64) -> Tensor {
    let data = (0..shape.iter().product()).map(|_| (middle + size * random.uniform()) as f32).collect();
    Tensor { shape: shape.to_vec(), data }
}

/// Every tensor of a small prior, random.
pub fn prior(seed: u64) -> TensorMap {
    let (words, max_words, max_tokens, codes, dt, d) = (9, 7, 49, 6, 8, 12);
    let mut random = Random(seed);
    let mut map = TensorMap::default();
    let mut add = |name: String, shape: &[usize], size: f64, middle: f64| {
        map.insert(name, random_tensor(&mut random, shape, size, middle));
    };
    let mut tables = vec![("text.embedding", words, dt), ("text.position", max_words, dt), ("planner.time", 32, d)];
    tables.extend([("planner.boundary", 4, d), ("planner.position", max_tokens, d), ("planner.end", max_tokens, d)]);
    tables.push(("planner.fixed", 1, d));
    for (name, rows, width) in tables {
        add(format!("{name}.weight"), &[rows, width], 1.0, 0.0);
    }
    let mut linears = vec![("text.length".to_owned(), max_tokens, dt)];
    linears.extend([("planner.global".into(), d, dt), ("planner.token".into(), codes, d)]);
    let mut norms = vec![("text.norm".to_owned(), dt), ("planner.norm".into(), d)];
    for (base, layers, width, hidden) in [("text", 1, dt, 13), ("planner", 2, d, 16)] {
        for i in 0..layers {
            let name = format!("{base}.layers.{i}");
            norms.extend([(format!("{name}.norm1"), width), (format!("{name}.norm2"), width)]);
            linears.push((format!("{name}.attention.qkv"), 3 * width, width));
            linears.push((format!("{name}.attention.out"), width, width));
            linears.push((format!("{name}.ffn.in"), hidden, width));
            linears.push((format!("{name}.ffn.out"), width, hidden));
            if base == "planner" {
                norms.push((format!("{name}.norm_cross"), width));
                linears.push((format!("{name}.cross.q"), width, width));
                linears.push((format!("{name}.cross.kv"), 2 * width, dt));
                linears.push((format!("{name}.cross.out"), width, width));
            }
        }
    }
    for (name, outputs, inputs) in linears {
        add(format!("{name}.weight"), &[outputs, inputs], 1.5 / (inputs as f64).sqrt(), 0.0);
        add(format!("{name}.bias"), &[outputs], 0.3, 0.0);
    }
    for (name, width) in norms {
        add(format!("{name}.weight"), &[width], 0.3, 1.0);
        add(format!("{name}.bias"), &[width], 0.2, 0.0);
    }
    map
}

/// A small prior, checked.
pub fn prior_checkpoint(seed: u64, norm: &str, activation: &str) -> prior::PriorCheckpoint {
    let config = prior::PriorConfig::from_json(&prior_config(norm, activation)).expect("a good configuration");
    prior::PriorCheckpoint::build(&prior(seed), config).expect("a good checkpoint")
}

/// Configuration of a small prior of masked tokens.
pub fn masked_config() -> String {
    prior_config("pre", "gelu").replace(r#""c": 3.0, "a": 0.9"#, r#""corruption": "masks""#)
}

/// Every tensor of it.
pub fn masked(seed: u64) -> TensorMap {
    let mut map = prior(seed);
    map.insert("planner.mask.weight", random_tensor(&mut Random(seed + 1), &[1, 12], 1.0, 0.0));
    map
}

/// Numbers of a word's vector in [`understanding`].
pub const DIMS: usize = 16;

/// Configuration of a small prior whose words have vectors, that knows three meanings and is told how strongly it is guided.
pub fn understanding_config() -> String {
    let mut words = ["a", "person", "walks", "waves", "carry", "run", "tired"];
    words.sort_by_key(|word| motionette_host::checkpoint::words::hash(word));
    let list = words.map(|word| format!("\"{word}\"")).join(", ");
    let meaning = |name: &str, style: bool, phrase: &str| {
        format!(r#"{{"name": "{name}", "side": "none", "style": {style}, "phrase": "{phrase}"}}"#)
    };
    let meanings = [
        meaning("walk", false, "a person walks"),
        meaning("wave", false, "a person waves"),
        meaning("tired", true, "tiredly"),
    ];
    let (old, more) = (r#""a", "person", "walks", "waves", "carry", "run", "tired""#, meanings.join(", "));
    let config = prior_config("pre", "gelu").replace(old, &list);
    let more = format!(
        r#""word_vectors": {DIMS}, "word_tiers": [0, 0, 0, 0, 0, 1, 2], "guidance": true, "threshold": 0.6, "meanings": [{more}]"#
    );
    config.replacen('{', &format!("{{{more}, "), 1)
}

/// Every tensor of it.
pub fn understanding(seed: u64) -> TensorMap {
    let (words, dt, d) = (7, 8, 12);
    let mut map = TensorMap::default();
    for (name, tensor) in prior(seed).iter().filter(|(name, _)| *name != "text.embedding.weight") {
        map.insert(name, tensor.clone());
    }
    let mut random = Random(seed + 1);
    let mut add = |name: &str, shape: &[usize], change: &dyn Fn(f32) -> f32| {
        let mut tensor = random_tensor(&mut random, shape, 1.0, 0.0);
        tensor.data.iter_mut().for_each(|v| *v = change(*v));
        map.insert(name, tensor);
    };
    add("text.vectors.weight", &[words, DIMS], &|v| (7.0 * v).round());
    add("text.scales.weight", &[words, 1], &|v| half::f16::from_f32(0.2 + 0.1 * v).to_f32());
    add("text.special.weight", &[2, dt], &|v| v);
    add("text.projection.weight", &[dt, DIMS], &|v| v);
    add("text.projection.bias", &[dt], &|v| v);
    add("text.meaning.weight", &[3, dt], &|v| v);
    add("text.meaning.bias", &[3], &|v| v);
    add("planner.guidance.weight", &[5, d], &|v| v);
    map
}

/// Metadata of a control with this configuration.
pub fn control_metadata(config: &str) -> HashMap<String, String> {
    metadata("motionette-control", config)
}

/// Sizes of a small control of [`prior`] with this seed. `families`: a list in JSON.
pub fn control_config(prior_seed: u64, norm: &str, activation: &str, context: bool, families: &str) -> String {
    let prior = prior_checkpoint(prior_seed, norm, activation);
    let (tokenizer, prior) = (prior.config.tokenizer.clone(), prior.weights_hash());
    format!(
        r#"{{"max_tokens": 49, "frame_width": 5, "scaffold": {{"width": 8, "heads": 2, "layers": 2, "hidden": 9}}, "rank": 3,
    "planner_width": 12, "planner_layers": 2, "epsilon": 1e-5, "norm": "{norm}", "activation": "{activation}",
    "context": {context}, "families": {families}, "tokenizer": "{tokenizer}", "prior": "{prior}", "figures": [1]}}"#
    )
}

/// Every tensor of a small control, random.
pub fn control(seed: u64, context: bool) -> TensorMap {
    let (frame, ws, hidden, rank, d) = (5, 8, 9, 3, 12);
    let mut random = Random(seed);
    let mut map = TensorMap::default();
    let mut add = |name: String, shape: &[usize], size: f64, middle: f64| {
        map.insert(name, random_tensor(&mut random, shape, size, middle));
    };
    add("control.mean".into(), &[scaffold::VALUES], 0.3, 0.5);
    add("control.std".into(), &[scaffold::VALUES], 0.2, 0.6);
    add("control.position.weight".into(), &[49, ws], 1.0, 0.0);
    let mut linears =
        vec![("control.frame".to_owned(), frame, scaffold::WIDTH), ("control.merge".into(), ws, 4 * frame)];
    let mut norms = vec!["control.norm".to_owned()];
    for i in 0..2 {
        let name = format!("control.layers.{i}");
        norms.extend([format!("{name}.norm1"), format!("{name}.norm2")]);
        linears.push((format!("{name}.attention.qkv"), 3 * ws, ws));
        linears.push((format!("{name}.attention.out"), ws, ws));
        linears.push((format!("{name}.ffn.in"), hidden, ws));
        linears.push((format!("{name}.ffn.out"), ws, hidden));
    }
    for m in 0..2 {
        linears.push((format!("control.anchor.{m}.down"), rank, ws));
        linears.push((format!("control.anchor.{m}.kv"), 2 * d, rank));
    }
    if context {
        linears.push(("control.global.in".into(), ws, ws));
        linears.push(("control.global.out".into(), d, ws));
        linears.push(("control.local".into(), d, ws));
    }
    for (name, outputs, inputs) in linears {
        add(format!("{name}.weight"), &[outputs, inputs], 1.5 / (inputs as f64).sqrt(), 0.0);
        add(format!("{name}.bias"), &[outputs], 0.3, 0.0);
    }
    for name in norms {
        add(format!("{name}.weight"), &[ws], 0.3, 1.0);
        add(format!("{name}.bias"), &[ws], 0.2, 0.0);
    }
    map
}

/// A small control, checked, with all families and the dual context.
pub fn control_checkpoint(seed: u64, prior_seed: u64) -> control::ControlCheckpoint {
    let text = control_config(prior_seed, "pre", "gelu", true, r#"["root3d", "planar", "body"]"#);
    let config = control::ControlConfig::from_json(&text).expect("a good configuration");
    control::ControlCheckpoint::build(&control(seed, true), config).expect("a good checkpoint")
}

/// Takes away, misshapes and spoils every tensor of a checkpoint in turn: each time `refused`, which reads what is left and gives its
/// error, must name that tensor.
pub fn names_every_damaged_tensor(map: &TensorMap, refused: impl Fn(&TensorMap) -> ErrorKind) {
    for (i, name) in map.names().enumerate() {
        let mut partial = TensorMap::default();
        map.iter().filter(|(n, _)| *n != name).for_each(|(n, t)| partial.insert(n, t.clone()));
        let kind = refused(&partial);
        assert!(matches!(&kind, ErrorKind::MissingTensor { tensor, .. } if tensor == name), "{name}: {kind}");

        let mut shape = map.find(name).expect(name).shape.clone();
        let turned = i % shape.len();
        shape[turned] += 1;
        let mut wrong = map.clone();
        wrong.insert(name, Tensor { shape: shape.clone(), data: vec![0.25; shape.iter().product()] });
        let kind = refused(&wrong);
        let ErrorKind::Shape { tensor, actual, .. } = &kind else { panic!("{name}: {kind}") };
        assert_eq!((tensor.as_str(), actual), (name, &shape));

        let mut wrong = map.clone();
        let mut tensor = map.find(name).expect(name).clone();
        tensor.data[2] = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY][i % 3];
        wrong.insert(name, tensor);
        let kind = refused(&wrong);
        assert!(matches!(&kind, ErrorKind::NotFinite { tensor, index: 2, .. } if tensor == name), "{name}: {kind}");
    }
}

/// Reads a checkpoint with the metadata of another format, of another version, and without configuration, all of which `refused` must
/// name.
pub fn names_other_metadata(
    good: &HashMap<String, String>,
    other_format: &str,
    refused: impl Fn(HashMap<String, String>) -> ErrorKind,
) {
    for (key, value) in [("format", other_format), ("version", "2")] {
        let mut metadata = good.clone();
        metadata.insert(key.to_owned(), value.to_owned());
        let kind = refused(metadata);
        assert!(matches!(&kind, ErrorKind::Version { key: k, actual, .. } if *k == key && actual == value), "{kind}");
    }
    let mut metadata = good.clone();
    metadata.remove("config");
    assert!(matches!(refused(metadata), ErrorKind::MissingOption { .. }));
}
