//! `motionette convert`, `inspect`, `plan` and `verify` from outside.

mod common;

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

use motionette_host::checkpoint;
use motionette_host::dataset::{Builder, Clip, Split};
use motionette_host::motion::recover;
use motionette_host::reference::Tokenizer;
use serde_json::Value;

/// A folder with the published RVQ checkpoint, its companions, and a dataset of one real motion in two splits.
struct Bench {
    folder: tempfile::TempDir,
}

impl Bench {
    fn new() -> Option<Self> {
        let published = common::shared("published")?;
        let folder = tempfile::tempdir().expect("a temporary folder");
        for (from, to) in [
            ("rvq.tar", "rvq.tar"),
            ("opt.txt", "opt.txt"),
            ("t2mgpt_vq.safetensors", "other.safetensors"),
            ("t2mgpt_args.json", "t2mgpt_args.json"),
            ("meta/mean.npy", "mean.npy"),
            ("meta/std.npy", "std.npy"),
        ] {
            std::fs::copy(published.join(from), folder.path().join(to)).expect(from);
        }
        let checkpoint = checkpoint::load(&folder.path().join("rvq.tar")).unwrap_or_else(|e| panic!("{e}"));
        let bytes = std::fs::read(published.join("golden/rvq_encode_input.npy")).expect("golden input");
        let normalised: Vec<f32> = npyz::NpyFile::new(&bytes[..]).expect("npy").into_vec().expect("floats");
        let features = Tokenizer::<f32>::new(&checkpoint).denormalise(&normalised).expect("statistics");
        let joints = recover::joints(&features).expect("whole rows");
        let mut builder = Builder::new();
        for (id, split) in [("for_training", Split::Train), ("for_testing", Split::Test)] {
            let clip = Clip {
                id: id.to_owned(),
                split,
                subset: "golden".to_owned(),
                source: "HumanML3D".to_owned(),
                fps_source: 20.0,
                captions: Vec::new(),
                labels: Value::Null,
                facts: None,
                hash: String::new(),
            };
            builder.push(clip, &joints, &features).expect("rows of a motion");
        }
        builder.finish().save(folder.path().join("two.mds")).expect("saved");
        Some(Self { folder })
    }

    fn run(&self, line: &str) -> Output {
        Command::new(env!("CARGO_BIN_EXE_motionette"))
            .args(line.split_whitespace())
            .arg("--json")
            .current_dir(self.folder.path())
            .output()
            .expect("the program starts")
    }

    fn succeeds(&self, line: &str) -> Value {
        let output = self.run(line);
        assert!(output.status.success(), "{line}: {}", String::from_utf8_lossy(&output.stderr));
        report(&output)
    }

    /// Fails with status 1 and says all of `words`; `rest` was not written.
    fn fails(&self, line: &str, words: &[&str], rest: &str) -> Value {
        let output = self.run(line);
        let said = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{line}: {said}");
        assert!(said.starts_with("error: ") && !said.contains("panicked"), "{said}");
        for word in words {
            assert!(said.contains(word), "{word:?} not in: {said}");
        }
        assert!(!self.path(rest).exists(), "{rest} was left behind");
        let report = report(&output);
        // A missed budget reports its figures instead.
        if report["error"].is_string() {
            common::says_each_cause_once(&report, &said);
        }
        report
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }
}

fn report(output: &Output) -> Value {
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    serde_json::from_str(text.lines().last().unwrap_or_default()).unwrap_or_else(|e| panic!("{e}: {text}"))
}

