use std::collections::HashMap;

use safetensors::Dtype;
use safetensors::tensor::TensorView;

use super::*;

fn pose(seed: usize) -> Pose {
    std::array::from_fn(|j| std::array::from_fn(|c| ((seed * 67 + j * 3 + c) % 101) as f32 * 0.01))
}

fn clip(id: &str, split: Split) -> Clip {
    Clip {
        id: id.into(),
        split,
        subset: "test".into(),
        source: "made by a formula".into(),
        fps_source: 30.0,
        captions: vec![Caption { text: "a person \"walks\" \u{e9}".into(), from: 0.0, to: 1.5, source: "test".into() }],
        labels: serde_json::json!({"take": 3, "style": ["calm", null]}),
        facts: None,
        hash: String::new(),
    }
}

fn small() -> Dataset {
    let mut builder = Builder::new();
    for (index, (id, split, rows)) in
        [("a", Split::Train, 3), ("b", Split::Test, 1), ("c", Split::Train, 5)].into_iter().enumerate()
    {
        let joints: Vec<Pose> = (0..rows).map(|t| pose(index * 10 + t)).collect();
        let features: Vec<f32> = (0..rows * FEATURES).map(|i| (i as f32 + index as f32).sin()).collect();
        builder.push(clip(id, split), &joints, &features).unwrap();
    }
    builder.finish()
}

#[test]
fn saved_and_loaded_is_equal_and_bytes_repeat() {
    let folder = tempfile::tempdir().unwrap();
    let (first, second) = (folder.path().join("a.mds"), folder.path().join("b.mds"));
    let dataset = small();
    dataset.save(&first).unwrap();
    let loaded = Dataset::load(&first).unwrap();
    assert_eq!(loaded, dataset);
    loaded.save(&second).unwrap();
    assert_eq!(std::fs::read(&first).unwrap(), std::fs::read(&second).unwrap());
    let train: Vec<_> = loaded.split(Split::Train).map(|c| (c.info.id.as_str(), c.frames())).collect();
    assert_eq!(train, [("a", 3), ("c", 5)]);
    assert_eq!(loaded.clip(2).joints[4], pose(24));
    assert_eq!(loaded.clip(1).features[262], (262.0f32 + 1.0).sin());
}

#[test]
fn hash_sees_every_part_of_the_content() {
    let base = small().hash;
    let mut others = Vec::new();
    for change in 0..4 {
        let mut builder = Builder::new();
        for view in small().iter() {
            let (mut info, mut joints, mut features) =
                (view.info.clone(), view.joints.to_vec(), view.features.to_vec());
            if info.id == "b" {
                match change {
                    0 => info.captions[0].text.push('!'),
                    1 => joints[0][21][2] += 1e-6,
                    2 => features[262] += 1e-6,
                    _ => info.split = Split::Val,
                }
            }
            builder.push(info, &joints, &features).unwrap();
        }
        others.push(builder.finish().hash);
    }
    assert!(others.iter().all(|hash| *hash != base), "{base} {others:?}");
}

#[test]
fn unfit_clips_are_refused() {
    let mut builder = Builder::new();
    let features = vec![0.5; FEATURES];
    assert!(matches!(builder.push(clip("x", Split::Val), &[], &[]), Err(Error::Rows { joints: 0, .. })));
    assert!(matches!(
        builder.push(clip("x", Split::Val), &[pose(1); 2], &features),
        Err(Error::Rows { joints: 2, .. })
    ));
    let mut broken = pose(1);
    broken[4][1] = f32::NAN;
    assert!(matches!(builder.push(clip("x", Split::Val), &[broken], &features), Err(Error::Value { .. })));
    builder.push(clip("x", Split::Val), &[pose(1)], &features).unwrap();
    assert!(matches!(builder.push(clip("x", Split::Val), &[pose(1)], &features), Err(Error::Repeated { .. })));
    assert_eq!(builder.finish().offsets, [0, 1]);
}

