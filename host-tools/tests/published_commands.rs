//! From published checkpoints to motions by the program alone, and what goes wrong on the way.

mod common;

use std::path::Path;

use common::bench::{Bench, list};
use common::golden::{Golden, published};

/// Files of the fixtures in the folder of a bench.
fn with(folder: &Path) -> Bench {
    let bench = Bench::new();
    for name in ["rvq.tar", "opt.txt", "mask.tar", "mask_opt.txt", "res.safetensors", "res_opt.txt", "t2mgpt_vq.pth"] {
        std::fs::copy(folder.join(name), bench.path(name)).expect(name);
    }
    for name in ["t2mgpt_trans.safetensors", "t2mgpt_args.json", "meta/mean.npy", "meta/std.npy"] {
        let to = bench.path(Path::new(name).file_name().and_then(|name| name.to_str()).expect("a name"));
        std::fs::copy(folder.join(name), to).expect(name);
    }
    for (name, array) in [("walk.npy", "mask_cond"), ("stop.npy", "t2mgpt_greedy_stop_cond")] {
        std::fs::copy(folder.join(format!("golden/{array}.npy")), bench.path(name)).expect(name);
    }
    bench.write("vectors.txt", b"# vectors\nwalk\twalk.npy\n");
    bench
}

#[test]
fn momask_from_its_files_to_a_motion() {
    let Some(folder) = published() else { return };
    let bench = with(&folder);
    let made =
        bench.succeeds("convert rvq.tar --prior mask.tar --residual res.safetensors --bank vectors.txt -o m.blob");
    assert_eq!((list(&made["bank"]), made["residual"].as_bool()), (vec!["walk".into()], Some(true)));
    assert_eq!((made["decoder_bits"].as_u64(), made["planner_bits"].as_u64()), (Some(16), Some(16)));
    let seen = bench.succeeds("inspect m.blob");
    assert_eq!(list(&seen["features"]), ["vq", "masked", "residual", "wide-layers"]);
    assert_eq!((seen["version"].as_str(), seen["generator"].as_str()), (Some("4.2"), Some("masked")));
    assert_eq!(seen["prior"]["vector"].as_u64(), Some(512));
    let planned = bench.succeeds("plan m.blob --anchors 0");
    let named = bench.succeeds("generate --blob m.blob --prompt walk --seconds 9.8 --seed 3 -o a.bvh");
    assert_eq!(named["arena_bytes"], planned["arena_bytes"], "what was planned");
    assert_eq!((named["planner_steps"].as_u64(), named["guidance"].as_f64()), (Some(10), Some(4.0)));
    assert_eq!(named["tokens"].as_array().map(Vec::len), Some(49 * 3));
    let sent = bench.succeeds("generate --blob m.blob --prompt-vector walk.npy --seconds 4 --seed 3 -o b.bvh");
    assert_eq!(sent["frames"].as_u64(), Some(80));
    // The tokenizer alone, for tokens that come from elsewhere, likewise.
    let alone = bench.succeeds("convert rvq.tar -o alone.blob");
    assert_eq!((alone["decoder_bits"].as_u64(), alone["calibration_sequences"].as_u64()), (Some(16), Some(0)));
    let alone = bench.succeeds("convert rvq.tar --decoder-bits 8 -o alone.blob");
    assert!(alone["decoder_bits"].as_u64() == Some(8) && alone["calibration_sequences"].as_u64() > Some(0));
    // Half the bytes with 8 bits.
    bench.succeeds("convert rvq.tar --prior mask.tar --decoder-bits 8 --planner-bits 8 -o small.blob");
    let seen = bench.succeeds("inspect small.blob");
    assert_eq!(list(&seen["features"]), ["vq", "masked"]);
    bench.succeeds("generate --blob small.blob --prompt-vector walk.npy --seconds 2 -o c.bvh");
}

#[test]
fn t2mgpt_from_its_files_to_the_published_tokens() {
    let Some(folder) = published() else { return };
    let bench = with(&folder);
    bench.succeeds("convert t2mgpt_vq.pth --prior t2mgpt_trans.safetensors -o g.blob");
    let seen = bench.succeeds("inspect g.blob");
    assert_eq!(list(&seen["features"]), ["vq", "autoregressive", "wide-layers"]);
    let made = bench.succeeds("generate --blob g.blob --prompt-vector stop.npy --sampling greedy -o a.bvh");
    let tokens: Vec<i64> = made["tokens"].as_array().expect("tokens").iter().filter_map(|t| t.as_i64()).collect();
    assert_eq!(tokens, Golden::open(&folder).ids("t2mgpt_greedy_stop_ids"));
    assert!(made["planner_steps"].is_null());
}

#[test]
fn what_does_not_go_together_is_refused() {
    let Some(folder) = published() else { return };
    let bench = with(&folder);
    let refuse = |line: &str, words: &[&str]| bench.fails(&line.split_whitespace().collect::<Vec<_>>(), words);
    refuse("convert rvq.tar --prior res.safetensors -o x", &["residual transformer", "--residual"]);
    refuse("convert rvq.tar --prior t2mgpt_trans.safetensors -o x", &["codes are 48", "64"]);
    refuse("convert t2mgpt_vq.pth --prior mask.tar -o x", &["codes are 64", "48"]);
    refuse("convert rvq.tar --prior mask.tar --residual mask.tar -o x", &["no residual transformer"]);
    refuse(
        "convert t2mgpt_vq.pth --prior t2mgpt_trans.safetensors --residual res.safetensors -o x",
        &["T2M-GPT", "residual"],
    );
    refuse("convert t.safetensors --prior p.prior.safetensors --residual res.safetensors -o x", &["--residual"]);
    refuse("convert t.safetensors --prior p.prior.safetensors --planner-bits 16 -o x", &["published planners"]);
    bench.write("lost.txt", b"walk\tno-such.npy\n");
    refuse("convert rvq.tar --prior mask.tar --bank lost.txt -o x", &["line 1", "walk", "no-such.npy"]);
    bench.write("words.txt", b"walk\tmean.npy\n");
    refuse("convert rvq.tar --prior mask.tar --bank words.txt -o x", &["walk", "263", "512"]);
    std::fs::copy(bench.path("res_opt.txt"), bench.path("other.txt")).expect("copied");
    let text = std::fs::read_to_string(bench.path("other.txt")).expect("options");
    bench.write("other.txt", text.replace("n_layers: 3", "n_layers: 2").as_bytes());
    refuse("convert rvq.tar --prior mask.tar --prior-options other.txt -o x", &["n_layers"]);

    bench.succeeds("convert rvq.tar --prior mask.tar --bank vectors.txt -o m.blob");
    bench.succeeds("convert t.safetensors --prior p.prior.safetensors -o words.blob");
    let generate = |line: &str, words: &[&str]| {
        let line: Vec<&str> = line.split_whitespace().chain(["-o", "x"]).collect();
        bench.fails(&line, words);
    };
    generate("generate --blob m.blob --text wave", &["vectors of 512 numbers", "--prompt", "walk"]);
    generate("generate --blob m.blob --prompt-vector mean.npy", &["263 numbers", "512"]);
    generate("generate --blob words.blob --prompt-vector walk.npy", &["words, not as vectors"]);
    generate("generate --blob m.blob --prompt-vector no-such.npy", &["no-such.npy"]);
    generate("generate --blob m.blob --prompt run", &["stores", "walk"]);
}
