//! The manifest of format 4 against bytes written by hand from `FORMAT.md`: what they mean, and what becomes of kinds that came later.

use motionette::blob::{
    Activation, Card, Codec, ControlConfig, Corruption, DecoderConfig, Error, Generator, Guidance, HeadConfig,
    HumanMl3d, Manifest, Norm, Padding, PhraseBank, PlannerConfig, PrefixConfig, Representation, ResidualConfig,
    SelfTest, Skeleton, TextConfig, TextEncoderConfig, TextEncoding, TextLength, TextTable, TransformerConfig,
};

/// A manifest with everything in it.
struct Written {
    bytes: Vec<u8>,
    /// Name, place and number of kinds of each section that is of a kind.
    kinds: Vec<(&'static str, usize, u8)>,
}

impl Written {
    fn bytes(&mut self, bytes: &[u8]) -> &mut Self {
        self.bytes.extend_from_slice(bytes);
        self
    }

    fn kind(&mut self, section: &'static str, found: u8, known: u8) -> &mut Self {
        self.kinds.push((section, self.bytes.len(), known));
        self.bytes(&[found])
    }

    fn text(&mut self, text: &str) -> &mut Self {
        self.bytes(&[text.len() as u8]).bytes(text.as_bytes())
    }

    /// Width 300, 2 heads, 3 layers, hidden width 7, norms behind, ReLU, epsilon 1e-5.
    fn transformer(&mut self) -> &mut Self {
        self.bytes(&[0xAC, 0x02, 2, 3, 7]);
        self.kind("transformer.norm", 1, 2).kind("transformer.activation", 0, 2).bytes(&[0xAC, 0xC5, 0x27, 0x37])
    }

