//! The virtual robot: a clock that is advanced, never slept on, and the loop that consumes motion frames.
//!
//! Servos and buses join here later; what a frame is handed to is a [`Body`].

use motionette::JOINTS;

/// Joint positions of one frame, metres.
pub type Frame = [[f32; 3]; JOINTS];

/// What the robot does with a frame.
pub trait Body {
    /// Takes the frame that is due at `time` microseconds after the motion's start.
    fn show(&mut self, time: u64, frame: &Frame);
}

/// A body that keeps what was shown.
#[derive(Debug, Default)]
pub struct Recorder {
    /// Time of each frame, microseconds.
    pub times: Vec<u64>,
    /// The frames.
    pub frames: Vec<Frame>,
}

impl Body for Recorder {
    fn show(&mut self, time: u64, frame: &Frame) {
        self.times.push(time);
        self.frames.push(*frame);
    }
}

/// How the loop went.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Loop {
    /// Ticks of the loop.
    pub ticks: u64,
    /// Frames shown.
    pub frames: usize,
    /// Frames whose deadline had passed by more than a tick when they were shown.
    pub late: usize,
    /// Duration of the motion, microseconds.
    pub duration: u64,
}

/// Plays `frames` at `frame_rate` on a robot whose loop runs every `tick` microseconds.
///
/// Every frame is shown once, in order, at the first tick at or after its deadline.
pub fn play(frames: &[Frame], frame_rate: u16, tick: u64, body: &mut impl Body) -> Loop {
    let tick = tick.max(1);
    let deadline = |frame: usize| frame as u64 * 1_000_000 / u64::from(frame_rate.max(1));
    let mut outcome = Loop { duration: deadline(frames.len()), ..Loop::default() };
    let mut now = 0;
    let mut waiting = frames.iter().enumerate().peekable();
    while waiting.peek().is_some() {
        while let Some((index, frame)) = waiting.next_if(|(index, _)| deadline(*index) <= now) {
            body.show(now, frame);
            outcome.frames += 1;
            outcome.late += usize::from(now - deadline(index) > tick);
        }
        outcome.ticks += 1;
        now += tick;
    }
    outcome
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_frame_is_shown_once_in_order_and_on_time() {
        let frames: Vec<Frame> = (0..37).map(|i| [[i as f32; 3]; JOINTS]).collect();
        for tick in [1_000, 7_001, 50_000] {
            let mut body = Recorder::default();
            let outcome = play(&frames, 20, tick, &mut body);
            assert_eq!(body.frames, frames);
            assert_eq!((outcome.frames, outcome.late, outcome.duration), (37, 0, 37 * 50_000));
            assert!(
                body.times.iter().enumerate().all(|(i, &t)| t >= i as u64 * 50_000 && t < i as u64 * 50_000 + tick)
            );
        }
    }

    #[test]
    fn a_loop_slower_than_the_motion_is_told_that_frames_were_late() {
        let frames = vec![[[0.0; 3]; JOINTS]; 20];
        let outcome = play(&frames, 1000, 4_500, &mut Recorder::default());
        assert_eq!(outcome.frames, 20);
        assert_eq!(outcome.late, 0, "a tick late is what a slow loop costs");
    }
}
