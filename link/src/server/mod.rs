//! The device's side of the link: a state machine with time passed in.
//!
//! Rules it keeps, whatever comes over the line:
//! - a request is executed once: the reply to a repeated one is repeated;
//! - a request that a later one has overtaken is not executed, so that nothing happens behind a stop;
//! - `Stop` is executed in every state and in every session;
//! - one job at a time, and none while a blob is transferred or, for a transfer, while the body moves;
//! - a host that falls silent is noticed after a set time, and said to the next one.

mod device;
mod session;
mod silence;

pub use device::{Description, Device, Job, Sink};
pub use silence::Silence;

use serde::Serialize;

use crate::frame::{self, Faults, Receiver};
use crate::message::{
    ANCHORS, CHUNK_BYTES, Command, Condition, Event, Header, Hello, Limits, LossAction, PROTOCOL, REPLY_FRAME,
    REQUEST_BYTES, Refusal, Reply, Status, TEXT_BYTES, name,
};
use crate::update::Store;
use session::{Order, Session};
use silence::Watch;

/// The device's side of the link.
#[derive(Debug)]
pub struct Server {
    receiver: Receiver<REQUEST_BYTES>,
    inner: Inner,
}

/// Everything behind the receiver.
#[derive(Debug)]
struct Inner {
    session: Session,
    watch: Watch,
    store: Store,
    /// An event that waits for room on its way out.
    pending: Option<Event>,
    outcome: Option<Event>,
    unsent: u32,
}

impl Server {
    /// A server for a device whose blobs lie in `store`.
    #[must_use]
    pub const fn new(store: Store, silence: Silence) -> Self {
        let session = Session::new();
        let watch = Watch::new(silence);
        Server {
            receiver: Receiver::new(),
            inner: Inner { session, watch, store, pending: None, outcome: None, unsent: 0 },
        }
    }

    /// The slots.
    #[must_use]
    pub const fn store(&self) -> &Store {
        &self.inner.store
    }

    /// What the receiver skipped.
    #[must_use]
    pub const fn skipped(&self) -> Faults {
        self.receiver.faults()
    }

    /// Takes bytes from the line as they come, in pieces of any size, at `now` (milliseconds, never decreasing), and
    /// executes the requests in them.
    pub fn receive<D: Device>(&mut self, now: u64, mut bytes: &[u8], device: &mut D, out: &mut impl Sink) {
        while let Some(received) = self.receiver.next(&mut bytes) {
            // What was skipped has been counted and is part of every status.
            let Ok(message) = received else { continue };
            match postcard::take_from_bytes::<Header>(message) {
                Ok((header, body)) if !header.from_device() => {
                    if let Some(answer) = self.inner.handle(now, header, body, device, out) {
                        self.inner.answer(answer, self.receiver.faults(), out);
                    }
                }
                _ => self.receiver.count_unfit(),
            }
        }
    }

    /// Sends events and watches for a silent host at `now` (milliseconds). To be called a few times a second at least, and
    /// after anything has ended.
    pub fn poll<D: Device>(&mut self, now: u64, device: &mut D, out: &mut impl Sink) {
        self.inner.poll(now, device, out);
    }
}

/// A reply that is to be sent.
struct Answer {
    header: Header,
    reply: Reply,
    /// Whether it is to be repeated when its request is.
    keep: bool,
}

impl Inner {
    /// Executes one request. `None`: there is nothing to answer, or the answer was repeated.
    fn handle<D: Device>(
        &mut self,
        now: u64,
        header: Header,
        body: &[u8],
        device: &mut D,
        out: &mut impl Sink,
    ) -> Option<Answer> {
        self.watch.heard(now);
        let refuse = |refusal| Some(Answer { header, reply: Reply::Refused(refusal), keep: false });
        if header.version != PROTOCOL {
            return refuse(Refusal::Version { supported: PROTOCOL });
        }
        let Some(command) = parse(body) else { return refuse(Refusal::Malformed) };
        let (stop, hello) = (matches!(command, Command::Stop), matches!(command, Command::Hello));
        match self.session.order(&header) {
            Order::Repeated => {
                let sent = self.session.reply().is_some_and(|frame| push(out, frame));
                self.unsent = self.unsent.saturating_add(u32::from(!sent));
                return None;
            }
            Order::Foreign if hello => {
                self.store.abort();
                self.session.begin(&header);
            }
            Order::Overtaken { .. } | Order::Foreign if stop => {
                device.stop();
                return Some(Answer { header, reply: Reply::Accepted, keep: false });
            }
            Order::Overtaken { last } => return refuse(Refusal::Stale { last }),
            Order::Foreign => return refuse(Refusal::Session),
            Order::Next => self.session.advance(&header),
        }
        let reply = self.execute(header.id, command, device).unwrap_or_else(Reply::Refused);
        Some(Answer { header, reply, keep: true })
    }

    fn answer(&mut self, answer: Answer, skipped: Faults, out: &mut impl Sink) {
        let Answer { header, mut reply, keep } = answer;
        if let Reply::Status(status) = &mut reply {
            status.skipped = skipped;
        }
        let message = (Header::reply(header.session, header.id), reply);
        let sent =
            if keep { self.session.keep(&message).is_some_and(|frame| push(out, frame)) } else { send(out, &message) };
        self.unsent = self.unsent.saturating_add(u32::from(!sent));
    }

