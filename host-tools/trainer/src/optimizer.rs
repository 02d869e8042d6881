//! AdamW over one flat parameter vector, with clipping by the global norm and a moving average of the weights.
//!
//! The framework's optimiser clips every tensor by itself and keeps its moments in its own record format. Here all state is four
//! vectors of the same length, so a checkpoint is a copy of them and a resumed run continues bit for bit.

use crate::setting::{OutOfRange, require};
use crate::tensor_file::{self, TensorFile};

/// Settings that stay the same during a run.
#[derive(Clone, Copy, Debug)]
pub struct Settings {
    /// Decay of the first moment.
    pub beta1: f32,
    /// Decay of the second moment.
    pub beta2: f32,
    /// Added to the root of the second moment.
    pub epsilon: f32,
    /// Decoupled weight decay, times the learning rate.
    pub weight_decay: f32,
    /// Largest global norm of the gradient.
    pub clip: f32,
    /// Decay of the average weights.
    pub average_decay: f32,
}

impl Settings {
    /// What all runs have in common, with what each chooses.
    #[must_use]
    pub fn new(weight_decay: f32, clip: f32, average_decay: f32) -> Self {
        Self { beta1: 0.9, beta2: 0.99, epsilon: 1e-8, weight_decay, clip, average_decay }
    }

    /// Checks that an update makes sense.
    ///
    /// # Errors
    /// [`OutOfRange`].
    pub fn check(&self) -> Result<(), OutOfRange> {
        require((0.0..1.0).contains(&self.average_decay), "average_decay", self.average_decay, "0 to 1")?;
        require(self.clip > 0.0, "clip", self.clip, "above 0")
    }
}

/// Names of the four vectors in a state file.
const VECTORS: [&str; 4] = ["optimizer.values", "optimizer.first", "optimizer.second", "optimizer.average"];

/// Parameters, their moments and their average.
#[derive(Clone, Debug, PartialEq)]
pub struct AdamW {
    /// The parameters.
    pub values: Vec<f32>,
    /// First moments.
    pub first: Vec<f32>,
    /// Second moments.
    pub second: Vec<f32>,
    /// Exponential moving average of the parameters.
    pub average: Vec<f32>,
    /// Updates done.
    pub updates: u64,
}

impl AdamW {
    /// Starts from `values` with zero moments.
    pub fn new(values: Vec<f32>) -> Self {
        let zeros = vec![0.0; values.len()];
        Self { first: zeros.clone(), second: zeros, average: values.clone(), values, updates: 0 }
    }

    /// Puts the four vectors into a state file; the number of updates is for its metadata.
    pub fn store(&self, file: &mut TensorFile) {
        for (name, vector) in VECTORS.into_iter().zip([&self.values, &self.first, &self.second, &self.average]) {
            file.insert(name, &[vector.len()], vector.clone());
        }
    }

    /// Takes what [`Self::store`] put there.
    ///
    /// # Errors
    /// [`tensor_file::Error`] naming the tensor that is missing, longer or shorter than the parameters, or not finite.
    pub fn restore(file: &TensorFile, updates: u64) -> Result<Self, tensor_file::Error> {
        let length = file.tensors.get(VECTORS[0]).map_or(0, |(_, values)| values.len());
        let vector = |name: &str| file.values(name, &[length]).map(<[f32]>::to_vec);
        let [values, first, second, average] = VECTORS.map(vector);
        Ok(Self { values: values?, first: first?, second: second?, average: average?, updates })
    }

    /// Multiplies the values that are `chosen`, and their averages, by `factor`.
    pub fn scale(&mut self, chosen: &[bool], factor: f32) {
        for values in [&mut self.values, &mut self.average] {
            values.iter_mut().zip(chosen).filter(|(_, chosen)| **chosen).for_each(|(value, _)| *value *= factor);
        }
    }

