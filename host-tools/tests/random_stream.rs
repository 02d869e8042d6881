//! The runtime's seeded generator against another implementation of the same: rand_pcg's `Pcg32`.

use motionette::numerics::hash::Stream;
use rand_pcg::Pcg32;
use rand_pcg::rand_core::Rng as _;

/// The increment 1442695040888963407 is `2 stream + 1`.
const STREAM: u64 = 1_442_695_040_888_963_407 >> 1;

#[test]
fn seeds_give_the_numbers_of_rand_pcg() {
    for seed in [0, 1, 7, u64::from(u32::MAX), 0x0123_4567_89ab_cdef, u64::MAX] {
        let (mut ours, mut theirs) = (Stream::new(seed), Pcg32::new(seed, STREAM));
        for n in 0..10_000 {
            assert_eq!(ours.next_u32(), theirs.next_u32(), "seed {seed}, number {n}");
        }
    }
}
