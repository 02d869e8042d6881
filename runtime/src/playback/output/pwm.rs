//! Servos on pins of the microcontroller.

use embedded_hal::pwm::SetDutyCycle;

use super::{Held, Lost, Output, Time};
use crate::playback::robot::{Bus, Channel};

/// PWM pins, by the numbers that the robot's description gives them.
#[derive(Debug)]
pub struct Pwm<P, const N: usize> {
    pins: [P; N],
    period: u32,
}

impl<P: SetDutyCycle, const N: usize> Pwm<P, N> {
    /// Pins whose PWM has a period of so many microseconds: 20 000 for most servos.
    pub const fn new(pins: [P; N], period: u32) -> Self {
        Pwm { pins, period }
    }
}

/// Why a pin could not be set.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum PwmError<E> {
    /// The robot has a servo on a pin that is not there.
    NoPin(u8),
    /// What the pin said.
    Pin(E),
}

impl<P: SetDutyCycle, const N: usize> Output for Pwm<P, N> {
    type Error = PwmError<P::Error>;

    fn serves(&self, channel: &Channel) -> bool {
        matches!(channel.bus, Bus::Pwm { .. })
    }

    fn find(&mut self, channels: &[Channel], index: usize, _: &mut Time<'_>) -> Result<Option<u16>, Self::Error> {
        let Some(Bus::Pwm { pin: number }) = channels.get(index).map(|channel| channel.bus) else { return Ok(None) };
        let pin = self.pins.get_mut(usize::from(number)).ok_or(PwmError::NoPin(number))?;
        pin.set_duty_cycle_fully_off().map_err(PwmError::Pin)?;
        Ok(None)
    }

    fn hold(&mut self, _: &[Channel], _: usize, _: f32, _: &mut Time<'_>) -> Result<Held, Self::Error> {
        Ok(Held::Unknown)
    }

    fn lost(_: &Self::Error) -> Option<Lost> {
        // A pin does not see it.
        None
    }

    fn write(&mut self, channels: &[Channel], commands: &[u16], _: &mut Time<'_>) -> Result<(), Self::Error> {
        for (channel, command) in channels.iter().zip(commands) {
            let Bus::Pwm { pin: number } = channel.bus else { continue };
            let pin = self.pins.get_mut(usize::from(number)).ok_or(PwmError::NoPin(number))?;
            let most = u32::from(pin.max_duty_cycle());
            let scaled = |command: u16, up: u32| (u32::from(command) * most + up).checked_div(self.period).unwrap_or(0);
            // To the nearest count inside the limits.
            let [first, last] = channel.command;
            let (low, high) = (scaled(first, self.period.saturating_sub(1)), scaled(last, 0));
            let nearest = scaled(*command, self.period / 2);
            let duty = if nearest < low {
                low
            } else if nearest > high {
                high
            } else {
                nearest
            };
            let duty = if duty > most { most } else { duty };
            pin.set_duty_cycle(duty as u16).map_err(PwmError::Pin)?;
        }
        Ok(())
    }
}
