//! `motionette device` from outside, against a robot of no body behind TCP and behind a serial port.

#[path = "../../link/tests/common/mod.rs"]
mod robot;

use std::io::{ErrorKind, Read, Write};
use std::net::TcpListener;
use std::path::Path;
use std::process::{Command, Output};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use motionette_link::message::{BlobFault, Feature, LossAction, Start, State, UpdateFault};
use motionette_link::server::{Port, Server, Silence};
use motionette_link::update::Store;
use robot::{Line, Robot};
use serde_json::Value;

/// A robot that answers on a line until it is dropped.
struct Served {
    robot: Arc<Mutex<Robot>>,
    end: Arc<AtomicBool>,
    port: String,
}

impl Drop for Served {
    fn drop(&mut self) {
        self.end.store(true, Ordering::Relaxed);
    }
}

impl Served {
    /// Behind TCP, one host after the other.
    fn on_tcp() -> Self {
        Self::start_with(Robot::default())
    }

    /// The same with this robot.
    fn start_with(robot: Robot) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let port = format!("tcp:{}", listener.local_addr().unwrap());
        Self::start(robot, port, move |serve, end| {
            while let Ok((mut stream, _)) = listener.accept() {
                stream.set_read_timeout(Some(Duration::from_millis(2))).unwrap();
                serve(&mut stream);
                if end.load(Ordering::Relaxed) {
                    break;
                }
            }
        })
    }

    /// Behind a pseudo terminal.
    #[cfg(unix)]
    fn on_serial() -> Self {
        use serialport::{SerialPort, TTYPort};
        let (mut master, slave) = TTYPort::pair().unwrap();
        let port = slave.name().unwrap();
        // Another process is to open it; until then, reading fails.
        drop(slave);
        master.set_timeout(Duration::from_millis(2)).unwrap();
        Self::start(Robot::default(), port, move |serve, end| {
            while !end.load(Ordering::Relaxed) {
                serve(&mut master);
                thread::sleep(Duration::from_millis(1));
            }
        })
    }

    fn start<S>(
        robot: Robot,
        port: String,
        serve: impl FnOnce(&mut dyn FnMut(&mut S), &AtomicBool) + Send + 'static,
    ) -> Self
    where
        S: Read + Write,
    {
        let robot = Arc::new(Mutex::new(robot));
        let end = Arc::new(AtomicBool::new(false));
        let (for_thread, ended) = (Arc::clone(&robot), Arc::clone(&end));
        thread::spawn(move || {
            let store = Store::open(&for_thread.lock().unwrap().flash);
            let mut server = Server::new(store, Silence { after_ms: 1000, action: LossAction::Hold });
            let mut port = server.port();
            let begin = Instant::now();
            serve(&mut |line: &mut S| converse(line, (&mut server, &mut port), &for_thread, begin, &ended), &ended);
        });
        Served { robot, end, port }
    }

    fn run(&self, folder: &Path, arguments: &[&str]) -> Output {
        let mut all = vec!["device", "--port", &self.port, "--json"];
        all.extend(arguments);
        Command::new(env!("CARGO_BIN_EXE_motionette")).args(all).current_dir(folder).output().unwrap()
    }

    fn succeeds(&self, arguments: &[&str]) -> Value {
        let output = self.run(Path::new("."), arguments);
        assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
        last_line(&output)
    }

    fn fails(&self, arguments: &[&str], words: &[&str]) {
        check_failure(&self.run(Path::new("."), arguments), words);
    }
}

/// Bytes to and from the server until the line closes.
fn converse(
    line: &mut (impl Read + Write),
    (server, port): (&mut Server, &mut Port),
    robot: &Mutex<Robot>,
    begin: Instant,
    end: &AtomicBool,
) {
    let mut buffer = [0; 300];
    let mut ticks = 0;
    while !end.load(Ordering::Relaxed) {
        let count = match line.read(&mut buffer) {
            Ok(0) => return,
            Ok(count) => count,
            Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock) => 0,
            Err(_) => return,
        };
        let mut out = Line::default();
        let now = begin.elapsed().as_millis() as u64;
        let mut robot = robot.lock().unwrap();
        server.receive(port, now, &buffer[..count], &mut *robot, &mut out);
        while ticks < now / 20 {
            ticks += 1;
            robot.advance();
        }
        server.poll(now, &mut *robot, &mut out);
        drop(robot);
        if line.write_all(&out.0).is_err() {
            return;
        }
    }
}

