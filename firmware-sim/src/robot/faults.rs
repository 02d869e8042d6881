//! Faults, and the middleware that injects them: what stands between the driver and the hardware, and is both to the other.

use std::fmt;
use std::str::FromStr;

use motionette::numerics::hash::Stream;
use serde::Serialize;

/// What goes wrong.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// A chip does not acknowledge; a serial servo does not answer.
    Nack,
    /// The bus is held low: nothing gets through until it is let go.
    Stuck,
    /// Replies come too late: the clock is stretched, or a servo takes its time.
    Late,
    /// A bit flips in what is read (I2C), or in anything (serial).
    Bit,
    /// Power of chips and servos is lost and comes back.
    Brownout,
    /// The blob in flash is damaged.
    Corrupt,
    /// The next motion is not ready when the present one ends.
    Overrun,
    /// The arena is smaller than the request needs.
    Arena,
}

impl Kind {
    /// All of them.
    pub const ALL: [Kind; 8] =
        [Kind::Nack, Kind::Stuck, Kind::Late, Kind::Bit, Kind::Brownout, Kind::Corrupt, Kind::Overrun, Kind::Arena];

    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Kind::Nack => "nack",
            Kind::Stuck => "stuck",
            Kind::Late => "late",
            Kind::Bit => "bit",
            Kind::Brownout => "brownout",
            Kind::Corrupt => "corrupt",
            Kind::Overrun => "overrun",
            Kind::Arena => "arena",
        }
    }

    /// Whether it happens to chips, servos and wires, at some time of the run.
    #[must_use]
    pub const fn is_electrical(self) -> bool {
        matches!(self, Kind::Nack | Kind::Stuck | Kind::Late | Kind::Bit | Kind::Brownout)
    }

    /// How long it lasts, milliseconds: shortest and longest.
    const fn duration(self) -> [u32; 2] {
        match self {
            Kind::Nack => [15, 120],
            Kind::Stuck => [200, 900],
            Kind::Late => [60, 400],
            Kind::Bit => [100, 500],
            Kind::Brownout => [30, 250],
            Kind::Corrupt | Kind::Overrun | Kind::Arena => [0, 0],
        }
    }
}

impl fmt::Display for Kind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Kind {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        Kind::ALL.into_iter().find(|kind| kind.name() == text).ok_or_else(|| {
            let known: Vec<&str> = Kind::ALL.iter().map(|kind| kind.name()).collect();
            format!("no fault is called {text:?}; known are {}", known.join(", "))
        })
    }
}

/// A fault of a run.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Fault {
    /// What.
    pub kind: Kind,
    /// When it begins, microseconds of the run.
    pub from: u64,
    /// When it is over.
    pub until: u64,
}

/// Draws when the faults happen, within `[from, until]` microseconds, apart from each other.
#[must_use]
pub fn schedule(kinds: &[Kind], seed: u64, [from, until]: [u64; 2]) -> Vec<Fault> {
    let mut random = Stream::new(seed ^ 0x000F_A017);
    let part = (until.saturating_sub(from)) / kinds.len().max(1) as u64;
    let mut faults = Vec::new();
    for (index, &kind) in kinds.iter().enumerate() {
        let [shortest, longest] = kind.duration();
        let lasts = u64::from(shortest + random.below(longest - shortest + 1)) * 1000;
        let room = part.saturating_sub(lasts).max(1);
        let from = from + index as u64 * part + u64::from(random.below(u32::try_from(room).unwrap_or(u32::MAX)));
        faults.push(Fault { kind, from, until: from + lasts });
    }
    faults
}

/// Which faults are in force.
#[derive(Debug, Clone)]
pub struct Injector {
    faults: Vec<Fault>,
    random: Stream,
}

impl Injector {
    /// Of a run's faults.
    #[must_use]
    pub fn new(faults: &[Fault], seed: u64) -> Self {
        Injector { faults: faults.to_vec(), random: Stream::new(seed) }
    }

    /// Whether a fault of that kind is in force.
    #[must_use]
    pub fn active(&self, kind: Kind, now: u64) -> bool {
        self.faults.iter().any(|fault| fault.kind == kind && (fault.from..fault.until).contains(&now))
    }

    /// True with a probability of `one` in `of`.
    pub fn chance(&mut self, one: u32, of: u32) -> bool {
        self.random.below(of) < one
    }

    /// Flips a bit of `bytes`.
    pub fn flip(&mut self, bytes: &mut [u8]) {
        if !bytes.is_empty() {
            let at = self.random.below(bytes.len() as u32) as usize;
            bytes[at] ^= 1 << self.random.below(8);
        }
    }
}
