//! The seam between network and sampler: another rule takes its place beside TMD, and nothing outside of it changes.

use std::ops::ControlFlow;

use motionette::codec::codebook::Codebooks;
use motionette::generation::tokens::sampler::{Draw, Logits, TokenSampler};
use motionette::generation::tokens::{PlanningLimits, Session};
use motionette::memory::{Arena, ArenaTooSmall};
use motionette::numerics::hash::Stream;
use motionette::{Fixed, Model, Planning, Prompt, ROWS};
use motionette_tests::tiny::{PriorShape, Shape, Tiny};

/// Each step keeps the tokens whose logits are the largest and makes all others token 0 again, as a masked planner does: the smallest
/// rule that must look at all positions before it settles one.
struct MostConfident {
    /// Tokens that a step settles.
    kept: usize,
}

/// The largest logit and its token.
fn best(logits: &[f32]) -> (f32, u16) {
    logits.iter().zip(0u16..).fold((f32::NEG_INFINITY, 0), |best, (&v, i)| if v > best.0 { (v, i) } else { best })
}

impl TokenSampler for MostConfident {
    /// The largest logit of each position.
    type Work<'s> = &'s mut [f32];

    fn layout<'s>(
        &self,
        arena: &mut Arena<'s>,
        _: usize,
        codebooks: &Codebooks<'_>,
    ) -> Result<&'s mut [f32], ArenaTooSmall> {
        // Less than the metric of token metric diffusion takes, so the session has room.
        arena.take(codebooks.codes())
    }

    fn time(&self, planning: &Planning<'_>, step: u16) -> f32 {
        planning.schedule.time(step, planning.steps)
    }

    fn macs(&self, _: &Codebooks<'_>) -> u64 {
        0
    }

    fn begin(&self, planning: &Planning<'_>, _: usize, _: &mut Stream, tokens: &mut [u16]) {
        for (i, token) in tokens.iter_mut().enumerate() {
            *token = planning.fixed_at(i).unwrap_or(0);
        }
    }

    fn step(&self, _: u16, logits: &mut Logits<'_, '_, '_>, _: &Codebooks<'_>, work: &mut &mut [f32], draw: Draw<'_>) {
        let Draw { planning, tokens, proposals, .. } = draw;
        logits.each(|i, logits| (work[i], proposals[i]) = best(logits));
        let mut order: Vec<usize> = (0..tokens.len()).collect();
        order.sort_by(|&a, &b| work[b].total_cmp(&work[a]));
        for (place, i) in order.into_iter().enumerate() {
            tokens[i] = planning.fixed_at(i).unwrap_or(if place < self.kept { proposals[i] } else { 0 });
        }
    }

    fn finish(&self, logits: &mut Logits<'_, '_, '_>, _: &mut &mut [f32], draw: Draw<'_>) {
        let Draw { planning, tokens, .. } = draw;
        logits.each(|i, logits| tokens[i] = planning.fixed_at(i).unwrap_or(best(logits).1));
    }
}

#[test]
fn another_rule_draws_by_the_same_passes() {
    let shape = Shape { codes: 11, prior: Some(PriorShape::default()), ..Shape::with_prior() };
    let tiny = Tiny::new(shape, 5);
    let model = Model::open(tiny.bytes()).expect("the blob opens");
    let modules = model.planning().expect("the blob plans");
    let (length, fixed) = (7, [Fixed { position: 2, token: 9 }]);
    let limits = PlanningLimits { words: 3, steps: 2, guided: true, anchors: false, clauses: 1 };
    let planning = Planning { fixed: &fixed, ..Planning::DEFAULT };
    let mut words = vec![0u128; modules.bytes(length, &limits, ROWS).all() / 16];
    let mut arena = Arena::new(bytemuck::cast_slice_mut(&mut words));
    let mut session = Session::new(modules, &mut arena, length, &limits, ROWS).expect("the planned bytes suffice");
    let mut go_on = || ControlFlow::Continue(());
    assert!(session.read(&Prompt::Text("a person waves"), &mut go_on).expect("known words").is_continue());

    let sampler = MostConfident { kept: 3 };
    let (mut random, mut tokens) = (Stream::new(1), [5u16; 7]);
    sampler.begin(&planning, model.codebooks().codes(), &mut random, &mut tokens);
    assert_eq!(tokens, [0, 0, 9, 0, 0, 0, 0]);
    for last in [false, true] {
        assert!(session.pass(&tokens, 0.0, &planning, &mut go_on).is_continue());
        // What the session says of one position at a time is the oracle.
        let most: Vec<(f32, u16)> = (0..length).map(|i| best(session.logits(i))).collect();
        let step = if last { None } else { Some(0) };
        session.advance_by(&sampler, &planning, step, &mut random, &mut tokens);
        for (i, token) in tokens.iter().enumerate() {
            let ahead = most.iter().filter(|other| other.0 > most[i].0).count();
            let want = match i {
                2 => 9,
                _ if last || ahead < 3 => most[i].1,
                _ => 0,
            };
            assert_eq!(*token, want, "position {i}, last step: {last}");
        }
    }
    assert!(tokens.iter().collect::<std::collections::HashSet<_>>().len() > 2, "{tokens:?} prove nothing");
}
