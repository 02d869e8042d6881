//! The processor's floating-point environment, checked by its behaviour.

/// Whether arithmetic rounds to nearest even, keeps subnormal numbers and NaN payloads.
pub(super) fn floating_point_is_default() -> bool {
    use core::hint::black_box;
    // 1 + 2^-24 is a tie that goes to even; 1 + 3 * 2^-24 is one that goes up; both differ in every other mode.
    let half_step = f32::from_bits(0x3380_0000);
    let nearest = black_box(1.0f32) + black_box(half_step) == 1.0
        && black_box(-1.0f32) - black_box(half_step) == -1.0
        && black_box(1.0f32) + black_box(3.0 * half_step) == 1.0 + 4.0 * half_step;
    let subnormal = black_box(f32::MIN_POSITIVE) * black_box(0.5) != 0.0;
    let payload = (black_box(f32::from_bits(0x7FC0_1234)) + black_box(1.0)).to_bits() & 0x000F_FFFF == 0x0000_1234;
    nearest && subnormal && payload
}
