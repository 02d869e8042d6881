//! The client of the device link against a server with a robot of no body, over lines that lose, repeat, damage and swap.

#[path = "../../link/tests/common/mod.rs"]
mod robot;

use std::collections::VecDeque;
use std::io::{self, ErrorKind, Read, Write};
use std::ops::ControlFlow;
use std::time::Duration;

use motionette::{BodyParts, Joint, Obstacle, Shape, Span, Track};
use motionette_host::device::{Client, Error, Options, Transport};
use motionette_link::conditions::{Given, Unfit};
use motionette_link::frame::encode;
use motionette_link::message::{
    Anchor, Clearance, Command, ConditionsFault, Event, FROM_DEVICE, Failure, Generate, Header, LossAction, Measure,
    PROTOCOL, REPLY_FRAME, Refusal, Reply, Start, StartFault, State, Status, Strain, Target, Tracking, UpdateFault,
};
use motionette_link::server::{Port, Server, Silence};
use motionette_link::update::Store;
use robot::{BLOB, CONDITION_BYTES, Line, OTHER, Random, Raw, Robot, ready_under};

const SILENCE: Silence = Silence { after_ms: 60_000, action: LossAction::Finish };
/// Time is simulated: only a bug makes anybody wait.
const OPTIONS: Options = Options {
    wait: Duration::from_secs(100),
    commit_wait: Duration::from_secs(100),
    attempts: 60,
    poll: Duration::from_secs(100),
    take_over: false,
};

/// Sees and wants nothing.
fn watch(_: &Status) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

/// Both directions of a line and the device at its end. A read without bytes lets time pass.
struct Wire {
    server: Server,
    port: Port,
    robot: Robot,
    now: u64,
    to_host: VecDeque<u8>,
    /// Pieces that are held back, towards the device and towards the host.
    held: [Option<Vec<u8>>; 2],
    random: Random,
    /// One piece in so many suffers each kind of fault; 0: none.
    rarity: usize,
    /// Faults that happened.
    faults: usize,
    /// The device starts anew at this request.
    reset_at: Option<usize>,
    writes: usize,
}

impl Wire {
    fn new(rarity: usize, seed: u64) -> Self {
        let robot = Robot::default();
        let mut server = Server::new(Store::open(&robot.flash), SILENCE);
        let port = server.port();
        let (held, random) = ([None, None], Random::new(seed));
        let to_host = VecDeque::new();
        Wire { server, port, robot, now: 0, to_host, held, random, rarity, faults: 0, reset_at: None, writes: 0 }
    }

    /// What becomes of a piece of bytes on its way.
    fn suffer(&mut self, piece: &[u8], direction: usize) -> Vec<u8> {
        let mut result = piece.to_vec();
        if self.rarity > 0 && !piece.is_empty() {
            let fault = self.random.below(6 * self.rarity);
            self.faults += usize::from(fault < 6);
            let at = self.random.below(piece.len());
            match fault {
                0 => result.clear(),
                1 => result.extend(piece),
                2 => result[at] ^= 1 << self.random.below(8),
                3 => drop(result.drain(..at)),
                4 => {
                    let count = self.random.below(50);
                    let garbage = self.random.bytes(count);
                    result.splice(0..0, garbage);
                }
                5 => return self.held[direction].replace(result).unwrap_or_default(),
                _ => {}
            }
        }
        result.extend(self.held[direction].take().unwrap_or_default());
        result
    }

    fn tell_host(&mut self, bytes: &[u8]) {
        for piece in bytes.chunks(37) {
            let piece = self.suffer(piece, 1);
            self.to_host.extend(piece);
        }
    }
}

impl Write for &mut Wire {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.writes += 1;
        if self.reset_at == Some(self.writes) {
            self.server = Server::new(Store::open(&self.robot.flash), SILENCE);
            self.port = self.server.port();
        }
        let count = bytes.len().min(60);
        let piece = self.suffer(&bytes[..count], 0);
        let mut line = Line::default();
        self.server.receive(&mut self.port, self.now, &piece, &mut self.robot, &mut line);
        self.tell_host(&line.0);
        Ok(count)
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Read for &mut Wire {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.to_host.is_empty() {
            self.now += 100;
            self.robot.advance();
            let mut line = Line::default();
            let (now, robot) = (self.now, &mut self.robot);
            self.server.poll(now, robot, &mut line);
            self.tell_host(&line.0);
        }
        if self.to_host.is_empty() {
            return Err(ErrorKind::TimedOut.into());
        }
        self.to_host.read(buffer)
    }
}

