//! Requests under conditions, from bytes on a line to the motion: server, device's state and the thread that makes motions.

mod common;

use std::collections::VecDeque;

use common::host::{HELLO, SILENCE, replies};
use common::{Flash, Line, crc, sent};
use motionette::playback::{Handles, MotionQueue, Robot};
use motionette::{
    BodyParts, Generator, Joint, LEAST_SPAN, Model, Motion, Obstacle, Prompt, Request, Shape, Source, Span, Track,
};
use motionette_link::conditions::Given;
use motionette_link::frame::encode;
use motionette_link::message::{
    Clearance, Command, ConditionsFault, Event, Failure, Generate, Header, Length, ObstacleFault, PromptFault,
    REQUEST_FRAME, Refinement, Refusal, Reply, TimelineFault, TrackFault, Tracking,
};
use motionette_link::server::Port;
use motionette_link::thread::{self, JobHost, Note};
use motionette_link::{Device, DeviceState, Preset, Server, SharedFlags, Store};

#[repr(C, align(16))]
struct Aligned<T: ?Sized>(T);

static SHIPPED: &Aligned<[u8]> = &Aligned(*include_bytes!("../../models/nano.blob"));
static VECTORS: &Aligned<[u8]> = &Aligned(*include_bytes!("../../tests/corpus/masked.blob"));
const ROBOT: &[u8] = include_bytes!("../../firmware-sim/boards/pico2/robot.bin");
const AREA: usize = 8192;

/// A device in one thread: what its host says comes whenever it has nothing to do.
struct Jobs {
    state: DeviceState<'static, Flash>,
    server: Server,
    port: Port,
    script: VecDeque<Command>,
    said: Vec<Reply>,
    id: u32,
}

impl JobHost for Jobs {
    type Storage = Flash;

    fn with<R>(&mut self, work: impl FnOnce(&mut DeviceState<'_, Flash>) -> R) -> R {
        work(&mut self.state)
    }

    fn wait(&mut self) {
        let mut line = Line::default();
        self.server.poll(0, &mut self.state, &mut line);
        match self.script.pop_front() {
            Some(command) => {
                self.id += 1;
                let mut buffer = [0; REQUEST_FRAME];
                let frame = encode(&(Header::new(5, self.id), command), &mut buffer).unwrap();
                self.server.receive(&mut self.port, 0, frame, &mut self.state, &mut line);
            }
            // The thread ends.
            None => self.state.activated(&Store::EMPTY),
        }
        self.said.extend(replies(&line.0).into_iter().map(|(_, reply)| reply));
    }

    fn note(&mut self, _: Note) {}
}

/// What a device with `words` of memory for conditions says to a host's requests, chunks of conditions left out.
fn said(blob: &[u8], words: usize, script: Vec<Command>) -> Vec<Reply> {
    let robot: &'static Robot = Box::leak(Box::new(Robot::open(ROBOT).unwrap()));
    let line: &'static mut MotionQueue<32, 256> = Box::leak(Box::default());
    let flags: &'static SharedFlags = Box::leak(Box::default());
    let Handles { mut feeder, control, .. } = line.split(robot).unwrap();
    let mut state = DeviceState::new("robot", Preset::DESKTOP, control, flags, Some(Flash::default()), &Store::EMPTY);
    if words > 0 {
        state = state.with_area(Box::leak(vec![0xA5A5_A5A5; words].into_boxed_slice()));
    }
    let mut server = Server::new(Store::EMPTY, SILENCE);
    let port = server.port();
    let script = std::iter::once(HELLO).chain(script).collect();
    let mut jobs = Jobs { state, server, port, script, said: Vec::new(), id: 0 };
    let mut arena = vec![0u128; 40_000];
    let model = Model::open(blob).unwrap();
    thread::run(&model, bytemuck::cast_slice_mut(&mut arena), &mut feeder, &mut jobs).unwrap();
    jobs.said.into_iter().filter(|reply| !matches!(reply, Reply::Chunk { .. })).collect()
}

fn stage(given: &Given<'_>) -> impl Iterator<Item = Command> + use<> {
    let bytes = sent(given);
    let begin = Command::ConditionsBegin { length: bytes.len() as u32, crc32: crc(&bytes) };
    let chunks: Vec<Command> = bytes
        .chunks(240)
        .enumerate()
        .map(|(i, c)| Command::ConditionsChunk { offset: 240 * i as u32, bytes: c.iter().copied().collect() })
        .collect();
    std::iter::once(begin).chain(chunks)
}

fn wave() -> Generate {
    let text = "a person waves the right hand".try_into().unwrap();
    Generate { length: Length::Frames(40), seed: 3, conditions: true, ..Generate::new(text) }
}

/// The same motion made without a link.
fn directly<R>(blob: &[u8], request: &Request<'_>, look: impl FnOnce(&Motion<'_>) -> R) -> R {
    let mut arena = vec![0u128; 40_000];
    let mut generator = Generator::new(Model::open(blob).unwrap(), bytemuck::cast_slice_mut(&mut arena)).unwrap();
    look(&generator.generate(request, &mut ()).unwrap())
}

