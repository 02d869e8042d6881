//! Arrays that PyTorch made, of published models.

use std::path::{Path, PathBuf};

/// Factor on the published rounding noise; every mistake the fixtures' README lists is far above it.
const FACTOR: f64 = 10.0;

/// The folder of the fixtures, if it is there.
pub fn published() -> Option<PathBuf> {
    super::shared("published")
}

/// Arrays with the tolerances that belong to them.
pub struct Golden {
    folder: PathBuf,
    tolerances: serde_json::Value,
}

impl Golden {
    /// The arrays of a set.
    pub fn open(published: &Path) -> Self {
        let text = std::fs::read_to_string(published.join("tolerances.json")).expect("tolerances.json");
        Self { folder: published.join("golden"), tolerances: serde_json::from_str(&text).expect("JSON") }
    }

    /// Shape and numbers of an array.
    pub fn floats(&self, name: &str) -> (Vec<usize>, Vec<f32>) {
        let bytes = std::fs::read(self.folder.join(format!("{name}.npy"))).expect(name);
        let file = npyz::NpyFile::new(&bytes[..]).expect(name);
        (file.shape().iter().map(|&d| d as usize).collect(), file.into_vec().expect(name))
    }

    /// An array of ids.
    pub fn ids(&self, name: &str) -> Vec<i64> {
        let bytes = std::fs::read(self.folder.join(format!("{name}.npy"))).expect(name);
        npyz::NpyFile::new(&bytes[..]).expect(name).into_vec().expect(name)
    }

    /// Largest difference to the golden array, checked against its tolerance.
    pub fn check(&self, name: &str, actual: impl IntoIterator<Item = f64>) {
        let limit = FACTOR * self.tolerances["outputs"][name]["max_abs_f32_minus_f64"].as_f64().expect(name);
        let (_, expected) = self.floats(name);
        let actual: Vec<f64> = actual.into_iter().collect();
        assert_eq!(actual.len(), expected.len(), "{name}: number of elements");
        let worst = actual.iter().zip(&expected).map(|(a, &e)| (a - f64::from(e)).abs()).fold(0.0, f64::max);
        eprintln!("{name}: {worst:.2e} of {limit:.2e}");
        assert!(worst <= limit, "{name}: off by {worst:.3e}, limit {limit:.3e}");
    }
}

/// In f64.
pub fn wide(values: &[f32]) -> impl Iterator<Item = f64> + '_ {
    values.iter().map(|&v| f64::from(v))
}
