//! The device's side: requests, repetitions, stops, silence.

mod common;

use common::host::{Host, SILENCE, replies};
use common::{BLOB, OTHER, crc};
use motionette_link::frame::{Faults, encode};
use motionette_link::message::{
    Anchor, BlobFault, Command, Event, Failure, Generate, Header, LossAction, PROTOCOL, REPLY_FRAME, REQUEST_FRAME,
    Refusal, Reply, Stage, State, Target, Transfer, UpdateFault,
};
use motionette_link::server::{Server, Silence, Sink};
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
    let Reply::Hello(hello) = host.ask(&Command::Hello) else { panic!() };
    assert_eq!((hello.version.as_str(), hello.preset.as_str()), (env!("CARGO_PKG_VERSION"), "table-top"));
    assert_eq!((hello.limits.silence_ms, hello.limits.blob_bytes, hello.blob), (500, 15 * 1024, None));
    assert_eq!(host.refused(&Command::Play), Refusal::NothingToPlay);

    host.accepted(&generate(false));
    let job = host.id;
    assert_eq!(host.refused(&generate(false)), Refusal::Busy { job });
    assert_eq!(host.refused(&Command::SelfTest), Refusal::Busy { job });
    assert_eq!(host.wait(100), []);
    let work = host.status().device.work.unwrap();
    assert_eq!((work.job, work.stage, work.step, work.steps), (job, Stage::Planning, 2, 2));
    let ready = Event::Ready { job, frames: 3, control_error: Some(0.25) };
    assert_eq!(host.wait(50), [ready]);
    let status = host.status();
    assert_eq!((status.outcome, status.device.work, status.device.frames_queued), (Some(ready), None, 3));

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
    host.ask(&Command::Hello);
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
    assert_eq!(host.refused(&Command::Status), Refusal::Session);
    host.ask(&Command::Hello);
    host.status();
    // The same numbers in a new session are new requests.
    (host.session, host.id) = (78, 0);
    assert_eq!(host.refused(&Command::KeepAlive), Refusal::Session);
    assert!(matches!(host.ask(&Command::Hello), Reply::Hello(_)));
    host.status();
    assert_eq!(host.as_numbered(Header::new(77, 9), &Command::Play), Reply::Refused(Refusal::Session));
    // Ids go round.
    host.id = u32::MAX - 1;
    host.session = 79;
    for _ in 0..4 {
        host.ask(&Command::Hello);
    }
    assert_eq!(host.id, 2);
    assert_eq!(
        host.as_numbered(Header::new(79, u32::MAX), &Command::Status),
        Reply::Refused(Refusal::Stale { last: 2 })
    );
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
    let ready = Event::Ready { job, frames: 3, control_error: Some(0.25) };
    assert_eq!(host.wait(1500), [Event::HostLost(LossAction::Finish), ready, Event::Finished]);
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
    host.server.receive(host.now, frame, &mut host.robot, &mut Full);
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
    host.ask(&Command::Hello);
    assert_eq!(host.status().transfer, None);
}

#[test]
fn sizes_are_those_of_the_documentation() {
    let text = include_str!("../PROTOCOL.md");
    for (what, bytes) in [("REQUEST_FRAME", REQUEST_FRAME), ("REPLY_FRAME", REPLY_FRAME)] {
        assert!(text.contains(&format!("{bytes} bytes")), "{what} is {bytes} bytes");
    }
    assert!(text.contains(&format!("{} bytes on a", size_of::<Server>())), "a server is {}", size_of::<Server>());
}
