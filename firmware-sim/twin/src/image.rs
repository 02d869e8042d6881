//! What the linker put into an image: code size, call sites of panics, floating-point instructions that round once for two
//! operations.

use anyhow::{Context, Result};
use object::{Object, ObjectSection, ObjectSymbol, RelocationTarget, SectionKind, SymbolKind, read::elf::ElfFile32};

/// Bytes of `.text` and `.rodata`: code and its constants, without vector table and model.
///
/// # Errors
/// When `elf` is no 32-bit ELF file.
pub fn text_bytes(elf: &[u8]) -> Result<u64> {
    sum(elf, &[".text", ".rodata"])
}

/// Bytes of flash that a board's image takes: everything that is loaded.
///
/// # Errors
/// When `elf` is no 32-bit ELF file.
pub fn flash_bytes(elf: &[u8]) -> Result<u64> {
    sum(elf, &[".vector_table", ".start_block", ".text", ".bi_entries", ".rodata", ".data", ".end_block"])
}

/// Bytes of `.data`, `.bss` and `.uninit`: static RAM.
///
/// # Errors
/// When `elf` is no 32-bit ELF file.
pub fn static_ram_bytes(elf: &[u8]) -> Result<u64> {
    sum(elf, &[".data", ".bss", ".uninit"])
}

fn sum(elf: &[u8], names: &[&str]) -> Result<u64> {
    let file = parse(elf)?;
    Ok(names.iter().filter_map(|name| file.section_by_name(name)).map(|section| section.size()).sum())
}

fn parse(elf: &[u8]) -> Result<ElfFile32<'_>> {
    ElfFile32::parse(elf).context("the image is no 32-bit ELF file")
}

/// One place where live code may begin to panic.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct PanicSite {
    /// Function that contains the call.
    pub caller: String,
    /// Function that panics.
    pub callee: String,
}

/// Start and name of every function, in order of their addresses.
///
/// # Errors
/// When `elf` is no 32-bit ELF file.
pub fn functions(elf: &[u8]) -> Result<Vec<(u64, String)>> {
    let file = parse(elf)?;
    let mut functions: Vec<(u64, String)> = file
        .symbols()
        .filter(|symbol| symbol.kind() == SymbolKind::Text && symbol.is_definition())
        .filter_map(|symbol| Some((symbol.address() & !1, demangle(symbol.name().ok()?))))
        .collect();
    functions.sort();
    Ok(functions)
}

/// Every reference from live code to a function that panics, read from the relocations that `--emit-relocs` kept.
///
/// # Errors
/// When `elf` is no 32-bit ELF file.
pub fn panic_sites(elf: &[u8]) -> Result<Vec<PanicSite>> {
    let file = parse(elf)?;
    let mut functions: Vec<(u64, u64, String)> = file
        .symbols()
        .filter(|symbol| symbol.kind() == SymbolKind::Text && symbol.size() > 0)
        .filter_map(|symbol| Some((symbol.address() & !1, symbol.size(), demangle(symbol.name().ok()?))))
        .collect();
    functions.sort();
    let containing = |address: u64| {
        let after = functions.partition_point(|(start, _, _)| *start <= address);
        functions[..after].iter().rev().find(|(start, size, _)| address < start + size).map(|(_, _, name)| name.clone())
    };
    let mut sites = Vec::new();
    for section in
        file.sections().filter(|section| matches!(section.kind(), SectionKind::Text | SectionKind::ReadOnlyData))
    {
        for (address, relocation) in section.relocations() {
            let RelocationTarget::Symbol(index) = relocation.target() else { continue };
            let symbol = file.symbol_by_index(index)?;
            // A reference to a section's start plus an addend names no function.
            let callee = match symbol.kind() {
                SymbolKind::Section => containing(symbol.address()).unwrap_or_default(),
                _ => demangle(symbol.name()?),
            };
            if !panics(&callee) {
                continue;
            }
            let caller = containing(address).unwrap_or_else(|| section.name().unwrap_or("?").to_owned());
            if !panics(&caller) {
                sites.push(PanicSite { caller, callee });
            }
        }
    }
    sites.sort();
    Ok(sites)
}

/// True for functions of `core` whose only purpose is to begin a panic, and for the panic handler.
fn panics(function: &str) -> bool {
    let of_core = function.starts_with("core::") || function.starts_with("<core::");
    of_core
        && function
            .split("::")
            .any(|part| part.contains("panic") || part.ends_with("_fail") || part.ends_with("_failed"))
        || function.ends_with("rust_begin_unwind")
}

fn demangle(name: &str) -> String {
    format!("{:#}", rustc_demangle::demangle(name))
}

