//! The device's side: requests, repetitions, stops, silence.

mod common;

use common::host::{HELLO, Host, SILENCE, replies};
use common::{BLOB, CONDITION_BYTES, OTHER, crc, ready, ready_under, sent};
use motionette::{BodyParts, Course, Joint, Keyframe, MAX_SPANS, Obstacle, Shape, Span, Track};
use motionette_link::conditions::Given;
use motionette_link::frame::{Faults, encode};
use motionette_link::message::{
    Anchor, BlobFault, Command, ConditionsFault, Event, Failure, Generate, Header, JobStage, LossAction, Owner,
    PROTOCOL, REPLY_FRAME, REQUEST_FRAME, Refinement, Refusal, Reply, Start, StartFault, State, Target, Transfer,
    UpdateFault,
};
use motionette_link::server::{Port, Server, Silence, Sink};
use motionette_link::update::Store;

const HOLD: Silence = Silence { after_ms: 500, action: LossAction::Hold };

fn generate(play_when_ready: bool) -> Command {
    let anchor = Anchor { frame: 10, target: Target::Root([0.0, 0.9, 0.5]) };
    let request = Generate::new("a person bows".try_into().unwrap());
    Command::Generate(Generate { anchors: [anchor].into_iter().collect(), play_when_ready, ..request })
}

#[test]
fn from_text_to_a_finished_motion() {
    let mut host = Host::new(SILENCE);
    let Reply::Hello(hello) = host.ask(&HELLO) else { panic!() };
    assert_eq!((hello.version.as_str(), hello.preset.as_str()), (env!("CARGO_PKG_VERSION"), "table-top"));
    assert_eq!((hello.limits.silence_ms, hello.limits.blob_bytes, hello.blob), (500, 15 * 1024, None));
    assert_eq!(host.refused(&Command::Play), Refusal::NothingToPlay);

    host.accepted(&generate(false));
    let job = host.id;
    assert_eq!(host.refused(&generate(false)), Refusal::Busy { job });
    assert_eq!(host.refused(&Command::SelfTest), Refusal::Busy { job });
    assert_eq!(host.wait(100), []);
    let work = host.status().device.work.unwrap();
    assert_eq!((work.job, work.stage, work.step, work.steps), (job, JobStage::Planning, 2, 2));
    assert_eq!(host.wait(50), [ready(job, true)]);
    let status = host.status();
    assert_eq!((status.outcome, status.device.work, status.device.frames_queued), (Some(ready(job, true)), None, 3));

    host.accepted(&Command::Play);
    host.wait(50);
    host.accepted(&Command::Hold);
    assert_eq!(host.status().device.state, State::Holding);
    assert_eq!(host.wait(200), [], "held");
    host.accepted(&Command::Resume);
    assert_eq!(host.wait(300), [Event::Finished]);
    host.accepted(&Command::SelfTest);
    let job = host.id;
    assert_eq!(host.wait(200), [Event::SelfTest { job, passed: Some(true) }]);
    assert_eq!(host.robot.calls, ["start", "play", "hold", "resume", "start"]);
}

#[test]
fn a_repeated_request_is_answered_and_not_executed() {
    let mut host = Host::greeted(SILENCE);
    let command = generate(true);
    for _ in 0..4 {
        assert_eq!(if host.id == 1 { host.ask(&command) } else { host.repeat(&command) }, Reply::Accepted);
    }
    host.wait(150);
    // The job is over, its request comes once more.
    assert_eq!(host.repeat(&command), Reply::Accepted);
    assert_eq!(host.robot.calls, ["start"]);
    let refusal = host.ask(&Command::Neutral);
    assert_eq!(refusal, Reply::Refused(Refusal::Moving));
    host.wait(1000);
    assert_eq!(host.repeat(&Command::Neutral), refusal, "refused then, refused now");
    let before = host.ask(&Command::Status);
    host.wait(50);
    assert_eq!(host.repeat(&Command::Status), before);
    assert_ne!(host.ask(&Command::Status), before);
}

#[test]
fn what_a_stop_has_overtaken_does_not_happen() {
    let mut host = Host::greeted(SILENCE);
    host.accepted(&generate(false));
    host.wait(150);
    let last = host.id + 2;
    let play = Header::new(host.session, host.id + 1);
    assert_eq!(host.as_numbered(Header::new(host.session, last), &Command::Stop), Reply::Accepted);
    assert_eq!(host.as_numbered(play, &Command::Play), Reply::Refused(Refusal::Stale { last }));
    // A stop that comes late is still a stop.
    assert_eq!(host.as_numbered(play, &Command::Stop), Reply::Accepted);
    assert_eq!(host.robot.calls, ["start", "stop", "stop"]);
}

