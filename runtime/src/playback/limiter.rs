//! Range, speed and acceleration of a servo's angle, enforced on the output itself: whatever is asked for, no tick's angle leaves the
//! range, no tick's step is above the speed, and no step differs from the one before it by more than the acceleration.
//!
//! Angles are whole numbers of [`UNITS`] a degree, so the three hold exactly. With `s` the largest change of a step, a step `v` is
//! only taken when braking by `s` a tick afterwards still ends inside the range:
//! `v + (v - s) + (v - 2 s) + ... <= distance to the end`. From such a state the next braking step is always allowed, so there is
//! always one to take.

/// Units a degree.
pub const UNITS: f32 = 65536.0;

/// An angle in 1/65536 degree.
pub type Angle = i32;

/// Degrees in units, rounded; those of the nearest representable angle beyond.
#[must_use]
pub fn units(degrees: f32) -> Angle {
    let scaled = degrees * UNITS;
    // The conversion saturates, and takes NaN to 0.
    (if scaled < 0.0 { scaled - 0.5 } else { scaled + 0.5 }) as Angle
}

/// Units in degrees.
#[must_use]
pub fn degrees(angle: Angle) -> f32 {
    angle as f32 / UNITS
}

/// What an angle may do.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ServoLimits {
    /// Smallest angle.
    pub low: Angle,
    /// Largest angle.
    pub high: Angle,
    /// Largest step, units a tick, at least 1.
    pub step: Angle,
    /// Largest change of a step from one tick to the next, at least 1.
    pub change: Angle,
}

/// An angle that keeps its [`ServoLimits`].
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limiter {
    limits: ServoLimits,
    at: Angle,
    step: Angle,
    target: Angle,
}

/// The largest step `v` for which `v + (v - s) + (v - 2 s) + ...` stays within `distance`, both at least 0; `s` is `change`.
///
/// With `n - 1` whole changes in `v` the sum is `n v - s n (n - 1) / 2`; `n` is the smallest number of steps for which
/// `s n (n + 1) / 2` reaches the distance.
#[inline(never)]
fn stopping_step(distance: Angle, change: Angle) -> Angle {
    let (distance, change) = (i64::from(distance), i64::from(change));
    let Some(ratio) = (8 * distance).checked_div(change) else { return 0 };
    // sqrt(8 d / s + 1) lies between 2 n - 1 and 2 n + 1, up to the two roundings down, which may make n one too small.
    let mut n = ((ratio + 1) as u64).isqrt().saturating_add(1) as i64 / 2;
    if change * n * (n + 1) / 2 < distance {
        n += 1;
    }
    let Some(step) = (distance + change * n * (n - 1) / 2).checked_div(n) else { return 0 };
    step as Angle
}

fn smaller(a: Angle, b: Angle) -> Angle {
    if a < b { a } else { b }
}

fn larger(a: Angle, b: Angle) -> Angle {
    if a > b { a } else { b }
}

impl Limiter {
    /// At rest at the angle nearest to `at` inside the range.
    #[must_use]
    #[inline(never)]
    pub fn new(limits: ServoLimits, at: Angle) -> Self {
        let ServoLimits { low, high, step, change } = limits;
        let high = larger(low, high);
        let limits = ServoLimits { low, high, step: larger(step, 1), change: larger(change, 1) };
        let at = smaller(larger(at, low), high);
        Limiter { limits, at, step: 0, target: at }
    }

    /// The angle.
    #[must_use]
    pub const fn at(&self) -> Angle {
        self.at
    }

    /// The last step.
    #[must_use]
    pub const fn step(&self) -> Angle {
        self.step
    }

    /// What it keeps.
    #[must_use]
    pub const fn limits(&self) -> &ServoLimits {
        &self.limits
    }

    /// Goes after `target` for one tick. Returns whether it is there.
    ///
    /// What is left of the way is covered as fast as still allows to stop, seen from the target as it moves: a target that stays is
    /// reached without overshoot, one that moves within the limits is followed without lag.
    #[inline(never)]
    pub fn follow(&mut self, target: Angle) -> bool {
        let ServoLimits { low, high, change, .. } = self.limits;
        let goal = smaller(larger(target, low), high);
        let moved = goal.saturating_sub(self.target);
        let behind = self.target.saturating_sub(self.at);
        let closer = stopping_step(behind.saturating_abs(), change);
        self.target = goal;
        self.take(moved.saturating_add(if behind < 0 { -closer } else { closer }));
        self.at == target
    }

    /// Goes on for one tick to what it went after last.
    pub fn settle(&mut self) -> bool {
        self.follow(self.target)
    }

    /// Slows down for one tick. Returns whether it stands.
    pub fn brake(&mut self) -> bool {
        self.take(0);
        self.target = self.at;
        self.step == 0
    }

