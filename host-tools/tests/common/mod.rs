//! Where the shared test data lies, random numbers, small checkpoints, formulas, a folder to run in.

#[allow(dead_code, reason = "each test binary compiles this module and not all run the program")]
pub mod bench;
#[allow(dead_code, reason = "each test binary compiles this module and not all need checkpoints")]
pub mod checkpoints;
#[allow(dead_code, reason = "each test binary compiles this module and not all need files of other programs")]
pub mod foreign;
#[allow(dead_code, reason = "each test binary compiles this module and not all compare with published models")]
pub mod golden;
#[allow(dead_code, reason = "each test binary compiles this module and not all need motions")]
pub mod motions;
#[allow(dead_code, reason = "each test binary compiles this module and not all need formulas")]
pub mod naive;

use std::path::PathBuf;

/// `../shared/<relative>` beside the workspace, or below `MOTIONETTE_SHARED`; says so on standard error when it is absent.
#[allow(dead_code, reason = "each test binary compiles this module and not all read shared data")]
pub fn shared(relative: &str) -> Option<PathBuf> {
    let root = std::env::var_os("MOTIONETTE_SHARED")
        .map_or_else(|| PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../shared"), PathBuf::from);
    let path = root.join(relative);
    if path.exists() {
        return Some(path);
    }
    eprintln!("skipped: ../shared/{relative} not found");
    None
}

/// A message in which no cause repeats what was said before it: `error` and `causes` of the report, the lines of standard error.
#[allow(dead_code, reason = "each test binary compiles this module and not all see failures")]
pub fn says_each_cause_once(report: &serde_json::Value, stderr: &str) {
    let text = |value: &serde_json::Value| value.as_str().expect("a text").to_owned();
    let mut said = vec![text(&report["error"])];
    for cause in report["causes"].as_array().expect("a list").iter().map(text) {
        assert!(!said.iter().any(|before| before.contains(&cause)), "{cause:?} is said twice: {report}");
        assert!(stderr.contains(&format!("because: {cause}")), "{stderr}");
        said.push(cause);
    }
    assert_eq!(stderr.matches("because: ").count(), said.len() - 1, "{stderr}");
}

/// SplitMix64: small, seeded, the same everywhere.
#[allow(dead_code, reason = "each test binary compiles this module and not all draw numbers")]
pub struct Random(pub u64);

#[allow(dead_code, reason = "each test binary compiles this module and not all draw numbers")]
impl Random {
    /// 64 uniform bits.
    pub fn bits(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    /// Uniform in -1..1.
    pub fn uniform(&mut self) -> f64 {
        (self.bits() >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }

    /// Uniform in -1..1, three times.
    pub fn vector(&mut self) -> [f64; 3] {
        [self.uniform(), self.uniform(), self.uniform()]
    }
}
