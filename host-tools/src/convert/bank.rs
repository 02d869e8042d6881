//! Prompts that are encoded on the host and stored in the blob by name.
//!
//! A bank file is text, a prompt a line: a name, a tab, the prompt. Empty lines and lines that begin with `#` are left out.

use std::path::{Path, PathBuf};

use crate::checkpoint::PriorCheckpoint;
use crate::checkpoint::prior::UNCONDITIONAL;
use crate::import::npy;
use crate::input;
use crate::reference::text::{self, PromptError, TextEncoder, Words};

/// Bytes of a name.
pub const MAX_NAME: usize = 64;

/// A bank could not be used.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The file cannot be read.
    #[error("cannot read the prompts in {}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A line is no prompt.
    #[error("line {line}: {what}; write a name, a tab, and the prompt")]
    Line {
        /// Line, from 1.
        line: usize,
        /// What is wrong.
        what: String,
    },
    /// A prompt that is no vector in a file.
    #[error("line {line}, prompt {name:?}: {source}")]
    Vector {
        /// Line, from 1.
        line: usize,
        /// Its name.
        name: String,
        /// Why.
        source: npy::Error,
    },
    /// A prompt that the text encoder cannot read.
    #[error("line {line}, prompt {name:?}: {source}")]
    Prompt {
        /// Line, from 1.
        line: usize,
        /// Its name.
        name: String,
        /// Why.
        source: PromptError,
    },
}

/// A prompt under its name.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Prompt {
    /// Line of the file, from 1.
    pub line: usize,
    /// Its name.
    pub name: String,
    /// Its text.
    pub text: String,
}

/// An encoded prompt.
#[derive(Debug, Clone, PartialEq)]
pub struct Entry {
    /// Its name.
    pub name: String,
    /// The words that the vocabulary does not have.
    pub unknown: Vec<String>,
    /// `[n + 1][dt]`: the memory, then the pooled vector.
    pub rows: Vec<f32>,
}

/// Reads a bank file.
///
/// # Errors
/// [`Error::Io`] and those of [`parse`].
pub fn read(path: &Path) -> Result<Vec<Prompt>, Error> {
    parse(&input::read_text(path, input::WRITTEN).map_err(|source| Error::Io { path: path.to_owned(), source })?)
}

/// Parses the text of a bank file.
///
/// # Errors
/// [`Error::Line`] for lines without a tab, names that are empty, too long or there twice, or without a prompt.
pub fn parse(text: &str) -> Result<Vec<Prompt>, Error> {
    let mut prompts: Vec<Prompt> = Vec::new();
    for (i, content) in text.trim_start_matches('\u{feff}').lines().enumerate() {
        let line = i + 1;
        let bad = |what: String| Err(Error::Line { line, what });
        if content.trim().is_empty() || content.starts_with('#') {
            continue;
        }
        let Some((name, prompt)) = content.split_once('\t') else { return bad("there is no tab".into()) };
        let (name, prompt) = (name.trim(), prompt.trim());
        if name.is_empty() || prompt.is_empty() {
            return bad(format!("the {} is empty", if name.is_empty() { "name" } else { "prompt" }));
        }
        if name.len() > MAX_NAME {
            return bad(format!("the name has {} bytes, at most {MAX_NAME} are allowed", name.len()));
        }
        if name == UNCONDITIONAL {
            return bad(format!("the name {UNCONDITIONAL} is that of the unconditional prompt"));
        }
        if let Some(other) = prompts.iter().find(|p| p.name == name) {
            return bad(format!("the name {name:?} is that of line {} already", other.line));
        }
        prompts.push(Prompt { line, name: name.to_owned(), text: prompt.to_owned() });
    }
    Ok(prompts)
}

/// Reads a bank file whose prompts are vectors: names, tabs, .npy files, relative ones beside the bank file.
///
/// # Errors
/// Those of [`read`]; [`Error::Vector`].
pub fn vectors(path: &Path) -> Result<Vec<Entry>, Error> {
    let folder = path.parent().unwrap_or(Path::new(""));
    let entry = |Prompt { line, name, text }: Prompt| {
        let rows =
            npy::vector(&folder.join(&text)).map_err(|source| Error::Vector { line, name: name.clone(), source })?;
        Ok(Entry { name, unknown: Vec::new(), rows })
    };
    read(path)?.into_iter().map(entry).collect()
}

/// Encodes prompts with the reference; `unconditional` puts the prompt of guidance in front of them.
///
/// # Errors
/// [`Error::Prompt`].
pub fn encode(checkpoint: &PriorCheckpoint, prompts: &[Prompt], unconditional: bool) -> Result<Vec<Entry>, Error> {
    let encoder = TextEncoder::<f32>::new(checkpoint);
    let entry = |name: &str, words: Words| {
        let encoded = encoder.encode(&words.ids);
        let rows = [encoded.memory, encoded.pooled].concat();
        Entry { name: name.to_owned(), unknown: words.unknown, rows }
    };
    let unconditional =
        unconditional.then(|| entry(UNCONDITIONAL, Words { ids: vec![text::UNCONDITIONAL], unknown: Vec::new() }));
    let mut entries: Vec<Entry> = unconditional.into_iter().collect();
    for Prompt { line, name, text } in prompts {
        let refused = |source| Error::Prompt { line: *line, name: name.clone(), source };
        entries.push(entry(name, encoder.read(text).map_err(refused)?));
    }
    Ok(entries)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines() {
        let text = "\u{feff}# greetings\nwave\ta person waves\r\n\n bow \t a person bows deeply \n";
        let prompts = parse(text).expect("a good file");
        let seen: Vec<_> = prompts.iter().map(|p| (p.line, p.name.as_str(), p.text.as_str())).collect();
        assert_eq!(seen, [(2, "wave", "a person waves"), (4, "bow", "a person bows deeply")]);
        for (text, line, word) in [
            ("wave a person waves", 1, "no tab"),
            ("a\tb\n\n\ta person", 3, "name is empty"),
            ("wave\t \n", 1, "prompt is empty"),
            ("a\tb\nb\tc\na\td", 3, "line 1"),
            ("<none>\tb", 1, "unconditional"),
            (&format!("{}\tb", "n".repeat(65)), 1, "65 bytes"),
        ] {
            let error = parse(text).expect_err(text);
            assert!(matches!(&error, Error::Line { line: l, .. } if *l == line), "{error}");
            assert!(error.to_string().contains(word), "{error}");
        }
    }
}
