//! The formulas of prior and control written out anew: whole matrices in f64, weights looked up by name.

use motionette_host::checkpoint::TensorMap;
use motionette_host::reference::Real;

/// Rows of numbers.
pub type Matrix = Vec<Vec<f64>>;

/// The formulas, for one order of norms and one nonlinearity.
pub struct Naive {
    /// Every tensor.
    pub map: TensorMap,
    /// Norms behind the sublayers.
    pub post: bool,
    /// ReLU in place of GELU.
    pub relu: bool,
}

impl Naive {
    fn vector(&self, name: &str) -> Vec<f64> {
        self.map.find(name).expect(name).data.iter().map(|&v| f64::from(v)).collect()
    }

    fn matrix(&self, name: &str) -> Matrix {
        let columns = self.map.find(name).expect(name).shape[1];
        self.vector(name).chunks(columns).map(<[f64]>::to_vec).collect()
    }

    /// `W x + b` of every row.
    pub fn linear(&self, name: &str, x: &Matrix) -> Matrix {
        let (w, b) = (self.matrix(&format!("{name}.weight")), self.vector(&format!("{name}.bias")));
        let row = |x: &Vec<f64>| {
            w.iter().zip(&b).map(|(w, b)| b + w.iter().zip(x).map(|(w, x)| w * x).sum::<f64>()).collect()
        };
        x.iter().map(row).collect()
    }

    fn norm(&self, name: &str, x: &Matrix) -> Matrix {
        let (w, b) = (self.vector(&format!("{name}.weight")), self.vector(&format!("{name}.bias")));
        let row = |x: &Vec<f64>| {
            let n = x.len() as f64;
            let mean = x.iter().sum::<f64>() / n;
            let variance = x.iter().map(|v| v * v).sum::<f64>() / n - mean * mean;
            (0..x.len()).map(|i| (x[i] - mean) / (variance + 1e-5).sqrt() * w[i] + b[i]).collect()
        };
        x.iter().map(row).collect()
    }

    fn attention(q: &Matrix, k: &Matrix, v: &Matrix, heads: usize) -> Matrix {
        let dh = q[0].len() / heads;
        let mut out = vec![Vec::new(); q.len()];
        for (q, out) in q.iter().zip(&mut out) {
            for h in 0..heads {
                let scores: Vec<f64> = k
                    .iter()
                    .map(|k| (0..dh).map(|c| q[h * dh + c] * k[h * dh + c]).sum::<f64>() / (dh as f64).sqrt())
                    .map(f64::exp)
                    .collect();
                let sum: f64 = scores.iter().sum();
                out.extend((0..dh).map(|c| scores.iter().zip(v).map(|(s, v)| s / sum * v[h * dh + c]).sum::<f64>()));
            }
        }
        out
    }

    fn part(x: &Matrix, from: usize, to: usize) -> Matrix {
        x.iter().map(|r| r[from..to].to_vec()).collect()
    }

    fn sublayer(&self, norm: &str, x: &Matrix, f: impl Fn(&Matrix) -> Matrix) -> Matrix {
        let sum = |a: &Matrix, b: Matrix| -> Matrix {
            a.iter().zip(b).map(|(a, b)| a.iter().zip(b).map(|(a, b)| a + b).collect()).collect()
        };
        if self.post { self.norm(norm, &sum(x, f(x))) } else { sum(x, f(&self.norm(norm, x))) }
    }

    /// `extra`: further rows of keys, then values, that self-attention looks at.
    fn block(&self, name: &str, x: &Matrix, heads: usize, memory: Option<&Matrix>, extra: &Matrix) -> Matrix {
        let d = x[0].len();
        let x = self.sublayer(&format!("{name}.norm1"), x, |h| {
            let qkv = self.linear(&format!("{name}.attention.qkv"), h);
            let q = Self::part(&qkv, 0, d);
            let k = [Self::part(&qkv, d, 2 * d), Self::part(extra, 0, d)].concat();
            let v = [Self::part(&qkv, 2 * d, 3 * d), Self::part(extra, d, 2 * d)].concat();
            self.linear(&format!("{name}.attention.out"), &Self::attention(&q, &k, &v, heads))
        });
        let x = memory.map_or(x.clone(), |memory| {
            self.sublayer(&format!("{name}.norm_cross"), &x, |h| {
                let kv = self.linear(&format!("{name}.cross.kv"), memory);
                let q = self.linear(&format!("{name}.cross.q"), h);
                let mixed = Self::attention(&q, &Self::part(&kv, 0, d), &Self::part(&kv, d, 2 * d), heads);
                self.linear(&format!("{name}.cross.out"), &mixed)
            })
        });
        self.sublayer(&format!("{name}.norm2"), &x, |h| {
            let mut hidden = self.linear(&format!("{name}.ffn.in"), h);
            for v in hidden.iter_mut().flatten() {
                *v = match self.relu {
                    true => v.max(0.0),
                    false => *v * normal_distribution(*v),
                };
            }
            self.linear(&format!("{name}.ffn.out"), &hidden)
        })
    }

