//! The times at which a sampler asks for proposals.

use crate::numerics::angle::sin_cos;

/// Times `t_k` of steps `k = 0..S`, from 0 to 1.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Schedule {
    /// `t_k = k / S`
    #[default]
    Uniform,
    /// `t_k = 1 - cos(pi/2 k/S)`: small steps first.
    Cosine,
}

impl Schedule {
    /// `t_k` of `steps` steps; `t_S = 1`.
    #[must_use]
    #[inline(never)]
    pub fn time(self, step: u16, steps: u16) -> f32 {
        if step >= steps {
            return 1.0;
        }
        let share = f32::from(step) / f32::from(steps);
        match self {
            Schedule::Uniform => share,
            Schedule::Cosine => {
                let (_, cos) = sin_cos(core::f32::consts::FRAC_PI_2 * share);
                1.0 - cos
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_ascend_from_zero_to_one() {
        for schedule in [Schedule::Uniform, Schedule::Cosine] {
            for steps in [1u16, 2, 10, 1000] {
                assert_eq!(schedule.time(0, steps), 0.0);
                assert_eq!(schedule.time(steps, steps), 1.0);
                for k in 0..steps {
                    assert!(schedule.time(k, steps) < schedule.time(k + 1, steps), "{schedule:?} {k} of {steps}");
                }
            }
        }
        assert_eq!(Schedule::Uniform.time(3, 10), 0.3);
        assert!((Schedule::Cosine.time(1, 3) - (1.0 - 0.75f32.sqrt())).abs() < 1e-6);
    }
}
