//! `convert --prior`, `inspect`, `plan`, `verify --prior` and `generate`: from two small random checkpoints to a motion, and what goes
//! wrong on the way.

mod common;

use std::process::Command;

use common::bench::{Bench, list, report};
use common::checkpoints::{self, prior_config, prior_metadata};
use motionette_host::blob::BlobFile;
use motionette_host::checkpoint::prior;
use motionette_host::reference::Prior;
use motionette_host::reference::tmd::{Sampling, Schedule, Settings};
use serde_json::Value;

#[test]
fn a_blob_holds_what_the_checkpoints_hold() {
    let bench = Bench::new();
    let made = bench.succeeds("convert t.safetensors --prior p.prior.safetensors --bank bank.txt -o p.blob");
    assert_eq!((made["words"].as_u64(), list(&made["bank"])), (Some(9), vec!["wave".into(), "fly".into()]));
    bench.succeeds("convert t.safetensors --prior p.prior.safetensors --bank bank.txt -o again.blob");
    let bytes = |name| std::fs::read(bench.path(name)).expect("a blob");
    assert!(bytes("p.blob") == bytes("again.blob"), "the converter is not deterministic");

    let seen = bench.succeeds("inspect p.blob --checkpoint t.safetensors --prior p.prior.safetensors --vocabulary");
    let info = &seen["prior"];
    assert_eq!(list(&info["vocabulary"])[2..5], ["a", "person", "walks"]);
    assert_eq!(list(&info["bank"]), ["wave", "fly"]);
    assert_eq!(info["layers"].as_array().map(Vec::len), Some(2 + 4 + 1 + 6 + 2 * 7 + 1));
    for layer in info["layers"].as_array().expect("layers") {
        let error = layer["weight_error"].as_f64().expect("with the prior");
        assert!(error > 0.0 && error < 0.02, "{layer}");
    }

    // Every number of the checkpoint comes back, to half a step of its row.
    let blob = BlobFile::open(&bench.path("p.blob")).expect("a blob");
    let source = prior::load(&bench.path("p.prior.safetensors")).expect("a prior");
    let back = blob.dequantised_prior(&source).expect("checked");
    assert!(back != source);
    let largest = |w: &[f32]| w.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
    for (a, b) in [source.text_parts(), source.planner_parts()]
        .concat()
        .iter()
        .zip([back.text_parts(), back.planner_parts()].concat())
    {
        match (a, b) {
            (prior::Part::Linear(a), prior::Part::Linear(b)) => {
                assert_eq!(a.bias, b.bias, "{}", a.name);
                for (a, b) in a.weight.chunks(a.inputs).zip(b.weight.chunks(b.inputs)) {
                    let step = largest(a) / 127.0;
                    assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 0.501 * step));
                }
            }
            (prior::Part::Embedding(a), prior::Part::Embedding(b)) => {
                for (a, b) in a.weight.chunks(a.width).zip(b.weight.chunks(b.width)) {
                    let step = largest(a) / 127.0;
                    assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 0.501 * step));
                }
            }
            (prior::Part::Norm(a), prior::Part::Norm(b)) => assert_eq!(a, &b),
            _ => panic!("other parts"),
        }
    }

    // Without the text encoder only prompts by name are left, the unconditional one among them.
    let less = "convert t.safetensors --prior p.prior.safetensors --bank bank.txt --no-text-encoder -o bank.blob";
    let made = bench.succeeds(less);
    assert_eq!(made["words"], Value::Null);
    let seen = bench.succeeds("inspect bank.blob");
    assert_eq!(list(&seen["prior"]["bank"]), ["<none>", "wave", "fly"]);
    assert_eq!((&seen["prior"]["text"], list(&seen["prior"]["vocabulary"]).len()), (&Value::Null, 0));
    // Stored is what the reference makes of the prompt: memory, then pooled vector.
    let blob = BlobFile::open(&bench.path("bank.blob")).expect("a blob");
    let entry = blob.table().expect("checked").into_iter().find(|t| t.name == "bank.1").expect("the second prompt");
    let reference = Prior::<f32>::with_codebook(&source, &checkpoints::tokenizer_checkpoint().codebooks[0]);
    let encoded = reference.text.encode(&[2, 3, 5]);
    assert_eq!(entry.shape, [1, 4, 8]);
    for (a, b) in entry.values.iter().zip([encoded.memory, encoded.pooled].concat()) {
        assert!((a - f64::from(b)).abs() < 2e-3 * (1.0 + a.abs()), "{a} {b}");
    }
}

