use super::*;

/// The message of a file with these anchors, which must be refused.
fn refused(anchors: &str) -> String {
    parse(&format!("{{\"anchors\": [{anchors}]}}"), 20).expect_err(anchors).to_string()
}

#[test]
fn all_three_families_and_both_times() {
    let text = r#"{"anchors":[{"time":2.0,"root":[1,-0.5,2e-1]},
        {"frame":70,"joint":"right_wrist","position":[0.25,1.5,3]},
        {"time":3.974,"planar_root":[7,8]},
        {"position":[1,2,3],"time":0,"joint":"pelvis"}]}"#;
    let expected = [
        Anchor::root(40, [1.0, -0.5, 0.2]),
        Anchor::joint(70, 21, [0.25, 1.5, 3.0]),
        Anchor::planar_root(79, [7.0, 8.0]),
        Anchor::joint(0, 0, [1.0, 2.0, 3.0]),
    ];
    assert_eq!(parse(text, 20).expect("valid"), expected);
    assert_eq!(parse("\u{feff}{\"anchors\": []}", 20).expect("valid"), []);
}

#[test]
fn seconds_are_frames_of_the_model() {
    let text = r#"{"anchors": [{"time": 1.99, "root": [0, 0, 0]}, {"frame": 7, "root": [0, 0, 0]}]}"#;
    for (frame_rate, frame) in [(8, 16), (20, 40), (30, 60), (1000, 1990)] {
        let anchors = parse(text, frame_rate).expect("valid");
        assert_eq!(anchors.iter().map(|anchor| anchor.frame).collect::<Vec<_>>(), [frame, 7], "{frame_rate} a second");
        check_at(&anchors, usize::from(frame) + 1, frame_rate).expect("just inside");
        let message = check_at(&anchors, frame.into(), frame_rate).expect_err("just outside").to_string();
        let seconds = f64::from(frame) / f64::from(frame_rate);
        assert!(message.contains(&format!("frame {frame} ({seconds:.2} s)")), "{message}");
    }
    let late = r#"{"anchors": [{"time": 2000, "root": [0, 0, 0]}]}"#;
    assert!(parse(late, 30).is_ok());
    let message = parse(late, 40).expect_err("frame 80000").to_string();
    assert!(message.ends_with("beyond any motion (frame 65535, 1638.375 s)"), "{message}");
    // 8 m in a second, or in a third of one.
    let run = [Anchor::planar_root(30, [0.0, 8.0])];
    assert_eq!(out_of_reach(&run, 30), []);
    assert_eq!(out_of_reach(&run, 90).len(), 1);
}

