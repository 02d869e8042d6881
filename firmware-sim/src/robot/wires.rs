//! The buses between firmware and hardware, as `embedded-hal` and `embedded-io` see them; [`Faulty`] stands between and spoils them.

use std::cell::RefCell;
use std::rc::Rc;

use embedded_hal::i2c::{ErrorKind as I2cError, ErrorType as I2cErrorType, I2c, NoAcknowledgeSource, Operation};
use embedded_hal::pwm::{ErrorType as PwmErrorType, SetDutyCycle};
use embedded_io::{ErrorKind as SerialError, ErrorType as SerialErrorType, Read, ReadReady, Write};

use super::clock::Clock;
use super::faults::{Injector, Kind};
use super::hardware::Hardware;

/// Microseconds a byte takes on I2C at 400 kHz, acknowledgement included.
const I2C_BYTE: u64 = 23;
/// Microseconds a byte takes on a serial bus at 1 Mbaud.
pub const SERIAL_BYTE: u64 = 10;
/// Microseconds after which a controller gives up on a bus that is held.
const STUCK_TIMEOUT: u64 = 2_000;
/// Microseconds by which a late chip stretches the clock of a transfer.
const STRETCH: u64 = 1_000;
/// Microseconds by which a late servo's answer is late.
const LATE: u64 = 7_000;

/// A bus with PCA9685 chips.
#[derive(Debug, Clone)]
pub struct I2cWire {
    /// The chips are there.
    pub hardware: Rc<RefCell<Hardware>>,
    /// What transfers take passes here.
    pub clock: Clock,
}

impl I2cErrorType for I2cWire {
    type Error = I2cError;
}

impl I2c for I2cWire {
    fn transaction(&mut self, address: u8, operations: &mut [Operation<'_>]) -> Result<(), I2cError> {
        let bytes: usize = operations
            .iter()
            .map(|operation| match operation {
                Operation::Read(bytes) => bytes.len() + 1,
                Operation::Write(bytes) => bytes.len() + 1,
            })
            .sum();
        self.clock.pass(bytes as u64 * I2C_BYTE);
        let mut hardware = self.hardware.borrow_mut();
        let Some(chip) = hardware.chips.get_mut(&address) else {
            return Err(I2cError::NoAcknowledge(NoAcknowledgeSource::Address));
        };
        for operation in operations {
            match operation {
                Operation::Read(bytes) => chip.read(bytes),
                Operation::Write(bytes) => chip.write(bytes),
            }
        }
        Ok(())
    }
}

/// A bus with serial servos.
#[derive(Debug, Clone)]
pub struct SerialWire {
    /// The servos are there.
    pub hardware: Rc<RefCell<Hardware>>,
    /// What transfers and waiting take passes here.
    pub clock: Clock,
}

impl SerialErrorType for SerialWire {
    type Error = SerialError;
}

impl Write for SerialWire {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, SerialError> {
        self.clock.pass(bytes.len() as u64 * SERIAL_BYTE);
        self.hardware.borrow_mut().chain.receive(bytes, self.clock.now(), SERIAL_BYTE);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> Result<(), SerialError> {
        Ok(())
    }
}

impl ReadReady for SerialWire {
    fn read_ready(&mut self) -> Result<bool, SerialError> {
        // Asking takes time; without it nobody could wait.
        self.clock.pass(2);
        let hardware = self.hardware.borrow();
        Ok(hardware.chain.answers.front().is_some_and(|(at, _)| *at <= self.clock.now()))
    }
}

impl Read for SerialWire {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize, SerialError> {
        let mut hardware = self.hardware.borrow_mut();
        let Some((at, byte)) = hardware.chain.answers.pop_front() else { return Ok(0) };
        self.clock.pass_until(at);
        bytes[0] = byte;
        Ok(1)
    }
}

/// A pin of the microcontroller with a period of 20 ms.
#[derive(Debug, Clone)]
pub struct Pin {
    /// The servo's wire ends there.
    pub hardware: Rc<RefCell<Hardware>>,
    /// Its number.
    pub number: u8,
}

/// Counts of a pin's period.
const PIN_COUNTS: u16 = 20_000;

impl PwmErrorType for Pin {
    type Error = core::convert::Infallible;
}

impl SetDutyCycle for Pin {
    fn max_duty_cycle(&self) -> u16 {
        PIN_COUNTS
    }