impl Transport for &mut Wire {
    fn set_timeout(&mut self, timeout: Duration) -> io::Result<()> {
        assert!(!timeout.is_zero());
        Ok(())
    }
}

fn request(play_when_ready: bool) -> Generate {
    let anchor = Anchor { frame: 1, target: Target::PlanarRoot([0.5, 0.5]) };
    let anchors = [anchor].into_iter().collect();
    Generate { anchors, play_when_ready, ..Generate::new("a person bows".try_into().unwrap()) }
}

#[test]
fn a_whole_session_on_a_good_line() {
    let mut wire = Wire::new(0, 1);
    let (mut client, hello) = Client::connect(&mut wire, OPTIONS).unwrap();
    assert_eq!((hello.preset.as_str(), hello.blob), ("table-top", None));
    let mut stages = Vec::new();
    let made = client.generate(&request(false), &mut |status| {
        stages.extend(status.device.work);
        ControlFlow::Continue(())
    });
    let made = made.unwrap();
    assert_eq!((made.frames, made.control_error), (3, Some(0.25)));
    assert_eq!(made.understood.map(|it| (it.phrase.to_string(), it.score)), Some(("person bows".into(), 0.5)));
    assert_eq!(made.strain, Some(Strain { measure: Measure::DISTANCE, value: 0.75, anchor: 2 }));
    assert!(!stages.is_empty() && stages.iter().all(|work| work.job == 2), "{stages:?}");
    client.tell(&Command::Play).unwrap();
    assert_eq!(client.wait_for_motion(&mut watch).unwrap(), State::Holding);
    assert_eq!(client.self_test().unwrap(), Some(true));
    let mut arrived = Vec::new();
    let (blob, sent) = client.update(&hello, BLOB, &mut |next| arrived.push(next)).unwrap();
    assert_eq!((blob.slot, blob.length as usize, sent), (0, BLOB.len(), true));
    assert!(arrived.is_sorted() && arrived.last() == Some(&blob.length));
    assert_eq!(client.repeated(), 0);

    client.close();
    let (mut client, hello) = Client::connect(&mut wire, OPTIONS).unwrap();
    assert_eq!(client.update(&hello, BLOB, &mut |_| panic!("nothing to send")).unwrap(), (blob, false));
    let limit = hello.limits.blob_bytes;
    let too_long = vec![0; limit as usize + 1];
    match client.update(&hello, &too_long, &mut |_| {}) {
        Err(Error::Refused(Refusal::Update(UpdateFault::Length { length, limit: most }))) => {
            assert_eq!((length, most), (limit + 1, limit));
        }
        other => panic!("{other:?}"),
    }
}

