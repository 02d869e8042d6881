//! The one place where logging is chosen: `defmt` with the feature of that name, nothing without it.

/// A message about normal work.
#[cfg(feature = "defmt")]
macro_rules! debug {
    ($($argument:tt)*) => { defmt::debug!($($argument)*) };
}

/// A message about something refused.
#[cfg(feature = "defmt")]
macro_rules! refused {
    ($($argument:tt)*) => { defmt::warn!($($argument)*) };
}

/// A message about normal work (logging is off: arguments are only type-checked).
#[cfg(not(feature = "defmt"))]
macro_rules! debug {
    ($text:literal $(, $argument:expr)*) => {{ $(let _ = &$argument;)* }};
}

/// A message about something refused (logging is off: arguments are only type-checked).
#[cfg(not(feature = "defmt"))]
macro_rules! refused {
    ($text:literal $(, $argument:expr)*) => {{ $(let _ = &$argument;)* }};
}

pub(crate) use {debug, refused};