#[test]
fn four_bits_are_for_the_planners_blocks_in_whole_groups() {
    let bench = Bench::new();
    let convert = |options: &str, blob: &str| {
        bench.succeeds(&format!("convert t.safetensors --prior p.prior.safetensors {options} -o {blob}.blob"))
    };
    convert("--planner-bits 8", "eight");
    convert("", "plain");
    let bytes = |blob: &str| std::fs::read(bench.path(&format!("{blob}.blob"))).expect("a blob");
    assert!(bytes("eight") == bytes("plain"), "8 bits are the default");
    assert_eq!(convert("--planner-bits 4 --rounding nearest", "four")["planner_bits"], 4);
    let mixed = convert("--four-bits ffn.out,cross.q --rounding nearest", "mixed");
    assert_eq!(mixed["planner_bits"], 8);
    assert_eq!(list(&mixed["four_bits"]), ["cross.q", "ffn.out"]);
    assert_eq!(bytes("mixed"), bytes("four"), "no other layer comes in whole groups here");
    assert_eq!(convert("--four-bits cross.q --rounding nearest", "other")["bytes"], bytes("plain").len());
    // Both of version 4.0.
    assert_eq!((&bytes("plain")[4..8], &bytes("four")[4..8]), (&[4, 0, 0, 0][..], &[4, 0, 0, 0][..]));
    assert!(bytes("four").len() < bytes("plain").len());

    let blob = BlobFile::open(&bench.path("four.blob")).expect("a blob");
    let source = prior::load(&bench.path("p.prior.safetensors")).expect("a prior");
    for layer in blob.prior_layers().expect("checked") {
        // Of the widths 12, 8 and 16 only the last comes in whole groups.
        let narrow = layer.name.starts_with("planner.layers.") && layer.name.ends_with(".ffn.out");
        assert_eq!(layer.bits, if narrow { 4 } else { 8 }, "{}", layer.name);
    }
    let back = blob.dequantised_prior(&source).expect("checked");
    for (a, b) in source.planner.layers.iter().zip(&back.planner.layers) {
        for (a, b) in a.contract.weight.chunks(16).zip(b.contract.weight.chunks(16)) {
            let step = a.iter().fold(0.0_f32, |m, v| m.max(v.abs())) / 7.0;
            assert!(a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 0.501 * step));
        }
    }
    let seen = bench.succeeds("inspect four.blob");
    let layers = seen["prior"]["layers"].as_array().expect("layers");
    assert_eq!(layers.iter().filter(|l| l["bits"] == 4).count(), 2);
    let plan = bench.succeeds("plan four.blob");
    let share = |name: &str| plan["flash"].as_array()?.iter().find(|s| s["name"] == name)?["amount"].as_u64();
    assert_eq!(share("planner, 4-bit weights"), Some(2 * 12 * 16 / 2));
    bench.misused("convert t.safetensors --prior p.prior.safetensors --planner-bits 6 -o six.blob", "error");
}

