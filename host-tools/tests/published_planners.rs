//! Published planners against PyTorch's own outputs: MoMask's mask and residual transformers and T2M-GPT's, from both containers.
//!
//! Tolerances come from `tolerances.json`, ids must match exactly. The uniforms of the recorded runs are part of the fixtures.

mod common;

use std::path::Path;

use common::golden::{Golden, published, wide};
use motionette_host::checkpoint::{self, ErrorKind, PublishedPlanner, published as checkpoints};
use motionette_host::reference::Tokenizer;
use motionette_host::reference::published::{Gpt, Mask, Residual};
use motionette_host::reference::published::{autoregressive, draw, masked, residual};
use motionette_host::reference::recover;
use motionette_host::reference::transformer::first_largest;

fn load(folder: &Path, name: &str) -> PublishedPlanner {
    checkpoints::load(&folder.join(name), None).unwrap_or_else(|e| panic!("{e}"))
}

fn mask(folder: &Path, name: &str) -> Mask<f32> {
    match load(folder, name) {
        PublishedPlanner::Mask(mask) => Mask::new(&mask),
        other => panic!("{name} is {other:?}"),
    }
}

fn residual_of(folder: &Path, name: &str) -> Residual<f32> {
    match load(folder, name) {
        PublishedPlanner::Residual(residual) => Residual::new(&residual),
        other => panic!("{name} is {other:?}"),
    }
}

fn gpt(folder: &Path, name: &str) -> Gpt<f32> {
    match load(folder, name) {
        PublishedPlanner::Gpt(gpt) => Gpt::new(&gpt),
        other => panic!("{name} is {other:?}"),
    }
}

fn tokens(golden: &Golden, name: &str) -> Vec<usize> {
    golden.ids(name).into_iter().map(|id| usize::try_from(id).expect("not negative")).collect()
}

fn signed(ids: &[usize]) -> Vec<i64> {
    ids.iter().map(|&id| id as i64).collect()
}

#[test]
fn both_containers_hold_the_same_planner() {
    let Some(folder) = published() else { return };
    for (torch, flat) in [
        ("mask.tar", "mask.safetensors"),
        ("res.tar", "res.safetensors"),
        ("t2mgpt_trans.pth", "t2mgpt_trans.safetensors"),
    ] {
        assert!(load(&folder, torch) == load(&folder, flat), "{torch} differs from {flat}");
    }
}

#[test]
fn mask_transformer() {
    let Some(folder) = published() else { return };
    let golden = Golden::open(&folder);
    let mask = mask(&folder, "mask.tar");
    let (ids, (_, text)) = (tokens(&golden, "mask_ids"), golden.floats("mask_cond"));
    let trace = mask.trace(&ids, Some(&text));
    golden.check("mask_hidden_input", wide(&trace.input));
    for (layer, rows) in trace.layers.iter().enumerate() {
        golden.check(&format!("mask_hidden_layer{layer}"), wide(rows));
    }
    golden.check("mask_logits_cond", wide(&mask.logits(&ids, Some(&text))));
    golden.check("mask_logits_uncond", wide(&mask.logits(&ids, None)));
    golden.check("mask_logits_cfg4", wide(&mask.guided(&ids, &text, 4.0)));
    assert_eq!(mask.text_width(), text.len());
}

#[test]
fn residual_transformer() {
    let Some(folder) = published() else { return };
    let golden = Golden::open(&folder);
    let residual = residual_of(&folder, "res.tar");
    let (ids, (_, text)) = (tokens(&golden, "res_ids"), golden.floats("mask_cond"));
    for layer in 1..residual.quantizers {
        golden.check(&format!("res_q{layer}_logits_cond"), wide(&residual.logits(&ids, layer, Some(&text))));
        golden.check(&format!("res_q{layer}_logits_uncond"), wide(&residual.logits(&ids, layer, None)));
        golden.check(&format!("res_q{layer}_logits_cfg5"), wide(&residual.guided(&ids, layer, &text, 5.0)));
    }
}

