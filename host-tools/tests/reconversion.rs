//! The shipped checkpoints, converted again, give the shipped blob: every rounding decision of import, calibration and quantisation, bit
//! by bit. It rests on `../shared/mocap` and `../shared/mocap2` and says so where they are absent.
//!
//! What it cannot see: whether the blob is a good one (the cross test `agreement` does).

mod common;

use std::path::{Path, PathBuf};

use motionette_host::blob::{AlignedBlob, BlobFile};
use motionette_host::checkpoint::{self, control, file_hash, prior};
use motionette_host::convert::{self, CardText, FourBits, Options, PriorSource, bank, calibration};
use motionette_host::dataset::{Dataset, Split, captioned};
use motionette_host::import::{actions::Actions, packs};
use motionette_host::reference::Prior;
use sha2::{Digest as _, Sha256};

/// Hash of the dataset that `motionette import pack` makes of both packs.
const PACKS: &str = "fc7227d503dc84bfbfb62351e7eb742aaed3ec4606d034d7c6cae8b0e2103d84";
/// Frames that `motionette import` asks of a clip.
const SHORTEST: usize = 8;
/// What the card says the weights were made from.
const DATA: &str = "Bandai-Namco Research motions, CMU, ACCAD, HDM05, Berkeley MHAD, ASE, Kinder-Gator, UTD-MHAD; words from all-MiniLM-L6-v2";

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

/// What the command in models/README.md writes, of that name, with words of so many tiers and such bits in the planner's blocks.
fn converted(dataset: &Dataset, name: &str, tier: u8, four_bits: FourBits) -> AlignedBlob {
    let paths = ["nano.safetensors", "nano.prior.safetensors", "nano.control.safetensors"].map(model);
    let [tokenizer, planner, anchors] = &paths;
    let tokenizer = checkpoint::load(tokenizer).expect("a tokenizer");
    let planner = prior::load(planner).expect("a prior");
    let tiers = planner.config.word_tiers.clone();
    let planner = planner.with_words(|row, _| tiers[row] <= tier);
    let control = control::load(anchors).expect("a control");
    let prompts = bank::read(&model("bank.txt")).expect("prompts");
    let bank = bank::encode(&planner, &prompts, false).expect("prompts of the vocabulary");
    let latents = calibration::from_dataset(&tokenizer, dataset).expect("train clips");
    let options = Options { four_bits, ..Options::default() };
    let cases = if options.calibrates_planner() {
        let reference = Prior::<f32>::new(&planner, &tokenizer);
        captioned::choose(&tokenizer, &reference, dataset, Split::Train, calibration::CASES, false).expect("captions")
    } else {
        Vec::new()
    };
    let source =
        PriorSource { checkpoint: &planner, bank: &bank, text_encoder: true, control: Some(&control), cases: &cases };
    let card = CardText {
        name: name.into(),
        licence: "CC BY-NC 4.0".into(),
        data: DATA.into(),
        checkpoint: paths.map(|path| file_hash(&path).expect("readable")).join("+"),
    };
    convert::convert_with_prior(&tokenizer, Some(source), &options, &latents, &card, |_| ()).expect("a blob").blob
}

#[test]
fn the_shipped_checkpoints_give_the_shipped_blobs() {
    let (Some(first), Some(second)) = (common::shared("mocap"), common::shared("mocap2")) else { return };
    let actions = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/actions.toml");
    let actions = Actions::read(actions).expect("the table of actions");
    let request = packs::Request { folders: vec![first, second], actions, withdraw: Vec::new(), shortest: SHORTEST };
    let dataset = packs::import(&request, &|_, _| ()).expect("the packs").dataset;
    assert_eq!(dataset.hash, PACKS, "the features of the packs");
    let queries = FourBits::NONE.with("cross.q").expect("a layer of the planner");
    for (name, tier, bits) in [("nano", 1, queries), ("nano-pico2", 1, FourBits::ALL)] {
        let made = converted(&dataset, name, tier, bits);
        let shipped = std::fs::read(model(&format!("{name}.blob"))).expect("the shipped blob");
        assert_eq!(weights(made.bytes()), weights(&shipped), "the weight section of {name}");
        assert!(made.bytes() == shipped, "{name}: header, manifest or table differ, the weights do not");
    }
}
