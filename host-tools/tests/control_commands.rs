//! `convert --control`, `inspect`, `plan`, `verify --control` and `generate --anchors`: a planner that sees anchors, and what goes wrong on
//! the way.

mod common;

use common::bench::{Bench, list, report};
use common::checkpoints::{self, control_config, control_metadata};
use motionette_host::blob::BlobFile;
use motionette_host::checkpoint::{control, prior};
use motionette_host::reference::tmd::Settings;
use motionette_host::reference::{Anchor, Prior, Target};
use serde_json::Value;

const ALL: &str = r#"["root3d", "planar", "body"]"#;
const ANCHORS: &str = r#"{"anchors": [
    {"frame": 10, "root": [0.5, 1.0, 0.25]},
    {"frame": 50, "planar_root": [1.0, 2.0]},
    {"frame": 50, "joint": "left_wrist", "position": [1.25, 1.5, 2.0]},
    {"frame": 99, "joint": "head", "position": [0.5, 1.5, 3.0]}
]}"#;

/// The anchors of [`ANCHORS`].
fn anchors() -> [Anchor; 4] {
    [
        Anchor { frame: 10, target: Target::Root([0.5, 1.0, 0.25]) },
        Anchor { frame: 50, target: Target::PlanarRoot([1.0, 2.0]) },
        Anchor { frame: 50, target: Target::Joint { joint: 20, position: [1.25, 1.5, 2.0] } },
        Anchor { frame: 99, target: Target::Joint { joint: 15, position: [0.5, 1.5, 3.0] } },
    ]
}

