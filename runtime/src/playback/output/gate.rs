//! An output-enable pin.

use embedded_hal::digital::OutputPin;

use super::{EitherError, Held, Lost, Output, Time};
use crate::playback::robot::Channel;

/// An output whose chips give pulses only while a pin is low: `OE` of a PCA9685, pulled high by a resistor, so that nothing is given
/// while the microcontroller starts, either. The pin goes low when the first commands have been written.
#[derive(Debug)]
pub struct Gate<O, P> {
    output: O,
    pin: P,
}

impl<O: Output, P: OutputPin> Gate<O, P> {
    /// `output` behind `pin`, which SHOULD be high.
    pub const fn new(output: O, pin: P) -> Self {
        Gate { output, pin }
    }

    /// What is behind the pin.
    pub const fn output(&mut self) -> &mut O {
        &mut self.output
    }
}

impl<O: Output, P: OutputPin> Output for Gate<O, P> {
    type Error = EitherError<O::Error, P::Error>;

    fn serves(&self, channel: &Channel) -> bool {
        self.output.serves(channel)
    }

    fn find(&mut self, channels: &[Channel], index: usize, time: &mut Time<'_>) -> Result<Option<u16>, Self::Error> {
        self.pin.set_high().map_err(EitherError::Second)?;
        self.output.find(channels, index, time).map_err(EitherError::First)
    }

    fn hold(
        &mut self,
        channels: &[Channel],
        index: usize,
        slack: f32,
        time: &mut Time<'_>,
    ) -> Result<Held, Self::Error> {
        self.output.hold(channels, index, slack, time).map_err(EitherError::First)
    }

    fn write(&mut self, channels: &[Channel], commands: &[u16], time: &mut Time<'_>) -> Result<(), Self::Error> {
        self.output.write(channels, commands, time).map_err(EitherError::First)?;
        self.pin.set_low().map_err(EitherError::Second)
    }

    fn lost(error: &Self::Error) -> Option<Lost> {
        match error {
            EitherError::First(error) => O::lost(error),
            EitherError::Second(_) => None,
        }
    }
}
