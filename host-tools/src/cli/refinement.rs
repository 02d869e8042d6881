//! `--refinement`: how anchors are met, by name.

use std::fmt;
use std::str::FromStr;

use motionette::refining::{Activity, Basis, Config, Method};

/// Behind a name: of its edit, feet do not stay where they stand.
const FREE_FEET: &str = ":free-feet";

/// How anchors are met and feet planted; `None` leaves anchors to the planner and feet as they are.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Refinement(pub Option<Config>);

impl Refinement {
    /// What commands do that are told nothing.
    pub const DEFAULT: &'static str = "exact";
}

/// The name by which it is asked for; variants of the published one are `rsN` all of them.
impl fmt::Display for Refinement {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Some(config) = self.0 else { return f.write_str("off") };
        let steps = config.evaluations;
        match (config.method, config.exact) {
            (Method::Published, _) => write!(f, "rs{}", steps.saturating_sub(1)),
            (Method::QuasiNewton, None) => write!(f, "fast:{steps}"),
            (Method::QuasiNewton, Some(exact)) => {
                let free = if exact.planted { "" } else { FREE_FEET };
                if steps == 0 { write!(f, "exact{free}") } else { write!(f, "fast:{steps}+exact{free}") }
            }
        }
    }
}

impl FromStr for Refinement {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let known = "known are off, exact, exact:free-feet, fast:N, fast:N+exact, fast:N+exact:free-feet, rs100, rs200, rs500, rs200:plain, :transport, :slope, :quadratic, :cubic, \
            :uniform, :shuffled";
        let bad = || format!("no refinement is called {text:?}; {known}");
        if text == "off" {
            return Ok(Refinement(None));
        }
        let (edited, planted) = text.strip_suffix(FREE_FEET).map_or((text, true), |text| (text, false));
        let with_feet = |config: Config| if planted { config } else { config.free_feet() };
        if edited == "exact" {
            return Ok(Refinement(Some(with_feet(Config::exact()))));
        }
        if let Some(budget) = edited.strip_prefix("fast:") {
            let (budget, both) = budget.strip_suffix("+exact").map_or((budget, false), |budget| (budget, true));
            let budget =
                budget.parse().ok().filter(|n| (1..=10_000).contains(n) && (both || planted)).ok_or_else(bad)?;
            let config = Config::fast(budget);
            return Ok(Refinement(Some(if both { with_feet(config.exactly()) } else { config })));
        }
        let (steps, ablation) = text
            .strip_prefix("rs")
            .ok_or_else(bad)?
            .split_once(':')
            .map_or_else(|| (text.trim_start_matches("rs"), None), |(steps, ablation)| (steps, Some(ablation)));
        let steps = steps.parse().ok().filter(|n| (1..=10_000).contains(n)).ok_or_else(bad)?;
        let mut config = Config::published(steps);
        match ablation {
            None => {}
            Some("plain") => config.basis = Basis::Plain,
            Some("transport") => config.basis = Basis::Transport,
            Some("slope") => config.basis = Basis::Slope,
            Some("quadratic") => config.basis = Basis::Quadratic,
            Some("cubic") => config.basis = Basis::Cubic,
            Some("uniform") => config.activity = Activity::Uniform,
            Some("shuffled") => config.activity = Activity::Shuffled,
            Some(_) => return Err(bad()),
        }
        Ok(Refinement(Some(config)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refinement(text: &str) -> Result<Refinement, String> {
        text.parse()
    }

    #[test]
    fn refinements_are_read_or_refused_with_the_list() {
        assert!(refinement("off").unwrap().0.is_none());
        assert_eq!(refinement("fast:40").unwrap().0.unwrap(), Config::fast(40));
        assert_eq!(refinement("exact").unwrap().0.unwrap(), Config::exact());
        assert_eq!(refinement("fast:3+exact").unwrap().0.unwrap(), Config::fast(3).exactly());
        assert_eq!(refinement("rs200").unwrap().0.unwrap(), Config::published(200));
        assert_eq!(refinement("rs100:slope").unwrap().0.unwrap().basis, Basis::Slope);
        assert_eq!(refinement("rs200:shuffled").unwrap().0.unwrap().activity, Activity::Shuffled);
        for text in [
            "",
            "fast",
            "fast:0",
            "fast:-1",
            "fast:99999",
            "fast:+exact",
            "exact:3",
            "exact:free-feet:free-feet",
            "fast:3:free-feet",
            "rs200:free-feet",
            "rs",
            "rs0",
            "rsx",
            "rs200:",
            "rs200:x",
            "slow",
        ] {
            assert!(refinement(text).unwrap_err().contains("known are"), "{text}");
        }
    }

    #[test]
    fn names_are_what_was_asked_for() {
        for name in ["off", "exact", "exact:free-feet", "fast:20", "fast:3+exact", "fast:3+exact:free-feet", "rs200"] {
            assert_eq!(refinement(name).unwrap().to_string(), name);
        }
        assert_eq!(refinement("rs100:slope").unwrap().to_string(), "rs100");
    }

    #[test]
    fn the_default_is_the_runtime_s() {
        assert_eq!(refinement(Refinement::DEFAULT), Ok(Refinement(Some(Config::DEFAULT))));
    }
}