#[test]
fn every_truncation_and_many_bit_flips_are_typed_errors() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.mds");
    small().save(&path).unwrap();
    let whole = std::fs::read(&path).unwrap();
    for length in (0..whole.len()).step_by(61) {
        std::fs::write(&path, &whole[..length]).unwrap();
        assert!(Dataset::load(&path).is_err(), "{length} bytes of {}", whole.len());
    }
    let mut accepted = 0;
    for position in (0..whole.len()).step_by(7) {
        let mut bytes = whole.clone();
        bytes[position] ^= 1 << (position % 8);
        std::fs::write(&path, &bytes).unwrap();
        // A flip in the padding or in a JSON form that means the same leaves the content whole; anything else must be noticed.
        if let Ok(loaded) = Dataset::load(&path) {
            assert_eq!(loaded, small(), "byte {position}");
            accepted += 1;
        }
    }
    assert!(accepted < 5, "{accepted} flips went unnoticed");
}

/// Writes a file with the safetensors crate itself, so that single parts can be wrong.
fn forge(metadata: &[(&str, &str)], shapes: [(Dtype, Vec<usize>); 3], offsets: &[i32]) -> Error {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("forged.mds");
    let bytes: Vec<Vec<u8>> = shapes
        .iter()
        .enumerate()
        .map(|(i, (dtype, shape))| match i {
            2 => offsets.iter().flat_map(|x| x.to_le_bytes()).collect(),
            _ => vec![0; shape.iter().product::<usize>() * dtype.bitsize() / 8],
        })
        .collect();
    let views: Vec<_> = ["joints", "features", "offsets"]
        .iter()
        .zip(&shapes)
        .zip(&bytes)
        .map(|((name, (dtype, shape)), data)| (*name, TensorView::new(*dtype, shape.clone(), data).unwrap()))
        .collect();
    let metadata: HashMap<String, String> = metadata.iter().map(|(k, v)| (k.to_string(), v.to_string())).collect();
    std::fs::write(&path, safetensors::serialize(views, Some(metadata)).unwrap()).unwrap();
    Dataset::load(&path).unwrap_err()
}

fn shapes(rows: usize, offsets: usize) -> [(Dtype, Vec<usize>); 3] {
    [(Dtype::F32, vec![rows, 22, 3]), (Dtype::F32, vec![rows, 263]), (Dtype::I32, vec![offsets])]
}

#[test]
fn forged_files_name_what_is_wrong() {
    let good = [("format", FORMAT), ("version", VERSIONS[0]), ("clips", "[]"), ("hash", "0")];
    let with = |name: &str, value: &'static str| good.map(|(k, v)| if k == name { (k, value) } else { (k, v) });
    assert!(matches!(forge(&good[1..], shapes(0, 1), &[0]), Error::Metadata { entry: "format", .. }));
    assert!(matches!(forge(&with("version", "3"), shapes(0, 1), &[0]), Error::Version { .. }));
    assert!(matches!(forge(&with("clips", "[{}]"), shapes(0, 1), &[0]), Error::Metadata { entry: "clips", .. }));
    assert!(matches!(forge(&good, shapes(0, 2), &[0, 0]), Error::Tensor { tensor: "offsets", .. }));
    let mut narrow = shapes(2, 1);
    narrow[1].1[1] = 262;
    assert!(matches!(forge(&good, narrow, &[0]), Error::Tensor { tensor: "features", .. }));
    let mut double = shapes(2, 1);
    double[0].0 = Dtype::F64;
    assert!(matches!(forge(&good, double, &[0]), Error::Tensor { tensor: "joints", .. }));
    assert!(matches!(forge(&good, shapes(2, 1), &[0]), Error::Offsets { .. }));
    assert!(matches!(forge(&good, shapes(2, 1), &[-2]), Error::Offsets { from: -2, .. }));
    assert!(matches!(forge(&good, shapes(0, 1), &[0]), Error::Hash { .. }));
    let clips =
        r#"[{"id":"a","split":"val","subset":"","source":"","fps_source":20,"captions":[],"labels":null,"hash":""}]"#;
    assert!(matches!(forge(&with("clips", clips), shapes(2, 2), &[0, 2]), Error::Hash { .. }));
    assert!(matches!(forge(&with("clips", clips), shapes(2, 2), &[0, 3]), Error::Offsets { to: 3, .. }));
}

#[test]
fn a_missing_file_and_an_unwritable_place_are_typed_errors() {
    let folder = tempfile::tempdir().unwrap();
    assert!(matches!(Dataset::load(folder.path().join("none.mds")), Err(Error::Read { .. })));
    assert!(matches!(small().save(folder.path()), Err(Error::Write(_))));
}
