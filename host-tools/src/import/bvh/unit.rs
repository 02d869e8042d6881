//! What a unit of a file is, and whether the body is of a size that fits.

use std::fmt;
use std::ops::RangeInclusive;
use std::str::FromStr;

use serde::Deserialize;
use serde_json::Value;

use super::Problem;
use crate::motion::quaternion::{self as q, Vector};
use crate::motion::{JOINTS, skeleton};

/// Metres a unit of a file: finite and above zero. From text `m`, `cm`, `mm`, `inch`, `cmu` (the CMU database's 0.45 of an inch scale) or a
/// number.
#[derive(Debug, Clone, Copy, PartialEq, Deserialize)]
#[serde(try_from = "Value")]
pub struct Unit(f64);

/// Units by name, the likely ones first.
const NAMED: [(&str, f64); 5] = [("cm", 0.01), ("m", 1.0), ("inch", 0.0254), ("mm", 0.001), ("cmu", 0.0254 / 0.45)];

/// Heights that need no word, metres.
const USUAL: RangeInclusive<f64> = 1.0..=2.5;
/// Heights that are taken where someone stated the unit, metres.
const POSSIBLE: RangeInclusive<f64> = 0.25..=5.0;
/// Height to which a likely unit comes closest, metres.
const TYPICAL: f64 = 1.7;

impl Unit {
    /// Hundredths of a metre, what most programs write.
    pub const CENTIMETRE: Self = Self(0.01);

    /// A unit of so many metres; `None` for what is not finite and above zero.
    pub fn new(metres: f64) -> Option<Self> {
        (metres.is_finite() && metres > 0.0).then_some(Self(metres))
    }

    /// Metres.
    pub const fn metres(self) -> f64 {
        self.0
    }

    /// The named unit in which a body of `height` units is nearest to a person's size; `None` when none makes it one.
    pub(super) fn likely(height: f64) -> Option<Self> {
        let off = |metres: f64| (height * metres / TYPICAL).ln().abs();
        let (_, metres) = NAMED.into_iter().min_by(|a, b| off(a.1).total_cmp(&off(b.1)))?;
        USUAL.contains(&(height * metres)).then_some(Self(metres))
    }
}

impl FromStr for Unit {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wanted = text.trim().to_lowercase();
        let alias = match wanted.as_str() {
            "metre" | "meter" | "metres" | "meters" => "m",
            "in" | "inches" => "inch",
            other => other,
        };
        let named = NAMED.into_iter().find(|(name, _)| *name == alias).map(|(_, metres)| metres);
        named.or_else(|| wanted.parse().ok()).and_then(Self::new).ok_or_else(|| {
            format!("{text:?} is no unit: write m, cm, mm, inch, cmu, or the metres of a unit as a number, e.g. 0.01")
        })
    }
}

impl TryFrom<Value> for Unit {
    type Error = String;

    fn try_from(value: Value) -> Result<Self, String> {
        match &value {
            Value::String(name) => name.parse(),
            // The number as it is written: see `Source`.
            other => other.to_string().parse(),
        }
    }
}

impl fmt::Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match NAMED.into_iter().find(|(_, metres)| (metres / self.0 - 1.0).abs() < 1e-3) {
            Some((name, _)) => f.write_str(name),
            None => write!(f, "{}", self.0),
        }
    }
}

/// Who says what the unit is.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Stated {
    /// The user, in an option or a mapping file.
    ByUser(Unit),
    /// A built-in table, for files that usually have these names.
    ByTable(Unit),
    /// Nobody.
    Nowhere,
}

