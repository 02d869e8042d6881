//! SHA-256 over a dataset's content.

use serde_json::Value;
use sha2::{Digest, Sha256};

use super::{Clip, Dataset};

/// Little-endian bytes of `values`, handed on in blocks.
pub(super) fn bytes_of<E>(values: &[f32], mut take: impl FnMut(&[u8]) -> Result<(), E>) -> Result<(), E> {
    const BLOCK: usize = 1 << 14;
    let mut bytes = vec![0u8; BLOCK * 4];
    for block in values.chunks(BLOCK) {
        for (slot, x) in bytes.chunks_exact_mut(4).zip(block) {
            slot.copy_from_slice(&x.to_le_bytes());
        }
        take(&bytes[..block.len() * 4])?;
    }
    Ok(())
}

/// Hash of one clip: description (without its hash) as JSON, then joints, then features, each preceded by its length.
pub(super) fn clip(clip: &Clip, joints: &[f32], features: &[f32]) -> String {
    let description = Clip { hash: String::new(), labels: sorted(&clip.labels), ..clip.clone() };
    // A description is strings, numbers and JSON values: it always has a JSON form.
    let description = serde_json::to_vec(&description).unwrap_or_default();
    let mut hash = Sha256::new();
    hash.update((description.len() as u64).to_le_bytes());
    hash.update(&description);
    for values in [joints, features] {
        hash.update((values.len() as u64).to_le_bytes());
        let absorbed: Result<(), std::convert::Infallible> = bytes_of(values, |block| {
            hash.update(block);
            Ok(())
        });
        let Ok(()) = absorbed;
    }
    hex(&hash.finalize())
}

/// Hash of a dataset: the clips' hashes in order.
pub(super) fn whole(clips: &[Clip]) -> String {
    let mut hash = Sha256::new();
    for clip in clips {
        hash.update(clip.hash.as_bytes());
    }
    hex(&hash.finalize())
}

/// The first clip whose content does not give the hash in its description. Runs on all cores.
pub(super) fn first_mismatch(dataset: &Dataset) -> Option<usize> {
    let indices: Vec<usize> = (0..dataset.clips.len()).collect();
    crate::parallel::map(&indices, |&index| {
        let view = dataset.clip(index);
        clip(view.info, view.joints.as_flattened().as_flattened(), view.features) == view.info.hash
    })
    .iter()
    .position(|&same| !same)
}

/// The same value with the keys of every object in order, whatever order the JSON library keeps.
fn sorted(value: &Value) -> Value {
    match value {
        Value::Object(map) => {
            let mut entries: Vec<_> = map.iter().collect();
            entries.sort_by(|a, b| a.0.cmp(b.0));
            entries.into_iter().map(|(key, value)| (key.clone(), sorted(value))).collect()
        }
        Value::Array(items) => items.iter().map(sorted).collect(),
        other => other.clone(),
    }
}

fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
