//! Sine and cosine within a turn, with the bits of `libm`'s `sinf` and `cosf`.

/// Bits of the largest magnitude that `libm` reduces without its general reduction, about `9 pi / 4`.
const LARGEST: u32 = 0x40E2_31D5;

/// Sine and cosine of `x`, radians, `|x| <= 7`; those of 0 beyond.
///
/// Angles here lie within a turn. Saying so in the bits that `libm` looks at leaves its reduction of large angles, 4 KiB of
/// double precision arithmetic, out of the program.
#[inline(never)]
pub fn sin_cos(x: f32) -> (f32, f32) {
    if x.to_bits() & 0x7FFF_FFFF > LARGEST { (0.0, 1.0) } else { libm::sincosf(x) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_are_those_of_sine_and_cosine() {
        for magnitude in (0..=LARGEST).step_by(997).chain([LARGEST]) {
            for bits in [magnitude, magnitude | 0x8000_0000] {
                let x = f32::from_bits(bits);
                let (sin, cos) = sin_cos(x);
                let want = (libm::sinf(x).to_bits(), libm::cosf(x).to_bits());
                assert_eq!((sin.to_bits(), cos.to_bits()), want, "{x:e}");
            }
        }
        for x in [7.1, -7.1, 1e30, f32::INFINITY, f32::NAN] {
            assert_eq!(sin_cos(x), (0.0, 1.0));
        }
    }
}
