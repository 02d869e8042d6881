//! Second moments of a layer's input and wanted output over calibration data.

/// Sums over observations of an input `x` `[n]` and the output `y` `[m]` it should give.
#[derive(Debug, Clone)]
pub struct Moments {
    /// Inputs n.
    pub inputs: usize,
    /// Outputs m.
    pub outputs: usize,
    count: f64,
    /// `[n]`
    x: Vec<f64>,
    /// `[m]`
    y: Vec<f64>,
    /// `[n][n]`, lower triangle.
    xx: Vec<f64>,
    /// `[m][n]`
    yx: Vec<f64>,
}

/// Means and covariances.
#[derive(Debug, Clone)]
pub struct Covariance {
    /// Mean input `[n]`.
    pub x: Vec<f64>,
    /// Mean output `[m]`.
    pub y: Vec<f64>,
    /// Covariance of inputs `[n][n]`.
    pub xx: Vec<f64>,
    /// Covariance of outputs with inputs `[m][n]`.
    pub yx: Vec<f64>,
}

impl Moments {
    /// Nothing observed yet.
    #[must_use]
    pub fn new(inputs: usize, outputs: usize) -> Self {
        let (x, y) = (vec![0.0; inputs], vec![0.0; outputs]);
        Self { inputs, outputs, count: 0.0, x, y, xx: vec![0.0; inputs * inputs], yx: vec![0.0; outputs * inputs] }
    }

    /// Observations so far.
    #[must_use]
    pub fn count(&self) -> usize {
        self.count as usize
    }

    /// One observation. Inputs that are zero (half of them, behind a ReLU) cost nothing.
    pub fn add(&mut self, x: &[f64], y: &[f64]) {
        let n = self.inputs;
        self.count += 1.0;
        for (i, &a) in x.iter().enumerate() {
            if a == 0.0 {
                continue;
            }
            self.x[i] += a;
            for (sum, b) in self.xx[i * n..=i * n + i].iter_mut().zip(x) {
                *sum += a * b;
            }
        }
        for ((row, total), &a) in self.yx.chunks_exact_mut(n).zip(&mut self.y).zip(y) {
            *total += a;
            for (sum, b) in row.iter_mut().zip(x) {
                *sum += a * b;
            }
        }
    }

    /// Means and covariances; all zero without observations.
    #[must_use]
    pub fn covariance(&self) -> Covariance {
        let n = self.inputs;
        let count = if self.count > 0.0 { self.count } else { 1.0 };
        let x: Vec<f64> = self.x.iter().map(|v| v / count).collect();
        let y: Vec<f64> = self.y.iter().map(|v| v / count).collect();
        let mut xx = vec![0.0; n * n];
        for i in 0..n {
            for j in 0..=i {
                let v = self.xx[i * n + j] / count - x[i] * x[j];
                (xx[i * n + j], xx[j * n + i]) = (v, v);
            }
        }
        let mut yx = vec![0.0; self.outputs * n];
        for (o, row) in yx.chunks_exact_mut(n).enumerate() {
            for (i, v) in row.iter_mut().enumerate() {
                *v = self.yx[o * n + i] / count - y[o] * x[i];
            }
        }
        Covariance { x, y, xx, yx }
    }
}
