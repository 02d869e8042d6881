//! A prompt of several clauses: each is planned as a segment of a stream would be, behind the last tokens of the one before.

use super::error::Error;
use super::observer::{Observer, Stage, Watch};
use super::plan_tokens::{Planned, PlanningTask, plan_tokens};
use crate::generation::tokens::session::Modules;
use crate::generation::tokens::{CONTEXT, Fixed, Length, Planning, SEED_STEP, Session};
use crate::memory::Arena;
use crate::request::prompt::{Prompt, PromptStats};
use crate::text::Text;
use crate::text::clauses::{Clauses, MAX_CLAUSES};
use crate::text::meaning::Understood;
use core::ops::ControlFlow;
use heapless::Vec;

/// What was understood of the clauses behind the first.
pub(super) type Then = [Option<Understood>; MAX_CLAUSES - 1];

/// The clauses in which a request's prompt is planned; `None` for those of one.
pub(super) fn clauses<'p>(text: &Text<'_>, prompt: &Prompt<'p>, planning: &Planning<'_>) -> Option<Clauses<'p>> {
    if !cfg!(feature = "text") {
        return None;
    }
    let Prompt::Text(prompt) = *prompt else { return None };
    // Given tokens may stand anywhere in the motion, and belong to no clause.
    Some(text.clauses(prompt)).filter(|clauses| clauses.len() > 1 && planning.fixed.is_empty())
}

/// Whether the model knows one action for all that a prompt asks for ("walks ahead and then turns left"): it is sure of one that it finds in
/// none of the clauses. Such a prompt is not parted.
#[inline(never)]
pub(super) fn is_one_action(
    modules: Modules<'_, '_>,
    task: &PlanningTask<'_>,
    clauses: &Clauses<'_>,
    arena: &mut Arena<'_>,
    observer: &mut dyn Observer,
) -> Result<bool, Error> {
    let mut session = Session::new(modules, arena, task.capacity, task.limits, task.rows).map_err(Error::Arena)?;
    let mut watch = Watch { observer, stage: Stage::Reading, evaluation: 1, evaluations: 1 };
    let mut action = |prompt: &Prompt<'_>| match session.read(prompt, &mut || watch.ask_at_the_end())? {
        ControlFlow::Continue(heard) => {
            Ok(heard.understood.filter(|heard| heard.sure).map(|heard| heard.action().phrase))
        }
        ControlFlow::Break(_) => Err(Error::Aborted),
    };
    let Some(whole) = action(task.prompt)? else { return Ok(false) };
    for clause in clauses.iter() {
        if action(&Prompt::Text(clause))? == Some(whole) {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Plans `clauses` one behind the other into `tokens`, which has room for the longest motion there may be.
///
/// A clause takes the tokens that it is predicted to take, and no more than its share of what is left; of a motion whose length is given the
/// last takes all that is left. Clause `k`, counted from 0, draws from the seed plus `k * 0x9E3779B97F4A7C15`, wrapping, and sees up to [`CONTEXT`]
/// tokens in front of it.
#[inline(never)]
pub(super) fn plan_clauses(
    modules: Modules<'_, '_>,
    task: PlanningTask<'_>,
    clauses: &Clauses<'_>,
    arena: &mut Arena<'_>,
    tokens: &mut [u16],
    observer: &mut dyn Observer,
) -> Result<(Planned, usize), Error> {
    let (count, all) = (clauses.len(), tokens.len());
    let (mut known, mut used) = (0, 0);
    let mut heard = PromptStats::default();
    let mut then = Then::default();
    for (k, clause) in clauses.iter().enumerate() {
        let (last, left) = (k + 1 == count, all - known);
        let most = left.div_ceil(count - k);
        let context = if known < CONTEXT { known } else { CONTEXT };
        let begin = known - context;
        let window = part_mut!(tokens, begin..known + most);
        let mut fixed: Vec<Fixed, CONTEXT> = Vec::new();
        for (position, token) in window.iter().take(context).enumerate() {
            let pushed = fixed.push(Fixed { position: position as u16, token: *token });
            invariant!(pushed.is_ok(), "as many as there is room for");
        }
        let given = Length::Tokens((context + most) as u16);
        let planning = Planning {
            length: if last && task.planning.length != Length::Predicted { given } else { Length::Predicted },
            seed: task.planning.seed.wrapping_add((k as u64).wrapping_mul(SEED_STEP)),
            fixed: &fixed,
            start_open: task.planning.start_open || begin > 0,
            end_open: task.planning.end_open || !last,
            ..*task.planning
        };
        let part = PlanningTask {
            prompt: &Prompt::Text(clause),
            planning: &planning,
            shortest: if last { task.shortest.saturating_sub(begin) } else { context + 1 },
            context,
            clause: (k as u16, count as u16),
            anchors: None,
            ..task
        };
        let mut overlay = arena.overlay();
        let planned = plan_tokens(modules, part, &mut overlay, window, observer)?;
        used = if used > overlay.used() { used } else { overlay.used() };
        known = begin + planned.tokens;
        heard.words += planned.heard.words;
        heard.unknown_words += planned.heard.unknown_words;
        match k.checked_sub(1).and_then(|place| then.get_mut(place)) {
            None => heard.understood = planned.heard.understood,
            Some(then) => *then = planned.heard.understood,
        }
    }
    Ok((Planned { tokens: known, heard, then, parted: true }, used))
}