    /// Takes the allowed step nearest to `wanted`.
    #[inline(never)]
    fn take(&mut self, wanted: Angle) {
        let ServoLimits { low, high, step, change } = self.limits;
        let most = smaller(
            smaller(self.step.saturating_add(change), step),
            stopping_step(high.saturating_sub(self.at), change),
        );
        let least = larger(
            larger(self.step.saturating_sub(change), -step),
            -stopping_step(self.at.saturating_sub(low), change),
        );
        self.step = larger(smaller(wanted, most), least);
        self.at += self.step;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::hash::Stream;

    fn limits(random: &mut Stream) -> ServoLimits {
        let low = random.below(1 << 24) as Angle - (1 << 23);
        let mut scaled = |bits: u32| {
            let bits = 1 + random.below(bits);
            1 + random.below(1 << bits) as Angle
        };
        let (high, step, change) = (low + scaled(24), scaled(22), scaled(22));
        ServoLimits { low, high, step, change }
    }

    /// As slowly as it can be found.
    fn brute_force(distance: Angle, change: Angle) -> Angle {
        let stops = |v: Angle| {
            let (mut sum, mut v) = (0, i64::from(v));
            while v > 0 {
                sum += v;
                v -= i64::from(change);
            }
            sum <= i64::from(distance)
        };
        (0..=distance).take_while(|v| stops(*v)).last().unwrap_or(0)
    }

    #[test]
    fn the_stopping_step_is_the_largest_from_which_braking_ends_in_time() {
        for distance in 0..400 {
            for change in (1..60).chain([399, 400, 401, 100_000]) {
                assert_eq!(stopping_step(distance, change), brute_force(distance, change), "{distance} by {change}");
            }
        }
        assert_eq!(stopping_step(Angle::MAX, 1), brute_force_large(Angle::MAX));
    }

    /// `v (v + 1) / 2 <= distance`, change 1.
    fn brute_force_large(distance: Angle) -> Angle {
        (0..).take_while(|v: &i64| v * (v + 1) / 2 <= i64::from(distance)).last().unwrap_or(0) as Angle
    }

    #[test]
    fn no_input_makes_the_output_leave_its_limits() {
        let mut random = Stream::new(11);
        for case in 0..400 {
            let limits = limits(&mut random);
            let mut limiter = Limiter::new(limits, random.below(u32::MAX) as Angle);
            let (mut at, mut step) = (limiter.at(), 0);
            for tick in 0..400 {
                match random.below(8) {
                    0 => _ = limiter.brake(),
                    1 => {
                        _ = limiter
                            .follow([Angle::MAX, Angle::MIN, 0, limits.low, limits.high][random.below(5) as usize])
                    }
                    2..=5 => _ = limiter.follow(at.saturating_add(random.below(1 << 16) as Angle - (1 << 15))),
                    _ => _ = limiter.follow(random.below(u32::MAX) as Angle),
                }
                let name = std::format!("case {case} tick {tick}: {limits:?} {limiter:?}");
                assert!((limits.low..=limits.high).contains(&limiter.at()), "{name}");
                assert_eq!(limiter.at() - at, limiter.step(), "{name}");
                assert!(limiter.step().abs() <= limits.step, "{name}");
                assert!((limiter.step() - step).abs() <= limits.change, "{name}");
                (at, step) = (limiter.at(), limiter.step());
            }
        }
    }

    #[test]
    fn it_follows_what_it_can_and_arrives_where_it_stays() {
        let mut random = Stream::new(12);
        for _ in 0..200 {
            let limits = limits(&mut random);
            let start = limits.low + random.below((limits.high - limits.low) as u32 + 1) as Angle;
            let mut limiter = Limiter::new(limits, start);
            let target = limits.low + random.below((limits.high - limits.low) as u32 + 1) as Angle;
            // Distance over the speed, and two ramps; a rounding of each step on the way.
            let way = i64::from((target - start).abs());
            let step = i64::from(limits.step);
            let ramp = (2.0 * (way as f64 / f64::from(limits.change)).sqrt()) as i64;
            let most = way / step + step / i64::from(limits.change) + ramp + 60;
            if most > 100_000 {
                continue;
            }
            let ticks = (0..=most).find(|_| limiter.follow(target));
            assert!(ticks.is_some(), "not there after {most}: {limiter:?} to {target}");
            assert!((0..100).all(|_| limiter.follow(target)) && limiter.step() == 0);
        }
        let limits = ServoLimits { low: -10_000_000, high: 10_000_000, step: 20_000, change: 2_000 };
        let mut limiter = Limiter::new(limits, 0);
        for tick in 1..300i32 {
            // A ramp that speeds up and slows down within the limits is followed without lag.
            let target = 100 * tick * tick / 2 - if tick > 150 { 100 * (tick - 150) * (tick - 150) } else { 0 };
            assert!(limiter.follow(target), "{tick}");
        }
    }
}