/// Counts multiply-add instructions on single or double precision in the image's functions: fused ones (`vfma`, `vfms`,
/// `vfnma`, `vfnms`), which round once, and chained ones (`vmla`, `vmls`, `vnmla`, `vnmls`), which round product and sum as
/// two separate instructions would.
///
/// # Errors
/// When `elf` is no 32-bit ELF file.
pub fn multiply_adds(elf: &[u8]) -> Result<(usize, usize)> {
    let file = parse(elf)?;
    // Mapping symbols of the ARM ELF specification: `$t` begins Thumb code, `$d` data, both up to the next one.
    let in_code = |symbol: &object::read::elf::ElfSymbol32<'_, '_>| {
        let section = symbol.section_index().and_then(|index| file.section_by_index(index).ok());
        section.is_some_and(|section| section.kind() == SectionKind::Text)
    };
    let mut marks: Vec<(u64, bool)> = file
        .symbols()
        .filter(in_code)
        .filter_map(|symbol| {
            let name = symbol.name().ok()?;
            let kind = name.split('.').next()?;
            matches!(kind, "$t" | "$d").then_some((symbol.address(), kind == "$t"))
        })
        .collect();
    marks.sort_unstable();
    let is_code = |address: u64| {
        let after = marks.partition_point(|(at, _)| *at <= address);
        after > 0 && marks[after - 1].1
    };
    let mut count = MultiplyAdds::default();
    for section in file.sections().filter(|section| section.kind() == SectionKind::Text) {
        let start = section.address();
        count.add(section.data()?, |offset| is_code(start + offset as u64));
    }
    Ok((count.fused, count.chained))
}

/// Multiply-add instructions found so far.
#[derive(Debug, Default, PartialEq, Eq)]
struct MultiplyAdds {
    fused: usize,
    chained: usize,
}

impl MultiplyAdds {
    /// Adds those of Thumb `code`; `is_code` tells code from literal pools by byte offset.
    fn add(&mut self, code: &[u8], is_code: impl Fn(usize) -> bool) {
        let half = |offset: usize| code.get(offset..offset + 2).map(|b| u16::from_le_bytes([b[0], b[1]]));
        let mut offset = 0;
        while let Some(first) = half(offset) {
            if !is_code(offset) || first < 0xE800 {
                offset += 2;
                continue;
            }
            let second = half(offset + 2).unwrap_or(0);
            // Coprocessor 10 (single) or 11 (double), data processing; the D bit of the first halfword is free.
            if matches!(second & 0x0F10, 0x0A00 | 0x0B00) {
                match first & 0xFFB0 {
                    // VFNMA and VFNMS, VFMA and VFMS.
                    0xEE90 | 0xEEA0 => self.fused += 1,
                    // VMLA and VMLS, VNMLA and VNMLS.
                    0xEE00 | 0xEE10 => self.chained += 1,
                    _ => {}
                }
            }
            offset += 4;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn count(halves: &[u16], is_code: bool) -> (usize, usize) {
        let code: Vec<u8> = halves.iter().flat_map(|half| half.to_le_bytes()).collect();
        let mut count = MultiplyAdds::default();
        count.add(&code, |_| is_code);
        (count.fused, count.chained)
    }

    /// Encodings from an assembler (`.cpu cortex-m7`, `.fpu fpv5-d16`), first halfword first.
    #[test]
    fn multiply_adds_are_told_from_other_instructions() {
        let cases: [(&str, [u16; 2], (usize, usize)); 12] = [
            ("vfma.f32 s0, s1, s2", [0xEEA0, 0x0A81], (1, 0)),
            ("vfms.f32 s0, s1, s2", [0xEEA0, 0x0AC1], (1, 0)),
            ("vfnma.f32 s0, s1, s2", [0xEE90, 0x0AC1], (1, 0)),
            ("vfma.f32 s1, s1, s2", [0xEEE0, 0x0A81], (1, 0)),
            ("vfma.f64 d0, d1, d2", [0xEEA1, 0x0B02], (1, 0)),
            ("vmla.f32 s0, s1, s2", [0xEE00, 0x0A81], (0, 1)),
            ("vnmls.f32 s0, s1, s2", [0xEE10, 0x0A81], (0, 1)),
            ("vmul.f32 s0, s1, s2", [0xEE20, 0x0A81], (0, 0)),
            ("vadd.f32 s0, s1, s2", [0xEE30, 0x0A81], (0, 0)),
            ("vdiv.f32 s0, s1, s2", [0xEE80, 0x0A81], (0, 0)),
            ("vmov s1, r0", [0xEE00, 0x0A90], (0, 0)),
            ("smlad r0, r1, r2, r3", [0xFB21, 0x3002], (0, 0)),
        ];
        for (text, halves, expected) in cases {
            assert_eq!(count(&halves, true), expected, "{text}");
        }
        assert_eq!(count(&[0xEEA0, 0x0A81], false), (0, 0), "a constant in a literal pool is no instruction");
        assert_eq!(count(&[0xBF00, 0xEEA0, 0x0A81], true), (1, 0), "a halfword instruction goes before");
        assert_eq!(count(&[0xF8D0, 0xEEA0, 0x0A81, 0xBF00], true), (0, 0), "second half of a load");
    }

    #[test]
    fn panicking_functions_are_recognised() {
        for name in [
            "core::panicking::panic_bounds_check",
            "core::slice::index::slice_end_index_len_fail",
            "core::option::unwrap_failed",
            "core::panicking::panic_const::panic_const_div_by_zero",
            "__rustc::rust_begin_unwind",
        ] {
            assert!(panics(name), "{name}");
        }
        for name in ["motionette::blob::Model::open", "core::fmt::write", "Reset", "my::panic_button::pressed"] {
            assert!(!panics(name), "{name}");
        }
    }
}
