//! The simulated robot under faults: whatever happens, servos stay inside their limits, no tick is missed, the robot ends in a defined
//! state and does again what it should.
//!
//! The figures of all scenarios are a table beside this file. `MOTIONETTE_BLESS=1 cargo test -p motionette-sim --test robot` writes it
//! anew; its changes are to be looked at.

use std::fmt::Write;
use std::path::Path;

use motionette::playback::{Rest, Robot, Start, StartFault, When};
use motionette::representation::Pose;
use motionette::{Generator, Model, Request};
use motionette_host::blob::AlignedBlob;
use motionette_host::robot_file;
use motionette_sim::default_model;
use motionette_sim::robot::boots::{self, Series};
use motionette_sim::robot::{Boot, EndState, Event, Fault, Kind, Run, Scenario, faults, run};
use motionette_sim::sample_clips::SampleClips;

const READY: u64 = 200_000;

/// A recorded motion, as the runtime decodes it.
fn motion() -> Vec<Pose> {
    let clip = SampleClips::built_in().unwrap().clips.remove(0);
    let blob = AlignedBlob::new(default_model::BLOB);
    let model = Model::open(blob.bytes()).unwrap();
    let request = Request::tokens(&clip.tokens);
    let plan = Generator::new(model.clone(), &mut []).unwrap().plan(&request).unwrap();
    let mut arena = vec![0u128; plan.arena_bytes.div_ceil(16)];
    let mut generator = Generator::new(model, bytemuck::cast_slice_mut(&mut arena)).unwrap();
    generator.generate(&request, &mut ()).unwrap().frames().to_vec()
}

fn robot(name: &str) -> Robot {
    robot_file::load(name).unwrap()
}

/// Where the robot stands when it has played everything.
fn end_of(robot: &Robot) -> EndState {
    match robot.after {
        Rest::Hold => EndState::Finished,
        Rest::Neutral => EndState::Neutral,
    }
}

fn play(robot: &Robot, frames: &[Pose], kinds: &[Kind], seed: u64) -> (usize, Run) {
    let end = READY + frames.len() as u64 * 50_000;
    let mut events =
        vec![(0, Event::Release), (READY, Event::Ready { frames: frames.to_vec(), frame_rate: 20, when: When::Then })];
    if kinds.contains(&Kind::Overrun) {
        events.push((end + 900_000, Event::Ready { frames: frames.to_vec(), frame_rate: 20, when: When::Then }));
    }
    let electrical: Vec<Kind> = kinds.iter().copied().filter(|kind| kind.is_electrical()).collect();
    let faults = faults::schedule(&electrical, seed, [READY + 300_000, end]);
    (faults.len(), run(&Scenario { robot, boot: Boot::default(), events, faults, seed }))
}

