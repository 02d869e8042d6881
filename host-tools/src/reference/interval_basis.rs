//! Intervals between anchors on the token grid, their basis functions, and the routed ridge projection (EQUATIONS section 5).

use super::anchors::Anchor;
use super::real::Real;

/// Ridge that no activity removes.
const RIDGE_FLOOR: f64 = 1e-4;

/// Functions of normalised time `s` in an interval; Legendre polynomials in `2 s - 1`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Basis {
    /// No basis: tokens move freely.
    Plain,
    /// Degree 0.
    Transport,
    /// Degree 1 alone.
    Slope,
    /// Degrees 0 and 1, as published.
    Affine,
    /// Degrees 0 to 2.
    Quadratic,
    /// Degrees 0 to 3.
    Cubic,
}

impl Basis {
    fn degrees(self) -> &'static [u32] {
        match self {
            Self::Plain => &[],
            Self::Transport => &[0],
            Self::Slope => &[1],
            Self::Affine => &[0, 1],
            Self::Quadratic => &[0, 1, 2],
            Self::Cubic => &[0, 1, 2, 3],
        }
    }
}

fn legendre(degree: u32, x: f64) -> f64 {
    match degree {
        0 => 1.0,
        1 => x,
        2 => (3.0 * x * x - 1.0) / 2.0,
        _ => (5.0 * x * x * x - 3.0 * x) / 2.0,
    }
}

/// One interval that owns tokens.
#[derive(Debug, Clone, PartialEq)]
pub struct Interval {
    /// Frame of its left end.
    pub left: usize,
    /// Frame of its right end.
    pub right: usize,
    /// Tokens it owns.
    pub tokens: Vec<usize>,
    /// `[tokens][functions]`; empty when tokens move freely.
    pub functions: Vec<Vec<f64>>,
}

/// All intervals of a request.
#[derive(Debug, Clone, PartialEq)]
pub struct IntervalBasis {
    /// In order of time.
    pub intervals: Vec<Interval>,
    /// Tokens move freely: asked for, or there were more coefficients than tokens.
    pub direct: bool,
}

impl IntervalBasis {
    /// Cuts `tokens` tokens of `frames_per_token` frames at the anchors and the sequence ends.
    #[must_use]
    pub fn new(anchors: &[Anchor], tokens: usize, frames_per_token: usize, basis: Basis) -> Self {
        let last = (tokens * frames_per_token).saturating_sub(1);
        let mut cuts: Vec<usize> = anchors.iter().map(|a| a.frame).chain([0, last]).collect();
        cuts.sort_unstable();
        cuts.dedup();
        let middle = |l: usize| (frames_per_token * l) as f64 + (frames_per_token as f64 - 1.0) / 2.0;
        let mut intervals: Vec<Interval> = cuts
            .windows(2)
            .map(|w| {
                let (left, right) = (w[0], w[1]);
                // A middle on a cut, which takes an odd number of frames a token, belongs to the right.
                let holds = |l: &usize| left as f64 <= middle(*l) && (middle(*l) < right as f64 || right == last);
                Interval { left, right, tokens: (0..tokens).filter(holds).collect(), functions: Vec::new() }
            })
            .filter(|i| !i.tokens.is_empty())
            .collect();
        let degrees = basis.degrees();
        let direct = degrees.is_empty() || intervals.len() * degrees.len() > tokens;
        if !direct {
            for i in &mut intervals {
                let kept = &degrees[..degrees.len().min(i.tokens.len())];
                let x = |l: usize| 2.0 * (middle(l) - i.left as f64) / (i.right - i.left) as f64 - 1.0;
                i.functions = i.tokens.iter().map(|&l| kept.iter().map(|&d| legendre(d, x(l))).collect()).collect();
            }
        }
        Self { intervals, direct }
    }

    /// `delta <- B alpha*`, `alpha_i = (B^T B + (lambda (1 - a_i) + 1e-4) I)^-1 B^T delta`; with free tokens `B = I`.
    ///
    /// `delta` is `[tokens][width]`, `activity` one number an interval.
    pub fn project<T: Real>(&self, delta: &mut [T], width: usize, lambda: f64, activity: &[f64]) {
        for (interval, &a) in self.intervals.iter().zip(activity) {
            let ridge = lambda * (1.0 - a) + RIDGE_FLOOR;
            if self.direct {
                let shrink = T::from_f64(1.0 / (1.0 + ridge));
                for &l in &interval.tokens {
                    for d in &mut delta[l * width..(l + 1) * width] {
                        *d *= shrink;
                    }
                }
                continue;
            }
            let b = &interval.functions;
            let n = b[0].len();
            let normal: Vec<Vec<f64>> = (0..n)
                .map(|p| {
                    let entry =
                        |q: usize| b.iter().map(|row| row[p] * row[q]).sum::<f64>() + if p == q { ridge } else { 0.0 };
                    (0..n).map(entry).collect()
                })
                .collect();
            for c in 0..width {
                let right = |p: usize| -> f64 {
                    interval.tokens.iter().zip(b).map(|(&l, row)| row[p] * delta[l * width + c].to_f64()).sum()
                };
                let alpha = solve(normal.clone(), (0..n).map(right).collect());
                for (&l, row) in interval.tokens.iter().zip(b) {
                    let value: f64 = row.iter().zip(&alpha).map(|(f, a)| f * a).sum();
                    delta[l * width + c] = T::from_f64(value);
                }
            }
        }
    }

