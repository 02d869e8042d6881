//! The table of actions (`docs/actions.toml`): one taxonomy over the labels of several collections.
//!
//! The file says for every raw label of every subset which canonical action it is and where its side comes from, and for every subset
//! its licence and who is held out for validation. Its form is described in `docs/data.md`.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::path::{Path, PathBuf};

use serde::Deserialize;
use toml::Spanned;

use super::table;
pub use super::table::Error;
use crate::dataset::Side;

/// What the file holds.
const WHAT: &str = "actions";
/// Stands for `left` and `right` in a name.
const SIDE: &str = "{side}";

/// What the table says of a collection.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Subset {
    /// Terms under which it may be used.
    pub licence: String,
    /// The actor whose training clips become the validation split.
    pub val_actor: Option<String>,
    /// Whether a model card can state its terms.
    #[serde(default = "yes")]
    pub card: bool,
    /// Left out of every import.
    #[serde(default)]
    pub withdrawn: bool,
}

fn yes() -> bool {
    true
}

/// A canonical action.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Action {
    /// Its name, unique.
    pub name: String,
    /// Canonical names that a judge may take for it.
    pub accept: Vec<String>,
    /// Everyday words that mean it.
    pub words: Vec<String>,
}

/// Where the side of a clip comes from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SideRule {
    /// The label says left.
    Left,
    /// The label says right.
    Right,
    /// The label says both.
    Both,
    /// There is none.
    None,
    /// Left or Right in the label or the name of the recording.
    Name,
    /// The hand that the pack names, or that moves more.
    Hand,
    /// The leg that the pack names, or that moves more.
    Leg,
    /// The way the heading turns.
    Turn,
}

/// What a raw label means.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Meaning {
    /// Name of the action, perhaps with `{side}`.
    template: String,
    /// Where the side comes from.
    pub side: SideRule,
    /// Whether the action is done with the legs.
    pub legs: bool,
}

impl Meaning {
    /// Canonical name of the action on this side; `None` when the action has a left and a right form and the side is neither.
    pub fn action(&self, side: Side) -> Option<String> {
        match side {
            _ if !self.template.contains(SIDE) => Some(self.template.clone()),
            Side::Left | Side::Right => Some(self.template.replace(SIDE, &side.to_string())),
            Side::Both | Side::None => None,
        }
    }
}

/// The whole table.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Actions {
    /// The file that it was read from.
    pub path: PathBuf,
    /// Collections by name.
    pub subsets: BTreeMap<String, Subset>,
    /// Canonical actions in the order of the file.
    pub actions: Vec<Action>,
    /// By subset and raw label.
    labels: HashMap<(String, String), Meaning>,
}

/// The file as it is written.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    subset: BTreeMap<String, Subset>,
    action: Vec<WrittenAction>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct WrittenAction {
    name: Spanned<String>,
    side: Option<SideRule>,
    #[serde(default)]
    legs: bool,
    words: Spanned<Vec<String>>,
    #[serde(default)]
    accept: Vec<Spanned<String>>,
    labels: BTreeMap<Spanned<String>, Vec<Spanned<WrittenLabel>>>,
}

#[derive(Deserialize)]
#[serde(untagged, deny_unknown_fields)]
enum WrittenLabel {
    Plain(String),
    Sided { label: String, side: SideRule },
}

impl Actions {
    /// Reads and checks a table.
    ///
    /// # Errors
    /// [`Error`], naming the file and the line.
    pub fn read(path: impl AsRef<Path>) -> Result<Self, Error> {
        let path = path.as_ref();
        Self::parse(path, &table::read(path, WHAT)?)
    }

