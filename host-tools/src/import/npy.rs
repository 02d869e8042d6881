//! NumPy arrays of f32 or f64.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use npyz::WriterBuilder;

use crate::input;

/// An array as read: f64 whatever the file held, row-major.
#[derive(Debug, Clone, PartialEq)]
pub struct Array {
    /// Sizes, outermost first.
    pub shape: Vec<usize>,
    /// Values, innermost dimension fastest.
    pub data: Vec<f64>,
}

/// Why an array could not be read.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The file cannot be opened, or is shorter than its header says.
    #[error("cannot read {} as a NumPy array", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system or the format reader said.
        source: io::Error,
    },
    /// The element type is not `f4` or `f8`.
    #[error("{} holds elements of type {dtype}; save it as float32 or float64", path.display())]
    Type {
        /// The file.
        path: PathBuf,
        /// NumPy's name of the type.
        dtype: String,
    },
    /// The array is stored column-major.
    #[error("{} is in Fortran order; save it with numpy.ascontiguousarray", path.display())]
    Order {
        /// The file.
        path: PathBuf,
    },
    /// The array is no single vector.
    #[error("{} holds an array of shape {shape:?}; save one vector, such as features[0]", path.display())]
    Vector {
        /// The file.
        path: PathBuf,
        /// Its shape.
        shape: Vec<usize>,
    },
    /// The header is not that of an array, or of none this program could hold.
    #[error("{} is not a NumPy array: {problem}", path.display())]
    Header {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        problem: &'static str,
    },
    /// The header announces more values than the file holds or memory could.
    #[error("{} announces {announced} values but has {bytes} bytes for them; the file is truncated or not what it says", path.display())]
    Truncated {
        /// The file.
        path: PathBuf,
        /// Product of the header's shape.
        announced: u64,
        /// Bytes after the header.
        bytes: u64,
    },
}

/// Reads an `.npy` file of f32 or f64.
///
/// # Errors
/// [`Error`], naming the file.
pub fn read(path: &Path) -> Result<Array, Error> {
    let failed = |source| Error::Read { path: path.to_path_buf(), source };
    let bytes = input::read(path, input::ANY).map_err(failed)?;
    let (announced, payload) = screen(&bytes).map_err(|problem| Error::Header { path: path.to_path_buf(), problem })?;
    let npy = npyz::NpyFile::new(bytes.as_slice()).map_err(failed)?;
    let shape: Vec<usize> = npy.shape().iter().map(|&n| n as usize).collect();
    let dtype = npy.dtype().descr();
    let width = match npy.dtype() {
        npyz::DType::Plain(kind) if kind.type_char() == npyz::TypeChar::Float => kind.size_field(),
        _ => 0,
    };
    if width != 4 && width != 8 {
        return Err(Error::Type { path: path.to_path_buf(), dtype });
    }
    if npy.order() != npyz::Order::C && shape.len() > 1 {
        return Err(Error::Order { path: path.to_path_buf() });
    }
    if announced.saturating_mul(width) > payload {
        return Err(Error::Truncated { path: path.to_path_buf(), announced, bytes: payload });
    }
    let data = if width == 8 {
        npy.into_vec::<f64>().map_err(failed)?
    } else {
        npy.into_vec::<f32>().map_err(failed)?.into_iter().map(f64::from).collect()
    };
    Ok(Array { shape, data })
}

/// Reads one vector, of a shape with no more than one extent beside 1, as f32.
///
/// # Errors
/// [`Error`], naming the file.
pub fn vector(path: &Path) -> Result<Vec<f32>, Error> {
    let Array { shape, data } = read(path)?;
    if shape.iter().filter(|&&extent| extent != 1).count() > 1 {
        return Err(Error::Vector { path: path.to_path_buf(), shape });
    }
    Ok(data.into_iter().map(|v| v as f32).collect())
}

/// Looks a file's header over before the format reader does, which recurses into nested brackets and multiplies sizes unchecked. Returns the
/// product of the sizes and the number of bytes after the header.
fn screen(bytes: &[u8]) -> Result<(u64, u64), &'static str> {
    let length = |size: usize| {
        let field = bytes.get(8..8 + size)?;
        Some((8 + size, field.iter().rev().fold(0usize, |n, &b| n << 8 | usize::from(b))))
    };
    let (start, length) = match bytes.get(..7) {
        Some(b"\x93NUMPY\x01") => length(2),
        Some(b"\x93NUMPY\x02" | b"\x93NUMPY\x03") => length(4),
        _ => return Err("it does not begin as one"),
    }
    .ok_or("it ends within the header")?;
    let header = bytes.get(start..start.saturating_add(length)).ok_or("it ends within the header")?;
    let count = |brackets: &[u8]| header.iter().filter(|b| brackets.contains(b)).count();
    if count(b"([{") > 64 || count(b"-") > 64 {
        return Err("its header is no description of an array");
    }
    let after = |text: &str| header.windows(text.len()).position(|w| w == text.as_bytes()).map(|at| at + text.len());
    let sizes = after("shape").ok_or("its header names no shape")?;
    let sizes = header[sizes..].split(|&b| b == b')').next().unwrap_or_default();
    let mut product = 1u64;
    for run in sizes.split(|b| !b.is_ascii_digit()).filter(|run| !run.is_empty()) {
        let size = run.iter().try_fold(0u64, |n, b| n.checked_mul(10)?.checked_add(u64::from(b - b'0')));
        // A size of zero must not hide what the others would multiply to on the way.
        product =
            size.and_then(|size| product.checked_mul(size.max(1))).ok_or("its sizes multiply to more than 64 bits")?;
    }
    Ok((product, (bytes.len() - start - header.len()) as u64))
}

