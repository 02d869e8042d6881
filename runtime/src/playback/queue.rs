//! The line from whoever makes motions to the interrupt that plays them: a lock-free queue of mapped frames.

use core::fmt;

use heapless::spsc::{Consumer, Producer, Queue};

use super::control::Control;
use super::mapper::Mapper;
use super::player::Player;
use super::robot::Robot;
use crate::Motion;
use crate::representation::Pose;

/// Steps of a degree in which angles are queued.
const STEPS: f32 = 100.0;

/// What is queued: at most `C` servo angles, or where a motion begins or ends.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Item<const C: usize> {
    /// A motion begins.
    Begin {
        /// Its number, high half first: an item has the alignment of its frames.
        number: [u16; 2],
        /// Frames a second, not 0.
        frame_rate: u16,
    },
    /// Hundredths of a degree.
    Frame([i16; C]),
    /// The motion has no more frames.
    End,
}

/// Whether the motion of this number comes before that of the other one; numbers begin again after 2^32.
pub(super) const fn is_before(number: u32, other: u32) -> bool {
    other.wrapping_sub(number).wrapping_sub(1) < u32::MAX / 2
}

/// Halves of a number, and the number again.
const fn halves(number: u32) -> [u16; 2] {
    [(number >> 16) as u16, number as u16]
}

/// See [`halves`].
pub(super) const fn whole([high, low]: [u16; 2]) -> u32 {
    (high as u32) << 16 | low as u32
}

/// Static memory of a playback line: `C` servo channels, `N - 1` places for frames (a motion takes its frames and two more).
///
/// `size_of::<MotionQueue<C, N>>()` is all the memory that playback needs beside [`Feeder`] and [`Player`].
pub struct MotionQueue<const C: usize, const N: usize> {
    queue: Queue<Item<C>, N>,
    control: Control,
}

impl<const C: usize, const N: usize> Default for MotionQueue<C, N> {
    fn default() -> Self {
        MotionQueue::new()
    }
}

impl<const C: usize, const N: usize> MotionQueue<C, N> {
    /// An empty line.
    #[must_use]
    pub const fn new() -> Self {
        MotionQueue { queue: Queue::new(), control: Control::new() }
    }

    /// The end that motions are put in at, the end that plays them, and the orders for it. The player takes the robot to stand
    /// at neutral until it is told otherwise ([`Player::stand_at`]).
    ///
    /// # Errors
    /// [`TooManyChannels`] when the robot has more than `C`.
    pub fn split<'a>(&'a mut self, robot: &'a Robot) -> Result<Handles<'a, C>, TooManyChannels> {
        let found = robot.channels.len();
        if found > C {
            return Err(TooManyChannels { found, room: C });
        }
        let MotionQueue { queue, control } = self;
        let control: &Control = control;
        let (producer, consumer) = queue.split();
        let feeder = Feeder { robot, mapper: Mapper::new(robot), producer, control, number: 0, open: false };
        Ok(Handles { feeder, player: Player::new(robot, consumer, control), control })
    }
}

/// Bytes of a [`MotionQueue`] of `channels` servos that takes a whole motion of `frames` frames, `size_of::<MotionQueue<channels, frames + 3>>()`: a
/// place takes two bytes a channel and two more, at least eight; the queue two indices besides, and one place that stays free; orders and counters the
/// rest.
#[must_use]
pub const fn queue_bytes(channels: usize, frames: usize) -> usize {
    const ALIGN: usize = align_of::<MotionQueue<1, 2>>();
    const FIXED: usize = 2 * size_of::<usize>();
    let place = if channels < 3 { 8 } else { 2 * channels + 2 };
    let queue = (FIXED + (frames + 3) * place).next_multiple_of(align_of::<usize>());
    (queue + size_of::<Control>()).next_multiple_of(ALIGN)
}

/// Both ends of a [`MotionQueue`].
pub struct Handles<'a, const C: usize> {
    /// For whoever makes motions.
    pub feeder: Feeder<'a, C>,
    /// For the timer interrupt.
    pub player: Player<'a, C>,
    /// For anyone.
    pub control: &'a Control,
}

/// A line has room for fewer servo channels than the robot has.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct TooManyChannels {
    /// Of the robot.
    pub found: usize,
    /// In a frame of the line.
    pub room: usize,
}

impl fmt::Display for TooManyChannels {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "the robot has {} servo channels, the line has room for {}", self.found, self.room)
    }
}

impl core::error::Error for TooManyChannels {}

/// Why a motion was not put into the line. Nothing of it was.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Full {
    /// There will be room when more of what is queued has been played.
    Wait {
        /// Places that it needs.
        needed: usize,
        /// Places that are free now.
        free: usize,
    },
    /// There is never as much room.
    Never {
        /// Places that it needs.
        needed: usize,
        /// Places of the line.
        room: usize,
    },
    /// The frame rate is 0: the motion would never advance.
    NoFrameRate,
}

impl fmt::Display for Full {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Full::Wait { needed, free } => write!(f, "the motion needs {needed} places in the line, {free} are free"),
            Full::Never { needed, room } => write!(f, "the motion needs {needed} places in the line, which has {room}"),
            Full::NoFrameRate => write!(f, "the motion has 0 frames a second and would never advance: give 1 to 65535"),
        }
    }
}

impl core::error::Error for Full {}

/// When a motion begins.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum When {
    /// When those before it have ended.
    #[default]
    Then,
    /// At once: what is left of those before it is thrown away.
    Now,
}

