//! The tensor table, read lazily in order, and the checked views into the weight section.

use super::manifest::Reader;
use super::{ALIGNMENT, DType, Error, MINOR, TensorEntry};
use crate::kernels::GROUP;

/// Walks the tensor table in order and hands out checked tensors.
#[derive(Debug, Clone, Copy)]
pub struct Tensors<'a> {
    table: &'a [u8],
    weights: &'a [u8],
    count: u16,
    next: u16,
    used: u32,
    /// Minor format version of the blob.
    minor: u16,
    /// Values were checked before: only places and shapes are read.
    trusted: bool,
}

impl<'a> Tensors<'a> {
    /// A reader over `table` (the manifest's bytes behind the `Manifest` value) and the weight section.
    #[must_use]
    pub const fn new(table: &'a [u8], weights: &'a [u8], count: u16) -> Self {
        Tensors { table, weights, count, next: 0, used: 0, minor: MINOR, trusted: false }
    }

    /// The same of a blob of that minor format version, for what errors say.
    pub(crate) const fn of_minor(self, minor: u16) -> Self {
        Tensors { minor, ..self }
    }

    /// The same place in a table whose tensors have been read before: values are not looked at again.
    pub(crate) const fn trusted(self) -> Self {
        Tensors { trusted: true, ..self }
    }

    /// Index of the tensor that [`Tensors::take`] returns next.
    #[must_use]
    pub const fn index(&self) -> u16 {
        self.next
    }

    /// The next tensor.
    ///
    /// # Errors
    /// [`Error::TensorMissing`] at the end of the table, [`Error::Manifest`] when the entry cannot be read,
    /// [`Error::TensorRange`] when its bytes are misaligned, out of range or overlap the previous tensor.
    pub fn take(&mut self) -> Result<Tensor<'a>, Error> {
        let index = self.next;
        if index >= self.count {
            return Err(Error::TensorMissing { index });
        }
        let Ok((entry, rest)) = postcard::take_from_bytes::<TensorEntry<'a>>(self.table) else {
            return Err(self.unreadable());
        };
        let range = Error::TensorRange { index };
        let length = u32::try_from(entry.bytes()).map_err(|_| range)?;
        let end = entry.offset.checked_add(length).ok_or(range)?;
        if entry.offset < self.used || !(entry.offset as usize).is_multiple_of(ALIGNMENT) {
            return Err(range);
        }
        let bytes = self.weights.get(entry.offset as usize..end as usize).ok_or(range)?;
        (self.table, self.next, self.used) = (rest, index + 1, end);
        Ok(Tensor { index, entry, bytes, trusted: self.trusted })
    }

    /// Why the next entry cannot be read: a number format that came later is said to be one.
    #[cold]
    fn unreadable(&self) -> Error {
        let mut entry = Reader::new(self.table, self.minor);
        entry.text();
        entry.kind("tensor format", DType::COUNT);
        entry.finish().err().unwrap_or(Error::Manifest)
    }

    /// The number format of the next tensor, if there is one.
    #[must_use]
    pub fn peek(&self) -> Option<DType> {
        let mut ahead = *self;
        ahead.take().ok().map(|tensor| tensor.entry.dtype)
    }

    /// Checks that the table and its bytes end here.
    ///
    /// # Errors
    /// [`Error::Manifest`] when entries or bytes are left over.
    pub fn finish(&self) -> Result<(), Error> {
        if self.next == self.count && self.table.is_empty() { Ok(()) } else { Err(Error::Manifest) }
    }
}

/// One tensor: its table entry and its bytes in flash.
#[derive(Debug, Clone, Copy)]
pub struct Tensor<'a> {
    /// Index in the table.
    pub index: u16,
    /// Name, format, shape, offset.
    pub entry: TensorEntry<'a>,
    bytes: &'a [u8],
    trusted: bool,
}

impl<'a> Tensor<'a> {
    #[inline(never)]
    fn shaped(&self, dtype: DType, shape: [u16; 3]) -> Result<(), Error> {
        if self.entry.dtype == dtype && self.entry.shape == shape {
            return Ok(());
        }
        if !cfg!(feature = "wide-layers") && self.entry.dtype == DType::I16Planes {
            return Err(Error::NotLinked { feature: "wide-layers" });
        }
        let expected = shape.iter().fold(1u32, |n, &d| n.saturating_mul(u32::from(d)));
        let found = u32::try_from(self.entry.elements()).unwrap_or(u32::MAX);
        Err(Error::TensorShape { index: self.index, found, expected })
    }

