//! `robot`, `export` and `plan --robot`: what they write, read back by others.

mod common;

use common::Random;
use common::bench::{Bench, report};
use common::motions::{random_motion, standing};
use motionette::JOINTS;
use motionette::playback::queue::queue_bytes;
use motionette::playback::{Mapper, Robot, reach};
use motionette_host::export::{bvh, glb, servo};
use motionette_host::import::{self, bvh::Reading};
use motionette_host::motion::{Pose, skeleton};
use motionette_host::robot_file::{self, PRESETS, load};
use motionette_host::servos::{Fit, Timeline};
use serde_json::Value;

/// The columns of a table under these names.
fn columns(text: &[u8], names: &[String]) -> Vec<Vec<f64>> {
    let mut table = csv::Reader::from_reader(text);
    let headers = table.headers().expect("a head").clone();
    let place = |name: &String| headers.iter().position(|header| header == name).expect(name);
    let places: Vec<usize> = names.iter().map(place).collect();
    let rows: Vec<csv::StringRecord> = table.records().map(|row| row.expect("a row")).collect();
    let column = |place: &usize| rows.iter().map(|row| row[*place].parse().expect("a number")).collect();
    places.iter().map(column).collect()
}

fn named(robot: &Robot, unit: &str) -> Vec<String> {
    robot.channels.iter().map(|channel| format!("{}_{unit}", channel.name)).collect()
}

#[test]
fn tables_hold_the_players_angles_within_range_speed_and_acceleration() {
    let mut random = Random(11);
    for preset in PRESETS {
        let robot = load(preset.name).expect("a preset");
        for size in [0.1, 0.6, 2.0] {
            let motion = random_motion(&mut random, 70, size);
            let timeline = Timeline::of(&robot, &motion, 20).expect("played");
            let mut text = Vec::new();
            servo::write_csv(&timeline, &mut text).expect("written");
            let times = &columns(&text, &["time_s".to_owned()])[0];
            let (angles, commands) = (columns(&text, &named(&robot, "deg")), columns(&text, &named(&robot, "command")));
            let rate = f64::from(robot.tick_rate);
            assert!(times.iter().enumerate().all(|(tick, time)| (time * rate - tick as f64).abs() < 1e-9));
            for (index, channel) in robot.channels.iter().enumerate() {
                let player = timeline.angles.iter().map(|tick| tick[index]);
                assert!(angles[index].iter().map(|angle| *angle as f32).eq(player), "{}", channel.name);
                let [low, high] = channel.range.map(f64::from);
                let [first, last] = channel.command.map(f64::from);
                let (mut at, mut speed) = (f64::from(channel.neutral), 0.0);
                for (angle, command) in angles[index].iter().zip(&commands[index]) {
                    // Angles are binary fractions of a degree; printed decimals round them.
                    let (step, slack) = ((angle - at) * rate, 1e-4 * rate);
                    let change = (step - speed) * rate;
                    assert!((low - 1e-4..=high + 1e-4).contains(angle), "{} at {angle}", channel.name);
                    assert!(step.abs() <= f64::from(channel.speed) + slack, "{} at {step}/s", channel.name);
                    let limit = f64::from(channel.acceleration) + 2.0 * slack * rate;
                    assert!(change.abs() <= limit, "{} at {change}/s^2", channel.name);
                    let there = first + (angle - low) / (high - low) * (last - first);
                    assert!((there - command).abs() < 0.51, "{} at {command}, not {there}", channel.name);
                    (at, speed) = (*angle, step);
                }
                // Both presets return to neutral.
                assert!(
                    (at - f64::from(channel.neutral)).abs() < 1e-4 && speed.abs() < 1e-3,
                    "{} at {at}",
                    channel.name
                );
            }
        }
    }
}

