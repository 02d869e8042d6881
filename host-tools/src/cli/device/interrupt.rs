//! Ctrl-C while a robot works for this program.

use std::io;
use std::ops::ControlFlow;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use signal_hook::consts::signal;
use signal_hook::flag;

/// Exit status of a program that a second Ctrl-C ends.
const ENDED: i32 = 130;
/// What asks a program to end: Ctrl-C, a polite `kill`, and a terminal that is closed.
const SIGNALS: &[i32] = &[
    signal::SIGINT,
    signal::SIGTERM,
    #[cfg(unix)]
    signal::SIGHUP,
];

/// Whether somebody wants the program to end.
#[derive(Debug, Clone)]
pub struct Interrupt(Arc<AtomicBool>);

impl Interrupt {
    /// From now on the first signal is noted and the second ends the program.
    ///
    /// # Errors
    /// What the system says.
    pub fn watch() -> io::Result<Self> {
        let noted = Arc::new(AtomicBool::new(false));
        for &signal in SIGNALS {
            // In this order: the first signal does not find its own note.
            flag::register_conditional_shutdown(signal, ENDED, Arc::clone(&noted))?;
            flag::register(signal, Arc::clone(&noted))?;
        }
        Ok(Interrupt(noted))
    }

    /// Breaks off once a signal has come.
    pub fn flow(&self) -> ControlFlow<()> {
        if self.0.load(Ordering::Relaxed) { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    }
}
