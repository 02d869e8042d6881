//! Impossible cases, loud where somebody can hear.

/// Whether a broken [`invariant!`] panics: in tests and check builds, never in a release.
pub(crate) const LOUD: bool = cfg!(any(test, feature = "invariants"));

/// States what holds by construction. Where it does not, tests and check builds panic with the place and the values; in a release build the
/// code behind it carries on with what it has, and nothing is left of the statement.
///
/// It is for sizes and states that no caller can bring about, never for input: that gets a typed error. Without it, a buffer of a wrong
/// size becomes a plausible motion.
macro_rules! invariant {
    ($holds:expr $(, $($message:tt)+)?) => {
        if $crate::invariant::LOUD {
            assert!($holds $(, $($message)+)?);
        }
    };
}

/// The part `$range` of a slice, which is there by construction; an empty one, after an [`invariant!`], where it is not.
macro_rules! part {
    ($slice:expr, $range:expr) => {
        match $slice.get($range) {
            Some(part) => part,
            None => {
                invariant!(false, "there is no {}", stringify!($slice[$range]));
                &[]
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
                invariant!(false, "there is no {}", stringify!($slice[$range]));
                &mut []
            }
        }
    };
}
