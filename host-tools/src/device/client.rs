//! Requests to a device, repeated until it answers.

use std::collections::VecDeque;
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io::ErrorKind;
use std::ops::ControlFlow;
use std::time::{Duration, Instant};

use motionette::blob::crc32;
use motionette_link::conditions::Given;
use motionette_link::frame::{self, Faults, Receiver};
use motionette_link::message::{
    Blob, CHUNK_BYTES, Clearance, Command, ConditionsFault, Event, FROM_DEVICE, Generate, Header, Hello, Owner,
    PROTOCOL, REPLY_BYTES, REQUEST_FRAME, Refusal, Reply, Start, State, Status, Strain, Tracking, Understood,
    UpdateFault,
};

use super::{Error, Transport};

/// How patient a client is, and how it treats others.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Options {
    /// How long it waits for an answer before it repeats a request.
    pub wait: Duration,
    /// The same for the verification of a blob.
    pub commit_wait: Duration,
    /// How often it sends a request at most.
    pub attempts: u32,
    /// How often it asks how a job or a motion stands.
    pub poll: Duration,
    /// Whether it ends another host's session.
    pub take_over: bool,
}

impl Default for Options {
    fn default() -> Self {
        Options {
            wait: Duration::from_millis(500),
            commit_wait: Duration::from_secs(5),
            attempts: 6,
            // Well below the silence after which devices count a host as lost.
            poll: Duration::from_millis(100),
            take_over: false,
        }
    }
}

/// Statuses without a trace of a job after which it counts as lost: its event may be on its way.
const TRACELESS: u32 = 20;

/// Times that a client that leaves says so.
const FAREWELLS: u32 = 2;

/// Sees how the device stands while it is waited for; to break off ends the waiting with [`Error::Interrupted`].
pub type Observe<'o> = dyn FnMut(&Status) -> ControlFlow<()> + 'o;

/// A motion that a device has made.
#[derive(Debug, Clone, PartialEq)]
pub struct Made {
    /// Frames.
    pub frames: u16,
    /// Mean distance from the anchors, metres.
    pub control_error: Option<f32>,
    /// What the device understood of the prompt.
    pub understood: Option<Understood>,
    /// What the anchors ask of the motion.
    pub strain: Option<Strain>,
    /// How far the motion is from its tracks.
    pub tracking: Option<Tracking>,
    /// How far it keeps clear of its obstacles.
    pub clearance: Option<Clearance>,
}

/// The host's side of a session with a device.
#[derive(Debug)]
pub struct Client<T> {
    transport: T,
    options: Options,
    receiver: Receiver<REPLY_BYTES>,
    /// Messages that have been read; without a body those that these tools do not understand.
    inbox: VecDeque<(Header, Option<Reply>)>,
    events: VecDeque<Event>,
    session: u32,
    id: u32,
    answered: bool,
    repeated: u32,
}

impl<T: Transport> Client<T> {
    /// A client without a session, which may stop the device and ask how it stands, and nothing else.
    #[must_use]
    pub fn new(transport: T, options: Options) -> Self {
        // The only source of randomness in the standard library.
        let session = RandomState::new().build_hasher().finish() as u32;
        Client {
            transport,
            options,
            receiver: Receiver::new(),
            inbox: VecDeque::new(),
            events: VecDeque::new(),
            session,
            id: 0,
            answered: false,
            repeated: 0,
        }
    }

    /// Begins a session.
    ///
    /// # Errors
    /// [`Error::Silent`] when nobody answers, [`Error::Version`] when someone of another version does, [`Error::Refused`] with
    /// [`Refusal::Occupied`] while another host has the robot and is not to be taken over.
    pub fn connect(transport: T, options: Options) -> Result<(Self, Hello), Error> {
        let mut client = Self::new(transport, options);
        match client.request(&Command::Hello { take_over: options.take_over })? {
            Reply::Hello(hello) => Ok((client, hello)),
            _ => Err(Error::Unexpected),
        }
    }

    /// Ends the session, so that another host need not wait for this one to count as silent. What moves or is made goes on. If nobody
    /// answers, the device finds out by itself.
    pub fn close(&mut self) {
        let _ = self.send(&Command::Close, FAREWELLS.min(self.options.attempts));
    }

    /// Requests that were sent more than once, counted for each time.
    #[must_use]
    pub const fn repeated(&self) -> u32 {
        self.repeated
    }

