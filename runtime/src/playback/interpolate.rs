//! Monotone cubic interpolation between frames: no overshoot, and a slope that is continuous.

/// The value between `p1` and `p2`, `t` of the way from 0 to 1, of the cubic whose slope at each is the harmonic mean of the slopes
/// on either side, or 0 where they point apart (Fritsch and Butland, 1984).
#[must_use]
pub fn monotone_cubic([p0, p1, p2, p3]: [f32; 4], t: f32) -> f32 {
    let (before, here, after) = (p1 - p0, p2 - p1, p3 - p2);
    let (start, end) = (slope(before, here), slope(here, after));
    let (t2, left) = (t * t, 1.0 - t);
    let value = p1 + here * t2 * (3.0 - 2.0 * t) + start * t * left * left - end * t2 * left;
    // Rounding alone could leave the interval.
    let (low, high) = if p1 < p2 { (p1, p2) } else { (p2, p1) };
    if value < low {
        low
    } else if value > high {
        high
    } else {
        value
    }
}

fn slope(a: f32, b: f32) -> f32 {
    if a * b > 0.0 { 2.0 * a * b / (a + b) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::numerics::hash::Stream;

    fn random(stream: &mut Stream) -> f32 {
        stream.below(20_001) as f32 / 100.0 - 100.0
    }

    #[test]
    fn it_meets_its_points_and_never_overshoots() {
        let mut stream = Stream::new(3);
        for _ in 0..2000 {
            let mut p = [0.0; 5];
            p.fill_with(|| random(&mut stream));
            let at = |points: &[f32], t| monotone_cubic([points[0], points[1], points[2], points[3]], t);
            assert_eq!(at(&p, 0.0), p[1]);
            assert!((at(&p, 1.0) - p[2]).abs() < 1e-4);
            let mut last = p[1];
            for k in 1..=50 {
                let value = at(&p, k as f32 / 50.0);
                assert!((value - last) * (p[2] - p[1]) >= -1e-3, "turns round: {p:?}");
                last = value;
            }
            let h = 1e-3;
            let (left, right) = ((p[2] - at(&p, 1.0 - h)) / h, (at(&p[1..], h) - p[2]) / h);
            assert!((left - right).abs() < 6.0, "the slope jumps at a frame: {left} {right} {p:?}");
        }
    }

    #[test]
    fn a_line_stays_a_line() {
        for k in 0..=20 {
            let t = k as f32 / 20.0;
            assert!((monotone_cubic([1.0, 3.0, 5.0, 7.0], t) - (3.0 + 2.0 * t)).abs() < 1e-5);
        }
    }
}
