//! `expf` and `erff` of the crate `libm` without branches, so that the compiler computes several values at a time: the
//! same operations in the same order, hence the same bits. The numbers are FreeBSD's (`e_expf.c`, `s_erff.c`).
#![allow(clippy::excessive_precision)]

/// Values computed at a time.
const LANES: usize = 8;

/// `x[i] <- exp(x[i])`.
#[inline(always)]
pub fn exp(x: &mut [f32]) {
    map(x, |v| v <= 0.0 && magnitude(v) < 0x42AE_AC50, exp_lane, ::libm::expf);
}

/// `x[i] <- x[i]/2 (1 + erf(x[i] / sqrt 2))`.
#[inline(always)]
pub fn gelu(x: &mut [f32]) {
    const ROOT: f32 = core::f32::consts::FRAC_1_SQRT_2;
    let finite = |v| magnitude(v) < 0x7F80_0000;
    map(x, finite, |v| 0.5 * v * (1.0 + erf_lane(v * ROOT)), |v| 0.5 * v * (1.0 + ::libm::erff(v * ROOT)));
}

/// Applies `lane` to blocks all of whose values are `inside`, `scalar` to the others.
#[inline(always)]
fn map(x: &mut [f32], inside: impl Fn(f32) -> bool, lane: impl Fn(f32) -> f32, scalar: impl Fn(f32) -> f32) {
    let (blocks, rest) = x.as_chunks_mut::<LANES>();
    for block in blocks {
        if block.iter().fold(true, |all, v| all & inside(*v)) {
            for v in block {
                *v = lane(*v);
            }
        } else {
            for v in block {
                *v = scalar(*v);
            }
        }
    }
    for v in rest {
        *v = scalar(*v);
    }
}

#[inline(always)]
fn magnitude(x: f32) -> u32 {
    x.to_bits() & 0x7FFF_FFFF
}

/// `expf` for `-87.33655 < x <= 0`.
#[inline(always)]
fn exp_lane(x: f32) -> f32 {
    let size = magnitude(x);
    let far = 1.442_695_021_6 * x - 0.5;
    // SAFETY: `far` is between -127 and 0.
    let far: i32 = unsafe { far.to_int_unchecked() };
    let near = if size > 0x3EB1_7218 { -1 } else { 0 };
    let k = if size > 0x3F85_1592 { far } else { near };
    let kf = k as f32;
    let hi = x - kf * 6.931_457_519_5e-1;
    let lo = kf * 1.428_606_765_3e-6;
    let r = hi - lo;
    let rr = r * r;
    let c = r - rr * (1.666_662_544_0e-1 + rr * -2.766_733_290_6e-3);
    let y = 1.0 + (r * c / (2.0 - c) - lo + hi);
    let y = if size > 0x3900_0000 { y } else { 1.0 + x };
    y * f32::from_bits(((127 + k) as u32) << 23)
}

