//! The same prior for dense tracks, in time that grows with the frames alone: state-space models of what is added, a Kalman filter forward and
//! Rauch, Tung and Striebel's smoother back.
//!
//! One model covers both kinds of way: `u` is a Matern 3/2 process, two numbers a frame, `u` and its slope; a limb's own way is `u` itself, the
//! root's path the sum of `u` over the frames before. All axes share one model and are seen at the same frames, so that covariances are computed
//! once for all of them. (Rasmussen and Williams, Gaussian Processes for Machine Learning, 2006, B.2; Särkkä, Bayesian Filtering
//! and Smoothing, 2013, 4.3 and 8.2.)

use crate::memory::{Arena, ArenaTooSmall};
use crate::nn::exp::exp;

/// Numbers of a state: the sum of `u` before, `u`, its slope.
const STATES: usize = 3;
/// Numbers of a symmetric matrix of them.
const COVARIANCE: usize = 6;
/// Least variance of what is seen, as a share of the process' own: single precision cannot tell less.
const LEAST_NOISE: f32 = 1e-4;

type State = [f32; STATES];
/// Rows of a symmetric matrix, whole.
type Matrix = [State; STATES];

/// What is seen of a way at a frame: where it goes, metres, and how surely.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen<const AXES: usize> {
    /// The way on each axis.
    pub way: [f32; AXES],
    /// Variance of it, square metres; at least a ten thousandth of the process' own counts.
    pub noise: f32,
}

/// A process, discretised to frames.
#[derive(Debug, Clone, Copy)]
pub struct Process {
    step: Matrix,
    /// Covariance of what a step adds.
    added: Matrix,
    /// Covariance of the state before the first frame.
    begin: Matrix,
    /// Which number of the state is the way.
    way: usize,
    least_noise: f32,
}

impl Process {
    /// A way of its own, of standard deviation `deviation` metres and length `length` frames.
    #[must_use]
    pub fn own(deviation: f32, length: f32) -> Self {
        Self::new(deviation * deviation, length, 1)
    }

    /// The sum of velocities that go together over `length` frames; over many frames its variance grows by `growth` a frame, square metres.
    #[must_use]
    pub fn path(growth: f32, length: f32) -> Self {
        // The covariance of u over all distances, 4 s^2 length / sqrt 3, is what the variance of the sum grows by.
        Self::new(growth * ROOT_3 / (4.0 * length), length, 0)
    }

    fn new(variance: f32, length: f32, way: usize) -> Self {
        let rate = ROOT_3 / length;
        let decay = exp(-rate);
        let (a, b) = (decay * (1.0 + rate), decay);
        let (c, d) = (-decay * rate * rate, decay * (1.0 - rate));
        let step = [[1.0, 1.0, 0.0], [0.0, a, b], [0.0, c, d]];
        let slope = rate * rate * variance;
        let begin = [[0.0; 3], [0.0, variance, 0.0], [0.0, 0.0, slope]];
        // What is stationary stays so: the step adds what it takes away.
        let added = [
            [0.0; 3],
            [0.0, variance - (a * a * variance + b * b * slope), -(a * c * variance + b * d * slope)],
            [0.0, -(a * c * variance + b * d * slope), slope - (c * c * variance + d * d * slope)],
        ];
        let least_noise = LEAST_NOISE * variance;
        Process { step, added, begin, way, least_noise }
    }
}

const ROOT_3: f32 = 1.732_050_8;

/// What the smoother keeps of every frame.
#[derive(Debug)]
pub struct Smoother<'a, const AXES: usize> {
    means: &'a mut [[State; AXES]],
    covariances: &'a mut [[f32; COVARIANCE]],
}

impl<'a, const AXES: usize> Smoother<'a, AXES>
where
    [State; AXES]: bytemuck::Pod,
{
    /// For motions of `frames` frames.
    ///
    /// # Errors
    /// [`ArenaTooSmall`].
    pub fn take(frames: usize, arena: &mut Arena<'a>) -> Result<Self, ArenaTooSmall> {
        Ok(Smoother { means: arena.take(frames)?, covariances: arena.take(frames)? })
    }

    /// The most probable way, `[T][AXES]` metres, given what is seen of it; `seen` says so for each frame, nothing where nothing is.
    pub fn smooth(&mut self, process: &Process, seen: impl Fn(usize) -> Option<Seen<AXES>>, ways: &mut [[f32; AXES]]) {
        let frames = self.means.len();
        invariant!(ways.len() == frames, "{} ways for {frames} frames", ways.len());
        let mut mean = [[0.0; STATES]; AXES];
        let mut covariance = process.begin;
        let kept = self.means.iter_mut().zip(self.covariances.iter_mut());
        for (frame, (kept_mean, kept_covariance)) in kept.enumerate() {
            if frame > 0 {
                mean = mean.map(|mean| applied(&process.step, mean));
                covariance = propagated(process, &covariance);
            }
            if let Some(Seen { way, noise }) = seen(frame) {
                update(process, way, noise, &mut mean, &mut covariance);
            }
            (*kept_mean, *kept_covariance) = (mean, packed(&covariance));
        }
        // Back: what the frame behind knows more than was predicted from this one. The last frame's filtered state is smoothed already.
        let mut after = mean;
        let back = self.means.iter().zip(self.covariances.iter()).zip(ways).enumerate().rev();
        for (frame, ((filtered, covariance), way)) in back {
            let mut smoothed = *filtered;
            if frame + 1 < frames {
                let covariance = unpacked(covariance);
                let predicted = propagated(process, &covariance);
                for (smoothed, after) in smoothed.iter_mut().zip(after) {
                    let ahead = applied(&process.step, *smoothed);
                    // C = P F^T P_predicted^-1 (after - ahead), right to left.
                    let weighed = solved(&predicted, difference(after, ahead));
                    let gain = applied(&covariance, transposed_applied(&process.step, weighed));
                    for (value, gain) in smoothed.iter_mut().zip(gain) {
                        *value += gain;
                    }
                }
            }
            after = smoothed;
            for (way, state) in way.iter_mut().zip(smoothed) {
                *way = state.get(process.way).copied().unwrap_or(0.0);
            }
        }
    }
}