fn failed(job: u32, why: Failure) -> Reply {
    Reply::Event(Event::Failed { job, why })
}

#[test]
fn a_motion_under_conditions_is_that_of_a_desktop() {
    let path: Vec<[f32; 3]> = (0..30).map(|i| [-0.3, 1.1 + 0.01 * i as f32, 0.35]).collect();
    let tracks = [Track::new(Joint::RightWrist, 5, &path).within(0.01)];
    let obstacles = [Obstacle::new(Shape::Sphere { radius: 0.2 }, [0.45, 1.1, 0.2])];
    let given = Given { tracks: &tracks, obstacles: &obstacles, ..Given::default() };
    let plain = Generate { conditions: false, ..wave() };
    let script = stage(&given).chain([
        Command::Generate(wave()),
        Command::Generate(plain),
        // They are still there.
        Command::Generate(Generate { seed: 4, ..wave() }),
        Command::Close,
        Command::Generate(wave()),
    ]);
    let said = said(&SHIPPED.0, AREA / 4, script.collect());
    let Reply::Hello(hello) = &said[0] else { panic!() };
    assert_eq!(hello.limits.condition_bytes as usize, AREA);
    let mut results = Vec::new();
    for reply in &said {
        if let Reply::Event(Event::Ready { tracking, clearance, .. }) = reply {
            results.push((*tracking, *clearance));
        }
    }
    let expected = |seed, given: &Given<'_>| {
        let request = wave();
        let request = Generate { seed, ..request };
        let request = request.request(&[]).steps(Preset::DESKTOP.steps);
        let request = request.tracks(given.tracks).obstacles(given.obstacles);
        directly(&SHIPPED.0, &request, |motion| (Tracking::of(motion), Clearance::of(motion)))
    };
    let (first, again) = (expected(3, &given), expected(4, &given));
    assert_eq!(results, [first, (None, None), again]);
    assert!(first.0.is_some_and(|it| it.mean < 0.05) && first.1.is_some() && first != again, "{first:?}");
    assert_eq!(said[said.len() - 2..], [Reply::Accepted, Reply::Refused(Refusal::Session)]);
}

/// The same with parts of the body that do something else, which shows in how near the figure comes to something far away.
#[test]
fn a_timeline_moves_what_it_moves_on_a_desktop() {
    let timeline = [
        Span::new(BodyParts::LEFT_ARM, 0, 24, "a person punches with the left hand"),
        Span::new(BodyParts::HEAD.and(BodyParts::RIGHT_ARM), 8, 32, "a person claps"),
    ];
    let obstacles = [Obstacle::new(Shape::Sphere { radius: 0.1 }, [3.0, 1.2, 0.3])];
    let plain = Given { obstacles: &obstacles, ..Given::default() };
    let given = Given { timeline: &timeline, ..plain };
    let script = [&given, &plain].map(|given| stage(given).chain([Command::Generate(wave())]).collect::<Vec<_>>());
    let said = said(&SHIPPED.0, AREA / 4, script.concat());
    let results: Vec<_> = said
        .iter()
        .filter_map(|reply| match reply {
            Reply::Event(Event::Ready { frames, clearance, .. }) => Some((usize::from(*frames), *clearance)),
            _ => None,
        })
        .collect();
    let expected = [&given, &plain].map(|given| {
        let request = wave();
        let request = request.request(&[]).steps(Preset::DESKTOP.steps);
        let request = request.obstacles(given.obstacles).timeline(given.timeline);
        directly(&SHIPPED.0, &request, |motion| (motion.frames().len(), Clearance::of(motion)))
    });
    assert_eq!(results, expected);
    assert_ne!(expected[0], expected[1]);
}