    fn new() -> Self {
        let mut all = Written { bytes: Vec::new(), kinds: Vec::new() };
        all.text("name").text("licence").text("data").text("");
        all.kind("representation", 0, 1).bytes(&[0x90, 0x03]);
        for joint in 0..22 {
            // x: the joint's number, y: 0, z: -2.
            all.bytes(&(joint as f32).to_le_bytes()).bytes(&[0, 0, 0, 0]).bytes(&[0, 0, 0, 0xC0]);
        }
        all.kind("codec", 0, 1).bytes(&[0x80, 0x01, 16, 0x80, 0x04, 1, 2]);
        all.bytes(&[2, 9, 1]).bytes(&[3, 1, 1, 9, 9, 0xAC, 0x02, 0]).bytes(&[0x87, 0x02]);
        all.kind("text", 1, 2).bytes(&[0xAC, 0x02, 32]);
        all.kind("text.encoder", 1, 3).kind("text.encoder.table", 0, 2).text("<none>\n<unknown>\nwalk").transformer();
        all.kind("text.length", 0, 2).kind("text.bank", 0, 2).text("wave\nrun");
        all.kind("generator", 1, 5).bytes(&[49]).transformer();
        // c = 3, a = 0.5
        all.bytes(&[0, 0, 0x40, 0x40]).bytes(&[0, 0, 0, 0x3F]).kind("generator.guidance", 0, 2);
        all.kind("generator.control", 1, 2).transformer().bytes(&[48, 32, 1, 7]);
        all.bytes(&[5, 24, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 0x01]).bytes(&[0x80, 0x08]);
        all
    }
}

#[test]
fn bytes_written_by_hand_mean_what_the_format_says() {
    let mut written = Written::new();
    let (length, skeleton) = (written.bytes.len(), skeleton());
    let transformer = TransformerConfig {
        width: 300,
        heads: 2,
        layers: 3,
        hidden: 7,
        norm: Norm::Post,
        activation: Activation::Relu,
        epsilon: 1e-5,
    };
    let pad = |left, right| Padding { left, right };
    let expected = Manifest {
        card: Card { name: "name", licence: "licence", data: "data", checkpoint: "" },
        representation: Representation::HumanMl3d(HumanMl3d { frame_rate: 400, skeleton: Skeleton::new(&skeleton) }),
        codec: Codec::Vq(DecoderConfig {
            width: 128,
            code_width: 16,
            codes: 512,
            quantizers: 1,
            stages: 2,
            dilations: [9, 1].into_iter().collect(),
            padding: [pad(1, 1), pad(9, 9), pad(300, 0)].into_iter().collect(),
            features: 263,
        }),
        text: Some(TextConfig {
            width: 300,
            max_words: 32,
            encoder: TextEncoding::Words(TextEncoderConfig {
                table: TextTable::Words("<none>\n<unknown>\nwalk"),
                transformer,
            }),
            length: TextLength::Head,
            bank: PhraseBank::Prompts("wave\nrun"),
        }),
        generator: Generator::Words(PlannerConfig {
            max_tokens: 49,
            transformer,
            corruption: Corruption::Near { c: 3.0, a: 0.5 },
            guidance: Guidance::TwoPass,
            control: Some(ControlConfig {
                scaffold: transformer,
                frame_width: 48,
                rank: 32,
                context: true,
                families: 7,
            }),
        }),
        self_test: SelfTest { seed: 5, tokens: 24, hash: u64::MAX },
        tensor_count: 1024,
    };
    assert_eq!(postcard::to_stdvec(&expected).as_deref(), Ok(&written.bytes[..]), "as the host tools write it");
    written.bytes.extend(b"table");
    assert_eq!(Manifest::read(&written.bytes, 0), Ok((expected.clone(), &b"table"[..])));
    let offsets = expected.representation.skeleton().offsets();
    assert_eq!((offsets.len(), offsets[0], offsets[21]), (22, [0.0, 0.0, -2.0], [21.0, 0.0, -2.0]));
    assert_eq!(expected.representation.frame_rate(), 400);
    assert_eq!((expected.codec.frames_per_token(), expected.generator.max_tokens()), (4, 49));
    for end in 0..length {
        assert_eq!(Manifest::read(&written.bytes[..end], 0), Err(Error::Manifest), "cut at {end}");
    }
}

fn skeleton() -> [u8; 264] {
    let mut bytes = [0; 264];
    for (joint, offset) in bytes.chunks_mut(12).enumerate() {
        offset[..4].copy_from_slice(&(joint as f32).to_le_bytes());
        offset[8..].copy_from_slice(&(-2.0_f32).to_le_bytes());
    }
    bytes
}

/// The kinds that came with version 4.1, in the place of the older ones.
#[test]
fn kinds_of_version_4_1_mean_what_the_format_says() {
    let written = Written::new();
    let at = |name: &str| written.kinds.iter().find(|kind| kind.0 == name).expect("a section").1;
    let bytes = &written.bytes;
    // 300 words with vectors of 64 numbers, then the transformer; stored prompts as before, three phrases, two of actions, from 0.5 on.
    let table = [1, 0xAC, 0x02, 64];
    let after_table = at("text.encoder.table") + 2 + "<none>\n<unknown>\nwalk".len();
    let bank = [&[1, 8][..], b"wave\nrun", &[8], b"go\nhop\ng", &[2, 0, 0, 0, 0x3F]].concat();
    let after_bank = at("text.bank") + 2 + "wave\nrun".len();
    let new = [
        &bytes[..at("text.encoder.table")],
        &table,
        &bytes[after_table..at("text.bank")],
        &bank,
        &bytes[after_bank..at("generator.guidance")],
        &[1],
        &bytes[at("generator.guidance") + 1..],
    ]
    .concat();
    let (manifest, rest) = Manifest::read(&new, 1).expect("a manifest of version 4.1");
    assert!(rest.is_empty());
    let text = manifest.text.expect("text");
    assert_eq!(text.encoder.words().expect("an encoder").table, TextTable::Vectors { words: 300, dims: 64 });
    let phrases = PhraseBank::Meanings { prompts: "wave\nrun", phrases: "go\nhop\ng", actions: 2, threshold: 0.5 };
    assert_eq!((text.bank, text.bank.names()), (phrases, "wave\nrun"));
    assert_eq!(manifest.generator.planner().expect("a planner").guidance, Guidance::OnePass);
    assert_eq!(postcard::to_stdvec(&manifest).as_deref(), Ok(&new[..]), "as the host tools write it");
}

/// The kinds that version 4.2 added, again by hand: prompts that are vectors, no length, planners behind a row of the text.
#[test]
fn kinds_of_version_4_2_mean_what_the_format_says() {
    let written = Written::new();
    let at = |name: &str| written.kinds.iter().find(|kind| kind.0 == name).expect("a section").1;
    // Width 300, 2 heads, 3 layers, hidden width 7, norms behind, ReLU, epsilon 1e-5.
    let stack = [0xAC, 0x02, 2, 3, 7, 1, 0, 0xAC, 0xC5, 0x27, 0x37];
    let transformer = TransformerConfig {
        width: 300,
        heads: 2,
        layers: 3,
        hidden: 7,
        norm: Norm::Post,
        activation: Activation::Relu,
        epsilon: 1e-5,
    };
    // Vectors of 512, one word, no length, two stored ones; then the planner, without a self-test.
    let text = [&[1, 0x80, 0x04, 1, 2, 1, 0, 8][..], b"wave\nrun"].concat();
    let end = [0, 0, 0, 4];
    for (kind, head, residual) in [(2, HeadConfig::Dense { epsilon: 0.5 }, true), (3, HeadConfig::Norm, false)] {
        let head_bytes: &[u8] = if residual { &[1, 0, 0, 0, 0x3F] } else { &[0] };
        // Guidance 4; of the residual planner epsilon 2, guidance 0.5.
        let tail = [&[1][..], &stack, &[0, 0, 0, 0x40], &[0, 0, 0, 0x3F]].concat();
        let tail: &[u8] = if residual { &tail } else { &[0] };
        let bytes =
            [&written.bytes[..at("text")], &text, &[kind, 49], &stack, head_bytes, &[0, 0, 0x80, 0x40], tail, &end]
                .concat();
        let (manifest, rest) = Manifest::read(&bytes, 2).expect("a manifest of version 4.2");
        assert!(rest.is_empty());
        let text = manifest.text.expect("text");
        assert_eq!((text.width, text.encoder, text.length), (512, TextEncoding::Vectors, TextLength::Unsaid));
        let residual = residual.then_some(ResidualConfig { transformer, epsilon: 2.0, guidance: 0.5 });
        let planner = PrefixConfig { max_tokens: 49, transformer, head, guidance: 4.0, residual };
        assert_eq!(
            manifest.generator,
            if kind == 2 { Generator::Masked(planner) } else { Generator::Autoregressive(planner) }
        );
        assert_eq!(postcard::to_stdvec(&manifest).as_deref(), Ok(&bytes[..]), "as the host tools write it");
    }
}

/// The kind that version 4.3 added, by hand: kind 1 without the constants of its process.
#[test]
fn the_kind_of_version_4_3_means_what_the_format_says() {
    let written = Written::new();
    let at = |name: &str| written.kinds.iter().find(|kind| kind.0 == name).expect("a section").1;
    let bytes = &written.bytes;
    let (before, constants) = (&bytes[..at("generator")], at("generator.guidance") - 8);
    let new = [before, &[4], &bytes[at("generator") + 1..constants], &bytes[constants + 8..]].concat();
    let (manifest, rest) = Manifest::read(&new, 3).expect("a manifest of version 4.3");
    assert!(rest.is_empty());
    let (near, _) = Manifest::read(bytes, 0).expect("a manifest of version 4.0");
    let planner = |manifest: &Manifest<'_>| *manifest.generator.planner().expect("a planner");
    let expected = PlannerConfig { corruption: Corruption::Masks, ..planner(&near) };
    assert_eq!(planner(&manifest), expected);
    assert_eq!((manifest.generator.control(), manifest.generator.max_tokens()), (expected.control.as_ref(), 49));
    assert_eq!(manifest.tensor_count, near.tensor_count);
    assert_eq!(postcard::to_stdvec(&manifest).as_deref(), Ok(&new[..]), "as the host tools write it");
    let needed = |manifest: &Manifest<'_>| -> Vec<&str> {
        motionette::model::cargo_features(manifest).into_iter().filter(|f| f.needed).map(|f| f.name).collect()
    };
    assert_eq!(needed(&manifest), ["vq", "masked", "anchor-control", "text"]);
    assert_eq!(needed(&near), ["vq", "tmd", "anchor-control", "text"]);
    for end in at("generator")..new.len() {
        assert_eq!(Manifest::read(&new[..end], 3), Err(Error::Manifest), "cut at {end}");
    }
}

