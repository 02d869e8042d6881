//! Containers of `torch.save`: a stored zip with `data.pkl` and one entry a storage.

use super::error::{ErrorKind, Result};
use super::pickle::{Id, Pickle, TensorRef, Value};
use super::tensors::{Tensor, TensorMap, element_count, to_f32};
use super::zip::Archive;

/// Where MoMask (`vq_model`, `t2m_transformer`, `res_transformer`), T2M-GPT (`net`, `trans`) and others keep the state dictionary.
const STATE_KEYS: &[&str] = &["vq_model", "t2m_transformer", "res_transformer", "net", "trans", "state_dict", "model"];

/// Reads the floating-point tensors of the state dictionary in a torch container.
///
/// Optimiser and scheduler entries beside the weights are skipped.
///
/// # Errors
/// Damaged zip or pickle, forbidden names, no state dictionary, tensors that do not fit their storage.
pub fn read(bytes: &[u8]) -> Result<TensorMap> {
    let mut archive = Archive::open(bytes)?;
    let name = archive
        .names()
        .find(|n| n.ends_with("/data.pkl") || *n == "data.pkl")
        .ok_or_else(|| ErrorKind::Zip { what: "no entry data.pkl".into() })?
        .to_owned();
    let root = name.strip_suffix("data.pkl").unwrap_or_default();
    if let Some(order) = archive.read(&format!("{root}byteorder"))?
        && order != b"little"
    {
        let what = format!("byte order `{}`, expected `little`", String::from_utf8_lossy(&order));
        return Err(ErrorKind::Zip { what });
    }
    let program = archive.read(&name)?.unwrap_or_default();
    let pickle = Pickle::parse(&program)?;
    let mut map = TensorMap::default();
    for (name, id) in pickle.entries(state_dict(&pickle)?) {
        let Value::Tensor(tensor) = pickle.value(id) else { continue };
        let entry = format!("{root}data/{}", tensor.key);
        let storage = archive.read(&entry)?.ok_or_else(|| ErrorKind::Extent {
            tensor: name.to_owned(),
            what: format!("its storage `{entry}` is not in the archive"),
        })?;
        // Integer tensors (counters of an optimiser or a batch norm) are no weights.
        match gather(name, tensor, &storage)? {
            Some(tensor) => map.insert(name, tensor),
            None => map.insert_other(name, tensor.element.name),
        }
    }
    Ok(map)
}

/// The dictionary of tensors: under one of [`STATE_KEYS`], or the top level itself.
fn state_dict(pickle: &Pickle) -> Result<Id> {
    let holds_tensors = |id: Id| pickle.entries(id).any(|(_, v)| matches!(pickle.value(v), Value::Tensor(_)));
    let top = pickle.root();
    STATE_KEYS
        .iter()
        .find_map(|key| pickle.entries(top).find(|(k, v)| k == key && holds_tensors(*v)))
        .map(|(_, id)| id)
        .or_else(|| holds_tensors(top).then_some(top))
        .ok_or_else(|| ErrorKind::NoStateDict {
            expected: STATE_KEYS,
            found: pickle.entries(top).take(16).map(|(k, _)| k.to_owned()).collect(),
        })
}

/// Copies a strided view out of its storage, row major. `None` for element types that are not floating point.
fn gather(name: &str, tensor: &TensorRef, storage: &[u8]) -> Result<Option<Tensor>> {
    let bad = |what: String| ErrorKind::Extent { tensor: name.to_owned(), what };
    if tensor.numel.checked_mul(tensor.element.size) != Some(storage.len()) {
        return Err(bad(format!(
            "its storage holds {} bytes, expected {} elements of {} bytes",
            storage.len(),
            tensor.numel,
            tensor.element.size
        )));
    }
    let count = element_count(&tensor.shape).filter(|&n| n <= tensor.numel);
    let count = count.ok_or_else(|| {
        bad(format!("its shape {:?} asks for more than the {} elements of its storage", tensor.shape, tensor.numel))
    })?;
    let last = tensor.shape.iter().zip(&tensor.strides).try_fold(tensor.offset, |at, (&n, &stride)| {
        n.saturating_sub(1).checked_mul(stride).and_then(|step| at.checked_add(step))
    });
    if count > 0 && last.is_none_or(|at| at >= tensor.numel) {
        return Err(bad(format!(
            "offset {} and strides {:?} leave its storage of {} elements",
            tensor.offset, tensor.strides, tensor.numel
        )));
    }
    let Some(flat) = to_f32(tensor.element.name, storage) else { return Ok(None) };
    let mut data = Vec::with_capacity(count);
    let mut index = vec![0_usize; tensor.shape.len()];
    for _ in 0..count {
        let at = index.iter().zip(&tensor.strides).fold(tensor.offset, |at, (i, s)| at + i * s);
        data.push(flat[at]);
        for (i, &n) in index.iter_mut().zip(&tensor.shape).rev() {
            *i += 1;
            if *i < n {
                break;
            }
            *i = 0;
        }
    }
    Ok(Some(Tensor { shape: tensor.shape.clone(), data }))
}

#[cfg(test)]
mod tests {
    use super::super::pickle::Element;
    use super::*;

    fn tensor(offset: usize, shape: &[usize], strides: &[usize]) -> TensorRef {
        let element = Element { name: "F32", size: 4 };
        TensorRef { key: "0".into(), element, numel: 6, offset, shape: shape.into(), strides: strides.into() }
    }

    #[test]
    fn strides_are_followed_and_bounded() {
        let storage: Vec<u8> = (0..6).flat_map(|v| (v as f32).to_le_bytes()).collect();
        let read = |t: &TensorRef| gather("w", t, &storage);
        let transposed = read(&tensor(0, &[3, 2], &[1, 3])).expect("in bounds").expect("floats");
        assert_eq!(transposed.data, [0.0, 3.0, 1.0, 4.0, 2.0, 5.0]);
        for wrong in [
            tensor(1, &[2, 3], &[3, 1]),
            tensor(0, &[2, 3], &[4, 1]),
            tensor(0, &[7], &[0]),
            tensor(0, &[usize::MAX, 2], &[0, 0]),
            tensor(usize::MAX, &[1, 2], &[1, 1]),
            tensor(0, &[2, 2], &[usize::MAX, 1]),
        ] {
            let error = read(&wrong).expect_err("out of bounds");
            assert!(error.to_string().starts_with("tensor `w`"), "{error}");
        }
    }
}
