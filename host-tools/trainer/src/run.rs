//! What the commands that train have in common.

use std::path::{Path, PathBuf};

use anyhow::Context;
use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::{Value, json};

/// The path with `.safetensors` at its end.
pub fn with_suffix(path: &Path) -> PathBuf {
    if path.extension().is_some_and(|e| e == "safetensors") {
        return path.to_path_buf();
    }
    let mut name = path.as_os_str().to_owned();
    name.push(".safetensors");
    name.into()
}

/// Prints `facts` on the last line when they are asked for.
///
/// # Errors
/// None today; the signature lets commands end with it.
pub fn finish(json: bool, facts: &Value) -> anyhow::Result<()> {
    if json {
        println!("{facts}");
    }
    Ok(())
}

/// The configuration with one `field=value` applied; fields of parts are written `part.field`.
///
/// # Errors
/// A change that is not of that form, names no setting, or does not fit it.
pub fn changed<C: Serialize + DeserializeOwned>(config: &C, change: &str) -> anyhow::Result<C> {
    let (field, value) = change.split_once('=').with_context(|| format!("--set {change}: write FIELD=VALUE"))?;
    let mut tree = json!(config);
    let pointer = format!("/{}", field.replace('.', "/"));
    let place = tree.pointer_mut(&pointer).with_context(|| format!("--set {change}: there is no setting {field}"))?;
    *place = serde_json::from_str(value).with_context(|| format!("--set {change}: {value} is not a value"))?;
    serde_json::from_value(tree).with_context(|| format!("--set {change}: {value} does not fit {field}"))
}
