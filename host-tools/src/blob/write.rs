//! The bytes of a blob: header, manifest, tensor table, weight section (`runtime/src/blob/FORMAT.md`).

use motionette::blob::{
    ALIGNMENT, Corruption, DType, Guidance, HEADER_LEN, Header, MAJOR, Manifest, PhraseBank, TensorEntry, TextEncoding,
    TextTable,
};

use super::AlignedBlob;

/// A blob could not be written.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A length or an offset is larger than its field.
    #[error("{what} is {found}, the blob format allows {bits} bits; train a smaller configuration")]
    TooLarge {
        /// Which length or offset.
        what: &'static str,
        /// Its value.
        found: usize,
        /// Bits of its field.
        bits: usize,
    },
    /// Postcard could not write the manifest or the table.
    #[error("the manifest cannot be serialised: {0}")]
    Manifest(#[from] postcard::Error),
}

/// A tensor that waits for its place in the weight section.
#[derive(Debug, Clone, PartialEq)]
pub struct Tensor {
    /// Name.
    pub name: String,
    /// Number format.
    pub dtype: DType,
    /// Shape, slowest dimension first.
    pub shape: [u16; 3],
    /// Its bytes, as the format wants them.
    pub bytes: Vec<u8>,
}

impl Tensor {
    /// The vector `[1][1][n]` of f32.
    ///
    /// # Errors
    /// [`Error::TooLarge`].
    pub fn vector(name: String, values: &[f32]) -> Result<Self, Error> {
        let shape = [1, 1, narrow(values.len(), "length of a vector")?];
        Ok(Self { name, dtype: DType::F32, shape, bytes: values.iter().flat_map(|v| v.to_le_bytes()).collect() })
    }
}

/// The blob of `manifest`, whose `tensor_count` is that of `tensors`, in their order.
///
/// # Errors
/// [`Error`].
pub fn write(manifest: &Manifest<'_>, tensors: &[Tensor]) -> Result<AlignedBlob, Error> {
    let (mut table, mut weights) = (Vec::new(), Vec::new());
    for tensor in tensors {
        weights.resize(weights.len().next_multiple_of(ALIGNMENT), 0);
        let offset = narrow(weights.len(), "weight section")?;
        let entry = TensorEntry { name: &tensor.name, dtype: tensor.dtype, shape: tensor.shape, offset };
        table.extend(postcard::to_stdvec(&entry)?);
        weights.extend_from_slice(&tensor.bytes);
    }
    let wide = tensors.iter().filter(|tensor| tensor.dtype == DType::I16Planes).count() > 1;
    versioned(manifest, &table, &weights, minor(manifest).max(if wide { 2 } else { 0 }))
}

/// The oldest minor version that has all that a manifest says: 3 where a planner that reads words has masked tokens; 2 where prompts are vectors (as where more layers than the last have weights of 16
/// bits); 1 where a convolution looks less far ahead than back, words have vectors,
/// prompts are understood as phrases, or guidance takes one pass; else 0.
fn minor(manifest: &Manifest<'_>) -> u16 {
    let causal = manifest.codec.decoder().padding.iter().any(|padding| padding.left != padding.right);
    let text = manifest.text.as_ref();
    let vectors = text
        .and_then(|text| text.encoder.words())
        .is_some_and(|encoder| matches!(encoder.table, TextTable::Vectors { .. }));
    let phrases = text.is_some_and(|text| matches!(text.bank, PhraseBank::Meanings { .. }));
    let one_pass = manifest.generator.planner().is_some_and(|planner| planner.guidance == Guidance::OnePass);
    if manifest.generator.planner().is_some_and(|planner| planner.corruption == Corruption::Masks) {
        return 3;
    }
    if text.is_some_and(|text| text.encoder == TextEncoding::Vectors) {
        return 2;
    }
    u16::from(causal || vectors || phrases || one_pass)
}

/// The bytes of a blob from its parts: header, `manifest`, the tensor `table` as it is on the wire, `weights`.
///
/// # Errors
/// [`Error`].
pub fn file(manifest: &Manifest<'_>, table: &[u8], weights: &[u8]) -> Result<AlignedBlob, Error> {
    versioned(manifest, table, weights, minor(manifest))
}

fn versioned(manifest: &Manifest<'_>, table: &[u8], weights: &[u8], minor: u16) -> Result<AlignedBlob, Error> {
    let mut text = postcard::to_stdvec(manifest)?;
    text.extend_from_slice(table);
    let offset = (HEADER_LEN + text.len()).next_multiple_of(ALIGNMENT);
    let mut header = Header {
        major: MAJOR,
        minor,
        total_len: narrow(offset + weights.len(), "blob")?,
        manifest_len: narrow(text.len(), "manifest")?,
        weights_offset: narrow(offset, "manifest")?,
        weights_len: narrow(weights.len(), "weight section")?,
        crc: 0,
    };
    let mut blob = header.emit().to_vec();
    blob.extend(text);
    blob.resize(offset, 0);
    blob.extend_from_slice(weights);
    header.crc = Header::checksum(&blob);
    blob[..HEADER_LEN].copy_from_slice(&header.emit());
    Ok(AlignedBlob::new(&blob))
}

/// A size in the format's own integer type.
///
/// # Errors
/// [`Error::TooLarge`], with `what`.
pub fn narrow<T: TryFrom<usize>>(found: usize, what: &'static str) -> Result<T, Error> {
    T::try_from(found).map_err(|_| Error::TooLarge { what, found, bits: 8 * size_of::<T>() })
}
