//! The two small streams that the digital-twin contract rests on: a hash over bits and a seeded generator.

/// FNV-1a, 64 bits, over bytes in little-endian order.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Fnv(u64);

impl Default for Fnv {
    fn default() -> Self {
        Fnv(0xCBF2_9CE4_8422_2325)
    }
}

impl Fnv {
    /// Adds bytes.
    #[must_use]
    pub fn bytes(mut self, bytes: &[u8]) -> Self {
        for byte in bytes {
            self.0 = (self.0 ^ u64::from(*byte)).wrapping_mul(0x0000_0100_0000_01B3);
        }
        self
    }

    /// Adds the bits of singles.
    #[must_use]
    #[inline(never)]
    pub fn f32s(self, values: &[f32]) -> Self {
        values.iter().fold(self, |hash, v| hash.bytes(&v.to_bits().to_le_bytes()))
    }

    /// The hash so far.
    #[must_use]
    pub const fn value(self) -> u64 {
        self.0
    }
}

/// FNV-1a, 32 bits: how words are looked up.
#[must_use]
pub fn fnv32(bytes: &[u8]) -> u32 {
    bytes.iter().fold(0x811C_9DC5, |hash, byte| (hash ^ u32::from(*byte)).wrapping_mul(0x0100_0193))
}

/// Hash over every bit of a motion: its embeddings `u [L][du]`, then its joints `[T][22][3]`.
#[must_use]
pub fn motion(u: &[f32], joints: &[f32]) -> u64 {
    Fnv::default().f32s(u).f32s(joints).value()
}

/// Seeded generator: PCG-XSH-RR 64/32 (O'Neill 2014) with increment 1442695040888963407; the state begins at
/// `(seed + increment) * multiplier + increment`, and every output is made from the state before its step.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Stream(u64);

const MULTIPLIER: u64 = 6_364_136_223_846_793_005;
const INCREMENT: u64 = 1_442_695_040_888_963_407;

impl Stream {
    /// The stream of a seed.
    #[must_use]
    pub const fn new(seed: u64) -> Self {
        Stream(seed.wrapping_add(INCREMENT).wrapping_mul(MULTIPLIER).wrapping_add(INCREMENT))
    }

    /// The next 32 bits.
    pub fn next_u32(&mut self) -> u32 {
        let state = self.0;
        self.0 = state.wrapping_mul(MULTIPLIER).wrapping_add(INCREMENT);
        let mixed = (((state >> 18) ^ state) >> 27) as u32;
        mixed.rotate_right((state >> 59) as u32)
    }

    /// A number in `0..bound` (0 when `bound` is 0), by multiply and shift: the bias is below `bound / 2^32`.
    pub fn below(&mut self, bound: u32) -> u32 {
        ((u64::from(self.next_u32()) * u64::from(bound)) >> 32) as u32
    }

    /// A number in `[0, 1)` with 24 bits.
    pub fn unit(&mut self) -> f32 {
        (self.next_u32() >> 8) as f32 * (1.0 / 16_777_216.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fnv_of_published_vectors() {
        assert_eq!(Fnv::default().value(), 0xcbf2_9ce4_8422_2325);
        assert_eq!(Fnv::default().bytes(b"a").value(), 0xaf63_dc4c_8601_ec8c);
        assert_eq!(Fnv::default().bytes(b"foobar").value(), 0x8594_4171_f739_67e8);
    }

    #[test]
    fn stream_of_the_reference_generator() {
        // pcg32_srandom_r(42, 54) of the PCG reference has increment 54 * 2 + 1; ours is fixed, so compare with a
        // plain restatement in 128-bit arithmetic instead.
        let (multiplier, increment, modulus) = (u128::from(MULTIPLIER), u128::from(INCREMENT), 1u128 << 64);
        let mut state = ((7 + increment) * multiplier + increment) % modulus;
        let mut stream = Stream::new(7);
        for _ in 0..100 {
            let mixed = (((state >> 18) ^ state) >> 27) & 0xFFFF_FFFF;
            let turn = (state >> 59) as u32;
            let expected = (mixed as u32).rotate_right(turn);
            state = (state * multiplier + increment) % modulus;
            assert_eq!(stream.next_u32(), expected);
        }
        assert!((0..1000).all(|_| stream.below(10) < 10 && stream.unit() < 1.0));
    }
}
