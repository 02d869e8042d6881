//! Virtual time: advanced by what takes time, never slept on.

use std::cell::Cell;
use std::rc::Rc;

/// Microseconds since power came up; clones are one clock.
#[derive(Debug, Clone, Default)]
pub struct Clock(Rc<Cell<u64>>);

impl Clock {
    /// Now, microseconds.
    #[must_use]
    pub fn now(&self) -> u64 {
        self.0.get()
    }

    /// Lets time pass.
    pub fn pass(&self, microseconds: u64) {
        self.0.set(self.now() + microseconds);
    }

    /// Lets time pass until then, if that is not past.
    pub fn pass_until(&self, time: u64) {
        self.0.set(self.now().max(time));
    }
}