    /// The table in `text`; `path` is what errors name.
    ///
    /// # Errors
    /// [`Error::Syntax`], [`Error::Entry`].
    pub fn parse(path: &Path, text: &str) -> Result<Self, Error> {
        let written: Written = table::parse(path, text, WHAT)?;
        let fail = |span: std::ops::Range<usize>, problem: String| {
            let before = text.get(..span.start).unwrap_or_default();
            Error::Entry { path: path.into(), line: before.matches('\n').count() + 1, problem }
        };
        let mut table = Self {
            path: path.into(),
            subsets: written.subset,
            actions: Vec::with_capacity(written.action.len()),
            labels: HashMap::new(),
        };
        let mut names: HashSet<String> = HashSet::new();
        for action in &written.action {
            let (name, words) = (action.name.get_ref(), action.words.get_ref());
            for action_name in sides(name) {
                let word = |c: char| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '-';
                if action_name.is_empty() || !action_name.chars().all(word) {
                    let problem = format!("the name {name:?} has other characters than a-z, 0-9, - and {SIDE}");
                    return Err(fail(action.name.span(), problem));
                }
                if !names.insert(action_name.clone()) {
                    let problem = format!("there are two actions {action_name:?}; give their labels to one of them");
                    return Err(fail(action.name.span(), problem));
                }
            }
            let different: BTreeSet<String> = words.iter().map(|word| word.trim().to_lowercase()).collect();
            if words.is_empty() || different.len() < words.len() || different.contains("") {
                let problem = format!("the words of {name:?} must be one or more, different and not empty");
                return Err(fail(action.words.span(), problem));
            }
            for (subset, labels) in &action.labels {
                if !table.subsets.contains_key(subset.get_ref()) {
                    let problem = format!("there is no [subset.{}]; add one with its licence", subset.get_ref());
                    return Err(fail(subset.span(), problem));
                }
                for label in labels {
                    let default = action.side.unwrap_or(SideRule::None);
                    let (raw, side) = match label.get_ref() {
                        WrittenLabel::Plain(raw) => (raw, default),
                        WrittenLabel::Sided { label, side } => (label, *side),
                    };
                    if name.contains(SIDE) && matches!(side, SideRule::None | SideRule::Both) {
                        let problem = format!("{raw:?} has no side, which the name {name:?} asks for; give it one");
                        return Err(fail(label.span(), problem));
                    }
                    let meaning = Meaning { template: name.clone(), side, legs: action.legs };
                    let key = (subset.get_ref().clone(), raw.clone());
                    if let Some(other) = table.labels.insert(key, meaning) {
                        let problem = format!(
                            "the label {raw:?} of {} belongs to {:?} already; keep it once",
                            subset.get_ref(),
                            other.template
                        );
                        return Err(fail(label.span(), problem));
                    }
                }
            }
        }
        for action in &written.action {
            let name = action.name.get_ref();
            for (index, expanded) in sides(name).into_iter().enumerate() {
                let mut accept = Vec::with_capacity(action.accept.len());
                for other in &action.accept {
                    let both = sides(other.get_ref());
                    if both.len() > 1 && !name.contains(SIDE) {
                        let problem = format!("{:?} has a side but {name:?} has none; name both", other.get_ref());
                        return Err(fail(other.span(), problem));
                    }
                    // A family's left form accepts the left form of the other.
                    let other_name = both.get(index).or(both.first()).cloned().unwrap_or_default();
                    if !names.contains(&other_name) || other_name == expanded {
                        let problem = format!("{name:?} accepts {other_name:?}, which is no other action");
                        return Err(fail(other.span(), problem));
                    }
                    accept.push(other_name);
                }
                table.actions.push(Action { name: expanded, accept, words: action.words.get_ref().clone() });
            }
        }
        Ok(table)
    }

    /// The action of this name.
    pub fn find(&self, name: &str) -> Option<&Action> {
        self.actions.iter().find(|action| action.name == name)
    }

    /// What the raw label of a subset means.
    pub fn meaning(&self, subset: &str, label: &str) -> Option<&Meaning> {
        self.labels.get(&(subset.to_owned(), label.to_owned()))
    }

    /// All subsets and raw labels that have a meaning.
    pub fn labels(&self) -> impl Iterator<Item = (&str, &str)> {
        self.labels.keys().map(|(subset, label)| (subset.as_str(), label.as_str()))
    }
}

/// A name, or its left and right form.
fn sides(name: &str) -> Vec<String> {
    if name.contains(SIDE) {
        ["left", "right"].map(|side| name.replace(SIDE, side)).to_vec()
    } else {
        vec![name.to_owned()]
    }
}
