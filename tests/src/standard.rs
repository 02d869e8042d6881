//! The standard request of the budgets, with its multiply-accumulates counted.

use anyhow::{Context, Result};
use motionette::kernels::count;
use motionette::{Generator, Model, Plan};
use motionette_sim::standard;

/// What was planned and what was counted.
#[derive(Debug, Clone, Copy)]
pub struct Counted {
    /// The request's plan.
    pub plan: Plan,
    /// Evaluations that the solver made.
    pub evaluations: u32,
    /// Its gradients.
    pub gradients: u32,
    /// Multiply-accumulates that were made.
    pub macs: u64,
}

impl Counted {
    /// Multiply-accumulates planned for as many evaluations and gradients as were made.
    #[must_use]
    pub const fn planned(&self) -> u64 {
        self.plan.macs_of(self.evaluations, self.gradients)
    }
}

/// Makes the motion: 49 tokens from text with guidance, two root anchors and two wrists, default refinement. Nothing else
/// in the process may use kernels meanwhile.
///
/// # Errors
/// Any error of the model or request.
pub fn count(model: &Model<'_>) -> Result<Counted> {
    let anchors = standard::anchors();
    let request = standard::request().through(&anchors);
    let plan = Generator::new(model.clone(), &mut [])?.plan(&request)?;
    let mut arena = vec![0u8; plan.arena_bytes + 16];
    let mut generator = Generator::new(model.clone(), &mut arena)?;
    count::reset();
    let motion = generator.generate(&request, &mut ())?;
    let macs = count::total();
    let report = motion.refinement.context("the request has anchors")?;
    Ok(Counted { plan, evaluations: report.evaluations.into(), gradients: report.gradients.into(), macs })
}
