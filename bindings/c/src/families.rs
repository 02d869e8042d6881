//! What a library says that was built without a family. Each build has one answer: `cargo xtask c` runs this with several.

use motionette::refining::Config;
use motionette::{Anchors, BodyParts, Error, Generator, Joint, Model, Obstacle, Request, Shape, Span, Track, blob};
use std::{fs, vec};

/// The bundled model opened by the runtime itself, and what requests of it get: edited through an anchor, with bent tokens, along a track,
/// around an obstacle, with an arm that does something else.
fn opened_and_bent() -> Result<[Result<(), Error>; 5], blob::Error> {
    let bytes = fs::read(concat!(env!("CARGO_MANIFEST_DIR"), "/../../models/nano.blob")).unwrap();
    let mut memory = vec![0u128; bytes.len().div_ceil(16)];
    // SAFETY: 16 bytes a block, and any bits are numbers.
    let room = unsafe { core::slice::from_raw_parts_mut(memory.as_mut_ptr().cast::<u8>(), 16 * memory.len()) };
    room[..bytes.len()].copy_from_slice(&bytes);
    let model = Model::open(&room[..bytes.len()])?;
    let anchors = Anchors::new().root_at(0.5, [0.0, 0.9, 0.2]);
    let mut arena = vec![0u8; 1 << 20];
    let mut generator = Generator::new(model, &mut arena).unwrap();
    let edited = Request::tokens(&[117, 204, 407]).through(&anchors);
    let (bent, given) = (edited.refined(Config::fast(2)), Request::tokens(&[117, 204, 407]));
    let (path, ball) = ([[0.0, 0.9, 0.1]; 4], Obstacle::new(Shape::Sphere { radius: 0.2 }, [0.0, 1.0, 3.0]));
    let (tracks, obstacles) = ([Track::new(Joint::Pelvis, 4, &path)], [ball]);
    let spans = [Span::new(BodyParts::LEFT_ARM, 0, 8, "a person waves")];
    let requests = [edited, bent, given.tracks(&tracks), given.obstacles(&obstacles), given.timeline(&spans)];
    Ok(requests.map(|request| generator.generate(&request, &mut ()).map(drop)))
}

/// The first family that the bundled model needs and this build has not.
const MISSING: Option<&str> = if !cfg!(feature = "vq") {
    Some("vq")
} else if !cfg!(feature = "tmd") {
    Some("tmd")
} else if !cfg!(feature = "anchor-control") {
    Some("anchor-control")
} else if !cfg!(feature = "text") {
    Some("text")
} else {
    None
};

#[test]
fn what_is_not_linked_is_named() {
    match (opened_and_bent(), MISSING) {
        (Err(blob::Error::NotLinked { feature }), Some(missing)) => assert_eq!(feature, missing),
        (Ok(answers), None) => {
            let answer = |linked: bool, feature| if linked { Ok(()) } else { Err(Error::NotLinked { feature }) };
            let refining = cfg!(feature = "refining");
            let tracks = cfg!(feature = "tracks");
            let timeline = cfg!(feature = "timeline");
            let editing = cfg!(feature = "editing") || refining || tracks || timeline;
            assert_eq!(answers[0], answer(editing, "editing"));
            assert_eq!(answers[1], if editing { answer(refining, "refining") } else { answer(false, "editing") });
            assert_eq!(answers[2], answer(tracks, "tracks"));
            let obstacles = cfg!(feature = "obstacles");
            assert_eq!(answers[3], if tracks { answer(obstacles, "obstacles") } else { answer(false, "tracks") });
            assert_eq!(answers[4], answer(timeline, "timeline"));
        }
        (found, missing) => panic!("{found:?}, the missing family is {missing:?}"),
    }
}
