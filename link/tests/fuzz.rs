//! Structure-aware fuzzing of the server: nothing panics and the rules hold, whatever comes.
//!
//! The robot of `common` panics on two jobs at once, on flash rules broken, and on a blob made active that does not open.

mod common;

use common::host::{SILENCE, replies};
use common::{BLOB, CONDITION_BYTES, Line, OTHER, Random, Raw, Robot, crc, sent};
use motionette::{
    BodyParts, Course, Keyframe, MAX_OBSTACLES, MAX_SPANS, MAX_TRACKS, Model, Obstacle, Prompt, Shape, Span, Track,
};
use motionette_link::conditions::{Conditions, Given, KEYFRAMES};
use motionette_link::frame::encode;
use motionette_link::message::{
    Anchor, Command, Event, Generate, Header, Length, LossAction, PROTOCOL, REQUEST_BYTES, REQUEST_FRAME, Refinement,
    Refusal, Reply, State, Target,
};
use motionette_link::server::{Server, Silence};
use motionette_link::update::Store;

fn generate(random: &mut Random) -> Command {
    let text = random.below(193);
    let text = (0..text).map(|_| char::from(b' ' + random.below(90) as u8)).collect();
    let anchors = (0..random.below(33))
        .map(|_| {
            let number = |random: &mut Random| f32::from_bits(random.bits() as u32);
            let position = [number(random), number(random), number(random)];
            let target = match random.below(3) {
                0 => Target::Root(position),
                1 => Target::PlanarRoot([position[0], position[1]]),
                _ => Target::Joint { joint: random.bits() as u8, position },
            };
            Anchor { frame: random.bits() as u16, target }
        })
        .collect();
    let length = if random.once_in(2) { Length::Predicted } else { Length::Frames(random.bits() as u16) };
    let play_when_ready = random.once_in(2);
    let refinement = Refinement(random.below(6) as u8);
    Command::Generate(Generate {
        length,
        refinement,
        seed: random.bits(),
        anchors,
        play_when_ready,
        conditions: random.once_in(3),
        ..Generate::new(text)
    })
}

/// A command, most likely one that gets somewhere: `next` is where the transfer of `blob` stands, `come` where that of the conditions
/// `staged` does.
fn command(random: &mut Random, (blob, next): (&[u8], usize), (staged, come): (&[u8], usize)) -> Command {
    match random.below(36) {
        0 => Command::Hello { take_over: random.once_in(2) },
        1..=3 => generate(random),
        4 => Command::Play,
        5 => Command::Stop,
        6 => Command::Hold,
        7 => Command::Resume,
        8..=9 => Command::Neutral,
        10 => Command::Status,
        11 => Command::SelfTest,
        12 => Command::BlobBegin { length: blob.len() as u32, crc32: crc(blob) },
        13 => Command::BlobBegin { length: random.below(20_000) as u32, crc32: random.bits() as u32 },
        14 => Command::BlobCommit,
        15 if random.once_in(8) => Command::BlobAbort,
        16 => {
            let count = random.below(241);
            let bytes = random.bytes(count);
            Command::BlobChunk { offset: random.below(20_000) as u32, bytes: bytes.into_iter().collect() }
        }
        17 => Command::KeepAlive,
        18 => Command::Release,
        19 if random.once_in(4) => Command::Close,
        20 => Command::ConditionsBegin { length: staged.len() as u32, crc32: crc(staged) },
        21 if random.once_in(2) => {
            Command::ConditionsBegin { length: random.below(2 * CONDITION_BYTES) as u32, crc32: random.bits() as u32 }
        }
        22 if random.once_in(2) => {
            let count = random.below(241);
            let bytes = random.bytes(count);
            let offset = random.below(2 * CONDITION_BYTES) as u32;
            Command::ConditionsChunk { offset, bytes: bytes.into_iter().collect() }
        }
        23..=30 => {
            let from = come.min(staged.len());
            let count = (1 + random.below(240)).min(staged.len() - from);
            Command::ConditionsChunk { offset: from as u32, bytes: staged[from..][..count].iter().copied().collect() }
        }
        _ => {
            let from = next.min(blob.len());
            let count = (1 + random.below(240)).min(blob.len() - from);
            Command::BlobChunk { offset: from as u32, bytes: blob[from..][..count].iter().copied().collect() }
        }
    }
}

/// What the rules say of sessions and silence, told by nothing but what was sent and when.
#[derive(Default)]
struct Rules {
    /// The session and whether it is open.
    session: Option<(u32, bool)>,
    /// Id of its last request.
    last: u32,
    /// When its host was last heard.
    heard: u64,
}

