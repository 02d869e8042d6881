//! `motionette convert OLD.blob -o NEW.blob` from outside.

use std::path::Path;
use std::process::{Command, Output};

use serde_json::Value;

fn corpus(name: &str) -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/corpus").join(name)
}

fn run(folder: &Path, line: &str) -> Output {
    let mut program = Command::new(env!("CARGO_BIN_EXE_motionette"));
    program.args(line.split_whitespace()).current_dir(folder).output().expect("the program starts")
}

/// Fails with status 1 and says all of `words`.
fn fails(folder: &Path, line: &str, words: &[&str]) {
    let output = run(folder, line);
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{line}: {said}");
    for word in words {
        assert!(said.contains(word), "{word:?} not in: {said}");
    }
}

#[test]
fn a_blob_of_format_3_becomes_one_of_format_4() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let folder = folder.path();
    std::fs::copy(corpus("format3/planner-of-four-bits.blob"), folder.join("old.blob")).expect("copied");

    // What its reader says is what to do.
    fails(folder, "inspect old.blob", &["version 3", "understands 4", "motionette convert OLD.blob -o NEW.blob"]);
    let output = run(folder, "convert old.blob -o new.blob --json");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{said}");
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let report: Value = serde_json::from_str(text.lines().last().unwrap_or_default()).expect("a report");
    assert_eq!((&report["from"], &report["version"]), (&Value::from("3.1"), &Value::from("4.0")));
    let (old, new) = (&report["old_weights_sha256"], &report["new_weights_sha256"]);
    assert_eq!((old, old.as_str().map(str::len)), (new, Some(64)));
    let printed = format!("{said}{text}");
    assert!(printed.matches(old.as_str().unwrap_or_default()).count() >= 2, "{printed}");
    let committed = std::fs::read(corpus("planner-of-four-bits.blob")).expect("the corpus");
    assert!(std::fs::read(folder.join("new.blob")).expect("written") == committed, "the corpus was lifted like this");
    assert!(run(folder, "inspect new.blob").status.success());

    // In place; twice is once too often, and leaves the file as it is.
    assert!(run(folder, "convert old.blob -o old.blob").status.success());
    fails(folder, "convert old.blob -o old.blob", &["old.blob", "format 4.0 already", "nothing to lift"]);
    assert!(std::fs::read(folder.join("old.blob")).expect("still there") == committed);
}

#[test]
fn what_cannot_be_lifted_writes_nothing() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let folder = folder.path();
    let old = std::fs::read(corpus("format3/narrow.blob")).expect("the corpus");
    std::fs::write(folder.join("old.blob"), &old).expect("written");
    std::fs::write(folder.join("cut.blob"), &old[..old.len() - 1]).expect("written");
    let mut damaged = old.clone();
    damaged[100] ^= 1;
    std::fs::write(folder.join("damaged.blob"), &damaged).expect("written");
    fails(folder, "convert cut.blob -o x.blob", &["cut.blob", "cut short"]);
    fails(folder, "convert damaged.blob -o x.blob", &["damaged.blob", "CRC-32"]);
    for options in ["--name n", "--licence MIT", "--planner-bits 4", "--no-refit", "--mean mean.npy", "--prior p"] {
        fails(folder, &format!("convert old.blob {options} -o x.blob"), &["old.blob is a blob", "nothing but -o"]);
    }
    assert!(!folder.join("x.blob").exists(), "x.blob was left behind");
}
