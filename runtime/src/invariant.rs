//! Impossible cases, loud where somebody can hear.

/// States what holds by construction. Where it does not, tests and check builds panic with the place and the values; in a release build the
/// code behind it carries on with what it has, and nothing is left of the statement.
///
/// It is for sizes and states that no caller can bring about, never for input: that gets a typed error. Without it, a buffer of a wrong
/// size becomes a plausible motion.
macro_rules! invariant {
    ($holds:expr, $($message:tt)+) => {
        #[cfg(any(test, feature = "invariants"))]
        {
            assert!($holds, $($message)+);
        }
    };
    ($holds:expr) => {
        #[cfg(any(test, feature = "invariants"))]
        {
            assert!($holds);
        }
    };
}

/// The part `$range` of a slice, which is there by construction; an empty one, after an [`invariant!`], where it is not.
macro_rules! part {
    ($slice:expr, $range:expr) => {
        match $slice.get($range) {
            Some(part) => part,
            None => {
                invariant!(false, "no such part of a slice: {}", stringify!($slice[$range]));
                Default::default()
            }
        }
    };
}

/// The same, to be written.
macro_rules! part_mut {
    ($slice:expr, $range:expr) => {
        match $slice.get_mut($range) {
            Some(part) => part,
            None => {
                invariant!(false, "no such part of a slice: {}", stringify!($slice[$range]));
                Default::default()
            }
        }
    };
}

pub(crate) use {invariant, part, part_mut};