/// The unit to use and what the user should know about it, from the height of the body in units of the file.
pub(super) fn choose(stated: Stated, height: f64) -> Result<(Unit, Option<String>), Problem> {
    let likely = Unit::likely(height);
    let refuse = |unit: Unit, certain: bool| {
        let advice = match likely {
            Some(likely) if certain => format!("the likely unit is {likely}: give --unit {likely}"),
            Some(likely) => format!("the likely unit is {likely}: give --unit {likely}, or --unit {unit} if it really is that size"),
            None => "give the metres of a unit with --unit, e.g. --unit 0.01, and check that the mapping names the right joints".into(),
        };
        Err(Problem::Height { unit, metres: height * unit.metres(), advice })
    };
    match stated {
        Stated::ByUser(unit) if !POSSIBLE.contains(&(height * unit.metres())) => refuse(unit, true),
        Stated::ByUser(unit) => {
            let unusual = !USUAL.contains(&(height * unit.metres()));
            let note = likely.filter(|_| unusual).map(|likely| {
                format!("in {unit} the body is {:.1} m tall; the likely unit is {likely}", height * unit.metres())
            });
            Ok((unit, note))
        }
        Stated::ByTable(unit) if !USUAL.contains(&(height * unit.metres())) => refuse(unit, false),
        Stated::ByTable(unit) => Ok((unit, None)),
        Stated::Nowhere => match likely {
            Some(unit) => {
                let tall = height * unit.metres();
                Ok((
                    unit,
                    Some(format!(
                        "taken to be in {unit}, in which the body is {tall:.1} m tall (--unit says otherwise)"
                    )),
                ))
            }
            None => refuse(Unit::CENTIMETRE, false),
        },
    }
}

/// About the height of a body, from the lengths of its bones whatever its posture: legs and trunk, and a share for feet and skull.
pub(super) fn height(joints: &[Vector; JOINTS]) -> f64 {
    const LEGS: [usize; 4] = [4, 5, 7, 8];
    const TRUNK: [usize; 5] = [3, 6, 9, 12, 15];
    const REST: f64 = 1.15;
    let bone = |&j: &usize| q::length(q::subtract(joints[j], joints[skeleton::PARENTS[j]]));
    REST * (LEGS.iter().map(bone).sum::<f64>() / 2.0 + TRUNK.iter().map(bone).sum::<f64>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_have_names_and_numbers() {
        let metres = |text: &str| text.parse::<Unit>().map(Unit::metres);
        assert_eq!(
            [metres("m"), metres("CM"), metres("inch"), metres("in")],
            [Ok(1.0), Ok(0.01), Ok(0.0254), Ok(0.0254)]
        );
        assert_eq!(metres("0.0564"), Ok(0.0564));
        for wrong in ["", "0", "-1", "nan", "inf", "feet", "1,5"] {
            assert!(metres(wrong).unwrap_err().contains("inch"), "{wrong}");
        }
        let shown =
            ["cm", "inch", "0.3048", "0.05644444"].map(|text| text.parse::<Unit>().map(|unit| unit.to_string()));
        assert_eq!(shown, ["cm", "inch", "0.3048", "cmu"].map(|text| Ok(text.to_owned())));
        let read = |json: &str| serde_json::from_str::<Unit>(json).map(Unit::metres).ok();
        assert_eq!(
            [read("0.01"), read("\"cm\""), read("1"), read("0"), read("null")],
            [Some(0.01), Some(0.01), Some(1.0), None, None]
        );
    }

    #[test]
    fn people_of_all_sizes_are_recognised_in_every_unit() {
        for person in [1.4, 1.7, 2.0] {
            for (name, metres) in NAMED {
                let unit = Unit::likely(person / metres).map(|unit| unit.to_string());
                assert_eq!(unit.as_deref(), Some(name), "{person} m");
            }
        }
        assert_eq!([Unit::likely(0.0), Unit::likely(1e6), Unit::likely(f64::NAN)], [None; 3]);
    }

    #[test]
    fn a_unit_that_makes_giants_is_refused_with_the_likely_one() {
        let unit = |metres| Unit::new(metres).unwrap();
        let refused = |stated, height| choose(stated, height).unwrap_err().to_string();
        assert!(refused(Stated::ByTable(unit(0.01)), 1.7).contains("--unit m"));
        assert!(refused(Stated::ByTable(unit(0.01)), 67.0).contains("--unit inch, or --unit cm"));
        assert!(refused(Stated::ByUser(unit(1.0)), 170.0).contains("--unit cm"));
        assert!(refused(Stated::Nowhere, 9e9).contains("--unit 0.01"));
        assert_eq!(choose(Stated::ByTable(unit(0.01)), 170.0).unwrap(), (unit(0.01), None));
        // A small robot, by the user's word.
        let (small, note) = choose(Stated::ByUser(unit(0.01)), 45.0).unwrap();
        assert!(small == unit(0.01) && note.unwrap().contains("0.5 m tall"));
        let (guessed, note) = choose(Stated::Nowhere, 66.0).unwrap();
        assert!(guessed == unit(0.0254) && note.unwrap().contains("inch"));
    }
}
