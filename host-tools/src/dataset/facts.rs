//! What a clip of several collections is known by: its action in one taxonomy, its side, how good it is, and who may use it.

use serde::{Deserialize, Serialize};

use crate::motion::side::Side;

/// How a motion was recorded.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Quality {
    /// Optical motion capture.
    Optical,
    /// A depth camera: noisy, and with synthetic feet.
    Kinect,
    /// Moved from another skeleton; toes and spine have no motion of their own.
    Retargeted,
}

impl std::fmt::Display for Quality {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Self::Optical => "optical",
            Self::Kinect => "kinect",
            Self::Retargeted => "retargeted",
        })
    }
}

/// What an import with a table of actions knows of a clip.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct Facts {
    /// Canonical name of the action.
    pub action: String,
    /// Side of the action.
    pub side: Side,
    /// Style of the movement, where the collection names one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub style: Option<String>,
    /// Whether the action has enough training clips to be judged.
    pub scored: bool,
    /// How it was recorded.
    pub quality: Quality,
    /// Whether a Kinect's legs count all the same, because the action is done with them.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub own_legs: bool,
    /// Terms of its source.
    pub licence: String,
    /// Who moved, unique over all collections; unknown where the source does not say.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub actor: Option<String>,
    /// Whether the actor is, or where unknown may be, in the training split.
    pub known_actor: bool,
}