    fn execute<D: Device>(&mut self, id: u32, command: Command, device: &mut D) -> Result<Reply, Refusal> {
        match command {
            Command::Hello => return Ok(Reply::Hello(self.hello(device))),
            Command::Status => return Ok(Reply::Status(self.status(device))),
            Command::KeepAlive => {}
            Command::Stop => device.stop(),
            Command::Hold => device.hold()?,
            Command::Generate(request) => {
                self.ready_for_work(&device.condition())?;
                device.start(id, Job::Generate(&request))?;
            }
            Command::SelfTest => {
                self.ready_for_work(&device.condition())?;
                device.start(id, Job::SelfTest)?;
            }
            Command::Play => {
                self.ready_to_move()?;
                device.play()?;
            }
            Command::Resume => {
                self.ready_to_move()?;
                device.resume()?;
            }
            Command::Neutral => {
                self.ready_to_move()?;
                device.neutral()?;
            }
            Command::BlobBegin { length, crc32 } => {
                let condition = device.condition();
                ready_for_flash(&condition)?;
                let storage = device.storage().ok_or(Refusal::NoStorage)?;
                self.store.begin(storage, length, crc32)?;
                return Ok(Reply::Chunk { next: 0 });
            }
            Command::BlobChunk { offset, bytes } => {
                ready_for_flash(&device.condition())?;
                let storage = device.storage().ok_or(Refusal::NoStorage)?;
                return Ok(Reply::Chunk { next: self.store.write(storage, offset, &bytes)? });
            }
            Command::BlobCommit => {
                ready_for_flash(&device.condition())?;
                let storage = device.storage().ok_or(Refusal::NoStorage)?;
                let blob = self.store.commit(storage)?;
                device.activated(&self.store);
                return Ok(Reply::Committed(blob));
            }
            Command::BlobAbort => self.store.abort(),
        }
        Ok(Reply::Accepted)
    }

    fn ready_for_work(&self, condition: &Condition) -> Result<(), Refusal> {
        match condition.work {
            Some(work) => Err(Refusal::Busy { job: work.job }),
            None => self.ready_to_move(),
        }
    }

    fn ready_to_move(&self) -> Result<(), Refusal> {
        match self.store.transfer() {
            Some(transfer) => Err(Refusal::Transferring { next: transfer.next, length: transfer.length }),
            None => Ok(()),
        }
    }

    fn hello<D: Device>(&self, device: &mut D) -> Hello {
        let blob_bytes = device.storage().map_or(0, |storage| Store::capacity(storage));
        let Description { preset, model } = device.describe();
        let Silence { after_ms, action } = self.watch.silence();
        Hello {
            version: name(env!("CARGO_PKG_VERSION")),
            preset,
            model,
            blob: self.store.active(),
            limits: Limits {
                text_bytes: TEXT_BYTES as u16,
                anchors: ANCHORS as u8,
                chunk_bytes: CHUNK_BYTES as u16,
                blob_bytes,
                silence_ms: after_ms,
                on_silence: action,
            },
        }
    }

    fn status<D: Device>(&mut self, device: &D) -> Status {
        Status {
            device: device.condition(),
            outcome: self.outcome,
            transfer: self.store.transfer(),
            host_lost: self.watch.report(),
            skipped: Faults::default(),
            unsent: self.unsent,
        }
    }

    fn poll<D: Device>(&mut self, now: u64, device: &mut D, out: &mut impl Sink) {
        if self.watch.silent(now) {
            if self.store.transfer().is_some() {
                self.store.abort();
                self.lost(LossAction::Abort, out);
            }
            let Condition { state, work, .. } = device.condition();
            // Work may end in movement at any time.
            if (state.moves() || work.is_some()) && self.watch.must_act(state.moves()) {
                let action = self.watch.silence().action;
                if action == LossAction::Hold {
                    // A device that cannot hold is at rest.
                    let _ = device.hold();
                }
                self.lost(action, out);
            }
        }
        while out.room() >= REPLY_FRAME {
            let Some(event) = self.pending.take().or_else(|| self.next_event(device)) else { break };
            self.tell(event, out);
        }
        if self.pending.is_none() {
            self.pending = self.next_event(device);
        }
    }

    fn next_event<D: Device>(&mut self, device: &mut D) -> Option<Event> {
        let event = device.event()?;
        if matches!(event, Event::Ready { .. } | Event::Failed { .. } | Event::SelfTest { .. }) {
            self.outcome = Some(event);
        }
        Some(event)
    }

    fn lost(&mut self, action: LossAction, out: &mut impl Sink) {
        if self.watch.acted(action) {
            self.tell(Event::HostLost(action), out);
        }
    }

    fn tell(&mut self, event: Event, out: &mut impl Sink) {
        let sent = send(out, &(Header::reply(self.session.number(), 0), Reply::Event(event)));
        self.unsent = self.unsent.saturating_add(u32::from(!sent));
    }
}

/// The command in `body`, if there is one and nothing behind it.
fn parse(body: &[u8]) -> Option<Command> {
    match postcard::take_from_bytes(body) {
        Ok((command, [])) => Some(command),
        _ => None,
    }
}

/// Flash is written only while nothing moves and nothing is made: code and model may lie in the flash that is busy then.
fn ready_for_flash(condition: &Condition) -> Result<(), Refusal> {
    match condition.work {
        Some(work) => Err(Refusal::Busy { job: work.job }),
        None if condition.state.moves() => Err(Refusal::Moving),
        None => Ok(()),
    }
}

fn send(out: &mut impl Sink, message: &impl Serialize) -> bool {
    let mut buffer = [0; REPLY_FRAME];
    frame::encode(message, &mut buffer).is_ok_and(|frame| push(out, frame))
}

fn push(out: &mut impl Sink, frame: &[u8]) -> bool {
    let fits = out.room() >= frame.len();
    if fits {
        out.send(frame);
    }
    fits
}
