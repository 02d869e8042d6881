//! The simulated robot behind its port: everything a host does with a board, without one.

use std::io::{BufRead, BufReader};
use std::process::{Child, Command as Process, Stdio};
use std::time::{Duration, Instant};

use motionette::Model;
use motionette::blob::Header;
use motionette_host::blob::AlignedBlob;
use motionette_host::device::{self, Client, Error, Options};
use motionette_link::message::{Command, Event, Generate, Hello, Length, LossAction, Refusal, State};
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

    /// A host. The first one may come before the self-test has ended, without which there is no model.
    fn host(&self) -> (Client<Box<dyn device::Transport>>, Hello) {
        let open = || {
            Client::connect(device::open(&self.port, 115_200).expect("the port"), Options::default()).expect("hello")
        };
        let (mut client, mut hello) = open();
        for _ in 0..200 {
            if hello.model.is_some() || hello.blob.is_none() {
                break;
            }
            std::thread::sleep(Duration::from_millis(50));
            (client, hello) = open();
        }
        (client, hello)
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        let _ = self.process.kill();
        let _ = self.process.wait();
    }
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

    let made = client.generate(&wave(40, false), &mut |_| ()).expect("a motion");
    assert_eq!((made.frames, made.control_error), (40, None));
    client.request(&Command::Play).expect("it plays");
    state_becomes(&mut client, State::Playing);
    // The next motion is made while this one plays.
    let made = client.generate(&wave(60, true), &mut |_| ()).expect("a motion while one plays");
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

    // A request that cannot be met is told why.
    let text = "xyzzy".try_into().expect("short");
    assert!(client.generate(&Generate::new(text), &mut |_| ()).is_err());
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
    let blob = default_model::BLOB;
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
    assert_eq!(client.generate(&wave(40, false), &mut |_| ()).expect("a motion").frames, 40);
}

#[test]
fn without_a_blob_nothing_moves_until_one_is_sent() {
    let served = Served::start(&["--empty", "--pico2", "--robot", "desk"]);
    let (mut client, hello) = served.host();
    assert_eq!((hello.model, hello.blob), (None, None));
    assert_eq!(refused(client.request(&Command::Generate(wave(40, true)))), Refusal::NoModel);
    client.send_blob(default_model::BLOB, &mut |_| ()).expect("a blob");
    let (mut client, hello) = served.host();
    assert!(hello.model.is_some());
    // What is left open is made as a Pico 2 would.
    let text = "a person walks forward".try_into().expect("short");
    let open = Generate { steps: 0, evaluations: 0, ..Generate::new(text) };
    assert_eq!(client.generate(&open, &mut |_| ()).expect("a motion").frames, 80);
}

/// The built-in model with another hash in its self-test: a blob in every other respect.
fn of_other_bits() -> Vec<u8> {
    let mut blob = default_model::BLOB.to_vec();
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
    client.send_blob(default_model::BLOB, &mut |_| ()).expect("the right one");
    let (mut client, hello) = served.host();
    assert!(hello.model.is_some());
    assert_eq!(client.generate(&wave(40, false), &mut |_| ()).expect("a motion").frames, 40);
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
        client.generate(&wave(196, true), &mut |_| ()).expect("a motion of 9.8 s");
        state_becomes(&mut client, State::Playing);
        drop(client);
        std::thread::sleep(Duration::from_millis(u64::from(hello.limits.silence_ms) + 800));
        let (mut client, _) = served.host();
        let status = client.status().expect("a status");
        assert_eq!((status.device.state, status.host_lost), (state, Some(action)));
    }
}
