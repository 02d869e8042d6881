//! The seams, each with the smallest second implementation: a map that is no decoder, a term that no request asks for.

use core::ops::ControlFlow;
use std::cell::Cell;
use std::vec;
use std::vec::Vec;

use super::terms::Floor;
use super::{
    Basis, Config, MotionMap, Objective, ProblemShape, Report, Stop, StopReason, Term, TokenGrid, scratch_bytes, solve,
};
use crate::JOINTS;
use crate::memory::{ALIGNMENT, Arena};
use crate::request::conditions::{Anchor, AnchorSet};

const WIDTH: usize = 3 * JOINTS;
const GRID: TokenGrid = TokenGrid { tokens: 6, frames_per_token: 1 };

/// A token is a frame, its embedding the positions of the joints.
struct Direct {
    positions: Vec<f32>,
    gradient: Vec<f32>,
    /// Bit j: joint j was asked for.
    asked: Cell<u32>,
    errors: Vec<f32>,
}

fn place(joint: u8, frame: usize) -> usize {
    frame * WIDTH + 3 * usize::from(joint)
}

impl MotionMap for Direct {
    fn grid(&self) -> TokenGrid {
        GRID
    }

    fn width(&self) -> usize {
        WIDTH
    }

    fn forward(&mut self, u: &[f32]) -> ControlFlow<Stop> {
        self.positions.copy_from_slice(u);
        ControlFlow::Continue(())
    }

    fn measured(&mut self, error: &super::ControlError) -> ControlFlow<Stop> {
        self.errors.push(error.mean);
        ControlFlow::Continue(())
    }

    fn position(&self, joint: u8, frame: usize) -> [f32; 3] {
        self.asked.set(self.asked.get() | 1 << joint);
        let [x, y, z] = [0, 1, 2].map(|axis| self.positions[place(joint, frame) + axis]);
        [x, y, z]
    }

    fn clear_gradient(&mut self) {
        self.gradient.fill(0.0);
    }

    fn add_gradient(&mut self, joint: u8, frame: usize, d: [f32; 3]) {
        for (slot, d) in self.gradient[place(joint, frame)..].iter_mut().zip(d) {
            *slot += d;
        }
    }

    fn backward(&mut self, du: &mut [f32]) -> ControlFlow<Stop> {
        du.copy_from_slice(&self.gradient);
        ControlFlow::Continue(())
    }
}

/// All joints in the origin, bent by `objective`.
fn bent(objective: &Objective<'_>, config: &Config) -> (Direct, Vec<f32>, Report) {
    let numbers = GRID.tokens * WIDTH;
    let mut map =
        Direct { positions: vec![0.0; numbers], gradient: vec![0.0; numbers], asked: Cell::new(0), errors: Vec::new() };
    let mut u = vec![0.0; numbers];
    let shape = ProblemShape { tokens: GRID.tokens, width: WIDTH, anchors: objective.anchors().len() };
    let mut scratch = vec![0u8; scratch_bytes(shape, config) + ALIGNMENT];
    let report = solve(&mut map, &mut u, objective, config, Arena::new(&mut scratch)).expect("it solves");
    (map, u, report)
}

fn configs() -> [Config; 2] {
    let free = |base| Config { basis: Basis::Plain, trust: 0.0, smoothness: 0.0, stop_error: 0.0, ..base };
    [free(Config::fast(60)), free(Config::published(200))]
}

#[test]
fn a_map_that_is_no_decoder_is_bent_and_told_its_errors() {
    let anchors = [Anchor::root(2, [0.3, 0.9, 0.1]), Anchor::joint(4, 20, [0.1, 1.2, 0.4])];
    let set = AnchorSet::new(&anchors, GRID.frames()).expect("good anchors");
    for config in configs() {
        let objective = Objective::new(&set, &config);
        let (map, u, report) = bent(&objective, &config);
        for (joint, frame, target) in [(0, 2, [0.3, 0.9, 0.1]), (20, 4, [0.1, 1.2, 0.4])] {
            for (found, wanted) in u[place(joint, frame)..].iter().zip(target) {
                assert!((found - wanted).abs() < 0.01, "{config:?}: {found} {wanted}");
            }
        }
        assert_eq!(u.iter().filter(|v| v.abs() > 1e-3).count(), 6, "nothing else moves");
        assert_eq!(map.errors.len(), usize::from(report.evaluations));
        assert_eq!(map.errors.first(), report.before.map(|error| error.mean).as_ref());
        assert!(map.errors.contains(&report.after.expect("measured").mean));
    }
}

#[test]
fn a_term_more_is_met_and_says_what_it_reads() {
    let anchors = [Anchor::joint(4, 20, [0.1, 1.2, 0.4])];
    let set = AnchorSet::new(&anchors, GRID.frames()).expect("good anchors");
    for config in configs() {
        let without = Objective::new(&set, &config);
        assert_eq!(without.joints(), 1 << 20);
        let floor = Floor { weight: 1.0, joint: 7, height: 0.25 };
        let objective = without.clone().with(Term::Floor(floor));
        assert_eq!(objective.joints(), 1 << 20 | 1 << 7);
        let (map, u, report) = bent(&objective, &config);
        assert_eq!(map.asked.get() & !(objective.joints() | 1), 0, "joints that no term reads");
        let heights: Vec<f32> = (0..GRID.tokens).map(|frame| u[place(7, frame) + 1]).collect();
        assert!(heights.iter().all(|y| *y > 0.25 - 0.02), "{config:?}: {heights:?}");
        assert!(report.after.expect("measured").worst < 0.02, "{config:?}: {report:?}");
        let (_, u, _) = bent(&without, &config);
        assert!((0..GRID.tokens).all(|frame| u[place(7, frame) + 1] == 0.0));
    }
}

/// A term without anchors is an objective, too; no term is none.
#[test]
fn terms_are_met_without_anchors() {
    for config in configs() {
        let nothing = Objective::new(&AnchorSet::EMPTY, &config);
        assert_eq!(bent(&nothing, &config).2.reason, StopReason::NoAnchors);
        let floor = Floor { weight: 1.0, joint: 7, height: 0.25 };
        let (_, u, report) = bent(&nothing.with(Term::Floor(floor)), &config);
        assert!(report.objective_after < 0.01 * report.objective_before, "{report:?}");
        assert!((0..GRID.tokens).all(|frame| u[place(7, frame) + 1] > 0.25 - 0.03));
    }
}
