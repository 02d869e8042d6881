//! A blob file on the host: read, aligned, opened, its tensor table walked, its layers as integers again.

use std::path::{Path, PathBuf};

use motionette::Model;
use motionette::blob::{self, DType, HEADER_LEN, Header, Manifest, Tensor, Tensors, TextTable};
use motionette::kernels::unpacked;

use super::{AlignedBlob, QuantisedConv1d};
use crate::checkpoint::anchors::Family;
use crate::checkpoint::prior::PartMut;
use crate::checkpoint::{self, ControlCheckpoint, PriorCheckpoint};
use crate::input;

/// Bytes of a blob at most: its length has 32 bits.
const LARGEST: u64 = u32::MAX as u64;

/// What the names of the anchor control's tensors begin with.
const CONTROL: &str = "control.";

/// A blob file could not be used.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The file cannot be read.
    #[error("cannot read the blob {}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The runtime refuses it.
    #[error("blob {}: {source}", path.display())]
    Refused {
        /// The file.
        path: PathBuf,
        /// Why.
        source: blob::Error,
    },
}

/// A blob that the runtime accepts.
#[derive(Debug, Clone)]
pub struct BlobFile {
    aligned: AlignedBlob,
    path: PathBuf,
}

/// What a blob consists of, as it stands there.
pub struct Parts<'b> {
    /// Lengths, offsets and the format version.
    pub header: Header,
    /// What the model is.
    pub manifest: Manifest<'b>,
    /// A reader over the table, and the weights behind it.
    pub tensors: Tensors<'b>,
}

/// One entry of the tensor table with the numbers behind it.
#[derive(Debug, Clone, PartialEq)]
pub struct TableEntry {
    /// Name.
    pub name: String,
    /// Number format.
    pub dtype: DType,
    /// Shape, slowest dimension first.
    pub shape: [usize; 3],
    /// Offset in the weight section.
    pub offset: usize,
    /// Bytes.
    pub bytes: usize,
    /// The numbers: integers as they are (int16 put together), floats as they are.
    pub values: Vec<f64>,
}

impl BlobFile {
    /// Reads a file and has the runtime check it.
    ///
    /// # Errors
    /// [`Error`], with the path.
    pub fn open(path: &Path) -> Result<Self, Error> {
        let bytes = input::read(path, LARGEST).map_err(|source| Error::Io { path: path.to_owned(), source })?;
        Self::new(AlignedBlob::new(&bytes), path)
    }

    /// Has the runtime check a blob in memory; `path` is what errors call it.
    ///
    /// # Errors
    /// [`Error::Refused`].
    pub fn new(aligned: AlignedBlob, path: &Path) -> Result<Self, Error> {
        let refused = |source| Error::Refused { path: path.to_owned(), source };
        Model::open(aligned.bytes()).map_err(refused)?;
        let file = Self { aligned, path: path.to_owned() };
        file.parts()?;
        Ok(file)
    }

