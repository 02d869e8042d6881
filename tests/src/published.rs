//! What PyTorch made of published checkpoints.

use std::path::Path;

/// Numbers of a golden array.
///
/// # Panics
/// When there is none of that name, or of other numbers.
#[must_use]
pub fn floats(folder: &Path, name: &str) -> Vec<f32> {
    let bytes = std::fs::read(folder.join("golden").join(format!("{name}.npy"))).expect(name);
    npyz::NpyFile::new(&bytes[..]).expect(name).into_vec().expect(name)
}
