//! Servos on a PCA9685, through the driver crate `pwm-pca9685`.

use embedded_hal::i2c::I2c;
use pwm_pca9685::{Channel as Outputs, Pca9685 as Driver};

use super::{Held, Lost, Output, Time};
use crate::playback::robot::{Bus, Channel};

/// Counts of the chip's oscillator a microsecond.
const OSCILLATOR_MHZ: u32 = 25;
/// Counts a period.
const COUNTS: u32 = 4096;
/// Registers that say whether the chip is as it was set up.
const MODE1: u8 = 0x00;
const PRESCALE: u8 = 0xFE;
/// The bit of [`MODE1`] that is set after power came up.
const SLEEP: u8 = 0x10;

/// One PCA9685. Its 16 outputs are given their pulses in one transfer.
///
/// Before each transfer the chip is asked whether it still runs as it was set up: one that lost its power sleeps and has forgotten
/// everything, and would acknowledge commands that move nothing. It is then set up anew, at the next attempt.
#[derive(Debug)]
pub struct Pca9685<I2C> {
    /// `None` only while a transfer is under way.
    i2c: Option<I2C>,
    address: u8,
    prescale: u8,
    off: [u16; 16],
    /// Whether it has been set up before.
    known: bool,
}

/// Why a chip could not be written to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Pca9685Error<E> {
    /// The bus failed.
    Bus(E),
    /// The chip had lost its setting, most likely its power. The next attempt sets it up again.
    Reset,
    /// The driver refused the address or a value.
    Refused,
}

impl<E> From<pwm_pca9685::Error<E>> for Pca9685Error<E> {
    fn from(error: pwm_pca9685::Error<E>) -> Self {
        match error {
            pwm_pca9685::Error::I2C(error) => Pca9685Error::Bus(error),
            _ => Pca9685Error::Refused,
        }
    }
}

impl<I2C: I2c> Pca9685<I2C> {
    /// The chip at `address`, with pulses `frequency` times a second (24 to 1526; 50 for most servos). Nothing is sent yet.
    pub const fn new(i2c: I2C, address: u8, frequency: u16) -> Self {
        let rate = COUNTS * if frequency < 24 { 24 } else { frequency as u32 };
        let prescale = (OSCILLATOR_MHZ * 1_000_000 + rate / 2) / rate - 1;
        let prescale = if prescale > 255 {
            255
        } else if prescale < 3 {
            3
        } else {
            prescale as u8
        };
        Pca9685 { i2c: Some(i2c), address, prescale, off: [0; 16], known: false }
    }

    /// The bus.
    pub const fn bus(&mut self) -> Option<&mut I2C> {
        self.i2c.as_mut()
    }

    /// Counts of a pulse, microseconds, to the nearest whole number inside `[first, last]`.
    fn counts(&self, pulse: u16, [first, last]: [u16; 2]) -> u16 {
        let step = u32::from(self.prescale) + 1;
        let rounded = |pulse: u16, up: u32| (u32::from(pulse) * OSCILLATOR_MHZ + up) / step;
        let (least, most) = (rounded(first, step - 1), rounded(last, 0));
        let nearest = rounded(pulse, step / 2);
        let kept = if nearest < least {
            least
        } else if nearest > most {
            most
        } else {
            nearest
        };
        if kept >= COUNTS { COUNTS as u16 - 1 } else { kept as u16 }
    }

    fn register(&mut self, register: u8) -> Result<u8, Pca9685Error<I2C::Error>> {
        let i2c = self.i2c.as_mut().ok_or(Pca9685Error::Refused)?;
        let mut value = [0];
        i2c.write_read(self.address, &[register], &mut value).map_err(Pca9685Error::Bus)?;
        let [value] = value;
        Ok(value)
    }

    /// Does something with the driver, which owns the bus meanwhile.
    fn with_driver(
        &mut self,
        work: impl FnOnce(&mut Driver<I2C>, &[u16; 16]) -> Result<(), pwm_pca9685::Error<I2C::Error>>,
    ) -> Result<(), Pca9685Error<I2C::Error>> {
        let i2c = self.i2c.take().ok_or(Pca9685Error::Refused)?;
        // Addresses that the driver would refuse are none that a checked robot has.
        let mut driver = Driver::new(i2c, self.address)?;
        let done = work(&mut driver, &self.off);
        self.i2c = Some(driver.destroy());
        Ok(done?)
    }
}

impl<I2C: I2c> Output for Pca9685<I2C> {
    type Error = Pca9685Error<I2C::Error>;

    fn serves(&self, channel: &Channel) -> bool {
        matches!(channel.bus, Bus::Pca9685 { address, .. } if address == self.address)
    }

    fn find(&mut self, _: &[Channel], _: usize, _: &mut Time<'_>) -> Result<Option<u16>, Self::Error> {
        // After a reset of the microcontroller alone it still runs.
        self.with_driver(|driver, _| {
            driver.set_channel_full_off(Outputs::All)?;
            driver.disable()
        })?;
        self.known = false;
        Ok(None)
    }

    fn hold(&mut self, _: &[Channel], _: usize, _: f32, _: &mut Time<'_>) -> Result<Held, Self::Error> {
        Ok(Held::Unknown)
    }

    fn lost(error: &Self::Error) -> Option<Lost> {
        matches!(error, Pca9685Error::Reset).then_some(Lost::Blind)
    }

    fn write(&mut self, channels: &[Channel], commands: &[u16], _: &mut Time<'_>) -> Result<(), Self::Error> {
        for (channel, command) in channels.iter().zip(commands) {
            if let Bus::Pca9685 { address, output } = channel.bus
                && address == self.address
            {
                let counts = self.counts(*command, channel.command);
                if let Some(off) = self.off.get_mut(usize::from(output)) {
                    *off = counts;
                }
            }
        }
        let (mode, prescale) = (self.register(MODE1)?, self.register(PRESCALE)?);
        if mode & SLEEP != 0 || prescale != self.prescale {
            // The first time nothing was lost.
            if core::mem::replace(&mut self.known, false) {
                return Err(Pca9685Error::Reset);
            }
            let prescale = self.prescale;
            // Pulses are set before they begin.
            self.with_driver(|driver, off| {
                driver.disable()?;
                driver.set_prescale(prescale)?;
                driver.set_all_on_off(&[0; 16], off)?;
                driver.enable()
            })?;
            self.known = true;
            return Ok(());
        }
        self.with_driver(|driver, off| {
            driver.enable()?;
            driver.set_all_on_off(&[0; 16], off)
        })
    }
}