/// `erff` for finite `x`.
#[inline(always)]
fn erf_lane(x: f32) -> f32 {
    let size = magnitude(x);
    let a = f32::from_bits(size);

    let z = x * x;
    let r = 1.283_791_661_3e-1
        + z * (-3.250_420_987_6e-1 + z * (-2.848_174_981_8e-2 + z * (-5.770_270_247_0e-3 + z * -2.376_301_745_2e-5)));
    let s = 1.0
        + z * (3.979_172_110_6e-1
            + z * (6.502_225_250_0e-2 + z * (5.081_306_211_7e-3 + z * (1.324_947_370_4e-4 + z * -3.960_228_241_3e-6))));
    let small = x + x * (r / s);
    let tiny = 0.125 * (8.0 * x + 1.027_033_329_0 * x);
    let small = if size < 0x3180_0000 { tiny } else { small };

    let t = a - 1.0;
    let p = -2.362_118_568_3e-3
        + t * (4.148_561_060_4e-1
            + t * (-3.722_078_800_2e-1
                + t * (3.183_466_196_1e-1
                    + t * (-1.108_946_949_2e-1 + t * (3.547_830_507_2e-2 + t * -2.166_375_517_8e-3)))));
    let q = 1.0
        + t * (1.064_208_820_5e-1
            + t * (5.403_979_420_7e-1
                + t * (7.182_865_589_9e-2
                    + t * (1.261_712_163_7e-1 + t * (1.363_708_358_3e-2 + t * 1.198_450_010_3e-2)))));
    let middle = 1.0 - 8.450_629_115_1e-1 - p / q;

    let u = 1.0 / (a * a);
    let ra = -9.864_944_033_3e-3
        + u * (-6.938_585_639_0e-1
            + u * (-1.055_862_617_5e+1
                + u * (-6.237_533_187_9e+1
                    + u * (-1.623_966_674_8e+2
                        + u * (-1.846_050_872_8e+2 + u * (-8.128_743_743_9e+1 + u * -9.814_329_147_3e+0))))));
    let sa = 1.0
        + u * (1.965_127_182_0e+1
            + u * (1.376_577_606_2e+2
                + u * (4.345_658_874_5e+2
                    + u * (6.453_872_680_7e+2
                        + u * (4.290_081_481_9e+2
                            + u * (1.086_350_021_4e+2 + u * (6.570_249_557_5e+0 + u * -6.042_441_353_2e-2)))))));
    let rb = -9.864_943_102_0e-3
        + u * (-7.992_832_660_7e-1
            + u * (-1.775_795_555_1e+1
                + u * (-1.606_363_830_6e+2
                    + u * (-6.375_664_672_9e+2 + u * (-1.025_095_092_8e+3 + u * -4.835_191_955_6e+2)))));
    let sb = 1.0
        + u * (3.033_806_037_9e+1
            + u * (3.257_925_109_9e+2
                + u * (1.536_729_614_3e+3
                    + u * (3.199_858_154_3e+3
                        + u * (2.553_050_293_0e+3 + u * (4.745_285_339_4e+2 + u * -2.244_095_230_1e+1))))));
    let (r, s) = if size < 0x4036_DB6D { (ra, sa) } else { (rb, sb) };
    let z = f32::from_bits(size & 0xFFFF_E000);
    // Values that are not used must stay in `exp_lane`'s range as well.
    let used = (0x3FA0_0000..0x40C0_0000).contains(&size);
    let first = if used { -z * z - 0.5625 } else { 0.0 };
    let second = if used { (z - a) * (z + a) + r / s } else { 0.0 };
    let large = exp_lane(first) * exp_lane(second) / a;

    let complement = if size < 0x3FA0_0000 { middle } else { large };
    let complement = if size < 0x40C0_0000 { complement } else { f32::from_bits(0x0380_0000) };
    let y = 1.0 - complement;
    let y = if x.to_bits() >> 31 != 0 { -y } else { y };
    if size < 0x3F58_0000 { small } else { y }
}

#[cfg(test)]
mod tests {

    fn exponentials(x: &mut [f32]) {
        crate::kernels::exponentials(x, 0.0);
    }

    fn gelu_by_crate(x: f32) -> f32 {
        0.5 * x * (1.0 + ::libm::erff(x * core::f32::consts::FRAC_1_SQRT_2))
    }

    fn agree(name: &str, bits: impl Iterator<Item = u32>, lanes: fn(&mut [f32]), scalar: fn(f32) -> f32) {
        let mut bits = bits.peekable();
        while bits.peek().is_some() {
            let x: [f32; 64] = core::array::from_fn(|_| f32::from_bits(bits.next().unwrap_or(0)));
            let mut y = x;
            lanes(&mut y);
            for (x, y) in x.into_iter().zip(y) {
                let want = scalar(x);
                let same = y.to_bits() == want.to_bits() || y.is_nan() && want.is_nan();
                assert!(same, "{name}({x:e}) = {y:e}, not {want:e}");
            }
        }
    }

    #[test]
    fn lanes_have_the_bits_of_the_crate() {
        let some = || (0..=u32::MAX).step_by(4099);
        agree("exp", some(), exponentials, ::libm::expf);
        agree("gelu", some(), crate::kernels::gelu, gelu_by_crate);
    }

    /// Everything between 2^-15 and 2^7, where the formulas are.
    #[test]
    #[ignore = "takes a minute"]
    fn all_lanes_have_the_bits_of_the_crate() {
        let (from, to) = (2f32.powi(-15).to_bits(), 2f32.powi(7).to_bits());
        let both = || (from..to).flat_map(|bits| [bits, bits | 1 << 31]);
        agree("exp", (from..to).map(|bits| bits | 1 << 31), exponentials, ::libm::expf);
        agree("gelu", both(), crate::kernels::gelu, gelu_by_crate);
    }

    #[test]
    fn lanes_have_the_bits_of_the_crate_around_bounds() {
        const BOUNDS: [u32; 9] = [
            0x3180_0000,
            0x3900_0000,
            0x3EB1_7218,
            0x3F58_0000,
            0x3F85_1592,
            0x3FA0_0000,
            0x4036_DB6D,
            0x40C0_0000,
            0x42AE_AC50,
        ];
        for sign in [0, 1 << 31] {
            for scale in [1.0, core::f32::consts::SQRT_2] {
                for bound in BOUNDS {
                    let middle = (f32::from_bits(bound) * scale).to_bits();
                    let around = || (middle - 20_000..middle + 20_000).map(|bits| bits | sign);
                    agree("exp", around(), exponentials, ::libm::expf);
                    agree("gelu", around(), crate::kernels::gelu, gelu_by_crate);
                }
            }
        }
    }
}
