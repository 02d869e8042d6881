//! Legs that say nothing of the action: hidden, or those of another motion.
//!
//! A Kinect's legs and contacts are made up. Actions that only a Kinect recorded must be known without them, and with the legs that a
//! model gives to them: in training such a motion has no legs, or those of a motion whose root moves much like its own.

use motionette_host::motion::FEATURES;
use motionette_host::motion::features::{HEIGHT, PLANAR_VELOCITY, of_legs};

/// Sets legs and contacts of normalised rows `[T][263]` to zero, their mean.
pub fn hide(rows: &mut [f32]) {
    for (index, value) in rows.iter_mut().enumerate() {
        if of_legs(index % FEATURES) {
            *value = 0.0;
        }
    }
}

/// Gives rows `[T][263]` legs and contacts of `donor`, which begins again where it is shorter. Without rows in it nothing changes.
pub fn replace(rows: &mut [f32], donor: &[f32]) {
    for (row, other) in rows.chunks_exact_mut(FEATURES).zip(donor.chunks_exact(FEATURES).cycle()) {
        (0..FEATURES).filter(|channel| of_legs(*channel)).for_each(|channel| row[channel] = other[channel]);
    }
}

/// The candidate whose root moves most like that of `rows`: smallest mean square of the difference of planar velocity and height. All are
/// normalised rows `[T][263]`; of a pair of motions the frames count that both have. None without candidates.
pub fn nearest<'a>(rows: &[f32], candidates: impl Iterator<Item = &'a [f32]>) -> Option<&'a [f32]> {
    let root = || PLANAR_VELOCITY.chain([HEIGHT]);
    let distance = |other: &[f32]| {
        let pairs = rows.chunks_exact(FEATURES).zip(other.chunks_exact(FEATURES));
        let frames = pairs.len().max(1) as f32;
        pairs.map(|(a, b)| root().map(|c| (a[c] - b[c]).powi(2)).sum::<f32>()).sum::<f32>() / frames
    };
    candidates.map(|other| (distance(other), other)).min_by(|a, b| a.0.total_cmp(&b.0)).map(|(_, other)| other)
}

#[cfg(test)]
mod tests {
    use motionette_host::motion::features::{CONTACTS, POSITIONS, ROTATIONS, VELOCITIES};

    use super::*;

    fn rows(frames: usize, first: f32) -> Vec<f32> {
        (0..frames * FEATURES).map(|i| first + i as f32).collect()
    }

    /// Knees, ankles and feet by hand: joints 4, 5, 7, 8, 10 and 11 with 3 + 6 + 3 channels each, and four contacts.
    #[test]
    fn legs_are_hidden_and_nothing_else() {
        let mut hidden = rows(2, 1.0);
        hide(&mut hidden);
        assert_eq!(hidden.iter().filter(|x| **x == 0.0).count(), 2 * (6 * 12 + 4));
        for channel in [POSITIONS.start + 9, ROTATIONS.start + 18, VELOCITIES.start + 33, CONTACTS.start] {
            assert_eq!(hidden[channel], 0.0, "channel {channel}");
        }
        // The hips, the root and the head stay.
        for channel in [POSITIONS.start, POSITIONS.start + 42, HEIGHT, PLANAR_VELOCITY.start] {
            assert_eq!(hidden[channel], rows(2, 1.0)[channel], "channel {channel}");
        }
    }

    #[test]
    fn a_short_donor_begins_again() {
        let (own, donor) = (rows(5, 0.5), rows(2, 9000.0));
        let mut changed = own.clone();
        replace(&mut changed, &donor);
        for (index, value) in changed.iter().enumerate() {
            let wanted = if of_legs(index % FEATURES) { donor[index % donor.len()] } else { own[index] };
            assert_eq!(*value, wanted, "value {index}");
        }
        replace(&mut changed, &[]);
        assert_eq!(changed.len(), own.len());
    }

    #[test]
    fn the_nearest_root_is_found_whatever_the_rest_does() {
        let still = vec![0.0; 3 * FEATURES];
        let mut like_it = vec![5.0; 9 * FEATURES];
        let mut moves = still.clone();
        for row in like_it.chunks_exact_mut(FEATURES) {
            row[PLANAR_VELOCITY.start..=HEIGHT].fill(0.1);
        }
        moves[HEIGHT] = 1.0;
        let found = nearest(&still, [&moves[..], &like_it[..]].into_iter()).unwrap();
        assert_eq!(found[FEATURES - 1], 5.0);
        assert!(nearest(&still, std::iter::empty()).is_none());
    }
}
