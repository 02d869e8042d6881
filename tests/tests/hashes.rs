//! Every bit that a user's motion consists of, written down: restructuring must not change one of them.
//!
//! `fixtures/hashes.txt` holds a hash for the simulator's default job, each of the twin's requests, each method, basis and activity of the
//! refinement, a stream given and a stream planned, and a motion of every committed blob (4-bit weights and residual quantizers among
//! them). A change that is meant to change bits writes the file anew (`MOTIONETTE_BLESS=1 cargo test -p motionette-tests --test hashes`) and
//! its commit says why.

use std::fmt::Write as _;
use std::path::Path;

use motionette::generation::tokens as planning;
use motionette::numerics::hash::Fnv;
use motionette::refining::{Activity, Basis, Config};
use motionette::{Generator, Length, Model, MotionStream, Request, StreamLimits};
use motionette_host::blob::BlobFile;
use motionette_sim::sample_clips::SampleClips;
use motionette_sim::{source, twin};
use motionette_tests::fuzz;

const FIXTURE: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/fixtures/hashes.txt");
/// More than any of the requests takes.
const ARENA_WORDS: usize = (1 << 20) / 16;

/// Lines `name hash`, in the order in which they were made.
#[derive(Default)]
struct Hashes(String);

impl Hashes {
    fn add(&mut self, name: &str, hash: u64) {
        writeln!(self.0, "{name} {hash:016x}").expect("a string takes everything");
    }
}

fn file(path: &Path) -> BlobFile {
    BlobFile::open(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Runs `work` with a generator of `model` in an arena of its own.
fn with_generator<T>(model: &Model<'_>, work: impl FnOnce(&mut Generator<'_>) -> T) -> T {
    let mut words = vec![0u128; ARENA_WORDS];
    let mut generator = Generator::new(model.clone(), bytemuck::cast_slice_mut(&mut words)).expect("floating point");
    work(&mut generator)
}

fn hash(generator: &mut Generator<'_>, request: &Request<'_>, name: &str) -> u64 {
    generator.generate(request, &mut ()).unwrap_or_else(|error| panic!("{name}: {error}")).hash()
}

/// The default job, and its anchors met by every method.
fn refinements(model: &Model<'_>, hashes: &mut Hashes) {
    let job = source::default_job(model.frame_rate()).expect("the build's anchors are right");
    let request = Request::text("a person walks forward").frames(100).seed(1).through(&job.anchors);
    assert_eq!(job.caption, "a person walks forward");
    let mut refined = |name: &str, config: Config| {
        let hash = with_generator(model, |generator| hash(generator, &request.refined(config), name));
        hashes.add(name, hash);
    };
    refined("default-job", Config::DEFAULT);
    refined("fast-feasible", Config { feasibility: 1.0, ..Config::fast(8) });
    refined("fast-without-metric", Config { prior: None, ..Config::fast(8) });
    let bases = [Basis::Plain, Basis::Transport, Basis::Slope, Basis::Affine, Basis::Quadratic, Basis::Cubic];
    for basis in bases {
        refined(&format!("fast-{basis:?}"), Config { basis, ..Config::fast(6) });
        for activity in [Activity::Residual, Activity::Uniform, Activity::Shuffled] {
            refined(&format!("published-{basis:?}-{activity:?}"), Config { basis, activity, ..Config::published(4) });
        }
    }
}

fn twins(model: &Model<'_>, hashes: &mut Hashes) {
    let bundle = SampleClips::built_in().expect("the bundle reads");
    let recorded: Vec<&[u16]> = bundle.clips.iter().map(|clip| clip.tokens.as_slice()).collect();
    with_generator(model, |generator| {
        for index in 0..twin::REQUESTS {
            let digest = twin::run(generator, index, &recorded).unwrap_or_else(|e| panic!("request {index}: {e}"));
            hashes.add(&format!("twin-{index:02}"), twin::combine(&[digest]));
        }
    });
}

/// Hash over all frames that come now.
fn drain(stream: &mut MotionStream<'_, '_>, mut hash: Fnv) -> Fnv {
    while let Some(frames) = stream.frames(&mut ()).expect("nobody interrupts") {
        hash = hash.f32s(frames.as_flattened().as_flattened());
    }
    hash
}

fn streams(model: &Model<'_>, hashes: &mut Hashes) {
    let bundle = SampleClips::built_in().expect("the bundle reads");
    let planning = planning::PlanningLimits { words: 16, steps: 3, guided: true, anchors: false, clauses: 1 };
    with_generator(model, |generator| {
        let limits = StreamLimits { tokens: 24, planning: Some(planning), rows: 8 };
        let mut given = generator.stream(&limits).expect("the arena is large enough");
        let mut hash = Fnv::default();
        for token in bundle.clips.iter().flat_map(|clip| &clip.tokens).take(120) {
            given.push(&[*token]).expect("there is room");
            hash = drain(&mut given, hash);
        }
        given.finish();
        hashes.add("stream-given", drain(&mut given, hash).value());

        let mut planned = generator.stream(&limits).expect("the arena is large enough");
        let mut hash = Fnv::default();
        for (prompt, tokens) in [("a person walks forward", 12), ("a person waves", 9), ("a person bows", 12)] {
            let request = Request::text(prompt).length(Length::Tokens(tokens)).seed(5).steps(3);
            planned.plan(&request, &mut ()).expect("the request is legal");
            hash = drain(&mut planned, hash);
        }
        planned.finish();
        hashes.add("stream-planned", drain(&mut planned, hash).value());
    });
}

/// A motion of each committed blob: from tokens, and from text where it can plan.
fn blobs(hashes: &mut Hashes) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus");
    for (name, _) in fuzz::corpus() {
        let blob = file(&folder.join(format!("{name}.blob")));
        let model = blob.model().expect("opened before");
        let numbers = model.max_tokens() * model.codebooks().quantizers();
        let codes = model.codebooks().codes();
        let tokens: Vec<u16> = (0..numbers).map(|i| (7 * i % codes) as u16).collect();
        with_generator(&model, |generator| {
            hashes.add(&format!("blob-{name}"), hash(generator, &Request::tokens(&tokens), name));
            let Some(modules) = model.planning() else { return };
            let prompt = if modules.text.encoder().is_some() { Request::text("wave") } else { Request::bank("wave") };
            let request = prompt.length(Length::Tokens(5)).seed(3);
            hashes.add(&format!("blob-{name}-planned"), hash(generator, &request, name));
        });
    }
}

#[test]
fn no_bit_of_a_motion_has_changed() {
    let blob = file(Path::new(concat!(env!("CARGO_MANIFEST_DIR"), "/../models/nano.blob")));
    let model = blob.model().expect("opened before");
    let mut hashes = Hashes::default();
    refinements(&model, &mut hashes);
    twins(&model, &mut hashes);
    streams(&model, &mut hashes);
    blobs(&mut hashes);
    if std::env::var_os("MOTIONETTE_BLESS").is_some() {
        std::fs::write(FIXTURE, &hashes.0).expect("the fixture can be written");
    }
    let expected = std::fs::read_to_string(FIXTURE).expect("the fixture reads");
    let changed: Vec<String> = expected
        .lines()
        .zip(hashes.0.lines())
        .filter(|(expected, found)| expected != found)
        .map(|(expected, found)| format!("{expected} is now {found}"))
        .collect();
    assert!(changed.is_empty(), "bits have changed:\n{}", changed.join("\n"));
    assert_eq!(expected.lines().count(), hashes.0.lines().count(), "hashes that are missing, or new");
}