#[test]
fn stop_works_always() {
    // Without a session, and in another one's.
    let mut host = Host::new(SILENCE);
    host.accepted(&Command::Stop);
    host.ask(&HELLO);
    host.accepted(&Command::Neutral);
    host.wait(50);
    host.accepted(&generate(true));
    let job = host.id;
    assert_eq!(host.as_numbered(Header::new(5, 1), &Command::Stop), Reply::Accepted);
    // During a job, which ends.
    assert_eq!(host.wait(50), [Event::Failed { job, why: Failure::Aborted }]);
    assert_eq!(host.wait(500), []);
    assert_eq!(host.status().device.state, State::Stopped);
    assert_eq!(host.refused(&Command::Play), Refusal::Stopped);
    // During a transfer, which goes on.
    assert_eq!(host.ask(&Command::BlobBegin { length: 500, crc32: 1 }), Reply::Chunk { next: 0 });
    host.accepted(&Command::Stop);
    assert_eq!(host.status().transfer, Some(Transfer { next: 0, length: 500 }));
    assert_eq!(host.refused(&Command::Neutral), Refusal::Transferring { next: 0, length: 500 });
    host.accepted(&Command::BlobAbort);
    host.accepted(&Command::Neutral);
    assert_eq!(host.status().device.state, State::Returning);
    // A stop of an unknown version is refused: nothing is known about it but its number.
    let header = Header { version: 9, session: 1, id: 1 };
    assert_eq!(host.as_numbered(header, &Command::Stop), Reply::Refused(Refusal::Version { supported: PROTOCOL }));
}

/// What hosts of versions 1 to 3 sent and understand, byte for byte: the refusal that names the version they are to speak.
#[test]
fn older_versions_are_told_which_version_this_is() {
    let mut host = Host::greeted(SILENCE);
    // Hello, Stop and a blob's beginning of session 0x1234.
    let sent: [&[u8]; 5] = [
        &[0x00, 0x05, 0x01, 0xB4, 0x24, 0x01, 0x05, 0x1D, 0xD8, 0x0D, 0x4F, 0x00],
        &[0x00, 0x0A, 0x01, 0xB4, 0x24, 0x02, 0x03, 0x64, 0xDA, 0x29, 0xFD, 0x00],
        &[
            0x00, 0x11, 0x01, 0xB4, 0x24, 0x02, 0x09, 0xE8, 0x07, 0x8D, 0xE0, 0xFB, 0xD7, 0x0C, 0x17, 0x79, 0x30, 0xB4,
            0x00,
        ],
        // Hello of version 2.
        &[0x00, 0x05, 0x02, 0xB4, 0x24, 0x01, 0x01, 0x05, 0x22, 0xFC, 0xDF, 0x37, 0x00],
        // Hello of version 3.
        &[0x00, 0x05, 0x03, 0xB4, 0x24, 0x01, 0x01, 0x05, 0x87, 0x2F, 0x83, 0xFC, 0x00],
    ];
    // Version 4 with the device's bit, session, id; Refused, Version, 4.
    let first = [0x00, 0x06, 0x84, 0xB4, 0x24, 0x01, 0x02, 0x06, 0x04, 0x2A, 0xBE, 0x7A, 0xE8, 0x00];
    let later = [0x00, 0x06, 0x84, 0xB4, 0x24, 0x02, 0x02, 0x06, 0x04, 0xC4, 0x11, 0xCF, 0xFA, 0x00];
    for (bytes, reply) in sent.into_iter().zip([first, later, later, first, first]) {
        assert_eq!(host.send(bytes), reply);
    }
    assert_eq!(host.robot.calls, [""; 0]);
}

/// On a line with an echo the device hears itself: it neither obeys nor answers.
#[test]
fn an_echo_is_no_request() {
    let mut host = Host::greeted(SILENCE);
    host.accepted(&generate(true));
    let mut buffer = [0; REQUEST_FRAME];
    for (id, reply) in [(0, Reply::Event(Event::Finished)), (9, Reply::Accepted), (9, Reply::Chunk { next: 0 })] {
        let frame = encode(&(Header::reply(host.session, id), reply), &mut buffer).unwrap();
        assert_eq!(host.send(frame), []);
    }
    assert_eq!(host.status().skipped.unfit, 3);
    assert_eq!(host.robot.calls, ["start"]);
}

#[test]
fn sessions_do_not_mix() {
    let mut host = Host::new(SILENCE);
    assert_eq!(host.refused(&Command::KeepAlive), Refusal::Session);
    host.ask(&HELLO);
    host.status();
    // The same numbers in a new session are new requests.
    (host.session, host.id) = (78, 0);
    assert_eq!(host.refused(&Command::KeepAlive), Refusal::Session);
    assert!(matches!(host.ask(&Command::Hello { take_over: true }), Reply::Hello(_)));
    host.status();
    assert_eq!(host.as_numbered(Header::new(77, 9), &Command::Play), Reply::Refused(Refusal::Session));
    // Ids go round.
    host.accepted(&Command::Close);
    host.id = u32::MAX - 1;
    host.session = 79;
    for _ in 0..4 {
        host.ask(&HELLO);
    }
    assert_eq!(host.id, 2);
    assert_eq!(
        host.as_numbered(Header::new(79, u32::MAX), &Command::Status),
        Reply::Refused(Refusal::Stale { last: 2 })
    );
}