/// Takes in what is seen.
fn update<const AXES: usize>(
    process: &Process,
    way: [f32; AXES],
    noise: f32,
    mean: &mut [State; AXES],
    covariance: &mut Matrix,
) {
    let noise = if noise > process.least_noise { noise } else { process.least_noise };
    let Some(row) = covariance.get(process.way).copied() else { return };
    let variance = row.get(process.way).copied().unwrap_or(0.0) + noise;
    let gain = row.map(|value| value / variance);
    for (mean, way) in mean.iter_mut().zip(way) {
        let off = way - mean.get(process.way).copied().unwrap_or(0.0);
        for (value, gain) in mean.iter_mut().zip(gain) {
            *value += gain * off;
        }
    }
    for (line, gain) in covariance.iter_mut().zip(gain) {
        for (value, other) in line.iter_mut().zip(row) {
            *value -= gain * other;
        }
    }
    // The subtraction loses the digits of what it makes small: no variance may become negative, and no covariance outgrow its variances.
    for i in 0..STATES {
        if let Some(value) = covariance.get_mut(i).and_then(|line| line.get_mut(i)) {
            *value = if *value > 0.0 { *value } else { 0.0 };
        }
    }
}

/// `F P F^T + Q`.
fn propagated(process: &Process, covariance: &Matrix) -> Matrix {
    let half = process.step.map(|row| applied(covariance, row));
    let mut out = process.added;
    for (line, half) in out.iter_mut().zip(half) {
        for (value, row) in line.iter_mut().zip(&process.step) {
            *value += dot(half, *row);
        }
    }
    out
}

fn dot([a, b, c]: State, [x, y, z]: State) -> f32 {
    a * x + b * y + c * z
}

/// `A x`, of a symmetric matrix or a step.
fn applied(matrix: &Matrix, x: State) -> State {
    matrix.map(|row| dot(row, x))
}

/// `A^T x`.
fn transposed_applied(&[[a, b, c], [d, e, f], [g, h, i]]: &Matrix, x: State) -> State {
    [dot([a, d, g], x), dot([b, e, h], x), dot([c, f, i], x)]
}

fn difference([a, b, c]: State, [x, y, z]: State) -> State {
    [a - x, b - y, c - z]
}

const fn packed(&[[a, b, c], [_, d, e], [_, _, f]]: &Matrix) -> [f32; COVARIANCE] {
    [a, b, c, d, e, f]
}

const fn unpacked(&[a, b, c, d, e, f]: &[f32; COVARIANCE]) -> Matrix {
    [[a, b, c], [b, d, e], [c, e, f]]
}

