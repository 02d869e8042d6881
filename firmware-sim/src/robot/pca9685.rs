//! The registers of a PCA9685, as far as servos need them (NXP data sheet, section 7.3).

/// Registers by address.
mod register {
    pub const MODE1: u8 = 0x00;
    pub const LED0_ON_L: u8 = 0x06;
    pub const LED15_OFF_H: u8 = 0x45;
    pub const ALL_LED_ON_L: u8 = 0xFA;
    pub const PRESCALE: u8 = 0xFE;
}

/// Bits of MODE1.
mod mode1 {
    pub const ALL_CALL: u8 = 0x01;
    pub const SLEEP: u8 = 0x10;
    pub const AUTO_INCREMENT: u8 = 0x20;
}

/// Bit 4 of an OFF_H register: no pulse.
const FULL_OFF: u8 = 0x10;

/// A chip.
#[derive(Debug, Clone)]
pub struct Pca9685 {
    registers: [u8; 256],
    pointer: u8,
}

impl Default for Pca9685 {
    /// As power comes up: asleep, 200 Hz, all outputs off.
    fn default() -> Self {
        let mut registers = [0; 256];
        registers[usize::from(register::MODE1)] = mode1::SLEEP | mode1::ALL_CALL;
        registers[usize::from(register::PRESCALE)] = 0x1E;
        for output in 0..16 {
            registers[usize::from(register::LED0_ON_L) + 4 * output + 3] = FULL_OFF;
        }
        Pca9685 { registers, pointer: 0 }
    }
}

impl Pca9685 {
    fn mode1(&self) -> u8 {
        self.registers[usize::from(register::MODE1)]
    }

    fn step(&mut self) {
        if self.mode1() & mode1::AUTO_INCREMENT != 0 {
            // Past the last output, or the last register, it starts again.
            self.pointer = match self.pointer {
                register::LED15_OFF_H | u8::MAX => 0,
                at => at + 1,
            };
        }
    }

    /// A write transfer: the register's address, then data.
    pub fn write(&mut self, bytes: &[u8]) {
        let Some((pointer, data)) = bytes.split_first() else { return };
        self.pointer = *pointer;
        for &byte in data {
            match self.pointer {
                // The prescaler can only be set while the oscillator is off.
                register::PRESCALE if self.mode1() & mode1::SLEEP == 0 => {}
                register::PRESCALE => self.registers[usize::from(register::PRESCALE)] = byte.max(3),
                at @ register::ALL_LED_ON_L..register::PRESCALE => {
                    for output in 0..16 {
                        let of =
                            usize::from(register::LED0_ON_L) + 4 * output + usize::from(at - register::ALL_LED_ON_L);
                        self.registers[of] = byte;
                    }
                }
                at => self.registers[usize::from(at)] = byte,
            }
            self.step();
        }
    }

    /// A read transfer.
    pub fn read(&mut self, bytes: &mut [u8]) {
        for byte in bytes {
            *byte = self.registers[usize::from(self.pointer)];
            self.step();
        }
    }

    /// Power is lost and comes back.
    pub fn reset(&mut self) {
        *self = Pca9685::default();
    }

    /// Microseconds of the pulses at an output; `None` while there are none.
    #[must_use]
    pub fn pulse(&self, output: u8) -> Option<f64> {
        let at = usize::from(register::LED0_ON_L) + 4 * usize::from(output & 15);
        let value = |low: usize| u16::from_le_bytes([self.registers[low], self.registers[low + 1]]);
        let (on, off) = (value(at), value(at + 2));
        let full_off = self.registers[at + 3] & FULL_OFF != 0;
        if self.mode1() & mode1::SLEEP != 0 || full_off || on == off {
            return None;
        }
        let counts = (off & 0x0FFF).wrapping_sub(on & 0x0FFF) & 0x0FFF;
        Some(f64::from(counts) * self.count())
    }

    /// Microseconds a count.
    #[must_use]
    pub fn count(&self) -> f64 {
        (f64::from(self.registers[usize::from(register::PRESCALE)]) + 1.0) / 25.0
    }

    /// Pulses a second.
    #[must_use]
    pub fn frequency(&self) -> f64 {
        1e6 / (4096.0 * self.count())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_behaves_as_its_data_sheet_says() {
        let mut chip = Pca9685::default();
        assert_eq!((chip.pulse(0), chip.frequency().round()), (None, 197.0));
        chip.write(&[0xFE, 121]);
        chip.write(&[0x00, mode1::AUTO_INCREMENT]);
        chip.write(&[0xFE, 60]);
        assert_eq!(chip.frequency().round(), 50.0, "awake, the prescaler keeps its value");
        chip.write(&[0x06, 0, 0, 0x33, 0x01, 0, 0, 0x66, 0x02]);
        assert!((chip.pulse(0).unwrap() - 1498.2).abs() < 0.1, "{:?}", chip.pulse(0));
        assert!((chip.pulse(1).unwrap() - 2996.3).abs() < 0.1);
        let mut seen = [0; 3];
        chip.write(&[0x08]);
        chip.read(&mut seen);
        assert_eq!(seen, [0x33, 0x01, 0]);
        // Without auto-increment every byte goes to the same register.
        chip.write(&[0x00, 0]);
        chip.write(&[0x08, 1, 2, 3]);
        assert_eq!(chip.registers[0x08..0x0B], [3, 0x01, 0]);
        chip.write(&[0xFD, FULL_OFF]);
        assert_eq!(chip.pulse(1), None);
        chip.reset();
        assert_eq!((chip.pulse(0), chip.registers[0]), (None, 0x11));
    }
}
