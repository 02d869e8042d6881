//! A table of anchor control as Markdown and JSON.

use std::path::Path;

use motionette_host::output::{self, write_atomic};
use serde_json::{Map, Value, json};

use super::tables::Entry;
use crate::evaluate::report::Facts;

/// Figures in the order of the columns, with their heads; arrows say which way is better.
const COLUMNS: [(&str, &str); 27] = [
    ("control_error_cm", "control error, cm ↓"),
    ("control_error_p95_cm", "p95"),
    ("control_error_max_cm", "max"),
    ("trajectory_error", "trajectories missed ↓"),
    ("location_error", "places missed ↓"),
    ("unreachable", "anchors that no motion meets"),
    ("loosened", "anchors loosened"),
    ("fid", "FID ↓"),
    ("top3", "top-3 ↑"),
    ("action_accuracy", "action ↑"),
    ("foot_skating", "foot skating ↓"),
    ("foot_speed", "feet near the ground, m/s"),
    ("jerk", "jerk, m/s³"),
    ("jerk_at_anchors", "jerk at anchors"),
    ("speed", "fastest joint, m/s"),
    ("bone_mm", "bones off, mm ↓"),
    ("strain", "strain"),
    ("warned", "warned"),
    ("lost", "actions lost"),
    ("lost_warned", "of these warned ↑"),
    ("du", "‖u - u0‖"),
    ("diversity", "diversity →"),
    ("evaluations", "decoder evaluations"),
    ("seconds", "seconds a sample"),
    ("macs_m", "million MAC"),
    ("m7_instructions_m", "M7, million instructions"),
    ("parameters", "trainable parameters"),
];

/// A table and what is to be said of it.
pub struct Page<'a> {
    /// Name of its files and of the table.
    pub name: &'a str,
    /// Head line.
    pub title: &'a str,
    /// What the reader should know, Markdown.
    pub notes: String,
    /// Its rows.
    pub entries: &'a [Entry],
    /// What it was made from.
    pub facts: &'a Facts,
}

impl Page<'_> {
    /// `{"table", "rows", ...}`; each row `{"name", "family", "anchors", "k", metric: mean, metric_ci: half width}`, without `k` the mean over
    /// numbers of anchors; `anchors` are `own` or `foreign`.
    pub fn json(&self) -> Value {
        let row = |entry: &Entry| {
            let mut object = Map::new();
            object.insert("name".into(), json!(entry.row.name));
            object.insert("family".into(), json!(entry.family));
            object.insert("anchors".into(), json!(entry.targets));
            if let Some(k) = entry.k {
                object.insert("k".into(), json!(k));
            }
            if let Some(parameters) = entry.parameters {
                object.insert("parameters".into(), json!(parameters));
            }
            for (name, figure) in &entry.row.figures {
                object.insert((*name).to_owned(), json!(figure.mean));
                object.insert(format!("{name}_ci"), json!(figure.half_width));
            }
            Value::Object(object)
        };
        let Facts { seeds, files, command, generation } = self.facts;
        let files: Map<String, Value> = files.iter().map(|(name, hash)| (name.clone(), json!(hash))).collect();
        json!({
            "table": self.name,
            "rows": self.entries.iter().map(row).collect::<Vec<_>>(),
            "seeds": seeds,
            "files": files,
            "generation": generation,
            "command": command,
        })
    }

    /// The page for people: a table for each family, means over numbers of anchors first, then each number.
    pub fn markdown(&self) -> String {
        let mut text = format!("# {}\n\nMade by `{}`. {}\n", self.title, self.facts.command, self.notes);
        for (family, targets) in distinct(self.entries.iter().map(|entry| (entry.family, entry.targets))) {
            for means in [true, false] {
                let of =
                    |entry: &&Entry| (entry.family, entry.targets) == (family, targets) && entry.k.is_none() == means;
                let entries: Vec<&Entry> = self.entries.iter().filter(of).collect();
                let ks = distinct(entries.iter().filter_map(|entry| entry.k));
                let family = format!("{family}, {} targets", targets.name());
                let title = match ks.as_slice() {
                    [] => format!("{family}: means over numbers of anchors"),
                    [k] => format!("{family}: {k} anchors"),
                    _ => format!("{family}: by number of anchors"),
                };
                if !entries.is_empty() {
                    text += &section(&title, &entries, ks.len() > 1);
                }
            }
        }
        text += "\n## Made from\n\n| file | SHA-256 |\n|---|---|\n";
        for (name, hash) in &self.facts.files {
            text += &format!("| {name} | `{hash}` |\n");
        }
        text + &format!("\nGeneration: `{}`\n", self.facts.generation)
    }

    /// Writes `<name>.json` and `<name>.md` into a folder, each whole or not at all.
    ///
    /// # Errors
    /// [`output::Error`].
    pub fn save(&self, folder: &Path) -> Result<(), output::Error> {
        let mut data = serde_json::to_string_pretty(&self.json()).unwrap_or_default();
        data.push('\n');
        for (extension, text) in [("json", data), ("md", self.markdown())] {
            write_atomic(folder.join(format!("{}.{extension}", self.name)), |w| w.write_all(text.as_bytes()))?;
        }
        Ok(())
    }
}

/// Values without repetition, in their order.
fn distinct<T: PartialEq>(values: impl Iterator<Item = T>) -> Vec<T> {
    let mut found = Vec::new();
    for value in values {
        if !found.contains(&value) {
            found.push(value);
        }
    }
    found
}

fn section(title: &str, entries: &[&Entry], by_count: bool) -> String {
    let value = |entry: &Entry, name: &str| -> Option<String> {
        if name == "parameters" {
            return entry.parameters.map(|parameters| parameters.to_string());
        }
        let f = entry.row.figures.get(name)?;
        let digits = if f.mean.abs() >= 100.0 {
            0
        } else if f.mean.abs() >= 10.0 {
            1
        } else {
            3
        };
        Some(format!("{:.digits$} ± {:.digits$}", f.mean, f.half_width))
    };
    let shown: Vec<_> =
        COLUMNS.iter().filter(|(name, _)| entries.iter().any(|entry| value(entry, name).is_some())).collect();
    let heads: Vec<&str> = shown.iter().map(|(_, head)| *head).collect();
    let (k, rule) = if by_count { (" K |", "---|") } else { ("", "") };
    let mut text =
        format!("\n## {title}\n\n| row |{k} {} |\n|---|{rule}{}\n", heads.join(" | "), "---|".repeat(heads.len()));
    for entry in entries {
        let cells: Vec<String> = shown.iter().map(|(name, _)| value(entry, name).unwrap_or("-".into())).collect();
        let k = if by_count { format!(" {} |", entry.k.unwrap_or_default()) } else { String::new() };
        text += &format!("| {} |{k} {} |\n", entry.row.name, cells.join(" | "));
    }
    text
}
