//! Orders at any time: range, speed and acceleration are kept.

use super::{Watch, arms, play, wave};
use crate::numerics::hash::Stream;
use crate::playback::control::State;
use crate::playback::queue::{Handles, MotionQueue, When};
use std::vec::Vec;

#[test]
fn orders_take_effect_and_keep_the_limits() {
    let robot = arms();
    let mut line = MotionQueue::<8, 256>::new();
    let Handles { mut feeder, mut player, control } = line.split(&robot).unwrap();
    let mut watch = Watch::new(&robot);
    feeder.play_frames(&wave(&robot, 100), 20, When::Then).unwrap();
    play(&mut player, &robot, &mut watch, 80);
    control.hold();
    let states = play(&mut player, &robot, &mut watch, 50);
    assert!(states.iter().all(|s| *s == State::Holding));
    let held: Vec<f32> = player.angles().collect();
    let frames = control.status().frames;
    play(&mut player, &robot, &mut watch, 50);
    assert_eq!(player.angles().collect::<Vec<_>>(), held);
    control.resume();
    play(&mut player, &robot, &mut watch, 40);
    assert!(control.status().frames > frames && control.status().state == State::Playing, "it goes on where it was");

    // Now: what was queued is gone.
    feeder.play_frames(&wave(&robot, 30), 20, When::Now).unwrap();
    play(&mut player, &robot, &mut watch, 4);
    assert!(feeder.queued() < 32, "{}", feeder.queued());
    play(&mut player, &robot, &mut watch, 120);
    assert_eq!((control.status().motions, control.status().finished), (2, 1));

    feeder.play_frames(&wave(&robot, 100), 20, When::Then).unwrap();
    play(&mut player, &robot, &mut watch, 60);
    control.stop();
    control.neutral();
    control.hold();
    let states = play(&mut player, &robot, &mut watch, 40);
    assert_eq!((states[0], states[39]), (State::Stopping, State::Stopped), "nothing overrides a stop");
    let stopped: Vec<f32> = player.angles().collect();
    feeder.play_frames(&wave(&robot, 20), 20, When::Then).unwrap();
    play(&mut player, &robot, &mut watch, 40);
    assert_eq!(player.angles().collect::<Vec<_>>(), stopped);
    control.resume();
    control.neutral();
    let states = play(&mut player, &robot, &mut watch, 200);
    assert_eq!((states[0], states[199]), (State::Returning, State::Neutral));
    assert!(player.angles().all(|a| a.abs() < 1e-4));
}

#[test]
fn any_orders_at_any_time_keep_the_limits() {
    let robot = arms();
    let mut random = Stream::new(77);
    for _ in 0..60 {
        let mut line = MotionQueue::<8, 48>::new();
        let Handles { mut feeder, mut player, control } = line.split(&robot).unwrap();
        let mut watch = Watch::new(&robot);
        let frames = wave(&robot, 40);
        for _ in 0..60 {
            match random.below(9) {
                0 => control.stop(),
                1 => control.hold(),
                2 => control.neutral(),
                3 | 4 => control.resume(),
                5 => drop(feeder.play_frames(&frames[random.below(40) as usize..], 20, When::Now)),
                6 => drop(feeder.play_frames(&frames[random.below(40) as usize..], 20, When::Then)),
                7 => drop(feeder.begin(20)),
                _ => drop(feeder.frame(&frames[random.below(40) as usize])),
            }
            play(&mut player, &robot, &mut watch, random.below(30));
        }
        assert_eq!(control.status().ticks, player.status().ticks);
    }
}
