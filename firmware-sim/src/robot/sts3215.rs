//! Serial bus servos as they answer: packets in, replies out.

use std::collections::VecDeque;

/// Where a packet's parts lie.
const HEADER: usize = 4;
/// Bytes that the host's receiver keeps.
const RECEIVER: usize = 64;
/// Registers that matter here, of two bytes each but for the first two.
mod register {
    pub const TORQUE: u8 = 40;
    pub const ACCELERATION: u8 = 41;
    pub const GOAL: u8 = 42;
    pub const GOAL_HIGH: u8 = 43;
    pub const SPEED: u8 = 46;
    pub const SPEED_HIGH: u8 = 47;
    pub const POSITION: u8 = 56;
    pub const POSITION_HIGH: u8 = 57;
    pub const TURNING: u8 = 58;
    pub const TURNING_HIGH: u8 = 59;
}

/// A servo's controller.
#[derive(Debug, Clone)]
pub struct Sts3215 {
    /// Its id.
    pub id: u8,
    /// Whether the motor is on.
    pub torque: bool,
    /// Where it is to go, 4096 a turn; `None` before it was told.
    pub goal: Option<u16>,
    /// Largest acceleration, 100 positions a second squared; 0 is as much as it can.
    pub acceleration: u8,
    /// Largest speed, positions a second; 0 is as fast as it can.
    pub speed: u16,
    /// Where it stands.
    pub position: u16,
    /// How fast it turns, positions a second; the highest bit is the direction.
    pub turning: u16,
    /// Where it stood when it awoke: it holds there while its motor is on and no goal has come.
    pub woke_at: u16,
    /// Whether its firmware has started since power came up; before that it hears and says nothing.
    pub awake: bool,
    /// Whether its firmware switches the motor on when power comes up. Both are sold.
    stiff: bool,
    /// Error bits that it reports.
    pub flags: u8,
    /// Microseconds until it answers.
    pub delay: u64,
}

impl Sts3215 {
    /// A servo that stands at `position` as power comes up. A `stiff` one switches its motor on when it awakes.
    #[must_use]
    pub const fn new(id: u8, position: u16, stiff: bool) -> Self {
        Sts3215 {
            id,
            torque: false,
            goal: None,
            acceleration: 0,
            speed: 0,
            position,
            turning: 0,
            woke_at: position,
            awake: false,
            stiff,
            flags: 0,
            delay: 100,
        }
    }

    /// Power is lost and comes back.
    pub fn reset(&mut self) {
        *self = Sts3215 { flags: self.flags, delay: self.delay, ..Sts3215::new(self.id, self.position, self.stiff) };
    }

    /// Its firmware has started.
    pub const fn wake(&mut self) {
        (self.awake, self.torque, self.woke_at) = (true, self.stiff, self.position);
    }

    fn write(&mut self, register: u8, data: &[u8]) {
        for (register, byte) in (register..).zip(data) {
            let ([_, goal], [speed_low, _]) = (self.goal.unwrap_or_default().to_be_bytes(), self.speed.to_le_bytes());
            match register {
                register::TORQUE => self.torque = *byte != 0,
                register::ACCELERATION => self.acceleration = *byte,
                register::GOAL => self.goal = Some(u16::from_le_bytes([*byte, 0])),
                register::GOAL_HIGH => {
                    self.goal = Some(u16::from_le_bytes([goal, *byte]) & 0x0FFF);
                    // A new goal switches the motor on: not every firmware does so, and this one must not be a surprise.
                    self.torque = true;
                }
                register::SPEED => self.speed = u16::from_le_bytes([*byte, 0]),
                register::SPEED_HIGH => self.speed = u16::from_le_bytes([speed_low, *byte]),
                _ => {}
            }
        }
    }

    fn read(&self, register: u8, length: u8) -> Vec<u8> {
        let [goal, speed, position, turning] =
            [self.goal.unwrap_or(self.position), self.speed, self.position, self.turning].map(u16::to_le_bytes);
        let at = |register: u8| match register {
            register::TORQUE => u8::from(self.torque),
            register::ACCELERATION => self.acceleration,
            register::GOAL..=register::GOAL_HIGH => goal[usize::from(register - register::GOAL)],
            register::SPEED..=register::SPEED_HIGH => speed[usize::from(register - register::SPEED)],
            register::POSITION..=register::POSITION_HIGH => position[usize::from(register - register::POSITION)],
            register::TURNING..=register::TURNING_HIGH => turning[usize::from(register - register::TURNING)],
            _ => 0,
        };
        (0..length).map(|offset| at(register.wrapping_add(offset))).collect()
    }
}

/// A wire with servos.
#[derive(Debug, Clone, Default)]
pub struct Chain {
    /// The servos.
    pub servos: Vec<Sts3215>,
    received: Vec<u8>,
    /// Bytes on the way to the host, with the time at which they are there.
    pub answers: VecDeque<(u64, u8)>,
}