#[test]
fn a_slow_motion_is_followed_and_a_standing_body_is_neutral() {
    for preset in PRESETS {
        let robot = load(preset.name).expect("a preset");
        let still = Mapper::new(&robot).map(&robot, &standing());
        assert!(robot.channels.iter().zip(&still).all(|(channel, angle)| (angle - channel.neutral).abs() < 0.1));
        // A motion that the robot can do: angles that swing slowly, made into bodies by its own forward kinematics.
        let swing = |frame: usize, k: usize| 0.2 * (0.1 * frame as f32 + k as f32).sin();
        let body = |frame: usize| {
            let angle = |(k, c): (usize, &motionette::playback::Channel)| {
                let [low, high] = c.range;
                0.5 * (low + high) + swing(frame, k) * (high - low)
            };
            reach(&robot, &standing(), &robot.channels.iter().enumerate().map(angle).collect::<Vec<f32>>())
        };
        let motion: Vec<Pose> = (0..100).map(body).collect();
        let fit = Fit::of(&robot, &motion, 20).expect("played");
        assert!(fit.reached.mean_mm < 5.0 && fit.reached.max_mm < 80.0, "{}: {:?}", preset.name, fit.reached);
        // From neutral to the middles of the ranges takes a moment.
        let later: Vec<Pose> = motion[40..].to_vec();
        let timeline = Timeline::of(&robot, &motion, 20).expect("played");
        let bodies = &timeline.bodies(&robot, &motion, 20)[40..];
        let off = later.iter().zip(bodies).flat_map(|(a, b)| (0..JOINTS).map(move |j| distance(a[j], b[j])));
        let mean = off.sum::<f64>() / (JOINTS * later.len()) as f64;
        assert!(mean < 0.008, "{}: {mean} m off", preset.name);
    }
}

#[test]
fn a_fit_says_what_is_asked_for() {
    let robot = load("upper-body").expect("a preset");
    let wide = PRESETS[0].text.replace("range = [-40, 50]", "range = [-90, 90]");
    let wide = robot_file::parse(&wide, "wide").expect("a robot");
    // A nod of 60 degrees a second up to 60 degrees, where the robot's neck ends at 50.
    let body = |frame: u8| {
        let nod = 3.0 * f32::from(frame.min(20));
        let angle = |name: &str| if name == "head pitch" { nod } else { 0.0 };
        reach(&wide, &standing(), &wide.channels.iter().map(|c| angle(&c.name)).collect::<Vec<f32>>())
    };
    let motion: Vec<Pose> = (0..=40).map(body).collect();
    let fit = Fit::of(&robot, &motion, 20).expect("played");
    for channel in &fit.channels {
        let [low, high] = channel.used;
        if channel.name == "head pitch" {
            assert!(low.abs() < 0.1 && (high - 50.0).abs() < 0.01, "{channel:?}");
            assert!((channel.clipped - 24.0 / 41.0).abs() < 1e-9, "{channel:?}");
            // Interpolation rounds the corners off, so it is faster in between.
            assert!((60.0..80.0).contains(&channel.speed) && channel.speed_limit == 300.0, "{channel:?}");
        } else {
            assert!(
                channel.clipped == 0.0 && low.abs() < 0.1 && high.abs() < 0.1 && channel.speed < 2.0,
                "{channel:?}"
            );
        }
    }
    // The head is 9 cm above the neck: 10 degrees short are a chord of 15.7 mm.
    assert!((fit.reached.max_mm - 15.7).abs() < 0.5, "{:?}", fit.reached);
    assert!(Fit::of(&wide, &motion, 20).expect("played").reached.max_mm < 0.5);
}