/// Another host gets the robot when the first closes its session, falls silent or hangs up, or when it insists; not before.
#[test]
fn one_host_at_a_time() {
    let mut host = Host::greeted(SILENCE);
    let mut port = host.server.port();
    let refused = |free_in_ms| Reply::Refused(Refusal::Occupied { free_in_ms });
    host.wait(150);
    assert_eq!(host.another(&mut port, Header::new(5, 1), &HELLO), refused(Some(350)));
    // The first has noticed nothing, and what it says begins the time anew.
    host.accepted(&Command::KeepAlive);
    assert_eq!(host.another(&mut port, Header::new(5, 2), &HELLO), refused(Some(500)));
    assert!(host.server.is_owner(&host.port) && !host.server.is_owner(&port));
    host.wait(450);
    assert_eq!(host.another(&mut port, Header::new(5, 3), &HELLO), refused(Some(50)));
    host.wait(50);
    assert!(matches!(host.another(&mut port, Header::new(5, 4), &HELLO), Reply::Hello(_)));
    assert!(host.server.is_owner(&port) && !host.server.is_owner(&host.port));
    assert_eq!(host.refused(&Command::Play), Refusal::Session);

    // The first takes it back, and closes.
    assert_eq!(host.ask(&HELLO), refused(Some(500)));
    assert!(matches!(host.ask(&Command::Hello { take_over: true }), Reply::Hello(_)));
    assert_eq!(host.another(&mut port, Header::new(5, 5), &Command::KeepAlive), Reply::Refused(Refusal::Session));
    host.accepted(&Command::Close);
    // The reply was lost; and a request that was on its way does nothing.
    assert_eq!(host.repeat(&Command::Close), Reply::Accepted);
    assert_eq!(host.refused(&Command::Neutral), Refusal::Session);
    assert_eq!(host.another(&mut port, Header::new(5, 6), &Command::Close), Reply::Accepted, "not its own: nothing");
    assert!(matches!(host.another(&mut port, Header::new(6, 1), &HELLO), Reply::Hello(_)));

    // The cable of the first is of no account, the second's is.
    host.server.hang_up(&host.port);
    (host.session, host.id) = (80, 0);
    assert_eq!(host.ask(&HELLO), refused(Some(500)));
    host.server.hang_up(&port);
    assert!(matches!(host.ask(&HELLO), Reply::Hello(_)));
    assert_eq!(host.robot.calls, [""; 0]);
}

/// A device that does not watch for silence waits for a host that is gone, unless its successor insists.
#[test]
fn without_a_watch_only_closing_frees_the_robot() {
    let mut host = Host::greeted(Silence { after_ms: 0, action: LossAction::Hold });
    let mut port = host.server.port();
    host.wait(100_000);
    let refused = Reply::Refused(Refusal::Occupied { free_in_ms: None });
    assert_eq!(host.another(&mut port, Header::new(5, 1), &HELLO), refused);
    let reply = host.another(&mut port, Header::new(5, 2), &Command::Hello { take_over: true });
    assert!(matches!(reply, Reply::Hello(_)));
}

/// Anybody may look and stop; who looks takes nothing away from the session's host.
#[test]
fn every_host_may_ask_how_it_stands() {
    let mut host = Host::new(HOLD);
    assert_eq!(host.status().owner, Owner::Nobody);
    host.ask(&HELLO);
    assert_eq!(host.status().owner, Owner::You);
    host.accepted(&generate(false));
    host.wait(150);
    host.robot.condition.frames_queued = 1000;
    host.accepted(&Command::Play);
    assert_eq!(host.wait(500), [Event::HostLost(LossAction::Hold)]);
    let mut port = host.server.port();
    host.another(&mut port, Header::new(5, 1), &Command::KeepAlive);
    for id in 2..4 {
        let Reply::Status(status) = host.another(&mut port, Header::new(5, id), &Command::Status) else { panic!() };
        assert_eq!((status.device.state, status.host_lost), (State::Holding, Some(LossAction::Hold)));
        assert_eq!(status.owner, Owner::Another);
    }
    assert_eq!(host.status().host_lost, Some(LossAction::Hold));
    let Reply::Status(status) = host.another(&mut port, Header::new(5, 9), &Command::Status) else { panic!() };
    assert_eq!(status.host_lost, None);
}

