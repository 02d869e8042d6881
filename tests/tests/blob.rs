//! Blobs that are cut short, damaged, of another version or hostile: each is refused with an error that says why.

use motionette::blob::{Error, HEADER_LEN, Header, Manifest, TensorEntry};
use motionette::{Generator, Model, Request};
use motionette_tests::tiny::{PriorShape, Shape, Tiny};

fn tiny() -> Tiny {
    Tiny::new(Shape { width: 4, code_width: 3, codes: 5, dilations: vec![1], wide: 4, ..Shape::default() }, 3)
}

/// A blob in aligned memory that may be changed.
struct Editable {
    words: Vec<u128>,
    len: usize,
}

impl Editable {
    fn new(bytes: &[u8]) -> Self {
        let mut words = vec![0u128; bytes.len().div_ceil(16) + 1];
        bytemuck::cast_slice_mut::<u128, u8>(&mut words)[..bytes.len()].copy_from_slice(bytes);
        Editable { words, len: bytes.len() }
    }

    fn bytes(&mut self) -> &mut [u8] {
        &mut bytemuck::cast_slice_mut(&mut self.words)[..self.len]
    }

    /// Makes the checksum fit again, so that what follows it is tested.
    fn repair(&mut self) {
        let crc = Header::checksum(self.bytes());
        self.bytes()[24..28].copy_from_slice(&crc.to_le_bytes());
    }

    fn open(&mut self) -> Result<(), Error> {
        Model::open(self.bytes()).map(|_| ())
    }
}

#[test]
fn every_truncation_and_every_flipped_bit_is_refused() {
    let tiny = tiny();
    let mut blob = Editable::new(tiny.bytes());
    assert_eq!(blob.open(), Ok(()));
    for len in 0..tiny.bytes().len() {
        let needed = if len < HEADER_LEN { HEADER_LEN } else { tiny.bytes().len() } as u32;
        let cut = Model::open(&tiny.bytes()[..len]).map(|_| ());
        assert_eq!(cut, Err(Error::Truncated { needed, available: len as u32 }));
    }
    for bit in (0..tiny.bytes().len() * 8).step_by(7) {
        blob.bytes()[bit / 8] ^= 1 << (bit % 8);
        assert!(blob.open().is_err(), "bit {bit}");
        blob.bytes()[bit / 8] ^= 1 << (bit % 8);
    }
    assert_eq!(blob.open(), Ok(()));
}

#[test]
fn errors_name_what_was_found() {
    let tiny = tiny();
    let mut blob = Editable::new(tiny.bytes());
    blob.bytes()[0] = b'X';
    assert_eq!(blob.open(), Err(Error::NotABlob { found: *b"XNTB" }));
    blob.bytes()[0] = b'M';
    blob.bytes()[4] = 9;
    assert_eq!(blob.open(), Err(Error::Version { found: 9, supported: 4 }));
    blob.bytes()[4] = 4;
    blob.bytes()[40] ^= 1;
    assert!(matches!(blob.open(), Err(Error::Checksum { .. })));
    blob.bytes()[40] ^= 1;
    let mut shifted = vec![0u128; tiny.bytes().len() / 16 + 2];
    let shifted: &mut [u8] = bytemuck::cast_slice_mut(&mut shifted);
    shifted[4..4 + tiny.bytes().len()].copy_from_slice(tiny.bytes());
    let moved = Model::open(&shifted[4..4 + tiny.bytes().len()]).map(|_| ());
    assert_eq!(moved, Err(Error::Misaligned { remainder: 4 }));
}

