//! What the thread that makes motions does, on a board as in the simulator: it proves the model, then works off its tasks.

use core::ops::ControlFlow;
use motionette::playback::{Feeder, Full, When};
use motionette::{Error, Generator, Model, Motion, Observer, Progress, Prompt, Request, Source, Stop};

use crate::conditions::Conditions;
use crate::device_state::{DeviceState, Task};
use crate::message::{Clearance, Event, Failure, Generate, JobStage, Strain, Tracking, Understood};

/// Where the thread finds the state of its device.
pub trait JobHost {
    /// The flash of the device.
    type Storage;

    /// Does something with the state, to which the link has no access meanwhile: it MUST be short.
    fn with<R>(&mut self, work: impl FnOnce(&mut DeviceState<'_, Self::Storage>) -> R) -> R;

    /// Lets time pass until something may have changed.
    fn wait(&mut self);

    /// Something for the log.
    fn note(&mut self, note: Note);
}

/// What the thread has to say.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Note {
    /// The model has proved itself, or carries no self-test.
    Proved {
        /// Whether it carries one.
        tested: bool,
    },
    /// The model made other bits than it should: the robot does not move.
    Unproved,
    /// A motion was made.
    Made {
        /// Its frames.
        frames: usize,
    },
    /// A job failed.
    Failed(Failure),
    /// A motion does not fit the line.
    DoesNotFit(Full),
}

/// An observer that passes on how far the work is, and gives up when the device says so.
struct Watch<'d, D> {
    jobs: &'d mut D,
}

impl<D: JobHost> Observer for Watch<'_, D> {
    fn progress(&mut self, progress: Progress) -> ControlFlow<Stop> {
        let aborted = self.jobs.with(|state| {
            state.progress(progress.stage.into(), progress.evaluation, progress.evaluations);
            state.aborted()
        });
        if aborted { ControlFlow::Break(Stop::Abort) } else { ControlFlow::Continue(()) }
    }
}

/// Works with `model` until another blob is to be opened. The model proves itself first, by the blob's self-test: one that does not is
/// not used.
///
/// # Errors
/// [`Error`] of the generator itself; jobs that fail are told to the device's state.
pub fn run<D: JobHost, const C: usize>(
    model: &Model<'_>,
    arena: &mut [u8],
    feeder: &mut Feeder<'_, C>,
    jobs: &mut D,
) -> Result<(), Error> {
    let mut generator = Generator::new(model.clone(), arena)?;
    generator.set_rows(jobs.with(|state| state.rows()));
    let proved = generator.self_test()?;
    if proved == Some(false) {
        jobs.note(Note::Unproved);
        wait_for_another(jobs);
        return Ok(());
    }
    jobs.note(Note::Proved { tested: proved.is_some() });
    jobs.with(|state| state.opened(model));
    let mut next = None;
    loop {
        match next.take().unwrap_or_else(|| task(jobs, feeder)) {
            Task::Reopen => return Ok(()),
            // Nothing is ready any more.
            Task::Play => jobs.with(|state| state.played()),
            Task::SelfTest { job } => {
                jobs.with(|state| state.progress(JobStage::Testing, 0, 0));
                let event = match generator.self_test() {
                    Ok(passed) => Event::SelfTest { job, passed },
                    Err(error) => Event::Failed { job, why: error.into() },
                };
                jobs.with(|state| state.done(event));
            }
            Task::Generate { job, request, area } => {
                let watch = &mut Watch { jobs: &mut *jobs };
                let made = match area.as_deref() {
                    None => make(&mut generator, &request, watch),
                    Some(area) => make_under(&mut generator, &request, area, watch),
                };
                if let Some(area) = area {
                    jobs.with(|state| state.returned(area));
                }
                match made {
                    Err(why) => {
                        jobs.note(Note::Failed(why));
                        jobs.with(|state| state.done(Event::Failed { job, why }));
                    }
                    Ok(motion) => {
                        let frames = motion.frames();
                        let control_error = motion.refinement.and_then(|report| report.after).map(|after| after.mean);
                        jobs.note(Note::Made { frames: frames.len() });
                        let event = Event::Ready {
                            job,
                            frames: frames.len() as u16,
                            control_error,
                            understood: Understood::of(
                                model,
                                motion.understood().into_iter().chain(motion.then()),
                                &request.text,
                            ),
                            strain: Strain::of(&motion),
                            tracking: Tracking::of(&motion),
                            clearance: Clearance::of(&motion),
                        };
                        jobs.with(|state| state.done(event));
                        // The motion lies in the arena until the next one is made.
                        next = loop {
                            match task(jobs, feeder) {
                                Task::Play => match feeder.play(&motion, When::Then) {
                                    Ok(()) => jobs.with(|state| state.played()),
                                    Err(Full::Wait { .. }) => jobs.wait(),
                                    Err(full) => {
                                        jobs.note(Note::DoesNotFit(full));
                                        jobs.with(|state| state.played());
                                    }
                                },
                                other => break Some(other),
                            }
                        };
                    }
                }
            }
        }
    }
}

/// A motion without conditions.
fn make<'m>(
    generator: &'m mut Generator<'_>,
    request: &Generate,
    observer: &mut impl Observer,
) -> Result<Motion<'m>, Failure> {
    let anchors = request.anchors();
    Ok(generator.generate(&request.request(&anchors), observer)?)
}

/// A motion with the conditions in `area`. What they are listed in is on the stack of no other.
#[inline(never)]
fn make_under<'m>(
    generator: &'m mut Generator<'_>,
    request: &Generate,
    area: &[u32],
    observer: &mut impl Observer,
) -> Result<Motion<'m>, Failure> {
    // The link has opened them before.
    let conditions = Conditions::open(area).map_err(|_| Failure::Unknown)?;
    let (anchors, tracks, keyframes) = (request.anchors(), conditions.tracks(), conditions.keyframes());
    let obstacles = conditions.obstacles(&keyframes);
    let timeline = conditions.timeline();
    let words = request.request(&anchors).tracks(&tracks).obstacles(&obstacles).timeline(&timeline);
    let request = match conditions.vector() {
        Some(vector) => Request { source: Source::Text(Prompt::Vector(vector)), ..words },
        None => words,
    };
    Ok(generator.generate(&request, observer)?)
}

/// Does nothing until another blob is to be opened: there is none, or none that can be used.
pub fn wait_for_another<D: JobHost>(jobs: &mut D) {
    while !jobs.with(|state| matches!(state.task(), Some(Task::Reopen))) {
        jobs.wait();
    }
}

/// The next task, however long that takes.
fn task<D: JobHost, const C: usize>(jobs: &mut D, feeder: &Feeder<'_, C>) -> Task {
    loop {
        let queued = feeder.queued();
        let task = jobs.with(|state| {
            state.queued(queued);
            state.task()
        });
        match task {
            Some(task) => return task,
            None => jobs.wait(),
        }
    }
}
