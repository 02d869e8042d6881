//! The device's side of the link: a state machine with time passed in.
//!
//! Rules it keeps, whatever comes over its lines:
//! - a request is executed once: the reply to a repeated one is repeated;
//! - a request that a later one has overtaken is not executed, so that nothing happens behind a stop;
//! - one session at a time: another host is refused until the first closes its own, falls silent, or is taken over;
//! - `Stop` is executed in every state and for every host, and `Status` answered for every host;
//! - one job at a time, and none while a blob is transferred or, for a transfer, while the body moves;
//! - conditions belong to requests of the session in which they came, and are not changed while a job uses them;
//! - a host that falls silent is noticed after a set time, and said to the next one: only requests of the session, of this version and
//!   well-formed, are signs of life.

mod device;
mod port;
mod session;
mod silence;

pub use device::{Description, Device, Job, Sink};
pub use port::Port;
pub use silence::Silence;

use motionette::LINKED_SPANS;
use serde::Serialize;

use crate::conditions::Staged;
use crate::frame::{self, Faults};
use crate::message::{
    ANCHORS, CHUNK_BYTES, Command, Condition, ConditionsFault, DeviceLimits, Event, Header, Hello, LossAction, Owner,
    PROTOCOL, REPLY_FRAME, Refusal, Reply, Status, TEXT_BYTES, name,
};
use crate::update::Store;
use session::{Order, Session};
use silence::Watch;

/// The device's side of the link.
#[derive(Debug)]
pub struct Server {
    session: Session,
    /// Number of the port over which the session's last request came.
    owner: Option<u32>,
    /// Ports made so far.
    ports: u32,
    watch: Watch,
    store: Store,
    staged: Staged,
    /// An event that waits for room on its way out.
    pending: Option<Event>,
    outcome: Option<Event>,
    unsent: u32,
}

impl Server {
    /// A server for a device whose blobs lie in `store`.
    #[must_use]
    pub const fn new(store: Store, silence: Silence) -> Self {
        Server {
            session: Session::new(),
            owner: None,
            ports: 0,
            watch: Watch::new(silence),
            store,
            staged: Staged::EMPTY,
            pending: None,
            outcome: None,
            unsent: 0,
        }
    }

    /// The slots.
    #[must_use]
    pub const fn store(&self) -> &Store {
        &self.store
    }

    /// A port for a line that hosts may talk over.
    #[must_use]
    pub const fn port(&mut self) -> Port {
        self.ports = self.ports.wrapping_add(1);
        Port::new(self.ports)
    }

    /// Whether the host of the session is at the other end of `port`: its line is the one for events.
    #[must_use]
    pub fn is_owner(&self, port: &Port) -> bool {
        self.session.is_open() && self.owner == Some(port.number)
    }

    /// Nobody listens on `port` any more: its cable was pulled or its connection closed. A session that was held over it ends, as
    /// [`Command::Close`] ends it.
    pub fn hang_up(&mut self, port: &Port) {
        if self.is_owner(port) {
            self.close();
        }
    }

    /// Takes bytes from a line as they come, in pieces of any size, at `now` (milliseconds, never decreasing), and executes the requests
    /// in them. Replies go to `out`, which MUST lead to the other end of the same line.
    pub fn receive<D: Device>(
        &mut self,
        port: &mut Port,
        now: u64,
        mut bytes: &[u8],
        device: &mut D,
        out: &mut impl Sink,
    ) {
        while let Some(received) = port.receiver.next(&mut bytes) {
            // What was skipped has been counted and is part of every status.
            let Ok(message) = received else { continue };
            match postcard::take_from_bytes::<Header>(message) {
                Ok((header, body)) if !header.from_device() => {
                    if let Some(answer) = self.handle(port.number, now, header, body, device, out) {
                        self.answer(answer, port.receiver.faults(), out);
                    }
                }
                _ => port.receiver.count_unfit(),
            }
        }
    }

    /// Executes one request. `None`: there is nothing to answer, or the answer was repeated.
    fn handle<D: Device>(
        &mut self,
        port: u32,
        now: u64,
        header: Header,
        body: &[u8],
        device: &mut D,
        out: &mut impl Sink,
    ) -> Option<Answer> {
        let aside = |reply| Some(Answer { header, reply, keep: false });
        let refuse = |refusal| aside(Reply::Refused(refusal));
        if header.version != PROTOCOL {
            return refuse(Refusal::Version { supported: PROTOCOL });
        }
        let Some(command) = parse(body) else { return refuse(Refusal::Malformed) };
        match (self.session.order(&header), &command) {
            (Order::Repeated, _) => {
                self.heard(port, now);
                let sent = self.session.reply().is_some_and(|frame| push(out, frame));
                self.unsent = self.unsent.saturating_add(u32::from(!sent));
                return None;
            }
            (Order::Next, Command::Hello { .. }) => self.session.begin(&header),
            (Order::Next, _) if self.session.is_open() => self.session.advance(&header),
            (Order::Foreign, Command::Hello { take_over }) => {
                if !take_over && self.session.is_open() && !self.watch.silent(now) {
                    return refuse(Refusal::Occupied { free_in_ms: self.watch.left(now) });
                }
                self.give_up();
                self.session.begin(&header);
            }
            (_, Command::Stop) => {
                device.stop();
                return aside(Reply::Accepted);
            }
            (Order::Overtaken { last }, _) => return refuse(Refusal::Stale { last }),
            (_, Command::Status) => {
                let owner = if self.session.is_open() { Owner::Another } else { Owner::Nobody };
                return aside(Reply::Status(self.status(owner, device)));
            }
            // A session that is not the current one has ended already.
            (_, Command::Close) => return aside(Reply::Accepted),
            _ => return refuse(Refusal::Session),
        }
        self.heard(port, now);
        let reply = self.execute(header.id, command, device).unwrap_or_else(Reply::Refused);
        Some(Answer { header, reply, keep: true })
    }

