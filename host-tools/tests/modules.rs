//! The modules of the host tools stand on each other in one direction only: each can be read, and changed, without those above it.
//!
//! What it cannot see: files of one module that need each other, and names that come in through a macro.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// The modules that the text of a module names, itself included.
fn named(text: &str) -> BTreeSet<String> {
    let code: Vec<&str> = text.lines().filter(|line| !line.trim_start().starts_with("//")).collect();
    let code = code.join("\n");
    let word = |s: &str| s.trim_start().split(|c: char| !(c.is_alphanumeric() || c == '_')).next().map(str::to_owned);
    let after = code.split("crate::").skip(1);
    after
        .flat_map(|rest| match rest.strip_prefix('{') {
            Some(list) => list.split('}').next().unwrap_or_default().split(',').filter_map(word).collect(),
            None => word(rest).into_iter().collect::<Vec<_>>(),
        })
        .filter(|name| !name.is_empty())
        .collect()
}

/// All text below a file or a folder.
fn text(path: &Path, into: &mut String) {
    if path.is_dir() {
        std::fs::read_dir(path).expect("a folder").for_each(|entry| text(&entry.expect("an entry").path(), into));
    } else if path.extension().is_some_and(|e| e == "rs") {
        into.push_str(&std::fs::read_to_string(path).expect("a source file"));
    }
}

/// A way from `at` back to a module that is on it already.
fn circle(uses: &BTreeMap<String, BTreeSet<String>>, at: &str, way: &mut Vec<String>) -> Option<Vec<String>> {
    if let Some(first) = way.iter().position(|module| module == at) {
        return Some(way[first..].to_vec());
    }
    let used = uses.get(at)?;
    way.push(at.to_owned());
    let found = used.iter().find_map(|next| circle(uses, next, way));
    way.pop();
    found
}

#[test]
fn no_module_uses_one_that_uses_it() {
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut uses = BTreeMap::new();
    for entry in std::fs::read_dir(source).expect("the source") {
        let path = entry.expect("an entry").path();
        let module = path.file_stem().expect("a name").to_string_lossy().into_owned();
        if ["lib", "main"].contains(&module.as_str()) {
            continue;
        }
        let mut all = String::new();
        text(&path, &mut all);
        let mut names = named(&all);
        names.remove(&module);
        uses.insert(module, names);
    }
    assert!(uses["convert"].contains("blob") && uses["dataset"].contains("reference"), "nothing was read: {uses:?}");
    for module in uses.keys() {
        if let Some(way) = circle(&uses, module, &mut Vec::new()) {
            panic!("a circle: {}", way.join(" -> "));
        }
    }
}

#[test]
fn a_circle_is_found() {
    let uses = [("a", "b"), ("b", "c"), ("c", "b")].map(|(from, to)| (from.to_owned(), [to.to_owned()].into()));
    assert_eq!(circle(&uses.into(), "a", &mut Vec::new()).expect("b and c"), ["b", "c"]);
    assert_eq!(named("use crate::{one, two::Three};\n// crate::four\nlet x = crate::five::six();").len(), 3);
}