/// The folder with two controls: `c` sees everything and speaks to the planner's rows, `body` sees body points and has no dual context.
fn bench() -> Bench {
    let bench = Bench::new();
    for (name, context, families) in [("c", true, ALL), ("body", false, r#"["body"]"#)] {
        let config = control_config(5, "pre", "gelu", context, families);
        let bytes = checkpoints::bytes(&checkpoints::control(6, context), control_metadata(&config));
        bench.write(&format!("{name}.control.safetensors"), &bytes);
        bench.succeeds(&convert(name));
    }
    bench.convert();
    bench.write("anchors.json", ANCHORS.as_bytes());
    bench
}

/// The line that makes `{name}.blob` with a control of this name.
fn convert(name: &str) -> String {
    format!("convert t.safetensors --prior p.prior.safetensors --control {name}.control.safetensors -o {name}.blob")
}

fn number(value: &Value) -> u64 {
    value.as_u64().unwrap_or_else(|| panic!("{value} is no number"))
}

/// Reference with the weights of a blob.
fn reference(bench: &Bench, name: &str) -> Prior<f32> {
    let tokenizer = motionette_host::checkpoint::load(&bench.path("t.safetensors")).expect("a tokenizer");
    let blob = BlobFile::open(&bench.path(&format!("{name}.blob"))).expect("a blob");
    let base = prior::load(&bench.path("p.prior.safetensors")).expect("a prior");
    let control = control::load(&bench.path(&format!("{name}.control.safetensors"))).expect("a control");
    let base = Prior::new(&blob.dequantised_prior(&base).expect("checked"), &tokenizer);
    base.controlled(&blob.dequantised_control(&control).expect("checked"), 20.0)
}

#[test]
fn a_blob_holds_what_the_control_holds() {
    let bench = bench();
    for (name, context, families) in [("c", true, &["root3d", "planar", "body"][..]), ("body", false, &["body"])] {
        let made = bench.succeeds(&convert(name).replace("-o ", "-o again."));
        assert_eq!(list(&made["control"]), families);
        assert_eq!(made["checkpoint"].as_str().map(|c| c.split('+').count()), Some(3));
        let bytes = |name: String| std::fs::read(bench.path(&name)).expect("a blob");
        assert!(bytes(format!("{name}.blob")) == bytes(format!("again.{name}.blob")), "not deterministic");

        let seen = bench.succeeds(&format!("inspect {name}.blob --control {name}.control.safetensors"));
        let info = &seen["control"];
        assert_eq!(
            (list(&info["families"]), info["context"].as_bool()),
            (families.iter().map(|f| (*f).to_owned()).collect(), Some(context))
        );
        assert_eq!((number(&info["frame_width"]), number(&info["rank"])), (5, 3));
        assert_eq!(info["layers"].as_array().map(Vec::len), Some(3 + 2 * 4 + 2 * 2 + if context { 3 } else { 0 }));
        for layer in info["layers"].as_array().expect("layers") {
            let error = layer["weight_error"].as_f64().expect("with the control");
            assert!(error > 0.0 && error < 0.02, "{layer}");
            assert_eq!(number(&layer["macs"]) == 0, layer["name"] == "control.position", "{layer}");
        }
        assert!(
            seen["prior"]["layers"]
                .as_array()
                .expect("layers")
                .iter()
                .all(|l| !l["name"].to_string().contains("control"))
        );

        // Every number of the checkpoint comes back, to half a step of its row; statistics and norms as they are.
        let blob = BlobFile::open(&bench.path(&format!("{name}.blob"))).expect("a blob");
        let source = control::load(&bench.path(&format!("{name}.control.safetensors"))).expect("a control");
        let back = blob.dequantised_control(&source).expect("checked");
        assert!(back != source);
        let largest = |w: &[f32]| w.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
        let close = |a: &[f32], b: &[f32], width: usize| {
            a.chunks(width).zip(b.chunks(width)).all(|(a, b)| {
                let step = largest(a) / 127.0;
                a.iter().zip(b).all(|(a, b)| (a - b).abs() <= 0.501 * step)
            })
        };
        for (a, b) in source.parts().into_iter().zip(back.parts()) {
            match (a, b) {
                (prior::Part::Linear(a), prior::Part::Linear(b)) => {
                    assert!(a.bias == b.bias && close(&a.weight, &b.weight, a.inputs), "{}", a.name);
                }
                (prior::Part::Embedding(a), prior::Part::Embedding(b)) => {
                    assert!(close(&a.weight, &b.weight, a.width), "{}", a.name);
                }
                (prior::Part::Norm(a), prior::Part::Norm(b)) => assert_eq!(a, b),
                _ => panic!("other parts"),
            }
        }
        let table = blob.table().expect("checked");
        let values = |name: &str| -> Vec<f32> {
            let tensor = table.iter().find(|t| t.name == name).expect(name);
            tensor.values.iter().map(|&v| v as f32).collect()
        };
        assert_eq!((values("control.mean"), values("control.std")), (source.statistics.mean, source.statistics.std));
        assert_eq!(values("control.norm.weight"), source.norm.weight);
    }
    assert_eq!(bench.succeeds("inspect p.blob")["control"], Value::Null);
}

#[test]
fn plan_counts_what_anchors_cost_the_planner() {
    let bench = bench();
    let plan = |line: &str| bench.succeeds(&format!("plan {line}"));
    let sum = |shares: &Value| -> u64 { shares.as_array().expect("shares").iter().map(|s| number(&s["amount"])).sum() };
    let (with, without) = (plan("c.blob --anchors 3"), plan("c.blob --anchors 3 --unconditioned"));
    for report in [&with, &without] {
        assert_eq!(sum(&report["arena"]), number(&report["arena_bytes"]));
        assert_eq!(sum(&report["flash"]), number(&report["flash_bytes"]));
    }
    let share = |report: &Value| {
        let shares = report["flash"].as_array().expect("shares");
        shares.iter().find(|s| s["name"] == "anchor control").map(|s| number(&s["amount"]))
    };
    assert!(share(&with) > share(&plan("body.blob")) && share(&plan("p.blob")).is_none());
    let planning = |report: &Value, figure: &str| number(&report["planning"][figure]);
    for figure in ["bytes", "macs"] {
        assert!(planning(&with, figure) > planning(&without, figure), "{figure}");
        let other = plan("p.blob --anchors 3");
        assert_eq!(planning(&other, figure), planning(&without, figure), "{figure}");
        assert_eq!(planning(&plan("c.blob --anchors 0"), figure), planning(&without, figure), "{figure}");
    }
    assert_eq!(number(&with["macs"]) - planning(&with, "macs"), number(&without["macs"]) - planning(&without, "macs"));
    for (report, expected) in [(&with, true), (&without, false), (&plan("p.blob"), false)] {
        assert_eq!(report["planning"]["conditioned"].as_bool(), Some(expected));
    }
    bench.succeeds("plan c.blob --model-rs model.rs");
    let constants = std::fs::read_to_string(bench.path("model.rs")).expect("text");
    assert!(constants.contains("pub const CONDITIONED: bool = true;\n"), "{constants}");
}

#[test]
fn generate_is_the_reference_in_integers_and_says_what_it_did_not_see() {
    let bench = bench();
    let make = |line: &str| {
        let rest = "--text person --seconds 5 -o m.bvh";
        bench.succeeds(&format!("generate --blob {line} {rest}"))
    };
    let tokens = |made: &Value| -> Vec<u64> { made["tokens"].as_array().expect("tokens").iter().map(number).collect() };
    for name in ["c", "body"] {
        let reference = reference(&bench, name);
        let words = reference.text.read("person").expect("words").ids;
        let (mut same, mut all, mut moved) = (0, 0, 0);
        for (guidance, seed) in [(1.0_f32, 1_u64), (1.0, 2), (2.0, 3), (2.0, 4)] {
            let options = format!("{name}.blob --guidance {guidance} --seed {seed}");
            let made = make(&format!("{options} --anchors anchors.json"));
            assert_eq!(number(&made["frames"]), 100);
            assert_eq!(made, make(&format!("{options} --anchors anchors.json")), "a replay");
            let settings = Settings { seed, ..Settings::default() };
            let guided = reference.through(reference.guided(&words, guidance), &anchors(), 25);
            let own = reference.sample(&guided, 25, &settings).pop().expect("steps");
            same += own.iter().zip(tokens(&made)).filter(|(a, b)| u64::from(**a) == *b).count();
            all += own.len();
            // Turned off, tokens are those of the text alone, whatever the blob.
            let blind = make(&format!("{options} --anchors anchors.json --unconditioned"));
            let plain = make(&options);
            assert_eq!(tokens(&blind), tokens(&plain));
            assert_eq!(tokens(&blind), tokens(&make(&options.replacen(name, "p", 1))));
            moved += tokens(&plain).iter().zip(tokens(&made)).filter(|(a, b)| *a != b).count();
            assert_eq!((number(&plain["unconditioned_anchors"]), &plain["unconditioned_because"]), (0, &Value::Null));
            assert_eq!(number(&blind["unconditioned_anchors"]), 4);
            assert_eq!(blind["unconditioned_because"], "--unconditioned");
        }
        // Rounding may tip single draws over.
        assert!(same > 4 * all / 5, "{name}: {same} of {all}");
        assert!(moved > all / 10, "{name}: anchors moved {moved} of {all} tokens");
    }
    for (name, unseen, why) in [
        ("c", 0, None),
        ("body", 2, Some("not trained with anchors of Root-3D and Planar-root")),
        ("p", 4, Some("no anchor control; convert it with --control")),
    ] {
        let made = make(&format!("{name}.blob --anchors anchors.json"));
        assert_eq!(number(&made["unconditioned_anchors"]), unseen);
        match why {
            None => assert_eq!(made["unconditioned_because"], Value::Null),
            Some(why) => {
                assert!(made["unconditioned_because"].as_str().is_some_and(|said| said.contains(why)), "{made}");
            }
        }
    }
    bench.misused("generate --blob c.blob --text person -o x --unconditioned", "--anchors");
}

#[test]
fn a_blob_that_can_less_takes_another_s_place_with_a_warning() {
    let bench = bench();
    let made = |line: &str| {
        let output = bench.run(&line.split_whitespace().collect::<Vec<_>>());
        assert!(output.status.success(), "{line}: {}", String::from_utf8_lossy(&output.stderr));
        let text = String::from_utf8_lossy(&output.stdout).into_owned();
        (list(&report(&output)["lost"]), text)
    };
    let parts = "convert t.safetensors --prior p.prior.safetensors";
    let whole = format!("{parts} --control c.control.safetensors --bank bank.txt -o o.blob");
    let (lost, text) = made(&whole);
    assert!(lost.is_empty() && !text.contains("warning"), "{text}");
    for (line, expected) in [
        (whole.clone(), &[][..]),
        (format!("{parts} --bank bank.txt -o o.blob"), &["anchor control"]),
        (format!("{parts} --control c.control.safetensors -o o.blob"), &["the stored prompts wave, fly"]),
        (
            format!("{parts} --control body.control.safetensors --bank bank.txt --no-text-encoder -o o.blob"),
            &["a text encoder", "anchor control for Root-3D", "anchor control for Planar-root"],
        ),
        (
            "convert t.safetensors -o o.blob".to_owned(),
            &["a planner", "a text encoder", "the stored prompts wave, fly", "anchor control"],
        ),
    ] {
        let (lost, text) = made(&line);
        assert_eq!(lost, expected, "{line}");
        assert_eq!(text.contains("warning: o.blob is replaced by a blob that can do less"), !lost.is_empty(), "{text}");
        made(&whole);
    }
    bench.write("o.blob", b"no blob at all");
    assert!(made("convert t.safetensors -o o.blob").0.is_empty());
}

#[test]
fn many_equal_anchors_are_one_and_many_others_too_many() {
    let bench = bench();
    let file = |anchors: &[String]| format!("{{\"anchors\": [{}]}}", anchors.join(","));
    let one = |x: f64| format!("{{\"frame\": 20, \"joint\": \"head\", \"position\": [{x}, 1.5, 0.25]}}");
    bench.write("one.json", file(&[one(0.5)]).as_bytes());
    bench.write("equal.json", file(&vec![one(0.5); 100_000]).as_bytes());
    let make = |anchors: &str| {
        let line = format!("generate --blob c.blob --text person --anchors {anchors} -o m.bvh");
        let made = bench.succeeds(&line);
        (made["hash"].clone(), made["arena_bytes"].clone(), made["anchors"].clone(), made["seed"].clone())
    };
    assert_eq!(make("equal.json"), make("one.json"));
    assert_eq!(make("one.json").3, 1, "the demo's seed");
    let many: Vec<String> = (0..40).map(|frame| format!("{{\"frame\": {frame}, \"root\": [0, 1, 0]}}")).collect();
    bench.write("many.json", file(&many).as_bytes());
    let arguments = ["generate", "--blob", "c.blob", "--text", "person", "--anchors", "many.json", "-o", "x"];
    bench.fails(&arguments, &["checking the anchors", "40 anchors given, at most 32"]);

    bench.write("far.json", file(&[one(0.5), one(0.5).replace("20", "60").replace("0.25", "250")]).as_bytes());
    let output =
        bench.run(&["generate", "--blob", "c.blob", "--text", "person", "--anchors", "far.json", "-o", "m.bvh"]);
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success() && text.contains("warning: anchor 1 lies 230."), "{text}");
}

