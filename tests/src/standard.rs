//! The standard request of the budgets, with its multiply-accumulates counted.

use std::path::Path;

use anyhow::{Context, Result};
use motionette::kernels::count;
use motionette::{Anchors, Generator, Joint, Model, Plan, Request};

/// Its text.
pub const PROMPT: &str = "a person walks forward and waves the right hand";
/// Its frames.
pub const FRAMES: u16 = 196;

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

/// A blob's bytes on a boundary that a reader takes.
pub struct Blob {
    words: Vec<u128>,
    length: usize,
}

impl Blob {
    /// Reads a file.
    ///
    /// # Errors
    /// What the system says.
    pub fn read(path: &Path) -> Result<Self> {
        let bytes = std::fs::read(path).with_context(|| path.display().to_string())?;
        let mut words = vec![0u128; bytes.len().div_ceil(16)];
        bytemuck::cast_slice_mut(&mut words)[..bytes.len()].copy_from_slice(&bytes);
        Ok(Blob { words, length: bytes.len() })
    }

    /// The bytes.
    #[must_use]
    pub fn bytes(&self) -> &[u8] {
        &bytemuck::cast_slice(&self.words)[..self.length]
    }
}

/// Makes the motion: 49 tokens from text with guidance, two root anchors and two wrists, default refinement. Nothing else
/// in the process may use kernels meanwhile.
///
/// # Errors
/// Any error of the model or request.
pub fn count(model: &Model<'_>) -> Result<Counted> {
    let anchors = Anchors::new()
        .root_at(4.0, [0.2, 0.9, 2.0])
        .root_at(9.7, [0.4, 0.9, 5.0])
        .joint_at(6.0, Joint::RightWrist, [0.0, 1.5, 3.2])
        .joint_at(8.0, Joint::LeftWrist, [0.5, 1.0, 4.2]);
    let request = Request::text(PROMPT).frames(FRAMES).seed(1).through(anchors.as_slice()?);
    let plan = Generator::new(model.clone(), &mut [])?.plan(&request)?;
    let mut arena = vec![0u8; plan.arena_bytes + 16];
    let mut generator = Generator::new(model.clone(), &mut arena)?;
    count::reset();
    let motion = generator.generate(&request, &mut ())?;
    let macs = count::total();
    let report = motion.refinement.context("the request has anchors")?;
    Ok(Counted { plan, evaluations: report.evaluations.into(), gradients: report.gradients.into(), macs })
}