/// Two tracks of half of the robot's memory, an obstacle, a span and a vector.
fn under<R>(use_them: impl FnOnce(&Given<'_>) -> R) -> R {
    let path = vec![[0.25, 1.0, -0.5]; CONDITION_BYTES / 48];
    let tracks = [Track::new(Joint::RightWrist, 3, &path), Track::new(Joint::Pelvis, 0, &path).within(0.02)];
    let obstacles = [Obstacle::new(Shape::Sphere { radius: 0.5 }, [0.0; 3])];
    let timeline = [Span::new(BodyParts::LEFT_ARM, 0, 40, "a person waves")];
    use_them(&Given { tracks: &tracks, obstacles: &obstacles, timeline: &timeline, vector: Some(&[0.5; 64]) })
}

#[test]
fn conditions_on_good_and_bad_lines() {
    let Event::Ready { tracking, clearance, .. } = ready_under(1, true, [2, 1, 1, 64]) else { panic!() };
    assert!(matches!((tracking, clearance), (Some(Tracking { .. }), Some(Clearance { .. }))));
    for seed in 0..60 {
        let mut wire = Wire::new([0, 30, 8, 4][seed as usize % 4], seed);
        let (mut client, hello) = Client::connect(&mut wire, OPTIONS).unwrap_or_else(|e| panic!("seed {seed}: {e}"));
        assert_eq!(client.stage(&hello, &Given::default(), &mut |_| panic!("nothing to send")).ok(), Some(false));
        let mut arrived = Vec::new();
        let staged = under(|given| client.stage(&hello, given, &mut |next| arrived.push(next)));
        assert!(staged.unwrap_or_else(|e| panic!("seed {seed}: {e}")), "seed {seed}");
        assert!(arrived.is_sorted() && arrived.len() > 10, "seed {seed}: {arrived:?}");
        // The same conditions for two requests, and none for a third.
        for conditions in [true, true, false] {
            let request = Generate { conditions, ..request(false) };
            let made = client.generate(&request, &mut watch).unwrap_or_else(|e| panic!("seed {seed}: {e}"));
            assert_eq!(made.tracking, tracking.filter(|_| conditions), "seed {seed}");
            assert_eq!(made.clearance, clearance.filter(|_| conditions), "seed {seed}");
        }
        assert_eq!(wire.robot.jobs.len(), 3, "seed {seed}");
    }
}

#[test]
fn conditions_that_cannot_be_sent() {
    let mut wire = Wire::new(0, 1);
    wire.robot.area.truncate(256);
    let (mut client, mut hello) = Client::connect(&mut wire, OPTIONS).unwrap();
    let refused = |error: Error| {
        assert!(error.hint().is_some(), "{error}");
        match error {
            Error::Refused(Refusal::Conditions(fault)) => fault,
            other => panic!("{other:?}"),
        }
    };
    let length = under(|given| given.bytes().unwrap());
    let too_long = under(|given| client.stage(&hello, given, &mut |_| {})).unwrap_err();
    assert_eq!(refused(too_long), ConditionsFault::Length { length, limit: 1024 });
    hello.limits.condition_bytes = 0;
    let none = under(|given| client.stage(&hello, given, &mut |_| {})).unwrap_err();
    assert_eq!(refused(none), ConditionsFault::NoArea);
    // The device says the same of what it was sent all the same.
    hello.limits.condition_bytes = u32::MAX;
    let too_long = under(|given| client.stage(&hello, given, &mut |_| {})).unwrap_err();
    assert_eq!(refused(too_long), ConditionsFault::Length { length, limit: 1024 });
    let given = Given { vector: Some(&[]), ..Given::default() };
    let unfit = client.stage(&hello, &given, &mut |_| {}).unwrap_err();
    assert!(matches!(unfit, Error::Unfit(Unfit::Vector { found: 0, .. })) && unfit.to_string().contains("0 numbers"));
    // None were sent.
    let request = Generate { conditions: true, ..request(false) };
    let none = client.generate(&request, &mut watch);
    assert!(matches!(none, Err(Error::Refused(Refusal::Conditions(ConditionsFault::NotSent)))), "{none:?}");
    assert_eq!(wire.robot.calls, [""; 0]);
}

/// Everything arrives, and everything is done once, however bad the line is.
#[test]
fn a_whole_session_on_bad_lines() {
    let (mut faults, mut repeated) = (0, 0);
    for seed in 0..150 {
        let mut late = 0;
        let mut wire = Wire::new([30, 8, 4][seed as usize % 3], seed);
        let (mut client, hello) = Client::connect(&mut wire, OPTIONS).unwrap_or_else(|e| panic!("seed {seed}: {e}"));
        for step in 0..2 {
            let made = client.generate(&request(true), &mut watch).unwrap_or_else(|e| panic!("seed {seed}: {e}"));
            assert_eq!(made.frames, 3, "seed {seed}");
            assert_eq!(client.wait_for_motion(&mut watch).unwrap(), State::Holding, "seed {seed}");
            let blob = [BLOB, OTHER][step];
            let (active, _) = client.update(&hello, blob, &mut |_| {}).unwrap_or_else(|e| panic!("seed {seed}: {e}"));
            assert_eq!(active.sequence as usize, step + 1, "seed {seed}");
            client.tell(&Command::Stop).unwrap();
            client.tell(&Command::Neutral).unwrap();
            while client.wait_for_rest(&mut watch).unwrap() != State::Neutral {
                // A repetition of the stop was held up on the line: a stop that comes late is still a stop.
                late += 1;
                client.tell(&Command::Neutral).unwrap();
            }
        }
        repeated += client.repeated();
        faults += wire.faults;
        let count = |what| wire.robot.calls.iter().filter(|&&call| call == what).count();
        assert_eq!(["start", "stop", "neutral"].map(count), [2, 2 + late, 2 + late], "seed {seed}");
        assert_eq!(wire.robot.activations, 2, "seed {seed}");
        assert_eq!(Store::open(&wire.robot.flash).bytes(&wire.robot.flash), Some(OTHER), "seed {seed}");
    }
    assert!(faults > 5000 && repeated > 2000, "{faults} faults, {repeated} repetitions");
}

#[test]
fn a_stop_needs_no_session() {
    let mut wire = Wire::new(0, 1);
    let (mut client, _) = Client::connect(&mut wire, OPTIONS).unwrap();
    client.tell(&Command::Generate(request(true))).unwrap();
    let mut other = Client::new(&mut wire, OPTIONS);
    other.tell(&Command::Stop).unwrap();
    assert!(matches!(other.tell(&Command::Play), Err(Error::Refused(Refusal::Session))));
    assert_eq!(wire.robot.condition.state, State::Stopped);
}

/// One host has the robot; others look, and wait or insist.
#[test]
fn another_host_waits_or_takes_over() {
    let mut wire = Wire::new(0, 1);
    let (mut client, _) = Client::connect(&mut wire, OPTIONS).unwrap();
    client.tell(&Command::Generate(request(true))).unwrap();
    match Client::connect(&mut wire, OPTIONS).err() {
        Some(error @ Error::Refused(Refusal::Occupied { free_in_ms: Some(1..=60_000) })) => {
            assert!(error.to_string().contains("60 s"), "{error}");
            assert!(error.hint().unwrap().contains("--take-over"));
        }
        other => panic!("{other:?}"),
    }
    assert!(Client::new(&mut wire, OPTIONS).status().unwrap().device.work.is_some());
    let insists = Options { take_over: true, ..OPTIONS };
    let (mut client, _) = Client::connect(&mut wire, insists).unwrap();
    client.close();
    Client::connect(&mut wire, OPTIONS).unwrap();
}

#[test]
fn who_waits_is_told_when_there_is_nothing_to_wait_for() {
    let mut wire = Wire::new(0, 1);
    let (mut client, _) = Client::connect(&mut wire, OPTIONS).unwrap();
    client.tell(&Command::Stop).unwrap();
    // Refused before it is made.
    let refused = client.generate(&request(true), &mut watch);
    assert!(matches!(refused, Err(Error::Refused(Refusal::Stopped))), "{refused:?}");
    client.generate(&request(false), &mut watch).unwrap();
    assert!(matches!(client.wait_for_motion(&mut watch), Err(Error::Stopped)));
    client.tell(&Command::Neutral).unwrap();
    client.wait_for_rest(&mut watch).unwrap();
    // Ready, and nobody has asked for it to be played.
    client.generate(&request(false), &mut watch).unwrap();
    assert!(matches!(client.wait_for_motion(&mut watch), Err(Error::NotBegun)));
    let interrupted = client.wait_for_motion(&mut |_| ControlFlow::Break(()));
    assert!(matches!(interrupted, Err(Error::Interrupted)));

    // A start that does not go on by itself.
    let mut wire = Wire::new(0, 1);
    let start = Start::Refused { channel: 4, why: StartFault::OutOfRange { decidegrees: -123 } };
    wire.robot.condition.start = start;
    let (mut client, _) = Client::connect(&mut wire, OPTIONS).unwrap();
    let error = client.generate(&request(true), &mut watch).unwrap_err();
    assert!(error.to_string().contains("channel 4") && error.to_string().contains("-12.3 degrees"), "{error}");
    assert!(error.hint().unwrap().contains("robot.toml"));
    client.generate(&request(false), &mut watch).unwrap();
    assert!(matches!(client.wait_for_motion(&mut watch), Err(Error::Refused(Refusal::NotReady(why))) if why == start));
}

#[test]
fn refusals_and_failures_are_what_the_device_says() {
    let mut wire = Wire::new(0, 1);
    let (mut client, _) = Client::connect(&mut wire, OPTIONS).unwrap();
    assert!(matches!(client.tell(&Command::Play), Err(Error::Refused(Refusal::NothingToPlay))));
    // The robot fails a job that is stopped.
    client.tell(&Command::Generate(request(false))).unwrap();
    client.tell(&Command::Stop).unwrap();
    let failed = Event::Failed { job: 3, why: Failure::Aborted };
    assert_eq!(client.event(OPTIONS.wait).unwrap(), Some(failed.clone()));
    assert_eq!(client.status().unwrap().outcome, Some(failed));
    assert!(matches!(client.tell(&Command::Play), Err(Error::Refused(Refusal::Stopped))));

    // The device starts anew while it works, and with it the numbers.
    let mut wire = Wire::new(0, 1);
    // A hello is one write, a request of generation is two: the first status comes fourth.
    wire.reset_at = Some(4);
    let (mut client, _) = Client::connect(&mut wire, OPTIONS).unwrap();
    assert!(matches!(client.generate(&request(false), &mut watch), Err(Error::Refused(Refusal::Session))));
}

/// A line that says what it was told to say.
struct Canned(VecDeque<u8>, ErrorKind);

impl Read for Canned {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.0.is_empty() && self.1 != ErrorKind::UnexpectedEof {
            return Err(self.1.into());
        }
        self.0.read(buffer)
    }
}

