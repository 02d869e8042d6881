//! A small smooth decoder to test the solver on: no code of the runtime, `f64` throughout, gradient by hand.
//!
//! Per frame, the embeddings around it (a triangular window over tokens) pass a tanh layer and a linear skip to root yaw
//! and planar velocity, height and 21 local positions. The root integrates its velocities, turned by the integrated yaw.
#![allow(dead_code)]

use std::cell::Cell;
use std::ops::ControlFlow;

use motionette::memory::{ALIGNMENT, Arena};
use motionette::refining::{
    Config, MotionMap, Objective, ProblemShape, Report, SolverError, Stop, TokenGrid, scratch_bytes, solve,
};
use motionette::request::conditions::{Anchor, AnchorSet};

pub const JOINTS: usize = 22;
/// Yaw velocity, planar velocity, height, 21 local positions.
const CHANNELS: usize = 4 + 63;
const HIDDEN: usize = 24;

/// Bytes on a boundary that the arena begins on.
pub struct Scratch(Vec<u128>);

impl Scratch {
    /// So many, with `filler` in each.
    pub fn new(bytes: usize, filler: u8) -> Self {
        Self(vec![u128::from_ne_bytes([filler; ALIGNMENT]); bytes.div_ceil(ALIGNMENT)])
    }

    pub fn bytes(&mut self) -> &mut [u8] {
        bytemuck::cast_slice_mut(&mut self.0)
    }
}

/// Solves in an arena of exactly the size that is asked for, full of `filler` bytes.
pub fn run_over(
    filler: u8,
    mock: &mut Mock,
    u: &mut [f32],
    set: &AnchorSet,
    config: &Config,
) -> Result<Report, SolverError> {
    let shape = ProblemShape { tokens: mock.tokens, width: mock.width, anchors: set.len() };
    let need = scratch_bytes(shape, config);
    let mut scratch = Scratch::new(need, filler);
    solve(mock, u, &Objective::new(set, config), config, Arena::new(&mut scratch.bytes()[..need]))
}

/// The same; numbers of the arena are NaN.
pub fn run(mock: &mut Mock, u: &mut [f32], set: &AnchorSet, config: &Config) -> Result<Report, SolverError> {
    run_over(0xFF, mock, u, set, config)
}

/// Seeded numbers, xorshift64*.
#[derive(Clone)]
pub struct Random(u64);

impl Random {
    pub fn new(seed: u64) -> Self {
        Self(seed.wrapping_mul(0x9E37_79B9_7F4A_7C15) | 1)
    }

    pub fn bits(&mut self) -> u64 {
        self.0 ^= self.0 >> 12;
        self.0 ^= self.0 << 25;
        self.0 ^= self.0 >> 27;
        self.0.wrapping_mul(0x2545_F491_4F6C_DD1D)
    }

    /// Uniform in 0..1.
    pub fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Roughly normal, unit variance.
    pub fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.uniform()).sum::<f64>() - 6.0
    }

    pub fn below(&mut self, bound: usize) -> usize {
        (self.uniform() * bound as f64) as usize
    }
}

/// When a mock asks to stop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StopAt {
    /// Calls of forward and backward that succeed before.
    pub calls: usize,
    pub stop: Stop,
}

#[derive(Clone)]
pub struct Mock {
    pub tokens: usize,
    pub frames_per_token: usize,
    pub width: usize,
    /// `[HIDDEN][width]`, `[CHANNELS][HIDDEN]`, `[CHANNELS][width]`.
    first: Vec<f64>,
    second: Vec<f64>,
    skip: Vec<f64>,
    bias: Vec<f64>,
    /// Weights of the tokens around every frame.
    taps: Vec<Vec<(usize, f64)>>,
    /// Of the last forward pass: `[frames][width]`, `[frames][HIDDEN]`, `[frames][CHANNELS]`, `[frames][JOINTS]`.
    window: Vec<f64>,
    hidden: Vec<f64>,
    channels: Vec<f64>,
    yaw: Vec<f64>,
    pub joints: Vec<[f64; 3]>,
    pub gradient: Vec<[f64; 3]>,
    /// Books.
    pub forwards: usize,
    pub backwards: usize,
    pub stop_at: Option<StopAt>,
    /// Forward passes with these indices give NaN.
    pub poisoned: Vec<usize>,
    poison: bool,
    /// False after a forward pass that was stopped.
    pub whole: bool,
    /// Every `u` that was evaluated.
    pub seen: Vec<Vec<f32>>,
    /// Positions that were asked for.
    pub asked: Cell<usize>,
}

impl Mock {
    /// Four frames a token.
    pub fn new(seed: u64, tokens: usize, width: usize) -> Self {
        Self::with_frames_per_token(seed, tokens, width, 4)
    }

