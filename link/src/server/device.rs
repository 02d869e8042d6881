//! What the server needs of a device.

use crate::message::{Condition, Event, Generate, ModelInfo, Name, Refusal};
use crate::update::{Storage, Store};

/// Where frames go.
pub trait Sink {
    /// Bytes that [`Sink::send`] can take now.
    fn room(&self) -> usize;

    /// Takes a whole frame, no longer than [`Sink::room`].
    fn send(&mut self, frame: &[u8]);
}

impl<const N: usize> Sink for heapless::Vec<u8, N> {
    fn room(&self) -> usize {
        self.capacity().saturating_sub(self.len())
    }

    fn send(&mut self, frame: &[u8]) {
        // The caller asked for room.
        let _ = self.extend_from_slice(frame);
    }
}

/// What is to be worked on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Job<'a> {
    /// A motion; [`Generate::request`] makes the runtime's request of it. Where [`Generate::conditions`] is set, the conditions lie whole
    /// at the beginning of [`Device::area`]; [`Conditions`](crate::conditions::Conditions) reads them.
    Generate(&'a Generate),
    /// [`motionette::Generator::self_test`].
    SelfTest,
}

/// What a device says of itself.
#[derive(Debug, Clone, PartialEq)]
pub struct Description {
    /// The robot it is set up as.
    pub preset: Name,
    /// Its model.
    pub model: Option<ModelInfo>,
    /// Bytes of the memory for conditions, whoever uses it now; 0: there is none.
    pub condition_bytes: u32,
}

/// The robot, as the link sees it.
///
/// Every method MUST return at once: the link may run in an interrupt. What takes time is handed over and its end reported
/// by [`Device::event`]. A movement that a
/// method has begun MUST show in [`Device::condition`] when it returns, even where it takes effect at the next tick.
pub trait Device {
    /// The flash that holds blobs.
    type Storage: Storage;

    /// What it is.
    fn describe(&self) -> Description;

    /// How it stands. `work` MUST be present from the return of a successful [`Device::start`] until its event has been
    /// made.
    fn condition(&self) -> Condition;

    /// Hands a job to whoever runs it; `job` is to come back in its event. Called only while there is no work.
    ///
    /// # Errors
    /// Why it cannot be done now: no model, a motion that plays out of the same memory; for a motion that is to play by itself also what
    /// [`Device::play`] would be refused for, so that it is not made in vain.
    fn start(&mut self, job: u32, work: Job<'_>) -> Result<(), Refusal>;

    /// Plays the motion that is ready.
    ///
    /// # Errors
    /// [`Refusal::NothingToPlay`], [`Refusal::Moving`], [`Refusal::Stopped`], or [`Refusal::NotReady`].
    fn play(&mut self) -> Result<(), Refusal>;

    /// Emergency stop. MUST end movement and work at once, and MUST NOT fail: state is `Stopped` until
    /// [`Device::neutral`], and the job's event says that it failed.
    fn stop(&mut self);

    /// Comes to rest within the motion. A job's motion that was to play by itself MUST NOT begin to.
    ///
    /// # Errors
    /// [`Refusal::NotPlaying`].
    fn hold(&mut self) -> Result<(), Refusal>;

    /// Goes on after [`Device::hold`].
    ///
    /// # Errors
    /// [`Refusal::NotPlaying`] or [`Refusal::Stopped`].
    fn resume(&mut self) -> Result<(), Refusal>;

    /// Moves to the neutral pose; ends `Stopped`.
    ///
    /// # Errors
    /// [`Refusal::Moving`].
    fn neutral(&mut self) -> Result<(), Refusal>;

    /// Lets servos that cannot say where they stand have their first pulses.
    ///
    /// # Errors
    /// [`Refusal::NotWaiting`] or [`Refusal::Stopped`].
    fn release(&mut self) -> Result<(), Refusal>;

    /// Takes the next thing that has happened.
    fn event(&mut self) -> Option<Event>;

    /// The flash that holds blobs, if the device has such.
    fn storage(&mut self) -> Option<&mut Self::Storage>;

    /// The memory for conditions; `None`: there is none, or a job uses it. MUST be there, and hold what was written there before, whenever
    /// no job is under way. By default there is none.
    fn area(&mut self) -> Option<&mut [u32]> {
        None
    }

    /// Another blob is the active one: whoever runs jobs is to open it before the next.
    fn activated(&mut self, store: &Store);
}