fn distance(a: [f32; 3], b: [f32; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>().sqrt()
}

#[test]
fn trajectories_are_what_ros_expects() {
    let robot = load("desk").expect("a preset");
    let timeline = Timeline::of(&robot, &random_motion(&mut Random(5), 40, 0.5), 20).expect("played");
    let neutral: Vec<f32> = robot.channels.iter().map(|channel| channel.neutral).collect();
    let mut text = Vec::new();
    servo::write_trajectory(&timeline, &neutral, &mut text).expect("written");
    let value: Value = serde_json::from_slice(&text).expect("JSON");
    assert!(value["header"]["stamp"]["sec"] == 0 && value["header"]["frame_id"] == "");
    let names: Vec<&str> = value["joint_names"].as_array().expect("names").iter().filter_map(Value::as_str).collect();
    assert_eq!(names, timeline.names);
    let points = value["points"].as_array().expect("points");
    assert_eq!(points.len(), timeline.angles.len());
    let numbers = |point: &Value, key: &str| -> Vec<f64> {
        point[key].as_array().expect(key).iter().filter_map(Value::as_f64).collect()
    };
    let mut before: Option<(Vec<f64>, Vec<f64>)> = None;
    for (tick, (point, angles)) in points.iter().zip(&timeline.angles).enumerate() {
        let time = &point["time_from_start"];
        let nanoseconds = time["sec"].as_u64().expect("s") * 1_000_000_000 + time["nanosec"].as_u64().expect("ns");
        assert_eq!(nanoseconds, tick as u64 * 10_000_000);
        let [positions, velocities, accelerations] =
            ["positions", "velocities", "accelerations"].map(|key| numbers(point, key));
        for (k, channel) in robot.channels.iter().enumerate() {
            assert!((positions[k].to_degrees() - f64::from(angles[k])).abs() < 1e-9);
            assert!(velocities[k].to_degrees().abs() <= f64::from(channel.speed) + 0.1);
            assert!(accelerations[k].to_degrees().abs() <= f64::from(channel.acceleration) + 20.0);
            if let Some((positions_before, velocities_before)) = &before {
                assert!((positions_before[k] + velocities[k] / 100.0 - positions[k]).abs() < 1e-9);
                assert!((velocities_before[k] + accelerations[k] / 100.0 - velocities[k]).abs() < 1e-9);
            }
        }
        before = Some((positions, velocities));
    }
}

#[test]
fn arrays_compile_without_std_and_hold_the_commands() {
    let robot = load("upper-body").expect("a preset");
    let timeline = Timeline::of(&robot, &random_motion(&mut Random(6), 10, 0.5), 20).expect("played");
    let folder = tempfile::tempdir().expect("a folder");
    let file = folder.path().join("motion.rs");
    let mut text = Vec::new();
    servo::write_rust(&timeline, &mut text).expect("written");
    std::fs::write(&file, text).expect("written");
    let (last, ticks) = (timeline.commands.last().expect("ticks"), timeline.commands.len());
    let checks = format!(
        "#![no_std]\n#![deny(warnings)]\npub mod motion {{ include!({file:?}); }}\nuse motion::{{CHANNELS, COMMANDS, TICK_RATE}};\n\
         const _: () = assert!(TICK_RATE == 50 && CHANNELS.len() == 12 && COMMANDS.len() == {ticks});\n\
         const _: () = {{ let (a, b) = (COMMANDS[{ticks} - 1], {last:?}); let mut i = 0; while i < 12 {{ assert!(a[i] == b[i]); i += 1; }} }};\n"
    );
    let source = folder.path().join("lib.rs");
    std::fs::write(&source, checks).expect("written");
    let rustc = std::env::var_os("RUSTC").unwrap_or_else(|| "rustc".into());
    let output = std::process::Command::new(rustc)
        .args(["--edition", "2021", "--crate-type", "rlib", "--emit", "metadata", "--out-dir"])
        .args([folder.path(), &source])
        .output()
        .expect("rustc runs");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

/// World matrices of the nodes of a document at a frame.
fn world(document: &gltf::Gltf, frame: usize) -> Vec<[[f32; 4]; 4]> {
    let bin = document.blob.as_deref().expect("bytes");
    let animation = document.animations().next().expect("an animation");
    let count = document.nodes().count();
    let mut local: Vec<([f32; 3], [f32; 4])> =
        document.nodes().map(|node| node.transform().decomposed()).map(|(t, r, _)| (t, r)).collect();
    for channel in animation.channels() {
        use gltf::animation::util::ReadOutputs;
        let node = channel.target().node().index();
        match channel.reader(|_| Some(bin)).read_outputs().expect("values") {
            ReadOutputs::Translations(mut values) => local[node].0 = values.nth(frame).expect("a frame"),
            ReadOutputs::Rotations(values) => local[node].1 = values.into_f32().nth(frame).expect("a frame"),
            _ => panic!("only places and rotations move"),
        }
    }
    let mut world = vec![[[0.0; 4]; 4]; count];
    let matrix = |(translation, rotation): ([f32; 3], [f32; 4])| {
        gltf::scene::Transform::Decomposed { translation, rotation, scale: [1.0; 3] }.matrix()
    };
    let mut open: Vec<(usize, [[f32; 4]; 4])> = document
        .scenes()
        .next()
        .expect("a scene")
        .nodes()
        .map(|node| (node.index(), matrix(local[node.index()])))
        .collect();
    let nodes: Vec<gltf::Node<'_>> = document.nodes().collect();
    while let Some((index, at)) = open.pop() {
        world[index] = at;
        for child in nodes[index].children() {
            open.push((child.index(), product(at, matrix(local[child.index()]))));
        }
    }
    world
}

/// Of column-major matrices.
fn product(a: [[f32; 4]; 4], b: [[f32; 4]; 4]) -> [[f32; 4]; 4] {
    std::array::from_fn(|column| std::array::from_fn(|row| (0..4).map(|k| a[k][row] * b[column][k]).sum()))
}

#[test]
fn gltf_files_hold_the_skeleton_and_its_places() {
    let motion = random_motion(&mut Random(9), 33, 0.2);
    let mut bytes = Vec::new();
    glb::write_glb(&motion, 0.05, &mut bytes).expect("written");
    let document = gltf::Gltf::from_slice(&bytes).expect("a valid document");
    let bin = document.blob.as_deref().expect("bytes");
    let nodes: Vec<gltf::Node<'_>> = document.nodes().collect();
    for (j, name) in skeleton::NAMES.iter().enumerate() {
        assert_eq!(nodes[j].name(), Some(*name));
        let children: Vec<usize> = nodes[j].children().map(|child| child.index()).collect();
        let expected: Vec<usize> = (1..JOINTS).filter(|&child| skeleton::PARENTS[child] == j).collect();
        assert_eq!(children, expected, "{name}");
    }
    let animation = document.animations().next().expect("an animation");
    assert_eq!(animation.channels().count(), 2 * JOINTS);
    for channel in animation.channels() {
        let times: Vec<f32> = channel.reader(|_| Some(bin)).read_inputs().expect("times").collect();
        assert!(times.len() == 33 && times.iter().enumerate().all(|(k, t)| (t - 0.05 * k as f32).abs() < 1e-6));
    }
    for frame in [0, 1, 16, 32] {
        let world = world(&document, frame);
        for j in 0..JOINTS {
            let [x, y, z, _] = world[j][3];
            let off = distance([x, y, z], motion[frame][j]);
            assert!(off < 0.001, "{} is {off} m off at frame {frame}", skeleton::NAMES[j]);
        }
    }
    // The mesh goes with the skeleton: every vertex stays near the bone that carries it.
    let skin = document.skins().next().expect("a skin");
    assert_eq!(skin.joints().map(|joint| joint.index()).collect::<Vec<_>>(), (0..JOINTS).collect::<Vec<_>>());
    let inverse: Vec<[[f32; 4]; 4]> =
        skin.reader(|_| Some(bin)).read_inverse_bind_matrices().expect("matrices").collect();
    let primitive = document.meshes().next().expect("a mesh").primitives().next().expect("triangles");
    let reader = primitive.reader(|_| Some(bin));
    let carried: Vec<usize> = reader.read_joints(0).expect("joints").into_u16().map(|[j, ..]| j.into()).collect();
    let places: Vec<[f32; 3]> = reader.read_positions().expect("places").collect();
    let world = world(&document, 20);
    assert_eq!(places.len(), 24 * (JOINTS - 1));
    for (k, ([x, y, z], j)) in places.into_iter().zip(carried).enumerate() {
        let (bone, m) = (1 + k / 24, product(world[j], inverse[j]));
        assert_eq!(j, skeleton::PARENTS[bone]);
        let at = std::array::from_fn(|row| m[0][row] * x + m[1][row] * y + m[2][row] * z + m[3][row]);
        let length = distance(motion[20][bone], motion[20][j]);
        assert!(distance(at, motion[20][j]) < 1.6 * length + 0.02, "vertex {k} of bone {bone}");
    }
}

#[test]
fn broken_motions_are_refused_before_anything_is_written() {
    let mut motion = vec![standing(); 3];
    motion[1][5][2] = f32::NAN;
    let mut out = Vec::new();
    let error = glb::write_glb(&motion, 0.05, &mut out).expect_err("not finite");
    assert!(error.to_string().contains("frame 1: the position of right_knee") && out.is_empty(), "{error}");
    assert!(glb::write_glb(&[], 0.05, &mut out).is_err() && out.is_empty());
    let robot = load("desk").expect("a preset");
    assert!(Timeline::of(&robot, &[], 20).is_err() && Timeline::of(&robot, &motion, 0).is_err());
    for frame_rate in [1, 255, 256, 300, 1000] {
        let frames = 3 * usize::from(frame_rate);
        let motion: Vec<_> = motion.iter().cycle().take(frames).copied().collect();
        let timeline = Timeline::of(&robot, &motion, frame_rate).expect("any frame rate but 0");
        let seconds = timeline.time(timeline.motion_ticks);
        assert!((seconds - 3.0).abs() < 0.1, "{frame_rate} frames a second: {seconds} s");
    }
    let played = Timeline::of(&robot, &motion, 20).expect("degenerate bones are no reason to fail");
    assert!(played.angles.iter().flatten().all(|angle| angle.is_finite()));
}

#[test]
fn the_program_exports_a_recording_in_every_format() {
    let bench = Bench::new();
    let motion = random_motion(&mut Random(2), 50, 0.2);
    let mut text = Vec::new();
    bvh::write_positions(&motion, 0.05, &mut text).expect("written");
    bench.write("m.bvh", &text);
    bench.write("a.json", br#"{"anchors": [{"frame": 20, "joint": "left_wrist", "position": [0.5, 1.0, 0.4]}]}"#);
    let made = bench.succeeds(
        "export --bvh m.bvh --anchors a.json --robot upper-body -o o.csv -o o.json -o o.rs -o o.bvh -o o.glb",
    );
    assert_eq!((&made["frames"], &made["tick_rate"], &made["robot"]), (&50.into(), &50.into(), &"upper-body".into()));
    let robot = load("upper-body").expect("a preset");
    let timeline =
        Timeline::of(&robot, &import::bvh::load(&bench.path("m.bvh"), &Reading::default()).expect("read").joints, 20);
    let timeline = timeline.expect("played");
    let table = std::fs::read(bench.path("o.csv")).expect("a table");
    let angles = columns(&table, &named(&robot, "deg"));
    assert!(
        timeline
            .angles
            .iter()
            .enumerate()
            .all(|(tick, row)| row.iter().zip(&angles).all(|(a, c)| c[tick] as f32 == *a))
    );
    // The anchor's own distance, and that of the servos: at 1 s, tick 50.
    let off = |pose: &Pose| 100.0 * distance(pose[20], [0.5, 1.0, 0.4]);
    let at = reach(&robot, &motion[20], &timeline.angles[50]);
    let figure = |key: &str| made[key].as_f64().expect(key);
    assert!((figure("control_error_cm") - off(&motion[20])).abs() < 0.01);
    assert!((figure("servo_control_error_cm") - off(&at)).abs() < 0.01, "{made} {}", off(&at));
    let back = import::bvh::load(&bench.path("o.bvh"), &Reading::default()).expect("read back").joints;
    let off: Vec<f64> =
        back.iter().flatten().zip(motion.iter().flatten()).map(|(a, b)| 100.0 * distance(*a, *b)).collect();
    assert!((figure("rigid_mean_cm") - off.iter().sum::<f64>() / off.len() as f64).abs() < 1e-3, "{made}");
    assert!((figure("rigid_largest_cm") - off.iter().copied().fold(0.0, f64::max)).abs() < 1e-3, "{made}");
    let exact = bench.succeeds("export --bvh m.bvh --positions -o p.bvh");
    let back = import::bvh::load(&bench.path("p.bvh"), &Reading::default()).expect("read back").joints;
    assert!(back.iter().zip(&motion).all(|(a, b)| (0..JOINTS).all(|j| distance(a[j], b[j]) < 1e-5)));
    assert!(exact["rigid_mean_cm"].is_null(), "{exact}");
    bench.fails(
        &["export", "--bvh", "m.bvh", "--positions", "--format", "glb", "-o", "x"],
        &["--positions is for .bvh"],
    );
    gltf::Gltf::from_slice(&std::fs::read(bench.path("o.glb")).expect("a file")).expect("a document");
    bench.fails(&["export", "--bvh", "m.bvh", "-o", "x"], &["names no format", ".csv"]);
    bench.fails(&["export", "--bvh", "m.bvh", "--format", "csv", "-o", "x"], &["give --robot", "upper-body, desk"]);
    bench.fails(&["export", "--bvh", "m.bvh", "--robot", "dsk", "--format", "rs", "-o", "x"], &["no robot \"dsk\""]);
    bench.misused("export --bvh m.bvh --seed 3 --robot desk -o x", "--seed");
    bench.misused("export --robot desk -o x", "--text");
    bench.misused("export --blob b --text t --unit cm -o x", "--unit");
    bench.misused("robot fit desk --blob b --text t --mapping m.json", "--mapping");
    bench.misused("generate --text x -o x", "--blob");
}

#[test]
fn the_program_shows_checks_packs_and_tries_robots() {
    let bench = Bench::new();
    let presets = bench.succeeds("robot presets");
    assert_eq!(presets["presets"].as_array().expect("a list").len(), PRESETS.len());
    let robot = load("desk").expect("a preset");
    assert_eq!(bench.succeeds("robot show desk"), serde_json::to_value(&robot).expect("JSON"));
    let shown = bench.run(&["robot", "show", "desk", "--toml"]);
    let (text, _) = PRESETS[1].text.split_at(200);
    assert!(String::from_utf8_lossy(&shown.stdout).starts_with(text));
    bench.succeeds("robot pack desk -o desk.bin");
    assert_eq!(robot_file::read(&bench.path("desk.bin")).expect("packed"), robot);
    bench.write("good.toml", PRESETS[1].text.as_bytes());
    assert_eq!(bench.succeeds("robot check good.toml")["channels"], 8);
    assert_eq!(bench.succeeds("robot check desk")["channels"], 8);
    let shown = bench.run(&["robot", "show", "good.toml", "--toml"]);
    assert!(String::from_utf8_lossy(&shown.stdout).starts_with(text));
    bench.fails(&["robot", "show", "desk.bin", "--toml"], &["desk.bin is a packed robot"]);
    bench.write("notes.txt", b"a robot\n= of [ mine {\n\"has\n\tthree ) legs, and\n[[ no = toml ]\n'");
    bench.fails(&["robot", "check", "notes.txt"], &["notes.txt has 1 problem\n", "notes.txt:1: this is no TOML"]);
    bench.write("bad.toml", PRESETS[1].text.replace("id = 8", "id = 7").replace("\"neck\"", "\"nek\"").as_bytes());
    bench.fails(
        &["robot", "check", "bad.toml"],
        &["bad.toml has 2 problems", "did you mean neck?", "(line 7", "| id = 7", "hint: docs/robot.md"],
    );
    bench.convert();
    let fit = bench.makes(&["robot", "fit", "desk", "--blob", "p.blob", "--text", "a person waves"]);
    let channels = fit["channels"].as_array().expect("channels");
    assert!(channels.len() == 8 && channels.iter().all(|c| c["used"][0].as_f64() >= c["range"][0].as_f64()));
    let plan = bench.succeeds("plan p.blob --tokens 10 --robot desk");
    let frames = plan["frames"].as_u64().expect("frames") as usize;
    assert_eq!(plan["playback"]["queue_bytes"], queue_bytes(8, frames));
    let player = size_of::<motionette::playback::Player<'_, 8>>();
    assert_eq!(plan["playback"]["player_bytes"], player);
    let output = bench.run(&["plan", "p.blob"]);
    assert!(report(&output).get("playback").is_none());
}