#[test]
fn refused_values_name_tensor_and_element() {
    let tiny = tiny();
    let weights = u32::from_le_bytes(tiny.bytes()[16..20].try_into().unwrap()) as usize;
    let with = |offset: usize, value: f32| {
        let mut blob = Editable::new(tiny.bytes());
        blob.bytes()[weights + offset..weights + offset + 4].copy_from_slice(&value.to_le_bytes());
        blob.repair();
        blob.open()
    };
    // The first tensor is the mean, the second the standard deviation, 16-byte aligned.
    let std = (4 * 263usize).next_multiple_of(16);
    assert_eq!(with(4 * 17, f32::NAN), Err(Error::TensorValue { index: 0, element: 17 }));
    assert_eq!(with(4 * 3, f32::INFINITY), Err(Error::TensorValue { index: 0, element: 3 }));
    assert_eq!(with(4 * 3, 1e9), Err(Error::TensorValue { index: 0, element: 3 }));
    assert_eq!(with(std + 4 * 5, 0.0), Err(Error::TensorValue { index: 1, element: 5 }));
    assert_eq!(with(std + 4 * 5, -1.0), Err(Error::TensorValue { index: 1, element: 5 }));
    // Tensor 3 is the first layer's weights: -128 is no symmetric int8; tensor 4 its scales.
    let codes = (std + 4 * 263usize).next_multiple_of(16);
    let first = codes + (2 * 5 * 3usize).next_multiple_of(16);
    let mut blob = Editable::new(tiny.bytes());
    blob.bytes()[weights + first + 2] = 0x80;
    blob.repair();
    assert_eq!(blob.open(), Err(Error::TensorValue { index: 3, element: 2 }));
    let scales = first + (3 * 4 * 3usize).next_multiple_of(16);
    assert_eq!(with(scales, 1e30), Err(Error::Unbounded { index: 3 }));
    assert_eq!(with(scales, f32::MIN_POSITIVE / 2.0), Err(Error::TensorValue { index: 4, element: 0 }));
}

/// Hashes that do not rise, scales that are not finite, a layer of another width than the vectors, phrases that cannot be.
#[test]
fn malformed_word_vectors_are_refused() {
    let shape = Shape { prior: Some(PriorShape::understanding()), ..Shape::with_prior() };
    let tiny = Tiny::new(shape, 5);
    let weights = |name: &str| {
        let file = blob_table(tiny.bytes());
        file.into_iter().find(|(found, ..)| found == name).expect("in the table")
    };
    let with = |at: usize, bytes: &[u8]| {
        let mut blob = Editable::new(tiny.bytes());
        assert_eq!(blob.open(), Ok(()));
        blob.bytes()[at..at + bytes.len()].copy_from_slice(bytes);
        blob.repair();
        blob.open()
    };
    // Rows of 24 numbers would lie in rows of 32.
    let odd = Tiny::new(
        Shape { prior: Some(PriorShape { vectors: 24, ..PriorShape::understanding() }), ..Shape::with_prior() },
        5,
    );
    let refused = Error::Config { what: "text.encoder.table.dims, no multiple of", found: 24, limit: 16 };
    assert_eq!(Editable::new(odd.bytes()).open(), Err(refused));
    let (_, hashes, index) = weights("hashes");
    let first: [u8; 4] = tiny.bytes()[hashes..hashes + 4].try_into().expect("four");
    assert_eq!(with(hashes + 4, &first), Err(Error::TensorValue { index, element: 1 }));
    assert_eq!(with(hashes + 4, &[0; 4]), Err(Error::TensorValue { index, element: 1 }));
    let (_, scales, index) = weights("scales");
    for bits in [[0, 0x7C], [0, 0xFC], [1, 0x7E]] {
        assert_eq!(with(scales + 2, &bits), Err(Error::TensorValue { index, element: 1 }), "{bits:?}");
    }
    // The format of the hashes, three dimensions: as singles they are of another format.
    let entry = tiny.bytes().windows(7).position(|bytes| bytes == b"\x06hashes").expect("in the table") + 7;
    assert_eq!(tiny.bytes()[entry..entry + 4], [5, 1, 1, 6]);
    assert!(matches!(with(entry, &[3]), Err(Error::TensorShape { found: 6, expected: 6, .. })));
    // Six phrases, four of them actions, then the threshold.
    let phrases = tiny.bytes().windows(5).position(|bytes| bytes == b"sadly").expect("a phrase") + 5;
    assert_eq!(tiny.bytes()[phrases], 4);
    for (actions, found) in [(0, 0), (7, 7)] {
        assert_eq!(with(phrases, &[actions]), Err(Error::Config { what: "text.bank.actions", found, limit: 6 }));
    }
    let threshold = |value: f32| with(phrases + 1, &value.to_le_bytes());
    for value in [0.0, -1.0, 1.0, f32::NAN, f32::INFINITY] {
        assert!(matches!(threshold(value), Err(Error::Number { what: "text.bank.threshold", .. })), "{value}");
    }
    assert_eq!(threshold(0.25), Ok(()));
}

