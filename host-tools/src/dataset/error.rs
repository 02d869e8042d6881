//! What can be wrong with a dataset.

use std::path::PathBuf;

/// Why a dataset cannot be built, written or read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The file cannot be read.
    #[error("cannot read the dataset {}; make one with `motionette import`", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The file is not a whole safetensors file.
    #[error("{} is not a whole safetensors file; import the dataset again", path.display())]
    Container {
        /// The file.
        path: PathBuf,
        /// What the format reader said.
        source: safetensors::SafeTensorError,
    },
    /// A metadata entry is missing or unreadable.
    #[error("{}: metadata entry {entry:?} is missing or unreadable ({reason}); is this a file of `motionette import`?", path.display())]
    Metadata {
        /// The file.
        path: PathBuf,
        /// Name of the entry.
        entry: &'static str,
        /// What is wrong with it.
        reason: String,
    },
    /// The file has another format or version.
    #[error("{} is {found}, this program reads {FORMAT} version {}; import the dataset again", path.display(),
        super::VERSIONS.join(" and "), FORMAT = super::FORMAT)]
    Version {
        /// The file.
        path: PathBuf,
        /// Format and version found.
        found: String,
    },
    /// A tensor is missing or has the wrong type or shape.
    #[error("{}: tensor {tensor:?} should be {expected} but is {found}; import the dataset again", path.display())]
    Tensor {
        /// The file.
        path: PathBuf,
        /// Name of the tensor.
        tensor: &'static str,
        /// Type and shape that fit the rest of the file.
        expected: String,
        /// Type and shape found.
        found: String,
    },
    /// Clip ranges are not ascending from 0 to the number of rows.
    #[error("{}: clip {clip} has rows {from}..{to} of {rows}; import the dataset again", path.display())]
    Offsets {
        /// The file.
        path: PathBuf,
        /// Index of the clip.
        clip: usize,
        /// First row.
        from: i64,
        /// Row after the last.
        to: i64,
        /// Rows in the file.
        rows: usize,
    },
    /// Content does not give the stored hash.
    #[error("{}: the content of {what} does not give its hash; the file is damaged, import the dataset again", path.display())]
    Hash {
        /// The file.
        path: PathBuf,
        /// A clip's name, or the whole.
        what: String,
    },
    /// Joints and features of a clip do not have the same number of rows, or none.
    #[error(
        "clip {clip}: {joints} rows of joints and {features} feature values; there must be 263 values for each of at least one row"
    )]
    Rows {
        /// Name of the clip.
        clip: String,
        /// Rows of joints.
        joints: usize,
        /// Feature values.
        features: usize,
    },
    /// A joint or feature is NaN or infinite.
    #[error("clip {clip} has values that are not finite; repair or leave out the recording")]
    Value {
        /// Name of the clip.
        clip: String,
    },
    /// Two clips have the same name.
    #[error("there are two clips {clip}; names must differ, rename a file or import the folders apart")]
    Repeated {
        /// The name.
        clip: String,
    },
    /// More rows than the file's 32-bit ranges can say.
    #[error("{rows} rows are more than a dataset file can hold (2147483647); split the import")]
    Full {
        /// Rows asked for.
        rows: usize,
    },
    /// The file cannot be written.
    #[error(transparent)]
    Write(#[from] crate::output::Error),
}