/// Writes an f32 array in row-major order.
///
/// # Errors
/// Those of the writer, and when `data` does not fill `shape`.
pub fn write(writer: &mut dyn Write, shape: &[usize], data: &[f32]) -> io::Result<()> {
    let shape: Vec<u64> = shape.iter().map(|&n| n as u64).collect();
    let mut npy = npyz::WriteOptions::new().default_dtype().shape(&shape).writer(writer).begin_nd()?;
    npy.extend(data.iter())?;
    npy.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A version 1 file with this header and payload.
    fn file(header: &str, payload: &[u8]) -> Vec<u8> {
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        let header = format!("{header:<117}\n");
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.bytes());
        bytes.extend(payload);
        bytes
    }

    fn header(descr: &str, fortran: &str, shape: &str) -> String {
        format!("{{'descr': '{descr}', 'fortran_order': {fortran}, 'shape': {shape}, }}")
    }

    fn read_bytes(bytes: &[u8]) -> Result<Array, Error> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.npy");
        std::fs::write(&path, bytes).unwrap();
        read(&path)
    }

    #[test]
    fn both_widths_and_byte_orders() {
        let values = [1.5f32, -2.0, 0.25, 3.0, 4.0, -0.5];
        let wide = values.map(f64::from).to_vec();
        let little: Vec<u8> = values.iter().flat_map(|x| x.to_le_bytes()).collect();
        let big: Vec<u8> = values.iter().flat_map(|x| f64::from(*x).to_be_bytes()).collect();
        for (descr, payload) in [("<f4", little), (">f8", big)] {
            let array = read_bytes(&file(&header(descr, "False", "(2, 3)"), &payload)).unwrap();
            assert_eq!((array.shape.as_slice(), &array.data), (&[2, 3][..], &wide));
        }
        let mut bytes = Vec::new();
        write(&mut bytes, &[3, 2], &values).unwrap();
        assert_eq!(read_bytes(&bytes).unwrap(), Array { shape: vec![3, 2], data: wide });
        assert!(write(&mut Vec::new(), &[4, 2], &values).is_err());
    }

    #[test]
    fn what_cannot_be_read_is_a_typed_error() {
        let zeros = [0u8; 48];
        let of = |descr, fortran, shape| read_bytes(&file(&header(descr, fortran, shape), &zeros)).unwrap_err();
        assert!(matches!(of("<i4", "False", "(2, 3)"), Error::Type { .. }));
        assert!(matches!(of("|O", "False", "(2, 3)"), Error::Type { .. }));
        assert!(matches!(of("<f4", "True", "(2, 3)"), Error::Order { .. }));
        assert!(matches!(of("<f8", "False", "(7,)"), Error::Truncated { announced: 7, .. }));
        assert!(matches!(of("<f4", "False", "(4294967296, 4294967295)"), Error::Truncated { .. }));
        assert!(matches!(of("<f4", "False", "(4294967296, 4294967296)"), Error::Header { .. }));
        assert!(matches!(of("<f4", "False", "(0, 4294967296, 4294967296)"), Error::Header { .. }));
        assert!(matches!(of("<f4", "False", "(99999999999999999999, 2)"), Error::Header { .. }));
        assert!(matches!(of("<f4", "False", "(-1, 3)"), Error::Read { .. }));
        assert!(matches!(read_bytes(&file(&"(".repeat(60_000), &[])), Err(Error::Header { .. })));
        assert!(matches!(read_bytes(b"\x93NUMPY\x02\x00\xff\xff\xff\xff{"), Err(Error::Header { .. })));
        assert!(matches!(read_bytes(b""), Err(Error::Header { .. })));
        assert!(matches!(read(Path::new("no/such/file.npy")), Err(Error::Read { .. })));
    }

    #[test]
    fn truncated_and_flipped_files_never_panic() {
        let whole = file(&header("<f4", "False", "(2, 6)"), &[7u8; 48]);
        for length in 0..whole.len() {
            assert!(read_bytes(&whole[..length]).is_err(), "{length}");
        }
        for at in 0..whole.len() - 48 {
            for bit in 0..8 {
                let mut bytes = whole.clone();
                bytes[at] ^= 1 << bit;
                if let Ok(array) = read_bytes(&bytes) {
                    assert_eq!(array.data.len(), array.shape.iter().product::<usize>());
                }
            }
        }
    }
}
