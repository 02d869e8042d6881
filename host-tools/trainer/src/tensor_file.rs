//! Named f32 tensors and text in a safetensors file. Equal content gives equal bytes.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use motionette_host::output::{self, write_atomic};
use safetensors::{Dtype, SafeTensors};
use serde_json::{Map, json};

/// Why a file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The file cannot be read.
    #[error("cannot read {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// The file is not a safetensors file, or only part of one.
    #[error("{} is not a whole safetensors file", path.display())]
    Container {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        source: safetensors::SafeTensorError,
    },
    /// A metadata entry is missing or does not fit.
    #[error("{}: metadata entry {entry:?}: {reason}", path.display())]
    Metadata {
        /// The file.
        path: PathBuf,
        /// Name of the entry.
        entry: String,
        /// What is wrong with it.
        reason: String,
    },
    /// A tensor is missing or has another type or shape.
    #[error("{}: tensor {tensor:?} should be f32 {expected:?} but is {found}", path.display())]
    Tensor {
        /// The file.
        path: PathBuf,
        /// Name of the tensor.
        tensor: String,
        /// Shape that was expected.
        expected: Vec<usize>,
        /// What is there.
        found: String,
    },
    /// A tensor holds NaN or an infinity.
    #[error("{}: tensor {tensor:?} holds a value that is not finite at element {element}", path.display())]
    Value {
        /// The file.
        path: PathBuf,
        /// Name of the tensor.
        tensor: String,
        /// Index of the first such value.
        element: usize,
    },
    /// The file could not be written.
    #[error(transparent)]
    Write(#[from] output::Error),
}

/// Name and version of what a file holds, its metadata entries `format` and `version`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Format {
    /// What it is.
    pub name: &'static str,
    /// Which form of it.
    pub version: &'static str,
}

impl Format {
    /// A file of this format with nothing else in it yet.
    pub fn file(&self) -> TensorFile {
        let entries = [("format", self.name), ("version", self.version)];
        let metadata = entries.map(|(entry, text)| (entry.to_owned(), text.to_owned())).into();
        TensorFile { metadata, ..TensorFile::default() }
    }

    /// Reads a file that must be of this format.
    ///
    /// # Errors
    /// Those of [`TensorFile::load`], and [`Error::Metadata`] for another format or version.
    pub fn load(&self, path: &Path) -> Result<TensorFile, Error> {
        let file = TensorFile::load(path)?;
        self.check(&file)?;
        Ok(file)
    }

    /// Checks that a file is of this format.
    ///
    /// # Errors
    /// [`Error::Metadata`] with what it is and what it should be.
    pub fn check(&self, file: &TensorFile) -> Result<(), Error> {
        file.expect("format", self.name)?;
        file.expect("version", self.version)
    }
}

/// A file in memory.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TensorFile {
    /// Text entries.
    pub metadata: BTreeMap<String, String>,
    /// Shape and values by name.
    pub tensors: BTreeMap<String, (Vec<usize>, Vec<f32>)>,
    path: PathBuf,
}

impl TensorFile {
    /// Sets a metadata entry.
    pub fn describe(&mut self, entry: &str, text: String) {
        self.metadata.insert(entry.to_owned(), text);
    }

    /// Adds a tensor.
    pub fn insert(&mut self, name: impl Into<String>, shape: &[usize], values: Vec<f32>) {
        self.tensors.insert(name.into(), (shape.to_vec(), values));
    }

    /// Writes the file whole or not at all.
    ///
    /// # Errors
    /// [`Error::Write`].
    pub fn save(&self, path: &Path) -> Result<(), Error> {
        let mut header = Map::new();
        header.insert("__metadata__".into(), json!(self.metadata));
        let mut offset = 0;
        for (name, (shape, values)) in &self.tensors {
            let end = offset + 4 * values.len();
            header.insert(name.clone(), json!({"dtype": "F32", "shape": shape, "data_offsets": [offset, end]}));
            offset = end;
        }
        let mut header = serde_json::Value::Object(header).to_string().into_bytes();
        header.resize(header.len().next_multiple_of(8), b' ');
        write_atomic(path, |w| {
            w.write_all(&(header.len() as u64).to_le_bytes())?;
            w.write_all(&header)?;
            self.tensors.values().flat_map(|(_, values)| values).try_for_each(|x| w.write_all(&x.to_le_bytes()))
        })?;
        Ok(())
    }