impl Rules {
    /// Whether what was sent may be answered so; `message` is as it arrived, `silence` milliseconds, 0: never.
    fn allow(&mut self, message: &[u8], reply: &Reply, now: u64, silence: u64) -> bool {
        let Ok((Header { version: PROTOCOL, session, id }, body)) = postcard::take_from_bytes::<Header>(message) else {
            return matches!(reply, Reply::Refused(Refusal::Version { supported: PROTOCOL }));
        };
        let Ok((command, [])) = postcard::take_from_bytes::<Command>(body) else {
            return matches!(reply, Reply::Refused(Refusal::Malformed));
        };
        let ours = self.session.is_some_and(|(number, _)| number == session);
        let open = self.session.is_some_and(|(_, open)| open);
        let order = id.wrapping_sub(self.last).cast_signed();
        let (hello, stop) = (matches!(command, Command::Hello { .. }), command == Command::Stop);
        if ours && order == 0 {
            self.heard = if open { now } else { self.heard };
            return true;
        }
        if (ours && order > 0 && (open || hello)) || (!ours && matches!(reply, Reply::Hello(_))) {
            let silent = silence > 0 && now - self.heard >= silence;
            let free = ours || !open || silent || command == Command::Hello { take_over: true };
            (self.session, self.last, self.heard) = (Some((session, command != Command::Close)), id, now);
            return free && hello == matches!(reply, Reply::Hello(_));
        }
        match reply {
            Reply::Accepted => stop || command == Command::Close,
            Reply::Status(_) => command == Command::Status,
            Reply::Refused(Refusal::Stale { .. }) => ours && order < 0 && !stop,
            Reply::Refused(Refusal::Session) => !stop && !hello && command != Command::Status,
            Reply::Refused(Refusal::Occupied { free_in_ms }) => {
                let left = (silence > 0).then(|| silence.saturating_sub(now - self.heard) as u32);
                !ours && open && command == Command::Hello { take_over: false } && *free_in_ms == left
            }
            _ => false,
        }
    }
}

#[derive(Default, Debug)]
struct Tally {
    accepted: usize,
    refused: usize,
    committed: usize,
    jobs: usize,
    skipped: usize,
    lost: usize,
    conditioned: usize,
}