#[test]
fn plan_counts_the_planner() {
    let bench = Bench::new();
    bench.convert();
    let sum = |shares: &Value| -> u64 {
        shares.as_array().expect("shares").iter().map(|s| s["amount"].as_u64().expect("a number")).sum()
    };
    let number = |v: &Value| v.as_u64().expect("a number");
    let plan = |options: &str| bench.succeeds(&format!("plan p.blob --tokens 20 {options}"));
    let whole = plan("--anchors 0");
    assert_eq!((number(&whole["planning"]["words"]), number(&whole["planning"]["steps"])), (7, 5));
    for report in [&whole, &plan("--anchors 3 --words 2 --steps 4 --guidance 1"), &plan("--words 0")] {
        assert_eq!(sum(&report["arena"]), number(&report["arena_bytes"]));
        assert_eq!(sum(&report["flash"]), number(&report["flash_bytes"]));
    }
    let macs = |options: &str| number(&plan(options)["planning"]["macs"]);
    assert!(macs("--steps 20") > 19 * macs("--steps 10") / 10 && macs("--guidance 1") < 2 * macs("") / 3);
    assert!(macs("--words 1") < macs("--words 7") && macs("--words 7") == macs("--words 1000"));
    let without = plan("--words 0 --anchors 0");
    assert_eq!(without["planning"], Value::Null);
    assert_eq!(number(&without["macs"]) + number(&whole["planning"]["macs"]), number(&whole["macs"]));
    // A pass of 21 rows, twice for guidance, five times.
    let figures = |options: &str| {
        let report = plan(options);
        let [reads, bytes, macs] = ["reads", "bytes", "macs"].map(|figure| number(&report["planning"][figure]));
        [number(&report["rows"]), reads, bytes, macs]
    };
    let [few, some, many] = ["--rows 4", "", "--rows 24"].map(figures);
    assert_eq!([few, some, many].map(|f| (f[0], f[1])), [(4, 60), (8, 30), (24, 10)]);
    assert!(few[2] < some[2] && some[2] < many[2] && few[3] == many[3]);
    bench.succeeds("plan p.blob --model-rs model.rs --words 5 --steps 8 --rows 12");
    let constants = std::fs::read_to_string(bench.path("model.rs")).expect("text");
    assert!(constants.contains("pub const WORDS: usize = 5;\n") && constants.contains("pub const STEPS: u16 = 8;\n"));
    assert!(constants.contains("pub const ROWS: usize = 12;\n"));
    for options in ["--steps 0", "--steps 1001", "--words -1", "--guidance strong", "--rows 3", "--rows 25"] {
        bench.misused(&format!("plan p.blob {options}"), "error");
    }
}

#[test]
fn generate_is_the_reference_in_integers() {
    let bench = Bench::new();
    let tokenizer = motionette_host::checkpoint::load(&bench.path("t.safetensors")).expect("a tokenizer");
    for (name, options) in [("p", ""), ("post", ""), ("p", "--planner-bits 4"), ("m", "")] {
        bench.succeeds(&format!(
            "convert t.safetensors --prior {name}.prior.safetensors --bank bank.txt {options} -o {name}.blob"
        ));
        let source = prior::load(&bench.path(&format!("{name}.prior.safetensors"))).expect("a prior");
        let blob = BlobFile::open(&bench.path(&format!("{name}.blob"))).expect("a blob");
        // The same weights, so that little but int16 activations is left to differ.
        let reference = Prior::<f32>::new(&blob.dequantised_prior(&source).expect("checked"), &tokenizer);
        let words = reference.text.read("A tired person walks, waving.").expect("words");
        assert_eq!(words.ids, [2, 8, 3, 4, 1]);
        let steps = usize::from(blob.model().expect("checked").default_planning().steps);
        assert_eq!(steps, if name == "m" { 10 } else { 5 });
        let plain = Settings { steps, ..Settings::default() };
        let (mut same, mut all) = (0, 0);
        for (options, guidance, settings) in [
            ("", 2.0, plain.clone()),
            ("--guidance 1 --steps 5", 1.0, Settings { steps: 5, ..plain.clone() }),
            ("--schedule cosine --steps 6", 2.0, Settings { steps: 6, schedule: Schedule::Cosine, ..plain.clone() }),
            ("--sampling greedy", 2.0, Settings { sampling: Sampling::Greedy, ..plain.clone() }),
            (
                "--sampling gumbel --temperature 0.7",
                2.0,
                Settings { sampling: Sampling::Gumbel { temperature: 0.7 }, ..plain.clone() },
            ),
            (
                "--temperature 1.3 --top-k 4 --top-p 0.9",
                2.0,
                Settings { sampling: Sampling::Sample { temperature: 1.3, top_k: 4, top_p: 0.9 }, ..plain.clone() },
            ),
        ] {
            for seed in [1, 2] {
                let head = ["generate", "--text", "A tired person walks, waving.", "--seconds", "5", "-o", "m.bvh"];
                let file = format!("{name}.blob");
                let tail = format!("--blob {file} --seed {seed} {options}");
                let arguments: Vec<&str> = head.into_iter().chain(tail.split_whitespace()).collect();
                let made = bench.makes(&arguments);
                assert_eq!((made["frames"].as_u64(), made["words"].as_u64()), (Some(100), Some(5)));
                assert_eq!(list(&made["unknown"]), ["waving"]);
                let tokens: Vec<u64> =
                    made["tokens"].as_array().expect("tokens").iter().map(|t| t.as_u64().expect("a token")).collect();
                let settings = Settings { seed, ..settings.clone() };
                let own = reference.generate(&words.ids, guidance, 25, &settings);
                assert_eq!(own.len(), tokens.len());
                all += own.len();
                same += own.iter().zip(&tokens).filter(|(a, b)| u64::from(**a) == **b).count();
                let again = bench.makes(&arguments);
                assert_eq!(made, again, "a replay");
            }
        }
        // Rounding may tip single draws over; other draws or another order of them would leave one in six.
        assert!(same > 4 * all / 5, "{name}: {same} of {all}");
    }
    assert!(std::fs::read_to_string(bench.path("m.bvh")).expect("a motion").contains("Frames: 100"));
}

