//! The shipped checkpoints, converted again, give the shipped blob: every rounding decision of import, calibration and quantisation, bit
//! by bit. It rests on `../shared/mocap` and says so where that is absent.
//!
//! What it cannot see: whether the blob is a good one (the cross test `agreement` does).

mod common;

use std::path::{Path, PathBuf};

use motionette_host::blob::{AlignedBlob, BlobFile};
use motionette_host::checkpoint::{self, control, file_hash, prior};
use motionette_host::convert::{self, CardText, Options, PriorSource, bank, calibration};
use motionette_host::dataset::{Dataset, Split, captioned};
use motionette_host::import::pack;
use motionette_host::motion::features;
use motionette_host::reference::Prior;
use sha2::{Digest as _, Sha256};

/// Hash of the dataset that `motionette import pack` makes of the motion-capture pack.
const PACK: &str = "eb00db8877d2fae06d87ec8d09ed520248b1724116bee5d14d9b3800f65daf83";
/// SHA-256 of the weight section of the same checkpoints with `--planner-bits 4`; no such blob is shipped.
const FOUR_BIT_WEIGHTS: &str = "dd6375eaf928d972d3808035f1e499196d801e1228afffdb3611fa879be8580c";
/// Frames that `motionette import` asks of a clip.
const SHORTEST: usize = 8;

fn model(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../models").join(name)
}

/// SHA-256 of the weight section.
fn weights(blob: &[u8]) -> String {
    let blob = BlobFile::new(AlignedBlob::new(blob), Path::new("nano.blob")).expect("a blob");
    let header = blob.parts().expect("a blob").header;
    let section = &blob.bytes()[header.weights_offset as usize..header.total_len as usize];
    Sha256::digest(section).iter().map(|b| format!("{b:02x}")).collect()
}

/// What the command in models/README.md writes, with so many bits in the planner's blocks.
fn converted(dataset: &Dataset, planner_bits: u8) -> AlignedBlob {
    let paths = ["nano.safetensors", "nano.prior.safetensors", "nano.control.safetensors"].map(model);
    let [tokenizer, planner, anchors] = &paths;
    let tokenizer = checkpoint::load(tokenizer).expect("a tokenizer");
    let planner = prior::load(planner).expect("a prior");
    let control = control::load(anchors).expect("a control");
    let prompts = bank::read(&model("bank.txt")).expect("prompts");
    let bank = bank::encode(&planner, &prompts, false).expect("prompts of the vocabulary");
    let latents = calibration::from_dataset(&tokenizer, dataset).expect("train clips");
    let options = Options { planner_bits, ..Options::default() };
    let cases = if options.calibrates_planner() {
        let reference = Prior::<f32>::new(&planner, &tokenizer);
        captioned::choose(&tokenizer, &reference, dataset, Split::Train, calibration::CASES, false).expect("captions")
    } else {
        Vec::new()
    };
    let source =
        PriorSource { checkpoint: &planner, bank: &bank, text_encoder: true, control: Some(&control), cases: &cases };
    let card = CardText {
        name: "nano".into(),
        licence: "CC BY-NC 4.0".into(),
        data: "Bandai-Namco Research motions, CMU mocap".into(),
        checkpoint: paths.map(|path| file_hash(&path).expect("readable")).join("+"),
    };
    convert::convert_with_prior(&tokenizer, Some(source), &options, &latents, &card, |_| ()).expect("a blob").blob
}

#[test]
fn the_shipped_checkpoints_give_the_shipped_blob() {
    let Some(folder) = common::shared("mocap") else { return };
    let (dataset, _) = pack::import(&folder, SHORTEST, &features::Options::default(), &|_, _| ()).expect("the pack");
    assert_eq!(dataset.hash, PACK, "the features of the pack");

    let made = converted(&dataset, 8);
    let shipped = std::fs::read(model("nano.blob")).expect("the shipped blob");
    assert_eq!(weights(made.bytes()), weights(&shipped), "the weight section");
    assert!(made.bytes() == shipped, "header, manifest or table differ, the weights do not");

    assert_eq!(weights(converted(&dataset, 4).bytes()), FOUR_BIT_WEIGHTS, "the weight section in 4 bits");
}