    /// An orthonormal basis of what the intervals can do: columns `[coefficients][tokens]`.
    #[must_use]
    pub fn orthonormal(&self, tokens: usize) -> Vec<Vec<f64>> {
        let mut columns: Vec<Vec<f64>> = Vec::new();
        for interval in &self.intervals {
            let count = if self.direct { interval.tokens.len() } else { interval.functions[0].len() };
            for f in 0..count {
                let mut column = vec![0.0; tokens];
                for (i, &l) in interval.tokens.iter().enumerate() {
                    column[l] = if self.direct { f64::from(i == f) } else { interval.functions[i][f] };
                }
                // Gram-Schmidt against the columns so far; other intervals are orthogonal already.
                for other in &columns {
                    let along: f64 = column.iter().zip(other).map(|(a, b)| a * b).sum();
                    column.iter_mut().zip(other).for_each(|(a, b)| *a -= along * b);
                }
                let norm = column.iter().map(|a| a * a).sum::<f64>().sqrt();
                if norm > 1e-9 {
                    column.iter_mut().for_each(|a| *a /= norm);
                    columns.push(column);
                }
            }
        }
        columns
    }
}

/// Solves a small dense system by elimination with row exchange.
fn solve(mut a: Vec<Vec<f64>>, mut b: Vec<f64>) -> Vec<f64> {
    let n = b.len();
    for p in 0..n {
        let best = (p..n).max_by(|&x, &y| a[x][p].abs().total_cmp(&a[y][p].abs())).unwrap_or(p);
        a.swap(p, best);
        b.swap(p, best);
        for r in p + 1..n {
            let factor = a[r][p] / a[p][p];
            for c in p..n {
                a[r][c] -= factor * a[p][c];
            }
            b[r] -= factor * b[p];
        }
    }
    for p in (0..n).rev() {
        for c in p + 1..n {
            b[p] -= a[p][c] * b[c];
        }
        b[p] /= a[p][p];
    }
    b
}

#[cfg(test)]
mod tests {
    use super::super::anchors::Target;
    use super::*;

    fn anchors(frames: &[usize]) -> Vec<Anchor> {
        frames.iter().map(|&frame| Anchor { frame, target: Target::PlanarRoot([0.0, 0.0]) }).collect()
    }

    #[test]
    fn tokens_are_owned_once_and_short_intervals_use_fewer_functions() {
        let basis = IntervalBasis::new(&anchors(&[5, 5, 7, 30]), 12, 4, Basis::Affine);
        let owned: Vec<usize> = basis.intervals.iter().flat_map(|i| i.tokens.clone()).collect();
        assert_eq!(owned, (0..12).collect::<Vec<_>>());
        // Token 1 stands at frame 5.5, the only one in [5, 7].
        assert_eq!(basis.intervals[1].tokens, [1]);
        assert_eq!(basis.intervals[1].functions[0].len(), 1);
        assert!(!basis.direct);
        assert!(IntervalBasis::new(&anchors(&[4, 9, 14]), 5, 4, Basis::Affine).direct);
    }

    #[test]
    fn every_token_is_owned_whatever_its_frames() {
        for frames_per_token in 1..=8 {
            let basis = IntervalBasis::new(&anchors(&[0, 3, 4, 9]), 12, frames_per_token, Basis::Affine);
            let owned: Vec<usize> = basis.intervals.iter().flat_map(|i| i.tokens.clone()).collect();
            assert_eq!(owned, (0..12).collect::<Vec<_>>(), "{frames_per_token} frames a token");
        }
    }

    #[test]
    fn projection_keeps_what_the_basis_spans_and_shrinks_idle_intervals() {
        let basis = IntervalBasis::new(&anchors(&[23]), 12, 4, Basis::Affine);
        let ramp: Vec<f64> = (0..12).map(|l| 3.0 - 0.5 * l as f64).collect();
        let mut kept = ramp.clone();
        basis.project(&mut kept, 1, 10.0, &[1.0, 1.0]);
        for (a, b) in kept.iter().zip(&ramp) {
            assert!((a - b).abs() < 1e-3, "{a} {b}");
        }
        let mut idle = ramp.clone();
        basis.project(&mut idle, 1, 10.0, &[1.0, 0.0]);
        assert!((idle[0] - ramp[0]).abs() < 1e-3);
        assert!(idle[7..].iter().zip(&ramp[7..]).all(|(a, b)| a.abs() < b.abs()), "{idle:?}");
        // A zig-zag is not in the span: the projection is orthogonal to what it leaves.
        let zigzag: Vec<f64> = (0..12).map(|l| if l % 2 == 0 { 1.0 } else { -1.0 }).collect();
        let mut p = zigzag.clone();
        basis.project(&mut p, 1, 0.0, &[1.0, 1.0]);
        for column in basis.orthonormal(12) {
            let along: f64 = column.iter().zip(zigzag.iter().zip(&p)).map(|(c, (z, p))| c * (z - p)).sum();
            assert!(along.abs() < 1e-3, "{along}");
        }
    }
}