/// A prior of masked tokens is converted, shown and compared as any other; of its process it needs no constants.
#[test]
fn masked_tokens() {
    let bench = Bench::new();
    bench.dataset();
    bench.succeeds("convert t.safetensors --prior m.prior.safetensors --bank bank.txt -o m.blob");
    bench.convert();
    let seen = bench.succeeds("inspect m.blob --checkpoint t.safetensors --prior m.prior.safetensors");
    assert_eq!((seen["version"].as_str(), seen["generator"].as_str()), (Some("4.3"), Some("masked")));
    assert_eq!(list(&seen["features"]), ["vq", "masked", "text"]);
    let planner = seen["prior"]["planner"].as_str().expect("a planner");
    assert!(planner.ends_with(", masked") && seen["prior"]["guidance"] == "two passes", "{seen}");
    let row = seen["prior"]["layers"].as_array().expect("layers").iter().find(|l| l["name"] == "planner.mask");
    assert!(row.expect("the row of a masked token")["weight_error"].as_f64().is_some_and(|e| e > 0.0 && e < 0.02));
    let plan = bench.succeeds("plan m.blob --tokens 20 --anchors 0");
    assert_eq!(plan["planning"]["steps"].as_u64(), Some(10));

    let line = "verify m.blob --checkpoint t.safetensors --prior m.prior.safetensors --dataset d.mds --solver 0";
    let said = report(&bench.run(&line.split_whitespace().collect::<Vec<_>>()));
    for kind in ["runtime", "weights"] {
        let top1 = said["planner"][kind]["top1"].as_f64().expect("a share");
        assert!((0.85..=1.0).contains(&top1), "{kind}: {top1}");
    }
    for (blob, prior) in [("m", "p"), ("p", "m")] {
        let line = format!(
            "verify {blob}.blob --checkpoint t.safetensors --prior {prior}.prior.safetensors --dataset d.mds --solver 0"
        );
        bench.fails(&line.split_whitespace().collect::<Vec<_>>(), &["whether tokens are masked"]);
    }

    let near = checkpoints::masked_config().replace(r#""corruption": "masks""#, r#""corruption": "near""#);
    let kind = prior::PriorConfig::from_json(&near).expect_err("near codes without constants");
    assert!(kind.to_string().contains('c'), "{kind}");
    let config = prior::PriorConfig::from_json(&checkpoints::masked_config()).expect("a good configuration");
    assert_eq!(config.corruption, prior::Corruption::Masks);
    checkpoints::names_every_damaged_tensor(&checkpoints::masked(3), |map| {
        prior::PriorCheckpoint::build(map, config.clone()).expect_err("a damaged checkpoint")
    });
}

#[test]
fn prompts_by_name_lengths_and_anchors() {
    let bench = Bench::new();
    bench.convert();
    bench.succeeds("convert t.safetensors --prior p.prior.safetensors --bank bank.txt --no-text-encoder -o bank.blob");
    let made = bench.succeeds("generate --blob bank.blob --prompt wave --seconds 2 --seed 3 -o m.bvh");
    assert_eq!((made["frames"].as_u64(), made["unknown_words"].as_u64()), (Some(40), Some(0)));
    // The text's own length is the reference's.
    let source = prior::load(&bench.path("p.prior.safetensors")).expect("a prior");
    let reference = Prior::<f32>::with_codebook(&source, &checkpoints::tokenizer_checkpoint().codebooks[0]);
    let length = reference.length(&[3, 4]) as u64;
    let made = bench.makes(&["generate", "--blob", "p.blob", "--text", "person walk", "-o", "m.bvh"]);
    assert_eq!(made["frames"].as_u64(), Some(4 * length));
    // To the next whole token.
    let made =
        bench.makes(&["generate", "--blob", "p.blob", "--text", "person walk", "--seconds", "1.01", "-o", "m.bvh"]);
    assert_eq!(made["frames"].as_u64(), Some(24));
    bench.write("anchors.json", br#"{"anchors": [{"frame": 10, "planar_root": [0.1, 0.2]}]}"#);
    let line = [
        "generate",
        "--blob",
        "p.blob",
        "--text",
        "person",
        "--seconds",
        "1",
        "--anchors",
        "anchors.json",
        "-o",
        "m.bvh",
    ];
    let made = bench.makes(&line);
    assert!(made["control_error_m"].as_f64().is_some_and(f64::is_finite));
    bench.write("late.json", br#"{"anchors": [{"frame": 20, "planar_root": [0.1, 0.2]}]}"#);
    let late =
        ["generate", "--blob", "p.blob", "--text", "person", "--seconds", "1", "--anchors", "late.json", "-o", "x"];
    bench.fails(&late, &["anchors", "20"]);
}

/// Its BVH file has rigid bones: what that costs is said as `export` says it.
#[test]
fn generate_says_what_rigid_bones_cost() {
    let bench = Bench::new();
    bench.convert();
    let asked = ["--blob", "p.blob", "--text", "person walk", "--seed", "3", "-o", "m.bvh"];
    let [generated, exported] = ["generate", "export"].map(|command| {
        let output = bench.run(&[&[command][..], &asked].concat());
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        let said =
            text.lines().find(|line| line.starts_with("rigid bones leave the motion's joints by")).map(str::to_owned);
        (said.unwrap_or_else(|| panic!("{command}: {text}")), report(&output))
    });
    assert_eq!(generated.0, exported.0);
    for key in ["rigid_mean_cm", "rigid_largest_cm"] {
        let [a, b] = [&generated, &exported].map(|made| made.1[key].as_f64().expect(key));
        assert!(a > 0.0 && a == b, "{key}: {a} and {b}");
    }
}

#[test]
fn verify_compares_the_planners() {
    let bench = Bench::new();
    bench.convert();
    bench.dataset();
    let line = "verify p.blob --checkpoint t.safetensors --prior p.prior.safetensors --dataset d.mds --solver 0";
    let output = bench.run(&line.split_whitespace().collect::<Vec<_>>());
    // The random decoder may miss its budgets; the planners are compared all the same.
    let said = report(&output);
    let planner = &said["planner"];
    assert_eq!((planner["runtime"]["clips"].as_u64(), planner["runtime"]["positions"].as_u64()), (Some(2), Some(90)));
    for kind in ["runtime", "weights"] {
        let top1 = planner[kind]["top1"].as_f64().expect("a share");
        assert!((0.85..=1.0).contains(&top1), "{kind}: {top1}");
        assert!(
            planner[kind]["times"][1]["divergence"].as_f64().is_some_and(|d| (0.0..0.05).contains(&d)),
            "{planner}"
        );
    }
    bench.fails(
        &"verify p.blob --checkpoint t.safetensors --prior post.prior.safetensors --dataset t.safetensors"
            .split(' ')
            .collect::<Vec<_>>(),
        &["t.safetensors"],
    );
}

#[test]
fn bad_input_is_named() {
    let bench = Bench::new();
    bench.convert();
    bench.succeeds("convert t.safetensors -o mute.blob");
    bench.succeeds("convert t.safetensors --prior p.prior.safetensors --bank bank.txt --no-text-encoder -o bank.blob");
    let good = std::fs::read(bench.path("p.prior.safetensors")).expect("a prior");
    bench.write("cut.prior.safetensors", &good[..good.len() / 2]);
    let other = prior_config("pre", "gelu").replace("\"tokenizer\": \"", "\"tokenizer\": \"00");
    let other = checkpoints::bytes(&checkpoints::prior(5), prior_metadata(&other));
    bench.write("other.prior.safetensors", &other);
    bench.write("tab.txt", b"wave a person waves\n");
    bench.write("unknown.txt", b"wave\ta person\nfly\tzebras flying\n");
    bench.write("long.txt", format!("long\t{}\n", "person ".repeat(8)).as_bytes());
    bench.write("empty.txt", b"# nothing\n");
    bench.write("twice.txt", b"wave\ta person\nwave\ta person waves\n");

    let convert = |rest: &str, words: &[&str]| {
        let line = format!("convert t.safetensors {rest} -o x");
        bench.fails(&line.split_whitespace().collect::<Vec<_>>(), words);
    };
    convert("--prior missing.safetensors", &["missing.safetensors", "No such file"]);
    convert("--prior cut.prior.safetensors", &["cut.prior.safetensors", "cut short"]);
    convert("--prior t.safetensors", &["t.safetensors", "motionette-tokenizer", "motionette-prior"]);
    convert("--prior other.prior.safetensors", &["another tokenizer"]);
    convert("--prior p.prior.safetensors --bank missing.txt", &["missing.txt", "No such file"]);
    convert("--prior p.prior.safetensors --bank tab.txt", &["tab.txt", "line 1", "no tab"]);
    convert("--prior p.prior.safetensors --bank unknown.txt", &["line 2", "fly", "none of the prompt's 2 words"]);
    convert("--prior p.prior.safetensors --bank long.txt", &["line 1", "8 words", "at most 7"]);
    convert("--prior p.prior.safetensors --bank empty.txt", &["empty.txt", "no prompt"]);
    convert("--prior p.prior.safetensors --bank twice.txt", &["line 2", "line 1"]);
    convert("--prior p.prior.safetensors --bank t.safetensors", &["t.safetensors"]);
    bench.misused("convert t.safetensors --bank bank.txt -o x", "--prior");
    bench.misused("convert t.safetensors --prior p.prior.safetensors --no-text-encoder -o x", "--bank");

    let generate = |blob: &str, rest: &[&str], words: &[&str]| {
        bench.fails(&[&["generate", "--blob", blob, "-o", "x"], rest].concat(), words);
    };
    let long = "a".repeat(10_000);
    let many = "person ".repeat(100);
    for (text, words) in [
        ("", &["no words"][..]),
        (" ,.!", &["no words"]),
        ("zebra unicorn", &["none of the prompt's 2 words", "inspect"]),
        (&long, &["10000 bytes"]),
        (&many, &["100 words", "7"]),
    ] {
        generate("p.blob", &["--text", text], words);
    }
    generate("p.blob", &["--prompt", "dance"], &["stored prompts", "wave, fly"]);
    generate("bank.blob", &["--text", "a person"], &["no text encoder", "--prompt", "wave"]);
    generate("mute.blob", &["--text", "a person"], &["no planner", "--prior"]);
    generate("t.safetensors", &["--text", "a person"], &["t.safetensors", "no motionette blob"]);
    for seconds in ["0", "-1", "9.81", "NaN", "inf", "1e30"] {
        generate("p.blob", &["--text", "person", &format!("--seconds={seconds}")], &["9.8 s"]);
    }
    for (option, words) in [
        ("--guidance=NaN", "guidance must be"),
        ("--guidance=-0.5", "guidance must be"),
        ("--guidance=inf", "guidance must be"),
        ("--steps=0", "0 steps"),
        ("--steps=1001", "1001 steps"),
        ("--temperature=0", "temperature must be"),
        ("--temperature=NaN", "temperature must be"),
        ("--top-p=0", "top-p must be"),
        ("--top-p=1.5", "top-p must be"),
    ] {
        generate("p.blob", &["--text", "person", option], &[words]);
    }
    generate("p.blob", &["--text", "person", "--anchors", "bank.txt"], &["reading the anchors"]);
    bench.misused("generate --blob p.blob -o x", "--text");
    bench.misused("generate --blob p.blob --text person --prompt wave -o x", "--prompt");
    bench.misused("generate --blob p.blob --text person --steps 70000 -o x", "70000");
    bench.misused("generate --blob p.blob --text person --sampling random -o x", "random");
    bench.misused("generate --blob p.blob --text person", "--output");
}

#[cfg(unix)]
#[test]
fn text_that_is_no_utf8_is_refused() {
    use std::os::unix::ffi::OsStrExt;
    let bench = Bench::new();
    bench.convert();
    let text = std::ffi::OsStr::from_bytes(b"a person \xff waves");
    let output = Command::new(env!("CARGO_BIN_EXE_motionette"))
        .args(["generate", "--blob", "p.blob", "-o", "x", "--text"])
        .arg(text)
        .current_dir(bench.folder.path())
        .output()
        .expect("the program starts");
    assert_eq!(output.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&output.stderr).contains("UTF-8"));
    bench.write("bytes.txt", b"wave\ta person \xff waves\n");
    let line = "convert t.safetensors --prior p.prior.safetensors --bank bytes.txt -o x";
    bench.fails(&line.split(' ').collect::<Vec<_>>(), &["bytes.txt"]);
}