/// Puts motions into a line, as servo angles.
pub struct Feeder<'a, const C: usize> {
    robot: &'a Robot,
    mapper: Mapper,
    producer: Producer<'a, Item<C>>,
    control: &'a Control,
    number: u32,
    open: bool,
}

impl<const C: usize> Feeder<'_, C> {
    /// The robot.
    #[must_use]
    pub const fn robot(&self) -> &Robot {
        self.robot
    }

    /// Frames that are queued, with two more a motion.
    #[must_use]
    pub fn queued(&self) -> usize {
        if has_places(self.producer.capacity()) { self.producer.len() } else { 0 }
    }

    /// Places that are free.
    #[must_use]
    pub fn free(&self) -> usize {
        self.producer.capacity().saturating_sub(self.queued())
    }

    /// Queues a whole motion; the generator is free for the next one afterwards.
    ///
    /// # Errors
    /// [`Full`]; nothing was queued then.
    pub fn play(&mut self, motion: &Motion<'_>, when: When) -> Result<(), Full> {
        self.play_frames(motion.frames(), motion.frame_rate(), when)
    }

    /// Queues a whole motion given as joint positions, metres.
    ///
    /// # Errors
    /// [`Full`]; nothing was queued then.
    pub fn play_frames(&mut self, frames: &[Pose], frame_rate: u16, when: When) -> Result<(), Full> {
        self.reserve(frames.len(), frame_rate, when)?;
        self.queue(frames.iter().copied(), frame_rate);
        Ok(())
    }

    /// Looks whether a motion of so many frames finds room.
    fn reserve(&mut self, frames: usize, frame_rate: u16, when: When) -> Result<(), Full> {
        if frame_rate == 0 {
            return Err(Full::NoFrameRate);
        }
        let needed = frames.saturating_add(2 + usize::from(self.open));
        if needed > self.producer.capacity() {
            return Err(Full::Never { needed, room: self.producer.capacity() });
        }
        if when == When::Now {
            // The player makes room for it in the meantime.
            self.control.throw_away();
        }
        let free = self.free();
        if needed > free {
            return Err(Full::Wait { needed, free });
        }
        Ok(())
    }

    /// Queues a motion for which there is room.
    fn queue(&mut self, frames: impl Iterator<Item = Pose>, frame_rate: u16) {
        let _ = self.begin(frame_rate);
        for frame in frames {
            let _ = self.frame(&frame);
        }
        let _ = self.end();
    }

    /// Begins a motion whose frames come one by one; ends the one before, if that is still open.
    ///
    /// # Errors
    /// [`Full`].
    pub fn begin(&mut self, frame_rate: u16) -> Result<(), Full> {
        if frame_rate == 0 {
            return Err(Full::NoFrameRate);
        }
        let (needed, free) = (1 + usize::from(self.open), self.free());
        if needed > free {
            return Err(Full::Wait { needed, free });
        }
        self.end()?;
        self.number = self.number.wrapping_add(1);
        self.mapper = Mapper::new(self.robot);
        self.control.begin(self.number);
        self.push(Item::Begin { number: halves(self.number), frame_rate })?;
        self.open = true;
        Ok(())
    }

    /// Queues the next frame of the motion that was begun: joint positions, metres.
    ///
    /// # Errors
    /// [`Full`]; the frame can be given again later.
    #[inline(never)]
    pub fn frame(&mut self, pose: &Pose) -> Result<(), Full> {
        let free = self.free();
        if free == 0 {
            return Err(Full::Wait { needed: 1, free });
        }
        let angles = self.mapper.map(self.robot, pose);
        self.push(Item::Frame(rounded(&angles)))
    }

    /// Handles the motion that was begun, if there is one.
    ///
    /// # Errors
    /// [`Full`].
    pub fn end(&mut self) -> Result<(), Full> {
        if self.open {
            self.push(Item::End)?;
            self.open = false;
        }
        Ok(())
    }

    #[inline(never)]
    fn push(&mut self, item: Item<C>) -> Result<(), Full> {
        if !has_places(self.producer.capacity()) {
            return Err(Full::Never { needed: 1, room: 0 });
        }
        self.producer.enqueue(item).map_err(|_| Full::Wait { needed: 1, free: 0 })
    }
}

/// Every queue has places; saying so leaves a division by zero out of the program.
const fn has_places(capacity: usize) -> bool {
    capacity.wrapping_add(1) != 0
}

/// Hundredths of a degree.
#[inline(never)]
fn rounded<const C: usize>(angles: &[f32]) -> [i16; C] {
    let mut frame = [0; C];
    for (to, angle) in frame.iter_mut().zip(angles) {
        let scaled = angle * STEPS;
        *to = (if scaled < 0.0 { scaled - 0.5 } else { scaled + 0.5 }) as i16;
    }
    frame
}

/// What a player takes from a line.
pub(super) struct Source<'a, const C: usize> {
    consumer: Consumer<'a, Item<C>>,
}

impl<'a, const C: usize> Source<'a, C> {
    pub fn new(consumer: Consumer<'a, Item<C>>) -> Self {
        Source { consumer }
    }

    /// The next item.
    #[inline(never)]
    pub fn take(&mut self) -> Option<Item<C>> {
        if has_places(self.consumer.capacity()) { self.consumer.dequeue() } else { None }
    }

    /// The next item, which stays.
    pub fn peek(&self) -> Option<&Item<C>> {
        if has_places(self.consumer.capacity()) { self.consumer.peek() } else { None }
    }
}

/// Degrees of a queued angle.
pub(super) fn degrees(queued: i16) -> f32 {
    f32::from(queued) / STEPS
}
