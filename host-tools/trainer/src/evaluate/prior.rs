//! The table of the prior: real motion, the same through the tokenizer, generated motion, and a control with shuffled text.
//!
//! | row | motion | `fid` against real test motion |
//! |---|---|---|
//! | `real` | the prompt's own clip | of other real motion: training clips of the same labels, drawn anew for every seed |
//! | `tokenizer` | the prompt's own clip, encoded and decoded in f32 | of these: every motion has its original on the other side |
//! | `reference`, `runtime` | generated for the caption | of these |
//! | `shuffled_text` | the last generated row, held against the captions of other clips | of these |

use motionette_host::dataset::{Dataset, Split};
use motionette_host::parallel;

use super::Error;
use super::codec::Codec;
use super::figures::{Row, Yardstick};
use super::prompt::{MAX_TOKENS, Motion, Prompt, by_subset, composition, prompts};
use super::real::{self, SHORT_TOKENS};
use super::sample::{Judged, Sample, judged};
use crate::evaluator::judge::Judge;
use crate::random::Random;

/// Name of the control's row.
const CONTROL: &str = "shuffled_text";
/// Stream of the random order of the control.
const SHUFFLE: u64 = 1 << 43;

/// Makes a motion for a prompt and a seed.
pub type Generate<'a> = dyn Fn(&Prompt, u64) -> anyhow::Result<Motion> + Sync + 'a;

/// Everything a table is made with.
pub struct Bench<'a> {
    /// Who judges.
    pub judge: &'a Judge,
    /// Tokens of real motion, and back.
    pub codec: &'a Codec,
    /// Where prompts and real motion come from.
    pub dataset: &'a Dataset,
    /// Token sequences of the training split, where copies are looked for.
    pub training: &'a [Vec<u16>],
    /// Rows of generated motion, in order.
    pub generators: &'a [(&'a str, Box<Generate<'a>>)],
    /// Motions a prompt.
    pub seeds: u64,
}

/// Motions of 9.8 s take most of the time, and hardly a clip is that long: one prompt of so many is enough.
const LONG_STRIDE: usize = 4;

/// Rows over the prompts of one subset, without figures of sets.
#[derive(Clone, Debug, PartialEq)]
pub struct Subset {
    /// Name of the subset.
    pub name: String,
    /// Number of prompts.
    pub prompts: usize,
    /// All rows but the control's.
    pub rows: Vec<Row>,
}

/// The same rows for several lengths.
#[derive(Clone, Debug, PartialEq)]
pub struct Tables {
    /// What the clips are, in words.
    pub clips: String,
    /// Number of prompts of `all`, `short` and `long`.
    pub prompts: [usize; 3],
    /// Every prompt at its own clip's length.
    pub all: Vec<Row>,
    /// Those of at most 5 s.
    pub short: Vec<Row>,
    /// One prompt of four at 9.8 s.
    pub long: Vec<Row>,
    /// The clips' own lengths, subset by subset.
    pub subsets: Vec<Subset>,
}

impl Bench<'_> {
    /// Measures everything. At most `limit` prompts are used, spread evenly; `say` is told how far it is.
    ///
    /// # Errors
    /// [`Error`], naming what failed.
    pub fn tables(&self, limit: usize, say: &dyn Fn(&str)) -> Result<Tables, Error> {
        let mut own = prompts(self.dataset, Split::Test);
        if limit < own.len() {
            own = (0..limit).map(|i| own[i * own.len() / limit].clone()).collect();
        }
        let whole: Vec<usize> = (0..own.len()).collect();
        let short: Vec<usize> = whole.iter().copied().filter(|i| own[*i].tokens <= SHORT_TOKENS).collect();
        let every = own.iter().step_by(LONG_STRIDE);
        let long: Vec<Prompt> = every.map(|prompt| Prompt { tokens: MAX_TOKENS, ..prompt.clone() }).collect();
        let counts = [own.len(), short.len(), long.len()];
        let clips = composition(self.dataset, &own, Split::Test);
        let by_subset = by_subset(self.dataset, &own);
        let (yardstick, samples) = self.samples(own, say)?;
        say("figures and their intervals");
        let rows = |members: &[usize]| samples.iter().map(|sample| yardstick.measure(sample, members)).collect();
        let (all, short) = (rows(&whole), rows(&short));
        let subset = |(name, members): (&str, Vec<usize>)| {
            let shown = samples.iter().filter(|sample| sample.name != CONTROL);
            let rows = shown.map(|sample| yardstick.measure_singles(sample, &members)).collect();
            Subset { name: name.to_owned(), prompts: members.len(), rows }
        };
        let subsets = by_subset.into_iter().map(subset).collect();
        let whole: Vec<usize> = (0..long.len()).collect();
        let (yardstick, samples) = self.samples(long, say)?;
        say("figures and their intervals");
        let long = samples.iter().map(|sample| yardstick.measure(sample, &whole)).collect();
        Ok(Tables { clips, prompts: counts, all, short, long, subsets })
    }

    /// The motions of all rows, and what they are measured against.
    fn samples(&self, prompts: Vec<Prompt>, say: &dyn Fn(&str)) -> Result<(Yardstick, Vec<Sample>), Error> {
        let judged = |motions: &[Motion]| judged(self.judge, &prompts, motions, self.training);
        let real = real::motions(self.dataset, &prompts, self.codec)?;
        let decoded: Vec<Motion> = real
            .iter()
            .map(|motion| Motion { joints: self.codec.decode(&motion.tokens), tokens: motion.tokens.clone() })
            .collect();
        let resampled = (0..self.seeds)
            .map(|seed| {
                let motions = real::resampled(self.dataset, &prompts, seed, self.codec)?;
                Ok(judged(&motions)?.into_iter().map(|motion| motion.embedding).collect())
            })
            .collect::<Result<Vec<Vec<Vec<f64>>>, Error>>()?;
        let mut samples = vec![
            Sample { independent: Some(resampled), ..Sample::new("real", vec![judged(&real)?]) },
            Sample::new("tokenizer", vec![judged(&decoded)?]),
        ];
        for (name, generate) in self.generators {
            let seeds = (0..self.seeds)
                .map(|seed| {
                    say(&format!("{name}: seed {} of {}, {} prompts", seed + 1, self.seeds, prompts.len()));
                    let motions = parallel::map(&prompts, |prompt| {
                        generate(prompt, seed).map_err(|source| Error::Generate {
                            row: (*name).to_owned(),
                            caption: prompt.caption.clone(),
                            seed,
                            source,
                        })
                    });
                    judged(&motions.into_iter().collect::<Result<Vec<_>, _>>()?)
                })
                .collect::<Result<Vec<Vec<Judged>>, Error>>()?;
            samples.push(Sample::new(name, seeds));
        }
        let last = &samples[samples.len() - 1];
        samples.push(last.shuffled(CONTROL, shuffled(prompts.len())));
        let captions: Vec<&str> = prompts.iter().map(|prompt| prompt.caption.as_str()).collect();
        let yardstick = Yardstick {
            texts: self.judge.texts(&captions),
            real: samples[0].motions[0].iter().map(|motion| motion.embedding.clone()).collect(),
            rounds: self.seeds as usize,
            prompts,
        };
        Ok((yardstick, samples))
    }
}

/// A random order of `0..n`.
fn shuffled(n: usize) -> Vec<usize> {
    let mut order: Vec<usize> = (0..n).collect();
    let mut random = Random::new(1, SHUFFLE);
    for i in (1..n).rev() {
        order.swap(i, random.below(i + 1));
    }
    order
}
