//! Motions from their first frame to their last.

use super::{Watch, arms, play, wave};
use crate::playback::control::State;
use crate::playback::mapper::Mapper;
use crate::playback::queue::{Full, Handles, MotionQueue, When};

#[test]
fn a_motion_is_played_to_its_last_frame_and_held() {
    let robot = arms();
    let mut line = MotionQueue::<8, 128>::new();
    let Handles { mut feeder, mut player, control } = line.split(&robot).unwrap();
    let mut watch = Watch::new(&robot);
    let frames = wave(&robot, 60);
    feeder.play_frames(&frames, 20, When::Then).unwrap();
    let states = play(&mut player, &robot, &mut watch, 60 * 50 / 20);
    assert!(states.iter().all(|s| *s == State::Playing), "{states:?}");
    play(&mut player, &robot, &mut watch, 100);
    let status = control.status();
    assert_eq!((status.state, status.motions, status.finished, status.frames), (State::Holding, 1, 1, 60));
    assert_eq!(status.starved, 0);
    let mut mapper = Mapper::new(&robot);
    let expected = frames.iter().map(|pose| mapper.map(&robot, pose)).last().unwrap();
    for (angle, expected) in player.angles().zip(expected) {
        assert!((angle - expected).abs() < 0.02, "{angle} {expected}");
    }
}

#[test]
fn frames_that_come_late_are_waited_for() {
    let robot = arms();
    let mut line = MotionQueue::<8, 32>::new();
    let Handles { mut feeder, mut player, control } = line.split(&robot).unwrap();
    let mut watch = Watch::new(&robot);
    let frames = wave(&robot, 40);
    feeder.begin(20).unwrap();
    for frame in &frames[..10] {
        feeder.frame(frame).unwrap();
    }
    let states = play(&mut player, &robot, &mut watch, 100);
    assert_eq!(states[99], State::Starved);
    assert!(control.status().starved > 50);
    for frame in &frames[10..] {
        feeder.frame(frame).unwrap();
    }
    feeder.end().unwrap();
    let states = play(&mut player, &robot, &mut watch, 100);
    assert_eq!((states[0], states[99]), (State::Playing, State::Holding));
    assert_eq!((control.status().frames, control.status().finished), (40, 1));
    // A motion without frames is one, too.
    feeder.play_frames(&[], 20, When::Then).unwrap();
    play(&mut player, &robot, &mut watch, 3);
    assert_eq!((control.status().finished, control.status().state), (2, State::Holding));
}

#[test]
fn a_motion_of_any_frame_rate_lasts_its_time() {
    let robot = arms();
    let mut line = MotionQueue::<8, 4096>::new();
    let Handles { mut feeder, mut player, control } = line.split(&robot).unwrap();
    for (frame_rate, frames, seconds) in
        [(1, 3, 3.0), (255, 510, 2.0), (256, 512, 2.0), (300, 600, 2.0), (1000, 4000, 4.0)]
    {
        let finished = control.status().finished;
        feeder.play_frames(&wave(&robot, frames), frame_rate, When::Then).unwrap();
        let ticks = (0..1000).find(|_| {
            player.tick();
            control.status().finished > finished
        });
        let took = ticks.unwrap() as f32 / 50.0;
        assert!((took - seconds).abs() < 0.1, "{frame_rate} frames a second: {took} s, not {seconds}");
    }
    // 65535 frames a second are many a tick, but no reason to wait.
    feeder.play_frames(&wave(&robot, 3000), u16::MAX, When::Then).unwrap();
    (0..5).for_each(|_| _ = player.tick());
    assert_eq!(control.status().state, State::Holding);
    assert_eq!(feeder.play_frames(&wave(&robot, 3), 0, When::Then), Err(Full::NoFrameRate));
    assert_eq!((feeder.begin(0), feeder.queued()), (Err(Full::NoFrameRate), 0));
}
