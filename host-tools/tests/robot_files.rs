//! `robot.toml`: what a good file means, and what is said about a bad one, and where.

use std::path::Path;

use motionette::Joint;
use motionette::playback::robot::Source;
use motionette::playback::{Axis, Bus, Rest, Robot};
use motionette_host::robot_file::{self, Error, PRESETS, Problem, pack, parse, preset_names};

const GOOD: &str = r#"
name = "golden"
tick_rate = 80
fade = 0.5
return_time = 2
after = "neutral"
finish_without_host = false
creep = 12.5
output_enable = 22

[defaults]
bus = "pca9685"
pulse = [600, 2400]
start = "neutral"
speed = 250
acceleration = 1500.5

[[channel]]
name = "nod"
joint = "neck"
axis = "x"
range = [-40, 50.5]
output = 3

[[channel]]
name = "elbow"
joint = "left_elbow"
axis = "x"
neutral = 90
start = 170
direction = "reversed"
gain = 0.5
range = [0, 180]
pulse = [1_000, 0x7D0]
speed = 100
address = 0x41
output = 3

[[channel]]
name = "pan"
follows = "heading"
bus = "sts3215"
range = [-90, 45]
id = 7

[[channel]]
name = "lift"
follows = "height"
gain = 200
bus = "sts3215"
range = [-90, 90]
position = [100, 900]
id = 8

[[channel]]
name = "spare"
follows = "still"
bus = "pwm"
range = [-90, 90]
pin = 4
"#;

#[test]
fn a_good_file_means_what_it_says() {
    let robot = parse(GOOD, "good.toml").expect("a good file");
    assert_eq!((robot.name.as_str(), robot.tick_rate, robot.fade, robot.return_time), ("golden", 80, 0.5, 2.0));
    assert_eq!((robot.after, robot.finish_without_host), (Rest::Neutral, false));
    assert_eq!((robot.creep, robot.output_enable), (12.5, Some(22)));
    let [nod, elbow, pan, lift, spare] = &robot.channels[..] else { panic!("five channels") };
    assert_eq!(nod.name, "nod");
    assert_eq!(nod.source, Source::Joint(Joint::Neck.into(), Axis::X));
    assert_eq!((nod.neutral, nod.gain, nod.range, nod.command), (0.0, 1.0, [-40.0, 50.5], [600, 2400]));
    assert_eq!((nod.speed, nod.acceleration), (250.0, 1500.5));
    assert_eq!(nod.bus, Bus::Pca9685 { address: 0x40, output: 3 });
    assert_eq!((elbow.neutral, elbow.gain, elbow.command, elbow.speed), (90.0, -0.5, [1000, 2000], 100.0));
    assert_eq!(elbow.bus, Bus::Pca9685 { address: 0x41, output: 3 });
    // A quarter of a turn below the middle, an eighth above.
    assert_eq!((pan.source, pan.command, pan.bus), (Source::Heading, [1024, 2560], Bus::Sts3215 { id: 7 }));
    assert_eq!((lift.source, lift.gain, lift.command), (Source::Height, 200.0, [100, 900]));
    assert_eq!((spare.source, spare.bus), (Source::Still, Bus::Pwm { pin: 4 }));
    let starts = [nod, elbow, pan, lift, spare].map(|channel| channel.start);
    assert_eq!(starts, [Some(0.0), Some(170.0), None, None, Some(0.0)], "STS3215s say where they stand");
    let bytes = pack(&robot).expect("a packed robot");
    assert_eq!(Robot::open(&bytes).expect("the same robot"), robot);
    let plain = parse(&GOOD.replace("creep = 12.5\noutput_enable = 22\n", ""), "plain").expect("both may be left out");
    assert_eq!((plain.creep, plain.output_enable), (20.0, None));
}