    /// What was skipped of the bytes that came.
    #[must_use]
    pub const fn skipped(&self) -> Faults {
        self.receiver.faults()
    }

    /// Sends a request until it is answered. Events that come meanwhile wait for [`Client::event`].
    ///
    /// # Errors
    /// [`Error::Refused`], [`Error::Silent`], [`Error::Broken`] or [`Error::Version`].
    pub fn request(&mut self, command: &Command) -> Result<Reply, Error> {
        self.send(command, self.options.attempts)
    }

    fn send(&mut self, command: &Command, attempts: u32) -> Result<Reply, Error> {
        let Options { wait, commit_wait, .. } = self.options;
        let wait = if matches!(command, Command::BlobCommit) { commit_wait } else { wait };
        self.id = self.id.wrapping_add(1);
        let header = Header::new(self.session, self.id);
        let mut buffer = [0; REQUEST_FRAME];
        // The largest request fits: a test of the link.
        let frame = frame::encode(&(header, command), &mut buffer).map_err(|_| Error::Unexpected)?;
        for attempt in 0..attempts {
            self.repeated += u32::from(attempt > 0);
            self.transport.write_all(frame).and_then(|()| self.transport.flush()).map_err(Error::Broken)?;
            let deadline = Instant::now() + wait;
            while let Some((answer, reply)) = self.message(deadline)? {
                // Answers to requests that were given up, or answered twice, come late.
                if answer.id != self.id {
                    continue;
                }
                self.answered = true;
                return match reply {
                    Reply::Refused(refusal) => Err(Error::Refused(refusal)),
                    reply => Ok(reply),
                };
            }
        }
        Err(Error::Silent { attempts, wait, before: self.answered })
    }

    /// The next message of this session that is no event; `None`: it is too late.
    fn message(&mut self, deadline: Instant) -> Result<Option<(Header, Reply)>, Error> {
        loop {
            while let Some((header, reply)) = self.inbox.pop_front() {
                match reply {
                    _ if header.session != self.session => {}
                    None if header.version == PROTOCOL | FROM_DEVICE => return Err(Error::Unexpected),
                    None => return Err(Error::Version { device: header.version & !FROM_DEVICE }),
                    Some(Reply::Event(event)) => self.events.push_back(event),
                    Some(reply) => return Ok(Some((header, reply))),
                }
            }
            if !self.read(deadline)? {
                return Ok(None);
            }
        }
    }

    /// Reads what there is; false when nothing came in time.
    fn read(&mut self, deadline: Instant) -> Result<bool, Error> {
        let left = deadline.saturating_duration_since(Instant::now());
        if left.is_zero() {
            return Ok(false);
        }
        // Systems round timeouts down, and zero means for ever.
        self.transport.set_timeout(left.max(Duration::from_millis(1))).map_err(Error::Broken)?;
        let mut buffer = [0; 512];
        let count = match self.transport.read(&mut buffer) {
            Ok(0) => return Err(Error::Broken(ErrorKind::UnexpectedEof.into())),
            Ok(count) => count,
            Err(error) if matches!(error.kind(), ErrorKind::TimedOut | ErrorKind::WouldBlock) => return Ok(false),
            Err(error) if error.kind() == ErrorKind::Interrupted => return Ok(true),
            Err(error) => return Err(Error::Broken(error)),
        };
        let mut bytes = &buffer[..count];
        while let Some(message) = self.receiver.next(&mut bytes) {
            // Counted by the receiver; an answer that was damaged is asked for again.
            let Ok(message) = message else { continue };
            match postcard::take_from_bytes::<Header>(message) {
                Ok((header, body)) if header.from_device() => {
                    let known = header.version == PROTOCOL | FROM_DEVICE;
                    let reply = if known { postcard::from_bytes(body).ok() } else { None };
                    self.inbox.push_back((header, reply));
                }
                _ => self.receiver.count_unfit(),
            }
        }
        Ok(true)
    }

    /// A request that is only to be accepted.
    ///
    /// # Errors
    /// As [`Client::request`].
    pub fn tell(&mut self, command: &Command) -> Result<(), Error> {
        match self.request(command)? {
            Reply::Accepted => Ok(()),
            _ => Err(Error::Unexpected),
        }
    }

    /// How the device stands.
    ///
    /// # Errors
    /// As [`Client::request`].
    pub fn status(&mut self) -> Result<Status, Error> {
        match self.request(&Command::Status)? {
            Reply::Status(status) => Ok(status),
            _ => Err(Error::Unexpected),
        }
    }

