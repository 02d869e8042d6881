//! The output-enable pin of the servo chips, where the robot has one.

use core::convert::Infallible;

use embassy_rp::gpio::{AnyPin, Level, Output};
use embedded_hal::digital::{ErrorType, OutputPin};

/// The last pin, and those that I2C has.
const LAST: u8 = 29;
const TAKEN: [u8; 2] = [4, 5];

/// The pin, high until the first commands have been written; none when the chips' pin is tied low.
pub struct Enable(Option<Output<'static>>);

impl Enable {
    /// The pin of that number, high. `None` when there is no such pin, or when it is taken.
    pub fn new(number: Option<u8>) -> Option<Self> {
        let Some(number) = number else { return Some(Enable(None)) };
        if number > LAST || TAKEN.contains(&number) {
            return None;
        }
        // SAFETY: the firmware uses no other pins than those of I2C, which are not this one, and makes one of these.
        let pin = unsafe { AnyPin::steal(number) };
        Some(Enable(Some(Output::new(pin, Level::High))))
    }
}

impl ErrorType for Enable {
    type Error = Infallible;
}

impl OutputPin for Enable {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.0.as_mut().map_or(Ok(()), OutputPin::set_low)
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.0.as_mut().map_or(Ok(()), OutputPin::set_high)
    }
}