    pub fn with_frames_per_token(seed: u64, tokens: usize, width: usize, frames_per_token: usize) -> Self {
        let mut random = Random::new(seed);
        let mut fill = |n: usize, scale: f64| (0..n).map(|_| scale * random.normal()).collect::<Vec<_>>();
        let first = fill(HIDDEN * width, 1.0 / (width as f64).sqrt());
        let mut second = fill(CHANNELS * HIDDEN, 0.25 / (HIDDEN as f64).sqrt());
        let mut skip = fill(CHANNELS * width, 0.15 / (width as f64).sqrt());
        let mut bias = fill(CHANNELS, 0.3);
        for (channel, scale) in [(0, 0.1), (1, 0.15), (2, 0.15), (3, 0.5)] {
            second[channel * HIDDEN..(channel + 1) * HIDDEN].iter_mut().for_each(|w| *w *= scale);
            skip[channel * width..(channel + 1) * width].iter_mut().for_each(|w| *w *= scale);
            bias[channel] *= 0.02;
        }
        bias[3] = 0.9;
        let frames = frames_per_token * tokens;
        Self {
            tokens,
            frames_per_token,
            width,
            first,
            second,
            skip,
            bias,
            taps: (0..frames).map(|frame| taps(frame, tokens, frames_per_token)).collect(),
            window: vec![0.0; frames * width],
            hidden: vec![0.0; frames * HIDDEN],
            channels: vec![0.0; frames * CHANNELS],
            yaw: vec![0.0; frames],
            joints: vec![[0.0; 3]; frames * JOINTS],
            gradient: vec![[0.0; 3]; frames * JOINTS],
            forwards: 0,
            backwards: 0,
            stop_at: None,
            poisoned: Vec::new(),
            poison: false,
            whole: false,
            seen: Vec::new(),
            asked: Cell::new(0),
        }
    }

    pub fn frames(&self) -> usize {
        self.frames_per_token * self.tokens
    }

    /// Positions `[frames][JOINTS]` at `u`.
    pub fn decode(&mut self, u: &[f64]) {
        let width = self.width;
        for frame in 0..self.frames() {
            let window = &mut self.window[frame * width..(frame + 1) * width];
            window.fill(0.0);
            for &(token, weight) in &self.taps[frame] {
                for (sum, value) in window.iter_mut().zip(&u[token * width..]) {
                    *sum += weight * value;
                }
            }
            let hidden = &mut self.hidden[frame * HIDDEN..(frame + 1) * HIDDEN];
            for (value, weights) in hidden.iter_mut().zip(self.first.chunks_exact(width)) {
                *value = dot(weights, window).tanh();
            }
            for c in 0..CHANNELS {
                self.channels[frame * CHANNELS + c] = self.bias[c]
                    + dot(&self.second[c * HIDDEN..(c + 1) * HIDDEN], hidden)
                    + dot(&self.skip[c * width..(c + 1) * width], window);
            }
        }
        let (mut yaw, mut x, mut z) = (0.0f64, 0.0, 0.0);
        for frame in 0..self.frames() {
            let row = self.channels[frame * CHANNELS..(frame + 1) * CHANNELS].to_vec();
            let (sin, cos) = yaw.sin_cos();
            self.yaw[frame] = yaw;
            for joint in 0..JOINTS {
                let local = match joint {
                    0 => [0.0, row[3], 0.0],
                    _ => [row[1 + 3 * joint], row[2 + 3 * joint], row[3 + 3 * joint]],
                };
                let position = [cos * local[0] + sin * local[2] + x, local[1], cos * local[2] - sin * local[0] + z];
                self.joints[frame * JOINTS + joint] = position;
            }
            x += cos * row[1] + sin * row[2];
            z += cos * row[2] - sin * row[1];
            yaw += row[0];
        }
    }

    /// `dJ/du` of the gathered gradient at the last decoded point.
    pub fn pull_back(&self) -> Vec<f64> {
        let frames = self.frames();
        let mut du = vec![0.0; self.tokens * self.width];
        // Suffix sums over later frames: of dJ/dx, dJ/dz and dJ/dyaw.
        let (mut gx, mut gz, mut gyaw) = (0.0, 0.0, 0.0);
        for frame in (0..frames).rev() {
            let row = &self.channels[frame * CHANNELS..(frame + 1) * CHANNELS];
            let (sin, cos) = self.yaw[frame].sin_cos();
            let mut d = [0.0; CHANNELS];
            // The step of this frame moves all later ones; its direction depends on this frame's yaw.
            d[1] = cos * gx - sin * gz;
            d[2] = sin * gx + cos * gz;
            d[0] = gyaw;
            let mut turn = gx * (-sin * row[1] + cos * row[2]) + gz * (-sin * row[2] - cos * row[1]);
            for joint in 0..JOINTS {
                let [ax, ay, az] = self.gradient[frame * JOINTS + joint];
                gx += ax;
                gz += az;
                if joint == 0 {
                    d[3] += ay;
                } else {
                    let (lx, lz) = (row[1 + 3 * joint], row[3 + 3 * joint]);
                    d[1 + 3 * joint] += cos * ax - sin * az;
                    d[2 + 3 * joint] += ay;
                    d[3 + 3 * joint] += sin * ax + cos * az;
                    turn += ax * (-sin * lx + cos * lz) + az * (-sin * lz - cos * lx);
                }
            }
            gyaw += turn;
            let mut back = vec![0.0; self.width];
            for (h, &activation) in self.hidden[frame * HIDDEN..(frame + 1) * HIDDEN].iter().enumerate() {
                let sum: f64 = d.iter().enumerate().map(|(c, d)| self.second[c * HIDDEN + h] * d).sum();
                let through = sum * (1.0 - activation * activation);
                for (value, weight) in back.iter_mut().zip(&self.first[h * self.width..]) {
                    *value += weight * through;
                }
            }
            for (d, weights) in d.iter().zip(self.skip.chunks_exact(self.width)) {
                for (value, weight) in back.iter_mut().zip(weights) {
                    *value += weight * d;
                }
            }
            for &(token, weight) in &self.taps[frame] {
                for k in 0..self.width {
                    du[token * self.width + k] += weight * back[k];
                }
            }
        }
        du
    }

