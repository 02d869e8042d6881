//! The simulated robot behind its port: everything a host does with a board, without one.

use std::io::{BufRead, BufReader, Write};
use std::net::TcpStream;
use std::ops::ControlFlow;
use std::process::{Child, Command as Process, Stdio};
use std::time::{Duration, Instant};

use motionette::Model;
use motionette::blob::Header;
use motionette_host::blob::AlignedBlob;
use motionette_host::device::{self, Client, Error, Options};
use motionette_link::message::{
    Anchor, Command, Event, FlashFault, Generate, Hello, Length, LossAction, Measure, Refusal, Start, State, Status,
    Target, UpdateFault,
};
use motionette_sim::default_model;

/// A server that ends with the test.
struct Served {
    process: Child,
    port: String,
}

impl Served {
    fn start(arguments: &[&str]) -> Self {
        let mut process = Process::new(env!("CARGO_BIN_EXE_motionette-sim"))
            .args(["serve", "--port", "0"])
            .args(arguments)
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .expect("the simulator starts");
        let mut line = String::new();
        BufReader::new(process.stdout.take().expect("piped")).read_line(&mut line).expect("it says where it is");
        let port = line.split_whitespace().find(|word| word.starts_with("tcp:")).expect("a port").to_owned();
        Served { process, port }
    }

    /// A host. The first one may come before the robot stands and before the self-test has ended, without which there is no model.
    fn host(&self) -> (Client<Box<dyn device::Transport>>, Hello) {
        for _ in 0..200 {
            let device = Client::new(self.line(), Options::default()).status().expect("a status").device;
            let (client, hello) = self.connect(Options::default()).expect("hello");
            if !device.start.is_under_way()
                && device.state != State::Returning
                && (hello.model.is_some() || hello.blob.is_none())
            {
                return (client, hello);
            }
            std::thread::sleep(Duration::from_millis(50));
        }
        panic!("the model does not prove itself");
    }

    fn line(&self) -> Box<dyn device::Transport> {
        device::open(&self.port, 115_200).expect("the port")
    }

    fn connect(&self, options: Options) -> Result<(Client<Box<dyn device::Transport>>, Hello), Error> {
        Client::connect(self.line(), options)
    }

