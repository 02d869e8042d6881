//! The oracle of scaffold features: every curve from the dense system of conditions that define it, in f64, whole motions at once.

use motionette::{Anchor, Target};

/// Joint and wanted position; the height is `None` where the anchor leaves it free.
fn parts(anchor: &Anchor) -> (usize, [Option<f64>; 3]) {
    let wide = |v: f32| Some(f64::from(v));
    match anchor.target {
        Target::Root(p) => (0, p.map(wide)),
        Target::PlanarRoot([x, z]) => (0, [wide(x), None, wide(z)]),
        Target::Joint { joint, position } => (usize::from(joint), position.map(wide)),
    }
}

/// Solves `a x = b` by Gauss with row exchange.
///
/// # Panics
/// When there is no solution.
#[must_use]
pub fn solve(mut a: Vec<Vec<f64>>, mut b: Vec<f64>) -> Vec<f64> {
    let n = b.len();
    for k in 0..n {
        let pivot = (k..n).max_by(|&i, &j| a[i][k].abs().total_cmp(&a[j][k].abs())).expect("a row is left");
        a.swap(k, pivot);
        b.swap(k, pivot);
        assert!(a[k][k] != 0.0, "the system has one solution");
        for i in k + 1..n {
            let factor = a[i][k] / a[k][k];
            for j in k..n {
                a[i][j] -= factor * a[k][j];
            }
            b[i] -= factor * b[k];
        }
    }
    let mut x = vec![0.0; n];
    for k in (0..n).rev() {
        let known: f64 = (k + 1..n).map(|j| a[k][j] * x[j]).sum();
        x[k] = (b[k] - known) / a[k][k];
    }
    x
}

/// The curve through knots of rising frames, at every frame from the first to the last: straight pieces through up to three, through
/// more cubic pieces `a + b x + c x^2 + d x^3` (x from a piece's left end) that meet in value, slope and bend, straight at both ends.
#[must_use]
pub fn curve(knots: &[(usize, f64)]) -> Vec<f64> {
    let pieces = knots.len() - 1;
    let span = |i: usize| (knots[i + 1].0 - knots[i].0) as f64;
    let coefficients: Vec<f64> = if pieces < 3 {
        (0..pieces).flat_map(|i| [knots[i].1, (knots[i + 1].1 - knots[i].1) / span(i), 0.0, 0.0]).collect()
    } else {
        let (mut a, mut b) = (Vec::new(), Vec::new());
        let mut condition = |terms: &[(usize, f64)], right: f64| {
            let mut row = vec![0.0; 4 * pieces];
            terms.iter().for_each(|&(column, value)| row[column] += value);
            a.push(row);
            b.push(right);
        };
        for i in 0..pieces {
            let h = span(i);
            condition(&[(4 * i, 1.0)], knots[i].1);
            condition(&[(4 * i, 1.0), (4 * i + 1, h), (4 * i + 2, h * h), (4 * i + 3, h * h * h)], knots[i + 1].1);
            if i + 1 < pieces {
                let next = 4 * (i + 1);
                condition(&[(4 * i + 1, 1.0), (4 * i + 2, 2.0 * h), (4 * i + 3, 3.0 * h * h), (next + 1, -1.0)], 0.0);
                condition(&[(4 * i + 2, 2.0), (4 * i + 3, 6.0 * h), (next + 2, -2.0)], 0.0);
            }
        }
        let last = 4 * (pieces - 1);
        condition(&[(2, 2.0)], 0.0);
        condition(&[(last + 2, 2.0), (last + 3, 6.0 * span(pieces - 1))], 0.0);
        solve(a, b)
    };
    let mut values: Vec<f64> = (0..pieces)
        .flat_map(|i| {
            let c = &coefficients[4 * i..4 * i + 4];
            (0..knots[i + 1].0 - knots[i].0).map(move |x| {
                let x = x as f64;
                c[0] + x * (c[1] + x * (c[2] + x * c[3]))
            })
        })
        .collect();
    values.push(knots[pieces].1);
    values
}

/// Features `[frames][244]` of anchors that do not contradict each other.
#[must_use]
pub fn features(anchors: &[Anchor], frames: usize, rate: f64, mean: &[f64], std: &[f64]) -> Vec<Vec<f64>> {
    let mut c = vec![vec![0.0; 244]; frames];
    for joint in 0..22 {
        for axis in 0..3 {
            let mut knots: Vec<(usize, f64)> = anchors
                .iter()
                .filter(|anchor| parts(anchor).0 == joint)
                .filter_map(|anchor| Some((usize::from(anchor.frame), parts(anchor).1[axis]?)))
                .collect();
            knots.sort_by_key(|k| k.0);
            knots.dedup_by_key(|k| k.0);
            let Some(&(first, _)) = knots.first() else { continue };
            let place = 3 * joint + axis;
            let component = if place == 1 {
                1
            } else if joint == 0 {
                0
            } else {
                1 + joint
            };
            let limited = |v: f64| v.clamp(-16.0, 16.0);
            let values = curve(&knots);
            for (i, value) in values.iter().enumerate() {
                let c = &mut c[first + i];
                c[66 + place] = limited((value - mean[place]) / std[place]);
                let change = if i == 0 { 0.0 } else { value - values[i - 1] };
                c[132 + place] = limited(change * rate / std[place]);
                c[198 + component] = 1.0;
            }
            for (t, value) in knots {
                c[t][place] = limited((value - mean[place]) / std[place]);
                c[t][221 + component] = 1.0;
            }
        }
    }
    c
}