    /// Memory and pooled vector.
    pub fn text(&self, words: &[u16]) -> (Matrix, Vec<f64>) {
        let (embedding, position) = (self.matrix("text.embedding.weight"), self.matrix("text.position.weight"));
        let x: Matrix = (0..words.len())
            .map(|i| embedding[usize::from(words[i])].iter().zip(&position[i]).map(|(a, b)| a + b).collect())
            .collect();
        let memory = self.norm("text.norm", &self.block("text.layers.0", &x, 2, None, &Vec::new()));
        let pooled = (0..8).map(|c| memory.iter().map(|row| row[c]).sum::<f64>() / words.len() as f64).collect();
        (memory, pooled)
    }

    /// Rows of the scaffold `[L][ws]` of frame features `[4 L][..]`.
    pub fn scaffold(&self, features: &Matrix) -> Matrix {
        let mut frames = self.linear("control.frame", features);
        frames.iter_mut().flatten().for_each(|v| *v = v.max(0.0));
        let mut x = self.linear("control.merge", &frames.chunks(4).map(<[_]>::concat).collect());
        let position = self.matrix("control.position.weight");
        x.iter_mut().zip(&position).for_each(|(x, p)| x.iter_mut().zip(p).for_each(|(x, p)| *x += p));
        for layer in ["control.layers.0", "control.layers.1"] {
            x = self.block(layer, &x, 2, None, &Vec::new());
        }
        self.norm("control.norm", &x)
    }

    /// What the dual context adds to the planner's rows.
    fn dual_context(&self, h: &Matrix) -> Matrix {
        let mean = (0..h[0].len()).map(|c| h.iter().map(|row| row[c]).sum::<f64>() / h.len() as f64).collect();
        let mut hidden = self.linear("control.global.in", &vec![mean]);
        hidden.iter_mut().flatten().for_each(|v| *v *= normal_distribution(*v));
        [self.linear("control.global.out", &hidden), self.linear("control.local", h)].concat()
    }

    /// Logits of a prior with two layers; with `anchors`, those of the frame features of a control.
    pub fn planner(
        &self,
        words: &[u16],
        z: &[u16],
        time: usize,
        fixed: &[bool],
        open: (bool, bool),
        anchors: Option<&Matrix>,
    ) -> Matrix {
        let table = |name: &str| self.matrix(&format!("planner.{name}.weight"));
        let (memory, pooled) = self.text(words);
        let mut first = self.linear("planner.global", &vec![pooled]).remove(0);
        let boundary = match open {
            (false, false) => 0,
            (false, true) => 1,
            (true, false) => 2,
            (true, true) => 3,
        };
        for (c, v) in first.iter_mut().enumerate() {
            *v += table("time")[time][c] + table("boundary")[boundary][c];
        }
        let mut x = vec![first];
        for (i, &token) in z.iter().enumerate() {
            let mut row = table("token")[usize::from(token)].clone();
            for (c, v) in row.iter_mut().enumerate() {
                *v += table("position")[i][c];
                *v += if open.1 { 0.0 } else { table("end")[z.len() - 1 - i][c] };
                *v += if fixed[i] { table("fixed")[0][c] } else { 0.0 };
            }
            x.push(row);
        }
        let h = anchors.map(|features| self.scaffold(features));
        if let Some(h) = h.as_ref().filter(|_| self.map.find("control.local.weight").is_some()) {
            x.iter_mut().flatten().zip(self.dual_context(h).concat()).for_each(|(x, v)| *x += v);
        }
        for m in 0..2 {
            let extra = h.as_ref().map_or_else(Vec::new, |h| {
                let low = self.linear(&format!("control.anchor.{m}.down"), h);
                self.linear(&format!("control.anchor.{m}.kv"), &low)
            });
            x = self.block(&format!("planner.layers.{m}"), &x, 3, Some(&memory), &extra);
        }
        self.linear("planner.token", &self.norm("planner.norm", &x).split_off(1))
    }
}

/// `(1 + erf(x / sqrt 2)) / 2` by Simpson's rule over the density.
fn normal_distribution(x: f64) -> f64 {
    let (steps, density) = (400, |s: f64| (-0.5 * s * s).exp() / (2.0 * core::f64::consts::PI).sqrt());
    let h = x / f64::from(steps);
    let inner: f64 = (1..steps).map(|n| density(f64::from(n) * h) * if n % 2 == 1 { 4.0 } else { 2.0 }).sum();
    0.5 + h / 3.0 * (density(0.0) + inner + density(x))
}

/// Refuses numbers that are farther than `limit` from those expected.
pub fn close<T: Real>(actual: &[T], expected: &Matrix, limit: f64, what: &str) {
    let expected: Vec<f64> = expected.iter().flatten().copied().collect();
    assert_eq!(actual.len(), expected.len(), "{what}");
    let worst = actual.iter().zip(&expected).map(|(a, e)| (a.to_f64() - e).abs()).fold(0.0, f64::max);
    assert!(worst <= limit, "{what}: off by {worst:.3e}");
}