/// The solution of `A x = b` for a symmetric positive matrix, by `L D L^T`; a number whose pivot is lost comes out as 0.
fn solved(&[[a, b, c], [_, d, e], [_, _, f]]: &Matrix, [x, y, z]: State) -> State {
    let inverse = |pivot: f32, whole: f32| if pivot > 1e-7 * whole { 1.0 / pivot } else { 0.0 };
    let ia = inverse(a, a);
    let (l1, l2) = (b * ia, c * ia);
    let d1 = d - l1 * b;
    let id = inverse(d1, d);
    let l3 = (e - l1 * c) * id;
    let f1 = f - l2 * c - l3 * (e - l1 * c);
    let y = y - l1 * x;
    let z = z - l2 * x - l3 * y;
    let z = z * inverse(f1, f);
    let y = y * id - l3 * z;
    [x * ia - l1 * y - l2 * z, y, z]
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::{vec, vec::Vec};

    fn smoothed<const AXES: usize>(process: &Process, seen: &[Option<Seen<AXES>>]) -> Vec<[f32; AXES]>
    where
        [State; AXES]: bytemuck::Pod,
    {
        let frames = seen.len();
        let bytes = Arena::measure(|arena| Smoother::<AXES>::take(frames, arena));
        let mut memory = vec![0u128; bytes / 16];
        let mut arena = Arena::new(bytemuck::cast_slice_mut(&mut memory));
        let mut smoother = Smoother::take(frames, &mut arena).unwrap();
        let mut ways = vec![[f32::NAN; AXES]; frames];
        smoother.smooth(process, |frame| seen[frame], &mut ways);
        ways
    }

    /// Covariance of ways at two frames, from the kernel itself.
    fn kernel(variance: f64, length: f64, path: bool, a: usize, b: usize) -> f64 {
        let at = |r: f64| {
            let r = 3f64.sqrt() * r.abs() / length;
            variance * (1.0 + r) * (-r).exp()
        };
        if !path {
            return at(a as f64 - b as f64);
        }
        (0..a).flat_map(|s| (0..b).map(move |r| (s, r))).map(|(s, r)| at(s as f64 - r as f64)).sum()
    }

    /// Gaussian process regression with dense matrices in f64: `K (K + R)^-1 y`.
    fn oracle(variance: f64, length: f64, path: bool, seen: &[(usize, f64, f64)], frame: usize) -> f64 {
        let n = seen.len();
        let mut a = vec![vec![0.0; n + 1]; n];
        for i in 0..n {
            for j in 0..n {
                a[i][j] = kernel(variance, length, path, seen[i].0, seen[j].0);
            }
            a[i][i] += seen[i].2;
            a[i][n] = seen[i].1;
        }
        for i in 0..n {
            let pivot = (i..n).max_by(|p, q| a[*p][i].abs().total_cmp(&a[*q][i].abs())).unwrap();
            a.swap(i, pivot);
            let top = a[i].clone();
            for row in a.iter_mut().skip(i + 1) {
                let factor = row[i] / top[i];
                for (value, top) in row.iter_mut().zip(&top) {
                    *value -= factor * top;
                }
            }
        }
        let mut x = vec![0.0; n];
        for i in (0..n).rev() {
            let known: f64 = (i + 1..n).map(|j| a[i][j] * x[j]).sum();
            x[i] = (a[i][n] - known) / a[i][i];
        }
        seen.iter().zip(&x).map(|((at, ..), x)| kernel(variance, length, path, frame, *at) * x).sum()
    }

    #[test]
    fn ways_are_those_of_the_dense_regression() {
        let frames = 40;
        let mut stream = crate::numerics::hash::Stream::new(4);
        let mut next = move || f64::from(stream.below(2001) as f32 / 1000.0 - 1.0);
        for (path, every, noise) in
            [(false, 1, 1e-3), (false, 9, 1e-3), (true, 1, 1e-2), (true, 7, 1e-3), (true, 25, 1e-4)]
        {
            let (variance, length) = if path { (0.01 * 3f64.sqrt() / 24.0, 6.0) } else { (0.0225, 6.0) };
            let process = if path { Process::path(0.01, 6.0) } else { Process::own(0.15, 6.0) };
            let points: Vec<(usize, f64, f64)> = (1..frames).step_by(every).map(|t| (t, 0.3 * next(), noise)).collect();
            let mut seen = vec![None; frames];
            for (t, y, noise) in &points {
                seen[*t] = Some(Seen { way: [*y as f32, -2.0 * *y as f32], noise: *noise as f32 });
            }
            let ways = smoothed(&process, &seen);
            for (t, way) in ways.iter().enumerate() {
                let want = oracle(variance, length, path, &points, t);
                for (got, want) in way.iter().zip([want, -2.0 * want]) {
                    assert!(
                        (f64::from(*got) - want).abs() < 2e-3,
                        "path {path} every {every}, frame {t}: {got} {want}"
                    );
                }
            }
        }
    }

    /// A track that says every frame is followed; what it does not say stays near, and nothing seen is nothing added.
    #[test]
    fn dense_tracks_are_followed() {
        let frames = 196;
        let track = |t: usize| [0.002 * t as f32, 0.1 * (0.1 * t as f32).sin()];
        let process = Process::path(0.01, 6.0);
        let seen: Vec<_> =
            (0..frames).map(|t| (20..180).contains(&t).then(|| Seen { way: track(t), noise: 0.0 })).collect();
        let ways = smoothed(&process, &seen);
        for (t, way) in ways.iter().enumerate().take(180).skip(20) {
            for (got, want) in way.iter().zip(track(t)) {
                assert!((got - want).abs() < 2e-3, "frame {t}: {way:?} {:?}", track(t));
            }
        }
        assert_eq!(ways[0], [0.0; 2], "a path begins where it began");
        let speed = |t: usize| {
            ways[t].iter().zip(&ways[t - 1]).map(|(a, b)| (a - b).abs()).fold(0.0, |a, b| if b > a { b } else { a })
        };
        assert!((1..frames).all(|t| speed(t) < 0.06));
        let nothing: [Option<Seen<2>>; 5] = [None; 5];
        assert_eq!(smoothed(&process, &nothing), [[0.0; 2]; 5]);
        let wild: Vec<_> =
            (0..196).map(|t| Some(Seen { way: [if t % 2 == 0 { 1e3 } else { -1e3 }], noise: 0.0 })).collect();
        assert!(smoothed(&Process::own(0.3, 6.0), &wild).iter().all(|way| way[0].is_finite()));
    }
}
