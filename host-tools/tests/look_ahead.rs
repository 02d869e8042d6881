//! A tokenizer whose decoder looks less far ahead than back, from its checkpoint to joints of the runtime.

mod common;

use common::bench::Bench;
use common::checkpoints::{self, TOKENIZER, tokenizer_metadata};
use motionette::{Bones, Generator, Limits, Plan, ROWS, Request};
use motionette_host::blob::BlobFile;
use motionette_host::checkpoint;
use motionette_host::reference::DecodePath;

const TOKENS: [u16; 12] = [3, 0, 5, 1, 1, 4, 2, 0, 3, 5, 2, 4];

/// `TOKENIZER`, whose dilations are 3 and 1, with such padding on the right; `None`: as much as on the left.
fn write(bench: &Bench, name: &str, right: Option<&str>) {
    let config = right.map_or(TOKENIZER.to_owned(), |right| {
        TOKENIZER.replace("\"down_t\": 2", &format!("\"right\": {right}, \"down_t\": 2"))
    });
    let mut tensors = checkpoints::tokenizer();
    let mut std = tensors.find("std").expect("std").clone();
    std.data.iter_mut().for_each(|s| *s = 0.05);
    tensors.insert("std", std);
    bench.write(name, &checkpoints::bytes(&tensors, tokenizer_metadata(&config)));
}

/// Joints by the reference, one coordinate after the other.
fn reference(bench: &Bench, name: &str) -> Vec<f64> {
    let checkpoint = checkpoint::load(&bench.path(name)).expect("a good checkpoint");
    let codebooks: Vec<Vec<f64>> =
        checkpoint.codebooks.iter().map(|book| book.iter().map(|&v| f64::from(v)).collect()).collect();
    let latent: Vec<f64> =
        TOKENS.iter().flat_map(|&token| codebooks[0][usize::from(token) * 3..][..3].iter().copied()).collect();
    let path = DecodePath::<f64>::new(&checkpoint).expect("statistics inside");
    path.forward(&latent).joints.into_iter().flatten().flatten().collect()
}

/// The same by the runtime.
fn runtime(bench: &Bench, name: &str) -> Vec<f64> {
    let file = BlobFile::open(&bench.path(name)).expect("a good blob");
    let model = file.model().expect("a good blob");
    let limits = Limits {
        tokens: TOKENS.len(),
        anchors: 0,
        tracked: 0,
        timeline: None,
        refinement: Default::default(),
        planning: None,
        rows: ROWS,
    };
    let plan = Plan::for_request(&model, &limits).expect("the limits are legal");
    let mut arena = vec![0u8; plan.arena_bytes + 16];
    let mut generator = Generator::new(model, &mut arena).expect("default floating point");
    let motion = generator
        .generate(&Request::tokens(&TOKENS).bones(Bones::Decoded).unrefined(), &mut ())
        .expect("request is valid");
    motion.joints().iter().map(|&v| f64::from(v)).collect()
}

fn distance(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    (a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>() / a.len() as f64).sqrt()
}

#[test]
fn a_blob_has_the_padding_of_its_checkpoint_and_moves_like_it() {
    let bench = Bench::new();
    write(&bench, "same.safetensors", None);
    let same = reference(&bench, "same.safetensors");
    // Look-ahead by hand: ((1 + 2 + 0) * 2 + 1 + 0 + 1) * 2 + 0 + 1 + 0.
    for (right, frames, version) in [
        ("[1, 3, 1, 1, 3, 1, 1, 1, 1]", 33, 0),
        ("[0, 0, 0, 0, 0, 0, 0, 0, 0]", 0, 1),
        ("[1, 2, 0, 1, 0, 1, 0, 1, 0]", 17, 1),
    ] {
        write(&bench, "t.safetensors", Some(right));
        bench.succeeds("convert t.safetensors --licence MIT -o a.blob");
        assert_eq!(std::fs::read(bench.path("a.blob")).expect("written")[6], version, "{right}");
        let seen = bench.succeeds("inspect a.blob");
        let found: Vec<_> = seen["padding"].as_array().expect("a list").iter().map(|each| each[1].clone()).collect();
        assert_eq!(serde_json::json!(found), serde_json::from_str::<serde_json::Value>(right).expect("numbers"));
        let plan = bench.succeeds("plan a.blob");
        assert_eq!(plan["stream"]["latency_frames"], frames, "{right}");
        let wanted = reference(&bench, "t.safetensors");
        let off = distance(&runtime(&bench, "a.blob"), &wanted);
        let other = distance(&same, &wanted);
        assert!(off < 0.003, "{right}: {off} m");
        assert!(if version == 0 { other == 0.0 } else { other > 0.03 }, "{right}: {other} m");
    }
    bench.fails(
        &["verify", "a.blob", "--checkpoint", "same.safetensors", "--dataset", "none.mds"],
        &["look-ahead of a convolution"],
    );
}
