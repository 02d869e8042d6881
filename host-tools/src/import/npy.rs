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
    if announced.saturating_mul(if wide { 8 } else { 4 }) > bytes {
        return Err(Error::Truncated { path: path.to_path_buf(), announced, bytes });
    }
    let data = if wide {
        npy.into_vec::<f64>().map_err(failed)?
    } else {
        npy.into_vec::<f32>().map_err(failed)?.into_iter().map(f64::from).collect()
    };
    Ok(Array { shape, data })
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
