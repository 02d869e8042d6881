//! An I2C controller that gives up in time.
//!
//! The HAL's blocking transfers wait for ever on a bus that is held low; a servo tick must not. The HAL sets the controller and its
//! pins up, transfers are made here, each byte within a deadline.

use embassy_rp::Peri;
use embassy_rp::i2c::{Blocking, Config, I2c, SclPin, SdaPin};
use embassy_rp::pac::{self, i2c::I2c as Registers};
use embassy_rp::peripherals::I2C0;
use embedded_hal::i2c::{ErrorKind, ErrorType, NoAcknowledgeSource, Operation};

use crate::servos::microseconds;

/// Microseconds that a byte may take; one at 400 kHz takes 23, and chips may stretch the clock.
const BYTE_TIMEOUT: u32 = 500;

/// I2C0, 400 kHz.
pub struct Bus {
    _controller: I2c<'static, I2C0, Blocking>,
}

impl Bus {
    /// Sets the controller up.
    pub fn new(
        controller: Peri<'static, I2C0>,
        scl: Peri<'static, impl SclPin<I2C0>>,
        sda: Peri<'static, impl SdaPin<I2C0>>,
    ) -> Self {
        let mut config = Config::default();
        config.frequency = 400_000;
        Bus { _controller: I2c::new_blocking(controller, scl, sda, config) }
    }

    /// Waits for `ready`, at most for a byte's time. The controller is reset if that is over, so that the next transfer starts clean.
    fn wait(&mut self, ready: impl Fn(Registers) -> bool) -> Result<(), ErrorKind> {
        let registers = pac::I2C0;
        let start = microseconds();
        loop {
            if registers.ic_raw_intr_stat().read().tx_abrt() {
                let source = registers.ic_tx_abrt_source().read();
                // Reading clears it.
                let _ = registers.ic_clr_tx_abrt().read();
                return Err(if source.abrt_7b_addr_noack() {
                    ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address)
                } else if source.abrt_txdata_noack() {
                    ErrorKind::NoAcknowledge(NoAcknowledgeSource::Data)
                } else if source.arb_lost() {
                    ErrorKind::ArbitrationLoss
                } else {
                    ErrorKind::Other
                });
            }
            if ready(registers) {
                return Ok(());
            }
            if microseconds().wrapping_sub(start) > BYTE_TIMEOUT {
                registers.ic_enable().write(|w| w.set_enable(false));
                return Err(ErrorKind::Bus);
            }
        }
    }

    /// One byte of a transfer, read when `byte` is none.
    fn command(&mut self, byte: Option<u8>, restart: bool, stop: bool) -> Result<u8, ErrorKind> {
        self.wait(|registers| registers.ic_status().read().tfnf())?;
        pac::I2C0.ic_data_cmd().write(|w| {
            w.set_restart(restart);
            w.set_stop(stop);
            w.set_cmd(byte.is_none());
            w.set_dat(byte.unwrap_or(0));
        });
        if byte.is_some() {
            self.wait(|registers| registers.ic_raw_intr_stat().read().tx_empty())?;
            return Ok(0);
        }
        self.wait(|registers| registers.ic_rxflr().read().rxflr() > 0)?;
        Ok(pac::I2C0.ic_data_cmd().read().dat())
    }
}

impl ErrorType for Bus {
    type Error = ErrorKind;
}

impl embedded_hal::i2c::I2c for Bus {
    fn transaction(&mut self, address: u8, operations: &mut [Operation<'_>]) -> Result<(), ErrorKind> {
        let registers = pac::I2C0;
        registers.ic_enable().write(|w| w.set_enable(false));
        registers.ic_tar().write(|w| w.set_ic_tar(u16::from(address)));
        registers.ic_enable().write(|w| w.set_enable(true));
        let _ = registers.ic_clr_stop_det().read();
        let count = operations.len();
        for (index, operation) in operations.iter_mut().enumerate() {
            let last = index + 1 == count;
            match operation {
                Operation::Write(bytes) => {
                    let length = bytes.len();
                    for (at, byte) in bytes.iter().enumerate() {
                        self.command(Some(*byte), index > 0 && at == 0, last && at + 1 == length)?;
                    }
                }
                Operation::Read(bytes) => {
                    let length = bytes.len();
                    for (at, byte) in bytes.iter_mut().enumerate() {
                        *byte = self.command(None, index > 0 && at == 0, last && at + 1 == length)?;
                    }
                }
            }
        }
        self.wait(|registers| registers.ic_raw_intr_stat().read().stop_det())
    }
}
