//! Named f32 tensors of a checkpoint, whatever container they came from.

use std::collections::BTreeMap;

use super::error::{ErrorKind, Result};

/// One tensor, row major.
#[derive(Debug, Clone, PartialEq)]
pub struct Tensor {
    /// Extents, outermost first; empty for a scalar.
    pub shape: Vec<usize>,
    /// `shape.product()` numbers.
    pub data: Vec<f32>,
}

/// All tensors of a checkpoint by name (sorted, so that every walk over them is deterministic).
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TensorMap {
    tensors: BTreeMap<String, Tensor>,
    /// Tensors that are there but hold no floating-point numbers: name and element type.
    others: BTreeMap<String, String>,
}

impl TensorMap {
    /// Adds a tensor; the last one of a name wins.
    pub fn insert(&mut self, name: impl Into<String>, tensor: Tensor) {
        self.tensors.insert(name.into(), tensor);
    }

    /// Notes a tensor of another element type, so that asking for it says so.
    pub fn insert_other(&mut self, name: impl Into<String>, dtype: impl Into<String>) {
        self.others.insert(name.into(), dtype.into());
    }

    /// Number of tensors.
    #[must_use]
    pub fn len(&self) -> usize {
        self.tensors.len()
    }

    /// Whether there is none.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.tensors.is_empty()
    }

    /// Names in sorted order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.tensors.keys().map(String::as_str)
    }

    /// Name and tensor, sorted by name.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Tensor)> {
        self.tensors.iter().map(|(n, t)| (n.as_str(), t))
    }

    /// The tensor of that name, if there is one.
    #[must_use]
    pub fn find(&self, name: &str) -> Option<&Tensor> {
        self.tensors.get(name)
    }

    /// The tensor `name`, checked: present, of shape `expected` (`None` = any extent), every element finite.
    ///
    /// # Errors
    /// [`ErrorKind::MissingTensor`], [`ErrorKind::Dtype`], [`ErrorKind::Shape`], [`ErrorKind::NotFinite`].
    pub fn get(&self, name: &str, expected: &[Option<usize>]) -> Result<&Tensor> {
        if let Some(dtype) = self.others.get(name) {
            return Err(ErrorKind::Dtype { tensor: name.to_owned(), actual: dtype.clone() });
        }
        let tensor = self.find(name).ok_or_else(|| ErrorKind::MissingTensor {
            tensor: name.to_owned(),
            present: self.len(),
            similar: self.nearest(name),
        })?;
        let fits = tensor.shape.len() == expected.len()
            && tensor.shape.iter().zip(expected).all(|(a, e)| e.is_none_or(|e| e == *a) && *a > 0);
        if !fits {
            return Err(ErrorKind::Shape {
                tensor: name.to_owned(),
                expected: describe(expected),
                actual: tensor.shape.clone(),
            });
        }
        if let Some(index) = tensor.data.iter().position(|v| !v.is_finite()) {
            return Err(ErrorKind::NotFinite { tensor: name.to_owned(), index, value: f64::from(tensor.data[index]) });
        }
        Ok(tensor)
    }

    /// The name with the longest common tail, then head: `x.weight` is the likely wish of who asked for `y.x.weight`.
    fn nearest(&self, name: &str) -> Option<String> {
        let common = |a: &str| {
            let tail = a.bytes().rev().zip(name.bytes().rev()).take_while(|(x, y)| x == y).count();
            let head = a.bytes().zip(name.bytes()).take_while(|(x, y)| x == y).count();
            tail + head
        };
        self.names().max_by_key(|n| common(n)).filter(|n| common(n) > 0).map(str::to_owned)
    }
}

/// `[36, *, 3]` for a partly free shape.
fn describe(expected: &[Option<usize>]) -> String {
    let parts: Vec<String> = expected.iter().map(|e| e.map_or_else(|| "*".to_owned(), |e| e.to_string())).collect();
    format!("[{}] with no empty dimension", parts.join(", "))
}

/// The product of extents, or `None` on overflow.
pub(crate) fn element_count(shape: &[usize]) -> Option<usize> {
    shape.iter().try_fold(1_usize, |n, &d| n.checked_mul(d))
}

/// Converts little-endian element bytes of type `dtype` ("F32", "F16", "BF16", "F64") to f32 (F64 rounds to nearest).
pub(crate) fn to_f32(dtype: &str, bytes: &[u8]) -> Option<Vec<f32>> {
    Some(match dtype {
        "F32" => bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect(),
        "F64" => bytes
            .chunks_exact(8)
            .map(|b| f64::from_le_bytes([b[0], b[1], b[2], b[3], b[4], b[5], b[6], b[7]]) as f32)
            .collect(),
        "BF16" => {
            bytes.chunks_exact(2).map(|b| f32::from_bits(u32::from(u16::from_le_bytes([b[0], b[1]])) << 16)).collect()
        }
        "F16" => bytes.chunks_exact(2).map(|b| half_to_f32(u16::from_le_bytes([b[0], b[1]]))).collect(),
        _ => return None,
    })
}

/// IEEE binary16 to binary32, exact.
fn half_to_f32(h: u16) -> f32 {
    let sign = if h & 0x8000 != 0 { -1.0 } else { 1.0 };
    let exponent = i32::from(h >> 10 & 0x1f);
    let mantissa = f32::from(h & 0x3ff);
    match exponent {
        0 => sign * mantissa * 2.0_f32.powi(-24),
        31 if mantissa == 0.0 => sign * f32::INFINITY,
        31 => f32::NAN,
        e => sign * (1.0 + mantissa / 1024.0) * 2.0_f32.powi(e - 15),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn half_precision_is_exact() {
        for (bits, value) in
            [(0x3c00, 1.0), (0xc000, -2.0), (0x7bff, 65504.0), (0x0001, 5.960_464_5e-8), (0x3555, 0.333_251_95)]
        {
            assert_eq!(half_to_f32(bits), value, "{bits:#06x}");
        }
        assert!(half_to_f32(0x7e00).is_nan());
    }

    #[test]
    fn missing_tensor_names_the_nearest() {
        let mut map = TensorMap::default();
        map.insert("vqvae.decoder.model.0.bias", Tensor { shape: vec![1], data: vec![0.0] });
        map.insert("other", Tensor { shape: vec![1], data: vec![0.0] });
        let text = map.get("decoder.model.0.bias", &[Some(1)]).unwrap_err().to_string();
        assert!(text.contains("`vqvae.decoder.model.0.bias`"), "{text}");
    }
}
