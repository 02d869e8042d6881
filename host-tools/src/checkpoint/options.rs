//! Option files that travel with published checkpoints: MoMask's `opt.txt` and T2M-GPT's argument JSON.

use std::collections::BTreeMap;

use super::error::{ErrorKind, Result};

/// Options by name, as text.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Options {
    values: BTreeMap<String, String>,
}

impl Options {
    /// Reads MoMask's `key: value` lines (dashes around them are decoration) or, when the text starts with `{`, a JSON object.
    ///
    /// # Errors
    /// [`ErrorKind::Option`] for a line that is neither, [`ErrorKind::Option`] for broken JSON.
    pub fn parse(text: &str) -> Result<Self> {
        if text.trim_start().starts_with('{') {
            return Self::parse_json(text);
        }
        let mut values = BTreeMap::new();
        for line in text.lines().map(str::trim).filter(|l| !l.is_empty() && !l.starts_with('-')) {
            let (key, value) = line.split_once(':').ok_or_else(|| ErrorKind::Option {
                key: "line".into(),
                value: line.chars().take(80).collect(),
                expected: "`key: value` lines".into(),
            })?;
            values.insert(key.trim().to_owned(), value.trim().to_owned());
        }
        Ok(Self { values })
    }

    fn parse_json(text: &str) -> Result<Self> {
        let json: BTreeMap<String, serde_json::Value> = serde_json::from_str(text).map_err(|e| ErrorKind::Option {
            key: "(file)".into(),
            value: e.to_string(),
            expected: "a JSON object of options".into(),
        })?;
        let values = json
            .into_iter()
            .map(|(k, v)| match v {
                serde_json::Value::String(s) => (k, s),
                other => (k, other.to_string()),
            })
            .collect();
        Ok(Self { values })
    }

    /// The text of an option.
    #[must_use]
    pub fn text(&self, key: &str) -> Option<&str> {
        self.values.get(key).map(String::as_str)
    }

    /// A whole number in `1..=max`.
    ///
    /// # Errors
    /// [`ErrorKind::MissingOption`], [`ErrorKind::Option`].
    pub fn count(&self, key: &str, max: usize) -> Result<usize> {
        let text = self.text(key).ok_or_else(|| ErrorKind::MissingOption { key: key.into() })?;
        text.parse().ok().filter(|v| (1..=max).contains(v)).ok_or_else(|| ErrorKind::Option {
            key: key.into(),
            value: text.into(),
            expected: format!("a whole number from 1 to {max}"),
        })
    }

    /// Refuses any value of `key` but `wanted` (case does not matter); a missing option counts as `wanted`.
    ///
    /// # Errors
    /// [`ErrorKind::Option`].
    pub fn require(&self, key: &str, wanted: &[&str]) -> Result<()> {
        match self.text(key) {
            Some(text) if !wanted.iter().any(|w| w.eq_ignore_ascii_case(text)) => Err(ErrorKind::Option {
                key: key.into(),
                value: text.into(),
                expected: format!("`{}` (the runtime has no other)", wanted[0]),
            }),
            _ => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_formats() {
        let text = Options::parse("----- Options -----\nwidth: 36\nvq_norm: None\n---- End ----\n").expect("text");
        let json = Options::parse("{\"width\": 36, \"vq_norm\": null, \"vq_act\": \"relu\"}").expect("json");
        for options in [text, json] {
            assert_eq!(options.count("width", 4096).expect("width"), 36);
            options.require("vq_act", &["relu"]).expect("relu or absent");
            options.require("vq_norm", &["None", "null"]).expect("no norm");
            assert!(matches!(options.count("depth", 9), Err(ErrorKind::MissingOption { .. })));
            assert!(matches!(options.count("width", 9), Err(ErrorKind::Option { .. })));
            assert!(matches!(options.require("width", &["37"]), Err(ErrorKind::Option { .. })));
        }
        assert!(matches!(Options::parse("no colon here"), Err(ErrorKind::Option { .. })));
        assert!(matches!(Options::parse("{\"width\": "), Err(ErrorKind::Option { .. })));
    }
}