#[test]
fn content_is_refused_with_index_and_field() {
    const GOOD: &str = r#"{"frame":1,"root":[0,0,0]}"#;
    for (second, parts) in [
        (r#"{"frame":1,"rot":[0,0,0]}"#, &["unknown field \"rot\"", "planar_root"][..]),
        (r#"{"frame":1,"frame":2,"root":[0,0,0]}"#, &["frame is given twice"]),
        (r#"{"root":[0,0,0]}"#, &["no time"]),
        (r#"{"frame":1,"time":1,"root":[0,0,0]}"#, &["both time and frame"]),
        (r#"{"frame":1}"#, &["no target"]),
        (r#"{"frame":1,"root":[0,0,0],"planar_root":[0,0]}"#, &["root, planar_root"]),
        (r#"{"frame":1,"root":[0,0,0],"position":[0,0,0]}"#, &["root, position"]),
        (r#"{"frame":1,"joint":"head"}"#, &["joint needs position"]),
        (r#"{"frame":1,"position":[0,0,0]}"#, &["position needs joint"]),
        (r#"{"frame":1,"joint":"hand","position":[0,0,0]}"#, &["no joint \"hand\"", "left_wrist, right_wrist"]),
        (r#"{"frame":1,"joint":20,"position":[0,0,0]}"#, &["joint must be", "not 20"]),
        (r#"{"frame":1,"root":[0,0]}"#, &["root must be a list of three", "[0,0]"]),
        (r#"{"frame":1,"root":[0,0,null]}"#, &["root must be", "null"]),
        (r#"{"frame":1,"planar_root":[0,0,0]}"#, &["planar_root must be a list of two"]),
        (r#"{"frame":1,"root":[0,1e39,0]}"#, &["root holds 1e39", "finite"]),
        (r#"{"time":-0.5,"root":[0,0,0]}"#, &["time -0.5 lies before"]),
        (r#"{"frame":-2,"root":[0,0,0]}"#, &["frame -2 lies before"]),
        (r#"{"frame":1.5,"root":[0,0,0]}"#, &["frame must be a whole number, not 1.5"]),
        (r#"{"time":"2 s","root":[0,0,0]}"#, &["time must be a number", "2 s"]),
        (r#"{"time":1e9,"root":[0,0,0]}"#, &["time 1000000000 lies beyond any motion"]),
        (r#"{"frame":65536,"root":[0,0,0]}"#, &["frame 65536 lies beyond any motion"]),
    ] {
        let message = refused(&format!("{GOOD}, {second}"));
        assert!(message.starts_with("anchor 1: "), "{message}");
        for part in parts {
            assert!(message.contains(part), "{second}: {message:?} lacks {part:?}");
        }
    }
}

#[test]
fn form_is_refused_with_line_and_column() {
    for (text, place) in [
        ("", (1, 0)),
        ("{\"anchors\": [\n  {\"frame\" 1}\n]}", (2, 12)),
        ("{\"anchors\": [\n  {\"frame\": 1, \"root\": [NaN, 0, 0]}\n]}", (2, 25)),
        ("{\"anchors\": [\n", (2, 0)),
        ("{\"anchors\": [], \"fps\": 30}", (1, 21)),
        ("{\"anchors\": [7]}", (1, 14)),
        ("{\"anchors\": []} x", (1, 17)),
        ("[]", (1, 1)),
        ("\n [[{\"frame\": 1, \"root\": [0, 0, 0]}]]", (2, 2)),
        ("{}", (1, 2)),
    ] {
        match parse(text, 20) {
            Err(Error::Json { line, column, message }) => {
                assert_eq!((line, column), place, "{text:?}: {message}");
                assert!(!message.contains("column"), "{message}");
            }
            other => panic!("{text:?}: {other:?}"),
        }
    }
    let deep = "[".repeat(100_000);
    assert!(matches!(parse(&format!("{{\"anchors\": [{{\"root\": {deep}"), 20), Err(Error::Json { .. })));
}

#[test]
fn a_long_value_is_shortened() {
    let message = refused(&format!("{{\"frame\": 1, \"joint\": \"{}\", \"position\": [0,0,0]}}", "\u{e4}".repeat(500)));
    assert!(message.contains("...") && message.chars().count() < 500, "{message}");
}

#[test]
fn the_motion_s_length_is_said() {
    let anchors = [Anchor::root(0, [0.0; 3]), Anchor::root(100, [0.0; 3])];
    check(&anchors, 101).expect("just inside");
    let message = check(&anchors, 100).expect_err("just outside").to_string();
    assert_eq!(message, "anchor 1: frame 100 (5.00 s) lies beyond the end: the motion has 100 frames (5.00 s)");
    let conflict = [Anchor::root(0, [0.0; 3]), Anchor::planar_root(0, [1.0, 0.0])];
    let message = check(&conflict, 10).expect_err("two places").to_string();
    assert_eq!(message, "anchors 0 and 1: both say where pelvis is at frame 0 (0.00 s), and disagree; remove one");
    let conflict = [anchors[0], Anchor::joint(30, 21, [0.0; 3]), anchors[0], Anchor::joint(30, 21, [0.0, 0.0, 1.0])];
    let found = check(&conflict, 100);
    assert!(
        matches!(
            found,
            Err(Error::Conflict { first: 1, second: 3, joint: Joint::RightWrist, frame: 30, frame_rate: 20 })
        ),
        "{found:?}"
    );
    let many: Vec<Anchor> = (0..33).map(|frame| Anchor::root(frame, [0.0; 3])).collect();
    assert!(matches!(check(&many, 100), Err(Error::Refused(AnchorError::TooMany { anchors: 33, limit: 32 }))));
    check(&[], 0).expect("nothing to meet");
}

#[test]
fn what_is_written_is_read_back_bit_for_bit() {
    let mut anchors =
        vec![Anchor::planar_root(u16::MAX, [-0.0, 1e-30]), Anchor::root(0, [f32::MAX, f32::MIN_POSITIVE, -1.0])];
    let mut x = 0.1f32;
    for joint in 0..22 {
        x *= -1.737_191_5;
        anchors.push(Anchor::joint(u16::from(joint) * 7, joint, [x, 1.0 / x, x * x]));
    }
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("anchors.json");
    write(&path, &anchors).expect("writable");
    let back = read(&path, 20).expect("readable");
    assert_eq!(format!("{back:?}"), format!("{anchors:?}"), "signs of zero included");
    write(&path, &[]).expect("writable");
    assert_eq!(read(&path, 20).expect("readable"), []);
}

#[test]
fn what_the_file_cannot_hold_is_refused_and_nothing_is_left() {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let path = folder.path().join("anchors.json");
    let not_finite = write(&path, &[Anchor::root(0, [0.0; 3]), Anchor::root(1, [0.0, f32::NAN, 0.0])]);
    assert!(matches!(not_finite, Err(Error::NotFinite { index: 1, field: "root", .. })), "{not_finite:?}");
    let joint = write(&path, &[Anchor::joint(0, 22, [0.0; 3])]);
    assert!(matches!(joint, Err(Error::NoSuchJoint { index: 0, joint: 22 })), "{joint:?}");
    assert!(!path.exists());
    let missing = read(&path, 20).expect_err("no such file");
    assert!(matches!(&missing, Error::Read { .. }) && missing.to_string().contains("anchors.json"), "{missing}");
}

#[test]
fn repeated_anchors_count_once() {
    let (a, b) = (Anchor::root(10, [0.0, 0.9, 0.5]), Anchor::joint(30, 21, [0.3, 1.2, 0.9]));
    let many: Vec<Anchor> = [a, b].into_iter().cycle().take(100_000).collect();
    check(&many, 40).expect("two distinct ones");
    assert_eq!(distinct(&many), [a, b]);
    assert_eq!(out_of_reach(&many, 20), []);
    assert_eq!(distinct(&[]), []);
}

#[test]
fn what_a_body_cannot_reach_is_said_with_distance_and_time() {
    // A person who walks, reaches up, turns back, jumps.
    let fine = [
        Anchor::planar_root(40, [0.3, 2.2]),
        Anchor::joint(0, 21, [-0.6, 2.1, 0.3]),
        Anchor::root(99, [1.1, 0.92, 5.4]),
        Anchor::root(139, [0.0, 1.3, 0.0]),
        Anchor::joint(139, 10, [0.0, 0.0, 0.1]),
    ];
    assert_eq!(out_of_reach(&fine, 20), []);
    // Millimetres for metres, and one metre-anchor after it that is blameless.
    let far = [Anchor::root(40, [300.0, 0.9, 400.0]), fine[2], Anchor::joint(60, 15, [0.0, 7.3, 0.0])];
    let found = out_of_reach(&far, 20);
    assert_eq!(found.iter().map(|far| (far.index, far.from)).collect::<Vec<_>>(), [(0, None), (2, None)]);
    // 500 m off, of which 2 s of running are 16 m and 0.5 m are allowed.
    assert!((found[0].beyond - 483.5).abs() < 1e-4 && found[0].seconds == 2.0, "{found:?}");
    assert!((found[1].beyond - 4.0).abs() < 1e-4, "{found:?}");
    let said = found[0].to_string();
    assert!(said.starts_with("anchor 0 lies 483.5 m beyond what a body can reach in 2.00 s from the start"), "{said}");
    // Ten metres in a twentieth of a second, given in any order.
    let leap = [Anchor::root(41, [10.0, 0.9, 0.5]), Anchor::root(40, [0.0, 0.9, 0.5])];
    let [far] = out_of_reach(&leap, 20)[..] else { panic!("one of the two") };
    assert_eq!((far.index, far.from), (0, Some(1)));
    assert!((far.beyond - 9.1).abs() < 1e-4, "{far:?}");
    assert!(far.to_string().contains("in 0.05 s from anchor 1"), "{far}");
}