#[test]
fn packed_robots_of_version_1_are_read_and_what_they_lack_is_said() {
    // As they were packed before version 2: the presets of that time.
    for (file, servos) in [("version1-upper-body.bin", 12), ("version1-desk.bin", 0)] {
        let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/fixtures/robots").join(file);
        assert!(matches!(robot_file::read(&path), Err(Error::Packed { .. })), "no firmware moves with it");
        let refused = robot_file::lift(&path, false);
        if servos > 0 {
            let error = refused.expect_err("nobody knows where these servos stand").to_string();
            assert!(error.contains("waist yaw, waist pitch") && error.contains("--start neutral"), "{error}");
        } else {
            assert_eq!(refused.expect("nothing is missing"), robot_file::lift(&path, true).expect("nor here"));
        }
        let lifted = robot_file::lift(&path, true).expect("sound").expect("of version 1");
        let today = robot_file::load(lifted.robot.name.as_str()).expect("a preset");
        assert_eq!(lifted.robot, today, "the presets say what is taken");
        assert!(lifted.taken[0].contains("creep"), "{:?}", lifted.taken);
        assert_eq!(lifted.taken.len(), if servos > 0 { 3 } else { 1 });
        let mut damaged = std::fs::read(&path).expect("a file");
        let last = damaged.len() - 1;
        damaged[last] ^= 1;
        let folder = tempfile::tempdir().expect("a folder");
        std::fs::write(folder.path().join("damaged.bin"), &damaged).expect("a file");
        assert!(matches!(robot_file::lift(&folder.path().join("damaged.bin"), true), Err(Error::Packed { .. })));
        std::fs::write(folder.path().join("short.bin"), &damaged[..40]).expect("a file");
        assert!(matches!(robot_file::lift(&folder.path().join("short.bin"), true), Err(Error::Packed { .. })));
        std::fs::write(folder.path().join("today.bin"), pack(&today).expect("packed")).expect("a file");
        assert_eq!(robot_file::lift(&folder.path().join("today.bin"), false).expect("sound"), None);
    }
}

/// A file of one sound channel with a line replaced or added, so that a case is one line long.
fn with(replaced: &str, by: &str) -> String {
    const SOUND: &str = r#"name = "bad"
tick_rate = 50
fade = 0.3

[defaults]
bus = "pca9685"
pulse = [600, 2400]
speed = 250
start = "neutral"
[[channel]]
name = "nod"
joint = "neck"
axis = "x"
neutral = 0
range = [-40, 50]
acceleration = 1500
output = 3
"#;
    parse(SOUND, "sound.toml").expect("sound as it stands");
    let text = SOUND.replace(replaced, by);
    assert_ne!(text, SOUND, "{replaced:?} stands in the file");
    text
}

fn problems(text: &str) -> Vec<Problem> {
    parse(text, "bad.toml").expect_err(text).problems
}