/// Only what the session's host says to this device is a sign of its life.
#[test]
fn refused_traffic_does_not_keep_a_silent_host_alive() {
    let mut buffer = [0; REQUEST_FRAME];
    let (ours, other) = (Header::new(77, 90), Header::new(5, 1));
    let mut frame = |header: Header, body: &[u8]| encode(&(header, common::Raw(body)), &mut buffer).unwrap().to_vec();
    // By their numbers: 13 is KeepAlive, 7 Status, 3 Stop, 0 Hello, 15 Close.
    let traffic = [
        ("another version", frame(Header { version: PROTOCOL + 1, ..ours }, &[13])),
        ("an older version", frame(Header { version: 1, ..ours }, &[13])),
        ("another session", frame(other, &[13])),
        ("a status of another session", frame(other, &[7])),
        ("a hello of another session", frame(other, &[0, 0])),
        ("a closing of another session", frame(other, &[15])),
        ("no request", frame(ours, &[200])),
        ("bytes behind a request", frame(ours, &[13, 0])),
        ("an old number", frame(Header::new(77, 1), &[13])),
        ("an echo", frame(Header { version: PROTOCOL | 0x80, ..ours }, &[13])),
    ];
    for (what, bytes) in traffic {
        let mut host = Host::greeted(HOLD);
        host.accepted(&generate(false));
        host.wait(150);
        host.robot.condition.frames_queued = 1000;
        host.accepted(&Command::Play);
        for _ in 0..9 {
            assert_eq!(host.wait(50), [], "{what}");
            host.send(&bytes);
        }
        assert_eq!(host.wait(50), [Event::HostLost(LossAction::Hold)], "{what}");
        assert_eq!(host.robot.condition.state, State::Holding, "{what}");
        // The host itself is heard.
        host.accepted(&Command::Resume);
        assert_eq!(host.wait(450), [], "{what}");
    }
}

/// A session that ends while something moves leaves a robot without a host: it does what it does without one.
#[test]
fn a_closed_session_is_a_lost_host() {
    for hang_up in [false, true] {
        let mut host = Host::greeted(HOLD);
        host.accepted(&generate(false));
        host.wait(150);
        host.robot.condition.frames_queued = 1000;
        host.accepted(&Command::Play);
        if hang_up {
            host.server.hang_up(&host.port);
        } else {
            host.accepted(&Command::Close);
        }
        assert_eq!(host.wait(450), []);
        assert_eq!(host.robot.condition.state, State::Playing);
        assert_eq!(host.wait(50), [Event::HostLost(LossAction::Hold)]);
        assert_eq!(host.robot.condition.state, State::Holding);
    }
    // A transfer has nobody who could end it.
    let mut host = Host::greeted(HOLD);
    host.ask(&Command::BlobBegin { length: 500, crc32: 0 });
    host.accepted(&Command::Close);
    assert_eq!(host.server.store().transfer(), None);
}

/// What would be made in vain is not made, and the reason is said.
#[test]
fn a_motion_that_cannot_be_played_is_refused_before_it_is_made() {
    let mut host = Host::greeted(SILENCE);
    host.accepted(&Command::Stop);
    assert_eq!(host.refused(&generate(true)), Refusal::Stopped);
    host.accepted(&generate(false));
    host.wait(150);
    host.accepted(&Command::Neutral);
    host.wait(50);
    let silent = Start::Refused { channel: 3, why: StartFault::Silent };
    for start in [Start::Waiting, silent] {
        host.robot.condition.start = start;
        assert_eq!(host.status().device.start, start);
        assert_eq!(host.refused(&generate(true)), Refusal::NotReady(start));
        assert_eq!(host.refused(&Command::Play), Refusal::NotReady(start));
    }
    assert_eq!(host.refused(&Command::Release), Refusal::NotWaiting);
    host.robot.condition.start = Start::Waiting;
    host.accepted(&Command::Release);
    // It moves now.
    assert_eq!(host.refused(&Command::BlobBegin { length: 500, crc32: 0 }), Refusal::Moving);
    host.accepted(&generate(true));
    assert_eq!(host.robot.calls, ["stop", "start", "neutral", "release", "start"]);
}

#[test]
fn a_refinement_method_that_is_not_known_is_refused_as_such() {
    let mut host = Host::greeted(SILENCE);
    for found in [6, 127, 128, 255] {
        let request = Generate::new("a person bows".try_into().unwrap());
        let request = Generate { refinement: Refinement(found), ..request };
        assert_eq!(host.refused(&Command::Generate(request)), Refusal::Refinement { found });
    }
    assert_eq!(host.robot.calls, [""; 0]);
}

#[test]
fn what_nobody_understands_is_refused() {
    let mut host = Host::greeted(SILENCE);
    let header = Header::new(host.session, 2);
    let mut buffer = [0; REQUEST_FRAME];
    // A variant nobody knows, bytes behind a request, a text that is too long, one that is no UTF-8.
    let frames = [
        encode(&(header, 99u8), &mut buffer).unwrap().to_vec(),
        encode(&(header, Command::Play, 0u8), &mut buffer).unwrap().to_vec(),
        encode(&(header, 1u8, "x".repeat(193).as_str(), [0u8; 9]), &mut buffer).unwrap().to_vec(),
        encode(&(header, 1u8, &[0xC1u8; 8][..]), &mut buffer).unwrap().to_vec(),
    ];
    for frame in frames {
        let bytes = host.send(&frame);
        assert_eq!(replies(&bytes), [(Header::reply(header.session, 2), Reply::Refused(Refusal::Malformed))]);
    }
    assert_eq!(host.send(&[0, 3, 3, 3, 3, 0, 5, 3, 3, 3, 3, 0]), []);
    // A message without so much as a header, though its checksum is right.
    assert_eq!(host.send(encode(&1u8, &mut buffer).unwrap()), []);
    let skipped = host.status().skipped;
    let expected = Faults { encoding: 1, checksum: 1, unfit: 1, too_long: 0 };
    assert_eq!(skipped, expected);
    assert_eq!(host.robot.calls, [""; 0]);
}

