//! Chooses the kernels of Cortex-M targets: rustc tells neither DSP, MVE nor floating-point instructions of a stable target.

use std::env;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    println!("cargo::rustc-check-cfg=cfg(kernels, values(none(), \"dsp\", \"mve\"))");
    println!("cargo::rustc-check-cfg=cfg(kernels_v8)");
    println!("cargo::rustc-check-cfg=cfg(fpu)");
    let target = env::var("TARGET").unwrap_or_default();
    if target.starts_with("thumb") && target.ends_with("eabihf") {
        println!("cargo::rustc-cfg=fpu");
    }
    let wanted = |feature: &str| env::var_os(format!("CARGO_FEATURE_{feature}")).is_some();
    // Every Armv7E-M core has the DSP extension; on Armv8-M it is the chip's choice, hence the firmware's.
    let v8 = target.starts_with("thumbv8m.main");
    let kernels = match (v8, target.starts_with("thumbv7em")) {
        (true, _) if wanted("MVE") => "mve",
        (true, _) if wanted("DSP") => "dsp",
        (_, true) => "dsp",
        _ => return,
    };
    println!("cargo::rustc-cfg=kernels");
    println!("cargo::rustc-cfg=kernels=\"{kernels}\"");
    if v8 {
        println!("cargo::rustc-cfg=kernels_v8");
    }
}