#[test]
fn every_fault_is_found_at_its_line() {
    let second = |keys: &str| format!("output = 3\n\n[[channel]]\nrange = [-40, 50]\nacceleration = 1500\n{keys}\n");
    let cases: Vec<(&str, String, usize, &str)> = vec![
        // The text, and its keys.
        ("fade = 0.3", "fade = 0.3.1".into(), 3, "this is no TOML"),
        ("fade = 0.3", "fade = 0.3\nfade = 0.4".into(), 4, "duplicate key"),
        ("axis = \"x\"", "axis = \"x".into(), 13, "this is no TOML"),
        ("speed = 250", "sped = 250".into(), 8, "did you mean speed?"),
        ("axis", "axes".into(), 13, "did you mean axis?"),
        ("tick_rate", "rate_of_ticks".into(), 2, "the whole robot has name, tick_rate, fade"),
        ("fade = 0.3", "fade = 0.3\noutput = 4".into(), 4, "put it below a [[channel]]"),
        ("speed = 250", "speed = 250\noutput = 4".into(), 9, "put it below a [[channel]]"),
        ("output = 3", "output = 3\nafter = \"hold\"".into(), 18, "put it above the first [table]"),
        // Types.
        ("tick_rate = 50", "tick_rate = 50.5".into(), 2, "a whole number from 0 to 1000, not 50.5"),
        ("tick_rate = 50", "tick_rate = -5".into(), 2, "a whole number from 0 to 1000, not -5"),
        ("speed = 250", "speed = \"fast\"".into(), 8, "speed must be a number, not \"fast\""),
        ("range = [-40, 50]", "range = [-40, 0, 50]".into(), 15, "[lowest, highest], not this list of 3"),
        ("pulse = [600, 2400]", "pulse = [600.5, 2400]".into(), 7, "two whole numbers of microseconds"),
        ("bus = \"pca9685\"", "bus = \"i2c\"".into(), 6, "one of \"pwm\", \"pca9685\", \"sts3215\", not \"i2c\""),
        ("fade = 0.3", "after = \"sleep\"".into(), 3, "one of \"hold\", \"neutral\", not \"sleep\""),
        ("fade = 0.3", "finish_without_host = 1".into(), 3, "true or false, not 1"),
        ("name = \"nod\"", format!("name = \"{}\"", "n".repeat(25)), 11, "at most 24 bytes"),
        ("[defaults]\nbus", "defaults = 3\nbus".into(), 5, "a table: [defaults], not 3"),
        // What a channel follows.
        ("\"neck\"", "\"nek\"".into(), 12, "did you mean neck?"),
        ("\"neck\"", "\"tail\"".into(), 12, "there is no joint \"tail\"; joints are pelvis, "),
        ("\"neck\"", "\"left_wrist\"".into(), 12, "positions do not tell how the left_wrist turns"),
        ("joint = \"neck\"\n", String::new(), 12, "an axis needs a joint beside it"),
        ("axis = \"x\"\n", String::new(), 12, "a joint needs an axis beside it"),
        ("joint = \"neck\"\naxis = \"x\"\n", String::new(), 10, "does not say what it follows"),
        ("axis = \"x\"", "axis = \"x\"\nfollows = \"heading\"".into(), 14, "keep one"),
        ("joint = \"neck\"\naxis = \"x\"", "follows = \"height\"".into(), 10, "degrees a metre"),
        // What is missing or foreign.
        ("name = \"nod\"\n", String::new(), 10, "this channel has no name"),
        ("range = [-40, 50]\n", String::new(), 10, "no range: give it one, here or in [defaults]"),
        ("speed = 250\n", String::new(), 9, "this channel has no speed"),
        ("pulse = [600, 2400]\n", String::new(), 9, "this channel has no pulse"),
        ("bus = \"pca9685\"\n", String::new(), 9, "this channel has no bus"),
        ("output = 3\n", String::new(), 10, "this channel has no output: give it one (output = 3)"),
        ("output = 3", "output = 3\nid = 4".into(), 18, "a servo on bus \"pca9685\" has no id: remove it"),
        // What the runtime does not allow.
        ("tick_rate = 50", "tick_rate = 10".into(), 2, "20 to 1000 commands a second"),
        ("fade = 0.3", "fade = -0.3".into(), 3, "0 to 60 seconds"),
        ("fade = 0.3", "return_time = 61".into(), 3, "0 to 60 seconds"),
        ("name = \"nod\"", "name = \"\"".into(), 11, "the name is empty"),
        ("range = [-40, 50]", "range = [50, -40]".into(), 15, "the first must be smaller"),
        ("range = [-40, 50]", "range = [-400, 50]".into(), 15, "within -320 to 320"),
        ("range = [-40, 50]", "range = [nan, 50]".into(), 15, "the first must be smaller"),
        ("neutral = 0", "neutral = 60".into(), 14, "neutral is 60 degrees, outside the range -40 to 50"),
        ("neutral = 0\nrange = [-40, 50]", "range = [10, 50]".into(), 14, "neutral is 0 degrees, outside"),
        ("neutral = 0", "gain = 0".into(), 14, "the gain is 0"),
        ("neutral = 0", "gain = -1".into(), 14, "direction = \"reversed\""),
        ("pulse = [600, 2400]", "pulse = [100, 2400]".into(), 7, "within 300 to 3000"),
        ("pulse = [600, 2400]", "pulse = [2400, 600]".into(), 7, "the first must be smaller"),
        ("speed = 250", "speed = 0".into(), 8, "the speed is 0 degrees a second"),
        ("acceleration = 1500", "acceleration = 0.1".into(), 16, "at this tick rate it must be"),
        ("output = 3", "output = 16".into(), 17, "output 16 does not exist: 0 to 15 do"),
        ("output = 3", "output = 3\naddress = 0x70".into(), 18, "address 0x70 is none of a PCA9685"),
        ("output = 3", "bus = \"sts3215\"\nid = 255".into(), 18, "output 255 does not exist: 0 to 253 do"),
        ("range = [-40, 50]", "range = [-200, 50]\nbus = \"sts3215\"\nid = 1".into(), 15, "beyond a turn of the servo"),
        // The start.
        ("start = \"neutral\"\n", "\n".into(), 10, "this channel has no start: give it one, here or in [defaults]"),
        (
            "start = \"neutral\"",
            "start = \"upright\"".into(),
            9,
            "a number of degrees, or \"neutral\", not \"upright\"",
        ),
        ("start = \"neutral\"", "start = 51".into(), 9, "start is 51 degrees, outside the range -40 to 50"),
        ("fade = 0.3", "creep = 91".into(), 3, "it must be 1 to 90"),
        ("fade = 0.3", "output_enable = 256".into(), 3, "a whole number from 0 to 255, not 256"),
        ("output = 3", "bus = \"sts3215\"\nid = 1\nstart = 0".into(), 19, "has no start: remove it"),
        // Two channels in each other's way.
        (
            "output = 3\n",
            second("name = \"nod\"\njoint = \"neck\"\naxis = \"z\"\noutput = 4"),
            22,
            "the channel \"nod\" (line 11)",
        ),
        (
            "output = 3\n",
            second("name = \"lean\"\njoint = \"neck\"\naxis = \"z\"\noutput = 3"),
            25,
            "this is also the output of the channel \"nod\" (line 17)",
        ),
        (
            "output = 3\n",
            second("name = \"lean\"\njoint = \"neck\"\naxis = \"x\"\noutput = 4"),
            24,
            "also followed by that of the channel \"nod\" (line 13)",
        ),
    ];
    for (replaced, by, line, part) in cases {
        let text = with(replaced, &by);
        let found = problems(&text);
        let hit = found.iter().find(|problem| problem.line == line && problem.message.contains(part));
        let hit = hit.unwrap_or_else(|| panic!("{by:?}: line {line}, {part:?}, not {found:#?}"));
        assert_eq!(hit.text, text.lines().nth(line - 1).expect("a line"), "the line is shown");
        // What is needed beside a key that is gone or foreign is asked for, too.
        let alone = !["the whole robot has", "[defaults], not 3", "beyond a turn", "0 to 253 do"]
            .iter()
            .any(|p| part.contains(p));
        assert!(found.len() == 1 || !alone, "one cause, one complaint: {found:#?}");
    }
}

