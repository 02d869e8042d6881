//! The reference against PyTorch's own outputs: MoMask's RVQ-VAE and T2M-GPT's VQ-VAE, from both containers.
//!
//! Tolerances come from `tolerances.json`: ten times the distance between PyTorch's f32 and f64 runs. Ids must match exactly.

mod common;

use std::path::Path;

use common::golden::{Golden, published, wide};
use motionette_host::checkpoint::{self, TokenizerCheckpoint};
use motionette_host::reference::recover;
use motionette_host::reference::{Decoder, Encoder, Quantizer, Tokenizer};

/// `[T][C]` to the golden files' `[C][T]`.
fn transposed(values: &[f32], channels: usize) -> Vec<f64> {
    (0..channels).flat_map(|c| values.iter().skip(c).step_by(channels).map(|&v| f64::from(v))).collect()
}

fn load(path: &Path) -> TokenizerCheckpoint {
    checkpoint::load(path).unwrap_or_else(|e| panic!("{e}"))
}

#[test]
fn both_containers_hold_the_same_tokenizer() {
    let Some(folder) = published() else { return };
    for (torch, flat) in [("rvq.tar", "rvq.safetensors"), ("t2mgpt_vq.pth", "t2mgpt_vq.safetensors")] {
        assert!(load(&folder.join(torch)) == load(&folder.join(flat)), "{torch} differs from {flat}");
    }
}

#[test]
fn momask_decoder_stages_and_joints() {
    let Some(folder) = published() else { return };
    let golden = Golden::open(&folder);
    for container in ["rvq.safetensors", "rvq.tar"] {
        let checkpoint = load(&folder.join(container));
        let tokenizer = Tokenizer::<f32>::new(&checkpoint);
        let (width, features) = (checkpoint.config.width, checkpoint.config.features);
        for length in ["L17", "L49"] {
            let ids = golden.ids(&format!("rvq_{length}_ids"));
            let latent = tokenizer.quantizer.decode(&ids).expect("published ids");
            golden.check(&format!("rvq_{length}_latent"), wide(&latent));
            let trace = tokenizer.decoder.forward(&latent);
            golden.check(&format!("rvq_{length}_decoded_norm"), wide(&trace.features));
            let motion = tokenizer.denormalise(&trace.features).expect("statistics");
            golden.check(&format!("rvq_{length}_decoded_denorm"), wide(&motion));
            let joints = recover::joints(&motion, features);
            golden.check(&format!("rvq_{length}_joints"), wide(joints.as_flattened().as_flattened()));
            // The importer's own recovery is a second opinion.
            let joints = motionette_host::motion::recover::joints(&motion).expect("whole rows");
            golden.check(&format!("rvq_{length}_joints"), wide(joints.as_flattened().as_flattened()));
            if length == "L17" {
                let relu = |x: &[f32]| -> Vec<f32> { x.iter().map(|&v| if v > 0.0 { v } else { 0.0 }).collect() };
                let stages = [
                    trace.input.clone(),
                    relu(&trace.input),
                    trace.stages[0].clone(),
                    trace.stages[1].clone(),
                    trace.hidden.clone(),
                    relu(&trace.hidden),
                ];
                for (i, stage) in stages.iter().enumerate() {
                    golden.check(&format!("rvq_L17_decoder_stage{i}"), transposed(stage, width));
                }
            }
        }
    }
}

#[test]
fn momask_encoder_and_ids() {
    let Some(folder) = published() else { return };
    let golden = Golden::open(&folder);
    for container in ["rvq.safetensors", "rvq.tar"] {
        let checkpoint = load(&folder.join(container));
        let encoder = Encoder::<f32>::new(checkpoint.encoder.as_ref().expect("an encoder"));
        let quantizer = Quantizer::<f32>::new(&checkpoint.codebooks, checkpoint.config.code_dim);
        let (shape, input) = golden.floats("rvq_encode_input");
        let latent = encoder.forward(&input[..168 * shape[1]]);
        golden.check("rvq_encode_latent_168f", wide(&latent));
        assert_eq!(quantizer.encode(&latent), golden.ids("rvq_encode_ids_168f"));
        assert_eq!(quantizer.encode(&encoder.forward(&input)), golden.ids("rvq_encode_ids_170f"));
    }
}

#[test]
fn unnormalised_motion_encodes_to_the_published_ids() {
    let Some(folder) = published() else { return };
    let golden = Golden::open(&folder);
    let checkpoint = load(&folder.join("rvq.safetensors"));
    let tokenizer = Tokenizer::<f32>::new(&checkpoint);
    let (shape, input) = golden.floats("rvq_encode_input");
    let motion = tokenizer.denormalise(&input).expect("statistics");
    let ids = tokenizer.encode(&motion).expect("finite features");
    // 170 frames: the last two are dropped, as the published scripts do.
    assert_eq!(shape[0], 170);
    assert_eq!(ids, golden.ids("rvq_encode_ids_168f"));
}

#[test]
fn t2mgpt_decoder_and_encoder() {
    let Some(folder) = published() else { return };
    let golden = Golden::open(&folder);
    for container in ["t2mgpt_vq.safetensors", "t2mgpt_vq.pth"] {
        let checkpoint = load(&folder.join(container));
        let tokenizer = Tokenizer::<f32>::new(&checkpoint);
        let features = tokenizer.decode_normalised(&golden.ids("t2mgpt_vq_L17_ids")).expect("published ids");
        golden.check("t2mgpt_vq_L17_decoded_norm", wide(&features));
        let encoder = Encoder::<f32>::new(checkpoint.encoder.as_ref().expect("an encoder"));
        let (shape, input) = golden.floats("rvq_encode_input");
        let ids = tokenizer.quantizer.encode(&encoder.forward(&input[..168 * shape[1]]));
        assert_eq!(ids, golden.ids("t2mgpt_vq_encode_ids_168f"));
    }
}

#[test]
fn f32_is_as_close_to_f64_as_pytorch() {
    let Some(folder) = published() else { return };
    let golden = Golden::open(&folder);
    let checkpoint = load(&folder.join("rvq.safetensors"));
    let ids = golden.ids("rvq_L49_ids");
    let latent = Quantizer::<f64>::new(&checkpoint.codebooks, checkpoint.config.code_dim).decode(&ids).expect("ids");
    let exact = Decoder::<f64>::new(&checkpoint.decoder, checkpoint.config.features).forward(&latent);
    golden.check("rvq_L49_decoded_norm", exact.features);
}
