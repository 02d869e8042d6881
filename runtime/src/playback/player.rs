//! Plays motions at the servos' rate, at a fixed cost a tick: interpolation, fades, limits, commands.
//!
//! [`Player::tick`] is made for a timer interrupt: it takes at most a few items from the line, does the same work whatever happens, and
//! waits for nothing.

use heapless::Vec;
use heapless::spsc::Consumer;

use super::control::{Control, State, Status, Wish};
use super::interpolate::monotone_cubic;
use super::limiter::{Angle, Limiter, ServoLimits, UNITS, units};
use super::queue::{Item, Source, degrees, is_before, whole};
use super::robot::{Channel, Rest, Robot};
use super::start::Start;

/// Items that a tick throws away at most when a motion is cut off.
const THROWN_AWAY: usize = 32;

/// How far from where the motion wants it a servo counts as held back by its limits: a tenth of a degree.
const BEHIND: Angle = (UNITS as Angle) / 10;

/// Four frames round the present time, hundredths of a degree, and where the motion stands between the middle two.
#[derive(Debug, Clone, Copy)]
struct FrameWindow<const C: usize> {
    frames: [[i16; C]; 4],
    /// Frames taken: the first fills all four, the second the last two, the third the last.
    taken: u8,
    /// No more frames come.
    ended: bool,
    /// Frames of the window that are still to come; the last one is kept for as long as the others.
    left: u8,
    /// Time since the second frame, in ticks times the frame rate; the next frame is due at the tick rate.
    time: u32,
    frame_rate: u16,
    /// Number of the second frame in the motion.
    index: u32,
    /// Number of the motion.
    number: u32,
}

impl<const C: usize> FrameWindow<C> {
    const fn new(number: u32, frame_rate: u16) -> Self {
        FrameWindow { frames: [[0; C]; 4], taken: 0, ended: false, left: 0, time: 0, frame_rate, index: 0, number }
    }

    /// Appends a frame to those not yet shown.
    #[inline(never)]
    fn push(&mut self, frame: [i16; C]) {
        let [_, b, c, d] = self.frames;
        self.frames = match self.taken {
            0 => [frame; 4],
            1 => [b, b, frame, frame],
            2 => [b, b, c, frame],
            _ => [b, c, d, frame],
        };
        if self.taken < 3 {
            self.taken += 1;
        }
        self.left = self.taken.saturating_sub(1);
    }

    /// Whether interpolation knows what it needs.
    const fn ready(&self) -> bool {
        self.taken >= 3 || (self.ended && self.taken > 0)
    }

    /// Degrees of a channel, `t` of the way from the second to the third frame.
    #[inline(never)]
    fn at(&self, channel: usize, t: f32) -> f32 {
        monotone_cubic(self.frames.map(|frame| frame.get(channel).map_or(0.0, |angle| degrees(*angle))), t)
    }
}

/// What moves the servos.
#[derive(Debug, Clone, Copy)]
enum Drive<const C: usize> {
    /// Nothing: they stand.
    None,
    /// A motion.
    Motion(FrameWindow<C>),
    /// The way to neutral.
    Return,
}

/// What the servos are to be told after a tick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Servos<'a> {
    /// A command a channel: microseconds, or positions of serial servos.
    pub commands: &'a [u16],
    /// What the player does.
    pub state: State,
}

/// Plays what a line brings.
pub struct Player<'a, const C: usize> {
    robot: &'a Robot,
    source: Source<'a, C>,
    control: &'a Control,
    servos: Vec<Limiter, C>,
    commands: Vec<u16, C>,
    /// Where the servos were before the last tick.
    before: [Angle; C],
    drive: Drive<C>,
    /// Where the present fade began, and how many ticks it has lasted.
    from: [Angle; C],
    faded: u32,
    held: bool,
    /// Whether the servos creep from where they were found to `goal`.
    creeping: bool,
    goal: [Angle; C],
    /// What comes before the motion of this number is thrown away, and whether that one has not come yet.
    cut: u32,
    cutting: bool,
    status: Status,
    /// What of the motion the last tick showed.
    frame: Option<f32>,
}

impl<'a, const C: usize> Player<'a, C> {
    pub(super) fn new(robot: &'a Robot, consumer: Consumer<'a, Item<C>>, control: &'a Control) -> Self {
        let (mut servos, mut commands) = (Vec::new(), Vec::new());
        for channel in &robot.channels {
            let limiter = Limiter::new(channel.limits(robot.tick_rate, channel.speed), units(channel.neutral));
            // The line was made for as many channels.
            let _ = servos.push(limiter);
            let _ = commands.push(channel.command(limiter.at()));
        }
        let mut before = [0; C];
        for (before, servo) in before.iter_mut().zip(&servos) {
            *before = Limiter::at(servo);
        }
        Player {
            robot,
            source: Source::new(consumer),
            control,
            servos,
            commands,
            before,
            drive: Drive::None,
            from: [0; C],
            faded: 0,
            held: false,
            creeping: false,
            goal: [0; C],
            cut: 0,
            cutting: false,
            status: Status::default(),
            frame: None,
        }
    }