/// The recorded run: every step of the masked process, the residual layers, the joints.
#[test]
fn a_whole_motion_is_sampled() {
    let Some(folder) = published() else { return };
    let golden = Golden::open(&folder);
    let (mask, residual) = (mask(&folder, "mask.safetensors"), residual_of(&folder, "res.safetensors"));
    let (_, text) = golden.floats("mask_cond");
    let (shape, uniforms) = golden.floats("sample_uniforms");
    let [steps, length, codes] = shape[..] else { panic!("{shape:?}") };
    let settings = masked::Settings { steps, ..masked::Settings::default() };
    let uniform = |step: usize, position: usize, class: usize| uniforms[(step * length + position) * codes + class];
    let run = masked::plan((length, codes), &settings, |ids| mask.guided(ids, &text, 4.0), uniform);
    let all = |field: fn(&masked::Step<f32>) -> &Vec<usize>| -> Vec<i64> {
        run.iter().flat_map(|s| signed(field(s))).collect()
    };
    let counts: Vec<usize> = run.iter().map(|step| step.masked).collect();
    assert_eq!(signed(&counts), golden.ids("sample_num_masked"));
    assert_eq!(all(|step| &step.before), golden.ids("sample_ids_in"));
    assert_eq!(all(|step| &step.drawn), golden.ids("sample_pred_ids"));
    assert_eq!(all(|step| &step.after), golden.ids("sample_ids_out"));
    golden.check("sample_scores", run.iter().flat_map(|step| wide(&step.scores)));
    golden.check("sample_logits_cfg4", run.iter().flat_map(|step| wide(&step.logits)));

    let quantizers = residual.quantizers;
    let mut tokens = vec![0; length * quantizers];
    let base = &run.last().expect("steps").after;
    tokens.chunks_exact_mut(quantizers).zip(base).for_each(|(position, &token)| position[0] = token);
    let (_, uniforms) = golden.floats("pipeline_res_uniforms");
    let uniform =
        |layer: usize, position: usize, class: usize| uniforms[((layer - 1) * length + position) * (codes + 1) + class];
    let mut seen = Vec::new();
    let logits = |tokens: &[usize], layer: usize| {
        let logits = residual.guided(tokens, layer, &text, 5.0);
        seen.extend(wide(&logits));
        logits
    };
    residual::plan(&mut tokens, (quantizers, codes), &draw::Choice::PUBLISHED, logits, uniform);
    golden.check("pipeline_res_logits_cfg5", seen);
    let ids: Vec<i64> = tokens.iter().map(|&id| if id == codes { -1 } else { id as i64 }).collect();
    assert_eq!(ids, golden.ids("pipeline_ids"));

    let tokenizer = checkpoint::load(&folder.join("rvq.tar")).expect("the tokenizer");
    let features = tokenizer.config.features;
    let tokenizer = Tokenizer::<f32>::new(&tokenizer);
    let normalised = tokenizer.decode_normalised(&ids).expect("ids");
    let joints = recover::joints(&tokenizer.denormalise(&normalised).expect("statistics"), features);
    golden.check("pipeline_joints", wide(joints.as_flattened().as_flattened()));
}

#[test]
fn t2mgpt_transformer() {
    let Some(folder) = published() else { return };
    let golden = Golden::open(&folder);
    let gpt = gpt(&folder, "t2mgpt_trans.pth");
    let (prefix, (_, text)) = (tokens(&golden, "t2mgpt_prefix_ids"), golden.floats("t2mgpt_cond"));
    golden.check("t2mgpt_base_out", wide(&gpt.rows(&prefix, &text)[0]));
    golden.check("t2mgpt_prefix_logits", wide(&gpt.logits(&prefix, &text)));
    for run in ["stop", "full", "none"] {
        let (_, text) = golden.floats(&format!("t2mgpt_greedy_{run}_cond"));
        let behind = |ids: &[usize]| {
            let logits = gpt.logits(ids, &text);
            logits[ids.len() * (gpt.codes + 1)..].to_vec()
        };
        let ids = autoregressive::plan(gpt.places - 1, behind, first_largest);
        // A run that ends at once has no file of ids.
        let expected = if run == "none" { Vec::new() } else { golden.ids(&format!("t2mgpt_greedy_{run}_ids")) };
        assert_eq!(signed(&ids), expected, "{run}");
        golden.check(&format!("t2mgpt_greedy_{run}_logits"), wide(&gpt.logits(&ids, &text)));
    }
}