fn run(seed: u64, tally: &mut Tally) {
    let mut random = Random::new(seed);
    let action = if random.once_in(2) { LossAction::Hold } else { LossAction::Finish };
    let silence = if random.once_in(4) { Silence { after_ms: 0, action } } else { Silence { after_ms: 400, action } };
    let mut robot = Robot::default();
    let mut server = Server::new(Store::open(&robot.flash), silence);
    let mut port = server.port();
    let (mut now, mut session, mut id) = (0u64, 9, 0u32);
    let blob = if random.once_in(2) { BLOB } else { OTHER };
    // A transfer in one go now and then, so that commits happen.
    let mut script: Vec<Command> = Vec::new();
    let mut active = server.store().active();
    let mut staged = some_conditions(&mut random);
    let mut all_staged = vec![staged.clone()];
    let (mut come, mut conditioned) = (0, None);
    let mut rules = Rules::default();
    for _ in 0..400 {
        let next = server.store().transfer().map_or(0, |t| t.next as usize);
        if script.is_empty() && random.once_in(60) {
            script.extend([Command::Neutral, Command::BlobCommit]);
            let chunks = blob.chunks(240).enumerate().rev();
            script.extend(
                chunks.map(|(i, c)| Command::BlobChunk { offset: 240 * i as u32, bytes: c.iter().copied().collect() }),
            );
            let begin = Command::BlobBegin { length: blob.len() as u32, crc32: crc(blob) };
            script.extend([begin, Command::Stop, Command::Hello { take_over: true }]);
            session = random.bits() as u32;
        }
        // And conditions with a request that they belong to.
        if script.is_empty() && random.once_in(60) {
            let text = "a person bows".try_into().unwrap();
            script.push(Command::Generate(Generate { conditions: true, ..Generate::new(text) }));
            let chunks = staged.chunks(240).enumerate().rev();
            script.extend(
                chunks.map(|(i, c)| Command::ConditionsChunk {
                    offset: 240 * i as u32,
                    bytes: c.iter().copied().collect(),
                }),
            );
            let begin = Command::ConditionsBegin { length: staged.len() as u32, crc32: crc(&staged) };
            script.extend([begin, Command::Stop, Command::Hello { take_over: true }]);
            session = random.bits() as u32;
        }
        let rare = if script.is_empty() { 1 } else { 40 };
        let command = script.pop().unwrap_or_else(|| command(&mut random, (blob, next), (&staged, come)));
        if !random.once_in(20 * rare) {
            id = id.wrapping_add(1);
        }
        if random.once_in(100 * rare) {
            session = random.below(3) as u32;
        }
        let mut header = Header::new(session, id);
        if random.once_in(50 * rare) {
            header.version = random.bits() as u8;
        }
        if random.once_in(50 * rare) {
            header.id = random.bits() as u32;
        }
        let mut buffer = [0; REQUEST_BYTES];
        let mut message = postcard::to_slice(&(header, &command), &mut buffer).unwrap().to_vec();
        // Below the checksum...
        if random.once_in(6 * rare) {
            mutate(&mut message, &mut random);
        }
        message.truncate(REQUEST_BYTES - 4);
        let mut buffer = [0; REQUEST_FRAME];
        let mut frame = encode(&Raw(&message), &mut buffer).unwrap().to_vec();
        // ... and above it.
        if random.once_in(8 * rare) {
            mutate(&mut frame, &mut random);
            // What is left of it ends here, so that every answer is one to this message.
            frame.push(0);
        }
        let mut line = Line::default();
        let mut rest = &frame[..];
        while !rest.is_empty() {
            let (part, behind) = rest.split_at(1 + random.below(rest.len()));
            server.receive(&mut port, now, part, &mut robot, &mut line);
            rest = behind;
        }
        for (header, reply) in replies(&line.0) {
            let after = u64::from(silence.after_ms);
            assert!(rules.allow(&message, &reply, now, after), "seed {seed}: {header:?} {reply:?}");
        }
        if random.once_in(3) {
            now += random.below(300) as u64;
            robot.advance();
            server.poll(now, &mut robot, &mut line);
            let silent =
                rules.session.is_some() && silence.after_ms > 0 && now - rules.heard >= silence.after_ms.into();
            let plays = robot.condition.state == State::Playing;
            assert!(!(silent && plays && action == LossAction::Hold), "seed {seed}: plays without its host");
            let lost = replies(&line.0).iter().any(|(_, reply)| matches!(reply, Reply::Event(Event::HostLost(_))));
            assert!(silent || !lost, "seed {seed}: its host is not lost");
        }

        for (_, reply) in replies(&line.0) {
            match reply {
                Reply::Refused(refusal) => {
                    assert!(!refusal.to_string().is_empty());
                    tally.refused += 1;
                }
                Reply::Committed(_) => tally.committed += 1,
                Reply::Event(Event::HostLost(_)) => tally.lost += 1,
                Reply::Status(status) => {
                    come = status.staged.map_or(0, |staged| staged.next as usize);
                    tally.accepted += 1;
                }
                Reply::Chunk { next }
                    if matches!(command, Command::ConditionsBegin { .. } | Command::ConditionsChunk { .. }) =>
                {
                    come = next as usize;
                    tally.accepted += 1;
                }
                _ => tally.accepted += 1,
            }
        }
        if let (Some(request), Some(work)) = (&robot.last, robot.condition.work)
            && request.conditions
            && conditioned != Some(work.job)
        {
            // The robot has opened them; they are what was sent, now or for a request before.
            let area: &[u8] = bytemuck::cast_slice(&robot.area);
            assert!(all_staged.iter().any(|staged| area.starts_with(staged)), "seed {seed}: other conditions");
            conditioned = Some(work.job);
            tally.conditioned += 1;
            staged = some_conditions(&mut random);
            all_staged.push(staged.clone());
        }
        let transfer = server.store().transfer();
        assert!(transfer.is_none() || !robot.condition.state.moves(), "seed {seed}: moves while flash is written");
        assert!(transfer.is_none() || robot.condition.work.is_none(), "seed {seed}: works while flash is written");
        if server.store().active() != active {
            active = server.store().active();
            let bytes = server.store().bytes(&robot.flash).unwrap();
            assert!(bytes == blob && Model::open(bytes).is_ok(), "seed {seed}: an unverified blob is active");
        }
    }
    // What is in flash says the same as what is in memory.
    assert_eq!(Store::open(&robot.flash).active(), active, "seed {seed}");
    tally.jobs += robot.jobs.len();
    tally.skipped += port.skipped().total() as usize;
}