/// The host disappears while a motion plays: it is played to its end, and the next status says why nobody was asked.
#[test]
fn a_lost_host_and_a_device_that_finishes() {
    let mut host = Host::greeted(SILENCE);
    host.accepted(&generate(true));
    host.robot.condition.work.as_mut().unwrap().steps = 12;
    let job = host.id;
    assert_eq!(host.wait(1500), [Event::HostLost(LossAction::Finish), ready(job, true), Event::Finished]);
    let status = host.status();
    assert_eq!((status.host_lost, status.device.state), (Some(LossAction::Finish), State::Holding));
    assert_eq!(host.status().host_lost, None, "said once");
    assert_eq!(host.wait(1500), [], "silence without a motion is nothing");
}

#[test]
fn a_lost_host_and_a_device_that_holds() {
    let mut host = Host::greeted(HOLD);
    host.accepted(&generate(false));
    host.wait(150);
    host.robot.condition.frames_queued = 1000;
    host.accepted(&Command::Play);
    assert_eq!(host.wait(450), []);
    // Any sign of life will do.
    host.accepted(&Command::KeepAlive);
    assert_eq!(host.wait(450), []);
    assert_eq!(host.wait(500), [Event::HostLost(LossAction::Hold)]);
    let status = host.status();
    assert_eq!((status.host_lost, status.device.state), (Some(LossAction::Hold), State::Holding));
    host.accepted(&Command::Resume);
    assert_eq!(host.wait(600), [Event::HostLost(LossAction::Hold)], "each silence anew");

    // Whatever sets it in motion again in the same silence, it holds, and says so once.
    host.robot.condition.state = State::Playing;
    assert_eq!(host.wait(50), []);
    assert_eq!(host.robot.condition.state, State::Holding);

    // A motion that would begin by itself in the silence does not.
    let mut host = Host::greeted(HOLD);
    host.accepted(&generate(true));
    host.robot.condition.work.as_mut().unwrap().steps = 20;
    let events = host.wait(2000);
    assert!(matches!(events[..], [Event::HostLost(LossAction::Hold), Event::Ready { .. }]), "{events:?}");
    assert_eq!(host.status().device.state, State::Holding);
}

/// A reply or event that finds no room is counted; a repeated request gets its reply, an event waits.
#[test]
fn a_full_line_loses_nothing_that_matters() {
    struct Full;
    impl Sink for Full {
        fn room(&self) -> usize {
            0
        }
        fn send(&mut self, _: &[u8]) {
            panic!("there was no room");
        }
    }
    let mut host = Host::greeted(SILENCE);
    let mut buffer = [0; REQUEST_FRAME];
    host.id += 1;
    let command = generate(false);
    let frame = encode(&(Header::new(host.session, host.id), &command), &mut buffer).unwrap();
    host.server.receive(&mut host.port, host.now, frame, &mut host.robot, &mut Full);
    assert_eq!(host.repeat(&command), Reply::Accepted);
    for _ in 0..5 {
        host.robot.advance();
        host.server.poll(host.now, &mut host.robot, &mut Full);
    }
    let status = host.status();
    assert!(matches!(status.outcome, Some(Event::Ready { .. })), "known although not yet told");
    assert_eq!(status.unsent, 1);
    let mut line = heapless::Vec::<u8, REPLY_FRAME>::new();
    host.server.poll(host.now, &mut host.robot, &mut line);
    assert!(matches!(replies(&line)[..], [(_, Reply::Event(Event::Ready { .. }))]));
}

