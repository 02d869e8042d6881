//! Prompts from JSON lines: `{"text": "...", "actions": ["walk", ...], "styles": ["elderly", ...]}`, one a line.
//!
//! `actions` are canonical names of the table of actions, none for a prompt that asks for nothing a body could do; `styles` are styles of the dataset and may be left out, as
//! `then`: actions one of which is to come after one of `actions`. Blank lines and lines that begin with `#` are passed over.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use motionette_host::import::actions::Actions;
use motionette_host::input;
use serde_json::{Map, Value};

/// The fields of a line.
const FIELDS: [&str; 4] = ["text", "actions", "styles", "then"];

/// Why a file of prompts cannot be used. Lines count from 1.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The file cannot be read.
    #[error("cannot read the prompts in {}", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// There is no line with a prompt.
    #[error("{} has no prompts; write lines like {{\"text\": \"hop\", \"actions\": [\"jump\"], \"styles\": []}}", path.display())]
    Empty {
        /// The file.
        path: PathBuf,
    },
    /// A line is not a JSON object.
    #[error("{} line {line}: not a JSON object: {message}", path.display())]
    Json {
        /// The file.
        path: PathBuf,
        /// The line.
        line: usize,
        /// What the reader said.
        message: String,
    },
    /// A field is missing, of another type, or nobody knows it.
    #[error("{} line {line}, field {field:?}: {problem}", path.display())]
    Field {
        /// The file.
        path: PathBuf,
        /// The line.
        line: usize,
        /// The field.
        field: String,
        /// What is wrong with it and what to do.
        problem: String,
    },
}

/// A prompt and what it may show.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Line {
    /// Line of the file, from 1.
    pub number: usize,
    /// The prompt.
    pub text: String,
    /// Canonical actions that a fair person accepts; none where there is nothing to accept, and the model should say so.
    pub actions: Vec<String>,
    /// Styles that a fair person accepts; empty when none is asked for.
    pub styles: Vec<String>,
    /// Canonical actions of which one is to follow; empty for a prompt of one thing.
    pub then: Vec<String>,
}

impl Line {
    /// Whether there is nothing that a body could do of it.
    pub fn nonsense(&self) -> bool {
        self.actions.is_empty()
    }

    /// The actions and what the table accepts for each.
    pub fn accepted<'a>(&'a self, table: &'a Actions) -> BTreeSet<&'a str> {
        accepted(&self.actions, table)
    }

    /// The same of those that are to follow.
    pub fn accepted_then<'a>(&'a self, table: &'a Actions) -> BTreeSet<&'a str> {
        accepted(&self.then, table)
    }
}

fn accepted<'a>(actions: &'a [String], table: &'a Actions) -> BTreeSet<&'a str> {
    let also = |name: &String| table.find(name).map(|action| action.accept.as_slice()).unwrap_or_default();
    actions.iter().flat_map(|name| std::iter::once(name).chain(also(name))).map(String::as_str).collect()
}

/// Reads a file of prompts. `styles` are the names that are known.
///
/// # Errors
/// [`Error`], naming the file, and the line and field where there is one.
pub fn read(path: &Path, table: &Actions, styles: &BTreeSet<String>) -> Result<Vec<Line>, Error> {
    let text = input::read_text(path, input::WRITTEN).map_err(|source| Error::Read { path: path.into(), source })?;
    parse(path, &text, table, styles)
}

/// The texts alone of the prompts in a file, whatever else it says of them.
///
/// # Errors
/// As [`read`], but of other fields.
pub fn texts(path: &Path) -> Result<Vec<String>, Error> {
    let written = input::read_text(path, input::WRITTEN).map_err(|source| Error::Read { path: path.into(), source })?;
    let text = |(line, object): Numbered| {
        text_of(&object).map_err(|problem| Error::Field { path: path.into(), line, field: "text".into(), problem })
    };
    objects(path, &written)?.into_iter().map(text).collect()
}

/// A JSON object and its line, from 1.
type Numbered = (usize, Map<String, Value>);

/// The objects in `text`.
fn objects(path: &Path, text: &str) -> Result<Vec<Numbered>, Error> {
    let mut objects = Vec::new();
    for (index, written) in text.lines().enumerate() {
        if written.trim().is_empty() || written.trim_start().starts_with('#') {
            continue;
        }
        let json = |message: String| Error::Json { path: path.into(), line: index + 1, message };
        match serde_json::from_str(written).map_err(|error| json(error.to_string()))? {
            Value::Object(object) => objects.push((index + 1, object)),
            _ => return Err(json("it is another JSON value".into())),
        }
    }
    Ok(objects)
}

/// The prompt that an object holds, or what is wrong with it.
fn text_of(object: &Map<String, Value>) -> Result<String, String> {
    let text = object.get("text").ok_or("missing; give the prompt")?;
    Ok(text.as_str().ok_or_else(|| format!("{text} is no text"))?.to_owned())
}

/// The prompts in `text`; `path` is what errors name.
///
/// # Errors
/// As [`read`], but for [`Error::Read`].
pub fn parse(path: &Path, text: &str, table: &Actions, styles: &BTreeSet<String>) -> Result<Vec<Line>, Error> {
    let mut lines = Vec::new();
    for (number, object) in objects(path, text)? {
        let fail = |field: &str, problem: String| Error::Field {
            path: path.into(),
            line: number,
            field: field.into(),
            problem,
        };
        if let Some(other) = object.keys().find(|key| !FIELDS.contains(&key.as_str())) {
            return Err(fail(other, format!("unknown; fields are {}", FIELDS.join(", "))));
        }
        let text = text_of(&object).map_err(|problem| fail("text", problem))?;
        let names = |field: &str, known: &dyn Fn(&str) -> bool, kind: &str| -> Result<Vec<String>, Error> {
            let Some(value) = object.get(field) else { return Ok(Vec::new()) };
            let list = value.as_array().ok_or_else(|| fail(field, format!("{value} is no list of names")))?;
            let mut names: Vec<String> = Vec::with_capacity(list.len());
            for item in list {
                let name = item.as_str().ok_or_else(|| fail(field, format!("{item} is no name")))?;
                if !known(name) {
                    return Err(fail(field, format!("{name:?} is no {kind}")));
                }
                if names.iter().any(|other| other == name) {
                    return Err(fail(field, format!("{name:?} stands twice")));
                }
                names.push(name.to_owned());
            }
            Ok(names)
        };
        let action = |name: &str| table.find(name).is_some();
        let actions = names("actions", &action, "action of the table of actions")?;
        if !object.contains_key("actions") {
            return Err(fail(
                "actions",
                "missing; name canonical actions, or [] where a body can do nothing of it".into(),
            ));
        }
        let then = names("then", &action, "action of the table of actions")?;
        let styles = names("styles", &|name: &str| styles.contains(name), "style of the dataset")?;
        if actions.is_empty() && !(styles.is_empty() && then.is_empty()) {
            return Err(fail("actions", "empty; what has a style or a sequel has an action".into()));
        }
        lines.push(Line { number, text, actions, styles, then });
    }
    if lines.is_empty() { Err(Error::Empty { path: path.into() }) } else { Ok(lines) }
}
