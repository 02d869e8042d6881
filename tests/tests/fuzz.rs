//! The fuzzer itself: its corpus is small and valid, its cases reach both outcomes of every reader, and it notices a panic.

use std::path::Path;

use motionette::{Generator, Model, Request};
use motionette_tests::fuzz::{self, Failure, MAX_BLOB, MAX_CONTROLLED_BLOB};

/// Blobs of format version 4 as they were written when it was fixed: today's reader must still open them.
#[test]
fn committed_blobs_still_open_and_move() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus");
    let mut arena = vec![0u8; 1 << 20];
    for (name, tiny) in fuzz::corpus() {
        let limit = if tiny.control.is_some() { MAX_CONTROLLED_BLOB } else { MAX_BLOB };
        assert!(tiny.bytes().len() <= limit, "{name}: {} bytes", tiny.bytes().len());
        let bytes = std::fs::read(folder.join(format!("{name}.blob"))).unwrap_or_else(|error| {
            panic!("{name}.blob: {error}; write it with `cargo run -p motionette-tests --bin fuzz -- --write-corpus tests/corpus`")
        });
        assert!(bytes.len() <= limit, "{name}.blob: {} bytes", bytes.len());
        let mut words = vec![0u128; bytes.len().div_ceil(16)];
        bytemuck::cast_slice_mut::<u128, u8>(&mut words)[..bytes.len()].copy_from_slice(&bytes);
        let model = Model::open(&bytemuck::cast_slice::<u128, u8>(&words)[..bytes.len()]);
        let mut generator = Generator::new(model.expect(name), &mut arena).expect("default floating point");
        let tokens = vec![0; generator.model().codebooks().quantizers()];
        let motion = generator.generate(&Request::tokens(&tokens), &mut ()).expect(name);
        assert_eq!(motion.frames().len(), generator_frames(&tiny), "{name}");
        assert!(motion.joints().iter().all(|v| v.is_finite()), "{name}");
    }
}

fn generator_frames(tiny: &motionette_tests::tiny::Tiny) -> usize {
    1 << tiny.shape.stages
}

#[test]
fn cases_reach_both_outcomes_of_every_reader() {
    let tally = fuzz::run(2, 0, 3000, 2, |_| {}).unwrap_or_else(|f| panic!("case {} of seed 2: {}", f.case, f.what));
    assert_eq!(tally.cases, 3000);
    let counts = [
        tally.blobs_refused,
        tally.blobs_opened,
        tally.requests_refused,
        tally.motions,
        tally.streams,
        tally.files_refused,
        tally.files_read,
    ];
    assert!(
        counts.iter().all(|&count| count > 10) && tally.conditioned > 3 && tally.led > 3 && tally.parted > 3,
        "{tally:?}"
    );
    assert_eq!(
        fuzz::run(2, 0, 3000, 1, |_| {}),
        Ok(tally),
        "the same seed gives the same cases on any number of threads"
    );
}

#[test]
fn a_panic_is_a_failure_of_its_case() {
    let list: Vec<u64> = (0..7).collect();
    let one = |case: u64| if list[case as usize] < 9 { Ok(()) } else { Err("large".to_owned()) };
    let drive = |first, cases, threads, one: &(dyn Fn(u64) -> Result<(), String> + Sync)| {
        fuzz::drive(first, cases, threads, |_| {}, || (), |(), case| one(case)).map(|threads| threads.len())
    };
    let failure = drive(3, 100, 1, &one).unwrap_err();
    assert_eq!(failure.case, 7);
    assert!(failure.what.starts_with("panicked: index out of bounds"), "{}", failure.what);
    let every = |case| if case % 300 == 299 { Err(format!("wrong {case}")) } else { Ok(()) };
    for threads in [1, 2, 5] {
        assert_eq!(drive(0, 250, threads, &every), Ok(threads));
        assert_eq!(drive(300, 2000, threads, &every), Err(Failure { case: 599, what: "wrong 599".to_owned() }));
    }
}