/// What absent sections are: one byte each.
#[test]
fn sections_that_are_absent_take_a_byte() {
    let written = Written::new();
    let at = |name: &str| written.kinds.iter().find(|kind| kind.0 == name).expect("a section").1;
    // No text, tokens given with the request, at most 300 of them.
    let bare = [&written.bytes[..at("text")], &[0, 0, 0xAC, 0x02], &[1, 2, 3, 4]].concat();
    let (manifest, rest) = Manifest::read(&bare, 0).expect("a bare manifest");
    assert_eq!((manifest.text, manifest.generator), (None, Generator::Given { max_tokens: 300 }));
    assert_eq!((manifest.self_test, manifest.tensor_count), (SelfTest { seed: 1, tokens: 2, hash: 3 }, 4));
    assert!(rest.is_empty());
    // A planner without control is followed by the self-test.
    let mut unanchored = written.bytes[..at("generator.control")].to_vec();
    unanchored.extend([0, 1, 2, 3, 4]);
    let (manifest, _) = Manifest::read(&unanchored, 0).expect("no control");
    assert!(manifest.generator.planner().is_some() && manifest.generator.control().is_none());
    assert_eq!(manifest.self_test, SelfTest { seed: 1, tokens: 2, hash: 3 });
}

/// The next kind of each section, which no reader of today can know: refused by the name of the section, with the format that it needs.
#[test]
fn kinds_that_came_later_are_named() {
    let written = Written::new();
    assert_eq!(written.kinds.len(), 16);
    for &(section, at, known) in &written.kinds {
        let mut bytes = written.bytes.clone();
        bytes[at] = known;
        let error = Manifest::read(&bytes, 7).map(|_| ()).expect_err(section);
        assert_eq!(error, Error::Unknown { section, found: known, known, minor: 7 });
        let said = error.to_string();
        for word in
            [format!("{section} is of kind {known}"), "4.3".to_owned(), "firmware that reads format 4.7".to_owned()]
        {
            assert!(said.contains(&word), "{word:?} not in: {said}");
        }
        // The largest kind, and what can be none.
        for far in [127, 255] {
            bytes[at] = far;
            let error = Manifest::read(&bytes, 1).map(|_| ());
            assert_eq!(error, Err(Error::Unknown { section, found: far, known, minor: 1 }));
        }
    }
}