#[test]
fn seconds_of_anchors_are_frames_of_the_model() {
    let bench = Bench::new();
    let config = checkpoints::TOKENIZER.replace("\"fps\": 20", "\"fps\": 30");
    let mut tokenizer = checkpoints::tokenizer();
    let std = motionette_host::checkpoint::Tensor { shape: vec![263], data: vec![0.05; 263] };
    tokenizer.insert("std", std);
    let bytes = checkpoints::bytes(&tokenizer, checkpoints::tokenizer_metadata(&config));
    bench.write("thirty.safetensors", &bytes);
    bench.succeeds("convert thirty.safetensors --prior p.prior.safetensors -o thirty.blob");
    let make = |when: &str| {
        let anchors = format!("{{\"anchors\": [{{{when}, \"planar_root\": [0.1, 0.2]}}]}}");
        bench.write("when.json", anchors.as_bytes());
        ["generate", "--blob", "thirty.blob", "--text", "person", "--seconds", "1", "--anchors", "when.json", "-o"]
    };
    let hash = |when: &str| bench.makes(&[&make(when)[..], &["m.bvh"]].concat())["hash"].clone();
    assert_eq!(hash("\"time\": 0.9"), hash("\"frame\": 27"));
    assert_ne!(hash("\"time\": 0.9"), hash("\"frame\": 18"));
    bench.fails(&[&make("\"time\": 1.1")[..], &["x"]].concat(), &["frame 33 (1.10 s)", "32 frames (1.07 s)"]);
}

