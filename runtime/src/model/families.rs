//! What a blob needs of this build: families are cargo features, and one that was left out is refused by its name.

use crate::blob::{Codec, Corruption, Error, Generator, Manifest, PlannerConfig};

/// A family that a blob may need, a cargo feature of this crate.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct CargoFeature {
    /// Its name.
    pub name: &'static str,
    /// Whether the blob needs it.
    pub needed: bool,
    /// Whether this build has it.
    pub linked: bool,
}

/// All of them, as a blob of this manifest needs them.
#[must_use]
pub fn cargo_features(manifest: &Manifest<'_>) -> [CargoFeature; 7] {
    let Codec::Vq(_) = &manifest.codec;
    let (planner, prefix) = (manifest.generator.planner(), manifest.generator.prefix());
    let control = planner.is_some_and(|planner| planner.control.is_some());
    let residual = prefix.is_some_and(|planner| planner.residual.is_some());
    let encoder = manifest.text.as_ref().is_some_and(|text| text.encoder.words().is_some());
    let (tmd, masked, turns) = match &manifest.generator {
        Generator::Words(PlannerConfig { corruption: Corruption::Near { .. }, .. }) => (true, false, false),
        Generator::Words(_) | Generator::Masked(_) => (false, true, false),
        Generator::Autoregressive(_) => (false, false, true),
        Generator::Given { .. } => (false, false, false),
    };
    [
        CargoFeature { name: "vq", needed: true, linked: cfg!(feature = "vq") },
        CargoFeature { name: "tmd", needed: tmd, linked: cfg!(feature = "tmd") },
        CargoFeature { name: "masked", needed: masked, linked: cfg!(feature = "masked") },
        CargoFeature { name: "autoregressive", needed: turns, linked: cfg!(feature = "autoregressive") },
        CargoFeature { name: "residual", needed: residual, linked: cfg!(feature = "residual") },
        CargoFeature { name: "anchor-control", needed: control, linked: cfg!(feature = "anchor-control") },
        CargoFeature { name: "text", needed: encoder, linked: cfg!(feature = "text") },
    ]
}

/// Refuses a blob that needs a family which is not linked.
pub(super) fn check(manifest: &Manifest<'_>) -> Result<(), Error> {
    // Those of other planners were refused where they were read.
    let [vq, tmd, .., control, text] = cargo_features(manifest);
    match [vq, tmd, control, text].into_iter().find(|feature| feature.needed && !feature.linked) {
        None => Ok(()),
        Some(CargoFeature { name, .. }) => Err(Error::NotLinked { feature: name }),
    }
}