fn bytes(path: &Path) -> Vec<u8> {
    std::fs::read(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

#[test]
fn the_road_from_checkpoint_to_figures() {
    let Some(bench) = Bench::new() else { return };
    let made = bench.succeeds("convert rvq.tar --calibration two.mds --licence MIT -o a.blob");
    assert_eq!(made["bytes"].as_u64(), Some(bytes(&bench.path("a.blob")).len() as u64));
    bench.succeeds("convert rvq.tar --calibration two.mds --licence MIT -o b.blob");
    assert!(bytes(&bench.path("a.blob")) == bytes(&bench.path("b.blob")), "the converter is not deterministic");
    let plain = "--decoder-bits 8 --rounding nearest --no-refit --no-bias-correction --licence MIT";
    bench.succeeds(&format!("convert rvq.tar {plain} -o plain.blob"));
    assert!(bytes(&bench.path("plain.blob")) != bytes(&bench.path("a.blob")));

    let seen = bench.succeeds("inspect a.blob --checkpoint rvq.tar");
    assert_eq!((&seen["licence"], &seen["checkpoint"]), (&Value::from("MIT"), &made["checkpoint"]));
    assert_eq!(seen["layers"].as_array().map(Vec::len), Some(17));
    let wide: Vec<_> = seen["layers"].as_array().expect("layers").iter().map(|l| l["wide"].as_u64()).collect();
    assert_eq!((wide[15], wide[16]), (Some(0), Some(4)), "root rows of the last layer are int16");
    for layer in seen["layers"].as_array().expect("layers") {
        let error = layer["weight_error"].as_f64().expect("with the checkpoint");
        assert!(error > 0.0 && error < 0.05, "{layer}");
    }

    let plan = bench.succeeds("plan a.blob --tokens 20 --anchors 2 --model-rs model.rs");
    let sum = |shares: &Value| {
        shares.as_array().expect("shares").iter().map(|s| s["amount"].as_u64().expect("a number")).sum()
    };
    let (arena, flash): (u64, u64) = (sum(&plan["arena"]), sum(&plan["flash"]));
    assert_eq!((Some(arena), Some(flash)), (plan["arena_bytes"].as_u64(), plan["flash_bytes"].as_u64()));
    assert_eq!(plan["flash_bytes"], made["bytes"]);
    assert!(plan["ram_bytes"].as_u64() > Some(arena) && plan["ram_bytes"].as_u64() < Some(arena + 16 * 1024));
    let pass: u64 = sum(&plan["decoder_macs"]);
    let layers: u64 = seen["layers"].as_array().expect("layers").iter().map(|l| l["macs"].as_u64().expect("MAC")).sum();
    assert_eq!(pass * 49, layers * 20, "work grows with the number of tokens");
    let constants = String::from_utf8(bytes(&bench.path("model.rs"))).expect("text");
    assert!(constants.contains(&format!("pub const ARENA_BYTES: usize = {arena};")), "{constants}");
    assert!(constants.contains("include_bytes!(\"a.blob\")"), "{constants}");

    // Calibration must earn its keep, on a motion it has seen here; that budgets hold is tested on the trained model.
    let figures =
        |blob: &str| report(&bench.run(&format!("verify {blob} --checkpoint rvq.tar --dataset two.mds --solver 1")));
    let (calibrated, plain) = (figures("a.blob"), figures("plain.blob"));
    let mean = |v: &Value| v["agreement"]["mean_mm"].as_f64().expect("a figure");
    assert!(mean(&calibrated) < 0.7 * mean(&plain), "{} {}", mean(&calibrated), mean(&plain));
    assert_eq!(calibrated["agreement"]["clips"][0]["id"], "for_testing");
    assert_eq!(calibrated["layers"]["alone"].as_array().map(Vec::len), Some(17));
    assert_eq!(calibrated["checkpoint_matches"], true);
    assert!(calibrated["solvers"]["runtime_cm"].as_f64() < calibrated["solvers"]["before_cm"].as_f64());
}

#[test]
fn a_missed_budget_is_a_failure_with_figures() {
    let Some(bench) = Bench::new() else { return };
    bench.succeeds("convert rvq.tar -o a.blob");
    // Another model of the same sizes: the same checkpoint with one weight changed a lot.
    let mut file = bytes(&bench.path("a.blob"));
    let blob = motionette_host::blob::BlobFile::open(&bench.path("a.blob")).expect("a good blob");
    let header = blob.parts().expect("checked").header;
    let bias = blob.table().expect("checked").into_iter().find(|t| t.name == "decoder.model.6.bias").expect("a bias");
    let at = header.weights_offset as usize + bias.offset + 4;
    file[at..at + 4].copy_from_slice(&2.0_f32.to_le_bytes());
    let crc = motionette::blob::Header::checksum(&file);
    let repaired = motionette::blob::Header { crc, ..header }.emit();
    file[..repaired.len()].copy_from_slice(&repaired);
    std::fs::write(bench.path("bent.blob"), &file).expect("written");
    let line = "verify bent.blob --checkpoint rvq.tar --dataset two.mds --solver 0";
    let figures = bench.fails(line, &["root drift at the end of 5 s", "allowed 10 mm"], "nothing");
    assert_eq!(figures["passed"], false);
    assert!(figures["agreement"]["drift_mean_mm"].as_f64() > Some(10.0));
}

#[test]
fn bad_input_is_named() {
    let Some(bench) = Bench::new() else { return };
    bench.succeeds("convert rvq.tar -o a.blob");
    let good = bytes(&bench.path("a.blob"));
    std::fs::write(bench.path("cut.blob"), &good[..good.len() / 2]).expect("written");
    let mut flipped = good.clone();
    flipped[good.len() / 2] ^= 4;
    std::fs::write(bench.path("flipped.blob"), &flipped).expect("written");
    let mut future = good.clone();
    future[4] = 9;
    std::fs::write(bench.path("future.blob"), &future).expect("written");
    let archive = bytes(&bench.path("rvq.tar"));
    std::fs::write(bench.path("cut.tar"), &archive[..archive.len() / 2]).expect("written");

    bench.fails("convert cut.tar -o x.blob", &["cut.tar", "directory cannot be read"], "x.blob");
    bench.fails("convert missing.tar -o x.blob", &["missing.tar", "No such file"], "x.blob");
    bench.fails("convert rvq.tar --options mean.npy -o x.blob", &["mean.npy"], "x.blob");
    bench.fails("convert rvq.tar --mean opt.txt -o x.blob", &["opt.txt", ".npy"], "x.blob");
    bench.fails("convert rvq.tar --calibration opt.txt -o x.blob", &["opt.txt"], "x.blob");
    bench.fails("convert rvq.tar -o opt.txt/x.blob", &["opt.txt"], "opt.txt/x.blob");
    bench.fails("inspect cut.blob", &["cut.blob", "cut short"], "nothing");
    bench.fails("inspect flipped.blob", &["flipped.blob", "CRC-32"], "nothing");
    bench.fails("plan future.blob", &["version 9", "understands 4", "newer firmware"], "nothing");
    bench.fails("plan rvq.tar --model-rs x.rs", &["rvq.tar", "no motionette blob"], "x.rs");
    let wrong = "verify a.blob --checkpoint other.safetensors --dataset two.mds";
    bench.fails(wrong, &["different models", "36", "20"], "nothing");
    bench.fails("verify a.blob --checkpoint rvq.tar --dataset two.mds --split val", &["Val"], "nothing");
}