    /// The next event, if one comes within `wait`.
    ///
    /// # Errors
    /// [`Error::Broken`] or [`Error::Version`].
    pub fn event(&mut self, wait: Duration) -> Result<Option<Event>, Error> {
        let deadline = Instant::now() + wait;
        while self.events.is_empty() && self.message(deadline)?.is_some() {}
        Ok(self.events.pop_front())
    }

    /// Sends the conditions of requests to come, those with [`Generate::conditions`]; `observe` sees how many of their bytes have arrived. What
    /// was sent before is no longer there. False: there is nothing to send, and nothing was sent.
    ///
    /// # Errors
    /// As [`Client::request`]; [`Error::Unfit`] and [`Error::Refused`] with [`Refusal::Conditions`] for what cannot fit.
    pub fn stage(&mut self, hello: &Hello, given: &Given<'_>, observe: &mut dyn FnMut(u32)) -> Result<bool, Error> {
        if given.is_empty() {
            return Ok(false);
        }
        let (length, limit) = (given.bytes().map_err(Error::Unfit)?, hello.limits.condition_bytes);
        if length > limit {
            let fault = if limit == 0 { ConditionsFault::NoArea } else { ConditionsFault::Length { length, limit } };
            return Err(Error::Refused(fault.into()));
        }
        let mut bytes = Vec::new();
        given.write(&mut bytes).map_err(Error::Unfit)?;
        let begin = Command::ConditionsBegin { length, crc32: !crc32(!0, &bytes) };
        self.send_pieces(&begin, &bytes, |offset, bytes| Command::ConditionsChunk { offset, bytes }, observe)?;
        Ok(true)
    }

    /// Has a motion made and waits for it; `observe` sees how it goes.
    ///
    /// # Errors
    /// As [`Client::request`], [`Error::Failed`], [`Error::JobLost`], or [`Error::Interrupted`].
    pub fn generate(&mut self, request: &Generate, observe: &mut Observe<'_>) -> Result<Made, Error> {
        self.tell(&Command::Generate(request.clone()))?;
        match self.outcome(self.id, observe)? {
            Event::Ready { frames, control_error, understood, strain, tracking, clearance, .. } => {
                Ok(Made { frames, control_error, understood, strain, tracking, clearance })
            }
            _ => Err(Error::Unexpected),
        }
    }

    /// Has the model prove itself; `None`: it carries no self-test.
    ///
    /// # Errors
    /// As [`Client::generate`].
    pub fn self_test(&mut self) -> Result<Option<bool>, Error> {
        self.tell(&Command::SelfTest)?;
        match self.outcome(self.id, &mut |_| ControlFlow::Continue(()))? {
            Event::SelfTest { passed, .. } => Ok(passed),
            _ => Err(Error::Unexpected),
        }
    }

    /// How the job of request `id` ended: from its event, or from a status when that was lost.
    fn outcome(&mut self, id: u32, observe: &mut Observe<'_>) -> Result<Event, Error> {
        let mut traceless = 0;
        while traceless < TRACELESS {
            let event = match self.event(self.options.poll)? {
                Some(event) => Some(event),
                None => {
                    let status = self.own_status(observe)?;
                    let at_work = status.device.work.is_some_and(|work| work.job == id);
                    traceless = if at_work { 0 } else { traceless + 1 };
                    status.outcome
                }
            };
            match event {
                Some(Event::Failed { job, why }) if job == id => return Err(Error::Failed(why)),
                Some(event @ (Event::Ready { job, .. } | Event::SelfTest { job, .. })) if job == id => {
                    return Ok(event);
                }
                _ => {}
            }
        }
        Err(Error::JobLost { job: id })
    }

    /// Waits until the robot is at rest, and keeps the device from taking its host for lost; the state it rests in comes back.
    ///
    /// # Errors
    /// As [`Client::request`]; [`Error::Refused`] with [`Refusal::NotReady`] when it waits for a start that does not go on, and with
    /// [`Refusal::Session`] when another host has taken over; [`Error::Interrupted`].
    pub fn wait_for_rest(&mut self, observe: &mut Observe<'_>) -> Result<State, Error> {
        self.wait(false, observe)
    }

    /// Waits until the motion that is to be played has been; else as [`Client::wait_for_rest`].
    ///
    /// # Errors
    /// As [`Client::wait_for_rest`]; [`Error::Stopped`] or [`Error::NotBegun`] when it was not played to its end.
    pub fn wait_for_motion(&mut self, observe: &mut Observe<'_>) -> Result<State, Error> {
        self.wait(true, observe)
    }