/// f64 is nearer to the recorded f32 run than ten times its rounding, and gives the same ids.
#[test]
fn f64_agrees() {
    let Some(folder) = published() else { return };
    let golden = Golden::open(&folder);
    let PublishedPlanner::Mask(checkpoint) = load(&folder, "mask.tar") else { panic!("a mask transformer") };
    let (ids, (_, text)) = (tokens(&golden, "mask_ids"), golden.floats("mask_cond"));
    let text: Vec<f64> = wide(&text).collect();
    golden.check("mask_logits_cfg4", Mask::<f64>::new(&checkpoint).guided(&ids, &text, 4.0));
}

/// Options that say something else than the tensors, and files that are something else, by name.
#[test]
fn checkpoints_that_disagree_with_their_options_are_refused() {
    let Some(folder) = published() else { return };
    let temporary = tempfile::tempdir().expect("a folder");
    let options = |name: &str, from: &str, to: &str| {
        let text = std::fs::read_to_string(folder.join(name)).expect(name);
        assert!(text.contains(from), "{from}");
        let path = temporary.path().join("options");
        std::fs::write(&path, text.replace(from, to)).expect("a file");
        path
    };
    let refused = |checkpoint: &str, options: &Path, what: &str| {
        let error = checkpoints::load(&folder.join(checkpoint), Some(options)).expect_err(what);
        let text = error.to_string();
        assert!(text.contains(what) && text.contains(checkpoint), "{text}");
        error.kind
    };
    let mask = |from: &str, to: &str, what: &str| refused("mask.tar", &options("mask_opt.txt", from, to), what);
    assert!(matches!(mask("latent_dim: 32", "latent_dim: 36", "position_enc.pe"), ErrorKind::Shape { .. }));
    assert!(matches!(mask("n_layers: 3", "n_layers: 4", "layers.3."), ErrorKind::MissingTensor { .. }));
    assert!(matches!(mask("n_layers: 3", "n_layers: 2", "n_layers"), ErrorKind::Option { .. }));
    assert!(matches!(mask("n_heads: 4", "n_heads: 5", "n_heads"), ErrorKind::Option { .. }));
    assert!(matches!(mask("n_heads: 4", "heads: 4", "n_heads"), ErrorKind::MissingOption { .. }));
    assert!(matches!(mask("ff_size: 80", "ff_size: 0", "ff_size"), ErrorKind::Option { .. }));
    let gpt =
        |from: &str, to: &str, what: &str| refused("t2mgpt_trans.pth", &options("t2mgpt_args.json", from, to), what);
    assert!(matches!(gpt("\"block_size\": 51", "\"block_size\": 50", "pos_embed"), ErrorKind::Shape { .. }));
    assert!(matches!(gpt("\"num_layers\": 2", "\"num_layers\": 1", "num_layers"), ErrorKind::Option { .. }));
    assert!(matches!(gpt("\"nb_code\": 48", "\"nb_code\": 47", "tok_emb"), ErrorKind::Shape { .. }));
    let absent = temporary.path().join("absent.txt");
    assert!(matches!(refused("res.tar", &absent, "--options"), ErrorKind::Companion { .. }));
    assert!(matches!(refused("rvq.tar", &folder.join("opt.txt"), "token_emb"), ErrorKind::MissingTensor { .. }));
}
