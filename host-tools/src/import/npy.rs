//! NumPy arrays of f32 or f64.

use std::fs::File;
use std::io::{self, BufReader, Write};
use std::path::{Path, PathBuf};

use npyz::WriterBuilder;

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
    /// The header announces more values than the file holds or memory could.
    #[error("{} announces {announced} values but has {bytes} bytes; the file is truncated or not what it says", path.display())]
    Truncated {
        /// The file.
        path: PathBuf,
        /// Product of the header's shape.
        announced: u64,
        /// Size of the file.
        bytes: u64,
    },
}

/// Reads an `.npy` file of f32 or f64.
///
/// # Errors
/// [`Error`], naming the file.
pub fn read(path: &Path) -> Result<Array, Error> {
    let failed = |source| Error::Read { path: path.to_path_buf(), source };
    let file = File::open(path).map_err(failed)?;
    let bytes = file.metadata().map_err(failed)?.len();
    let npy = npyz::NpyFile::new(BufReader::new(file)).map_err(failed)?;
    let shape: Vec<usize> = npy.shape().iter().map(|&n| n as usize).collect();
    let announced = npy.shape().iter().try_fold(1u64, |a, &n| a.checked_mul(n)).unwrap_or(u64::MAX);
    let dtype = npy.dtype().descr();
    let (wide, narrow) = (dtype.contains("f8"), dtype.contains("f4"));
    if !wide && !narrow {
        return Err(Error::Type { path: path.to_path_buf(), dtype });
    }
    if npy.order() != npyz::Order::C && shape.len() > 1 {
        return Err(Error::Order { path: path.to_path_buf() });
    }
    let truncated = || Error::Truncated { path: path.to_path_buf(), announced, bytes };
    // Before anything is reserved for the announced number.
    if announced.saturating_mul(if wide { 8 } else { 4 }) > bytes {
        return Err(truncated());
    }
    let data = if wide {
        npy.into_vec::<f64>()
    } else {
        npy.into_vec::<f32>().map(|narrow| narrow.into_iter().map(f64::from).collect())
    };
    match data {
        Ok(data) => Ok(Array { shape, data }),
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Err(truncated()),
        Err(error) => Err(failed(error)),
    }
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
        assert!(matches!(of("<f4", "False", "(4294967296, 4294967296)"), Error::Truncated { .. }));
        assert!(matches!(of("<f4", "False", "(-1, 3)"), Error::Read { .. }));
        assert!(matches!(read_bytes(b""), Err(Error::Read { .. })));
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