    fn wait(&mut self, motion: bool, observe: &mut Observe<'_>) -> Result<State, Error> {
        let (mut moved, mut waited) = (false, 0);
        loop {
            moved |= self.event(self.options.poll)? == Some(Event::Finished);
            let device = self.own_status(observe)?.device;
            moved |= device.moves();
            if device.moves() || device.start.is_under_way() {
                continue;
            }
            // What was ordered may take a moment to begin.
            let late = waited >= TRACELESS;
            waited += 1;
            match device.start {
                start @ (Start::Waiting | Start::Refused { .. }) if late => {
                    return Err(Error::Refused(Refusal::NotReady(start)));
                }
                Start::Waiting | Start::Refused { .. } => continue,
                _ => {}
            }
            match device.state {
                State::Stopped if motion => return Err(Error::Stopped),
                // A motion may have ended between two statuses.
                state if moved || !motion || device.frames_queued == 0 => return Ok(state),
                _ if late => return Err(Error::NotBegun),
                _ => {}
            }
        }
    }

    /// How the device stands, as long as this host has the session.
    fn own_status(&mut self, observe: &mut Observe<'_>) -> Result<Status, Error> {
        let status = self.status()?;
        match observe(&status) {
            ControlFlow::Break(()) => Err(Error::Interrupted),
            ControlFlow::Continue(()) if status.owner == Owner::You => Ok(status),
            ControlFlow::Continue(()) => Err(Error::Refused(Refusal::Session)),
        }
    }

    /// Sends a blob and makes it the active one; `observe` sees how many bytes have arrived.
    ///
    /// # Errors
    /// As [`Client::request`].
    pub fn send_blob(&mut self, blob: &[u8], observe: &mut dyn FnMut(u32)) -> Result<Blob, Error> {
        let length = u32::try_from(blob.len()).unwrap_or(u32::MAX);
        let begin = Command::BlobBegin { length, crc32: !crc32(!0, blob) };
        self.send_pieces(&begin, blob, |offset, bytes| Command::BlobChunk { offset, bytes }, observe)?;
        match self.request(&Command::BlobCommit)? {
            Reply::Committed(blob) => Ok(blob),
            _ => Err(Error::Unexpected),
        }
    }

    /// Sends all of `bytes` in chunks, behind `begin`.
    fn send_pieces(
        &mut self,
        begin: &Command,
        bytes: &[u8],
        chunk: impl Fn(u32, heapless::Vec<u8, CHUNK_BYTES>) -> Command,
        observe: &mut dyn FnMut(u32),
    ) -> Result<(), Error> {
        let length = u32::try_from(bytes.len()).unwrap_or(u32::MAX);
        let mut next = self.next_offset(begin)?;
        while next < length {
            observe(next);
            let left = bytes.get(next as usize..).unwrap_or(&[]);
            next = self.next_offset(&chunk(next, left.iter().take(CHUNK_BYTES).copied().collect()))?;
        }
        observe(length);
        Ok(())
    }

    /// Where the device expects the next bytes of what is being sent.
    fn next_offset(&mut self, command: &Command) -> Result<u32, Error> {
        match self.request(command)? {
            Reply::Chunk { next } => Ok(next),
            _ => Err(Error::Unexpected),
        }
    }

    /// Sends a blob unless the device says that it is the active one already.
    ///
    /// # Errors
    /// As [`Client::send_blob`]; [`UpdateFault::Length`] for a blob that cannot fit.
    pub fn update(&mut self, hello: &Hello, blob: &[u8], observe: &mut dyn FnMut(u32)) -> Result<(Blob, bool), Error> {
        let length = u32::try_from(blob.len()).unwrap_or(u32::MAX);
        let crc32 = !crc32(!0, blob);
        match hello.blob {
            Some(active) if (active.length, active.crc32) == (length, crc32) => Ok((active, false)),
            _ if hello.limits.blob_bytes == 0 => Err(Error::Refused(Refusal::NoStorage)),
            _ if length > hello.limits.blob_bytes => {
                let limit = hello.limits.blob_bytes;
                Err(Error::Refused(UpdateFault::Length { length, limit }.into()))
            }
            _ => Ok((self.send_blob(blob, observe)?, true)),
        }
    }
}