    /// The bytes, aligned.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        self.aligned.bytes()
    }

    /// The model.
    ///
    /// # Errors
    /// [`Error::Refused`]; not after [`BlobFile::open`] succeeded.
    pub fn model(&self) -> Result<Model<'_>, Error> {
        Model::open(self.bytes()).map_err(|source| self.refused(source))
    }

    fn refused(&self, source: blob::Error) -> Error {
        Error::Refused { path: self.path.clone(), source }
    }

    /// Header, manifest and table, read anew.
    ///
    /// # Errors
    /// [`Error::Refused`]; not after [`BlobFile::open`] succeeded.
    pub fn parts(&self) -> Result<Parts<'_>, Error> {
        let read = || -> Result<_, blob::Error> {
            let bytes = self.bytes();
            let header = Header::parse(bytes)?;
            let manifest_end = HEADER_LEN + header.manifest_len as usize;
            let text = bytes.get(HEADER_LEN..manifest_end).ok_or(blob::Error::Header)?;
            let weights =
                bytes.get(header.weights_offset as usize..header.total_len as usize).ok_or(blob::Error::Header)?;
            let (manifest, table) = Manifest::read(text, header.minor)?;
            let tensors = Tensors::new(table, weights, manifest.tensor_count);
            Ok(Parts { header, manifest, tensors })
        };
        read().map_err(|source| self.refused(source))
    }

    /// Why the planner does not see some of the anchors of a request, in words for a person; `parted` says whether each clause of its prompt was
    /// planned for itself. The caller knows whether the request itself asked for that.
    ///
    /// # Errors
    /// [`Error::Refused`]; not after [`BlobFile::open`] succeeded.
    pub fn unconditioned_because(&self, parted: bool) -> Result<String, Error> {
        let Some(&control) = self.parts()?.manifest.generator.control() else {
            return Ok("the blob has no anchor control; convert it with --control".to_owned());
        };
        if parted {
            return Ok("each clause of the prompt is planned for itself, and anchors belong to none".to_owned());
        }
        let unseen = Family::ALL.iter().filter(|family| control.families & family.bit() == 0);
        let names: Vec<String> = unseen.map(ToString::to_string).collect();
        Ok(format!("it was not trained with anchors of {}", names.join(" and ")))
    }

    /// The whole table with its numbers.
    ///
    /// # Errors
    /// [`Error::Refused`]; not after [`BlobFile::open`] succeeded.
    pub fn table(&self) -> Result<Vec<TableEntry>, Error> {
        let Parts { manifest, mut tensors, .. } = self.parts()?;
        (0..manifest.tensor_count)
            .map(|_| tensors.take().and_then(|t| entry(&t)))
            .collect::<Result<_, _>>()
            .map_err(|source| self.refused(source))
    }

    /// The decoder's convolutions in order of execution, as integers.
    ///
    /// # Errors
    /// [`Error::Refused`]; not after [`BlobFile::open`] succeeded.
    pub fn layers(&self) -> Result<Vec<QuantisedConv1d>, Error> {
        let manifest = self.parts()?.manifest;
        let mut layers = layers(&self.table()?);
        layers.truncate(convolutions(&manifest));
        Ok(layers)
    }

    /// Linears and tables of text encoder and planner in the order of the blob, as convolutions of one tap in integers; a table has no
    /// bias.
    ///
    /// # Errors
    /// [`Error::Refused`]; not after [`BlobFile::open`] succeeded.
    pub fn prior_layers(&self) -> Result<Vec<QuantisedConv1d>, Error> {
        let mut layers = self.planning_layers()?;
        layers.retain(|layer| !layer.name.starts_with(CONTROL));
        Ok(layers)
    }

    /// Hashes of its words with vectors, rising; none without a table of those.
    ///
    /// # Errors
    /// [`Error::Refused`]; not after [`BlobFile::open`] succeeded.
    pub fn word_hashes(&self) -> Result<Vec<u32>, Error> {
        let Parts { manifest, mut tensors, .. } = self.parts()?;
        let table = manifest.text.and_then(|text| Some(text.encoder.words()?.table));
        let Some(TextTable::Vectors { words, .. }) = table else {
            return Ok(Vec::new());
        };
        for _ in 0..manifest.tensor_count {
            let tensor = tensors.take().map_err(|source| self.refused(source))?;
            if tensor.entry.dtype == DType::U32 {
                return Ok(tensor.hashes(words).map_err(|source| self.refused(source))?.to_vec());
            }
        }
        Ok(Vec::new())
    }

    /// Those of the anchor control.
    ///
    /// # Errors
    /// [`Error::Refused`]; not after [`BlobFile::open`] succeeded.
    pub fn control_layers(&self) -> Result<Vec<QuantisedConv1d>, Error> {
        let mut layers = self.planning_layers()?;
        layers.retain(|layer| layer.name.starts_with(CONTROL));
        Ok(layers)
    }

    /// Everything behind the decoder.
    fn planning_layers(&self) -> Result<Vec<QuantisedConv1d>, Error> {
        let manifest = self.parts()?.manifest;
        let mut layers = layers(&self.table()?);
        Ok(layers.split_off(convolutions(&manifest).min(layers.len())))
    }

    /// `decoder` with the blob's weights, as real numbers, in place of its own: to run in the reference.
    ///
    /// # Errors
    /// [`Error::Refused`]; not after [`BlobFile::open`] succeeded.
    pub fn dequantised(&self, decoder: &checkpoint::Decoder) -> Result<checkpoint::Decoder, Error> {
        let mut result = decoder.clone();
        for (to, from) in result.convolutions_mut().into_iter().zip(self.layers()?) {
            *to = from.dequantised();
        }
        Ok(result)
    }

    /// A prior with the blob's weights in place of its own; what the blob does not hold (norms, a text encoder that was left out) stays.
    ///
    /// # Errors
    /// [`Error::Refused`]; not after [`BlobFile::open`] succeeded.
    pub fn dequantised_prior(&self, prior: &PriorCheckpoint) -> Result<PriorCheckpoint, Error> {
        let mut result = prior.clone();
        put_back(&self.prior_layers()?, result.parts_mut());
        Ok(result)
    }

    /// A control with the blob's weights in place of its own; what the blob does not hold in integers stays.
    ///
    /// # Errors
    /// [`Error::Refused`]; not after [`BlobFile::open`] succeeded.
    pub fn dequantised_control(&self, control: &ControlCheckpoint) -> Result<ControlCheckpoint, Error> {
        let mut result = control.clone();
        put_back(&self.control_layers()?, result.parts_mut());
        Ok(result)
    }
}

