//! The further quantizers, behind the planner of the first.

use super::{Modules, Pass, Reading, Session};
use crate::generation::tokens::Planning;
use crate::generation::tokens::sampler::Logits;
use crate::numerics::hash::Stream;
use crate::request::prompt::Prompt;
use crate::stop::{Check, Stop};
use core::ops::ControlFlow;

impl Session<'_, '_, '_> {
    /// The residual planner's pass for a quantizer from 1 on, two where it is guided, given the tokens `[L][Q]` of the quantizers before it: what
    /// [`Session::draw_detail`] reads. Nothing without such a planner.
    ///
    /// Breaks off when `check` says so; it is asked behind every block.
    pub fn detail(
        &mut self,
        prompt: &Prompt<'_>,
        quantizer: usize,
        tokens: &[u16],
        check: Check<'_>,
    ) -> ControlFlow<Stop> {
        let Modules { text, residual: Some(residual), codebooks, .. } = self.modules else {
            return ControlFlow::Continue(());
        };
        let (quantizers, width) = (codebooks.quantizers().max(1), residual.width());
        let length = tokens.len() / quantizers;
        let x = part_mut!(self.x, ..(2 + length) * width);
        let mut spare = self.spare.overlay();
        let mut pass = worked_in!(Pass::new(&mut spare, &self.needed), ControlFlow::Continue(()));
        let guided = core::mem::take(&mut pass.guided);
        // What says nothing comes first: guidance leads from there.
        for asked in [false, true] {
            if !asked && !residual.guided() {
                continue;
            }
            let reading = if asked { Reading::of(prompt, 0) } else { Reading::Vector(&[]) };
            reading.recall(text, &mut [], self.pooled);
            let mut scratch = pass.rows(2 + length);
            residual.forward(quantizer, self.pooled, (tokens, quantizers), x, &mut scratch, check)?;
            let rows = x.iter_mut().skip(2 * width);
            if !asked {
                for (to, from) in guided.iter_mut().zip(rows) {
                    *to = *from;
                }
            } else if residual.guided() {
                for (with, without) in rows.zip(guided.iter()) {
                    *with = *without + residual.guidance() * (*with - *without);
                }
            }
        }
        ControlFlow::Continue(())
    }

    /// Draws the tokens of a quantizer into `tokens [L][Q]` by the last [`Session::detail`]; class V, nothing, is one of them. What they were drawn
    /// from is shown to `see`, position by position.
    pub fn draw_detail(
        &mut self,
        quantizer: usize,
        planning: &Planning<'_>,
        random: &mut Stream,
        tokens: &mut [u16],
        see: &mut dyn FnMut(&[f32]),
    ) {
        let Modules { residual: Some(residual), codebooks, .. } = self.modules else { return };
        let (quantizers, width) = (codebooks.quantizers().max(1), residual.width());
        let rows = part!(self.x, 2 * width..(2 + tokens.len() / quantizers) * width);
        let mut spare = self.spare.overlay();
        let Some(head) = residual.head(quantizer) else { return };
        let mut logits = worked_in!(Logits::new(&head, rows, &mut spare));
        logits.each(|i, logits| {
            see(logits);
            let drawn = planning.sampling.propose(logits, random);
            if let Some(to) = tokens.get_mut(i * quantizers + quantizer) {
                *to = drawn;
            }
        });
    }
}
