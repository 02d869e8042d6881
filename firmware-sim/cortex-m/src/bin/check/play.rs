//! Motions on servos: a queue, a player, a verified start, a serial bus.

use core::hint::black_box;

use motionette::{
    Frame, Motion,
    playback::{
        Handles, MotionQueue, Robot, RobotError, When,
        output::{Runner, Sts3215},
        reach,
    },
};

/// A serial port about which the optimiser knows nothing.
struct Port;

impl embedded_io::ErrorType for Port {
    type Error = embedded_io::ErrorKind;
}

impl embedded_io::Read for Port {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize, Self::Error> {
        black_box(bytes);
        black_box(Ok(1))
    }
}

impl embedded_io::ReadReady for Port {
    fn read_ready(&mut self) -> Result<bool, Self::Error> {
        black_box(Ok(true))
    }
}

impl embedded_io::Write for Port {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Self::Error> {
        black_box(bytes);
        black_box(Ok(bytes.len()))
    }

    fn write_all(&mut self, bytes: &[u8]) -> Result<(), Self::Error> {
        black_box(bytes);
        black_box(Ok(()))
    }

    fn flush(&mut self) -> Result<(), Self::Error> {
        black_box(Ok(()))
    }
}

/// Frames, or a whole motion, move servos.
#[inline(never)]
pub fn play(bytes: &[u8], frames: &[Frame], motion: Option<&Motion<'_>>) -> Result<u32, RobotError> {
    let robot = Robot::open(black_box(bytes))?;
    let mut line = black_box(MotionQueue::<16, 8>::new());
    let Ok(Handles { mut feeder, mut player, control }) = line.split(&robot) else { return Ok(0) };
    if let Some(motion) = motion {
        for when in black_box([When::Then, When::Now]) {
            let _ = black_box(feeder.play(motion, when));
        }
    }
    let _ = black_box(feeder.begin(black_box(20)));
    for frame in frames {
        let _ = black_box(feeder.frame(frame));
        black_box(reach(&robot, frame, black_box(&[])));
    }
    let _ = black_box((feeder.end(), feeder.queued(), feeder.free()));
    player.stand_at(black_box(&[0.0]));
    for order in black_box([0, 1, 2, 3]) {
        match order {
            0 => control.stop(),
            1 => control.hold(),
            2 => control.neutral(),
            _ => control.resume(),
        }
        black_box(player.tick());
        black_box(player.stand());
        player.rewind();
    }
    black_box(player.angles().count());
    let mut runner = Runner::new(player, Sts3215::new(Port));
    control.release();
    for _ in 0..black_box(100) {
        let _ = black_box(runner.tick(&mut || black_box(0), black_box(5000)));
    }
    black_box(runner.bus());
    Ok(control.status().ticks)
}
