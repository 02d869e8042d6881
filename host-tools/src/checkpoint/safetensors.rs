//! Containers in the safetensors format.

use std::collections::BTreeMap;

use safetensors::{Dtype, SafeTensors};

use super::error::{ErrorKind, Result};
use super::tensors::{Tensor, TensorMap, to_f32};

/// Tensors and the free-text metadata of a safetensors file. Tensors that are not floating point are noted as such.
///
/// # Errors
/// [`ErrorKind::Safetensors`] when the header or the offsets are damaged.
pub fn read(bytes: &[u8]) -> Result<(TensorMap, BTreeMap<String, String>)> {
    let damaged = |e: safetensors::SafeTensorError| ErrorKind::Safetensors(e.to_string());
    let (_, header) = SafeTensors::read_metadata(bytes).map_err(damaged)?;
    let metadata = header.metadata().clone().unwrap_or_default().into_iter().collect();
    let file = SafeTensors::deserialize(bytes).map_err(damaged)?;
    let mut map = TensorMap::default();
    for (name, view) in file.iter() {
        let dtype = match view.dtype() {
            Dtype::F32 => "F32",
            Dtype::F64 => "F64",
            Dtype::F16 => "F16",
            Dtype::BF16 => "BF16",
            other => {
                map.insert_other(name, format!("{other:?}"));
                continue;
            }
        };
        if let Some(data) = to_f32(dtype, view.data()) {
            map.insert(name, Tensor { shape: view.shape().to_vec(), data });
        }
    }
    Ok((map, metadata))
}
