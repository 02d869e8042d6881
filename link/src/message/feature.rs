//! Name of a cargo feature.

use core::fmt;

use serde::{Deserialize, Serialize};

use super::FEATURE_BYTES;

/// A cargo feature of the crate `motionette` by name, cut to [`FEATURE_BYTES`] bytes. On the wire a text, so that a host can say the
/// name of one that came after it.
#[derive(Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "Text", into = "Text")]
pub struct Feature {
    bytes: [u8; FEATURE_BYTES],
    length: u8,
}

type Text = heapless::String<FEATURE_BYTES>;

impl Feature {
    /// As much of `name` as fits, cut between characters.
    #[must_use]
    pub fn new(name: &str) -> Self {
        let length = name.floor_char_boundary(FEATURE_BYTES);
        let mut bytes = [0; FEATURE_BYTES];
        bytes.iter_mut().zip(name.bytes().take(length)).for_each(|(to, byte)| *to = byte);
        Feature { bytes, length: length as u8 }
    }

    /// The name.
    #[must_use]
    pub fn as_str(&self) -> &str {
        let text = self.bytes.get(..usize::from(self.length)).unwrap_or_default();
        core::str::from_utf8(text).unwrap_or_default()
    }
}

impl From<Text> for Feature {
    fn from(text: Text) -> Self {
        Feature::new(&text)
    }
}

impl From<Feature> for Text {
    fn from(feature: Feature) -> Self {
        Text::try_from(feature.as_str()).unwrap_or_default()
    }
}

impl fmt::Debug for Feature {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.as_str().fmt(f)
    }
}

impl fmt::Display for Feature {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.as_str())
    }
}
