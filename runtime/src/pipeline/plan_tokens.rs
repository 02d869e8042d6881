//! The planning stage: reads the prompt, settles the length, runs the sampler with the observer watching.

use super::error::Error;
use super::observer::{Observer, Stage, Watch};
use super::sequence::Then;
use crate::codec::codebook::Codebooks;
#[cfg(feature = "autoregressive")]
use crate::generation::tokens::PlanningError;
use crate::generation::tokens::session::Modules;
use crate::generation::tokens::{Length, Planning, PlanningLimits, Session};
use crate::memory::Arena;
use crate::numerics::hash::Stream;
use crate::request::conditions::AnchorSet;
use crate::request::prompt::{Prompt, PromptStats};
use crate::stop::Stop;
use crate::text::VECTORS;
use core::ops::ControlFlow;

/// What planning settled.
#[derive(Debug, Clone, Copy)]
pub(super) struct Planned {
    /// Tokens of the motion.
    pub tokens: usize,
    /// What was understood of the prompt, or of the first of its clauses.
    pub heard: PromptStats,
    /// Of the others.
    pub then: Then,
    /// Each clause of the prompt was planned for itself.
    pub parted: bool,
}

/// Asks the observer, and puts [`Stop::Finish`] off until there are proposals to finish with.
struct Finishing<'w, 'o> {
    watch: &'w mut Watch<'o>,
    /// The end was asked for.
    wanted: bool,
    /// There are proposals.
    ready: bool,
}

impl Finishing<'_, '_> {
    fn ask(&mut self) -> ControlFlow<Stop> {
        let flow = self.watch.ask();
        if flow != ControlFlow::Break(Stop::Finish) {
            return flow;
        }
        self.wanted = true;
        if self.ready { flow } else { ControlFlow::Continue(()) }
    }
}

/// What is to be planned.
#[derive(Debug, Clone, Copy)]
pub(super) struct PlanningTask<'p> {
    /// What the session is made for.
    pub limits: &'p PlanningLimits,
    /// Rows that pass through a layer at a time.
    pub rows: usize,
    pub prompt: &'p Prompt<'p>,
    pub planning: &'p Planning<'p>,
    /// Tokens of a predicted length at least.
    pub shortest: usize,
    /// Tokens of the largest part of the motion: what the session takes does not depend on which of them it is.
    pub capacity: usize,
    /// Of the tokens, so many at the beginning come before what is planned; the planning gives them.
    pub context: usize,
    /// Clauses planned before this one, and all of them.
    pub clause: (u16, u16),
    /// What conditions the planner, as far as it sees it.
    pub anchors: Option<&'p AnchorSet>,
}