    /// Reads a file; tensors of other types than f32 are an error.
    ///
    /// # Errors
    /// [`Error::Read`], [`Error::Container`], [`Error::Tensor`].
    pub fn load(path: &Path) -> Result<Self, Error> {
        let bytes = std::fs::read(path).map_err(|source| Error::Read { path: path.to_path_buf(), source })?;
        let container = |source| Error::Container { path: path.to_path_buf(), source };
        let (_, header) = SafeTensors::read_metadata(&bytes).map_err(container)?;
        let file = SafeTensors::deserialize(&bytes).map_err(container)?;
        let mut tensors = BTreeMap::new();
        for (name, view) in file.iter() {
            if view.dtype() != Dtype::F32 {
                return Err(Error::Tensor {
                    path: path.to_path_buf(),
                    tensor: name.to_owned(),
                    expected: view.shape().to_vec(),
                    found: format!("{:?}", view.dtype()),
                });
            }
            let (words, _) = view.data().as_chunks::<4>();
            let values = words.iter().map(|word| f32::from_le_bytes(*word)).collect();
            tensors.insert(name.to_owned(), (view.shape().to_vec(), values));
        }
        let metadata = header.metadata().clone().unwrap_or_default().into_iter().collect();
        Ok(Self { metadata, tensors, path: path.to_path_buf() })
    }

    /// Metadata entry `entry`.
    ///
    /// # Errors
    /// [`Error::Metadata`] when there is none.
    pub fn text(&self, entry: &str) -> Result<&str, Error> {
        self.metadata.get(entry).map(String::as_str).ok_or_else(|| self.metadata_error(entry, "is missing"))
    }

    /// Metadata entry `entry` from JSON.
    ///
    /// # Errors
    /// [`Error::Metadata`] when there is none or it cannot be read as `T`.
    pub fn parsed<T: serde::de::DeserializeOwned>(&self, entry: &str) -> Result<T, Error> {
        serde_json::from_str(self.text(entry)?).map_err(|error| self.metadata_error(entry, &error.to_string()))
    }

    /// Checks that entry `entry` is `expected`.
    fn expect(&self, entry: &str, expected: &str) -> Result<(), Error> {
        match self.text(entry)? {
            found if found == expected => Ok(()),
            found => Err(self.metadata_error(entry, &format!("is {found:?}, this program reads {expected:?}"))),
        }
    }

    /// Values of tensor `name`, which must have this shape and be finite.
    ///
    /// # Errors
    /// [`Error::Tensor`], [`Error::Value`].
    pub fn values(&self, name: &str, shape: &[usize]) -> Result<&[f32], Error> {
        let wrong = |found: String| Error::Tensor {
            path: self.path.clone(),
            tensor: name.to_owned(),
            expected: shape.to_vec(),
            found,
        };
        let (found, values) = self.tensors.get(name).ok_or_else(|| wrong("missing".to_owned()))?;
        if found != shape {
            return Err(wrong(format!("f32 {found:?}")));
        }
        match values.iter().position(|x| !x.is_finite()) {
            Some(element) => Err(Error::Value { path: self.path.clone(), tensor: name.to_owned(), element }),
            None => Ok(values),
        }
    }

    fn metadata_error(&self, entry: &str, reason: &str) -> Error {
        Error::Metadata { path: self.path.clone(), entry: entry.to_owned(), reason: reason.to_owned() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const FORMAT: Format = Format { name: "test", version: "1" };

    fn example() -> TensorFile {
        let mut file = FORMAT.file();
        file.insert("b", &[2, 1], vec![1.5, -2.0]);
        file.insert("a", &[3], vec![0.0, 1.0, f32::MIN_POSITIVE]);
        file
    }

    #[test]
    fn round_trip() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.safetensors");
        example().save(&path).unwrap();
        let back = FORMAT.load(&path).unwrap();
        assert_eq!(back.tensors, example().tensors);
        assert_eq!(back.values("b", &[2, 1]).unwrap(), [1.5, -2.0]);
    }

    #[test]
    fn what_does_not_fit_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("x.safetensors");
        assert!(matches!(TensorFile::load(&path), Err(Error::Read { .. })));
        example().save(&path).unwrap();
        let file = TensorFile::load(&path).unwrap();
        assert!(matches!(file.values("c", &[1]), Err(Error::Tensor { .. })));
        assert!(matches!(file.values("b", &[1, 2]), Err(Error::Tensor { .. })));
        for other in [Format { name: "other", ..FORMAT }, Format { version: "2", ..FORMAT }] {
            assert!(matches!(other.load(&path), Err(Error::Metadata { .. })));
        }
        assert!(matches!(file.text("config"), Err(Error::Metadata { .. })));
        let bytes = std::fs::read(&path).unwrap();
        for length in 0..bytes.len() {
            std::fs::write(&path, &bytes[..length]).unwrap();
            assert!(matches!(TensorFile::load(&path), Err(Error::Container { .. })), "{length} bytes");
        }
        let mut nan = example();
        nan.insert("a", &[1], vec![f32::NAN]);
        nan.save(&path).unwrap();
        assert!(matches!(TensorFile::load(&path).unwrap().values("a", &[1]), Err(Error::Value { element: 0, .. })));
    }
}
