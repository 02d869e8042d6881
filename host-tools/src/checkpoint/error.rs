//! What can be wrong with a checkpoint, with the tensor or option at fault, what was expected and what is there.

use std::path::PathBuf;

/// A checkpoint could not be read: which file, and why.
#[derive(Debug, thiserror::Error)]
#[error("checkpoint {}: {kind}", path.display())]
pub struct Error {
    /// The file that was being read.
    pub path: PathBuf,
    /// What is wrong with it.
    #[source]
    pub kind: ErrorKind,
}

/// The ways in which a checkpoint file fails. Returned, with the path, as [`Error`].
#[derive(Debug, thiserror::Error)]
pub enum ErrorKind {
    /// The operating system refused.
    #[error("cannot read it ({0}); check the path and its permissions")]
    Io(#[from] std::io::Error),
    /// Neither a safetensors file nor a zip container of `torch.save`.
    #[error(
        "neither a safetensors file nor a torch zip container (it starts with {start:02x?}); give a .safetensors, .tar, .pth or .pt file"
    )]
    UnknownContainer {
        /// The first bytes of the file, at most eight.
        start: Vec<u8>,
    },
    /// The safetensors header or its data section is damaged.
    #[error("not a valid safetensors file: {0}; the file is damaged or was cut short")]
    Safetensors(String),
    /// The zip container is damaged or uses something that `torch.save` does not write.
    #[error("zip container, {what}; the file was cut short, is damaged, or was not written by torch.save")]
    Zip {
        /// What is wrong, and with which entry.
        what: String,
    },
    /// The pickle inside a torch container is damaged or asks for something that is not data.
    #[error("data.pkl, {what} at byte {at}; only plain state dictionaries can be read")]
    Pickle {
        /// What is wrong.
        what: String,
        /// Byte offset in the pickle.
        at: usize,
    },
    /// A pickle names a Python object other than containers and tensors. Nothing is ever executed.
    #[error(
        "data.pkl names the Python object `{module}.{name}` at byte {at}, which is neither a container nor a tensor; refused (save the state dictionary alone)"
    )]
    ForbiddenGlobal {
        /// Python module.
        module: String,
        /// Attribute of the module.
        name: String,
        /// Byte offset in the pickle.
        at: usize,
    },
    /// No dictionary of tensors where MoMask (`vq_model`) or T2M-GPT (`net`) keep it.
    #[error("no state dictionary: expected one of {expected:?} at the top level, found {found:?}")]
    NoStateDict {
        /// Names looked for.
        expected: &'static [&'static str],
        /// Names at the top level.
        found: Vec<String>,
    },
    /// A tensor is not there.
    #[error("tensor `{tensor}` is missing ({present} tensors are present{}); is this another model's checkpoint?", similar.as_ref().map(|s| format!(", the nearest name is `{s}`")).unwrap_or_default())]
    MissingTensor {
        /// Its full name.
        tensor: String,
        /// Number of tensors in the file.
        present: usize,
        /// The nearest name that is present.
        similar: Option<String>,
    },
    /// A tensor has another shape than the configuration says.
    #[error("tensor `{tensor}` has shape {actual:?}, expected {expected}")]
    Shape {
        /// Its full name.
        tensor: String,
        /// Shape wanted, `*` for a free dimension.
        expected: String,
        /// Shape found.
        actual: Vec<usize>,
    },
    /// A tensor has an element type that is not a floating point number.
    #[error("tensor `{tensor}` holds {actual}, expected F32 (F16, BF16 and F64 are converted)")]
    Dtype {
        /// Its full name.
        tensor: String,
        /// Element type found.
        actual: String,
    },
    /// A tensor holds a NaN or an infinity.
    #[error(
        "tensor `{tensor}` holds {value} at element {index}, expected finite numbers; training diverged or the file is damaged"
    )]
    NotFinite {
        /// Its full name.
        tensor: String,
        /// Flat index, row major.
        index: usize,
        /// The value.
        value: f64,
    },
    /// A tensor's extent does not fit its storage, or is absurdly large.
    #[error("tensor `{tensor}`: {what}")]
    Extent {
        /// Its full name or storage key.
        tensor: String,
        /// What does not fit.
        what: String,
    },
    /// An option is missing.
    #[error("option `{key}` is missing; give the option file (opt.txt, t2mgpt_args.json) with --options")]
    MissingOption {
        /// The option's name.
        key: String,
    },
    /// An option has a value this tool can't work with.
    #[error("option `{key}` is `{value}`, expected {expected}")]
    Option {
        /// The option's name.
        key: String,
        /// Its text.
        value: String,
        /// What can be read.
        expected: String,
    },
    /// A file that goes with the checkpoint (options, mean, std) is unreadable.
    #[error("{what} {}: {reason}", path.display())]
    Companion {
        /// What it is.
        what: &'static str,
        /// The companion file.
        path: PathBuf,
        /// Why it can't be used.
        reason: String,
    },
    /// A safetensors checkpoint names another format or version in its metadata.
    #[error("its metadata says `{key}` = `{actual}`, expected `{expected}`; convert it with the matching release")]
    Version {
        /// Metadata key.
        key: &'static str,
        /// Value found.
        actual: String,
        /// Value understood.
        expected: &'static str,
    },
    /// A standard deviation that cannot be a scale.
    #[error(
        "tensor `{tensor}` holds {value} at element {index}, expected positive numbers; the statistics are damaged"
    )]
    Std {
        /// Its full name.
        tensor: String,
        /// Flat index.
        index: usize,
        /// The value.
        value: f32,
    },
    /// A prior or a control was trained on the tokens of another tokenizer.
    #[error(
        "trained on the tokens of another tokenizer: that one's codebook has the SHA-256 {expected}, this one's has {actual}; give the tokenizer it was trained with"
    )]
    OtherTokenizer {
        /// Hash that the checkpoint names.
        expected: String,
        /// Hash of the tokenizer given.
        actual: String,
    },
    /// A control was trained on another prior.
    #[error(
        "the control was trained on another prior: that one's weights have the SHA-256 {expected}, this one's have {actual}; give the prior it was trained with"
    )]
    OtherPrior {
        /// Hash that the control names.
        expected: String,
        /// Hash of the prior given.
        actual: String,
    },
}

/// Shorthand inside this module.
pub(crate) type Result<T> = core::result::Result<T, ErrorKind>;