    fn call(&self) -> ControlFlow<Stop> {
        match self.stop_at {
            Some(at) if self.forwards + self.backwards > at.calls => ControlFlow::Break(at.stop),
            _ => ControlFlow::Continue(()),
        }
    }

    /// Random embeddings of unit variance.
    pub fn embeddings(&self, seed: u64) -> Vec<f32> {
        let mut random = Random::new(seed);
        (0..self.tokens * self.width).map(|_| random.normal() as f32).collect()
    }

    /// Start and anchors: the anchors lie on the motion of other embeddings near the start.
    pub fn problem(&mut self, seed: u64, places: &[(u16, Option<u8>)], planar: bool) -> (Vec<f32>, Vec<Anchor>) {
        let start = self.embeddings(seed);
        let other = self.embeddings(seed + 1000);
        let goal: Vec<f64> = start.iter().zip(&other).map(|(a, b)| f64::from(a + 0.6 * b)).collect();
        self.decode(&goal);
        let anchors = places
            .iter()
            .map(|&(frame, joint)| {
                let p = self.joints[frame as usize * JOINTS + usize::from(joint.unwrap_or(0))].map(|v| v as f32);
                match joint {
                    Some(joint) => Anchor::joint(frame, joint, p),
                    None if planar => Anchor::planar_root(frame, [p[0], p[2]]),
                    None => Anchor::root(frame, p),
                }
            })
            .collect();
        (start, anchors)
    }

    pub fn set(&self, anchors: &[Anchor]) -> AnchorSet {
        AnchorSet::new(anchors, self.frames()).expect("valid anchors")
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

/// Tokens within two tokens of a frame and their weights.
fn taps(frame: usize, tokens: usize, frames_per_token: usize) -> Vec<(usize, f64)> {
    let each = frames_per_token as f64;
    let centre = (frame as f64 - 0.5 * (each - 1.0)) / each;
    let weight = |token: usize| 1.0 - (token as f64 - centre).abs() / 2.0;
    (0..tokens).map(|token| (token, weight(token))).filter(|(_, weight)| *weight > 0.0).collect()
}

impl MotionMap for Mock {
    fn grid(&self) -> TokenGrid {
        TokenGrid { tokens: self.tokens, frames_per_token: self.frames_per_token }
    }

    fn width(&self) -> usize {
        self.width
    }

    fn forward(&mut self, u: &[f32]) -> ControlFlow<Stop> {
        self.forwards += 1;
        self.seen.push(u.to_vec());
        self.whole = false;
        self.call()?;
        self.whole = true;
        self.poison = self.poisoned.contains(&(self.forwards - 1));
        let wide: Vec<f64> = u.iter().map(|&v| f64::from(v)).collect();
        self.decode(&wide);
        ControlFlow::Continue(())
    }

    fn position(&self, joint: u8, frame: usize) -> [f32; 3] {
        self.asked.set(self.asked.get() + 1);
        if self.poison {
            return [f32::NAN; 3];
        }
        self.joints[frame * JOINTS + usize::from(joint)].map(|v| v as f32)
    }

    fn clear_gradient(&mut self) {
        self.gradient.fill([0.0; 3]);
    }

    fn add_gradient(&mut self, joint: u8, frame: usize, d: [f32; 3]) {
        for (slot, value) in self.gradient[frame * JOINTS + usize::from(joint)].iter_mut().zip(d) {
            *slot += f64::from(value);
        }
    }

    fn backward(&mut self, du: &mut [f32]) -> ControlFlow<Stop> {
        self.backwards += 1;
        self.call()?;
        for (slot, value) in du.iter_mut().zip(self.pull_back()) {
            *slot = value as f32;
        }
        ControlFlow::Continue(())
    }
}
