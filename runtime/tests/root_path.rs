//! The root's path over a long time: heading against f64, in pieces against whole.

use motionette::representation::humanml3d::{Path, ROOT_CHANNELS, Recovery, Root, channels};
use motionette::representation::{Features, Recover};

/// Frames of ten hours.
const FRAMES: usize = 10 * 3600 * 20;

fn path(buffers: &mut [Vec<f32>; 4]) -> Path<'_> {
    let [cos, sin, x, z] = buffers;
    Path { cos, sin, x, z, d_angle: &mut [], d_x: &mut [], d_z: &mut [] }
}

#[test]
fn slow_and_fast_turns_survive_ten_hours() {
    let selected = channels(0);
    let (mean, std) = ([0.0f32; ROOT_CHANNELS], [1.0f32; ROOT_CHANNELS]);
    let mut buffers: [Vec<f32>; 4] = std::array::from_fn(|_| vec![0.0; 1000]);
    // Half angles a frame: a turn in a day, in ten minutes, in four seconds, and the other way round.
    for yaw in [3.6e-6f32, 2.6e-4, 0.039, -0.039, -2.6e-4] {
        let values = [yaw, 0.01, 0.02, 0.0].repeat(1000);
        let features = Features { values: &values, channels: &selected };
        let recovery = Recovery { mean: &mean, std: &std };
        let mut root = Root::default();
        let mut worst = 0.0f64;
        for block in 0..FRAMES / 1000 {
            recovery.integrate_from(features, &mut root, &mut path(&mut buffers));
            for (frame, (cos, sin)) in buffers[0].iter().zip(&buffers[1]).enumerate() {
                let heading = 2.0 * f64::from(yaw) * (block * 1000 + frame) as f64;
                let error = f64::from(*sin).atan2(f64::from(*cos)) - heading;
                worst = worst.max((error - (error / std::f64::consts::TAU).round() * std::f64::consts::TAU).abs());
            }
        }
        // Half an ulp of a number below pi for each frame, twice since the angle is half.
        let bound = FRAMES as f64 * 2.0 * f64::from(f32::EPSILON) / 2.0;
        println!("{yaw} rad a frame: heading off by at most {worst:.4} rad, bound {bound:.4}");
        assert!(worst < bound, "{yaw}: {worst}");
    }
}

#[test]
fn pieces_give_the_bits_of_the_whole_beyond_a_turn() {
    let selected = channels(0);
    let (mean, std) = ([0.1f32, 0.0, 0.01, 0.9], [0.5f32, 0.02, 0.03, 0.1]);
    let mut random = motionette::numerics::hash::Stream::new(4);
    let values: Vec<f32> = (0..200 * ROOT_CHANNELS).map(|_| random.unit() - 0.3).collect();
    let features = |values| Features { values, channels: &selected };
    let recovery = Recovery { mean: &mean, std: &std };
    let mut whole: [Vec<f32>; 4] = std::array::from_fn(|_| vec![0.0; 200]);
    recovery.integrate(features(&values), &mut path(&mut whole));
    for length in [1usize, 3, 16, 77] {
        let mut root = Root::default();
        let mut pieces: [Vec<f32>; 4] = Default::default();
        for values in values.chunks(length * ROOT_CHANNELS) {
            let mut buffers: [Vec<f32>; 4] = std::array::from_fn(|_| vec![0.0; values.len() / ROOT_CHANNELS]);
            recovery.integrate_from(features(values), &mut root, &mut path(&mut buffers));
            for (all, piece) in pieces.iter_mut().zip(&buffers) {
                all.extend(piece);
            }
        }
        assert_eq!(pieces, whole, "{length} frames at a time");
    }
    // Against f64 without any wrapping: the turn that is left out is a whole one.
    let (mut angle, mut x, mut z) = (0.0f64, 0.0f64, 0.0f64);
    let mut turns = 0.0f64;
    for (frame, row) in values.chunks(ROOT_CHANNELS).enumerate() {
        let near = |a: f32, b: f64| (f64::from(a) - b).abs() < 1e-4;
        assert!(near(whole[0][frame], (2.0 * angle).cos()) && near(whole[1][frame], (2.0 * angle).sin()));
        assert!(near(whole[2][frame], x) && near(whole[3][frame], z), "frame {frame}");
        let f = |c: usize| f64::from(row[c]) * f64::from(std[c]) + f64::from(mean[c]);
        angle += f(0);
        turns = turns.max(angle / std::f64::consts::PI);
        let (sin, cos) = (2.0 * angle).sin_cos();
        x += f(1) * cos - f(2) * sin;
        z += f(1) * sin + f(2) * cos;
    }
    assert!(turns > 3.0, "the motion must turn: {turns}");
}
