//! A row at a time, of a planner that plans so.

use super::{Pass, Session};
use crate::generation::tokens::sampler::Logits;
use crate::stop::{Check, Stop};
use core::ops::ControlFlow;

impl Session<'_, '_, '_> {
    /// One more row of a planner of a token at a time: the first says what is asked for, row `at` beyond it `token`, which stands at position
    /// `at - 1`. Logits `[V + 1]` of the next token; class V ends the motion.
    ///
    /// Breaks off when `check` says so; it is asked behind every block.
    pub fn extend(&mut self, token: u16, at: usize, check: Check<'_>) -> ControlFlow<Stop, &mut [f32]> {
        let planner = self.modules.planner;
        let x = part_mut!(self.x, ..planner.width());
        let mut spare = self.spare.overlay();
        let mut pass = worked_in!(Pass::new(&mut spare, &self.needed), ControlFlow::Continue(&mut []));
        planner.extend((token, at), &self.text, &mut self.cache, x, &mut pass.scratch, check)?;
        let mut spare = self.spare.overlay();
        let mut logits = worked_in!(Logits::new(planner.head(), x, &mut spare), ControlFlow::Continue(&mut []));
        logits.each(|_, _| {});
        ControlFlow::Continue(logits.first())
    }
}
