//! Damaged and hostile checkpoints: every one gives a typed error that names what, where, expected and found, and nothing panics.

mod common;

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use common::checkpoints::{TOKENIZER as CONFIG, bytes, tokenizer as whole, tokenizer_metadata as metadata};
use motionette_host::checkpoint::{self, ErrorKind, Tensor, TensorMap, tensors_of};
use safetensors::{Dtype, tensor::TensorView};

struct Folder(tempfile::TempDir);

impl Folder {
    fn new() -> Self {
        Self(tempfile::tempdir().expect("a temporary folder"))
    }

    fn write(&self, name: &str, bytes: &[u8]) -> PathBuf {
        let path = self.0.path().join(name);
        std::fs::write(&path, bytes).expect("written");
        path
    }

    fn kind(&self, bytes: &[u8]) -> ErrorKind {
        let path = self.write("x.safetensors", bytes);
        let error = checkpoint::load(&path).expect_err("a bad checkpoint was read");
        assert!(error.to_string().contains("x.safetensors"), "{error}");
        error.kind
    }
}

#[test]
fn the_whole_one_is_read_back_as_it_was() {
    let folder = Folder::new();
    let map = whole();
    let path = folder.write("x.safetensors", &bytes(&map, metadata(CONFIG)));
    let checkpoint = checkpoint::load(&path).expect("a good checkpoint");
    assert_eq!(checkpoint.config.dilations, [3, 1]);
    assert_eq!(checkpoint.decoder.convolutions().len(), 1 + 2 * 5 + 2);
    let up = &checkpoint.decoder.stages[1].up;
    assert_eq!(up.weight, map.find("decoder.model.3.2.weight").expect("there").data);
    assert_eq!((up.outputs, up.inputs, up.kernel), (4, 4, 3));
    assert_eq!(checkpoint.statistics.expect("inside").std[262], 0.5);
    assert_eq!(checkpoint.encoder.expect("there").stages[0].blocks[1].dilation, 1);
}

#[test]
fn every_missing_tensor_is_named() {
    let folder = Folder::new();
    let map = whole();
    for left_out in map.names() {
        let mut partial = TensorMap::default();
        map.iter().filter(|(n, _)| *n != left_out).for_each(|(n, t)| partial.insert(n, t.clone()));
        let kind = folder.kind(&bytes(&partial, metadata(CONFIG)));
        assert!(matches!(&kind, ErrorKind::MissingTensor { tensor, .. } if tensor == left_out), "{left_out}: {kind}");
    }
}

#[test]
fn every_wrong_shape_is_named_with_both_shapes() {
    let folder = Folder::new();
    let map = whole();
    for name in map.names() {
        let mut wrong = map.clone();
        let tensor = map.find(name).expect("there");
        let mut shape = tensor.shape.clone();
        *shape.last_mut().expect("a dimension") += 1;
        let data = vec![0.25; shape.iter().product()];
        wrong.insert(name, Tensor { shape: shape.clone(), data });
        let kind = folder.kind(&bytes(&wrong, metadata(CONFIG)));
        let ErrorKind::Shape { tensor, actual, .. } = &kind else { panic!("{name}: {kind}") };
        assert_eq!((tensor.as_str(), actual), (name, &shape));
    }
}

#[test]
fn numbers_that_are_none_are_named_with_their_place() {
    let folder = Folder::new();
    for (name, value) in [
        ("decoder.model.6.weight", f32::NAN),
        ("mean", f32::INFINITY),
        ("quantizer.layers.0.codebook", f32::NEG_INFINITY),
        ("encoder.model.2.1.model.1.conv2.bias", f32::NAN),
    ] {
        let mut map = whole();
        let mut tensor = map.find(name).expect("there").clone();
        tensor.data[2] = value;
        map.insert(name, tensor);
        let kind = folder.kind(&bytes(&map, metadata(CONFIG)));
        assert!(matches!(&kind, ErrorKind::NotFinite { tensor, index: 2, .. } if tensor == name), "{kind}");
    }
}

