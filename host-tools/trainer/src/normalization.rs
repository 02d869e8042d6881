//! Mean and deviation of the features, as HumanML3D computes them.
//!
//! The deviation of a channel is replaced by the mean of its group, so that channels of one kind keep their proportions: a joint
//! that hardly moves is not blown up to the weight of a hand.

use std::ops::Range;

use motionette_host::motion::FEATURES;
use motionette_host::motion::features::{
    CONTACTS, HEIGHT, PLANAR_VELOCITY, POSITIONS, ROTATIONS, VELOCITIES, YAW_VELOCITY, of_legs,
};

use crate::tensor_file::{self, TensorFile};

/// Channels that share a deviation: yaw velocity, planar velocity, height, local positions, rotations, velocities, contacts.
pub const GROUPS: [Range<usize>; 7] =
    [YAW_VELOCITY..YAW_VELOCITY + 1, PLANAR_VELOCITY, HEIGHT..HEIGHT + 1, POSITIONS, ROTATIONS, VELOCITIES, CONTACTS];

/// Smallest deviation: a group that never changes stays finite.
const FLOOR: f64 = 1e-4;

/// Mean and deviation of every channel, `[263]` each.
#[derive(Clone, Debug, PartialEq)]
pub struct Normalization {
    /// Means.
    pub mean: Vec<f32>,
    /// Deviations, the same within a group, at least 1e-4.
    pub std: Vec<f32>,
}

impl Normalization {
    /// Of all rows `[T][263]` of all motions; sums run in f64. Without rows: mean 0, smallest deviation.
    pub fn of<'a>(motions: impl Iterator<Item = &'a [f32]> + Clone) -> Self {
        Self::of_measured(motions.map(|motion| (motion, false)))
    }

    /// The same where motions may have synthetic legs (`true`): these do not count in the channels of legs and contacts, unless all are.
    pub fn of_measured<'a>(motions: impl Iterator<Item = (&'a [f32], bool)> + Clone) -> Self {
        let all_synthetic = motions.clone().all(|(_, synthetic)| synthetic);
        let leg: Vec<bool> = (0..FEATURES).map(of_legs).collect();
        let rows = motions.flat_map(|(m, synthetic)| m.chunks_exact(FEATURES).map(move |row| (row, synthetic)));
        let counts = |synthetic: bool, c: usize| all_synthetic || !synthetic || !leg[c];
        let mut count = vec![0.0f64; FEATURES];
        let mut mean = vec![0.0f64; FEATURES];
        for (row, synthetic) in rows.clone() {
            for c in (0..FEATURES).filter(|c| counts(synthetic, *c)) {
                mean[c] += f64::from(row[c]);
                count[c] += 1.0;
            }
        }
        let divide = |sums: &mut [f64]| sums.iter_mut().zip(&count).for_each(|(sum, count)| *sum /= count.max(1.0));
        divide(&mut mean);
        let mut std = vec![0.0f64; FEATURES];
        for (row, synthetic) in rows {
            for c in (0..FEATURES).filter(|c| counts(synthetic, *c)) {
                std[c] += (f64::from(row[c]) - mean[c]).powi(2);
            }
        }
        divide(&mut std);
        std.iter_mut().for_each(|square| *square = square.sqrt());
        for group in GROUPS {
            let shared = (std[group.clone()].iter().sum::<f64>() / group.len() as f64).max(FLOOR);
            std[group].fill(shared);
        }
        let narrow = |values: Vec<f64>| values.into_iter().map(|x| x as f32).collect();
        Self { mean: narrow(mean), std: narrow(std) }
    }

    /// Adds the tensors `mean` and `std`.
    pub fn store(&self, file: &mut TensorFile) {
        file.insert("mean", &[self.mean.len()], self.mean.clone());
        file.insert("std", &[self.std.len()], self.std.clone());
    }

    /// Takes what [`Self::store`] put there.
    ///
    /// # Errors
    /// [`tensor_file::Error`] naming the tensor that is missing or does not fit.
    pub fn restored(file: &TensorFile) -> Result<Self, tensor_file::Error> {
        let channels = |name: &str| file.values(name, &[FEATURES]).map(<[f32]>::to_vec);
        Ok(Self { mean: channels("mean")?, std: channels("std")? })
    }

    /// `(x - mean) / std` for rows `[T][263]`.
    pub fn apply(&self, features: &[f32]) -> Vec<f32> {
        let channels = self.mean.iter().zip(&self.std).cycle();
        features.iter().zip(channels).map(|(x, (mean, std))| (x - mean) / std).collect()
    }

    /// `x std + mean` for rows `[T][263]`.
    pub fn restore(&self, normalised: &[f32]) -> Vec<f32> {
        let channels = self.mean.iter().zip(&self.std).cycle();
        normalised.iter().zip(channels).map(|(x, (mean, std))| x * std + mean).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn groups_cover_every_channel_once() {
        let mut channels: Vec<usize> = GROUPS.into_iter().flatten().collect();
        channels.sort_unstable();
        assert_eq!(channels, (0..FEATURES).collect::<Vec<_>>());
    }

    #[test]
    fn known_rows() {
        // Channel c alternates between c and c + 2 (c even: deviation 1) or c and c + 4 (c odd: deviation 2).
        let row = |up: bool| (0..FEATURES).map(move |c| (c + if up { 2 + 2 * (c % 2) } else { 0 }) as f32);
        let motion: Vec<f32> = row(false).chain(row(true)).collect();
        let normalization = Normalization::of([&motion[..]].into_iter());
        assert_eq!(normalization.mean[4], 5.0);
        assert_eq!(normalization.mean[5], 7.0);
        assert_eq!(normalization.std[1], 1.5, "channels 1 and 2 share");
        assert_eq!(normalization.std[3], 2.0);
        let back = normalization.restore(&normalization.apply(&motion));
        for (a, b) in back.iter().zip(&motion) {
            assert!((a - b).abs() < 1e-4);
        }
    }

    #[test]
    fn synthetic_legs_do_not_count() {
        let measured: Vec<f32> = (0..4 * FEATURES).map(|i| (i as f32).sin()).collect();
        let synthetic = vec![9.0f32; 6 * FEATURES];
        let both = Normalization::of_measured([(&measured[..], false), (&synthetic[..], true)].into_iter());
        let [alone, all] = [vec![&measured[..]], vec![&measured[..], &synthetic[..]]]
            .map(|motions| Normalization::of(motions.into_iter()));
        // Left knee, left hip; velocity of the right foot, of the pelvis; a contact; rotation of the left ankle, of the neck.
        for (channel, leg) in
            [(4 + 9, true), (4, false), (193 + 33, true), (193, false), (262, true), (67 + 36, true), (67 + 66, false)]
        {
            let wanted = if leg { &alone } else { &all };
            assert_eq!(both.mean[channel], wanted.mean[channel], "channel {channel}");
        }
        assert_eq!((both.std[259], both.std[3]), (alone.std[259], all.std[3]));
        let only = Normalization::of_measured([(&synthetic[..], true)].into_iter());
        assert_eq!(only, Normalization::of([&synthetic[..]].into_iter()), "where nothing was measured all counts");
    }

    #[test]
    fn constant_channels_keep_a_floor() {
        let motion = vec![1.0f32; 3 * FEATURES];
        let normalization = Normalization::of([&motion[..]].into_iter());
        assert!(normalization.std.iter().all(|s| *s == FLOOR as f32));
        assert!(normalization.apply(&motion).iter().all(|x| *x == 0.0));
    }
}
