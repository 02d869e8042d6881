//! Robots in bytes, and what is refused.

use super::whole_body;
use crate::playback::robot::{Axis, Bus, Fault, MAX_BYTES, Robot, RobotError, Source, Violation};
use std::string::ToString;
use std::vec::Vec;

#[test]
fn robots_are_packed_and_opened_or_refused_with_the_reason() {
    let robot = whole_body();
    let mut bytes = [0; MAX_BYTES];
    let length = robot.pack(&mut bytes).unwrap();
    let packed = &bytes[..length];
    assert_eq!(Robot::open(packed).unwrap(), robot);
    for cut in 0..length {
        assert!(Robot::open(&packed[..cut]).is_err());
    }
    for at in 0..length {
        let mut damaged = packed.to_vec();
        damaged[at] ^= 0x10;
        // The two unused bytes of the header may be anything.
        assert!(Robot::open(&damaged).is_err() || (6..8).contains(&at), "byte {at}");
    }
    let broken = |change: &dyn Fn(&mut Robot)| {
        let mut robot = robot.clone();
        change(&mut robot);
        let mut all = Vec::new();
        robot.violations(&mut |violation| all.push(violation));
        assert_eq!(robot.pack(&mut [0; MAX_BYTES]), Err(RobotError::Violation(all[0])));
        assert!(!all[0].what.to_string().is_empty());
        all
    };
    let of = |channel: u8, what: Fault| Violation { channel: Some(channel), what };
    let found = broken(&|r| r.channels[3].range = [20.0, -20.0]);
    assert_eq!(found, [of(3, Fault::Range { range: [20.0, -20.0] })]);
    assert_eq!(broken(&|r| r.channels[4].source = Source::Joint(20, Axis::X)), [of(4, Fault::Joint(20))]);
    assert_eq!(broken(&|r| r.channels[2].name = r.channels[1].name.clone()), [of(2, Fault::SameName { other: 1 })]);
    assert_eq!(broken(&|r| r.channels[9].bus = r.channels[0].bus), [of(9, Fault::SameOutput { other: 0 })]);
    assert_eq!(broken(&|r| r.channels[3].source = r.channels[1].source), [of(3, Fault::SameAxis { other: 1 })]);
    assert_eq!(broken(&|r| r.channels[0].speed = 0.0).len(), 1);
    assert_eq!(broken(&|r| r.channels[0].gain = 0.0), [of(0, Fault::Gain(0.0))]);
    assert_eq!(broken(&|r| r.channels[0].neutral = 31.0).len(), 1);
    assert_eq!(broken(&|r| r.channels[0].command = [2000, 1000]).len(), 1);
    assert_eq!(broken(&|r| r.channels[0].bus = Bus::Pca9685 { address: 0x70, output: 16 }).len(), 2);
    assert_eq!(broken(&|r| r.channels[0].bus = Bus::Sts3215 { id: 254 }).len(), 1);
    let mut nonsense = robot.clone();
    (nonsense.channels[0].speed, nonsense.channels[1].gain, nonsense.channels[2].range[1]) =
        (f32::NAN, f32::NAN, f32::NAN);
    nonsense.creep = f32::NAN;
    let mut count = 0;
    nonsense.violations(&mut |_| count += 1);
    assert_eq!(count, 4);
    assert_eq!(broken(&|r| r.tick_rate = 5)[0], Violation { channel: None, what: Fault::TickRate(5) });
    assert_eq!(broken(&|r| r.channels.clear())[0], Violation { channel: None, what: Fault::NoChannels });
    assert_eq!(broken(&|r| r.creep = f32::INFINITY).len(), 1);
    assert_eq!(broken(&|r| r.creep = 0.5)[0], Violation { channel: None, what: Fault::Creep(0.5) });
    assert_eq!(broken(&|r| r.channels[2].start = None), [of(2, Fault::NoStart)]);
    let range = robot.channels[2].range;
    assert_eq!(broken(&|r| r.channels[2].start = Some(99.0)), [of(2, Fault::Start { start: 99.0, range })]);
    assert_eq!(broken(&|r| r.fade = -1.0)[0], Violation { channel: None, what: Fault::Times });
}
