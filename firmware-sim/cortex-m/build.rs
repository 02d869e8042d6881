//! Chooses the memory map for the target, passes the linker scripts, and puts the model and the bundled token sequences
//! where the source can include them.

use std::{
    env, fs,
    path::{Path, PathBuf},
};

/// Where the trained default lies, seen from this package.
const DEFAULT_BLOB: &str = "../../models/nano.blob";
/// The bundled token sequences of recorded motions.
const CLIPS: &str = "../assets/clips.json";

fn main() {
    let out = PathBuf::from(env::var_os("OUT_DIR").expect("cargo sets OUT_DIR"));
    let package = PathBuf::from(env::var_os("CARGO_MANIFEST_DIR").expect("cargo sets CARGO_MANIFEST_DIR"));
    let target = env::var("TARGET").expect("cargo sets TARGET");
    let memory = match target.as_str() {
        "thumbv7em-none-eabihf" => "memory/m4-m7.x",
        "thumbv8m.main-none-eabihf" if env::var_os("CARGO_FEATURE_MVE").is_some() => "memory/m55.x",
        "thumbv8m.main-none-eabihf" => "memory/m33.x",
        other => panic!(
            "no memory map for {other}: build for thumbv7em-none-eabihf (M4F, M7) or thumbv8m.main-none-eabihf (M33; M55 with the feature `mve`)"
        ),
    };
    let blob_section = "memory/blob.x";
    let read = |name: &str| fs::read_to_string(package.join(name)).unwrap_or_else(|e| panic!("{name}: {e}"));
    fs::write(out.join("memory.x"), read(memory) + &read(blob_section)).expect("OUT_DIR is writable");
    for file in [memory, blob_section, "build.rs"] {
        println!("cargo::rerun-if-changed={file}");
    }
    println!("cargo::rustc-link-search={}", out.display());
    println!("cargo::rustc-link-arg-bins=-Tlink.x");
    println!("cargo::rustc-link-arg-bins=--nmagic");
    if env::var_os("CARGO_FEATURE_CHECK").is_some() {
        // Relocations stay in the image: they are the call sites that `cargo xtask twin` counts.
        println!("cargo::rustc-link-arg-bins=--emit-relocs");
    }
    let twin = env::var_os("CARGO_FEATURE_TWIN").is_some();
    if twin {
        println!("cargo::rustc-link-arg-bins=-Tdefmt.x");
    }
    if twin || env::var_os("CARGO_FEATURE_BENCH").is_some() {
        let blob = env::var_os("MOTIONETTE_BLOB").map_or_else(|| package.join(DEFAULT_BLOB), PathBuf::from);
        println!("cargo::rerun-if-env-changed=MOTIONETTE_BLOB");
        println!("cargo::rerun-if-changed={}", blob.display());
        fs::copy(&blob, out.join("model.blob")).unwrap_or_else(|e| {
            panic!("{}: {e}; train and convert a model first, or name another blob in MOTIONETTE_BLOB", blob.display())
        });
        let clips = package.join(CLIPS);
        println!("cargo::rerun-if-changed={}", clips.display());
        fs::write(out.join("recorded.rs"), recorded(&clips)).expect("OUT_DIR is writable");
    }
}

/// The bundled token sequences as a Rust expression of type `&[&[u16]]`.
fn recorded(clips: &Path) -> String {
    let text = fs::read_to_string(clips).unwrap_or_else(|e| panic!("{}: {e}", clips.display()));
    let bundle: serde_json::Value = serde_json::from_str(&text).unwrap_or_else(|e| panic!("{}: {e}", clips.display()));
    let clips = bundle["clips"].as_array().expect("`clips` is a list");
    let sequences: Vec<String> = clips.iter().map(|clip| format!("&{}", clip["tokens"])).collect();
    format!("&[{}]\n", sequences.join(", "))
}