/// Puts the real weights that `layers` stand for into the parts of the same names.
fn put_back(layers: &[QuantisedConv1d], parts: Vec<PartMut<'_>>) {
    let find = |name: &str| layers.iter().find(|l| l.name == name).map(QuantisedConv1d::dequantised);
    for part in parts {
        match part {
            PartMut::Linear(linear) => {
                if let Some(back) = find(&linear.name) {
                    (linear.weight, linear.bias) = (back.weight, back.bias);
                }
            }
            PartMut::Embedding(table) => {
                if let Some(back) = find(&table.name) {
                    table.weight = back.weight;
                }
            }
            PartMut::Norm(_) => {}
        }
    }
}

/// Convolutions of a decoder.
fn convolutions(manifest: &Manifest<'_>) -> usize {
    let d = manifest.codec.decoder();
    3 + usize::from(d.stages) * (2 * d.dilations.len() + 1)
}

/// Everything in the table that has integers and scales.
fn layers(table: &[TableEntry]) -> Vec<QuantisedConv1d> {
    let mut layers = Vec::new();
    let mut rest = table.iter().peekable();
    while let Some(entry) = rest.next() {
        let (wide, narrow) = match entry.dtype {
            // Vectors of words are no layer.
            _ if ![".weight", ".wide"].into_iter().any(|ending| entry.name.ends_with(ending)) => continue,
            DType::I16Planes => (Some(entry), rest.next_if(|e| e.dtype == DType::I8)),
            DType::I8 | DType::I4 => (None, Some(entry)),
            DType::F16 | DType::F32 | DType::U32 => continue,
        };
        let mut floats = |ending| {
            let entry = rest.next_if(|e| e.dtype == DType::F32 && e.name.ends_with(ending));
            entry.map_or_else(Vec::new, |e| e.values.iter().map(|&v| v as f32).collect())
        };
        let (scales, bias) = (floats(".scale"), floats(".bias"));
        let name = &entry.name;
        let name = name.strip_suffix(".weight").or_else(|| name.strip_suffix(".wide")).unwrap_or(name);
        layers.push(layer(name, wide, narrow, scales, bias));
    }
    layers
}

fn layer(
    name: &str,
    wide: Option<&TableEntry>,
    narrow: Option<&TableEntry>,
    scales: Vec<f32>,
    bias: Vec<f32>,
) -> QuantisedConv1d {
    let [kernel, _, inputs] = wide.or(narrow).map_or([0; 3], |e| e.shape);
    let mut values = vec![0; scales.len() * inputs * kernel];
    let wide_rows = wide.map_or(0, |e| e.shape[1]);
    for (entry, first) in [(wide, 0), (narrow, wide_rows)] {
        let Some(entry) = entry else { continue };
        let rows = entry.shape[1];
        for (at, &v) in entry.values.iter().enumerate() {
            let (k, o, i) = (at / (rows * inputs), at / inputs % rows, at % inputs);
            if let Some(slot) = values.get_mut(((first + o) * inputs + i) * kernel + k) {
                *slot = v as i32;
            }
        }
    }
    QuantisedConv1d {
        name: name.to_owned(),
        outputs: scales.len(),
        inputs,
        kernel,
        wide: wide_rows,
        bits: if narrow.is_some_and(|e| e.dtype == DType::I4) { 4 } else { 8 },
        values,
        scales,
        bias,
    }
}

fn entry(tensor: &Tensor<'_>) -> Result<TableEntry, blob::Error> {
    let e = tensor.entry;
    let values: Vec<f64> = match e.dtype {
        DType::F32 => tensor.f32s(e.shape[2])?.iter().map(|&v| f64::from(v)).collect(),
        DType::F16 => {
            let bits = tensor.f16s(e.shape[1], e.shape[2])?;
            bits.iter().map(|&b| half::f16::from_bits(b).to_f64()).collect()
        }
        DType::U32 => tensor.hashes(e.shape[2])?.iter().map(|&v| f64::from(v)).collect(),
        DType::I8 => tensor.bytes(e.shape)?.iter().map(|&v| f64::from(v)).collect(),
        DType::I4 => {
            let groups = tensor.nibbles(e.shape)?.as_chunks().0;
            groups.iter().flat_map(unpacked).map(f64::from).collect()
        }
        DType::I16Planes => {
            let (high, low) = tensor.planes(e.shape)?;
            high.iter().zip(low).map(|(&h, &l)| 256.0 * f64::from(h) + f64::from(l)).collect()
        }
    };
    Ok(TableEntry {
        name: e.name.to_owned(),
        dtype: e.dtype,
        shape: e.shape.map(usize::from),
        offset: e.offset as usize,
        bytes: e.bytes() as usize,
        values,
    })
}