/// Names, places and numbers of the tensors.
fn blob_table(blob: &[u8]) -> Vec<(String, usize, u16)> {
    let header = Header::parse(blob).expect("a header");
    let manifest = &blob[HEADER_LEN..][..header.manifest_len as usize];
    let (manifest, mut table) = Manifest::read(manifest, header.minor).expect("a manifest");
    (0..manifest.tensor_count)
        .map(|index| {
            let (entry, rest) = postcard::take_from_bytes::<TensorEntry<'_>>(table).expect("an entry");
            table = rest;
            (entry.name.to_owned(), (header.weights_offset + entry.offset) as usize, index)
        })
        .collect()
}

/// 4-bit weights of another shape or type than their place needs, and where rows are embeddings.
#[test]
fn malformed_four_bit_weights_are_refused() {
    let shape = Shape { prior: Some(PriorShape::packed()), ..Shape::with_prior() };
    let tiny = Tiny::new(shape, 5);
    let entry = |name: &str| {
        let name = [&[name.len() as u8], name.as_bytes()].concat();
        tiny.bytes().windows(name.len()).position(|bytes| bytes == name).expect("in the table") + name.len()
    };
    let with = |at: usize, byte: u8| {
        let mut blob = Editable::new(tiny.bytes());
        assert_eq!(blob.open(), Ok(()));
        blob.bytes()[at] = byte;
        blob.repair();
        blob.open()
    };
    // A number format that came later.
    let unknown = Error::Unknown { section: "tensor format", found: 6, known: 6, minor: 0 };
    assert_eq!(with(entry("token"), 6), Err(unknown));
    // The number format, three dimensions, the offset; the first block's queries of the text.
    let (query, token) = (entry("cq"), entry("token"));
    assert_eq!(tiny.bytes()[query..query + 4], [4, 1, 32, 32]);
    assert!(matches!(with(query + 3, 24), Err(Error::TensorShape { found: 768, expected: 1024, .. })));
    assert!(matches!(with(query + 2, 16), Err(Error::TensorShape { found: 512, expected: 1024, .. })));
    // As int8, or the high halves of int16, it has values that are refused.
    assert!(matches!(with(query, 0), Err(Error::TensorValue { .. })));
    assert!(matches!(with(query, 1), Err(Error::TensorValue { .. })));
    assert_eq!(tiny.bytes()[token..token + 4], [0, 1, 11, 32]);
    assert!(matches!(with(token, 4), Err(Error::TensorShape { found: 0, expected: 352, .. })));
}

/// Places in the manifest of [`tiny`], whose numbers take a byte each, from `FORMAT.md`.
mod place {
    /// Behind the card of "tiny", "MIT OR Apache-2.0", "random numbers" and "".
    pub const REPRESENTATION: usize = super::HEADER_LEN + 5 + 18 + 15 + 1;
    pub const FRAME_RATE: usize = REPRESENTATION + 1;
    pub const SKELETON: usize = FRAME_RATE + 1;
    pub const CODEC: usize = SKELETON + 264;
    /// Width, code width, codes, quantizers, stages, one dilation.
    pub const STAGES: usize = CODEC + 5;
    pub const DILATIONS: usize = STAGES + 1;
    /// Seven convolutions, two numbers each.
    pub const PADDING: usize = DILATIONS + 2;
    pub const FEATURES: usize = PADDING + 1 + 14;
    pub const TEXT: usize = FEATURES + 2;
    pub const GENERATOR: usize = TEXT + 1;
    pub const MAX_TOKENS: usize = GENERATOR + 1;
    pub const SELF_TEST: usize = MAX_TOKENS + 1;
    pub const TENSOR_COUNT: usize = SELF_TEST + 3;
}