    /// One update (Loshchilov and Hutter 2019, algorithm 2) and one update of the average.
    ///
    /// `gradient` and `decayed` are as long as the parameters; `decayed[i]` says whether weight decay applies to parameter i. Returns
    /// the global norm of the gradient before clipping. A gradient that is not finite changes nothing and its norm is returned.
    pub fn update(&mut self, settings: &Settings, rate: f32, gradient: &[f32], decayed: &[bool]) -> f32 {
        assert_eq!(gradient.len(), self.values.len(), "gradient and parameters differ in length");
        assert_eq!(decayed.len(), self.values.len(), "decay mask and parameters differ in length");
        let norm = gradient.iter().map(|g| f64::from(*g) * f64::from(*g)).sum::<f64>().sqrt() as f32;
        if !norm.is_finite() {
            return norm;
        }
        self.updates += 1;
        let scale = if norm > settings.clip { settings.clip / norm } else { 1.0 };
        let correction1 = 1.0 - (f64::from(settings.beta1)).powf(self.updates as f64) as f32;
        let correction2 = 1.0 - (f64::from(settings.beta2)).powf(self.updates as f64) as f32;
        // A short history would drag the first random weights along.
        let updates = self.updates as f32;
        let average_decay = settings.average_decay.min((1.0 + updates) / (10.0 + updates));
        for i in 0..gradient.len() {
            let g = gradient[i] * scale;
            self.first[i] += (1.0 - settings.beta1) * (g - self.first[i]);
            self.second[i] += (1.0 - settings.beta2) * (g * g - self.second[i]);
            let step = (self.first[i] / correction1) / ((self.second[i] / correction2).sqrt() + settings.epsilon);
            let decay = if decayed[i] { settings.weight_decay * self.values[i] } else { 0.0 };
            self.values[i] -= rate * (step + decay);
            self.average[i] += (1.0 - average_decay) * (self.values[i] - self.average[i]);
        }
        norm
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SETTINGS: Settings =
        Settings { beta1: 0.9, beta2: 0.99, epsilon: 1e-8, weight_decay: 0.1, clip: 1.0, average_decay: 0.5 };

    /// First update by hand: moments are bias-corrected to the gradient itself, so the step is its sign.
    #[test]
    fn first_update_matches_the_formula() {
        let mut adam = AdamW::new(vec![1.0, -2.0]);
        let norm = adam.update(&SETTINGS, 0.01, &[0.3, -0.4], &[true, false]);
        assert!((norm - 0.5).abs() < 1e-7);
        assert!((adam.values[0] - (1.0 - 0.01 * (1.0 + 0.1))).abs() < 1e-6, "{:?}", adam.values);
        assert!((adam.values[1] - (-2.0 + 0.01)).abs() < 1e-6, "{:?}", adam.values);
    }

    #[test]
    fn clipping_bounds_the_global_norm() {
        let mut clipped = AdamW::new(vec![0.0, 0.0]);
        clipped.update(&SETTINGS, 0.1, &[30.0, -40.0], &[false, false]);
        assert!(
            (clipped.first[0] - 0.1 * 0.6).abs() < 1e-6 && (clipped.first[1] + 0.1 * 0.8).abs() < 1e-6,
            "{:?}",
            clipped.first
        );
    }

    #[test]
    fn a_gradient_that_is_not_finite_changes_nothing() {
        let mut adam = AdamW::new(vec![1.0]);
        let before = adam.clone();
        assert!(adam.update(&SETTINGS, 0.1, &[f32::NAN], &[true]).is_nan());
        assert_eq!(adam, before);
    }

    #[test]
    fn finds_the_minimum_of_a_parabola() {
        let settings = Settings { weight_decay: 0.0, ..SETTINGS };
        let mut adam = AdamW::new(vec![3.0, -1.0]);
        for step in 0..2000 {
            let rate = 0.05 * (1.0 - step as f32 / 2000.0);
            let gradient = [2.0 * (adam.values[0] - 0.5), 20.0 * (adam.values[1] - 2.0)];
            adam.update(&settings, rate, &gradient, &[false, false]);
        }
        assert!((adam.values[0] - 0.5).abs() < 1e-2 && (adam.values[1] - 2.0).abs() < 1e-2, "{:?}", adam.values);
        assert!((adam.average[0] - 0.5).abs() < 1e-2, "{:?}", adam.average);
    }
}
