//! Why a blob was refused.

use super::{ALIGNMENT, MAGIC, MAJOR, MINOR};

/// Why a blob was refused. Numbers say what was found and what was expected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[non_exhaustive]
pub enum Error {
    /// The slice does not begin on an [`ALIGNMENT`]-byte boundary: align the blob in flash (`#[repr(align(16))]`).
    Misaligned {
        /// Address modulo [`ALIGNMENT`].
        remainder: u8,
    },
    /// Fewer bytes than the header or its total length promise: the transfer was cut short.
    Truncated {
        /// Bytes that are needed.
        needed: u32,
        /// Bytes that are there.
        available: u32,
    },
    /// The first four bytes are not the magic: this is no motionette blob.
    NotABlob {
        /// The bytes found.
        found: [u8; 4],
    },
    /// Another major format version: `motionette convert OLD.blob -o NEW.blob` lifts an older blob, a newer one needs newer
    /// firmware.
    Version {
        /// Major version of the blob.
        found: u16,
        /// Major version this reader understands.
        supported: u16,
    },
    /// A length or offset in the header does not fit the others.
    Header,
    /// The CRC-32 does not match: the blob was damaged.
    Checksum {
        /// CRC computed over the bytes.
        computed: u32,
        /// CRC stored in the header.
        stored: u32,
    },
    /// The manifest is not valid postcard of the expected type.
    Manifest,
    /// A section of the manifest is of a kind that this reader does not know: the blob needs firmware that reads its format version.
    Unknown {
        /// The section.
        section: &'static str,
        /// Its kind.
        found: u8,
        /// Kinds this reader knows, from 0 on.
        known: u8,
        /// Minor format version of the blob.
        minor: u16,
    },
    /// The blob needs a family that was left out of this firmware: build it with the cargo feature.
    NotLinked {
        /// The feature of this crate.
        feature: &'static str,
    },
    /// A configuration value is out of its limits.
    Config {
        /// Which value.
        what: &'static str,
        /// The value found.
        found: u32,
        /// The largest (or only) value allowed.
        limit: u32,
    },
    /// A number of the configuration is not finite or out of its range.
    Number {
        /// Which number.
        what: &'static str,
        /// Its bits.
        bits: u32,
    },
    /// A tensor's offset is misaligned, out of the weight section, or overlaps its predecessor.
    TensorRange {
        /// Index in the tensor table.
        index: u16,
    },
    /// A tensor has another type or shape than its place in the module needs; 4-bit rows must come in whole groups of
    /// [`crate::kernels::GROUP`].
    TensorShape {
        /// Index in the tensor table.
        index: u16,
        /// Number of elements found.
        found: u32,
        /// Number of elements needed.
        expected: u32,
    },
    /// The tensor table ends before the module's configuration is satisfied.
    TensorMissing {
        /// Index of the first missing tensor.
        index: u16,
    },
    /// A tensor holds a value that is not finite or not allowed (a scale that is not positive, an int8 weight of -128).
    TensorValue {
        /// Index in the tensor table.
        index: u16,
        /// Element that is refused.
        element: u32,
    },
    /// The weights could drive activations beyond [`crate::model::MAX_MAGNITUDE`], where arithmetic is no longer finite.
    Unbounded {
        /// Index of the first tensor of the layer where the bound is exceeded.
        index: u16,
    },
}

impl core::fmt::Display for Error {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        match *self {
            Error::Misaligned { remainder } => {
                write!(f, "blob starts {remainder} bytes off a {ALIGNMENT}-byte boundary: align it in flash")
            }
            Error::Truncated { needed, available } => {
                write!(f, "blob needs {needed} bytes but {available} are there: the transfer was cut short")
            }
            Error::NotABlob { found } => {
                write!(f, "first bytes are {found:02x?}, not the magic {MAGIC:02x?}: this is no motionette blob")
            }
            Error::Version { found, supported } => {
                let cure = if found < supported {
                    "lift it with `motionette convert OLD.blob -o NEW.blob`"
                } else {
                    "it needs newer firmware"
                };
                write!(f, "blob format version {found}, this reader understands {supported}: {cure}")
            }
            Error::Header => write!(f, "header lengths and offsets contradict each other"),
            Error::Checksum { computed, stored } => {
                write!(f, "CRC-32 of the bytes is {computed:08x}, the header says {stored:08x}: the blob is damaged")
            }
            Error::Manifest => write!(f, "the manifest cannot be read"),
            Error::Unknown { section, found, known, minor } => write!(
                f,
                "manifest: {section} is of kind {found}, this reader of format {MAJOR}.{MINOR} knows kinds below {known}: \
                 the blob needs firmware that reads format {MAJOR}.{minor}"
            ),
            Error::NotLinked { feature } => {
                write!(f, "the blob needs `{feature}`, which this firmware was built without: enable that feature")
            }
            Error::Config { what, found, limit } => write!(f, "manifest: {what} is {found}, allowed is {limit}"),
            Error::Number { what, .. } => write!(f, "manifest: {what} is not finite or out of its range"),
            Error::TensorRange { index } => write!(f, "tensor {index}: offset misaligned, out of range or overlapping"),
            Error::TensorShape { index, found, expected } => {
                write!(f, "tensor {index}: {found} elements of its type, the module needs {expected}")
            }
            Error::TensorMissing { index } => write!(f, "tensor {index} is missing"),
            Error::TensorValue { index, element } => {
                write!(f, "tensor {index}: element {element} is not finite or not allowed")
            }
            Error::Unbounded { index } => {
                write!(f, "tensor {index}: with these weights activations could leave the finite range")
            }
        }
    }
}

impl core::error::Error for Error {}