    /// Says where the servos really stand, degrees: before the first tick, and whenever they may have moved by themselves. The player
    /// goes on from there: it creeps, at [`Robot::creep`], to where it would have had them, and only then does anything else.
    pub fn stand_at(&mut self, angles: &[f32]) {
        let rate = self.robot.tick_rate;
        let goals = self.goal.iter_mut().zip(&mut self.before);
        let servos = self.servos.iter_mut().zip(&mut self.commands).zip(&self.robot.channels);
        for ((((servo, command), channel), (goal, before)), angle) in servos.zip(goals).zip(angles) {
            if !self.creeping {
                *goal = servo.at();
            }
            let slow = if self.robot.creep < channel.speed { self.robot.creep } else { channel.speed };
            *servo = Limiter::new(channel.limits(rate, slow), units(*angle));
            *command = channel.command(servo.at());
            *before = servo.at();
        }
        self.creeping = true;
    }

    /// Angles that the servos were last told to take, degrees.
    pub fn angles(&self) -> impl Iterator<Item = f32> + '_ {
        self.servos.iter().map(|servo| super::limiter::degrees(servo.at()))
    }

    /// The frame of its motion that the last tick showed, with the part of the way to the next; `None` when it played none.
    #[must_use]
    pub const fn frame(&self) -> Option<f32> {
        self.frame
    }

    /// Ticks a second.
    #[must_use]
    pub const fn tick_rate(&self) -> u16 {
        self.robot.tick_rate
    }

    /// The servos.
    #[must_use]
    pub fn channels(&self) -> &'a [Channel] {
        &self.robot.channels
    }

    /// Its orders.
    pub(super) const fn control(&self) -> &'a Control {
        self.control
    }

    /// What it has counted.
    #[must_use]
    pub const fn status(&self) -> &Status {
        &self.status
    }

    /// One tick: to be called [`Robot::tick_rate`] times a second.
    #[inline(never)]
    pub fn tick(&mut self) -> Servos<'_> {
        self.status.ticks = self.status.ticks.wrapping_add(1);
        for (before, servo) in self.before.iter_mut().zip(&self.servos) {
            *before = servo.at();
        }
        self.frame = None;
        let wish = self.control.wish();
        self.cut_off();
        self.status.start = Start::Ready;
        self.status.state = match wish {
            Wish::Run if self.creeping => self.creep(),
            Wish::Run => self.run(),
            Wish::Hold => {
                self.held = true;
                self.brake();
                State::Holding
            }
            Wish::Stop => {
                self.drive = Drive::None;
                self.throw_away(|_| true);
                if self.brake() { State::Stopped } else { State::Stopping }
            }
            Wish::Neutral => {
                if !matches!(self.drive, Drive::Return) {
                    self.begin(Drive::Return);
                }
                self.throw_away(|_| true);
                if self.creeping {
                    for (goal, channel) in self.goal.iter_mut().zip(&self.robot.channels) {
                        *goal = units(channel.neutral);
                    }
                    self.creep()
                } else {
                    self.go_home()
                }
            }
        };
        if self.creeping {
            self.status.start = Start::Creeping;
        }
        self.show()
    }

    /// One tick in which it is not known where the servos stand, so that they are told nothing: motions wait, orders are noted.
    #[inline(never)]
    pub(super) fn wait(&mut self, start: Start) -> State {
        self.cut_off();
        self.status.start = start;
        self.frame = None;
        self.stand().state
    }

    /// One tick in which the servos stay where they are and the motion waits: for when they cannot be told anything else.
    #[inline(never)]
    pub fn stand(&mut self) -> Servos<'_> {
        self.status.ticks = self.status.ticks.wrapping_add(1);
        self.status.state = if self.control.wish() == Wish::Stop { State::Stopped } else { State::Holding };
        self.rewind();
        self.show()
    }

    /// The servos did not hear of the last tick: they stand where they were before it, and the motion goes on from there.
    #[inline(never)]
    pub fn rewind(&mut self) {
        for (servo, before) in self.servos.iter_mut().zip(&mut self.before) {
            *servo = Limiter::new(*servo.limits(), *before);
        }
        self.held = true;
    }

    #[inline(never)]
    fn show(&mut self) -> Servos<'_> {
        for ((command, servo), channel) in self.commands.iter_mut().zip(&self.servos).zip(&self.robot.channels) {
            *command = channel.command(servo.at());
        }
        self.control.publish(&self.status);
        Servos { commands: &self.commands, state: self.status.state }
    }

    /// A tick of whatever is to be played.
    #[inline(never)]
    fn run(&mut self) -> State {
        if core::mem::take(&mut self.held) {
            // From where the servos came to stand.
            self.begin(self.drive);
        }
        self.load();
        match self.drive {
            Drive::None => {
                for servo in &mut self.servos {
                    servo.settle();
                }
                State::Holding
            }
            Drive::Return => self.go_home(),
            Drive::Motion(reel) => self.play(reel),
        }
    }

    /// A tick of the slow way to where the servos are to be.
    #[inline(never)]
    fn creep(&mut self) -> State {
        let mut there = true;
        for (servo, goal) in self.servos.iter_mut().zip(&self.goal) {
            there &= servo.follow(*goal) && servo.step() == 0;
        }
        if there {
            // Standing: from here on with all that the servos may do.
            for (servo, channel) in self.servos.iter_mut().zip(&self.robot.channels) {
                *servo = Limiter::new(channel.limits(self.robot.tick_rate, channel.speed), servo.at());
            }
            (self.creeping, self.held) = (false, true);
            return State::Holding;
        }
        State::Returning
    }

    /// Begins to follow `drive`, fading from where the servos are.
    #[inline(never)]
    fn begin(&mut self, drive: Drive<C>) {
        self.drive = drive;
        self.faded = 0;
        for (from, servo) in self.from.iter_mut().zip(&self.servos) {
            *from = servo.at();
        }
    }

    /// Takes the frames that the next ticks need, and a motion that begins when none is playing.
    #[inline(never)]
    fn load(&mut self) {
        // A beginning, three frames and an end: nothing needs more at once.
        for _ in 0..5 {
            match (&mut self.drive, self.source.peek()) {
                (_, None) => return,
                (Drive::Motion(reel), Some(_)) if reel.ready() => return,
                (Drive::Motion(reel), Some(Item::Frame(frame))) => {
                    reel.push(*frame);
                    self.status.frames = self.status.frames.wrapping_add(1);
                }
                (Drive::Motion(reel), Some(Item::End)) if reel.taken > 0 => reel.ended = true,
                (Drive::Motion(_), Some(Item::End)) => self.finish(),
                // The next tick goes on throwing away.
                (_, Some(Item::Begin { number, .. })) if self.cutting && is_before(whole(*number), self.cut) => return,
                (_, Some(Item::Begin { number, frame_rate })) => {
                    let reel = FrameWindow::new(whole(*number), *frame_rate);
                    self.begin(Drive::Motion(reel));
                    self.status.motions = self.status.motions.wrapping_add(1);
                }
                // Left over from a motion that was cut off.
                (Drive::None | Drive::Return, Some(_)) => {}
            }
            let _ = self.source.take();
        }
    }

    /// Handles what is not to be played any more, and throws away what of it is queued.
    #[inline(never)]
    fn cut_off(&mut self) {
        let cut = self.control.cut();
        if cut != self.cut {
            (self.cut, self.cutting) = (cut, true);
        }
        if !self.cutting {
            return;
        }
        if let Drive::Motion(reel) = &self.drive
            && is_before(reel.number, cut)
        {
            self.drive = Drive::None;
        }
        let reached = self.throw_away(|number| is_before(number, cut));
        self.cutting = !(reached || matches!(self.drive, Drive::Motion(_)));
    }

    /// Throws away what is queued, at most as much as a tick may, up to the first motion whose number is not `unwanted`. Returns
    /// whether it has come to that one.
    #[inline(never)]
    fn throw_away(&mut self, unwanted: impl Fn(u32) -> bool) -> bool {
        if let Drive::Motion(_) = self.drive {
            // What comes next is its own.
            return false;
        }
        for _ in 0..THROWN_AWAY {
            match self.source.peek() {
                None => return false,
                Some(Item::Begin { number, .. }) if !unwanted(whole(*number)) => return true,
                Some(_) => _ = self.source.take(),
            }
        }
        false
    }

    /// A tick of a motion.
    #[inline(never)]
    fn play(&mut self, mut reel: FrameWindow<C>) -> State {
        if !reel.ready() {
            self.brake();
            return State::Holding;
        }
        let rate = u32::from(self.robot.tick_rate);
        let t = reel.time as f32 / rate as f32;
        let fade = self.weight(self.robot.fade);
        let mut behind = false;
        for (channel, (servo, from)) in self.servos.iter_mut().zip(&self.from).enumerate() {
            let from = super::limiter::degrees(*from);
            let target = from + fade * (reel.at(channel, t) - from);
            let target = units(target);
            servo.follow(target);
            behind |= target.saturating_sub(servo.at()).saturating_abs() > BEHIND;
        }
        self.frame = Some(reel.index as f32 + t);
        self.status.limited = self.status.limited.wrapping_add(u32::from(behind));
        self.faded = self.faded.saturating_add(1);
        reel.time += u32::from(reel.frame_rate);
        let mut state = State::Playing;
        while reel.time >= rate {
            // The next frame is reached; what lies behind it must be known, or nothing does.
            let next = match self.source.peek() {
                _ if reel.ended => None,
                Some(Item::Frame(frame)) => Some(*frame),
                Some(Item::End) => {
                    reel.ended = true;
                    let _ = self.source.take();
                    continue;
                }
                Some(Item::Begin { .. }) => {
                    reel.ended = true;
                    continue;
                }
                None => {
                    // Stays at the next frame until the one behind it comes.
                    reel.time = rate;
                    self.status.starved = self.status.starved.wrapping_add(1);
                    state = State::Starved;
                    break;
                }
            };
            reel.time -= rate;
            reel.index = reel.index.saturating_add(1);
            match next {
                Some(frame) => {
                    let _ = self.source.take();
                    self.status.frames = self.status.frames.wrapping_add(1);
                    reel.push(frame);
                }
                None if reel.left > 0 => {
                    let [_, b, c, d] = reel.frames;
                    reel.frames = [b, c, d, d];
                    reel.left -= 1;
                }
                None => {
                    self.finish();
                    return State::Playing;
                }
            }
        }
        self.drive = Drive::Motion(reel);
        state
    }

    /// The motion has been played.
    fn finish(&mut self) {
        self.status.finished = self.status.finished.wrapping_add(1);
        self.begin(match self.robot.after {
            Rest::Hold => Drive::None,
            Rest::Neutral => Drive::Return,
        });
    }

    /// A tick of the way to neutral.
    #[inline(never)]
    fn go_home(&mut self) -> State {
        let weight = self.weight(self.robot.return_time);
        let mut there = true;
        for ((servo, from), channel) in self.servos.iter_mut().zip(&self.from).zip(&self.robot.channels) {
            let from = super::limiter::degrees(*from);
            let target = if weight >= 1.0 { channel.neutral } else { from + weight * (channel.neutral - from) };
            servo.follow(units(target));
            there &= servo.at() == units(channel.neutral) && servo.step() == 0;
        }
        self.faded = self.faded.saturating_add(1);
        if there && weight >= 1.0 { State::Neutral } else { State::Returning }
    }

    /// Smooth from 0 to 1 within `seconds` of the present fade.
    fn weight(&self, seconds: f32) -> f32 {
        let ticks = seconds * f32::from(self.robot.tick_rate);
        let t = (self.faded as f32 + 1.0) / (ticks + 1.0);
        if t < 1.0 { t * t * (3.0 - 2.0 * t) } else { 1.0 }
    }

    /// Slows every servo down. Returns whether all stand.
    #[inline(never)]
    fn brake(&mut self) -> bool {
        let mut stand = true;
        for servo in &mut self.servos {
            stand &= servo.brake();
        }
        stand
    }
}

