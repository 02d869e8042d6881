//! Which actions a tokenizer keeps: how often rules over joints see an action in its clips, and in the same clips through encoder, codes and
//! decoder. Joint errors do not tell: a kick that is smoothed away is a few centimetres of one leg for a few frames.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use burn::tensor::Device;
use motionette_host::dataset::{Dataset, Split};
use motionette_host::detect::{actions::does, detect};
use motionette_host::motion::{FPS, Pose};
use serde::Serialize;

use super::checkpoint::Checkpoint;
use super::config::FRAMES_PER_TOKEN;
use super::metrics::decoded;
use super::model::Network;

/// An action that a rule answers for.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Kept {
    /// Its name.
    pub action: String,
    /// Its clips.
    pub clips: usize,
    /// Share of them in which the rule sees it.
    pub real: f64,
    /// Share of them in which it sees it once they are decoded.
    pub decoded: f64,
}

/// The actions of the clips of `splits` that a rule answers for, by name.
pub fn kept(checkpoint: &Checkpoint, dataset: &Dataset, splits: &[Split]) -> Vec<Kept> {
    let device = Device::flex();
    let network = Network::new(&checkpoint.config.architecture, &checkpoint.parameters, false, &device);
    let mut hits: BTreeMap<&str, [usize; 3]> = BTreeMap::new();
    for clip in splits.iter().flat_map(|split| dataset.split(*split)).filter(|clip| clip.frames() >= FRAMES_PER_TOKEN) {
        let Some(action) = clip.info.action() else { continue };
        let seen = |motion: &[Pose]| does(&detect(motion, FPS), action);
        // The frames that are decoded count, not what lies behind them.
        let joints = decoded(checkpoint, &network, &clip, &device).joints;
        let Some(real) = seen(&clip.joints[..joints.len()]) else { continue };
        let through = seen(&joints) == Some(true);
        let [clips, all, left] = hits.entry(action).or_default();
        *clips += 1;
        *all += usize::from(real);
        *left += usize::from(through);
    }
    let share = |hits: usize, clips: usize| hits as f64 / clips as f64;
    let row = |(action, [clips, real, left]): (&str, [usize; 3])| Kept {
        action: action.to_owned(),
        clips,
        real: share(real, clips),
        decoded: share(left, clips),
    };
    hits.into_iter().map(row).collect()
}

/// As a table.
pub fn table(rows: &[Kept]) -> String {
    let mut out = String::from("action seen by rules over joints | clips | recorded | through the tokenizer\n");
    for Kept { action, clips, real, decoded } in rows {
        // Writing to a string cannot fail.
        let _ = writeln!(out, "{action:32} | {clips:5} | {real:8.2} | {decoded:.2}");
    }
    out
}

#[cfg(test)]
mod tests {
    use motionette_host::dataset::Facts;

    use super::*;
    use crate::testing;

    /// A tokenizer of a few steps loses every walk; an action without a rule has no row.
    #[test]
    fn what_is_lost_is_counted() {
        let walk = testing::with_facts(&testing::dataset(12, 60), |info| Facts {
            action: if info.id.ends_with('1') { "draw-circle".into() } else { "walk".into() },
            ..testing::facts()
        });
        let folder = tempfile::tempdir().unwrap();
        testing::prepare_tokenizer(folder.path());
        let checkpoint = Checkpoint::load(&folder.path().join("tokenizer.safetensors")).unwrap();
        let splits = [Split::Train, Split::Val, Split::Test];
        let rows = kept(&checkpoint, &walk, &splits);
        let all: Vec<_> = walk.iter().filter(|clip| clip.info.action() == Some("walk")).collect();
        let seen = all.iter().filter(|clip| does(&detect(clip.joints, FPS), "walk") == Some(true)).count();
        assert_eq!(rows.iter().map(|row| row.action.as_str()).collect::<Vec<_>>(), ["walk"]);
        assert_eq!((rows[0].clips, rows[0].real), (all.len(), seen as f64 / all.len() as f64));
        assert!(seen > 0 && rows[0].decoded < rows[0].real, "{rows:?}");
        assert!(table(&rows).lines().count() == 2);
    }
}
