//! Learning rate: linear warm-up, a constant stretch, a cosine fall at the end.
//!
//! The constant stretch lets a run that is limited by the clock decide late how many steps it has: the fall begins when the given
//! share of the time is left, its length follows from the speed so far and from then on everything depends on the step alone. The
//! number of steps is part of the result, and a run with `--steps` of that number gives the same weights.

use serde::{Deserialize, Serialize};

use crate::setting::{OutOfRange, require};

/// Course of the learning rate.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Settings {
    /// Largest learning rate.
    pub learning_rate: f32,
    /// Steps of linear warm-up.
    pub warm_up: u64,
    /// Last share of the steps, in which the learning rate falls along a cosine.
    pub decay: f64,
    /// Learning rate at the end as a share of the largest.
    pub final_rate: f32,
}

impl Settings {
    /// Checks that the learning rate is one, all along its course.
    ///
    /// # Errors
    /// [`OutOfRange`].
    pub fn check(&self) -> Result<(), OutOfRange> {
        let rate = self.learning_rate > 0.0 && self.learning_rate <= 0.1;
        require(rate, "learning_rate", self.learning_rate, "above 0, at most 0.1")?;
        require((0.0..=1.0).contains(&self.decay), "decay", self.decay, "0 to 1")
    }
}

/// The end of a run, once it is known.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Plan {
    /// Steps in all.
    pub steps: u64,
    /// First step of the fall.
    pub fall_from: u64,
}

impl Plan {
    /// For a run of `steps` steps of which the share `decay` falls.
    pub fn of_steps(steps: u64, decay: f64) -> Self {
        let fall = (steps as f64 * decay).round() as u64;
        Self { steps, fall_from: steps - fall.min(steps) }
    }

    /// When the fall is to begin after `done` steps: the plan whose fall begins there.
    pub fn falling_from(done: u64, decay: f64) -> Self {
        if decay >= 1.0 {
            return Self::of_steps(done, decay);
        }
        let mut steps = (done as f64 / (1.0 - decay)).round() as u64;
        // Rounding must not move the beginning of the fall.
        while Self::of_steps(steps, decay).fall_from < done {
            steps += 1;
        }
        while steps > done && Self::of_steps(steps, decay).fall_from > done {
            steps -= 1;
        }
        Self { steps, fall_from: done }
    }
}

/// Learning rate of step `step` (counted from 0). Without a plan the run is still in its constant stretch.
pub fn rate(settings: &Settings, plan: Option<Plan>, step: u64) -> f32 {
    let warm = ((step + 1) as f32 / settings.warm_up.max(1) as f32).min(1.0);
    let fall = match plan {
        Some(plan) if step >= plan.fall_from => {
            let progress = (step - plan.fall_from) as f64 / (plan.steps - plan.fall_from).max(1) as f64;
            let cosine = 0.5 * (1.0 + (std::f64::consts::PI * progress.min(1.0)).cos());
            settings.final_rate + (1.0 - settings.final_rate) * cosine as f32
        }
        _ => 1.0,
    };
    settings.learning_rate * warm * fall
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rises_stays_and_falls() {
        let settings = Settings { learning_rate: 1e-3, warm_up: 10, decay: 0.5, final_rate: 0.01 };
        let plan = Some(Plan::of_steps(100, settings.decay));
        let rate = |step| rate(&settings, plan, step) / settings.learning_rate;
        assert!((rate(0) - 0.1).abs() < 1e-6);
        assert_eq!(rate(9), 1.0);
        assert_eq!(rate(50), 1.0);
        assert!((rate(75) - 0.505).abs() < 1e-6);
        assert!(rate(99) < 0.02 && rate(99) >= settings.final_rate);
    }

    /// A plan made on the way is the plan of a run that knew its number of steps from the start.
    #[test]
    fn late_plans_are_plans_of_steps() {
        for decay in [0.0, 0.2, 0.35, 0.5] {
            for done in [0, 1, 10, 777, 9999] {
                let late = Plan::falling_from(done, decay);
                assert_eq!(late, Plan::of_steps(late.steps, decay), "decay {decay} done {done}");
            }
        }
    }
}
