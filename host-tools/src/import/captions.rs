//! HumanML3D's caption files: one `sentence#tagged words#from#to` a line, seconds, `0#0` for the whole motion.

use std::path::{Path, PathBuf};

use crate::dataset::Caption;
use crate::input;

/// Why a caption file cannot be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// It cannot be read.
    #[error("cannot read the captions {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A time is not a number, or ends before it begins.
    #[error("{} line {line}: {problem}; a line is SENTENCE, or SENTENCE#TAGS#FROM#TO with seconds", path.display())]
    Line {
        /// The file.
        path: PathBuf,
        /// Line, from 1.
        line: usize,
        /// What is wrong.
        problem: String,
    },
}

/// Reads a caption file; `source` is noted with every sentence. Lines with the sentence alone are taken as well; `nan` times mean 0, as in
/// some of HumanML3D's files.
///
/// # Errors
/// [`Error`], naming the file and the line.
pub fn read(path: &Path, source: &str) -> Result<Vec<Caption>, Error> {
    let bytes = input::read(path, input::ANY).map_err(|source| Error::Read { path: path.to_path_buf(), source })?;
    let text = String::from_utf8_lossy(&bytes);
    let lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
    lines
        .map(|(index, line)| {
            parse(line, source).map_err(|problem| Error::Line { path: path.to_path_buf(), line: index + 1, problem })
        })
        .collect()
}

fn parse(line: &str, source: &str) -> Result<Caption, String> {
    let fields: Vec<&str> = line.split('#').collect();
    let (from, to) = match fields[..] {
        [_] => (0.0, 0.0),
        [_, _, from, to] => (seconds(from)?, seconds(to)?),
        _ => return Err(format!("{} parts between # signs", fields.len())),
    };
    if to < from {
        return Err(format!("ends at {to} s, before its begin at {from} s"));
    }
    Ok(Caption { text: fields[0].trim().into(), from, to, source: source.into() })
}

fn seconds(field: &str) -> Result<f64, String> {
    match field.trim().parse::<f64>() {
        Ok(x) if x.is_nan() => Ok(0.0),
        Ok(x) if x.is_finite() && x >= 0.0 => Ok(x),
        _ => Err(format!("{:?} is not a time in seconds", field.trim().chars().take(40).collect::<String>())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_with_and_without_times() {
        let caption = parse("a man walks.#a/DET man/NOUN walk/VERB#1.5#3.0", "humanml3d").unwrap();
        assert_eq!(caption, Caption { text: "a man walks.".into(), from: 1.5, to: 3.0, source: "humanml3d".into() });
        assert_eq!(parse("only words", "x").unwrap().to, 0.0);
        assert_eq!(parse("x#y#nan#nan", "x").unwrap().from, 0.0);
        for bad in ["a#b#1", "a#b#x#2", "a#b#-1#2", "a#b#3#2", "a#b#inf#inf"] {
            assert!(parse(bad, "x").is_err(), "{bad}");
        }
    }
}