#[test]
fn a_robot_without_channels_or_with_too_many_is_refused() {
    let found = problems("name = \"none\"\n");
    assert!(found.len() == 1 && found[0].line == 1 && found[0].message.contains("no channels"), "{found:?}");
    let channel = |n: usize| {
        format!(
            "[[channel]]\nname = \"{n}\"\nfollows = \"still\"\nrange = [-1, 1]\nspeed = 9\nacceleration = 90\nbus = \"pwm\"\npulse = [1000, 2000]\npin = {n}\nstart = 0\n"
        )
    };
    let text: String = (0..33).map(channel).collect();
    let found = problems(&text);
    assert!(found.len() == 1 && found[0].line == 32 * 10 + 1, "{found:?}");
    assert!(found[0].message.contains("at most 32 channels"), "{found:?}");
    assert_eq!(parse(&(0..32).map(channel).collect::<String>(), "32").expect("32 are fine").channels.len(), 32);
}

#[test]
fn all_problems_come_at_once_in_the_order_of_lines_and_once_each() {
    let text = GOOD
        .replace("tick_rate = 80", "tick_rate = 5")
        .replace("pulse = [600, 2400]", "pulse = [2400, 600]")
        .replace("joint = \"neck\"", "joint = \"knee\"")
        .replace("range = [0, 180]", "range = [180, 0]")
        .replace("id = 7", "id = \"seven\"");
    let found = parse(&text, "many.toml").expect_err("five problems");
    let lines: Vec<usize> = found.problems.iter().map(|problem| problem.line).collect();
    assert_eq!(lines, [3, 13, 20, 33, 44], "{found}");
    let shown = found.to_string();
    assert!(shown.starts_with("many.toml has 5 problems\n\nmany.toml:3: tick_rate is 5"), "{shown}");
    assert!(shown.contains("\n   33 | range = [180, 0]\n      |         ^^^^^^^^\n"), "{shown}");
}

#[test]
fn presets_are_sound_and_names_files_and_packed_robots_load() {
    let folder = tempfile::tempdir().expect("a folder");
    for preset in PRESETS {
        let robot = robot_file::load(preset.name).expect(preset.name);
        assert_eq!(robot.name, preset.name);
        let bytes = pack(&robot).expect("a packed robot");
        let packed = folder.path().join("robot.bin");
        std::fs::write(&packed, &bytes).expect("a file");
        assert_eq!(robot_file::read(&packed).expect("the same robot"), robot);
        let text = folder.path().join("robot.toml");
        std::fs::write(&text, preset.text).expect("a file");
        assert_eq!(robot_file::load(text.to_str().expect("a path")).expect("the same robot"), robot);
        std::fs::write(&packed, &bytes[..bytes.len() - 1]).expect("a file");
        assert!(matches!(robot_file::read(&packed), Err(Error::Packed { .. })));
    }
    let error = robot_file::load("upper-bdy").expect_err("no such robot");
    assert!(matches!(error, Error::NoSuchRobot { .. }) && error.to_string().contains(&preset_names()), "{error}");
    assert!(matches!(robot_file::load("no/such.toml"), Err(Error::Read { .. })));
    std::fs::write(folder.path().join("latin.toml"), b"name = \"\xe9\"").expect("a file");
    assert!(matches!(robot_file::read(&folder.path().join("latin.toml")), Err(Error::Read { .. })));
}
