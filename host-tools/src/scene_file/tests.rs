use motionette::{ALL_JOINTS, BodyParts, Course, Keyframe, Prompt, Shape};

use super::*;
use crate::entries::Fault;

/// The message of a tracks file whose second track is this, which must be refused.
fn refused_track(track: &str) -> String {
    const GOOD: &str = r#"{"joint":"head","frame":0,"positions":[[0,1.5,0]]}"#;
    parse_tracks(&format!("{{\"tracks\": [{GOOD}, {track}]}}"), 20).expect_err(track).to_string()
}

/// The message of a scene file whose second obstacle is this, which must be refused.
fn refused_obstacle(obstacle: &str) -> String {
    const GOOD: &str = r#"{"sphere":{"radius":1},"at":[0,1,5]}"#;
    parse_scene(&format!("{{\"obstacles\": [{GOOD}, {obstacle}]}}"), 20).expect_err(obstacle).to_string()
}

fn tracks(list: &str, frame_rate: u16) -> Vec<OwnedTrack> {
    parse_tracks(&format!("{{\"tracks\": [{list}]}}"), frame_rate).expect(list)
}

fn obstacles(list: &str) -> Vec<OwnedObstacle> {
    parse_scene(&format!("{{\"obstacles\": [{list}]}}"), 20).expect(list)
}

fn spans(list: &str) -> Vec<OwnedSpan> {
    parse_timeline(&format!("{{\"timeline\": [{list}]}}"), 20).expect(list)
}

#[test]
fn tracks_as_they_stand() {
    let read = tracks(
        r#"{"joint":"right_wrist","frame":10,"positions":[[1,2,3],null,[4,5,6],[7,8,9]],"mask":[1,1,0,1],"axes":"xz","tolerance":0.02},
        {"joint":"pelvis","time":0.5,"positions":[[0,-0.5,2e-1]]}"#,
        20,
    );
    let wrist = OwnedTrack {
        joint: 21,
        first: 10,
        axes: [true, false, true],
        mask: Some(vec![1, 0, 0, 1]),
        positions: vec![[1.0, 2.0, 3.0], [0.0; 3], [0.0; 3], [7.0, 8.0, 9.0]],
        tolerance: 0.02,
    };
    let pelvis = OwnedTrack {
        joint: 0,
        first: 10,
        axes: [true; 3],
        mask: None,
        positions: vec![[0.0, -0.5, 0.2]],
        tolerance: 0.0,
    };
    assert_eq!(read, [wrist.clone(), pelvis]);
    let borrowed = wrist.borrowed();
    assert_eq!(
        (borrowed.at(10), borrowed.at(11), borrowed.at(13), borrowed.at(14)),
        (Some([1.0, 2.0, 3.0]), None, Some([7.0, 8.0, 9.0]), None)
    );
    assert_eq!(parse_tracks("\u{feff}{\"tracks\": []}", 20).expect("an empty list"), []);
}

#[test]
fn positions_at_a_rate_of_their_own_are_taken_to_the_frames_of_the_model() {
    // 30 a second to 20 a second: frames at positions 0, 1.5, 3, 4.5.
    let line =
        r#"{"joint":"head","frame":4,"frame_rate":30,"positions":[[0,1,0],[1,1,0],[2,1,0],[3,1,0],[4,1,0],[5,1,0]]}"#;
    let [head] = &tracks(line, 20)[..] else { panic!("one track") };
    assert_eq!((head.first, &head.mask), (4, &None));
    assert_eq!(head.positions, [0.0, 1.5, 3.0, 4.5].map(|x| [x, 1.0, 0.0]));
    // Nothing where a neighbour does not count, and a position on a frame needs none.
    let gap = line.replace("[2,1,0]", "null");
    let [head] = &tracks(&gap, 20)[..] else { panic!("one track") };
    assert_eq!(head.mask, Some(vec![1, 0, 1, 1]));
    // A start between two frames: 0.12 s is frame 2.4, and frame 3 is 0.9 positions behind it.
    let late = line.replace("\"frame\":4", "\"time\":0.12");
    let [head] = &tracks(&late, 20)[..] else { panic!("one track") };
    assert_eq!(head.first, 3);
    assert!((head.positions[0][0] - 0.9).abs() < 1e-6 && head.positions.len() == 3, "{head:?}");
    // Fewer than the model makes.
    let slow = r#"{"joint":"head","time":0,"frame_rate":5,"positions":[[0,1,0],[1,1,4]]}"#;
    let [head] = &tracks(slow, 20)[..] else { panic!("one track") };
    assert_eq!(head.positions, [0.0, 0.25, 0.5, 0.75, 1.0].map(|x| [x, 1.0, 4.0 * x]));
}