#[test]
fn integers_are_no_weights() {
    let folder = Folder::new();
    let data = vec![0_u8; 8 * 263];
    let views = [("decoder.model.0.weight", TensorView::new(Dtype::I64, vec![263], &data).expect("a view"))];
    let file = safetensors::serialize(views, Some(metadata(CONFIG))).expect("a file");
    let kind = folder.kind(&file);
    assert!(
        matches!(&kind, ErrorKind::Dtype { tensor, actual } if tensor == "decoder.model.0.weight" && actual == "I64"),
        "{kind}"
    );
}

#[test]
fn other_formats_and_versions_are_refused_with_both_names() {
    let folder = Folder::new();
    for (key, value) in [("format", "motionette-dataset"), ("version", "2"), ("version", "")] {
        let mut metadata = metadata(CONFIG);
        metadata.insert(key.to_owned(), value.to_owned());
        let kind = folder.kind(&bytes(&whole(), metadata));
        assert!(matches!(&kind, ErrorKind::Version { key: k, actual, .. } if *k == key && actual == value), "{kind}");
    }
}

#[test]
fn hostile_configurations() {
    let folder = Folder::new();
    let map = whole();
    for (from, to) in [
        ("\"width\": 4", "\"width\": 0"),
        ("\"width\": 4", "\"width\": 18446744073709551615"),
        ("\"width\": 4", "\"width\": -1"),
        ("\"depth\": 2", "\"depth\": 1000000000"),
        ("\"down_t\": 2", "\"down_t\": 63"),
        ("[3, 1]", "[3]"),
        ("[3, 1]", "[3, 0]"),
        ("\"fps\": 20", "\"fps\": 0"),
        ("\"fps\": 20", "\"fps\": 20, \"encoder_dilations\": [0, 1]"),
        ("\"fps\": 20", "\"fps\": 20, \"right\": [1, 3, 1, 1, 3, 1, 1, 1]"),
        ("\"fps\": 20", "\"fps\": 20, \"right\": [1, 3, 1, 1, 4, 1, 1, 1, 1]"),
        ("\"fps\": 20", "\"fps\": 20, \"right\": [1, 3, 1, 1, -3, 1, 1, 1, 1]"),
        ("\"codes\": 6", "\"codes\": 1e300"),
        ("\"features\": 263,", ""),
        ("\"quantizers\": 1", "\"quantizers\": 4000000000"),
    ] {
        assert!(CONFIG.contains(from));
        let kind = folder.kind(&bytes(&map, metadata(&CONFIG.replace(from, to))));
        assert!(matches!(kind, ErrorKind::Option { .. }), "{to}: {kind}");
    }
    let mut metadata = metadata(CONFIG);
    metadata.remove("config");
    assert!(matches!(folder.kind(&bytes(&map, metadata)), ErrorKind::MissingOption { .. }));
}

#[test]
fn every_truncation_of_a_safetensors_file() {
    let file = bytes(&whole(), metadata(CONFIG));
    let steps = (0..64).chain((64..file.len()).step_by(211));
    for n in steps {
        let error = tensors_of(&file[..n]).expect_err("a truncated file was read");
        assert!(matches!(error, ErrorKind::Safetensors(_) | ErrorKind::UnknownContainer { .. }), "{n}: {error}");
    }
}