    /// The session's host was heard of.
    fn heard(&mut self, port: u32, now: u64) {
        if self.session.is_open() {
            self.owner = Some(port);
            self.watch.heard(now);
        }
    }

    /// Ends the session. What moves or is made goes on, as after a host that fell silent.
    fn close(&mut self) {
        self.give_up();
        self.session.close();
    }

    /// Gives up what the session's host has sent and not finished.
    fn give_up(&mut self) {
        self.store.abort();
        self.staged.abort();
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
            Command::Hello { .. } => return Ok(Reply::Hello(self.hello(device))),
            Command::Status => {
                let status = self.status(Owner::You, device);
                self.watch.reported();
                return Ok(Reply::Status(status));
            }
            Command::KeepAlive => {}
            Command::Close => self.close(),
            Command::Stop => device.stop(),
            Command::Hold => device.hold()?,
            Command::Generate(request) => {
                if !request.refinement.is_known() {
                    return Err(Refusal::Refinement { found: request.refinement.0 });
                }
                if request.conditions {
                    self.staged.whole(area(device)?)?;
                }
                self.start(id, Job::Generate(&request), device)?;
            }
            Command::SelfTest => self.start(id, Job::SelfTest, device)?,
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
            Command::Release => {
                self.ready_to_move()?;
                device.release()?;
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
            Command::ConditionsBegin { length, crc32 } => {
                self.staged.begin(area(device)?, length, crc32)?;
                return Ok(Reply::Chunk { next: 0 });
            }
            Command::ConditionsChunk { offset, bytes } => {
                return Ok(Reply::Chunk { next: self.staged.write(area(device)?, offset, &bytes)? });
            }
        }
        Ok(Reply::Accepted)
    }

    fn start<D: Device>(&self, id: u32, job: Job<'_>, device: &mut D) -> Result<(), Refusal> {
        match device.condition().work {
            Some(work) => return Err(Refusal::Busy { job: work.job }),
            None => self.ready_to_move()?,
        }
        device.start(id, job).map_err(|refusal| match (refusal, self.store.refused()) {
            (Refusal::NoModel, Some(refused)) if self.store.active().is_none() => Refusal::Unusable(refused.why),
            _ => refusal,
        })
    }

    fn ready_to_move(&self) -> Result<(), Refusal> {
        match self.store.transfer() {
            Some(transfer) => Err(Refusal::Transferring { next: transfer.next, length: transfer.length }),
            None => Ok(()),
        }
    }

    fn hello<D: Device>(&self, device: &mut D) -> Hello {
        let blob_bytes = device.storage().map_or(0, |storage| Store::capacity(storage));
        let Description { preset, model, condition_bytes } = device.describe();
        let Silence { after_ms, action } = self.watch.silence();
        Hello {
            version: name(env!("CARGO_PKG_VERSION")),
            preset,
            model,
            blob: self.store.active(),
            refused: self.store.refused(),
            limits: DeviceLimits {
                text_bytes: TEXT_BYTES as u16,
                anchors: ANCHORS as u8,
                chunk_bytes: CHUNK_BYTES as u16,
                blob_bytes,
                condition_bytes,
                spans: LINKED_SPANS as u8,
                silence_ms: after_ms,
                on_silence: action,
            },
        }
    }

    fn status<D: Device>(&self, owner: Owner, device: &D) -> Status {
        Status {
            owner,
            device: device.condition(),
            outcome: self.outcome.clone(),
            refused: self.store.refused(),
            transfer: self.store.transfer(),
            staged: self.staged.transfer(),
            host_lost: self.watch.unreported(),
            skipped: Faults::default(),
            unsent: self.unsent,
        }
    }

    /// Sends events and watches for a silent host at `now` (milliseconds). To be called a few times a second at least, and
    /// after anything has ended. `out` leads to the session's host, see [`Server::is_owner`].
    pub fn poll<D: Device>(&mut self, now: u64, device: &mut D, out: &mut impl Sink) {
        if self.watch.silent(now) {
            let sending = self.staged.transfer().is_some_and(|staged| staged.next < staged.length);
            let sending = sending || self.store.transfer().is_some();
            self.give_up();
            if sending {
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
            self.outcome = Some(event.clone());
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

/// A reply that is to be sent.
struct Answer {
    header: Header,
    reply: Reply,
    /// Whether it is to be repeated when its request is.
    keep: bool,
}

/// The command in `body`, if there is one and nothing behind it.
fn parse(body: &[u8]) -> Option<Command> {
    match postcard::take_from_bytes(body) {
        Ok((command, [])) => Some(command),
        _ => None,
    }
}

/// The memory for conditions, while no job may read there.
fn area<D: Device>(device: &mut D) -> Result<&mut [u32], Refusal> {
    match device.condition().work {
        Some(work) => Err(Refusal::Busy { job: work.job }),
        None => device.area().ok_or(Refusal::Conditions(ConditionsFault::NoArea)),
    }
}

/// Flash is written only while nothing moves and nothing is made: code and model may lie in the flash that is busy then.
fn ready_for_flash(condition: &Condition) -> Result<(), Refusal> {
    match condition.work {
        Some(work) => Err(Refusal::Busy { job: work.job }),
        None if condition.moves() => Err(Refusal::Moving),
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