/// Plans tokens `[L][Q]` into `tokens`, which has room for the longest motion there may be, in a session that takes its memory from
/// `arena`.
// Its own frame: the session is not to lie on the stack while the tokens are decoded.
#[inline(never)]
pub(super) fn plan_tokens(
    modules: Modules<'_, '_>,
    task: PlanningTask<'_>,
    arena: &mut Arena<'_>,
    tokens: &mut [u16],
    observer: &mut dyn Observer,
) -> Result<Planned, Error> {
    let PlanningTask { limits, rows, prompt, planning, shortest, capacity, context, clause, anchors } = task;
    let mut session = Session::new(modules, arena, capacity, limits, rows).map_err(Error::Arena)?;
    let mut watch = Watch { observer, stage: Stage::Reading, evaluation: 1, evaluations: 1 };
    let mut end = Finishing { watch: &mut watch, wanted: false, ready: false };
    let ControlFlow::Continue(heard) = session.read(prompt, &mut || end.ask())? else { return Err(Error::Aborted) };

    // The first quantizer's tokens are planned side by side, and parted when those of the others come.
    let quantizers = modules.quantizers();
    let mut count = tokens.len() / quantizers;
    let says_length = !VECTORS || modules.text.length().outputs() > 0;
    let in_turn = modules.planner.in_turn();
    if says_length && planning.length == Length::Predicted {
        let least = [shortest, planning.shortest()];
        let mut wanted = context + session.predicted_length();
        for least in least {
            if wanted < least {
                wanted = least;
            }
        }
        if wanted < count {
            count = wanted;
        }
    }
    let all = part_mut!(tokens, ..count * quantizers);
    let tokens = part_mut!(all, ..count);
    if let Some(anchors) = anchors
        && session.anchor(anchors, count, &mut || end.ask()).is_break()
    {
        return Err(Error::Aborted);
    }

    let mut random = Stream::new(planning.seed);
    session.begin(planning, &mut random, tokens);
    end.watch.stage = Stage::Planning;
    #[cfg(feature = "autoregressive")]
    if in_turn {
        // Where the planner may say when the motion ends, it has so many tokens at least.
        let least = match planning.length {
            Length::Predicted => match shortest.max(planning.shortest()).max(context + 1).min(count) {
                1 => 0,
                least => least,
            },
            _ => count,
        };
        count = plan_in_turn(&mut session, planning, least, &mut random, tokens, &mut end)?;
    }
    let first = clause.0.saturating_mul(planning.steps);
    end.watch.evaluations = clause.1.saturating_mul(planning.steps);
    let steps = if in_turn { 0 } else { planning.steps };
    for step in 0..steps {
        end.watch.evaluation = first.saturating_add(step + 1);
        let time = session.time(planning, step);
        match session.pass(tokens, time, planning, &mut || end.ask()) {
            ControlFlow::Continue(()) => {}
            ControlFlow::Break(Stop::Abort) => return Err(Error::Aborted),
            ControlFlow::Break(Stop::Finish) => {
                for (to, from) in tokens.iter_mut().zip(session.proposal()) {
                    *to = *from;
                }
                break;
            }
        }
        let last = end.wanted || step + 1 == planning.steps;
        session.advance(planning, if last { None } else { Some(step) }, &mut random, tokens);
        end.ready = true;
        end.watch.observer.tokens(first.saturating_add(step), tokens);
        if last {
            break;
        }
    }
    if quantizers > 1 {
        let all = part_mut!(all, ..count * quantizers);
        for position in (0..count).rev() {
            let token = all.get(position).copied().unwrap_or(0);
            for (quantizer, to) in all.iter_mut().skip(position * quantizers).take(quantizers).enumerate() {
                *to = if quantizer == 0 { token } else { Codebooks::NONE };
            }
        }
        #[cfg(feature = "residual")]
        if modules.residual.is_some() {
            for quantizer in 1..quantizers {
                if session.detail(prompt, quantizer, all, &mut || end.watch.ask_at_the_end()).is_break() {
                    return Err(Error::Aborted);
                }
                session.draw_detail(quantizer, planning, &mut random, all, &mut |_| {});
            }
            let codes = modules.codebooks.codes();
            for token in all.iter_mut().filter(|token| usize::from(**token) >= codes) {
                *token = Codebooks::NONE;
            }
        }
    }
    Ok(Planned { tokens: count, heard, then: Then::default(), parted: false })
}

/// Plans `tokens` one behind the other, at least so many of them; how many there are comes back.
#[cfg(feature = "autoregressive")]
fn plan_in_turn(
    session: &mut Session<'_, '_, '_>,
    planning: &Planning<'_>,
    least: usize,
    random: &mut Stream,
    tokens: &mut [u16],
    end: &mut Finishing<'_, '_>,
) -> Result<usize, Error> {
    let mut token = 0;
    for at in 0..tokens.len() {
        // What is there is a motion once it is as long as it must be.
        end.ready = at > 0 && at >= least;
        if end.wanted && end.ready {
            return Ok(at);
        }
        end.watch.evaluation = at as u16 + 1;
        end.watch.evaluations = tokens.len() as u16;
        let logits = match session.extend(token, at, &mut || end.ask()) {
            ControlFlow::Continue(logits) => logits,
            ControlFlow::Break(Stop::Abort) => return Err(Error::Aborted),
            ControlFlow::Break(Stop::Finish) => return Ok(at),
        };
        let stop = logits.len().saturating_sub(1);
        if let (true, Some(end)) = (at < least, logits.get_mut(stop)) {
            *end = f32::MIN;
        }
        let drawn = planning.sampling.propose(logits, random);
        token = planning.fixed_at(at).unwrap_or(drawn);
        if usize::from(token) >= stop {
            return if at > 0 { Ok(at) } else { Err(PlanningError::Nothing.into()) };
        }
        if let Some(to) = tokens.get_mut(at) {
            *to = token;
        }
        end.watch.observer.tokens(at as u16, part!(tokens, ..at + 1));
    }
    Ok(tokens.len())
}