#[test]
fn verify_compares_the_planners_with_anchors() {
    let bench = bench();
    bench.dataset();
    for name in ["c", "body"] {
        let line = format!(
            "verify {name}.blob --checkpoint t.safetensors --prior p.prior.safetensors --control {name}.control.safetensors \
             --dataset d.mds --solver 0"
        );
        // The random decoder may miss its budgets; the planners are compared all the same.
        let said = report(&bench.run(&line.split_whitespace().collect::<Vec<_>>()));
        let (planner, control) = (&said["planner"], &said["control"]);
        assert_eq!((number(&control["runtime"]["clips"]), number(&control["runtime"]["positions"])), (2, 90));
        for kind in ["runtime", "weights"] {
            let top1 = control[kind]["top1"].as_f64().expect("a share");
            assert!((0.85..=1.0).contains(&top1), "{name} {kind}: {top1}");
            let divergence = |report: &Value| report[kind]["times"][1]["divergence"].as_f64().expect("nats");
            assert!((0.0..0.05).contains(&divergence(control)), "{control}");
            assert_ne!(divergence(control), divergence(planner), "{name} {kind}: the anchors were not seen");
        }
    }
    let without = "verify c.blob --checkpoint t.safetensors --prior p.prior.safetensors --dataset d.mds --solver 0";
    let said = report(&bench.run(&without.split_whitespace().collect::<Vec<_>>()));
    assert_eq!(said["control"], Value::Null);
}