#[test]
fn tracks_are_refused_with_index_and_field() {
    for (track, parts) in [
        (r#"{"frame":1,"positions":[[0,0,0]]}"#, &["joint is missing", "right_wrist"][..]),
        (r#"{"joint":"head","frame":1}"#, &["positions is missing", "[[x, y, z], ...]"]),
        (r#"{"joint":"head","positions":[[0,0,0]]}"#, &["no time; give time (seconds) or frame"]),
        (r#"{"joint":"head","time":1,"frame":1,"positions":[[0,0,0]]}"#, &["both time and frame"]),
        (r#"{"joint":"head","frame":1,"frame":2,"positions":[[0,0,0]]}"#, &["frame is given twice"]),
        (
            r#"{"joint":"head","frame":1,"position":[[0,0,0]]}"#,
            &["unknown field \"position\"", "positions, mask, axes"],
        ),
        (r#"{"joint":"hand","frame":1,"positions":[[0,0,0]]}"#, &["no joint \"hand\"", "left_wrist, right_wrist"]),
        (r#"{"joint":21,"frame":1,"positions":[[0,0,0]]}"#, &["joint must be the name of a joint, not 21"]),
        (r#"{"joint":"head","frame":-1,"positions":[[0,0,0]]}"#, &["frame -1 lies before the start"]),
        (r#"{"joint":"head","frame":1.5,"positions":[[0,0,0]]}"#, &["frame must be a whole number, not 1.5"]),
        (r#"{"joint":"head","time":"1","positions":[[0,0,0]]}"#, &["time must be a number of seconds"]),
        (r#"{"joint":"head","time":1e9,"positions":[[0,0,0]]}"#, &["time 1000000000 lies beyond any motion"]),
        (r#"{"joint":"head","frame":1,"positions":[0,0,0]}"#, &["positions must be a list of positions", "not 0"]),
        (r#"{"joint":"head","frame":1,"positions":7}"#, &["positions must be", "not 7"]),
        (r#"{"joint":"head","frame":1,"positions":[[0,0]]}"#, &["positions must be", "[0,0]"]),
        (r#"{"joint":"head","frame":1,"positions":[[0,null,0]]}"#, &["positions must be", "null"]),
        (r#"{"joint":"head","frame":1,"positions":[[0,1e39,0]]}"#, &["positions holds 1e39", "finite"]),
        (r#"{"joint":"head","frame":1,"positions":[]}"#, &["no position counts"]),
        (r#"{"joint":"head","frame":1,"positions":[null]}"#, &["no position counts; give some"]),
        (r#"{"joint":"head","frame":1,"positions":[[0,0,0]],"mask":[0]}"#, &["no position counts"]),
        (r#"{"joint":"head","frame":1,"positions":[[0,0,0]],"mask":[1,1]}"#, &["2 entries for 1 positions"]),
        (
            r#"{"joint":"head","frame":1,"positions":[[0,0,0]],"mask":[2]}"#,
            &["mask must be a list of 0 and 1", "not 2"],
        ),
        (r#"{"joint":"head","frame":1,"positions":[[0,0,0]],"mask":[true]}"#, &["mask must be", "not true"]),
        (r#"{"joint":"head","frame":1,"positions":[[0,0,0]],"mask":1}"#, &["mask must be", "not 1"]),
        (r#"{"joint":"head","frame":1,"positions":[[0,0,0]],"axes":""}"#, &["axes must be some of the letters"]),
        (r#"{"joint":"head","frame":1,"positions":[[0,0,0]],"axes":"xx"}"#, &["axes must be", "each once", "\"xx\""]),
        (r#"{"joint":"head","frame":1,"positions":[[0,0,0]],"axes":"xw"}"#, &["axes must be", "\"xw\""]),
        (r#"{"joint":"head","frame":1,"positions":[[0,0,0]],"axes":[1,0,1]}"#, &["axes must be", "[1,0,1]"]),
        (
            r#"{"joint":"head","frame":1,"positions":[[0,0,0]],"tolerance":-0.1}"#,
            &["tolerance is -0.1; it must be 0 to 1 m"],
        ),
        (
            r#"{"joint":"head","frame":1,"positions":[[0,0,0]],"tolerance":20}"#,
            &["tolerance is 20; it must be 0 to 1 m"],
        ),
        (r#"{"joint":"head","frame":1,"positions":[[0,0,0]],"tolerance":"2 cm"}"#, &["tolerance must be a number"]),
        (
            r#"{"joint":"head","frame":1,"positions":[[0,0,0]],"frame_rate":0}"#,
            &["frame_rate is 0; it must be above 0"],
        ),
        (r#"{"joint":"head","frame":1,"positions":[[0,0,0]],"frame_rate":1e5}"#, &["frame_rate is 100000", "10000"]),
        (r#"{"joint":"head","frame":1,"positions":[[0,0,0]],"frame_rate":"30"}"#, &["frame_rate must be a number"]),
        (
            r#"{"joint":"head","time":0.03,"positions":[[0,0,0]],"frame_rate":30}"#,
            &["falls on a frame of the model, which has 20"],
        ),
        (
            r#"{"joint":"head","time":0.01,"positions":[[0,0,0],null,[0,0,0]],"frame_rate":30}"#,
            &["nothing of it falls"],
        ),
        (r#"{"joint":"head","frame":65535,"positions":[[0,0,0],[0,0,0]]}"#, &["last position lies at frame 65536"]),
        (r#"{"joint":"head","frame":0,"positions":[[0,0,0],[0,0,0]],"frame_rate":1e-5}"#, &["lies at frame 2000000"]),
    ] {
        let message = refused_track(track);
        assert!(message.starts_with("track 1: "), "{message}");
        for part in parts {
            assert!(message.contains(part), "{track}: {message:?} lacks {part:?}");
        }
    }
}

#[test]
fn obstacles_of_every_form_and_course() {
    let read = obstacles(
        r#"{"sphere":{"radius":0.3},"at":[1,2,3],"margin":0,"joints":["head","left_wrist","head"]},
        {"capsule":{"radius":0.1,"from":[-1,0.5,2],"to":[1,0.5,4]}},
        {"cylinder":{"radius":0.2,"height":2},"at":[0,1,2],"velocity":[0.5,0,-0.25]},
        {"box":{"size":[0.5,1,2]},"keyframes":[{"time":0.5,"position":[1,0,0]},{"frame":40,"position":[0,0,1]}]},
        {"plane":{"normal":[0,0,-1]},"at":[0,0,4]},
        {"capsule":{"radius":0.1,"from":[0,0,0],"to":[0,2,0]},"velocity":[0,0,1]},
        {"capsule":{"radius":0.1,"from":[0,0,0],"to":[0,2,0]},"keyframes":[{"frame":0,"position":[5,1,5]}]}"#,
    );
    let shapes: Vec<Shape> = read.iter().map(|obstacle| obstacle.shape).collect();
    let upright = Shape::Capsule { half: [0.0, 1.0, 0.0], radius: 0.1 };
    assert_eq!(
        shapes,
        [
            Shape::Sphere { radius: 0.3 },
            Shape::Capsule { half: [1.0, 0.0, 1.0], radius: 0.1 },
            Shape::Cylinder { radius: 0.2, half_height: 1.0 },
            Shape::Box { half: [0.25, 0.5, 1.0] },
            Shape::Plane { normal: [0.0, 0.0, -1.0] },
            upright,
            upright,
        ]
    );
    assert_eq!((read[0].margin, read[0].joints), (0.0, 1 << 15 | 1 << 20));
    assert_eq!((read[1].margin, read[1].joints), (0.05, ALL_JOINTS));
    let keyframes =
        [Keyframe { frame: 10, position: [1.0, 0.0, 0.0] }, Keyframe { frame: 40, position: [0.0, 0.0, 1.0] }];
    let courses: Vec<Course<'_>> = read.iter().map(|obstacle| obstacle.borrowed().course).collect();
    assert_eq!(
        courses,
        [
            Course::Still([1.0, 2.0, 3.0]),
            Course::Still([0.0, 0.5, 3.0]),
            Course::Moving { from: [0.0, 1.0, 2.0], velocity: [0.5, 0.0, -0.25] },
            Course::Keyframes(&keyframes),
            Course::Still([0.0, 0.0, 4.0]),
            Course::Moving { from: [0.0, 1.0, 0.0], velocity: [0.0, 0.0, 1.0] },
            Course::Keyframes(&[Keyframe { frame: 0, position: [5.0, 1.0, 5.0] }]),
        ]
    );
    assert_eq!(read[2].borrowed().margin, 0.05);
    assert_eq!(parse_scene("{\"obstacles\": []}", 20).expect("an empty list"), []);
}

#[test]
fn obstacles_are_refused_with_index_and_field() {
    for (obstacle, parts) in [
        (r#"{"at":[0,0,0]}"#, &["it has no form", "sphere, capsule, cylinder, box, plane"][..]),
        (
            r#"{"sphere":{"radius":1},"box":{"size":[1,1,1]},"at":[0,0,0]}"#,
            &["several forms (sphere, box)", "exactly one"],
        ),
        (r#"{"sphere":{"radius":1},"sphere":{"radius":2},"at":[0,0,0]}"#, &["sphere is given twice"]),
        (r#"{"sphere":{"radius":1,"radius":2},"at":[0,0,0]}"#, &["radius is given twice"]),
        (r#"{"ball":{"radius":1},"at":[0,0,0]}"#, &["unknown field \"ball\"", "sphere, capsule"]),
        (r#"{"sphere":{"radius":1,"height":2},"at":[0,0,0]}"#, &["unknown field \"height\"; fields are radius"]),
        (r#"{"sphere":0.3,"at":[0,0,0]}"#, &["sphere must be an object with its sizes, not 0.3"]),
        (r#"{"sphere":{},"at":[0,0,0]}"#, &["radius is missing"]),
        (r#"{"sphere":{"radius":0},"at":[0,0,0]}"#, &["radius is 0; it must be above 0 and at most 100 m"]),
        (r#"{"sphere":{"radius":-1},"at":[0,0,0]}"#, &["radius is -1"]),
        (r#"{"sphere":{"radius":1000},"at":[0,0,0]}"#, &["radius is 1000"]),
        (r#"{"sphere":{"radius":"1 m"},"at":[0,0,0]}"#, &["radius must be a number of metres"]),
        (r#"{"sphere":{"radius":1e39},"at":[0,0,0]}"#, &["radius holds 1e39"]),
        (r#"{"sphere":{"radius":1}}"#, &["at is missing", "keyframes"]),
        (r#"{"sphere":{"radius":1},"velocity":[0,0,1]}"#, &["at is missing"]),
        (r#"{"sphere":{"radius":1},"at":[0,0]}"#, &["at must be a list of three numbers", "[0,0]"]),
        (r#"{"capsule":{"radius":1,"from":[0,0,0]}}"#, &["to is missing"]),
        (r#"{"capsule":{"radius":1,"to":[0,0,0]}}"#, &["from is missing"]),
        (r#"{"capsule":{"radius":1,"from":[0,0,0],"to":[0,1]}}"#, &["to must be a list of three"]),
        (
            r#"{"capsule":{"radius":1,"from":[0,0,0],"to":[0,1,0]},"at":[0,0,0]}"#,
            &["at and capsule's from and to are both given"],
        ),
        (r#"{"cylinder":{"radius":1},"at":[0,0,0]}"#, &["height is missing"]),
        (r#"{"cylinder":{"radius":1,"height":-2},"at":[0,0,0]}"#, &["height is -2"]),
        (r#"{"box":{},"at":[0,0,0]}"#, &["size is missing"]),
        (r#"{"box":{"size":1},"at":[0,0,0]}"#, &["size must be a list of three"]),
        (r#"{"box":{"size":[1,0,1]},"at":[0,0,0]}"#, &["size is 0"]),
        (r#"{"plane":{},"at":[0,0,0]}"#, &["normal is missing"]),
        (r#"{"plane":{"normal":[0,0,0]},"at":[0,0,0]}"#, &["normal's length is 0", "a direction"]),
        (
            r#"{"sphere":{"radius":1},"at":[0,0,0],"velocity":[0,0,1],"keyframes":[]}"#,
            &["velocity and keyframes are both"],
        ),
        (
            r#"{"sphere":{"radius":1},"at":[0,0,0],"keyframes":[{"frame":0,"position":[0,0,0]}]}"#,
            &["at and keyframes are both"],
        ),
        (r#"{"sphere":{"radius":1},"at":[0,0,0],"velocity":1}"#, &["velocity must be a list of three"]),
        (r#"{"sphere":{"radius":1},"keyframes":[]}"#, &["keyframes must be a list of objects", "at least one"]),
        (r#"{"sphere":{"radius":1},"keyframes":{"frame":0}}"#, &["keyframes must be"]),
        (r#"{"sphere":{"radius":1},"at":[0,0,0],"margin":-0.1}"#, &["margin is -0.1; it must be 0 to 1 m"]),
        (r#"{"sphere":{"radius":1},"at":[0,0,0],"margin":null}"#, &["margin must be a number of metres, not null"]),
        (r#"{"sphere":{"radius":1},"at":[0,0,0],"joints":[]}"#, &["joints must be a list of names"]),
        (r#"{"sphere":{"radius":1},"at":[0,0,0],"joints":"head"}"#, &["joints must be a list", "\"head\""]),
        (r#"{"sphere":{"radius":1},"at":[0,0,0],"joints":["hand"]}"#, &["no joint \"hand\""]),
        (r#"{"sphere":{"radius":1},"at":[0,0,0],"joints":[15]}"#, &["joints must be the name of a joint, not 15"]),
    ] {
        let message = refused_obstacle(obstacle);
        assert!(message.starts_with("obstacle 1: "), "{message}");
        for part in parts {
            assert!(message.contains(part), "{obstacle}: {message:?} lacks {part:?}");
        }
    }
}

#[test]
fn keyframes_are_refused_with_their_number() {
    for (second, part) in [
        ("7", "it must be an object with time and position, not 7"),
        (r#"{"position":[0,0,0]}"#, "no time"),
        (r#"{"frame":2,"time":3,"position":[0,0,0]}"#, "both time and frame"),
        (r#"{"frame":2}"#, "position is missing"),
        (r#"{"frame":2,"position":[0]}"#, "position must be a list of three"),
        (r#"{"frame":2,"position":[0,0,0],"speed":1}"#, "unknown field \"speed\"; fields are time, frame, position"),
        (r#"{"frame":1,"position":[0,0,0]}"#, "its frame 1 is not behind that of the keyframe before it"),
        (r#"{"time":-1,"position":[0,0,0]}"#, "time -1 lies before the start"),
    ] {
        let first = r#"{"frame":1,"position":[0,0,0]}"#;
        let message = refused_obstacle(&format!("{{\"sphere\":{{\"radius\":1}},\"keyframes\":[{first},{second}]}}"));
        assert!(message.starts_with("obstacle 1, keyframe 1: ") && message.contains(part), "{second}: {message}");
    }
}

#[test]
fn spans_as_they_stand() {
    let read = spans(
        r#"{"parts":"right_arm","from":1.0,"to":3.02,"text":"a person waves"},
        {"parts":["left_arm","head"],"first_frame":60,"frames":30,"prompt":"wave"},
        {"parts":["Upper Body","LEFT-LEG","head"],"from":0,"to":0.01,"text":""}"#,
    );
    let text = |text: &str| OwnedPrompt::Text(text.to_owned());
    let arm = OwnedSpan { parts: BodyParts::RIGHT_ARM, first: 20, frames: 40, prompt: text("a person waves") };
    let both = BodyParts::LEFT_ARM.and(BodyParts::HEAD);
    let stored = OwnedSpan { parts: both, first: 60, frames: 30, prompt: OwnedPrompt::Bank("wave".to_owned()) };
    let all = BodyParts::UPPER_BODY.and(BodyParts::LEFT_LEG);
    // What is too short for a span, or says nothing, refuses the runtime.
    let short = OwnedSpan { parts: all, first: 0, frames: 0, prompt: text("") };
    assert_eq!(read, [arm.clone(), stored.clone(), short]);
    let (arm, stored) = (arm.borrowed(), stored.borrowed());
    assert_eq!(
        (arm.parts, arm.first, arm.end(), arm.prompt),
        (BodyParts::RIGHT_ARM, 20, 60, Prompt::Text("a person waves"))
    );
    assert_eq!((stored.end(), stored.prompt), (90, Prompt::Bank("wave")));
    assert_eq!(parse_timeline("\u{feff}{\"timeline\": []}", 20).expect("an empty list"), []);
}

#[test]
fn spans_are_refused_with_index_and_field() {
    for (span, parts) in [
        (r#"{"from":1,"to":2,"text":"a"}"#, &["parts is missing; give \"parts\": \"right_arm\""][..]),
        (
            r#"{"parts":"rigth_arm","from":1,"to":2,"text":"a"}"#,
            &[
                "no part \"rigth_arm\"; parts are head, left_arm, right_arm, left_leg, right_leg, arms, legs, upper_body",
            ],
        ),
        (r#"{"parts":["head","tail"],"from":1,"to":2,"text":"a"}"#, &["no part \"tail\""]),
        (r#"{"parts":[],"from":1,"to":2,"text":"a"}"#, &["parts must be the name of a part", "not []"]),
        (r#"{"parts":["head",4],"from":1,"to":2,"text":"a"}"#, &["parts must be the name", "or a list", "not 4"]),
        (r#"{"parts":null,"from":1,"to":2,"text":"a"}"#, &["parts must be the name", "not null"]),
        (r#"{"parts":"head","text":"a"}"#, &["no time; give either from and to (seconds) or first_frame and frames"]),
        (r#"{"parts":"head","from":1,"text":"a"}"#, &["its times are from; give either from and to"]),
        (r#"{"parts":"head","frames":9,"text":"a"}"#, &["its times are frames;"]),
        (r#"{"parts":"head","from":1,"frames":9,"text":"a"}"#, &["its times are from, frames;"]),
        (
            r#"{"parts":"head","from":1,"to":2,"first_frame":1,"frames":9,"text":"a"}"#,
            &["its times are from, to, first_frame, frames;"],
        ),
        (r#"{"parts":"head","from":1,"from":1,"to":2,"text":"a"}"#, &["from is given twice"]),
        (r#"{"parts":"head","from":"1","to":2,"text":"a"}"#, &["from must be a number of seconds, not \"1\""]),
        (r#"{"parts":"head","from":-1,"to":2,"text":"a"}"#, &["from -1 lies before the start of the motion"]),
        (r#"{"parts":"head","from":1,"to":4000,"text":"a"}"#, &["to 4000 lies beyond any motion"]),
        (r#"{"parts":"head","from":2,"to":1.5,"text":"a"}"#, &["to, 1.5 s, is not behind from, 2 s; give a later one"]),
        (r#"{"parts":"head","from":2,"to":2,"text":"a"}"#, &["to, 2 s, is not behind from, 2 s"]),
        (r#"{"parts":"head","first_frame":-1,"frames":9,"text":"a"}"#, &["first_frame -1 lies before the start"]),
        (r#"{"parts":"head","first_frame":0.5,"frames":9,"text":"a"}"#, &["first_frame must be a whole number"]),
        (r#"{"parts":"head","first_frame":70000,"frames":9,"text":"a"}"#, &["first_frame 70000 lies beyond"]),
        (r#"{"parts":"head","first_frame":0,"frames":0,"text":"a"}"#, &["frames is 0; it must be 1 to 65535"]),
        (r#"{"parts":"head","first_frame":0,"frames":65536,"text":"a"}"#, &["frames is 65536; it must be 1 to 65535"]),
        (r#"{"parts":"head","first_frame":0,"frames":-8,"text":"a"}"#, &["frames must be a whole number, not -8"]),
        (r#"{"parts":"head","first_frame":0,"frames":8.5,"text":"a"}"#, &["frames must be a whole number, not 8.5"]),
        (r#"{"parts":"head","from":1,"to":2}"#, &["text is missing; give \"text\": \"a person waves"]),
        (r#"{"parts":"head","from":1,"to":2,"text":7}"#, &["text must be what the parts do, in words, not 7"]),
        (r#"{"parts":"head","from":1,"to":2,"prompt":["a"]}"#, &["prompt must be the name of a prompt", "[\"a\"]"]),
        (r#"{"parts":"head","from":1,"to":2,"text":"a","prompt":"b"}"#, &["text and prompt are both given; keep one"]),
        (
            r#"{"parts":"head","from":1,"to":2,"text":"a","joint":"head"}"#,
            &["unknown field \"joint\"; fields are parts, from, to, first_frame, frames, text, prompt"],
        ),
    ] {
        const GOOD: &str = r#"{"parts":"head","from":0,"to":1,"text":"a person nods"}"#;
        let refused = parse_timeline(&format!("{{\"timeline\": [{GOOD}, {span}]}}"), 20);
        let message = refused.expect_err(span).to_string();
        assert!(message.starts_with("span 1: "), "{message}");
        for part in parts {
            assert!(message.contains(part), "{span}: {message:?} lacks {part:?}");
        }
    }
}

#[test]
fn a_timeline_that_is_written_is_read_back() {
    let sets = (0..=u8::MAX).filter_map(BodyParts::from_bits).filter(|parts| !parts.is_empty());
    let written: Vec<OwnedSpan> = sets
        .zip(0..)
        .map(|(parts, number)| {
            let words = format!("a \"person\" waves\n\\ \u{e4}\u{1f44b} {number}");
            let prompt = if number % 2 == 0 { OwnedPrompt::Text(words) } else { OwnedPrompt::Bank(words) };
            OwnedSpan { parts, first: u16::MAX - number, frames: u16::MAX - 3 * number, prompt }
        })
        .collect();
    assert_eq!(written.len(), 35);
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("timeline.json");
    write_timeline(&path, &written).expect("writable");
    assert_eq!(read_timeline(&path, 20).expect("readable"), written);
    assert_eq!(parse_timeline(&timeline_text(&[]).expect("writable"), 20).expect("readable"), []);
    let text = timeline_text(&written[..1]).expect("writable");
    assert!(
        text.contains(r#"{"parts": "head", "first_frame": 65535, "frames": 65535, "text": "a \"person\" "#),
        "{text}"
    );

    // What the file cannot hold leaves what stands there.
    let nothing = OwnedSpan { parts: BodyParts::NONE, ..written[0].clone() };
    let found = write_timeline(&path, &[written[0].clone(), nothing]);
    assert!(matches!(found, Err(Error::NoParts { index: 1 })), "{found:?}");
    let found = write_timeline(&path, &[OwnedSpan { frames: 0, ..written[0].clone() }]);
    assert!(matches!(found, Err(Error::Range { field: "frames", .. })), "{found:?}");
    assert_eq!(read_timeline(&path, 20).expect("readable"), written);
    let missing = read_timeline(&folder.path().join("none.json"), 20).expect_err("no such file");
    assert!(matches!(&missing, Error::Read { .. }) && missing.to_string().contains("none.json"), "{missing}");
    let folder = write_timeline(folder.path(), &[]).expect_err("a folder, no file");
    assert!(matches!(&folder, Error::Write(_)), "{folder}");
}

#[test]
fn form_is_refused_with_line_and_column() {
    for (text, place) in [
        ("", (1, 0)),
        ("{\"LIST\": [\n  {\"frame\" 1}\n]}", (2, 12)),
        ("{\"LIST\": [], \"fps\": 30}", (1, 21)),
        ("{\"LIST\": [7]}", (1, 14)),
        ("{\"LIST\": []} x", (1, 17)),
        (" []", (1, 2)),
        ("{}", (1, 2)),
    ] {
        // Names have other numbers of letters than the one that these places were counted for.
        for (name, more) in [("tracks", 6), ("obstacles", 9), ("timeline", 8)] {
            let text = text.replace("LIST", name);
            let (line, column) = match place {
                (1, column) if text.contains(name) => (1, column - 7 + more),
                place => place,
            };
            let found = match name {
                "tracks" => parse_tracks(&text, 20).map(|_| ()),
                "timeline" => parse_timeline(&text, 20).map(|_| ()),
                _ => parse_scene(&text, 20).map(|_| ()),
            };
            let said = found.as_ref().map_err(ToString::to_string);
            match &found {
                Err(Error::Json { line: l, column: c, .. }) => {
                    assert_eq!((*l, *c), (line, column), "{text:?}: {said:?}")
                }
                _ => panic!("{text:?}: {found:?}"),
            }
            let said = said.expect_err("refused");
            assert!(said.starts_with(&format!("line {line}, column {column}: ")) && said.contains(name), "{said}");
        }
    }
    let deep = "[".repeat(100_000);
    assert!(matches!(parse_tracks(&format!("{{\"tracks\": [{{\"mask\": {deep}"), 20), Err(Error::Json { .. })));
    let long = refused_track(&format!(r#"{{"joint":"{}","frame":0,"positions":[[0,0,0]]}}"#, "\u{e4}".repeat(500)));
    assert!(long.contains("...") && long.chars().count() < 500, "{long}");
}

#[test]
fn what_is_written_is_read_back() {
    let mut x = 0.1f32;
    let written: Vec<OwnedTrack> = (0..22)
        .map(|joint| {
            let positions = (0..4).map(|_| {
                x *= -1.737_191_5;
                [x, 1.0 / x, -0.0]
            });
            OwnedTrack {
                joint,
                first: 7 * u16::from(joint),
                axes: [joint % 2 == 0, true, joint % 3 == 0],
                mask: None,
                positions: positions.collect(),
                tolerance: if joint % 5 == 0 { 0.0 } else { 0.01 * f32::from(joint) },
            }
        })
        .collect();
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("tracks.json");
    write_tracks(&path, &written).expect("writable");
    let back = read_tracks(&path, 20).expect("readable");
    assert_eq!(format!("{back:?}"), format!("{written:?}"), "signs of zero included");
    // What does not count is lost, and nothing else.
    let mut gap = written[3].clone();
    (gap.mask, gap.positions[2]) = (Some(vec![1, 1, 0, 1]), [0.0; 3]);
    let text = tracks_text(std::slice::from_ref(&gap)).expect("writable");
    assert_eq!(parse_tracks(&text, 20).expect("readable"), [gap]);
    assert_eq!(parse_tracks(&tracks_text(&[]).expect("writable"), 20).expect("readable"), []);
}

#[test]
fn what_the_file_cannot_hold_is_refused_and_nothing_is_left() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("tracks.json");
    let good =
        OwnedTrack { joint: 0, first: 0, axes: [true; 3], mask: None, positions: vec![[0.0; 3]], tolerance: 0.0 };
    let nan = OwnedTrack { positions: vec![[0.0, f32::NAN, 0.0]], ..good.clone() };
    let found = write_tracks(&path, &[good.clone(), nan]);
    assert!(
        matches!(&found, Err(Error::Field { place, fault: Fault::NotFinite { field: "positions", .. } }) if place.index == 1),
        "{found:?}"
    );
    let found = write_tracks(&path, &[OwnedTrack { tolerance: f32::INFINITY, ..good.clone() }]);
    assert!(
        matches!(&found, Err(Error::Field { fault: Fault::NotFinite { field: "tolerance", .. }, .. })),
        "{found:?}"
    );
    let found = write_tracks(&path, &[OwnedTrack { joint: 22, ..good.clone() }]);
    assert!(matches!(found, Err(Error::NoSuchJoint { index: 0, joint: 22 })), "{found:?}");
    let found = write_tracks(&path, &[OwnedTrack { mask: Some(vec![1, 0]), ..good }]);
    assert!(matches!(found, Err(Error::Mask { index: 0, found: 2, positions: 1 })), "{found:?}");
    assert!(!path.exists());
    for missing in [read_tracks(&path, 20).map(|_| ()), read_scene(&path, 20).map(|_| ())] {
        let missing = missing.expect_err("no such file");
        assert!(matches!(&missing, Error::Read { .. }) && missing.to_string().contains("tracks.json"), "{missing}");
    }
    let folder = write_tracks(folder.path(), &[]).expect_err("a folder, no file");
    assert!(matches!(&folder, Error::Write(_)), "{folder}");
}