#[test]
fn what_the_runtime_refuses_arrives_with_its_indices() {
    let still = [[0.0, 1.0, 0.0]; 10];
    let good = Track::new(Joint::Head, 0, &still);
    let given = |tracks| Given { tracks, ..Given::default() };
    let job = |given: &Given<'_>| stage(given).chain([Command::Generate(wave())]).collect::<Vec<_>>();
    let fast = Obstacle::new(Shape::Sphere { radius: 0.2 }, [9.0; 3]).margin(1.5);
    let arm = Span::new(BodyParts::LEFT_ARM, 0, 20, "a person waves");
    let no_edit = Command::Generate(Generate { refinement: Refinement::FAST, evaluations: 2, ..wave() });
    let script = [
        job(&given(&[good, Track { joint: 22, ..good }])),
        job(&given(&[good, Track { first: 35, ..good }])),
        job(&Given { obstacles: &[fast], ..Given::default() }),
        job(&Given { timeline: &[arm, Span { frames: 7, ..arm }], ..Given::default() }),
        job(&Given { timeline: &[Span { first: 30, ..arm }], ..Given::default() }),
        job(&Given { timeline: &[arm, arm], ..Given::default() }),
        job(&Given { timeline: &[arm, Span { prompt: Prompt::Text("zorb"), first: 20, ..arm }], ..Given::default() }),
        job(&Given { timeline: &[Span { prompt: Prompt::Bank("zorb"), ..arm }], ..Given::default() }),
        // A model that reads words; a refinement that edits nothing.
        job(&Given { vector: Some(&[1.0, 0.5]), ..Given::default() }),
        stage(&given(&[good])).chain([no_edit]).collect(),
        // A stop takes nothing away.
        vec![Command::Stop, Command::Generate(Generate { conditions: true, ..wave() })],
    ];
    let said = said(&SHIPPED.0, AREA / 4, script.concat());
    let failures: Vec<Failure> = said
        .iter()
        .filter_map(|reply| match reply {
            Reply::Event(Event::Failed { why, .. }) => Some(*why),
            _ => None,
        })
        .collect();
    let Failure::Timeline(TimelineFault::Prompt { error: not_stored @ PromptFault::NotStored { .. }, .. }) =
        failures[7]
    else {
        panic!("{failures:?}");
    };
    let expected = [
        Failure::Tracks(TrackFault::JointOutOfRange { index: 1, joint: 22, joints: 22 }),
        Failure::Tracks(TrackFault::FrameOutOfRange { index: 1, frame: 44, frames: 40 }),
        Failure::Obstacles(ObstacleFault::Margin { index: 0, margin: 1.5 }),
        Failure::Timeline(TimelineFault::TooShort { index: 1, frames: 7 }),
        Failure::Timeline(TimelineFault::OutOfRange { index: 0, end: 50, frames: 40 }),
        Failure::Timeline(TimelineFault::Overlap { first: 0, second: 1, parts: 2 }),
        Failure::Timeline(TimelineFault::Prompt { index: 1, error: PromptFault::OnlyUnknownWords { words: 1 } }),
        Failure::Timeline(TimelineFault::Prompt { index: 0, error: not_stored }),
        Failure::Prompt(PromptFault::NoVectors),
        Failure::Tracks(TrackFault::NotExact),
    ];
    assert_eq!(failures, expected);
    assert!(matches!(said.last(), Some(Reply::Event(Event::Ready { tracking: Some(_), .. }))), "{said:?}");
}

