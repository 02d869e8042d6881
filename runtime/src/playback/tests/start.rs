//! Servos come to their start before anything plays.

use super::{Watch, arms, play, wave};
use crate::playback::Player;
use crate::playback::Start;
use crate::playback::control::State;
use crate::playback::queue::{Handles, MotionQueue, When};
use std::vec::Vec;

#[test]
fn servos_creep_from_where_they_are_found_and_motions_wait() {
    let robot = arms();
    let mut line = MotionQueue::<8, 128>::new();
    let Handles { mut feeder, mut player, control } = line.split(&robot).unwrap();
    let found: Vec<f32> = robot.channels.iter().map(|c| 0.8 * c.range[1] + 0.2 * c.range[0]).collect();
    feeder.play_frames(&wave(&robot, 40), 20, When::Then).unwrap();
    player.stand_at(&found);
    assert!(player.angles().zip(&found).all(|(angle, found)| (angle - found).abs() < 1e-4), "where they are");
    let mut before: Vec<f32> = player.angles().collect();
    let mut slow = |player: &mut Player<'_, 8>, ticks| {
        for _ in 0..ticks {
            player.tick();
            let now: Vec<f32> = player.angles().collect();
            let most = robot.creep / f32::from(robot.tick_rate) + 1e-4;
            assert!(now.iter().zip(&before).all(|(a, b)| (a - b).abs() <= most), "faster than creeping");
            before = now;
        }
    };
    slow(&mut player, 50);
    assert_eq!((control.start(), control.status().state), (Start::Creeping, State::Returning));
    control.stop();
    slow(&mut player, 20);
    let stopped: Vec<f32> = player.angles().collect();
    slow(&mut player, 20);
    assert_eq!((player.angles().collect::<Vec<_>>(), control.status().state), (stopped, State::Stopped));
    control.resume();
    feeder.play_frames(&wave(&robot, 40), 20, When::Then).unwrap();
    let ticks = (0..500).find(|_| {
        slow(&mut player, 1);
        control.start() == Start::Ready
    });
    assert!(ticks.is_some() && player.angles().all(|angle| angle.abs() < 1e-4), "at neutral");
    (0..40).for_each(|_| _ = player.tick());
    assert_eq!((control.status().motions, control.status().state), (1, State::Playing), "what came after the stop");

    // Servos that moved by themselves in mid-motion come back, and the motion goes on.
    let mut watch = Watch::new(&robot);
    let off: Vec<f32> = player.angles().map(|angle| angle - 3.0).collect();
    let frames = control.status().frames;
    player.stand_at(&off);
    player.tick();
    assert_eq!((control.start(), control.status().frames), (Start::Creeping, frames));
    watch.before = player.angles().map(|angle| [angle, 0.0]).collect();
    (0..5).for_each(|_| _ = player.tick());
    watch.before = player.angles().map(|angle| [angle, robot.creep]).collect();
    play(&mut player, &robot, &mut watch, 200);
    assert_eq!((control.start(), control.status().finished), (Start::Ready, 1));
}
