//! The runtime's public road and nothing else: measures code size and finds call sites of panics.
//!
//! Blob, arena and request come through pointers that the optimiser cannot see through, so nothing of the runtime is
//! folded away. The image is linked and inspected, never run. With the feature `gate` its panic handler calls a symbol
//! that nobody defines, so that one reachable panic fails the link.
#![no_std]
#![no_main]

#[cfg(feature = "generate")]
mod generate;
#[cfg(feature = "playback")]
mod play;

use core::{hint::black_box, panic::PanicInfo};

use cortex_m as _;
use cortex_m_rt::entry;

#[entry]
fn main() -> ! {
    // Slices, so that the optimiser does not know their lengths.
    let blob: &[u8] = black_box(&[]);
    #[cfg(feature = "planted")]
    black_box(blob[black_box(7)]);
    #[cfg(feature = "generate")]
    {
        let mut arena = [0u8; 64];
        let anchors = [motionette::Anchor::root(0, [0.0; 3])];
        let fixed = [motionette::Fixed { position: 0, token: 0 }];
        let (tokens, u, text): (&[u16], &[f32], &str) = black_box((&[0], &[], "wave"));
        let (anchors, fixed): (&[motionette::Anchor], &[motionette::Fixed]) = black_box((&anchors, &fixed));
        let result = generate::serve(blob, black_box(&mut arena), tokens, u, anchors, (text, fixed));
        let _ = black_box(result);
    }
    #[cfg(all(feature = "playback", not(feature = "generate")))]
    {
        let _ = black_box(play::play(blob, black_box(&[]), None));
    }
    loop {
        cortex_m::asm::nop();
    }
}

#[cfg(not(feature = "gate"))]
#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    loop {
        cortex_m::asm::nop();
    }
}

#[cfg(feature = "gate")]
#[panic_handler]
fn panic(_: &PanicInfo<'_>) -> ! {
    unsafe extern "C" {
        safe fn a_panic_is_reachable() -> !;
    }
    a_panic_is_reachable()
}
