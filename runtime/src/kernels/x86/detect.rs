//! Which instructions may be used: the processor has them, and the system saves the registers they need.
//!
//! CPUID leaves 1 and 7 and XCR0: Intel 64 and IA-32 Architectures Software Developer's Manual, volume 1, chapters 13.2
//! (XSAVE-managed state), 14.3 (AVX) and 15.2 (AVX-512); volume 2, CPUID (leaf 7.1).

use core::arch::x86_64::{__cpuid, __cpuid_count, _xgetbv};
use core::sync::atomic::{AtomicU8, Ordering};

/// Instructions that a variant is written for, the best last. Each includes those before it, but AVX-512 not all of AVX-VNNI.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum Isa {
    /// What every target has.
    Portable = 1,
    /// AVX2.
    Avx2 = 2,
    /// AVX2 and AVX-VNNI.
    AvxVnni = 3,
    /// AVX-512 F, BW, VL and VNNI.
    Avx512 = 4,
}

/// [`Isa::best`] as a number; 0 before it was asked for.
static BEST: AtomicU8 = AtomicU8::new(0);

/// CPUID.1:ECX: OSXSAVE, AVX.
const LEAF1_ECX: u32 = 1 << 27 | 1 << 28;
/// CPUID.7.0:EBX: AVX2.
const LEAF7_EBX_AVX2: u32 = 1 << 5;
/// CPUID.7.0:EBX: AVX512F, AVX512BW, AVX512VL.
const LEAF7_EBX_AVX512: u32 = 1 << 16 | 1 << 30 | 1 << 31;
/// CPUID.7.0:ECX: AVX512_VNNI.
const LEAF7_ECX_AVX512: u32 = 1 << 11;
/// CPUID.7.1:EAX: AVX-VNNI.
const LEAF7_1_EAX_VNNI: u32 = 1 << 4;
/// XCR0: XMM, YMM.
const XCR0_AVX: u64 = 0b110;
/// XCR0: mask registers and both halves of ZMM as well.
const XCR0_AVX512: u64 = 0b1110_0110;

impl Isa {
    /// The best that processor and system support.
    #[inline]
    pub fn best() -> Isa {
        match BEST.load(Ordering::Relaxed) {
            1 => Isa::Portable,
            2 => Isa::Avx2,
            3 => Isa::AvxVnni,
            4 => Isa::Avx512,
            _ => {
                let isa = detect();
                BEST.store(isa as u8, Ordering::Relaxed);
                isa
            }
        }
    }

    /// This one if it is supported, else the best that is.
    #[inline]
    pub fn supported(self) -> Isa {
        match Isa::best() {
            Isa::Avx512 if self == Isa::AvxVnni => Isa::Avx2,
            best if self > best => best,
            _ => self,
        }
    }
}

#[cold]
fn detect() -> Isa {
    let has = |found: u32, wanted: u32| found & wanted == wanted;
    if __cpuid(0).eax < 7 || !has(__cpuid(1).ecx, LEAF1_ECX) {
        return Isa::Portable;
    }
    // SAFETY: OSXSAVE is set, so the system has enabled XGETBV.
    let saved = unsafe { xcr0() };
    let leaf = __cpuid_count(7, 0);
    if saved & XCR0_AVX != XCR0_AVX || !has(leaf.ebx, LEAF7_EBX_AVX2) {
        Isa::Portable
    } else if saved & XCR0_AVX512 == XCR0_AVX512 && has(leaf.ebx, LEAF7_EBX_AVX512) && has(leaf.ecx, LEAF7_ECX_AVX512) {
        Isa::Avx512
    } else if leaf.eax >= 1 && has(__cpuid_count(7, 1).eax, LEAF7_1_EAX_VNNI) {
        Isa::AvxVnni
    } else {
        Isa::Avx2
    }
}

/// The state components that the system saves.
#[target_feature(enable = "xsave")]
fn xcr0() -> u64 {
    // SAFETY: register 0 exists wherever XGETBV does.
    unsafe { _xgetbv(0) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::is_x86_feature_detected as has;

    #[test]
    fn agrees_with_the_standard_library() {
        let avx512 = has!("avx512f") && has!("avx512bw") && has!("avx512vl") && has!("avx512vnni");
        let best = if !has!("avx2") {
            Isa::Portable
        } else if avx512 {
            Isa::Avx512
        } else if has!("avxvnni") {
            Isa::AvxVnni
        } else {
            Isa::Avx2
        };
        assert_eq!(Isa::best(), best);
        assert_eq!(Isa::Portable.supported(), Isa::Portable);
        assert_eq!(Isa::Avx512.supported(), best);
        assert_eq!(Isa::AvxVnni.supported(), if best == Isa::Avx512 { Isa::Avx2 } else { best });
    }
}
