//! The planning stage: reads the prompt, settles the length, runs the sampler with the observer watching.

use super::error::Error;
use super::observer::{Observer, Stage, Watch};
use crate::hash::Stream;
use crate::memory::Arena;
use crate::nn::Interrupted;
use crate::perception::anchors::AnchorSet;
use crate::perception::prompt::{Heard, Prompt};
use crate::planning::session::Modules;
use crate::planning::{Length, Limits, Planning, Session};
use crate::refining::Stop;

/// What planning settled.
#[derive(Debug, Clone, Copy)]
pub(super) struct Planned {
    /// Tokens of the motion.
    pub tokens: usize,
    /// What was understood of the prompt.
    pub heard: Heard,
}

/// What the observer has wished for.
#[derive(Debug, Clone, Copy, Default)]
struct Wish {
    finish: bool,
    /// Whether there are proposals to finish with.
    ready: bool,
    abort: bool,
}

impl Wish {
    /// Asks the observer. A wish to finish ends the pass only when there is something to finish with.
    fn ask(&mut self, watch: &mut Watch<'_>) -> Result<(), Interrupted> {
        match watch.ask() {
            Ok(()) => Ok(()),
            Err(Stop::Abort) => {
                self.abort = true;
                Err(Interrupted)
            }
            Err(Stop::Finish) => {
                self.finish = true;
                if self.ready { Err(Interrupted) } else { Ok(()) }
            }
        }
    }
}

/// Plans the tokens of `prompt` into `tokens`, which has room for the longest motion there may be, conditioned by `anchors`, in a
/// session within `limits` that takes its memory from `arena`. A predicted length is at least `shortest`.
// Its own frame: the session is not to lie on the stack while the tokens are decoded.
#[inline(never)]
pub(super) fn plan_tokens(
    modules: Modules<'_, '_>,
    (limits, rows): (&Limits, usize),
    arena: &mut Arena<'_>,
    prompt: &Prompt<'_>,
    planning: &Planning<'_>,
    shortest: usize,
    anchors: Option<&AnchorSet>,
    tokens: &mut [u16],
    observer: &mut dyn Observer,
) -> Result<Planned, Error> {
    let mut session = Session::new(modules, arena, tokens.len(), limits, rows).map_err(Error::Arena)?;
    let mut wish = Wish::default();
    let mut watch = Watch { observer, stage: Stage::Reading, evaluation: 1, evaluations: 1 };
    let heard = session.read(prompt, &mut || wish.ask(&mut watch))?;
    let heard = heard.map_err(|Interrupted| Error::Aborted)?;

    let mut count = tokens.len();
    if planning.length == Length::Predicted {
        let least = [shortest, planning.shortest()];
        let mut wanted = session.predicted_length();
        for least in least {
            if wanted < least {
                wanted = least;
            }
        }
        if wanted < count {
            count = wanted;
        }
    }
    let tokens = part_mut!(tokens, ..count);
    if let Some(anchors) = anchors {
        session.anchor(anchors, count, &mut || wish.ask(&mut watch)).map_err(|Interrupted| Error::Aborted)?;
    }

    let mut stream = Stream::new(planning.seed);
    session.begin(planning, &mut stream, tokens);
    watch.stage = Stage::Planning;
    watch.evaluations = planning.steps;
    for step in 0..planning.steps {
        watch.evaluation = step + 1;
        let time = planning.schedule.time(step, planning.steps);
        if session.pass(tokens, time, planning, &mut || wish.ask(&mut watch)).is_err() {
            if wish.abort {
                return Err(Error::Aborted);
            }
            for (to, from) in tokens.iter_mut().zip(session.proposal()) {
                *to = *from;
            }
            break;
        }
        let last = wish.finish || step + 1 == planning.steps;
        let next = planning.schedule.time(step + 1, planning.steps);
        let stride = session.tmd().step(time, next);
        session.advance(planning, if last { None } else { Some(&stride) }, &mut stream, tokens);
        wish.ready = true;
        watch.observer.tokens(step, tokens);
        if last {
            break;
        }
    }
    Ok(Planned { tokens: count, heard })
}