impl Channel {
    /// What the servo may do at so many ticks a second, at most at `speed` degrees a second. Limits are rounded to the safe side.
    #[inline(never)]
    fn limits(&self, tick_rate: u16, speed: f32) -> ServoLimits {
        let rate = f32::from(tick_rate);
        let [low, high] = self.range.map(units);
        let (step, change) = (speed / rate * UNITS, self.acceleration / (rate * rate) * UNITS);
        ServoLimits { low, high, step: step as Angle, change: change as Angle }
    }

    /// The command for an angle of the range: its ends are [`Channel::command`]'s.
    #[inline(never)]
    fn command(&self, angle: Angle) -> u16 {
        let [low, high] = self.range.map(|end| i64::from(units(end)));
        let [first, last] = self.command.map(i64::from);
        let (way, span) = (i64::from(angle) - low, high - low);
        let command = (way * (last - first) + span / 2).checked_div(span).map_or(first, |part| first + part);
        let kept = if command < first {
            first
        } else if command > last {
            last
        } else {
            command
        };
        kept as u16
    }

    /// Whether a servo that says that it stands at `command` is in its range, or beyond an end by no more than `slack` degrees.
    #[must_use]
    #[inline(never)]
    pub fn admits(&self, command: u16, slack: f32) -> bool {
        let ([low, high], angle) = (self.range, self.degrees(command));
        angle >= low - slack && angle <= high + slack
    }

    /// Degrees of a command, within the range or not.
    #[inline(never)]
    pub(super) fn degrees(&self, command: u16) -> f32 {
        let ([low, high], [first, last]) = (self.range, self.command.map(f32::from));
        low + (f32::from(command) - first) * (high - low) / (last - first)
    }
}