#[test]
fn the_manifest_lies_where_the_format_says() {
    let tiny = tiny();
    let bytes = tiny.bytes();
    let skeleton = motionette_tests::tiny::skeleton();
    assert_eq!(bytes[place::REPRESENTATION..place::SKELETON], [0, 20]);
    assert_eq!(bytes[place::SKELETON..place::CODEC], skeleton);
    assert_eq!(bytes[place::CODEC..place::PADDING], [0, 4, 3, 5, 1, 2, 1, 1]);
    assert_eq!(bytes[place::PADDING..place::FEATURES], [7, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1]);
    assert_eq!(bytes[place::FEATURES..=place::TENSOR_COUNT], [0x87, 0x02, 0, 0, 49, 0, 0, 0, 31]);
    let model = Model::open(bytes).expect("a good blob");
    assert_eq!((model.frame_rate(), model.frames_per_token(), model.max_tokens()), (20, 4, 49));
    let offsets = model.skeleton().offsets();
    assert_eq!((offsets.len(), offsets[0], offsets[5]), (22, [0.0; 3], [0.0, 0.105, 0.0]));
}

/// Values that no reader of 4.0 takes, each refused by its name.
#[test]
fn refused_values_of_the_manifest_are_named() {
    let tiny = tiny();
    let with = |at: usize, bytes: &[u8]| {
        let mut blob = Editable::new(tiny.bytes());
        blob.bytes()[at..at + bytes.len()].copy_from_slice(bytes);
        blob.repair();
        blob.open()
    };
    let config = |what, found, limit| Err(Error::Config { what, found, limit });
    assert_eq!(with(place::FRAME_RATE, &[0]), config("representation.frame_rate", 0, 1000));
    assert_eq!(with(place::STAGES, &[3]), config("entries of codec.padding", 7, 9));
    assert_eq!(with(place::DILATIONS + 1, &[2]), config("codec.padding, left and right together", 2, 4));
    // A causal convolution: nothing ahead. The first stage's first.
    assert_eq!(with(place::PADDING + 3, &[2, 0]), Ok(()));
    assert_eq!(with(place::PADDING + 3, &[0, 2]), config("codec.padding on the right, beside the left", 2, 0));
    assert_eq!(with(place::PADDING + 3, &[3, 0]), config("codec.padding, left and right together", 3, 2));
    assert_eq!(with(place::PADDING + 3, &[0, 0]), config("codec.padding, left and right together", 0, 2));
    assert_eq!(with(place::FEATURES, &[0x88]), config("codec.features", 264, 263));
    assert_eq!(with(place::MAX_TOKENS, &[0]), config("generator.max_tokens", 0, 256));
    assert_eq!(with(place::TENSOR_COUNT, &[0]), config("tensor_count", 0, 1024));
    let bone = |joint: usize, value: f32| with(place::SKELETON + 12 * joint, &value.to_le_bytes());
    for (joint, value) in [(0, 0.1), (21, f32::NAN), (3, f32::INFINITY), (7, 4.0), (7, -1e30)] {
        let refused = bone(joint, value);
        assert!(matches!(refused, Err(Error::Number { what, .. }) if what.contains("skeleton")), "{refused:?}");
    }
    assert_eq!(bone(7, 2.0), Ok(()));
    // A bone of no length.
    let short = with(place::SKELETON + 12 * 9 + 4, &[0; 4]);
    assert!(matches!(short, Err(Error::Number { bits: 0, .. })), "{short:?}");
}