#[test]
fn a_blob_over_the_link() {
    let mut host = Host::greeted(SILENCE);
    assert_eq!(host.refused(&Command::BlobCommit), Refusal::Update(UpdateFault::NoTransfer));
    host.transfer(BLOB);
    let Reply::Committed(blob) = host.ask(&Command::BlobCommit) else { panic!() };
    assert_eq!((blob.slot, blob.sequence, blob.length, blob.crc32), (0, 1, BLOB.len() as u32, crc(BLOB)));
    assert_eq!(host.robot.activations, 1);
    assert_eq!(host.repeat(&Command::BlobCommit), Reply::Committed(blob));
    assert_eq!(host.robot.activations, 1);
    assert_eq!(host.server.store().bytes(&host.robot.flash), Some(BLOB));

    // Another one, with a chunk that comes twice under new numbers and one that comes too early.
    let length = OTHER.len() as u32;
    host.ask(&Command::BlobBegin { length, crc32: crc(OTHER) });
    for (index, chunk) in OTHER.chunks(100).enumerate() {
        let offset = index as u32 * 100;
        let chunk = |offset| Command::BlobChunk { offset, bytes: chunk.iter().copied().collect() };
        assert_eq!(host.ask(&chunk(offset + 100)), Reply::Chunk { next: offset });
        let Reply::Chunk { next } = host.ask(&chunk(offset)) else { panic!() };
        assert_eq!(host.ask(&chunk(offset)), Reply::Chunk { next });
        if next < length {
            let incomplete = Refusal::Update(UpdateFault::Incomplete { next, length });
            assert_eq!(host.refused(&Command::BlobCommit), incomplete);
            assert_eq!(host.refused(&generate(false)), Refusal::Transferring { next, length });
        }
    }
    let Reply::Committed(blob) = host.ask(&Command::BlobCommit) else { panic!() };
    assert_eq!((blob.slot, blob.sequence), (1, 2));
    assert_eq!(Store::open(&host.robot.flash).active(), Some(blob));

    // Refused, with the active one untouched: too long, wrong sum, no blob, too large for the device's memory.
    let limit = 15 * 1024;
    let too_long = UpdateFault::Length { length: limit + 1, limit };
    assert_eq!(host.refused(&Command::BlobBegin { length: limit + 1, crc32: 0 }), Refusal::Update(too_long));
    assert_eq!(
        host.refused(&Command::BlobBegin { length: 0, crc32: 0 }),
        Refusal::Update(UpdateFault::Length { length: 0, limit })
    );
    let noise = [0x5A; 300];
    host.transfer(&noise);
    assert_eq!(host.refused(&Command::BlobCommit), Refusal::Update(UpdateFault::Model(BlobFault::NotABlob)));
    let announced = crc(BLOB) ^ 1;
    host.ask(&Command::BlobBegin { length: BLOB.len() as u32, crc32: announced });
    for (index, chunk) in BLOB.chunks(240).enumerate() {
        host.ask(&Command::BlobChunk { offset: index as u32 * 240, bytes: chunk.iter().copied().collect() });
    }
    let wrong = UpdateFault::Checksum { computed: crc(BLOB), announced };
    assert_eq!(host.refused(&Command::BlobCommit), Refusal::Update(wrong));
    host.robot.flash.memory = 5000;
    host.transfer(BLOB);
    let memory = UpdateFault::Memory { needed: BLOB.len() as u32, available: 5000 };
    assert_eq!(host.refused(&Command::BlobCommit), Refusal::Update(memory));
    assert_eq!((host.robot.activations, host.server.store().active()), (2, Some(blob)));
}

/// After an update of the firmware: the blob in flash is whole, and of a format that this firmware does not read.
#[test]
fn a_blob_of_another_format_is_named_and_not_taken_for_none() {
    let mut host = Host::new(SILENCE);
    let mut old = BLOB.to_vec();
    let (found, supported) = (u16::from(old[4]) - 1, u16::from(old[4]));
    old[4] -= 1;
    host.robot.flash = common::flash_with(&[&old]);
    host.server = Server::new(Store::open(&host.robot.flash), SILENCE);
    host.robot.model = false;
    let why = UpdateFault::Model(BlobFault::Version { found, supported });
    let Reply::Hello(hello) = host.ask(&HELLO) else { panic!() };
    let refused = hello.refused.unwrap();
    assert_eq!((hello.blob, hello.model, refused.why), (None, None, why));
    assert_eq!((refused.blob.slot, refused.blob.length, refused.blob.crc32), (0, old.len() as u32, crc(&old)));
    assert_eq!(host.status().refused, hello.refused);
    assert_eq!(host.refused(&generate(false)), Refusal::Unusable(why));
    assert_eq!(host.refused(&Command::SelfTest), Refusal::Unusable(why));

    // The right one goes to the other slot, and is the newest.
    host.transfer(BLOB);
    let Reply::Committed(blob) = host.ask(&Command::BlobCommit) else { panic!() };
    assert_eq!((blob.slot, blob.sequence), (1, 2));
    assert_eq!(host.status().refused, None);
    let store = Store::open(&host.robot.flash);
    assert_eq!((store.active(), store.refused()), (Some(blob), None));
}

#[test]
fn no_flash_while_something_moves_and_no_movement_while_flash_is_written() {
    let mut host = Host::greeted(SILENCE);
    let begin = Command::BlobBegin { length: 500, crc32: 0 };
    host.accepted(&generate(true));
    let job = host.id;
    assert_eq!(host.refused(&begin), Refusal::Busy { job });
    host.wait(150);
    assert_eq!(host.refused(&begin), Refusal::Moving);
    host.wait(1000);
    assert_eq!(host.ask(&begin), Reply::Chunk { next: 0 });
    for command in [generate(true), Command::Play, Command::Resume, Command::Neutral, Command::SelfTest] {
        assert_eq!(host.refused(&command), Refusal::Transferring { next: 0, length: 500 });
    }
    // A host that disappears in the middle gives its transfer up, and so does one that starts anew.
    assert_eq!(host.wait(600), [Event::HostLost(LossAction::Abort)]);
    let status = host.status();
    assert_eq!((status.host_lost, status.transfer), (Some(LossAction::Abort), None));
    host.ask(&begin);
    (host.session, host.id) = (host.session + 1, 0);
    host.ask(&Command::Hello { take_over: true });
    assert_eq!(host.status().transfer, None);
}

