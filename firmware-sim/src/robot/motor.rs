//! A servo's mechanics: controller, motor, gears, and what hangs on its horn.
//!
//! The horn has inertia. The controller is a critically damped position loop, as fast as a hobby servo's; a serial servo puts a profile of
//! limited speed and acceleration before it. Without power nothing holds the horn but the friction of the gears, and what hangs on it
//! sags towards where it would hang at rest. All forces are given as accelerations of the horn, in shares of the acceleration that the
//! channel may have: whoever set that limit has seen to it that the motor has force to spare.

/// Seconds of a step.
pub const STEP: f64 = 1e-3;
/// Natural frequency of the position loop, per second: it lags by two over this, a fortieth of a second.
const FREQUENCY: f64 = 80.0;
/// Largest acceleration of the motor.
const STRENGTH: f64 = 4.0;
/// Of what hangs on the horn, at most.
const LOAD: f64 = 0.18;
/// Of the gears.
const FRICTION: f64 = 0.1;
/// Speed that the gears take without power, per second.
const DRAG: f64 = 6.0;
/// Degrees from where the load hangs at rest within which it pulls less.
const SWING: f64 = 20.0;
/// Fastest speed in shares of the channel's, without load.
const SLEW: f64 = 1.25;

/// What a controller is told.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Drive {
    /// It has no power, or its motor is off.
    Off,
    /// To go to an angle as fast as it can, degrees.
    Pulses(f64),
    /// To go to an angle within a speed and an acceleration of its own, degrees; zero is as much as it can.
    Profile {
        /// Degrees.
        goal: f64,
        /// Degrees a second.
        speed: f64,
        /// Degrees a second squared.
        acceleration: f64,
    },
}

/// A servo.
#[derive(Debug, Clone)]
pub struct Motor {
    angle: f64,
    speed: f64,
    /// Where a profile has come to, and how fast it is.
    profile: (f64, f64),
    /// Limits of the channel: degrees a second, and squared.
    limits: (f64, f64),
    /// Where what hangs on the horn would come to rest, and how strongly it pulls there, as a share of [`LOAD`].
    hangs: f64,
    pull: f64,
    /// Somebody keeps the horn from moving while it has no power.
    held: bool,
}

impl Motor {
    /// At rest at `angle`. What hangs on it pulls towards `hangs` with a share `pull` of the heaviest load.
    pub const fn new(angle: f64, limits: (f64, f64), hangs: f64, pull: f64, held: bool) -> Self {
        Motor { angle, speed: 0.0, profile: (angle, 0.0), limits, hangs, pull, held }
    }

    /// Where the horn stands, degrees.
    pub const fn angle(&self) -> f64 {
        self.angle
    }

    /// How fast it turns, degrees a second.
    pub const fn speed(&self) -> f64 {
        self.speed
    }

    /// Moves for [`STEP`].
    pub fn step(&mut self, drive: Drive) {
        let (fastest, limit) = self.limits;
        let load = -LOAD * limit * self.pull * ((self.angle - self.hangs) / SWING).clamp(-1.0, 1.0);
        let slew = SLEW * fastest;
        let force = match drive {
            Drive::Off => {
                self.profile = (self.angle, 0.0);
                if self.held {
                    self.speed = 0.0;
                    return;
                }
                -DRAG * self.speed
            }
            Drive::Pulses(goal) => {
                self.profile = (self.angle, self.speed);
                self.towards(goal, slew, STRENGTH * limit)
            }
            Drive::Profile { goal, speed, acceleration } => {
                let or = |value: f64, most: f64| if value > 0.0 { value.min(most) } else { most };
                self.plan(goal, or(speed, slew), or(acceleration, STRENGTH * limit));
                self.towards(self.profile.0, slew, STRENGTH * limit)
            }
        };
        let moved = self.speed + (force + load) * STEP;
        // Friction slows down and never turns round.
        let friction = FRICTION * limit * STEP;
        self.speed = if moved.abs() <= friction { 0.0 } else { moved - friction * moved.signum() };
        self.angle += self.speed * STEP;
    }

    /// The acceleration that the position loop asks for, as far as the motor can.
    fn towards(&self, goal: f64, slew: f64, strength: f64) -> f64 {
        // A loop whose error is limited is no faster than `slew`.
        let error = (goal - self.angle).clamp(-2.0 * slew / FREQUENCY, 2.0 * slew / FREQUENCY);
        (FREQUENCY * FREQUENCY * error - 2.0 * FREQUENCY * self.speed).clamp(-strength, strength)
    }

    /// The profile goes on towards `goal`, so that it can stop there.
    fn plan(&mut self, goal: f64, fastest: f64, acceleration: f64) {
        let (at, speed) = self.profile;
        let (way, change) = (goal - at, acceleration * STEP);
        if way.abs() <= change * STEP && speed.abs() <= change {
            self.profile = (goal, 0.0);
            return;
        }
        let half = change / 2.0;
        let stopping = ((half * half + 2.0 * acceleration * way.abs()).sqrt() - half).min(way.abs() / STEP);
        let wanted = stopping.min(fastest) * way.signum();
        let speed = wanted.clamp(speed - change, speed + change);
        self.profile = (at + speed * STEP, speed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: (f64, f64) = (270.0, 2500.0);

    fn run(motor: &mut Motor, drive: Drive, steps: usize) -> (f64, f64) {
        let (mut fastest, mut hardest) = (0.0f64, 0.0f64);
        for _ in 0..steps {
            let before = motor.speed;
            motor.step(drive);
            fastest = fastest.max(motor.speed.abs());
            hardest = hardest.max((motor.speed - before).abs() / STEP);
        }
        (fastest, hardest)
    }

    #[test]
    fn a_goal_far_away_is_a_jump_and_a_profile_is_not() {
        let mut motor = Motor::new(-60.0, LIMITS, 0.0, 0.0, false);
        let (fastest, hardest) = run(&mut motor, Drive::Pulses(60.0), 2000);
        assert!(fastest > 300.0 && hardest > 9000.0, "{fastest} {hardest}");
        assert!((motor.angle - 60.0).abs() < 0.1);
        let profile = Drive::Profile { goal: -60.0, speed: 40.0, acceleration: 1000.0 };
        let (fastest, hardest) = run(&mut motor, profile, 5000);
        assert!((38.0..41.0).contains(&fastest) && hardest < 1050.0, "{fastest} {hardest}");
        assert!((motor.angle + 60.0).abs() < 0.1);
    }

    #[test]
    fn without_power_the_horn_sags_to_where_its_load_hangs_unless_somebody_holds_it() {
        let mut motor = Motor::new(50.0, LIMITS, 0.0, 1.0, false);
        let (fastest, _) = run(&mut motor, Drive::Off, 20_000);
        assert!((20.0..60.0).contains(&fastest), "{fastest}");
        assert!(motor.angle.abs() < 15.0 && motor.speed == 0.0, "friction keeps it near: {}", motor.angle);
        let mut held = Motor::new(50.0, LIMITS, 0.0, 1.0, true);
        run(&mut held, Drive::Off, 1000);
        assert_eq!(held.angle, 50.0);
    }
}