#[test]
fn bad_input_is_named() {
    let bench = bench();
    let good = std::fs::read(bench.path("c.control.safetensors")).expect("a control");
    bench.write("cut.safetensors", &good[..good.len() / 2]);
    let config = control_config(5, "pre", "gelu", true, ALL);
    for (name, from, to) in
        [("other", "\"prior\": \"", "\"prior\": \"00"), ("tokens", "\"tokenizer\": \"", "\"tokenizer\": \"00")]
    {
        let bytes = checkpoints::bytes(&checkpoints::control(6, true), control_metadata(&config.replace(from, to)));
        bench.write(&format!("{name}.safetensors"), &bytes);
    }
    let hash = checkpoints::prior_checkpoint(5, "pre", "gelu").weights_hash();
    let verify =
        |blob: &str| format!("verify {blob} --checkpoint t.safetensors --prior p.prior.safetensors --dataset d.mds");
    for line in ["convert t.safetensors --prior p.prior.safetensors -o x".to_owned(), verify("c.blob")] {
        for (file, words) in [
            ("missing.safetensors", &["missing.safetensors", "No such file"][..]),
            ("cut.safetensors", &["cut.safetensors", "cut short"]),
            ("p.prior.safetensors", &["motionette-prior", "motionette-control"]),
            ("other.safetensors", &["another prior", &hash, &format!("00{hash}")]),
            ("tokens.safetensors", &["another tokenizer"]),
        ] {
            bench.fails(&format!("{line} --control {file}").split(' ').collect::<Vec<_>>(), words);
        }
    }
    bench.misused("convert t.safetensors --control c.control.safetensors -o x", "--prior");
    bench
        .misused("verify c.blob --checkpoint t.safetensors --dataset d.mds --control c.control.safetensors", "--prior");
    for (line, words) in [
        (format!("{} --control c.control.safetensors", verify("p.blob")), &["no anchor control", "--control"][..]),
        (format!("{} --control body.control.safetensors", verify("c.blob")), &["dual context"]),
        ("inspect p.blob --control c.control.safetensors".to_owned(), &["no anchor control"]),
        ("inspect body.blob --control c.control.safetensors".to_owned(), &["different models"]),
    ] {
        bench.fails(&line.split(' ').collect::<Vec<_>>(), words);
    }
}