fn checksum(bytes: &[u8]) -> u8 {
    !bytes.iter().fold(0u8, |sum, byte| sum.wrapping_add(*byte))
}

impl Chain {
    /// Bytes arrive at `now`; `byte_time` is what a byte takes, microseconds.
    pub fn receive(&mut self, bytes: &[u8], now: u64, byte_time: u64) {
        self.received.extend(bytes);
        loop {
            let start = self.received.windows(2).position(|pair| pair == [0xFF, 0xFF]);
            let Some(start) = start else {
                let keep = usize::from(self.received.last() == Some(&0xFF));
                self.received.drain(..self.received.len() - keep);
                return;
            };
            self.received.drain(..start);
            let Some(&length) = self.received.get(3) else { return };
            let end = HEADER + usize::from(length);
            if length < 2 || self.received[2] == 0xFF {
                self.received.drain(..1);
                continue;
            }
            if self.received.len() < end {
                return;
            }
            let packet: Vec<u8> = self.received.drain(..end).collect();
            if checksum(&packet[2..end - 1]) == packet[end - 1] {
                self.execute(packet[2], packet[4], &packet[5..end - 1], now, byte_time);
            }
        }
    }

    fn execute(&mut self, id: u8, instruction: u8, parameters: &[u8], now: u64, byte_time: u64) {
        match (instruction, parameters) {
            (0x02, [register, length]) => {
                let Some(servo) = self.servos.iter().find(|servo| servo.id == id && servo.awake) else { return };
                let mut reply = vec![0xFF, 0xFF, id, length + 2, servo.flags];
                reply.extend(servo.read(*register, *length));
                reply.push(checksum(&reply[2..]));
                let times = (1..).map(|k| now + servo.delay + k * byte_time);
                // What nobody reads in time is lost.
                let room = RECEIVER.saturating_sub(self.answers.len());
                self.answers.extend(times.zip(reply).take(room));
            }
            (0x03, [register, data @ ..]) => {
                self.servos
                    .iter_mut()
                    .filter(|servo| servo.awake && (servo.id == id || id == 0xFE))
                    .for_each(|s| s.write(*register, data));
            }
            (0x83, [register, length, data @ ..]) => {
                for part in data.chunks_exact(usize::from(*length) + 1) {
                    let (id, data) = (part[0], &part[1..]);
                    self.servos
                        .iter_mut()
                        .filter(|servo| servo.awake && servo.id == id)
                        .for_each(|s| s.write(*register, data));
                }
            }
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packets_of_the_manual_are_understood_and_damaged_ones_are_not() {
        let mut chain =
            Chain { servos: vec![Sts3215::new(1, 2048, false), Sts3215::new(2, 100, false)], ..Chain::default() };
        chain.receive(&[0xFF, 0xFF, 0x01, 0x04, 0x02, 0x38, 0x02, 0xBE], 0, 10);
        assert!(chain.answers.is_empty(), "nothing is said before the firmware has started");
        chain.servos.iter_mut().for_each(Sts3215::wake);
        // Read two bytes of the position of servo 1, in pieces and behind noise.
        chain.receive(&[0x55, 0xFF, 0xFF, 0x01, 0x04], 0, 10);
        chain.receive(&[0x02, 0x38, 0x02, 0xBE], 50, 10);
        let reply: Vec<u8> = chain.answers.drain(..).map(|(_, byte)| byte).collect();
        assert_eq!(reply, [0xFF, 0xFF, 0x01, 0x04, 0x00, 0x00, 0x08, 0xF2]);
        // Goals of both at once: 2000 and 1000.
        let mut packet = vec![0xFF, 0xFF, 0xFE, 0x0A, 0x83, 0x2A, 0x02, 0x01, 0xD0, 0x07, 0x02, 0xE8, 0x03];
        packet.push(checksum(&packet[2..]));
        let mut damaged = packet.clone();
        damaged[8] ^= 1;
        chain.receive(&damaged, 100, 10);
        assert!(chain.servos.iter().all(|servo| servo.goal.is_none()));
        chain.receive(&packet, 200, 10);
        assert_eq!((chain.servos[0].goal, chain.servos[1].goal), (Some(2000), Some(1000)));
        // Acceleration, goal, time and speed of servo 1 at once, read back.
        let mut packet = vec![0xFF, 0xFF, 0x01, 0x0A, 0x03, 0x29, 50, 0xE8, 0x03, 0, 0, 0xDC, 0x05];
        packet.push(checksum(&packet[2..]));
        chain.receive(&packet, 300, 10);
        assert_eq!((chain.servos[0].acceleration, chain.servos[0].goal, chain.servos[0].speed), (50, Some(1000), 1500));
        assert_eq!(chain.servos[0].read(40, 8), [1, 50, 0xE8, 0x03, 0, 0, 0xDC, 0x05]);
        chain.servos[0].reset();
        assert_eq!((chain.servos[0].torque, chain.servos[0].acceleration), (false, 0), "forgotten");
    }
}