/// A model whose prompts are vectors: the one that was staged counts, whatever the text says.
#[test]
fn a_prompt_may_be_a_vector() {
    let model = Model::open(&VECTORS.0).unwrap();
    // Too short a one is refused with the width that there must be.
    let short = stage(&Given { vector: Some(&[1.0]), ..Given::default() });
    let told = said(&VECTORS.0, AREA / 4, short.chain([Command::Generate(wave())]).collect());
    let short = |width| Failure::Prompt(PromptFault::VectorWidth { found: 1, width });
    let Some(Reply::Event(Event::Failed { job, why: Failure::Prompt(PromptFault::VectorWidth { found: 1, width }) })) =
        told.last()
    else {
        panic!("{told:?}");
    };
    assert_eq!(told[told.len() - 2..], [Reply::Accepted, failed(*job, short(*width))]);
    let vector: Vec<f32> = (0..*width).map(|i| 0.25 * (i as f32 - 3.0)).collect();
    let frames = 2 * model.frames_per_token() as u16;
    let request = Generate { length: Length::Frames(frames), ..wave() };
    let staged = stage(&Given { vector: Some(&vector), ..Given::default() });
    let words = Generate { conditions: false, ..request.clone() };
    let script = staged.chain([Command::Generate(request.clone()), Command::Generate(words)]);
    let told = said(&VECTORS.0, AREA / 4, script.collect());
    let made = directly(
        &VECTORS.0,
        &Request { source: Source::Text(Prompt::Vector(&vector)), ..request.request(&[]) },
        |motion| motion.frames().len(),
    );
    let ready = told.iter().any(
        |reply| matches!(reply, Reply::Event(Event::Ready { frames, understood: None, .. }) if usize::from(*frames) == made),
    );
    assert!(ready, "{told:?}");
    let Some(Reply::Event(Event::Failed {
        why: Failure::Prompt(PromptFault::Vectors { width: of_model, .. }), ..
    })) = told.last()
    else {
        panic!("{told:?}");
    };
    assert_eq!(of_model, width);
    // Vectors of spans likewise.
    let arm = |prompt| Span { prompt, ..Span::new(BodyParts::LEFT_ARM, 0, LEAST_SPAN, "") };
    let request = Generate { length: Length::Frames(LEAST_SPAN), ..request };
    let spans = [arm(Prompt::Vector(&vector))];
    let narrow = [arm(Prompt::Vector(&vector[..1]))];
    let script = [&spans, &narrow].map(|timeline| {
        let given = Given { vector: Some(&vector), timeline, ..Given::default() };
        stage(&given).chain([Command::Generate(request.clone())]).collect::<Vec<_>>()
    });
    let told = said(&VECTORS.0, AREA / 4, script.concat());
    assert!(told.iter().any(|reply| matches!(reply, Reply::Event(Event::Ready { .. }))), "{told:?}");
    let error = PromptFault::VectorWidth { found: 1, width: *width };
    let Some(Reply::Event(Event::Failed { why, .. })) = told.last() else { panic!("{told:?}") };
    assert_eq!(*why, Failure::Timeline(TimelineFault::Prompt { index: 0, error }));
}

#[test]
fn a_device_without_memory_for_conditions_says_so() {
    let begin = Command::ConditionsBegin { length: 12, crc32: 0 };
    let plain = Generate { conditions: false, ..wave() };
    let said = said(&SHIPPED.0, 0, vec![begin, Command::Generate(wave()), Command::Generate(plain)]);
    let Reply::Hello(hello) = &said[0] else { panic!() };
    assert_eq!(hello.limits.condition_bytes, 0);
    let refused = Reply::Refused(Refusal::Conditions(ConditionsFault::NoArea));
    assert_eq!(said[1..4], [refused.clone(), refused, Reply::Accepted]);
    assert!(matches!(said[4], Reply::Event(Event::Ready { tracking: None, clearance: None, .. })));
}

/// A job that is stopped before the thread has seen it gives its conditions back.
#[test]
fn a_stop_before_the_thread_has_seen_the_job() {
    let flags: &'static SharedFlags = Box::leak(Box::default());
    let robot: &'static Robot = Box::leak(Box::new(Robot::open(ROBOT).unwrap()));
    let line: &'static mut MotionQueue<32, 256> = Box::leak(Box::default());
    let Handles { control, .. } = line.split(robot).unwrap();
    let area = Box::leak(vec![0u32; AREA / 4].into_boxed_slice());
    let state = DeviceState::new("robot", Preset::DESKTOP, control, flags, None::<Flash>, &Store::EMPTY);
    let mut state = state.with_area(area);
    state.opened(&Model::open(&SHIPPED.0).unwrap());
    for _ in 0..2 {
        assert_eq!(state.area().map(|area| area.len()), Some(AREA / 4));
        state.start(1, motionette_link::server::Job::Generate(&wave())).unwrap();
        assert_eq!(state.area(), None);
        assert_eq!(state.describe().condition_bytes as usize, AREA);
        state.stop();
        assert_eq!(state.event(), Some(Event::Failed { job: 1, why: Failure::Aborted }));
    }
}
