//! The objective of refinement: a list of terms, and its gradient with respect to joint positions (AnchorRoute eq. 26-28,
//! EQUATIONS 5).
//!
//! ```text
//! J(u) = L_anc + g_sm L_sm + g_feas L_feas + g_tr ||u - u0||^2
//! ```
//! One module a term. A term says which joints it reads, what it is at a motion, and which way it pulls; what has to be decoded, and
//! how much memory that takes, follows from the list. A new term is a module and a variant of [`Term`].

pub mod anchors;
pub mod feasibility;
#[cfg(test)]
mod floor;
pub mod smoothness;
pub mod trust;

use heapless::Vec;

use super::MotionMap;
use super::config::Config;
use super::metric::{ResidualMetric, Residuals};
use crate::JOINTS;
use crate::request::conditions::AnchorSet;
use anchors::{AnchorTerm, Distances};
use feasibility::Feasibility;
#[cfg(test)]
pub(crate) use floor::Floor;
use smoothness::Smoothness;
use trust::Trust;

/// Most terms of an objective.
pub const MAX_TERMS: usize = 6;

/// One term of the objective, with its weight.
#[derive(Clone, Copy, Debug)]
pub enum Term<'a> {
    /// Distances from the anchors.
    Anchors(AnchorTerm<'a>),
    /// Bends of the anchored joints' paths.
    Smoothness(Smoothness),
    /// Speed of the root beyond what a body can do.
    Feasibility(Feasibility),
    /// Distance from where the solve began.
    Trust(Trust),
    /// The second implementation that the tests put in.
    #[cfg(test)]
    Floor(Floor),
}

impl Term<'_> {
    /// Joints whose positions it reads, bit j for joint j.
    #[must_use]
    pub fn joints(&self) -> u32 {
        match self {
            Term::Anchors(term) => term.joints(),
            Term::Smoothness(term) => term.joints(),
            Term::Feasibility(_) => Feasibility::JOINTS,
            Term::Trust(_) => 0,
            #[cfg(test)]
            Term::Floor(term) => term.joints(),
        }
    }

    /// What it adds to `J` at the motion of the map's last forward pass, with `moved = ||u - u0||^2`.
    pub fn value(&self, map: &impl MotionMap, moved: f32) -> f32 {
        match self {
            Term::Anchors(term) => term.distances(map).squares,
            Term::Smoothness(term) => term.value(map),
            Term::Feasibility(term) => term.value(map),
            Term::Trust(term) => term.value(moved),
            #[cfg(test)]
            Term::Floor(term) => term.value(map),
        }
    }

    /// Adds its gradient with respect to positions to what the map gathers. Anchors pull by `W r` under a metric.
    fn gather(&self, map: &mut impl MotionMap, metric: Option<&ResidualMetric<'_>>) {
        match self {
            Term::Anchors(term) => term.gather(map, metric),
            Term::Smoothness(term) => term.gather(map),
            Term::Feasibility(term) => term.gather(map),
            Term::Trust(_) => {}
            #[cfg(test)]
            Term::Floor(term) => term.gather(map),
        }
    }
}

/// Most joints besides the root that an objective of so many distinct anchors reads.
pub(crate) const fn most_joints(anchors: usize) -> usize {
    if anchors < JOINTS - 1 { anchors } else { JOINTS - 1 }
}

/// `J` and what it was made of at one point.
#[derive(Clone, Copy, Debug)]
pub struct Point {
    /// `J(u)`, square metres.
    pub objective: f32,
    /// What is descended: `J(u)` with `r^T W r` for `L_anc` under a metric, `J(u)` without.
    pub descent: f32,
    /// Distances from the anchors.
    pub distances: Distances,
}

/// The terms of one request. Without anchors there are none.
#[derive(Clone, Debug)]
pub struct Objective<'a> {
    anchors: &'a AnchorSet,
    terms: Vec<Term<'a>, MAX_TERMS>,
}

impl<'a> Objective<'a> {
    /// The objective of `anchors` with the weights of `config`.
    #[must_use]
    pub fn new(anchors: &'a AnchorSet, config: &Config) -> Self {
        let objective = Objective { anchors, terms: Vec::new() };
        if anchors.is_empty() {
            return objective;
        }
        let Config { smoothness, feasibility, max_step, trust, .. } = *config;
        let mut objective = objective.with(Term::Anchors(AnchorTerm::new(anchors)));
        // A weight that is no number is to be noticed.
        if smoothness > 0.0 || smoothness.is_nan() {
            objective = objective.with(Term::Smoothness(Smoothness::new(anchors, smoothness)));
        }
        if feasibility > 0.0 || feasibility.is_nan() {
            objective = objective.with(Term::Feasibility(Feasibility::new(feasibility, max_step)));
        }
        objective.with(Term::Trust(Trust::new(trust)))
    }

    /// The same with one term more, at most [`MAX_TERMS`] in all.
    #[must_use]
    pub fn with(mut self, term: Term<'a>) -> Self {
        let pushed = self.terms.push(term);
        invariant!(pushed.is_ok(), "more than {MAX_TERMS} terms");
        self
    }

    /// The anchors, which cut the motion into intervals.
    #[must_use]
    pub const fn anchors(&self) -> &'a AnchorSet {
        self.anchors
    }

    /// True when there is nothing to meet.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.terms.is_empty()
    }

    /// Joints whose positions the terms read, bit j for joint j.
    #[must_use]
    pub fn joints(&self) -> u32 {
        self.terms.iter().fold(0, |joints, term| joints | term.joints())
    }

    /// Measures the motion of the last forward pass, `moved` being `||u - u0||^2`.
    pub fn measure(&self, map: &impl MotionMap, moved: f32, metric: Option<&ResidualMetric<'_>>) -> Point {
        let mut point = Point { objective: 0.0, descent: 0.0, distances: Distances::NONE };
        for term in &self.terms {
            let (value, descended) = match term {
                Term::Anchors(term) => {
                    point.distances = term.distances(map);
                    let squares = point.distances.squares;
                    (squares, metric.map_or(squares, |metric| metric.apply(&mut Residuals::of(self.anchors, map))))
                }
                other => {
                    let value = other.value(map, moved);
                    (value, value)
                }
            };
            point.objective += value;
            point.descent += descended;
        }
        point
    }

    /// Clears the map's gradient and gathers that of what is descended at the motion of the last forward pass.
    pub fn gather(&self, map: &mut impl MotionMap, metric: Option<&ResidualMetric<'_>>) {
        map.clear_gradient();
        for term in &self.terms {
            term.gather(map, metric);
        }
    }

    /// Adds the gradient of the terms that act on the embeddings themselves. `moved` is `u - u0`, in the same coordinates as
    /// `gradient`, which are orthonormal.
    pub(super) fn add_direct(&self, gradient: &mut [f32], moved: impl Iterator<Item = f32> + Clone) {
        for term in &self.terms {
            if let Term::Trust(term) = term {
                term.add_gradient(gradient, moved.clone());
            }
        }
    }
}