fn last_line(output: &Output) -> Value {
    let text = String::from_utf8(output.stdout.clone()).unwrap();
    serde_json::from_str(text.lines().last().unwrap()).unwrap()
}

fn check_failure(output: &Output, words: &[&str]) {
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.starts_with("error: ") && !said.contains("panicked"), "{said}");
    for word in words {
        assert!(said.contains(word), "{word:?} not in: {said}");
    }
    let error = last_line(output);
    assert!(error["error"].is_string() && error["causes"].is_array(), "{error}");
}

fn a_session(served: &Served) {
    let folder = tempfile::tempdir().unwrap();
    let hello = served.succeeds(&["hello"]);
    assert_eq!((&hello["preset"], &hello["model"]["frames"]), (&"table-top".into(), &196.into()));
    assert_eq!(hello["limits"]["on_silence"], "hold");
    served.fails(&["play"], &["no motion to play", "hint: ", "generate"]);

    let anchors = folder.path().join("anchors.json");
    std::fs::write(&anchors, r#"{"anchors": [{"time": 1.0, "root": [0.1, 0.9, 0.5]}]}"#).unwrap();
    let anchors = anchors.to_str().unwrap();
    let text = ["generate", "--text", "a person bows", "--seconds", "2.5", "--seed", "7"];
    let made = served.succeeds(&[&text[..], &["--anchors", anchors]].concat());
    assert_eq!((&made["frames"], &made["anchors"], &made["control_error_m"]), (&3.into(), &1.into(), &0.25.into()));
    assert_eq!((&made["understood"]["phrase"], &made["strain"]["anchor"]), (&"person bows".into(), &2.into()));
    let status = served.succeeds(&["status"]);
    assert_eq!((&status["state"], &status["outcome"]["event"]), (&"holding".into(), &"ready".into()));
    assert_eq!(served.succeeds(&["play"])["state"], "holding");
    assert_eq!(served.succeeds(&[&text[..], &["--play"]].concat())["played"]["state"], "holding");
    served.succeeds(&["self-test"]);
    served.fails(&["hold"], &["no motion to hold"]);
    served.succeeds(&["stop"]);
    served.fails(&["play"], &["was stopped", "hint: ", "neutral"]);
    assert_eq!(served.succeeds(&["neutral"])["state"], "neutral");
    let watched = served.succeeds(&["watch", "--seconds", "0.3"]);
    assert_eq!(watched["status"]["state"], "neutral");
    assert_eq!(served.robot.lock().unwrap().calls, ["start", "play", "start", "start", "stop", "neutral"]);
}

#[test]
fn everything_over_tcp() {
    let served = Served::on_tcp();
    a_session(&served);
    let blob = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/corpus/planner.blob");
    let sent = served.succeeds(&["send-blob", blob]);
    assert_eq!((&sent["sent"], &sent["blob"]["slot"]), (&true.into(), &0.into()));
    assert_eq!(served.succeeds(&["send-blob", blob])["sent"], false);
    assert_eq!(served.robot.lock().unwrap().activations, 1);
    let large = concat!(env!("CARGO_MANIFEST_DIR"), "/../models/nano.blob");
    served.fails(&["send-blob", large], &["does not fit", "15360"]);
    served.fails(&["send-blob", "none.blob"], &["none.blob", "hint: "]);
}

#[cfg(unix)]
#[test]
fn everything_over_a_serial_port() {
    a_session(&Served::on_serial());
}

/// Blobs that are whole, and that this firmware cannot run: what it lacks is said, before an update and after one.
#[test]
fn a_blob_that_needs_other_firmware() {
    let feature = BlobFault::NotLinked { feature: Feature::new("later-family") };
    let later = BlobFault::Unknown { major: 4, minor: 77 };
    let cures =
        [(feature, &["`later-family`", "hint: ", "Cargo.toml"][..]), (later, &["format 4.77", "hint: ", "update"])];
    for (fault, words) in cures {
        let served = Served::on_tcp();
        let blob = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/corpus/planner.blob");
        served.succeeds(&["send-blob", blob]);
        served.robot.lock().unwrap().flash.fault = Some(UpdateFault::Model(fault));
        let other = concat!(env!("CARGO_MANIFEST_DIR"), "/../tests/corpus/anchors.blob");
        served.fails(&["send-blob", other], &[words, &["the blob that was active stays so"]].concat());

        // The firmware was changed, and the blob stayed.
        let Served { robot, .. } = &served;
        let again = Served::start_with(std::mem::take(&mut *robot.lock().unwrap()));
        again.robot.lock().unwrap().model = false;
        assert!(again.succeeds(&["hello"])["refused"]["why"].as_str().is_some_and(|why| why.contains(words[0])));
        again.fails(&["generate", "--text", "a bow"], &[words, &["send-blob"]].concat());
    }
}

/// A host that has said hello and is gone without a word.
fn forgetful_host(served: &Served) {
    let mut line = std::net::TcpStream::connect(served.port.strip_prefix("tcp:").unwrap()).unwrap();
    // Version 4, session 0x1234, id 1; Hello, no taking over.
    line.write_all(&[0x00, 0x05, 0x04, 0xB4, 0x24, 0x01, 0x01, 0x05, 0x3F, 0x1F, 0x86, 0xE1, 0x00]).unwrap();
    assert!(line.read(&mut [0; 300]).unwrap() > 0);
}

#[test]
fn another_host_is_waited_for_or_taken_over() {
    let served = Served::on_tcp();
    forgetful_host(&served);
    served.fails(&["hello"], &["another host has the robot, for 1 s more", "hint: ", "--take-over"]);
    assert_eq!(served.succeeds(&["status"])["state"], "holding");
    served.succeeds(&["stop"]);
    assert_eq!(served.robot.lock().unwrap().calls, ["stop"]);
    assert_eq!(served.succeeds(&["--take-over", "hello"])["preset"], "table-top");
    // Who leaves says so.
    served.succeeds(&["hello"]);
    forgetful_host(&served);
    thread::sleep(Duration::from_millis(1200));
    served.succeeds(&["hello"]);
}

#[test]
fn a_motion_that_cannot_be_played_is_an_error() {
    let served = Served::on_tcp();
    served.succeeds(&["stop"]);
    let play = ["generate", "--text", "a person bows", "--play"];
    served.fails(&play, &["was stopped", "hint: ", "motionette device neutral"]);
    served.succeeds(&["neutral"]);
    served.robot.lock().unwrap().condition.start = Start::Waiting;
    served.fails(&play, &["waits for its release", "hint: ", "motionette device release"]);
    assert_eq!(served.succeeds(&["status"])["start"]["state"], "waiting");
    assert_eq!(served.robot.lock().unwrap().calls, ["stop", "neutral"]);
    served.robot.lock().unwrap().condition.start = Start::Ready;
    served.fails(&["release"], &["does not wait for a release"]);
    let made = served.succeeds(&play);
    assert_eq!((&made["played"]["state"], &made["seed"]), (&"holding".into(), &1.into()));
}

/// Ctrl-C, a polite kill and a terminal that is closed: the robot holds before the program ends.
#[cfg(unix)]
#[test]
fn an_interrupted_host_holds_the_robot() {
    for signal in ["-INT", "-TERM", "-HUP"] {
        let served = Served::on_tcp();
        served.robot.lock().unwrap().frames = 10_000;
        let arguments = ["device", "--port", &served.port, "--json", "generate", "--text", "a person bows", "--play"];
        let mut command = Command::new(env!("CARGO_BIN_EXE_motionette"));
        command.args(arguments).stdout(std::process::Stdio::piped()).stderr(std::process::Stdio::piped());
        let child = command.spawn().unwrap();
        let begun = Instant::now();
        while served.robot.lock().unwrap().condition.state != State::Playing {
            assert!(begun.elapsed() < Duration::from_secs(20), "it does not play");
            thread::sleep(Duration::from_millis(5));
        }
        assert!(Command::new("kill").args([signal, &child.id().to_string()]).status().unwrap().success());
        let output = child.wait_with_output().unwrap();
        check_failure(&output, &["the robot holds", "interrupted", "motionette device resume"]);
        let robot = served.robot.lock().unwrap();
        assert_eq!((robot.condition.state, robot.held), (State::Holding, true));
        // It was told: the silence after which the device holds by itself has not passed.
        assert_eq!(robot.calls, ["start", "hold"]);
    }
}

#[test]
fn what_makes_no_sense_never_reaches_the_device() {
    let served = Served::on_tcp();
    let text = "x".repeat(193);
    served.fails(&["generate", "--text", &text], &["193 bytes", "192"]);
    for seconds in ["0", "-1", "9.9", "nan"] {
        let seconds = format!("--seconds={seconds}");
        served.fails(&["generate", "--text", "a bow", &seconds], &["up to 9.8 s"]);
    }
    let folder = tempfile::tempdir().unwrap();
    let anchors = folder.path().join("anchors.json");
    std::fs::write(&anchors, r#"{"anchors": [{"frame": 196, "root": [0.1, 0.9, 0.5]}]}"#).unwrap();
    let anchors = anchors.to_str().unwrap();
    served.fails(&["generate", "--text", "a bow", "--anchors", anchors], &["frame 196", "196 frames"]);
    assert!(served.robot.lock().unwrap().calls.is_empty());
}

/// A prompt's vector travels as a condition; what cannot be read or sent never reaches the device.
#[test]
fn a_prompt_as_a_vector() {
    let served = Served::on_tcp();
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name).to_str().unwrap().to_owned();
    let vector = |name: &str, numbers: usize| {
        let mut header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': ({numbers},), }}");
        header += &" ".repeat(63 - (10 + header.len()) % 64);
        header.push('\n');
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.bytes());
        bytes.extend((0..numbers).flat_map(|number| (number as f32 / 8.0).to_le_bytes()));
        std::fs::write(path(name), bytes).unwrap();
        path(name)
    };
    assert_eq!(served.succeeds(&["hello"])["limits"]["condition_bytes"], robot::CONDITION_BYTES);
    let (short, long) = (vector("short.npy", 512), vector("long.npy", 2000));
    let made = served.succeeds(&["generate", "--prompt-vector", &short]);
    assert_eq!((&made["frames"], &made["text"], &made["tracking"]), (&3.into(), &Value::Null, &Value::Null));
    assert_eq!(served.robot.lock().unwrap().given, [0, 0, 0, 512]);
    let too_long = ["8012 bytes", "4096", "hint: "];
    served.fails(&["generate", "--prompt-vector", &long], &too_long);
    served.fails(&["generate", "--prompt-vector", &path("none.npy")], &["none.npy"]);
    served.robot.lock().unwrap().area.clear();
    served.fails(&["generate", "--prompt-vector", &short], &["sets no memory aside", "hint: "]);
    assert_eq!(served.robot.lock().unwrap().calls, ["start"]);
    for arguments in [&["generate"][..], &["generate", "--text", "a bow", "--prompt-vector", &short]] {
        assert_eq!(served.run(Path::new("."), arguments).status.code(), Some(2), "{arguments:?}");
    }
}

#[test]
fn ports_that_are_not_there() {
    let run = |port: &str| {
        let arguments = ["device", "--port", port, "--json", "hello"];
        Command::new(env!("CARGO_BIN_EXE_motionette")).args(arguments).output().unwrap()
    };
    check_failure(&run("/dev/no-such-port"), &["/dev/no-such-port", "hint: ", "plugged in"]);
    // A port that was free a moment ago.
    let port = format!("tcp:{}", TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap());
    check_failure(&run(&port), &[&port, "hint: ", "simulator"]);
    check_failure(&run("tcp:127.0.0.1"), &["tcp:127.0.0.1", "hint: ", "tcp:HOST:PORT"]);
    // A name that no server is asked about: its label is longer than any may be.
    let unknown = run(&format!("tcp:{}.invalid:7878", "x".repeat(64)));
    check_failure(&unknown, &["cannot find the host", "hint: ", "address"]);
    assert!(!String::from_utf8_lossy(&unknown.stderr).contains("another program"));
    // Somebody listens and says nothing.
    let mute = TcpListener::bind("127.0.0.1:0").unwrap();
    let port = format!("tcp:{}", mute.local_addr().unwrap());
    check_failure(&run(&port), &["does not answer", "hint: ", "--baud"]);
}