    /// A bare connection.
    fn stream(&self) -> TcpStream {
        TcpStream::connect(self.port.strip_prefix("tcp:").expect("TCP")).expect("a connection")
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
}

/// Sees and wants nothing.
fn watch(_: &Status) -> ControlFlow<()> {
    ControlFlow::Continue(())
}

fn wave(frames: u16, play: bool) -> Generate {
    let text = "a person waves the right hand".try_into().expect("short");
    Generate { length: Length::Frames(frames), seed: 2, play_when_ready: play, ..Generate::new(text) }
}

fn state_becomes(client: &mut Client<Box<dyn device::Transport>>, wanted: State) {
    let begun = Instant::now();
    loop {
        let state = client.status().expect("a status").device.state;
        if state == wanted {
            return;
        }
        assert!(begun.elapsed() < Duration::from_secs(20), "{state:?} instead of {wanted:?}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// The refusal, if it is one.
fn refusal(result: Result<motionette_link::Reply, Error>) -> Option<Refusal> {
    match result {
        Err(Error::Refused(refusal)) => Some(refusal),
        _ => None,
    }
}

fn refused(result: Result<motionette_link::Reply, Error>) -> Refusal {
    refusal(result).expect("a refusal")
}

#[test]
fn motions_are_made_played_held_and_stopped() {
    let served = Served::start(&[]);
    let (mut client, hello) = served.host();
    assert_eq!((hello.preset.as_str(), hello.model.map(|m| m.frames)), ("upper-body", Some(196)));
    assert_eq!(client.self_test().expect("a self-test"), Some(true));
    assert_eq!(refused(client.request(&Command::Play)), Refusal::NothingToPlay);

    let made = client.generate(&wave(40, false), &mut watch).expect("a motion");
    assert_eq!((made.frames, made.control_error), (40, None));
    client.request(&Command::Play).expect("it plays");
    state_becomes(&mut client, State::Playing);
    // The next motion is made while this one plays.
    let made = client.generate(&wave(60, true), &mut watch).expect("a motion while one plays");
    assert_eq!(made.frames, 60);
    client.request(&Command::Hold).expect("it holds");
    state_becomes(&mut client, State::Holding);
    client.request(&Command::Resume).expect("it goes on");
    state_becomes(&mut client, State::Playing);
    client.tell(&Command::Stop).expect("it stops");
    state_becomes(&mut client, State::Stopped);
    assert_eq!(refused(client.request(&Command::Play)), Refusal::Stopped);
    client.request(&Command::Neutral).expect("it may move again");
    state_becomes(&mut client, State::Neutral);
    let status = client.status().expect("a status");
    assert_eq!((status.device.missed_ticks, status.device.bus_faults, status.unsent), (0, 0, 0));

    // The anchor that strains the motion most is named: one in the way of the motion, one that no body of this size can reach.
    let root = Anchor { frame: 0, target: Target::PlanarRoot([0.0, 0.0]) };
    let away = Anchor { frame: 20, target: Target::Joint { joint: 20, position: [30.0, 20.0, 0.0] } };
    let anchored = Generate { anchors: [root, away].into_iter().collect(), ..wave(40, false) };
    let made = client.generate(&anchored, &mut watch).expect("a motion");
    let (mean, strain) = (made.control_error.expect("anchors"), made.strain.expect("anchors"));
    assert_eq!((strain.measure, strain.anchor), (Measure::STRAIN, 1));
    assert!(strain.value > 1.0 && mean > 1.0, "{mean} {strain:?}");

    // A request that cannot be met is told why.
    let text = "xyzzy".try_into().expect("short");
    assert!(client.generate(&Generate::new(text), &mut watch).is_err());
}

#[test]
fn a_stop_ends_the_work_at_once() {
    let served = Served::start(&[]);
    let (mut client, _) = served.host();
    let mut long = wave(196, true);
    long.steps = 400;
    client.request(&Command::Generate(long)).expect("it begins");
    client.tell(&Command::Stop).expect("it stops");
    let begun = Instant::now();
    let failed = loop {
        match client.event(Duration::from_millis(200)).expect("the line works") {
            Some(Event::Failed { .. }) => break true,
            Some(Event::Ready { .. }) => break false,
            _ => assert!(begun.elapsed() < Duration::from_secs(20), "the work does not end"),
        }
    };
    assert!(failed, "the motion was made all the same");
}

#[test]
fn a_new_blob_replaces_the_old_one_only_when_it_is_whole() {
    let folder = tempfile::tempdir().expect("a folder");
    let flash = folder.path().join("flash.bin");
    let arguments = ["--flash", flash.to_str().expect("a path")];
    let blob = default_model::BOARD_BLOB;
    {
        let served = Served::start(&arguments);
        let (mut client, hello) = served.host();
        let before = hello.blob.expect("the built-in model");
        // The host goes away in the middle.
        client.request(&Command::BlobBegin { length: blob.len() as u32, crc32: 7 }).expect("it begins");
        let bytes = blob[..240].try_into().expect("a chunk");
        client.request(&Command::BlobChunk { offset: 0, bytes }).expect("taken");
        assert!(matches!(refused(client.request(&Command::Play)), Refusal::Transferring { .. }));
        drop(client);
        // A damaged one is refused.
        let (mut client, hello) = served.host();
        assert_eq!(hello.blob, Some(before));
        let mut damaged = blob.to_vec();
        damaged[100_000] ^= 1;
        assert!(client.send_blob(&damaged, &mut |_| ()).is_err());
        drop(client);
        let (mut client, hello) = served.host();
        assert_eq!(hello.blob, Some(before));
        assert_eq!(client.self_test().expect("the old model works"), Some(true));
        let after = client.send_blob(blob, &mut |_| ()).expect("the whole one is taken");
        assert_eq!((after.slot, after.sequence), (1 - before.slot, before.sequence + 1));
    }
    // It is there after a restart, and makes motions.
    let served = Served::start(&arguments);
    let (mut client, hello) = served.host();
    assert_eq!(hello.blob.map(|blob| blob.sequence), Some(2));
    assert_eq!(client.generate(&wave(40, false), &mut watch).expect("a motion").frames, 40);
}

#[test]
fn without_a_blob_nothing_moves_until_one_is_sent() {
    let served = Served::start(&["--empty", "--pico2", "--robot", "desk"]);
    let (mut client, hello) = served.host();
    assert_eq!((hello.model, hello.blob), (None, None));
    assert_eq!(refused(client.request(&Command::Generate(wave(40, true)))), Refusal::NoModel);
    client.send_blob(default_model::BOARD_BLOB, &mut |_| ()).expect("a blob");
    drop(client);
    let (mut client, hello) = served.host();
    assert!(hello.model.is_some());
    // What is left open is made as a Pico 2 would.
    let text = "a person walks forward".try_into().expect("short");
    let open = Generate { steps: 0, evaluations: 0, ..Generate::new(text) };
    assert_eq!(client.generate(&open, &mut watch).expect("a motion").frames, 80);
}

/// What a second host does while the first plays a motion: it looks, it is told to wait, and the first notices nothing.
#[test]
fn another_host_does_not_disturb_the_one_that_plays() {
    let served = Served::start(&[]);
    let (mut client, _) = served.host();
    let made = client.generate(&wave(60, true), &mut watch).expect("a motion");
    assert_eq!(made.understood.map(|it| it.phrase.to_string()), Some("a person waves their right hand".to_owned()));
    let mut asked = 0;
    let state = client.wait_for_motion(&mut |_| {
        match served.connect(Options::default()).err() {
            Some(Error::Refused(Refusal::Occupied { free_in_ms: Some(4000..=5000) })) => asked += 1,
            other => panic!("{other:?}"),
        }
        let status = Client::new(served.line(), Options::default()).status().expect("a status");
        assert_eq!(status.device.start, Start::Ready);
        ControlFlow::Continue(())
    });
    // The preset rests in its neutral pose.
    assert!(matches!(state, Ok(State::Neutral)) && asked > 5, "{state:?}, {asked}");

    // One that insists gets it, and when it leaves, it leaves the robot to the next.
    let insists = Options { take_over: true, ..Options::default() };
    let (mut second, _) = served.connect(insists).expect("taken over");
    assert_eq!(refused(client.request(&Command::KeepAlive)), Refusal::Session);
    assert!(served.connect(Options::default()).is_err());
    second.close();
    let (third, _) = served.connect(Options::default()).expect("left to it");
    drop(third);
    served.connect(Options::default()).expect("its connection is closed");
}

/// Hosts that ask and do not read, that say nothing, that say nonsense: whoever stops the robot is heard at once.
#[test]
fn hosts_that_misbehave_keep_nobody_from_stopping() {
    let served = Served::start(&[]);
    let (mut client, _) = served.host();
    client.generate(&wave(196, true), &mut watch).expect("a motion of 9.8 s");
    state_becomes(&mut client, State::Playing);
    let mut deaf = served.stream();
    deaf.set_nonblocking(true).expect("a socket");
    // A status of session 0x1234, again and again, until nothing more goes out for a while.
    let status = [0x00, 0x0A, 0x02, 0xB4, 0x24, 0x05, 0x07];
    let sum = !motionette::blob::crc32(!0, &status[2..]);
    let frame = [&status[..], &sum.to_le_bytes(), &[0]].concat();
    assert!(!sum.to_le_bytes().contains(&0), "COBS as it stands");
    let frames = frame.repeat(1000);
    let begun = Instant::now();
    let (mut sent, mut last) = (0, Instant::now());
    while last.elapsed() < Duration::from_millis(300) && begun.elapsed() < Duration::from_secs(3) {
        match deaf.write(&frames[sent % frame.len()..]) {
            Ok(count) => (sent, last) = (sent + count, Instant::now()),
            Err(_) => std::thread::sleep(Duration::from_millis(5)),
        }
    }
    assert!(sent > 1_000_000, "{sent} bytes were not answered");
    let silent = served.stream();
    let mut noisy = served.stream();
    noisy.write_all(&[0x55; 100_000]).expect("noise");
    // More than there is room for: the first of them go, and not the host with the session.
    let crowd: Vec<_> = (0..40).map(|_| served.stream()).collect();
    assert!(client.status().expect("the session goes on").device.state.moves());

    let patience = Options { wait: Duration::from_secs(2), attempts: 1, ..Options::default() };
    Client::new(served.line(), patience).tell(&Command::Stop).expect("it stops");
    state_becomes(&mut client, State::Stopped);
    drop((deaf, silent, noisy, crowd));
}

/// What a run of the simulator that cannot begin says.
fn fails(arguments: &[&str]) -> String {
    let output = Process::new(env!("CARGO_BIN_EXE_motionette-sim"))
        .args(["serve", "--port", "0"])
        .args(arguments)
        .output()
        .expect("the simulator starts");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.starts_with("error: ") && !said.contains("panicked"), "{said}");
    said
}

#[test]
fn a_flash_file_is_recognised_before_it_is_touched() {
    let folder = tempfile::tempdir().expect("a folder");
    let thesis = folder.path().join("thesis.txt");
    std::fs::write(&thesis, "years of work").expect("written");
    let said = fails(&["--flash", thesis.to_str().expect("a path")]);
    assert!(said.contains("thesis.txt") && said.contains("13 bytes"), "{said}");
    assert_eq!(std::fs::read(&thesis).expect("still there"), b"years of work");
    assert!(fails(&["--flash", folder.path().to_str().expect("a path")]).contains("no regular file"));
    // Where nothing can be written, that is said before a host has sent anything.
    let blocked = thesis.join("flash.bin");
    assert!(fails(&["--flash", blocked.to_str().expect("a path")]).contains("flash.bin"));
}

/// The place of the flash file is lost while the simulator runs: the blob is refused, and everything goes on.
#[test]
fn a_flash_file_that_cannot_be_written_any_more_costs_the_blob_only() {
    let folder = tempfile::tempdir().expect("a folder");
    let place = folder.path().join("place");
    let flash = place.join("flash.bin");
    let served = Served::start(&["--flash", flash.to_str().expect("a path")]);
    let (mut client, hello) = served.host();
    std::fs::rename(&place, folder.path().join("elsewhere")).expect("moved");
    std::fs::write(&place, "in the way").expect("written");
    let error = client.send_blob(default_model::BOARD_BLOB, &mut |_| ()).expect_err("it cannot be kept");
    assert!(matches!(error, Error::Refused(Refusal::Update(UpdateFault::Flash(FlashFault::Device)))), "{error:?}");
    drop(client);
    let (mut client, after) = served.host();
    assert_eq!(after.blob, hello.blob);
    assert_eq!(client.generate(&wave(40, false), &mut watch).expect("a motion").frames, 40);
}

#[test]
fn a_stopped_robot_makes_no_motion_that_it_cannot_play() {
    let served = Served::start(&[]);
    let (mut client, _) = served.host();
    client.tell(&Command::Stop).expect("it stops");
    assert_eq!(refused(client.request(&Command::Generate(wave(40, true)))), Refusal::Stopped);
    client.request(&Command::Neutral).expect("it may move again");
    state_becomes(&mut client, State::Neutral);
    client.generate(&wave(40, true), &mut watch).expect("a motion");
    assert!(matches!(client.wait_for_motion(&mut watch), Ok(State::Neutral)));
}

/// Servos that cannot say where they stand get no pulses, and nothing is played, until somebody says that the robot is in its place.
#[test]
fn a_robot_that_waits_for_its_release_says_so_and_plays_nothing() {
    let served = Served::start(&["--unreleased"]);
    let (mut client, _) = served.host();
    let begun = Instant::now();
    while client.status().expect("a status").device.start != Start::Waiting {
        assert!(begun.elapsed() < Duration::from_secs(20), "it does not wait");
        std::thread::sleep(Duration::from_millis(20));
    }
    let waits = Refusal::NotReady(Start::Waiting);
    assert_eq!(refused(client.request(&Command::Generate(wave(40, true)))), waits);
    client.generate(&wave(40, false), &mut watch).expect("made all the same");
    assert_eq!(refused(client.request(&Command::Play)), waits);
    // A stop outlasts everything but its own end.
    client.tell(&Command::Stop).expect("it stops");
    assert_eq!(refused(client.request(&Command::Release)), Refusal::Stopped);
    client.tell(&Command::Neutral).expect("it may move again");
    while client.event(Duration::from_millis(50)).expect("the line works").is_some() {}
    client.tell(&Command::Release).expect("it is released");
    let mut starts = Vec::new();
    while starts.last() != Some(&Start::Ready) {
        assert!(begun.elapsed() < Duration::from_secs(30), "{starts:?}");
        if let Some(Event::Start(start)) = client.event(Duration::from_millis(200)).expect("the line works") {
            starts.push(start);
        }
    }
    client.wait_for_rest(&mut watch).expect("it gets there");
    let status = client.status().expect("a status");
    assert_eq!((status.device.start, status.device.state), (Start::Ready, State::Neutral));
    assert_eq!(refused(client.request(&Command::Release)), Refusal::NotWaiting);
    client.generate(&wave(40, true), &mut watch).expect("a motion");
    client.wait_for_motion(&mut watch).expect("it plays");
}

/// The built-in model with another hash in its self-test: a blob in every other respect.
fn of_other_bits() -> Vec<u8> {
    let mut blob = default_model::BOARD_BLOB.to_vec();
    let model = AlignedBlob::new(&blob);
    let hash = Model::open(model.bytes()).expect("the built-in model").self_test().hash;
    let mut room = [0; 10];
    let written = postcard::to_slice(&hash, &mut room).expect("a number");
    let at = blob.windows(written.len()).position(|bytes| bytes == written).expect("it stands in the manifest");
    blob[at] ^= 1;
    // The checksum, so that nothing else is wrong.
    let checksum = Header::checksum(&blob);
    blob[24..28].copy_from_slice(&checksum.to_le_bytes());
    blob
}

#[test]
fn a_model_that_makes_other_bits_than_it_says_does_not_move_the_robot() {
    let served = Served::start(&[]);
    let (mut client, hello) = served.host();
    assert!(hello.model.is_some());
    client.send_blob(&of_other_bits(), &mut |_| ()).expect("whole, and a model");
    let begun = Instant::now();
    while refusal(client.request(&Command::Generate(wave(40, true)))) != Some(Refusal::NoModel) {
        assert!(begun.elapsed() < Duration::from_secs(20), "the robot would move");
        std::thread::sleep(Duration::from_millis(20));
    }
    assert_eq!(client.status().expect("a status").device.state, State::Holding);
    // The right one is taken again.
    client.send_blob(default_model::BOARD_BLOB, &mut |_| ()).expect("the right one");
    drop(client);
    let (mut client, hello) = served.host();
    assert!(hello.model.is_some());
    assert_eq!(client.generate(&wave(40, false), &mut watch).expect("a motion").frames, 40);
}

#[test]
fn a_host_that_is_gone_is_missed_as_the_robot_is_configured() {
    let folder = tempfile::tempdir().expect("a folder");
    let preset = motionette_host::robot_file::preset("upper-body").expect("a preset").text;
    let body = preset.lines().filter(|line| !line.starts_with("finish_without_host")).collect::<Vec<_>>().join("\n");
    for (finish, state, action) in
        [(false, State::Holding, LossAction::Hold), (true, State::Playing, LossAction::Finish)]
    {
        let path = folder.path().join(format!("{finish}.toml"));
        std::fs::write(&path, format!("finish_without_host = {finish}\n{body}")).expect("written");
        let served = Served::start(&["--robot", path.to_str().expect("a path")]);
        let (mut client, hello) = served.host();
        assert_eq!(hello.limits.on_silence, action);
        client.generate(&wave(196, true), &mut watch).expect("a motion of 9.8 s");
        state_becomes(&mut client, State::Playing);
        drop(client);
        std::thread::sleep(Duration::from_millis(u64::from(hello.limits.silence_ms) + 800));
        let (mut client, _) = served.host();
        let status = client.status().expect("a status");
        assert_eq!((status.device.state, status.host_lost), (state, Some(action)));
    }
}