    fn set_duty_cycle(&mut self, duty: u16) -> Result<(), Self::Error> {
        self.hardware.borrow_mut().pins.insert(self.number, duty);
        Ok(())
    }
}

/// A wire with faults.
#[derive(Debug, Clone)]
pub struct Faulty<W> {
    /// The wire as it is.
    pub wire: W,
    /// What goes wrong on it.
    pub injector: Rc<RefCell<Injector>>,
    /// When it is.
    pub clock: Clock,
    /// Until when an answer is held back.
    held: Option<u64>,
}

impl<W> Faulty<W> {
    /// `wire`, with what `injector` says going wrong on it.
    pub const fn new(wire: W, injector: Rc<RefCell<Injector>>, clock: Clock) -> Self {
        Faulty { wire, injector, clock, held: None }
    }

    fn active(&self, kind: Kind) -> bool {
        self.injector.borrow().active(kind, self.clock.now())
    }
}

impl<W: I2cErrorType> I2cErrorType for Faulty<W> {
    type Error = I2cError;
}

impl<W: I2c<Error = I2cError>> I2c for Faulty<W> {
    fn transaction(&mut self, address: u8, operations: &mut [Operation<'_>]) -> Result<(), I2cError> {
        if self.active(Kind::Stuck) {
            self.clock.pass(STUCK_TIMEOUT);
            return Err(I2cError::Bus);
        }
        if self.active(Kind::Nack) || self.active(Kind::Brownout) {
            self.clock.pass(I2C_BYTE);
            return Err(I2cError::NoAcknowledge(NoAcknowledgeSource::Address));
        }
        if self.active(Kind::Late) {
            self.clock.pass(STRETCH);
        }
        self.wire.transaction(address, operations)?;
        // I2C has no checksum: only what is read back can be told from what was meant.
        if self.active(Kind::Bit) && self.injector.borrow_mut().chance(1, 3) {
            for operation in operations {
                if let Operation::Read(bytes) = operation {
                    self.injector.borrow_mut().flip(bytes);
                }
            }
        }
        Ok(())
    }
}

impl<W: SerialErrorType> SerialErrorType for Faulty<W> {
    type Error = W::Error;
}

impl<W: Write> Write for Faulty<W> {
    fn write(&mut self, bytes: &[u8]) -> Result<usize, Self::Error> {
        if self.active(Kind::Stuck) || self.active(Kind::Brownout) {
            // Sent, and heard by nobody.
            self.clock.pass(bytes.len() as u64 * SERIAL_BYTE);
            return Ok(bytes.len());
        }
        let mut sent = bytes.to_vec();
        if self.active(Kind::Bit) && self.injector.borrow_mut().chance(1, 2) {
            self.injector.borrow_mut().flip(&mut sent);
        }
        self.wire.write(&sent)
    }

    fn flush(&mut self) -> Result<(), Self::Error> {
        self.wire.flush()
    }
}

impl<W: ReadReady> ReadReady for Faulty<W> {
    fn read_ready(&mut self) -> Result<bool, Self::Error> {
        if self.active(Kind::Nack) || self.active(Kind::Stuck) || self.active(Kind::Brownout) {
            self.clock.pass(50);
            return Ok(false);
        }
        if !self.active(Kind::Late) {
            self.held = None;
        } else if self.wire.read_ready()? {
            let until = *self.held.get_or_insert(self.clock.now() + LATE);
            if self.clock.now() < until {
                return Ok(false);
            }
        }
        self.wire.read_ready()
    }
}

impl<W: Read + ReadReady> Read for Faulty<W> {
    fn read(&mut self, bytes: &mut [u8]) -> Result<usize, Self::Error> {
        let count = self.wire.read(bytes)?;
        // The next answer is late again.
        self.held = self.held.filter(|_| self.wire.read_ready().unwrap_or(false));
        if self.active(Kind::Bit) && self.injector.borrow_mut().chance(1, 10) {
            self.injector.borrow_mut().flip(&mut bytes[..count]);
        }
        Ok(count)
    }
}