impl Write for Canned {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        // The header of a reply is that of its request.
        if let Some((header, _)) = request_in(bytes) {
            let mut buffer = [0; REPLY_FRAME];
            let header = Header { version: FROM_DEVICE | (PROTOCOL + 1), ..header };
            if !self.0.is_empty() {
                self.0.extend(encode(&(header, Reply::Accepted), &mut buffer).unwrap());
            }
        }
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Transport for Canned {
    fn set_timeout(&mut self, _: Duration) -> io::Result<()> {
        Ok(())
    }
}

/// A device of version 1: whatever it is sent, it says in its own words that it is of that version.
struct Older(VecDeque<u8>);

impl Read for Older {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        self.0.read(buffer)
    }
}

impl Write for Older {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let (header, _) = request_in(bytes).expect("one whole request");
        // Version 1 with the device's bit, session, id; Refused, Version, 1.
        let mut message = vec![0x81];
        for mut number in [header.session, header.id] {
            while number >= 0x80 {
                message.push(number as u8 | 0x80);
                number >>= 7;
            }
            message.push(number as u8);
        }
        message.extend([2, 0, 1]);
        let mut buffer = [0; REPLY_FRAME];
        self.0.extend(encode(&Raw(&message), &mut buffer).unwrap());
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

impl Transport for Older {
    fn set_timeout(&mut self, _: Duration) -> io::Result<()> {
        Ok(())
    }
}

#[test]
fn an_older_device_is_the_one_to_be_updated() {
    match Client::connect(Older(VecDeque::new()), OPTIONS).err() {
        Some(error @ Error::Version { device: 1 }) => {
            assert!(error.to_string().contains("version 1") && error.to_string().contains("firmware"), "{error}");
        }
        other => panic!("{other:?}"),
    }
}

fn request_in(mut bytes: &[u8]) -> Option<(Header, Vec<u8>)> {
    let mut receiver = motionette_link::frame::Receiver::<1024>::new();
    let message = receiver.next(&mut bytes)?.ok()?;
    let (header, body) = postcard::take_from_bytes::<Header>(message).ok()?;
    Some((header, body.to_vec()))
}

#[test]
fn nobody_there_another_version_and_a_broken_line() {
    let nobody = Client::connect(Canned(VecDeque::new(), ErrorKind::WouldBlock), Options { attempts: 3, ..OPTIONS });
    assert!(matches!(nobody, Err(Error::Silent { attempts: 3, before: false, .. })));
    // Noise comes before the answer of a newer device.
    let newer = Client::connect(Canned([7, 7].into(), ErrorKind::TimedOut), OPTIONS);
    match newer.err() {
        Some(error @ Error::Version { device }) if device == PROTOCOL + 1 => {
            assert!(error.to_string().contains("update these tools"), "{error}")
        }
        other => panic!("{other:?}"),
    }
    for kind in [ErrorKind::BrokenPipe, ErrorKind::UnexpectedEof] {
        let broken = Client::connect(Canned(VecDeque::new(), kind), OPTIONS);
        match broken.err() {
            Some(error @ Error::Broken(_)) => assert!(error.hint().is_some()),
            other => panic!("{other:?}"),
        }
    }
}