fn mutate(bytes: &mut Vec<u8>, random: &mut Random) {
    for _ in 0..1 + random.below(3) {
        let at = random.below(bytes.len().max(1));
        match random.below(5) {
            0 => bytes.insert(at.min(bytes.len()), random.bits() as u8),
            1 if !bytes.is_empty() => drop(bytes.remove(at)),
            2 => bytes.truncate(at),
            3 if !bytes.is_empty() => bytes[at] = [0, 1, 0x7F, 0x80, 0xFF][random.below(5)],
            _ if !bytes.is_empty() => bytes[at] ^= 1 << random.below(8),
            _ => {}
        }
    }
}

#[test]
fn nothing_panics_and_the_rules_hold() {
    let mut tally = Tally::default();
    for seed in 0..400 {
        run(seed, &mut tally);
    }
    // The fuzzer gets everywhere.
    let Tally { accepted, refused, committed, jobs, skipped, lost, conditioned } = tally;
    assert!(accepted > 20_000 && refused > 20_000, "{tally:?}");
    assert!(committed > 100 && jobs > 1000 && skipped > 1000 && lost > 100, "{tally:?}");
    assert!(conditioned > 100, "{tally:?}");
}

/// Owned tracks, obstacles and spans, of any numbers.
#[derive(Default)]
struct Owned {
    positions: Vec<Vec<[f32; 3]>>,
    masks: Vec<Option<Vec<u8>>>,
    keyframes: Vec<Vec<Keyframe>>,
    spans: Vec<(String, Vec<f32>)>,
    vector: Option<Vec<f32>>,
}