/// The worked example of `FORMAT.md` is the blob that it says it is.
#[test]
fn the_worked_example_is_a_blob_of_the_corpus() {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(root.join("../runtime/src/blob/FORMAT.md")).expect("the specification");
    let blob = std::fs::read(root.join("corpus/narrow.blob")).expect("the example's blob");
    let (_, example) = text.split_once("## Worked example").expect("an example");
    let lines = example.split("```").nth(1).expect("a block").lines().skip(1);
    let mut seen = 0;
    for line in lines {
        let (offset, rest) = line.trim_start().split_once("  ").expect("an offset");
        let at: usize = offset.parse().expect("a number");
        let column = rest.get(..54).expect("a column of bytes");
        let bytes: Vec<u8> =
            column.split_whitespace().map(|byte| u8::from_str_radix(byte, 16).expect("a byte")).collect();
        assert!(!bytes.is_empty() && blob[at..].starts_with(&bytes), "{line}");
        seen += bytes.len();
    }
    assert_eq!(seen, 380 - 20 * 12, "every byte of the manifest up to the first entry, but for 20 joints");
}

#[test]
fn lists_beyond_their_limit_are_named() {
    let written = Written::new();
    let codec = written.kinds.iter().find(|kind| kind.0 == "codec").expect("a codec").1;
    // Behind the kind, three numbers (two bytes, one, two), two bytes.
    let dilations = codec + 8;
    assert_eq!(written.bytes[dilations..dilations + 4], [2, 9, 1, 3]);
    for (at, what, limit) in [(dilations, "codec.dilations", 4), (dilations + 3, "codec.padding", 18)] {
        let mut bytes = written.bytes.clone();
        bytes[at] = 100;
        let refused = Manifest::read(&bytes, 0).map(|_| ());
        assert_eq!(refused, Err(Error::Config { what, found: 100, limit }));
    }
}

#[test]
fn a_family_that_is_not_linked_is_named() {
    let said = Error::NotLinked { feature: "tmd" }.to_string();
    assert!(said.contains("`tmd`") && said.contains("enable"), "{said}");
}