fn under(conditions: bool) -> Command {
    let request = Generate::new("a person bows".try_into().unwrap());
    Command::Generate(Generate { conditions, ..request })
}

/// Two tracks, an obstacle, a span and a vector: 12 + 12 + 2 * 12 + 40 * 12 + 11 * 12 + 12 bytes, those of the obstacle and 8 + 8.
fn conditions() -> Vec<u8> {
    let (path, mask) = ([[0.25, 1.0, -0.5]; 40], [1, 0, 1, 1, 0, 0, 0, 0, 0, 0, 1]);
    let tracks =
        [Track::new(Joint::RightWrist, 3, &path), Track::new(Joint::Pelvis, 0, &path[..11]).masked(&mask).within(0.02)];
    let keys = [Keyframe { frame: 0, position: [0.0; 3] }, Keyframe { frame: 9, position: [1.0, 0.0, 0.0] }];
    let obstacles = [Obstacle::new(Shape::Sphere { radius: 0.5 }, [0.0; 3]).moving(Course::Keyframes(&keys))];
    let timeline = [Span::new(BodyParts::LEFT_ARM, 8, 40, "waves")];
    sent(&Given { tracks: &tracks, obstacles: &obstacles, timeline: &timeline, vector: Some(&[0.5, -0.5, 1.0]) })
}

#[test]
fn conditions_come_in_pieces_and_belong_to_a_request() {
    let mut host = Host::new(SILENCE);
    let Reply::Hello(hello) = host.ask(&HELLO) else { panic!() };
    assert_eq!(hello.limits.condition_bytes as usize, CONDITION_BYTES);
    // All features are linked.
    assert_eq!(usize::from(hello.limits.spans), MAX_SPANS);
    let refused = |fault| Refusal::Conditions(fault);
    assert_eq!(host.refused(&under(true)), refused(ConditionsFault::NotSent));
    let bytes = conditions();
    let length = bytes.len() as u32;
    let chunk = |offset: u32, bytes: &[u8]| Command::ConditionsChunk { offset, bytes: bytes.iter().copied().collect() };
    assert_eq!(host.refused(&chunk(0, &bytes[..8])), refused(ConditionsFault::NotSent));
    let begin = Command::ConditionsBegin { length, crc32: crc(&bytes) };
    assert_eq!(host.ask(&begin), Reply::Chunk { next: 0 });
    for (index, piece) in bytes.chunks(100).enumerate() {
        let offset = index as u32 * 100;
        // Too early, in its turn, and once more under a new number.
        assert_eq!(host.ask(&chunk(offset + 100, piece)), Reply::Chunk { next: offset });
        assert_eq!(host.refused(&under(true)), refused(ConditionsFault::Incomplete { next: offset, length }));
        let Reply::Chunk { next } = host.ask(&chunk(offset, piece)) else { panic!() };
        assert_eq!(host.ask(&chunk(offset, piece)), Reply::Chunk { next });
        assert_eq!(host.status().staged, Some(Transfer { next, length }));
    }
    // Behind the end nothing is taken.
    let end = length + 4;
    assert_eq!(host.refused(&chunk(length, &[0; 4])), refused(ConditionsFault::Length { length: end, limit: length }));
    assert_eq!(host.robot.calls, [""; 0]);

    // Requests without them do not touch them, those with them may come again and again.
    host.accepted(&under(false));
    let job = host.id;
    for command in [begin.clone(), chunk(0, &bytes[..4]), under(true)] {
        assert_eq!(host.refused(&command), Refusal::Busy { job });
    }
    assert_eq!(host.wait(150), [ready(job, false)]);
    for _ in 0..2 {
        host.accepted(&under(true));
        let job = host.id;
        assert_eq!(host.robot.given, [2, 1, 1, 3]);
        assert_eq!(host.wait(150), [ready_under(job, false, [2, 1, 1, 3])]);
        assert_eq!(host.status().outcome, Some(ready_under(job, false, [2, 1, 1, 3])));
    }
    // Also while it moves: they lie in no flash.
    host.accepted(&Command::Play);
    assert_eq!(host.ask(&begin), Reply::Chunk { next: 0 });
    assert_eq!(host.refused(&under(true)), refused(ConditionsFault::Incomplete { next: 0, length }));
}

