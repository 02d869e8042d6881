//! Robots that come with the tools.

/// A robot that comes with the tools.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Preset {
    /// Its name.
    pub name: &'static str,
    /// What it is, in a line.
    pub about: &'static str,
    /// Its `robot.toml`.
    pub text: &'static str,
}

/// All of them.
pub const PRESETS: [Preset; 2] = [
    Preset {
        name: "upper-body",
        about: "waist, head and two arms: 12 hobby servos on a PCA9685",
        text: include_str!("../../../models/robots/upper-body.toml"),
    },
    Preset {
        name: "desk",
        about: "a turning base, a head and two arms: 8 STS3215 servos on a serial bus",
        text: include_str!("../../../models/robots/desk.toml"),
    },
];

/// A preset by name.
#[must_use]
pub fn preset(name: &str) -> Option<&'static Preset> {
    PRESETS.iter().find(|preset| preset.name == name)
}

/// Their names, with commas.
#[must_use]
pub fn preset_names() -> String {
    PRESETS.map(|preset| preset.name).join(", ")
}