#[test]
fn hostile_safetensors_headers() {
    let with_header = |header: &str| [&(header.len() as u64).to_le_bytes()[..], header.as_bytes(), &[0; 16]].concat();
    for file in [
        with_header(r#"{"a":{"dtype":"F32","shape":[4],"data_offsets":[0,99]}}"#),
        with_header(r#"{"a":{"dtype":"F32","shape":[18446744073709551615,4],"data_offsets":[0,16]}}"#),
        with_header(r#"{"a":{"dtype":"F32","shape":[4],"data_offsets":[16,0]}}"#),
        with_header(
            r#"{"a":{"dtype":"F32","shape":[2],"data_offsets":[0,8]},"b":{"dtype":"F32","shape":[2],"data_offsets":[4,12]}}"#,
        ),
        with_header(r#"{"a":{"dtype":"F99","shape":[4],"data_offsets":[0,16]}}"#),
        with_header(&format!("{{{}", "[".repeat(100_000))),
        [&0x00ff_ffff_ffff_ffff_u64.to_le_bytes()[..], b"{}"].concat(),
    ] {
        let error = tensors_of(&file).expect_err("a hostile header was read");
        assert!(matches!(error, ErrorKind::Safetensors(_)), "{error}");
    }
    assert!(matches!(tensors_of(b"GIF89a.........."), Err(ErrorKind::UnknownContainer { .. })));
}

/// A stored zip with a correct directory, as `torch.save` writes.
fn zip(entries: &[(&str, &[u8])]) -> Vec<u8> {
    let crc = |data: &[u8]| {
        !data.iter().fold(!0_u32, |mut c, &b| {
            c ^= u32::from(b);
            (0..8).for_each(|_| c = if c & 1 != 0 { (c >> 1) ^ 0xedb8_8320 } else { c >> 1 });
            c
        })
    };
    let (mut file, mut directory) = (Vec::new(), Vec::new());
    for (name, data) in entries {
        let at = file.len() as u32;
        let mut common = vec![20, 0, 0, 8, 0, 0, 0, 0, 0, 0];
        common.extend(crc(data).to_le_bytes());
        common.extend([(data.len() as u32).to_le_bytes(), (data.len() as u32).to_le_bytes()].concat());
        common.extend([(name.len() as u16).to_le_bytes(), [0; 2]].concat());
        file.extend(b"PK\x03\x04");
        file.extend(&common);
        file.extend(name.as_bytes());
        file.extend(*data);
        directory.extend(b"PK\x01\x02\x14\x00");
        directory.extend(&common);
        directory.extend([0; 10]);
        directory.extend(at.to_le_bytes());
        directory.extend(name.as_bytes());
    }
    let (start, size, count) = (file.len() as u32, directory.len() as u32, entries.len() as u16);
    file.extend(directory);
    file.extend(b"PK\x05\x06\0\0\0\0");
    file.extend([count.to_le_bytes(), count.to_le_bytes()].concat());
    file.extend([size.to_le_bytes(), start.to_le_bytes()].concat());
    file.extend([0; 2]);
    file
}

/// `{'net': {'w': tensor of `shape` over storage 0}}` as torch pickles it.
fn pickle(numel: u8, offset: u8, shape: [u8; 2], strides: [u8; 2]) -> Vec<u8> {
    let mut p = b"\x80\x02}X\x03\x00\x00\x00netccollections\nOrderedDict\n)RX\x01\x00\x00\x00wctorch._utils\n_rebuild_tensor_v2\n((X\x07\x00\x00\x00storagectorch\nFloatStorage\nX\x01\x00\x00\x000X\x03\x00\x00\x00cpu".to_vec();
    p.extend([b'K', numel, b't', b'Q', b'K', offset]);
    p.extend([b'K', shape[0], b'K', shape[1], 0x86, b'K', strides[0], b'K', strides[1], 0x86]);
    p.extend(b"\x89ccollections\nOrderedDict\n)RtRss.");
    p
}

#[test]
fn torch_containers() {
    let storage: Vec<u8> = (0..6).flat_map(|v| (v as f32).to_le_bytes()).collect();
    let read = |p: &[u8], s: &[u8]| tensors_of(&zip(&[("m/data.pkl", p), ("m/data/0", s), ("m/version", b"3\n")]));
    let (map, _) = read(&pickle(6, 0, [2, 3], [3, 1]), &storage).expect("a good container");
    assert_eq!(map.find("w").expect("there").data, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);

    // Tensors that do not fit their storage.
    for (program, storage) in [
        (pickle(6, 1, [2, 3], [3, 1]), &storage[..]),
        (pickle(6, 0, [2, 3], [250, 250]), &storage),
        (pickle(6, 0, [255, 255], [0, 0]), &storage),
        (pickle(7, 0, [2, 3], [3, 1]), &storage),
        (pickle(6, 0, [2, 3], [3, 1]), &storage[..20]),
    ] {
        let error = read(&program, storage).expect_err("an impossible tensor was read");
        assert!(matches!(error, ErrorKind::Extent { .. }), "{error}");
        assert!(error.to_string().contains("`w`"), "{error}");
    }
    // A storage that is not there, no dictionary of tensors, a call.
    let missing = tensors_of(&zip(&[("m/data.pkl", &pickle(6, 0, [2, 3], [3, 1]))])).expect_err("no storage");
    assert!(missing.to_string().contains("m/data/0"), "{missing}");
    assert!(matches!(read(b"\x80\x02}X\x02\x00\x00\x00epK\x01s.", &storage), Err(ErrorKind::NoStateDict { .. })));
    let call = read(b"\x80\x02cbuiltins\neval\nX\x01\x00\x00\x001\x85R.", &storage).expect_err("a call");
    assert!(
        matches!(&call, ErrorKind::ForbiddenGlobal { module, name, .. } if module == "builtins" && name == "eval"),
        "{call}"
    );
    assert!(matches!(tensors_of(&zip(&[("m/readme", b"hello")])), Err(ErrorKind::Zip { .. })));
}

#[test]
fn damaged_torch_containers() {
    let storage: Vec<u8> = (0..6).flat_map(|v| (v as f32).to_le_bytes()).collect();
    let file = zip(&[("m/data.pkl", &pickle(6, 0, [2, 3], [3, 1])), ("m/data/0", &storage)]);
    for n in 2..file.len() {
        assert!(tensors_of(&file[..n]).is_err(), "cut at {n}");
    }
    // Any flipped bit either is caught or leaves the numbers as they were (names of unused fields, time stamps).
    let (whole, _) = tensors_of(&file).expect("undamaged");
    for bit in 16..file.len() * 8 {
        let mut damaged = file.clone();
        damaged[bit / 8] ^= 1 << (bit % 8);
        if let Ok((map, _)) = tensors_of(&damaged) {
            assert_eq!(map, whole, "bit {bit}");
        }
    }
}

#[test]
fn published_checkpoints_need_their_options() {
    let folder = Folder::new();
    let file = bytes(&whole(), HashMap::new());
    let kind = folder.kind(&file);
    assert!(matches!(&kind, ErrorKind::Companion { what: "option file", .. }), "{kind}");
    let options =
        "depth: 2\ndilation_growth_rate: 3\nwidth: 4\ncode_dim: 3\nnb_code: 6\nnum_quantizers: 1\ndown_t: 2\n";
    for extra in ["vq_act: relu\n", "vq_act: gelu\n", "vq_norm: LN\n", ""] {
        folder.write("opt.txt", format!("{options}{extra}").as_bytes());
        let result = checkpoint::load(&folder.write("x.safetensors", &file));
        // The encoder of this file is 5 wide, MoMask's is as wide as its decoder.
        let kind = result.expect_err("an encoder of another width").kind;
        match extra {
            "" | "vq_act: relu\n" => assert!(matches!(kind, ErrorKind::Shape { .. }), "{kind}"),
            _ => assert!(matches!(kind, ErrorKind::Option { .. }), "{kind}"),
        }
    }
    folder.write("opt.txt", b"depth: 2\n");
    let kind = checkpoint::load(&folder.0.path().join("x.safetensors")).expect_err("no width").kind;
    assert!(matches!(kind, ErrorKind::MissingOption { .. }), "{kind}");
    folder.write("opt.txt", options.replace("growth_rate: 3", "growth_rate: 65536").as_bytes());
    let kind = checkpoint::load(&folder.0.path().join("x.safetensors")).expect_err("absurd dilations").kind;
    assert!(matches!(kind, ErrorKind::Option { .. }), "{kind}");
}

#[test]
fn unreadable_files() {
    for path in ["/nonexistent/x.safetensors", "/"] {
        let error = checkpoint::load(Path::new(path)).expect_err("nothing there");
        assert!(matches!(error.kind, ErrorKind::Io(_)), "{error}");
    }
}