#[test]
fn conditions_that_are_wrong_are_refused_as_such() {
    let mut host = Host::greeted(SILENCE);
    let refused = |fault| Refusal::Conditions(fault);
    let limit = CONDITION_BYTES as u32;
    for length in [0, 8, 14, limit + 4, u32::MAX] {
        let begin = Command::ConditionsBegin { length, crc32: 0 };
        assert_eq!(host.refused(&begin), refused(ConditionsFault::Length { length, limit }));
    }
    // Another sum than announced; a bit is wrong. What was wrong is given up.
    let bytes = conditions();
    let (computed, announced) = (crc(&bytes), crc(&bytes) ^ 1);
    let pieces = |host: &mut Host, bytes: &[u8], crc32| {
        assert_eq!(host.ask(&Command::ConditionsBegin { length: bytes.len() as u32, crc32 }), Reply::Chunk { next: 0 });
        for (index, piece) in bytes.chunks(240).enumerate() {
            host.ask(&Command::ConditionsChunk { offset: 240 * index as u32, bytes: piece.iter().copied().collect() });
        }
    };
    pieces(&mut host, &bytes, announced);
    assert_eq!(host.refused(&under(true)), refused(ConditionsFault::Checksum { computed, announced }));
    assert_eq!(host.refused(&under(true)), refused(ConditionsFault::NotSent));
    assert_eq!(host.status().staged, None);
    // Right sums of what makes no sense: a format that came later, one track and one span too many, four bytes too much.
    for (at, byte, place) in [(4, 3, 4), (5, 25, 4), (7, 9, 4), (0, bytes[0] + 4, 0), (0, bytes[0] - 4, 0)] {
        let mut bad = bytes.clone();
        bad[at] = byte;
        host.stage(&bad);
        let why = host.refused(&under(true));
        let Refusal::Conditions(ConditionsFault::Format { at }) = why else { panic!("{why:?}") };
        assert!(at == place || place == 0, "{at}");
        assert!(why.to_string().contains(&format!("byte {at}")), "{why}");
    }
    host.stage(&bytes);
    host.accepted(&under(true));
    // A device without memory for them.
    let mut host = Host::greeted(SILENCE);
    host.robot.area.clear();
    for command in [Command::ConditionsBegin { length: 12, crc32: 0 }, under(true)] {
        assert_eq!(host.refused(&command), refused(ConditionsFault::NoArea));
    }
    host.accepted(&under(false));
}

/// Nobody's request is made under what another host has sent, nor under what came in a session that is over.
#[test]
fn conditions_are_those_of_a_session() {
    let bytes = conditions();
    let none = Reply::Refused(Refusal::Conditions(ConditionsFault::NotSent));
    for end in ["taken over", "closed", "hung up", "silent"] {
        for whole in [true, false] {
            let mut host = Host::greeted(SILENCE);
            let mut port = host.server.port();
            if whole {
                host.stage(&bytes);
            } else {
                host.ask(&Command::ConditionsBegin { length: bytes.len() as u32, crc32: crc(&bytes) });
            }
            // Another host's requests are refused before anybody looks for conditions.
            let other = host.another(&mut port, Header::new(5, 1), &under(true));
            assert_eq!(other, Reply::Refused(Refusal::Session));
            let events = match end {
                "closed" => {
                    host.accepted(&Command::Close);
                    Vec::new()
                }
                "hung up" => {
                    host.server.hang_up(&host.port);
                    Vec::new()
                }
                "silent" => host.wait(600),
                _ => Vec::new(),
            };
            // Something was given up only where something was under way.
            let lost = end == "silent" && !whole;
            assert_eq!(events, if lost { vec![Event::HostLost(LossAction::Abort)] } else { vec![] }, "{end}");
            if end == "silent" {
                let status = host.status();
                assert_eq!((status.staged, status.host_lost), (None, lost.then_some(LossAction::Abort)));
                assert_eq!(host.ask(&under(true)), none, "{end}");
            }
            let reply = host.another(&mut port, Header::new(5, 2), &Command::Hello { take_over: true });
            assert!(matches!(reply, Reply::Hello(_)));
            assert_eq!(host.another(&mut port, Header::new(5, 3), &under(true)), none, "{end}");
            // The first one, back again, has to send them anew.
            assert!(matches!(host.ask(&Command::Hello { take_over: true }), Reply::Hello(_)));
            assert_eq!(host.ask(&under(true)), none, "{end}");
            host.stage(&bytes);
            host.accepted(&under(true));
        }
    }
}

#[test]
fn sizes_are_those_of_the_documentation() {
    let text = include_str!("../PROTOCOL.md");
    for (what, bytes) in [("REQUEST_FRAME", REQUEST_FRAME), ("REPLY_FRAME", REPLY_FRAME)] {
        assert!(text.contains(&format!("{bytes} bytes")), "{what} is {bytes} bytes");
    }
    let sizes = format!("{} and {} bytes on a", size_of::<Server>(), size_of::<Port>());
    assert!(text.contains(&sizes), "server and port are {sizes} 64-bit machine");
}