    fn cast<T: bytemuck::AnyBitPattern>(&self) -> Result<&'a [T], Error> {
        bytemuck::try_cast_slice(self.bytes).map_err(|_| Error::TensorRange { index: self.index })
    }

    fn refuse<T: Copy>(&self, values: &[T], wrong: impl Fn(T) -> bool) -> Result<(), Error> {
        if self.trusted {
            return Ok(());
        }
        match values.iter().position(|&v| wrong(v)) {
            None => Ok(()),
            Some(element) => {
                Err(Error::TensorValue { index: self.index, element: u32::try_from(element).unwrap_or(u32::MAX) })
            }
        }
    }

    /// `length` finite singles.
    ///
    /// # Errors
    /// [`Error::TensorShape`] or [`Error::TensorValue`].
    pub fn f32s(&self, length: u16) -> Result<&'a [f32], Error> {
        self.shaped(DType::F32, [1, 1, length])?;
        let values = self.cast::<f32>()?;
        self.refuse(values, |v| !v.is_finite())?;
        Ok(values)
    }

    /// `length` singles that are positive and normal: scales and standard deviations.
    ///
    /// # Errors
    /// [`Error::TensorShape`] or [`Error::TensorValue`].
    pub fn scales(&self, length: u16) -> Result<&'a [f32], Error> {
        let values = self.f32s(length)?;
        self.refuse(values, |v| !(v.is_normal() && v > 0.0))?;
        Ok(values)
    }

    /// Bit patterns of `rows * columns` finite halves.
    ///
    /// # Errors
    /// [`Error::TensorShape`] or [`Error::TensorValue`].
    pub fn f16s(&self, rows: u16, columns: u16) -> Result<&'a [u16], Error> {
        self.shaped(DType::F16, [1, rows, columns])?;
        let values = self.cast::<u16>()?;
        self.refuse(values, |v| !half::f16::from_bits(v).is_finite())?;
        Ok(values)
    }

    /// `length` hashes, rising.
    ///
    /// # Errors
    /// [`Error::TensorShape`], or [`Error::TensorValue`] of one that is not above the one before it.
    pub fn hashes(&self, length: u16) -> Result<&'a [u32], Error> {
        self.shaped(DType::U32, [1, 1, length])?;
        let values = self.cast::<u32>()?;
        if self.trusted {
            return Ok(values);
        }
        match values.iter().zip(values.iter().skip(1)).position(|(a, b)| a >= b) {
            None => Ok(values),
            Some(place) => Err(Error::TensorValue {
                index: self.index,
                element: u32::try_from(place).unwrap_or(u32::MAX).saturating_add(1),
            }),
        }
    }

    /// int8 weights in -127..=127.
    ///
    /// # Errors
    /// [`Error::TensorShape`] or [`Error::TensorValue`].
    pub fn bytes(&self, shape: [u16; 3]) -> Result<&'a [i8], Error> {
        self.shaped(DType::I8, shape)?;
        let values = self.cast::<i8>()?;
        self.refuse(values, |v| v == i8::MIN)?;
        Ok(values)
    }

    /// 4-bit weights, two a byte as [`crate::kernels::linear_s16s4`] reads them, `shape[2]` a multiple of [`GROUP`]. All values
    /// are allowed.
    ///
    /// # Errors
    /// [`Error::TensorShape`].
    pub fn nibbles(&self, shape: [u16; 3]) -> Result<&'a [u8], Error> {
        let [taps, rows, inputs] = shape;
        let whole = inputs.checked_next_multiple_of(GROUP as u16).unwrap_or(0);
        self.shaped(DType::I4, [taps, rows, whole])?;
        Ok(self.bytes)
    }

    /// The high and the low plane of int16 weights; high halves in -127..=127.
    ///
    /// # Errors
    /// [`Error::TensorShape`] or [`Error::TensorValue`].
    pub fn planes(&self, shape: [u16; 3]) -> Result<(&'a [i8], &'a [i8]), Error> {
        self.shaped(DType::I16Planes, shape)?;
        let values = self.cast::<i8>()?;
        let (high, low) = values.split_at_checked(values.len() / 2).unwrap_or((values, &[]));
        self.refuse(high, |v| v == i8::MIN)?;
        Ok((high, low))
    }
}