/// Conditions of up to a few kilobytes into `use_them`.
fn with_conditions<R>(random: &mut Random, use_them: impl FnOnce(&Given<'_>) -> R) -> R {
    fn number(random: &mut Random) -> f32 {
        f32::from_bits(random.bits() as u32)
    }
    fn place(random: &mut Random) -> [f32; 3] {
        std::array::from_fn(|_| number(random))
    }
    let mut some = Owned::default();
    let (tracks, obstacles) = (random.below(4), random.below(4));
    for _ in 0..tracks {
        let count = random.below(40);
        some.positions.push((0..count).map(|_| place(random)).collect());
        let mask = random.bytes(count);
        some.masks.push(random.once_in(2).then_some(mask));
    }
    for _ in 0..obstacles {
        let frame = |random: &mut Random| Keyframe { frame: random.bits() as u16, position: place(random) };
        some.keyframes.push((0..random.below(9)).map(|_| frame(random)).collect());
    }
    for _ in 0..random.below(4) {
        let text = (0..random.below(97)).map(|_| char::from(random.bits() as u8)).collect();
        some.spans.push((text, (0..random.below(9)).map(|_| number(random)).collect()));
    }
    let width = 1 + random.below(64);
    some.vector = random.once_in(2).then(|| (0..width).map(|_| number(random)).collect());
    let tracks: Vec<Track<'_>> = some
        .positions
        .iter()
        .zip(&some.masks)
        .map(|(positions, mask)| Track {
            joint: random.bits() as u8,
            first: random.bits() as u16,
            axes: std::array::from_fn(|_| random.once_in(2)),
            mask: mask.as_deref(),
            positions,
            tolerance: number(random),
        })
        .collect();
    let obstacles: Vec<Obstacle<'_>> = some
        .keyframes
        .iter()
        .map(|keyframes| {
            let shape = match random.below(5) {
                0 => Shape::Sphere { radius: number(random) },
                1 => Shape::Capsule { half: place(random), radius: number(random) },
                2 => Shape::Cylinder { radius: number(random), half_height: number(random) },
                3 => Shape::Box { half: place(random) },
                _ => Shape::Plane { normal: place(random) },
            };
            let course = match random.below(3) {
                0 => Course::Still(place(random)),
                1 => Course::Moving { from: place(random), velocity: place(random) },
                _ => Course::Keyframes(keyframes),
            };
            Obstacle { shape, course, margin: number(random), joints: random.bits() as u32 }
        })
        .collect();
    let timeline: Vec<Span<'_>> = some
        .spans
        .iter()
        .map(|(text, vector)| {
            let prompt = match random.below(3) {
                0 => Prompt::Text(text),
                1 => Prompt::Bank(text),
                _ => Prompt::Vector(vector),
            };
            let parts = BodyParts::from_bits(random.bits() as u8 % 64).unwrap_or(BodyParts::UPPER_BODY);
            Span { parts, first: random.bits() as u16, frames: random.bits() as u16, prompt }
        })
        .collect();
    use_them(&Given { tracks: &tracks, obstacles: &obstacles, timeline: &timeline, vector: some.vector.as_deref() })
}

fn some_conditions(random: &mut Random) -> Vec<u8> {
    loop {
        let bytes = with_conditions(random, sent);
        if bytes.len() <= CONDITION_BYTES {
            return bytes;
        }
    }
}

fn words(bytes: &[u8]) -> Vec<u32> {
    bytes.chunks_exact(4).map(|four| u32::from_le_bytes(four.try_into().unwrap())).collect()
}

/// Bit for bit what was given comes out, and of what was damaged either conditions come out that say the same again, or none.
#[test]
fn conditions_there_and_back_and_damaged() {
    let (mut opened, mut refused) = (0, 0);
    for seed in 0..3000 {
        let mut random = Random::new(seed);
        let mut bytes = with_conditions(&mut random, |given| {
            let bytes = sent(given);
            let area = words(&bytes);
            let conditions = Conditions::open(&area).unwrap_or_else(|fault| panic!("seed {seed}: {fault}"));
            let keyframes = conditions.keyframes();
            let (tracks, obstacles) = (conditions.tracks(), conditions.obstacles(&keyframes));
            let (timeline, vector) = (conditions.timeline(), conditions.vector());
            let back = Given { tracks: &tracks, obstacles: &obstacles, timeline: &timeline, vector };
            // Numbers may be none: their bits are compared.
            assert_eq!(sent(&back), bytes, "seed {seed}");
            assert_eq!(format!("{back:?}"), format!("{given:?}"), "seed {seed}");
            bytes
        });
        for _ in 0..20 {
            if random.once_in(4) {
                mutate(&mut bytes, &mut random);
            } else if !bytes.is_empty() {
                let at = random.below(bytes.len().min(64));
                bytes[at] = [0, 1, 2, 24, 25, 0x7F, 0xFF][random.below(7)];
            }
            if random.once_in(2) && bytes.len() >= 4 {
                let length = (bytes.len() as u32) & !3;
                bytes[..4].copy_from_slice(&length.to_le_bytes());
            }
            let area = words(&bytes);
            let Ok(conditions) = Conditions::open(&area) else {
                refused += 1;
                continue;
            };
            opened += 1;
            let keyframes = conditions.keyframes();
            let (tracks, obstacles) = (conditions.tracks(), conditions.obstacles(&keyframes));
            assert!(tracks.len() <= MAX_TRACKS && obstacles.len() <= MAX_OBSTACLES && keyframes.len() <= KEYFRAMES);
            let (timeline, vector) = (conditions.timeline(), conditions.vector());
            assert!(timeline.len() <= MAX_SPANS);
            let again = sent(&Given { tracks: &tracks, obstacles: &obstacles, timeline: &timeline, vector });
            assert_eq!(again.len(), conditions.bytes(), "seed {seed}");
            // Other keyframes than its own are of no harm.
            let _ = conditions.obstacles(&keyframes[keyframes.len() / 2..]);
        }
    }
    assert!(opened > 1000 && refused > 10_000, "{opened} opened, {refused} refused");
}

/// Frames come late, twice, in the wrong order, or not at all: no request is executed twice, and none behind a later one.
#[test]
fn every_request_once_and_in_order() {
    for seed in 0..300 {
        let mut random = Random::new(seed);
        let mut robot = Robot::default();
        let mut server = Server::new(Store::open(&robot.flash), SILENCE);
        let mut port = server.port();
        let mut line = Line::default();
        let mut buffer = [0; REQUEST_FRAME];
        let hello = encode(&(Header::new(4, 1), Command::Hello { take_over: false }), &mut buffer).unwrap();
        server.receive(&mut port, 0, hello, &mut robot, &mut line);
        let mut window: Vec<Vec<u8>> = Vec::new();
        for id in 2..200 {
            let command = if random.once_in(2) { Command::SelfTest } else { generate(&mut random) };
            let frame = encode(&(Header::new(4, id), command), &mut buffer).unwrap().to_vec();
            for _ in 0..random.below(4) {
                window.push(frame.clone());
            }
            while window.len() > 3 {
                let chosen = random.below(window.len());
                server.receive(&mut port, 0, &window.swap_remove(chosen), &mut robot, &mut line);
                robot.advance();
            }
        }
        assert!(robot.jobs.len() > 10 && robot.jobs.is_sorted_by(|a, b| a < b), "seed {seed}: {:?}", robot.jobs);
    }
}