#[test]
fn whatever_goes_wrong_servos_stay_in_their_limits_and_come_back() {
    let frames = motion();
    let mut table = String::from(
        "robot       fault                   seed  ticks  missed  outside  errors  failed  recovered  motions  end\n",
    );
    let cases: Vec<Vec<Kind>> = [vec![], vec![Kind::Overrun]]
        .into_iter()
        .chain(Kind::ALL.into_iter().filter(|kind| kind.is_electrical()).map(|kind| vec![kind]))
        .chain([vec![Kind::Nack, Kind::Brownout, Kind::Overrun], Kind::ALL[..5].to_vec()])
        .collect();
    for name in ["upper-body", "desk"] {
        let robot = robot(name);
        for kinds in &cases {
            for seed in 1..=3 {
                let (injected, run) = play(&robot, &frames, kinds, seed);
                let names: Vec<&str> = kinds.iter().map(|kind| kind.name()).collect();
                let case = format!("{name} {names:?} seed {seed}");
                assert_eq!(run.missed_ticks, 0, "{case}: ticks missed, longest {} us", run.longest_tick_us);
                assert_eq!(run.limit_violations, 0, "{case}: servos heard what they must not");
                assert_eq!(run.recovered.len(), injected, "{case}: not everything recovered");
                assert_eq!(run.end_state, end_of(&robot), "{case}");
                // A stretched clock only takes longer, and some flipped bits do not matter.
                let harmless = [Kind::Overrun, Kind::Late, Kind::Bit];
                if !kinds.iter().all(|kind| harmless.contains(kind)) {
                    assert!(run.bus_errors > 0, "{case}: nothing was noticed");
                } else if !kinds.contains(&Kind::Late) && !kinds.contains(&Kind::Bit) {
                    assert_eq!(run.bus_errors, 0, "{case}: errors without a fault");
                }
                assert!(run.longest_tick_us < 20_000, "{case}: {} us", run.longest_tick_us);
                let shown = match names.len() {
                    0 => "none".to_owned(),
                    1..=3 => names.join("+"),
                    _ => "all electrical".to_owned(),
                };
                writeln!(
                    table,
                    "{name:10}  {shown:22}  {seed:4}  {:5}  {:6}  {:7}  {:6}  {:6}  {:9}  {:7}  {:?}",
                    run.ticks,
                    run.missed_ticks,
                    run.limit_violations,
                    run.bus_errors,
                    run.failed_ticks,
                    run.recovered.len(),
                    run.motions[1],
                    run.end_state
                )
                .unwrap();
            }
        }
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/snapshots/robot.txt");
    if std::env::var_os("MOTIONETTE_BLESS").is_some() {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(&path, &table).unwrap();
    }
    let expected = std::fs::read_to_string(&path).unwrap_or_default();
    assert_eq!(table, expected, "the table has changed: look at it, and bless it if it is right");
}

#[test]
fn without_faults_servos_follow_closely() {
    let frames = motion();
    for name in ["upper-body", "desk"] {
        let (_, run) = play(&robot(name), &frames, &[], 1);
        // A servo's own controller lags by about a fortieth of a second; behind a profile of limited acceleration, which stops at each
        // goal, as far as it takes to stop: at 270 degrees a second and 2232 a second squared, 16 degrees more.
        let most = if name == "desk" { 30.0 } else { 15.0 };
        assert!(run.worst_tracking_deg < most, "{name}: {} degrees", run.worst_tracking_deg);
        assert_eq!((run.motions, run.failed_ticks), ([1, 1], 0));
    }
}

#[test]
fn orders_work_in_the_middle_of_a_motion_and_of_a_fault() {
    let frames = motion();
    let robot = robot("upper-body");
    let with = |orders: &[(u64, Event)], kinds: &[Kind]| {
        let mut events = vec![
            (0, Event::Release),
            (READY, Event::Ready { frames: frames.clone(), frame_rate: 20, when: When::Then }),
        ];
        events.extend_from_slice(orders);
        let faults = faults::schedule(kinds, 5, [900_000, 1_500_000]);
        let run = run(&Scenario { robot: &robot, boot: Boot::default(), events, faults, seed: 5 });
        assert_eq!((run.missed_ticks, run.limit_violations), (0, 0));
        run
    };
    for kinds in [&[][..], &[Kind::Stuck]] {
        assert_eq!(with(&[(1_000_000, Event::Stop)], kinds).end_state, EndState::Stopped);
        assert_eq!(with(&[(1_000_000, Event::Hold)], kinds).end_state, EndState::Holding);
        assert_eq!(with(&[(1_000_000, Event::Neutral)], kinds).end_state, EndState::Neutral);
        let resumed = with(&[(1_000_000, Event::Hold), (2_000_000, Event::Resume)], kinds);
        assert_eq!((resumed.end_state, resumed.motions), (end_of(&robot), [1, 1]));
        let stopped = with(&[(1_000_000, Event::Stop), (2_000_000, Event::Resume)], kinds);
        assert_eq!((stopped.end_state, stopped.motions), (EndState::Holding, [1, 0]));
        let again = Event::Ready { frames: frames.clone(), frame_rate: 20, when: When::Now };
        let replaced = with(&[(1_000_000, again)], kinds);
        assert_eq!(
            (replaced.end_state, replaced.motions),
            (end_of(&robot), [2, 1]),
            "cut off, and the next one played"
        );
    }
}

#[test]
fn horns_keep_their_limits_from_any_start() {
    // A sample of `motionette-sim boots --count 1000`.
    let motion = boots::motion().unwrap();
    for series in Series::ALL {
        let figures = series.run(&motion, 12, 7).unwrap();
        assert_eq!(figures.good, figures.count, "{figures}");
        let wrong = matches!(series, Series::Pca9685Wrong | Series::PwmWrong);
        assert!(!wrong || figures.horns.acceleration > 2.0, "a wrong pose cannot go unseen: {figures}");
    }
}

#[test]
fn a_servo_that_is_silent_or_out_of_range_keeps_the_robot_still_and_is_named() {
    let frames = motion();
    let robot = robot("desk");
    let play = |boot: Boot, faults: Vec<Fault>| {
        let events = vec![(READY, Event::Ready { frames: frames.clone(), frame_rate: 20, when: When::Then })];
        run(&Scenario { robot: &robot, boot, events, faults, seed: 3 })
    };
    let mut pose: Vec<f64> = robot.channels.iter().map(|channel| f64::from(channel.neutral)).collect();
    pose[4] = 12.0;
    let outside = play(Boot { pose, held: true }, vec![]);
    let why = StartFault::OutOfRange { decidegrees: 120 };
    assert_eq!((outside.start, outside.motions), (Start::Refused { channel: 4, why }, [0, 0]));
    assert_eq!((outside.ready, outside.horns.speed), (None, 0.0), "nothing moved");
    let silent = play(Boot::default(), vec![Fault { kind: Kind::Nack, from: 0, until: 700_000_000 }]);
    assert_eq!(silent.start, Start::Refused { channel: 0, why: StartFault::Silent });
    assert_eq!(silent.motions, [0, 0]);
    // It goes on as soon as it can.
    let late = play(Boot::default(), vec![Fault { kind: Kind::Nack, from: 0, until: 2_000_000 }]);
    assert_eq!((late.start, late.motions), (Start::Ready, [1, 1]));
}

#[test]
fn servos_that_cannot_say_where_they_stand_get_no_pulses_before_a_release() {
    let frames = motion();
    let robot = robot("upper-body");
    let ready = || (READY, Event::Ready { frames: frames.clone(), frame_rate: 20, when: When::Then });
    let scenario = |events, faults| Scenario { robot: &robot, boot: Boot::default(), events, faults, seed: 3 };
    let waiting = run(&scenario(vec![ready()], vec![]));
    assert_eq!((waiting.start, waiting.ready, waiting.motions), (Start::Waiting, None, [0, 0]));
    // After a reset of the microcontroller alone the chip still gives pulses: they are taken away until the next release.
    let second = (3_000_000, Event::Reset);
    let reset = run(&scenario(vec![(0, Event::Release), ready(), second.clone()], vec![]));
    assert_eq!((reset.start, reset.motions), (Start::Waiting, [1, 0]));
    let again = run(&scenario(vec![(0, Event::Release), ready(), second, (4_000_000, Event::Release)], vec![]));
    assert_eq!((again.start, again.end_state), (Start::Ready, EndState::Holding));
    // Nor does anybody know where they are after more than a second without power.
    let outage = |until| vec![Fault { kind: Kind::Brownout, from: 1_000_000, until }];
    assert_eq!(run(&scenario(vec![(0, Event::Release), ready()], outage(1_900_000))).start, Start::Ready);
    assert_eq!(run(&scenario(vec![(0, Event::Release), ready()], outage(2_500_000))).start, Start::Waiting);
}

#[test]
fn the_boards_robot_is_the_preset() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("boards/pico2/robot.bin");
    let packed = robot_file::pack(&robot("upper-body")).unwrap();
    let same = std::fs::read(&path).unwrap() == packed;
    assert!(same, "robot.bin is stale: motionette robot pack upper-body -o firmware-sim/boards/pico2/robot.bin");
}
