//! What the solver is asked to do: method, budget, weights, basis.

use super::metric::Prior;
use super::motion_space::Exact;
use crate::request::conditions::{AnchorSet, Family};

/// One number for each control family.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct PerFamily {
    /// Root-3D.
    pub root_3d: f32,
    /// Planar-root.
    pub planar_root: f32,
    /// Body-point.
    pub body_point: f32,
}

impl PerFamily {
    /// The same number for all.
    pub const fn all(value: f32) -> Self {
        Self { root_3d: value, planar_root: value, body_point: value }
    }

    /// Number of one family.
    pub const fn get(&self, family: Family) -> f32 {
        match family {
            Family::Root3d => self.root_3d,
            Family::PlanarRoot => self.planar_root,
            Family::BodyPoint => self.body_point,
        }
    }

    /// Smallest number among the families present in `anchors`; the Body-point one when there are none.
    pub fn smallest(&self, anchors: &AnchorSet) -> f32 {
        let mut smallest = None;
        for anchor in anchors.iter() {
            let value = self.get(anchor.family);
            smallest = match smallest {
                Some(old) if old <= value => Some(old),
                _ => Some(value),
            };
        }
        smallest.unwrap_or(self.body_point)
    }
}

/// How the solver steps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Method {
    /// Quasi-Newton in the coefficients of the interval basis: the default, for a few tens of decoder evaluations.
    QuasiNewton,
    /// RouteSolver as published: an Adam step on the tokens, then its ridge projection onto the interval basis.
    Published,
}

/// Functions of normalised time that span an interval's correction (EQUATIONS 5). With `x = 2 s - 1` in -1..1.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Basis {
    /// Ablation "plain": no basis, every token moves freely and activity is not used.
    Plain,
    /// Ablation: `1`.
    Transport,
    /// Ablation: `x`.
    Slope,
    /// `1, x`: piecewise affine, as published.
    Affine,
    /// Ablation: `1, x` and the second Legendre polynomial.
    Quadratic,
    /// Ablation: `1, x` and the second and third Legendre polynomials.
    Cubic,
}

impl Basis {
    /// Functions an interval with enough tokens uses.
    pub const fn functions(self) -> usize {
        match self {
            Basis::Plain => 0,
            Basis::Transport | Basis::Slope => 1,
            Basis::Affine => 2,
            Basis::Quadratic => 3,
            Basis::Cubic => 4,
        }
    }
}

/// Where an interval's activity `a_i` comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Activity {
    /// `clip(larger endpoint error / rho, 0, 1)`, refreshed every step, as published.
    Residual,
    /// Ablation: 1 everywhere.
    Uniform,
    /// Ablation: residual activities, randomly permuted among the intervals at every step.
    Shuffled,
}

/// Everything that steers a solve. The defaults of [`Config::fast`] and [`Config::published`] are documented there.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Config {
    /// Stepping method.
    pub method: Method,
    /// Hard limit on decoder evaluations (forward passes), line-search trials included.
    pub evaluations: u16,
    /// The solve ends when no anchor is further off than this, metres. 0 runs the whole budget.
    pub stop_error: f32,
    /// Weight of the smoothness term, `g_sm`.
    pub smoothness: f32,
    /// Weight of the trust-region term, `g_tr`.
    pub trust: f32,
    /// Weight of the feasibility term, `g_feas`; 0 switches it off.
    pub feasibility: f32,
    /// Largest root displacement a frame that the feasibility term accepts, metres.
    pub max_step: f32,
    /// Interval basis.
    pub basis: Basis,
    /// Source of the activities.
    pub activity: Activity,
    /// Ridge weight `lambda`.
    pub ridge: f32,
    /// Control error at which an interval is fully active, `rho_f`, metres.
    pub tolerance: PerFamily,
    /// Adam's learning rate ([`Method::Published`] only); a mixture of families takes the smallest of theirs.
    pub learning_rate: PerFamily,
    /// Metric of the residuals ([`Method::QuasiNewton`] only); `None` descends `J` as it is.
    pub prior: Option<Prior>,
    /// Pairs the quasi-Newton method remembers, 1..=[`MAX_MEMORY`](super::optimiser::lbfgs::MAX_MEMORY).
    pub memory: u8,
    /// Seed of the shuffled activity.
    pub seed: u32,
    /// The edit in motion space, behind the decoder: what meets the anchors exactly. With no evaluations it is all there is.
    pub exact: Option<Exact>,
}

impl Config {
    /// What a request takes that says nothing else.
    pub const DEFAULT: Self = Self::exact();

    /// What a request takes that wants the motion as it was decoded.
    pub(crate) const NONE: Self = Self::fast(0);

    /// Token embeddings bent by quasi-Newton steps, with a budget of decoder evaluations. Chosen on val clips with K = 2, 4, 8 anchors of each family:
    /// - trust 1e-6: ten times more leaves 3 mm at K = 2, none lets `||u - u0||` grow by a fifth;
    /// - smoothness 0.1 does not show; 3 takes 4 to 10 % off the jerk and costs body points a quarter more error;
    /// - ridge 0 to 1, memory 3 to 8 and other bases move the error by less than a fifth;
    /// - the metric divides the error after 20 evaluations by six.
    pub const fn fast(evaluations: u16) -> Self {
        Self {
            method: Method::QuasiNewton,
            evaluations,
            stop_error: 0.001,
            smoothness: 0.1,
            trust: 1e-6,
            feasibility: 0.0,
            max_step: 0.25,
            basis: Basis::Affine,
            activity: Activity::Residual,
            ridge: 0.3,
            tolerance: PerFamily::all(0.05),
            learning_rate: PerFamily::all(0.1),
            prior: Some(Prior::NANO),
            memory: 5,
            seed: 1,
            exact: None,
        }
    }

    /// The edit in motion space alone: no decoder evaluation.
    pub const fn exact() -> Self {
        Self { exact: Some(Exact::DEFAULT), ..Self::fast(0) }
    }

    /// The same, with the edit in motion space behind it.
    #[must_use]
    pub const fn exactly(self) -> Self {
        Self { exact: Some(Exact::DEFAULT), ..self }
    }

    /// The same edit in motion space with feet that do not stay where they stand.
    #[must_use]
    pub const fn free_feet(self) -> Self {
        match self.exact {
            Some(exact) => Self { exact: Some(Exact { planted: false, ..exact }), ..self },
            None => self,
        }
    }

    /// Whether token embeddings are bent at all.
    pub(crate) const fn bends(&self) -> bool {
        self.evaluations > 0 || self.exact.is_none()
    }

    /// RouteSolver as published with `steps` Adam steps (RS100, RS200, RS500). The last step's result is evaluated too, so
    /// the budget is one evaluation larger than the number of steps. The learning rate is the largest that keeps jerk near
    /// the start's on val clips, not the one with the smallest error: 0.2 and 0.4 halve the error again at more jerk and
    /// distance (the simulator's `solver_grid` example makes such a grid).
    pub const fn published(steps: u16) -> Self {
        Self { method: Method::Published, evaluations: steps.saturating_add(1), stop_error: 0.0, ..Self::fast(0) }
    }
}

impl Default for Config {
    fn default() -> Self {
        Self::DEFAULT
    }
}
