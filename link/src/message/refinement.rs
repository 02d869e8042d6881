//! How a motion is bent onto its anchors, on the wire.

use motionette::refining::Config;
use serde::{Deserialize, Serialize};

/// A refinement method: a number, so that a device can say which one it does not know.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub struct Refinement(pub u8);

impl Refinement {
    /// The one that the device prefers: [`Refinement::EXACT`].
    pub const DEVICE: Refinement = Refinement(0);
    /// None: the planner alone sees the anchors.
    pub const NONE: Refinement = Refinement(1);
    /// Quasi-Newton steps in the coefficients of the anchor intervals, [`Config::fast`].
    pub const FAST: Refinement = Refinement(2);
    /// RouteSolver as published, [`Config::published`].
    pub const PUBLISHED: Refinement = Refinement(3);
    /// Edited in motion space behind so many decoder evaluations, none of which it needs, [`Config::exactly`].
    /// Feet stay where they stand, with anchors and without.
    pub const EXACT: Refinement = Refinement(4);
    /// The same with feet that do not.
    pub const EXACT_FREE_FEET: Refinement = Refinement(5);

    /// Whether decoder evaluations are no more than what may come before it.
    #[must_use]
    pub const fn edits(self) -> bool {
        self.0 == Self::EXACT.0 || self.0 == Self::EXACT_FREE_FEET.0
    }

    /// Whether this version of the link knows it.
    #[must_use]
    pub const fn is_known(self) -> bool {
        self.0 <= Self::EXACT_FREE_FEET.0
    }

    /// The runtime's configuration with a budget of decoder evaluations; `None`: no refinement.
    #[must_use]
    pub const fn config(self, evaluations: u16) -> Option<Config> {
        match self {
            Self::NONE => None,
            Self::PUBLISHED => Some(Config { evaluations, ..Config::published(0) }),
            Self::FAST => Some(Config::fast(evaluations)),
            Self::EXACT_FREE_FEET => Some(Config::fast(evaluations).exactly().free_feet()),
            _ => Some(Config::fast(evaluations).exactly()),
        }
    }
}