/// A self-test asks for tokens that the model can decode, at most 64 numbers; a blob without a hash has none.
#[test]
fn a_self_test_that_cannot_run_is_refused() {
    let with = |shape: Shape, tokens: u8, hash: u8| {
        let tiny = Tiny::new(shape, 3);
        let mut blob = Editable::new(tiny.bytes());
        blob.bytes()[place::SELF_TEST..place::SELF_TEST + 3].copy_from_slice(&[1, tokens, hash]);
        blob.repair();
        blob.open()
    };
    let one = tiny().shape;
    let three = Shape { quantizers: 3, ..one.clone() };
    let refused = |found, limit| Err(Error::Config { what: "self_test.tokens", found, limit });
    assert_eq!(with(one.clone(), 49, 7), Ok(()));
    assert_eq!(with(one.clone(), 50, 7), refused(50, 49));
    assert_eq!(with(one.clone(), 0, 7), refused(0, 49));
    assert_eq!(with(one.clone(), 127, 0), Ok(()));
    assert_eq!(with(three.clone(), 21, 7), Ok(()));
    assert_eq!(with(three, 22, 7), refused(22, 21));
    assert_eq!(with(Shape { max_tokens: 80, ..one.clone() }, 64, 7), Ok(()));
    assert_eq!(with(Shape { max_tokens: 80, ..one }, 65, 7), refused(65, 64));
}

/// A blob of a later minor version whose codec came with it, and one whose sections are known.
#[test]
fn kinds_that_came_later_are_refused_by_name() {
    let tiny = tiny();
    let with = |at: usize, minor: u8| {
        let mut blob = Editable::new(tiny.bytes());
        blob.bytes()[at] = 9;
        blob.bytes()[6] = minor;
        blob.repair();
        blob.open()
    };
    for (at, section, known) in [
        (place::REPRESENTATION, "representation", 1),
        (place::CODEC, "codec", 1),
        (place::TEXT, "text", 2),
        (place::GENERATOR, "generator", 5),
    ] {
        assert_eq!(with(at, 4), Err(Error::Unknown { section, found: 9, known, minor: 4 }));
    }
    // A seed of 9.
    assert_eq!(with(place::SELF_TEST, 4), Ok(()));
}

/// Blobs of the format before this one: the error says both versions and what to do.
#[test]
fn blobs_of_format_3_are_told_to_be_lifted() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus/format3");
    let mut seen = 0;
    for file in std::fs::read_dir(folder).expect("the folder of old blobs") {
        let bytes = std::fs::read(file.expect("an entry").path()).expect("a blob");
        let error = Editable::new(&bytes).open().expect_err("an old blob");
        assert_eq!(error, Error::Version { found: 3, supported: 4 });
        let said = error.to_string();
        for word in ["version 3", "understands 4", "motionette convert OLD.blob -o NEW.blob"] {
            assert!(said.contains(word), "{word:?} not in: {said}");
        }
        seen += 1;
    }
    assert!(seen > 3, "only {seen} old blobs");
    let newer = Error::Version { found: 5, supported: 4 }.to_string();
    assert!(newer.contains("newer firmware") && !newer.contains("convert"), "{newer}");
}

/// Whatever the bytes, opening them answers, and what opens can be run.
#[test]
fn mutated_manifests_never_panic() {
    let tiny = tiny();
    let manifest = HEADER_LEN..u32::from_le_bytes(tiny.bytes()[16..20].try_into().unwrap()) as usize;
    let mut arena = vec![0u8; 1 << 20];
    let mut opened = 0;
    for at in (0..HEADER_LEN).chain(manifest) {
        for value in [0u8, 1, 2, 127, 128, 255] {
            let mut blob = Editable::new(tiny.bytes());
            blob.bytes()[at] = value;
            blob.repair();
            if let Ok(model) = Model::open(blob.bytes()) {
                opened += 1;
                let mut generator = Generator::new(model, &mut arena).unwrap();
                if let Ok(motion) = generator.generate(&Request::tokens(&[0, 1]), &mut ()) {
                    assert!(motion.joints().iter().all(|v| v.is_finite()), "byte {at} = {value}");
                }
                let _ = generator.self_test();
            }
        }
    }
    assert!(opened > 10, "only {opened} mutants opened: the checksum was not repaired");
}
