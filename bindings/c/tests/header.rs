//! The committed C header is the one that the source gives.

use std::{env, fs, path::Path};

#[test]
fn the_header_is_current() {
    let package = Path::new(env!("CARGO_MANIFEST_DIR"));
    let path = package.join("include/motionette.h");
    let mut made = Vec::new();
    cbindgen::generate(package).expect("cbindgen reads the source").write(&mut made);
    let made = String::from_utf8(made).expect("source is UTF-8");
    // cbindgen makes macros of associated constants of the runtime's types as well, some out of names that do not exist.
    let ours = |name: &str| name.starts_with("MTN_") || name.starts_with("MOTIONETTE_");
    let all_ours = |item: &&str| item.lines().filter_map(|line| line.strip_prefix("#define ")).all(ours);
    // Where they stood, nothing stays.
    let said = |item: &&str| !item.trim().is_empty();
    let made: String = made.split_inclusive("\n\n").filter(all_ours).filter(said).collect();
    if env::var_os("MOTIONETTE_WRITE_HEADER").is_some() {
        fs::write(&path, &made).expect("the header can be written");
    }
    let committed = fs::read_to_string(&path).unwrap_or_default();
    let differs = made.lines().zip(committed.lines()).position(|(a, b)| a != b);
    let line = differs.unwrap_or(made.lines().count().min(committed.lines().count())) + 1;
    assert!(made == committed, "include/motionette.h differs at line {line}: run `cargo xtask c --write-header`");
}
