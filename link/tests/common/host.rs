//! A host of a few lines: numbers requests, reads replies.

use motionette_link::frame::{Receiver, encode};
use motionette_link::message::{
    Command, Event, Header, LossAction, REPLY_BYTES, REQUEST_FRAME, Refusal, Reply, Status,
};
use motionette_link::server::{Port, Server, Silence};
use motionette_link::update::Store;

use super::{Line, Robot, crc};

pub const HELLO: Command = Command::Hello { take_over: false };
pub const SILENCE: Silence = Silence { after_ms: 500, action: LossAction::Finish };

pub struct Host {
    pub server: Server,
    pub port: Port,
    pub robot: Robot,
    pub session: u32,
    pub id: u32,
    pub now: u64,
}

impl Host {
    pub fn new(silence: Silence) -> Self {
        let robot = Robot::default();
        let mut server = Server::new(Store::open(&robot.flash), silence);
        let port = server.port();
        Host { server, port, robot, session: 77, id: 0, now: 1000 }
    }

    /// After hello.
    pub fn greeted(silence: Silence) -> Self {
        let mut host = Self::new(silence);
        assert!(matches!(host.ask(&HELLO), Reply::Hello(_)));
        host
    }

    /// The next request and its reply.
    pub fn ask(&mut self, command: &Command) -> Reply {
        self.id = self.id.wrapping_add(1);
        self.repeat(command)
    }

    /// The last request again.
    pub fn repeat(&mut self, command: &Command) -> Reply {
        self.as_numbered(Header::new(self.session, self.id), command)
    }

    /// A request with a header of its own.
    pub fn as_numbered(&mut self, header: Header, command: &Command) -> Reply {
        let mut buffer = [0; REQUEST_FRAME];
        let frame = encode(&(header, command), &mut buffer).unwrap();
        let mut replies = replies(&self.send(frame));
        assert_eq!(replies.len(), 1, "{command:?}: {replies:?}");
        let (echo, reply) = replies.remove(0);
        assert_eq!(echo, Header::reply(header.session, header.id));
        reply
    }

    /// What another host is told, over a line of its own.
    pub fn another(&mut self, port: &mut Port, header: Header, command: &Command) -> Reply {
        core::mem::swap(&mut self.port, port);
        let reply = self.as_numbered(header, command);
        core::mem::swap(&mut self.port, port);
        reply
    }

    /// Bytes to the device; its bytes back.
    pub fn send(&mut self, bytes: &[u8]) -> Vec<u8> {
        let mut line = Line::default();
        self.server.receive(&mut self.port, self.now, bytes, &mut self.robot, &mut line);
        line.0
    }

    /// Time passes, the robot works, the server polls; what it tells comes back.
    pub fn wait(&mut self, milliseconds: u64) -> Vec<Event> {
        let mut line = Line::default();
        for _ in 0..milliseconds.div_ceil(50) {
            self.now += 50;
            self.robot.advance();
            self.server.poll(self.now, &mut self.robot, &mut line);
        }
        let events = replies(&line.0).into_iter();
        events
            .map(|(header, reply)| match reply {
                Reply::Event(event) if header.id == 0 => event,
                other => panic!("{header:?}: {other:?}"),
            })
            .collect()
    }

    pub fn accepted(&mut self, command: &Command) {
        assert_eq!(self.ask(command), Reply::Accepted, "{command:?}");
    }

    pub fn refused(&mut self, command: &Command) -> Refusal {
        match self.ask(command) {
            Reply::Refused(refusal) => refusal,
            other => panic!("{command:?}: {other:?}"),
        }
    }

    pub fn status(&mut self) -> Status {
        match self.ask(&Command::Status) {
            Reply::Status(status) => status,
            other => panic!("{other:?}"),
        }
    }

    /// Whole conditions.
    pub fn stage(&mut self, bytes: &[u8]) {
        let begin = Command::ConditionsBegin { length: bytes.len() as u32, crc32: crc(bytes) };
        assert_eq!(self.ask(&begin), Reply::Chunk { next: 0 });
        for (index, chunk) in bytes.chunks(240).enumerate() {
            let offset = index as u32 * 240;
            let command = Command::ConditionsChunk { offset, bytes: chunk.iter().copied().collect() };
            assert_eq!(self.ask(&command), Reply::Chunk { next: offset + chunk.len() as u32 });
        }
    }

    /// A whole blob, without the commit.
    pub fn transfer(&mut self, blob: &[u8]) {
        let begin = Command::BlobBegin { length: blob.len() as u32, crc32: crc(blob) };
        assert_eq!(self.ask(&begin), Reply::Chunk { next: 0 });
        for (index, chunk) in blob.chunks(240).enumerate() {
            let offset = index as u32 * 240;
            let command = Command::BlobChunk { offset, bytes: chunk.iter().copied().collect() };
            assert_eq!(self.ask(&command), Reply::Chunk { next: offset + chunk.len() as u32 });
        }
    }
}

/// The messages in what a device sent.
pub fn replies(mut bytes: &[u8]) -> Vec<(Header, Reply)> {
    let mut receiver = Receiver::<REPLY_BYTES>::new();
    let mut replies = Vec::new();
    while let Some(message) = receiver.next(&mut bytes) {
        let (header, body) = postcard::take_from_bytes(message.unwrap()).unwrap();
        let (reply, rest) = postcard::take_from_bytes(body).unwrap();
        assert_eq!(rest, [0; 0]);
        replies.push((header, reply));
    }
    replies
}
