//! Which feature channels are wanted: the representation picks them, a codec computes no others.

use heapless::Vec;

/// Ranges of channels that one request may select.
pub const MAX_RANGES: usize = 24;

/// Adjoining output channels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Range {
    /// First channel of the layer.
    pub first: usize,
    /// Number of channels.
    pub count: usize,
}

/// The channels that a request needs, in ascending order.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Channels {
    ranges: Vec<Range, MAX_RANGES>,
    count: usize,
}

impl Channels {
    /// No channels yet.
    #[must_use]
    pub const fn new() -> Self {
        Channels { ranges: Vec::new(), count: 0 }
    }

    /// Appends `count` channels from `first` on, which must not lie before those already there; they are joined to the
    /// last range when they follow it. Returns false when there is no room for another range.
    pub fn push(&mut self, first: usize, count: usize) -> bool {
        if count == 0 {
            return true;
        }
        if let Some(last) = self.ranges.last_mut()
            && last.first + last.count == first
        {
            last.count += count;
            self.count += count;
            return true;
        }
        let pushed = self.ranges.push(Range { first, count }).is_ok();
        if pushed {
            self.count += count;
        }
        pushed
    }

    /// How many channels are selected.
    #[must_use]
    pub const fn count(&self) -> usize {
        self.count
    }

    /// Position of `channel` among the selected ones.
    #[must_use]
    pub fn position(&self, channel: usize) -> Option<usize> {
        let mut before = 0;
        for range in &self.ranges {
            if channel >= range.first && channel < range.first + range.count {
                return Some(before + channel - range.first);
            }
            before += range.count;
        }
        None
    }

    /// The ranges.
    pub fn ranges(&self) -> impl Iterator<Item = Range> + '_ {
        self.ranges.iter().copied()
    }
}
