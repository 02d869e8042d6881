//! What an image reported, read from its decoded log, and the comparison with the desktop.

use std::collections::HashMap;

use anyhow::{Context, Result, bail};
use motionette_sim::twin::{self, Digest};

/// Everything a machine reported about a run.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Report {
    /// One digest a request, in order.
    pub digests: Vec<Digest>,
    /// Painted stack that was used, bytes.
    pub stack_bytes: usize,
    /// Painted arena that was used, bytes.
    pub arena_high_water_bytes: usize,
    /// `size_of::<Generator>()` on the machine, bytes.
    pub generator_bytes: usize,
}

impl Report {
    /// Reads the `twin key=value ...` lines among `lines`.
    ///
    /// # Errors
    /// When a request or the closing line is missing, or a value is no number.
    pub fn read(lines: &[String]) -> Result<Self> {
        let mut digests = Vec::new();
        let mut end = None;
        for line in lines {
            let Some(pairs) = line.strip_prefix("twin ") else { continue };
            let values = pairs.split(' ').map(pair).collect::<Result<HashMap<&str, u64>>>();
            let values = Values(values.with_context(|| format!("in the line `{line}`"))?);
            if values.0.contains_key("end") {
                end = Some(values);
                continue;
            }
            if values.get("request")? != digests.len() as u64 {
                bail!("request {} was expected: `{line}`", digests.len());
            }
            digests.push(values.digest()?);
        }
        let end = end.context("the image did not finish")?;
        if digests.len() != twin::ALL {
            bail!("{} of {} requests were reported", digests.len(), twin::ALL);
        }
        Ok(Self {
            digests,
            stack_bytes: end.size("stack")?,
            arena_high_water_bytes: end.size("arena_high_water")?,
            generator_bytes: end.size("generator")?,
        })
    }
}

/// The pairs of one line.
struct Values<'l>(HashMap<&'l str, u64>);

fn pair(text: &str) -> Result<(&str, u64)> {
    let (key, value) = text.split_once('=').with_context(|| format!("`{text}` is no key=value"))?;
    Ok((key, value.parse().with_context(|| format!("`{value}` is no number"))?))
}

impl Values<'_> {
    fn get(&self, key: &str) -> Result<u64> {
        self.0.get(key).copied().with_context(|| format!("`{key}` is missing"))
    }

    fn size(&self, key: &str) -> Result<usize> {
        Ok(usize::try_from(self.get(key)?)?)
    }

    fn digest(&self) -> Result<Digest> {
        Ok(Digest {
            numbers: self.size("numbers")?,
            anchors: self.size("anchors")?,
            evaluations: u16::try_from(self.get("evaluations")?)?,
            gradients: u16::try_from(self.get("gradients")?)?,
            before: u32::try_from(self.get("before")?)?,
            after: u32::try_from(self.get("after")?)?,
            arena_used: self.size("arena_used")?,
            tokens: self.get("tokens")?,
            u: self.get("u")?,
            joints: self.get("joints")?,
        })
    }
}

/// What of request `index` differs between the desktop and a machine; nothing when every bit is equal.
pub fn difference(desktop: &Digest, machine: &Digest) -> Option<&'static str> {
    let hashes = [
        ("tokens", desktop.tokens == machine.tokens),
        ("embeddings", desktop.u == machine.u),
        ("joints", desktop.joints == machine.joints),
        ("figures of the report", desktop == machine),
    ];
    hashes.iter().find(|(_, equal)| !equal).map(|(what, _)| *what)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn line(index: usize) -> String {
        format!(
            "twin request={index} numbers=3 anchors=2 evaluations=4 gradients=3 before=1065353216 after=0 arena_used=640 tokens=1 u=18446744073709551615 joints={index}"
        )
    }

    fn lines() -> Vec<String> {
        let mut lines: Vec<String> = (0..twin::ALL).map(line).collect();
        lines.insert(3, "debug: unrelated=1".to_owned());
        lines.push("twin end=1 stack=9000 arena_high_water=640 generator=512".to_owned());
        lines
    }

    #[test]
    fn reads_what_the_image_prints() {
        let report = Report::read(&lines()).unwrap();
        assert_eq!(report.digests.len(), twin::ALL);
        assert_eq!(report.digests[7].joints, 7);
        assert_eq!(report.digests[7].u, u64::MAX);
        assert_eq!((report.stack_bytes, report.arena_high_water_bytes, report.generator_bytes), (9000, 640, 512));
    }

    #[test]
    fn incomplete_runs_are_refused() {
        let message = |lines: &[String]| Report::read(lines).unwrap_err().to_string();
        let all = lines();
        assert_eq!(message(&all[..all.len() - 1]), "the image did not finish");
        assert!(message(&[&all[..2], &all[5..]].concat()).starts_with("request 2 was expected"));
        assert!(message(&[all[0].clone(), all[all.len() - 1].clone()]).starts_with("1 of "));
        assert!(message(&["twin request=0 numbers=x".to_owned()]).contains("request=0"));
    }

    #[test]
    fn a_single_differing_hash_is_named() {
        let digest = Report::read(&lines()).unwrap().digests[0];
        assert_eq!(difference(&digest, &digest), None);
        assert_eq!(difference(&digest, &Digest { u: 5, ..digest }), Some("embeddings"));
        assert_eq!(difference(&digest, &Digest { joints: 5, ..digest }), Some("joints"));
        assert_eq!(difference(&digest, &Digest { evaluations: 9, ..digest }), Some("figures of the report"));
    }
}
