//! What the thread that makes motions does, on a board as in the simulator: it proves the model, then works off the station's tasks.

use core::ops::ControlFlow;
use motionette::playback::{Feeder, Full, When};
use motionette::{Error, Generator, Model, Observer, Progress, Stop};

use crate::message::{Event, Failure, Stage, Strain, Understood};
use crate::station::{Station, Task};

/// Where the thread finds its station.
pub trait Desk {
    /// The flash of the station.
    type Storage;

    /// Does something with the station, to which the link has no access meanwhile: it MUST be short.
    fn with<R>(&mut self, work: impl FnOnce(&mut Station<'_, Self::Storage>) -> R) -> R;

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

/// An observer that passes on how far the work is, and gives up when the station says so.
struct Watch<'d, D> {
    desk: &'d mut D,
}

impl<D: Desk> Observer for Watch<'_, D> {
    fn progress(&mut self, progress: Progress) -> ControlFlow<Stop> {
        let aborted = self.desk.with(|station| {
            station.progress(progress.stage.into(), progress.evaluation, progress.evaluations);
            station.aborted()
        });
        if aborted { ControlFlow::Break(Stop::Abort) } else { ControlFlow::Continue(()) }
    }
}

/// Works with `model` until another blob is to be opened. The model proves itself first, by the blob's self-test: one that does not is
/// not used.
///
/// # Errors
/// [`Error`] of the generator itself; jobs that fail are told to the station.
pub fn run<D: Desk, const C: usize>(
    model: &Model<'_>,
    arena: &mut [u8],
    feeder: &mut Feeder<'_, C>,
    desk: &mut D,
) -> Result<(), Error> {
    let mut generator = Generator::new(model.clone(), arena)?;
    generator.set_rows(desk.with(|station| station.rows()));
    let proved = generator.self_test()?;
    if proved == Some(false) {
        desk.note(Note::Unproved);
        wait_for_another(desk);
        return Ok(());
    }
    desk.note(Note::Proved { tested: proved.is_some() });
    desk.with(|station| station.opened(model));
    let mut next = None;
    loop {
        match next.take().unwrap_or_else(|| task(desk, feeder)) {
            Task::Reopen => return Ok(()),
            // Nothing is ready any more.
            Task::Play => desk.with(|station| station.played()),
            Task::SelfTest { job } => {
                desk.with(|station| station.progress(Stage::Testing, 0, 0));
                let event = match generator.self_test() {
                    Ok(passed) => Event::SelfTest { job, passed },
                    Err(error) => Event::Failed { job, why: error.into() },
                };
                desk.with(|station| station.done(event));
            }
            Task::Generate { job, request } => {
                let anchors = request.anchors();
                match generator.generate(&request.request(&anchors), &mut Watch { desk: &mut *desk }) {
                    Err(error) => {
                        desk.note(Note::Failed(error.into()));
                        desk.with(|station| station.done(Event::Failed { job, why: error.into() }));
                    }
                    Ok(motion) => {
                        let frames = motion.frames();
                        let control_error = motion.refinement.and_then(|report| report.after).map(|after| after.mean);
                        desk.note(Note::Made { frames: frames.len() });
                        let event = Event::Ready {
                            job,
                            frames: frames.len() as u16,
                            control_error,
                            understood: Understood::of(model, &request.text),
                            strain: Strain::of(&motion),
                        };
                        desk.with(|station| station.done(event));
                        // The motion lies in the arena until the next one is made.
                        next = loop {
                            match task(desk, feeder) {
                                Task::Play => match feeder.play(&motion, When::Then) {
                                    Ok(()) => desk.with(|station| station.played()),
                                    Err(Full::Wait { .. }) => desk.wait(),
                                    Err(full) => {
                                        desk.note(Note::DoesNotFit(full));
                                        desk.with(|station| station.played());
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

/// Does nothing until another blob is to be opened: there is none, or none that can be used.
pub fn wait_for_another<D: Desk>(desk: &mut D) {
    while !desk.with(|station| matches!(station.task(), Some(Task::Reopen))) {
        desk.wait();
    }
}

/// The next task, however long that takes.
fn task<D: Desk, const C: usize>(desk: &mut D, feeder: &Feeder<'_, C>) -> Task {
    loop {
        let queued = feeder.queued();
        let task = desk.with(|station| {
            station.queued(queued);
            station.task()
        });
        match task {
            Some(task) => return task,
            None => desk.wait(),
        }
    }
}
