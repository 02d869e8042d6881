//! What fits the line, what is gone at a stop, and its bytes.

use super::{Watch, arms, play, standing, wave};
use crate::playback::control::State;
use crate::playback::queue::{Full, Handles, MotionQueue, When, queue_bytes};
use crate::playback::robot::Robot;

#[test]
fn a_motion_is_never_half_queued() {
    let robot = arms();
    let mut line = MotionQueue::<8, 64>::new();
    let Handles { mut feeder, mut player, .. } = line.split(&robot).unwrap();
    let frames = wave(&robot, 40);
    assert_eq!(feeder.play_frames(&wave(&robot, 70), 20, When::Then), Err(Full::Never { needed: 72, room: 63 }));
    feeder.play_frames(&frames, 20, When::Then).unwrap();
    assert_eq!(feeder.play_frames(&frames, 20, When::Then), Err(Full::Wait { needed: 42, free: 21 }));
    assert_eq!(feeder.queued(), 42);
    let mut ticks = 0;
    while feeder.play_frames(&frames, 20, When::Then).is_err() {
        player.tick();
        ticks += 1;
        assert!(ticks < 100);
    }
    assert!(line_error(&robot));
}

fn line_error(robot: &Robot) -> bool {
    MotionQueue::<4, 8>::new().split(robot).is_err_and(|e| (e.found, e.room) == (robot.channels.len(), 4))
}

#[test]
fn everything_that_was_queued_at_a_stop_is_gone() {
    let robot = arms();
    for (orders, ticks) in [(0, 0), (0, 1), (0, 3), (1, 1), (2, 1)] {
        let mut line = MotionQueue::<8, 256>::new();
        let Handles { mut feeder, mut player, control } = line.split(&robot).unwrap();
        let mut watch = Watch::new(&robot);
        // Two motions fill the line; a third one is still open.
        feeder.play_frames(&wave(&robot, 100), 20, When::Then).unwrap();
        feeder.play_frames(&wave(&robot, 100), 20, When::Then).unwrap();
        feeder.begin(20).unwrap();
        feeder.frame(&standing()).unwrap();
        play(&mut player, &robot, &mut watch, 20);
        match orders {
            0 => control.stop(),
            1 => control.neutral(),
            _ => {
                control.stop();
                play(&mut player, &robot, &mut watch, 1);
                // What comes while the robot is stopped is not kept for later, either.
                feeder.play_frames(&wave(&robot, 30), 20, When::Then).unwrap();
                feeder.play_frames(&wave(&robot, 10), 20, When::Then).unwrap();
            }
        }
        play(&mut player, &robot, &mut watch, ticks);
        control.resume();
        feeder.frame(&standing()).unwrap();
        let states = play(&mut player, &robot, &mut watch, 200);
        assert_eq!(
            (control.status().motions, control.status().finished),
            (1, 0),
            "{orders} {ticks}: another one began"
        );
        assert!(matches!(states[199], State::Holding | State::Neutral));
        feeder.play_frames(&wave(&robot, 30), 20, When::Then).unwrap();
        play(&mut player, &robot, &mut watch, 200);
        assert_eq!(
            (control.status().motions, control.status().finished),
            (2, 1),
            "{orders} {ticks}: the next one plays"
        );
    }
}

#[test]
fn now_is_seen_however_many_motions_came_before() {
    let robot = arms();
    let mut line = MotionQueue::<8, 256>::new();
    let Handles { mut feeder, mut player, control } = line.split(&robot).unwrap();
    let frames = wave(&robot, 60);
    for others in [0, 1, 253, 254, 255, 256, 65_534] {
        feeder.play_frames(&frames[..1], 20, When::Now).unwrap();
        for _ in 0..others {
            feeder.play_frames(&[], 20, When::Then).unwrap();
            player.tick();
        }
        (0..10).for_each(|_| _ = player.tick());
        // A long one plays, and is to be cut off.
        feeder.play_frames(&frames, 20, When::Then).unwrap();
        (0..10).for_each(|_| _ = player.tick());
        assert_eq!(control.status().state, State::Playing);
        let finished = control.status().finished;
        feeder.play_frames(&frames[..1], 1000, When::Now).unwrap();
        (0..10).for_each(|_| _ = player.tick());
        assert_eq!(
            (control.status().state, control.status().finished),
            (State::Holding, finished + 1),
            "after {others}"
        );
    }
}

#[test]
fn the_bytes_of_a_line_are_as_promised() {
    assert_eq!(queue_bytes(1, 1), size_of::<MotionQueue<1, 4>>());
    assert_eq!(queue_bytes(3, 2), size_of::<MotionQueue<3, 5>>());
    assert_eq!(queue_bytes(8, 196), size_of::<MotionQueue<8, 199>>());
    assert_eq!(queue_bytes(12, 196), size_of::<MotionQueue<12, 199>>());
    assert_eq!(queue_bytes(31, 100), size_of::<MotionQueue<31, 103>>());
}
