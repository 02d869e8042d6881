//! `motionette-train evaluate --prompts FILE.jsonl`.

use std::collections::BTreeSet;
use std::path::Path;

use anyhow::Context as _;
use motionette::Length;
use motionette::generation::tokens::Planning;
use motionette::{Request, request::prompt::PromptError};
use motionette_host::blob::BlobFile;
use motionette_host::console::{remark, say};
use motionette_host::dataset::{Dataset, Split};
use motionette_host::detect::{self, score};
use motionette_host::import::actions::Actions;
use motionette_host::import::phrases::Phrases;
use motionette_host::motion::{FPS, Pose};
use motionette_host::{parallel, verify};

use super::file::{self, Line};
use super::order;
use super::report::{Report, Unseen, described};
use super::trust;
use super::unseen::TrainingWords;
use super::verdict::{Bench, Outcome, Shown, Verdict};
use crate::evaluate::command::{Args, hashes};
use crate::evaluate::generators;
use crate::evaluate::prompt::Prompt;
use crate::evaluate::report::Facts;
use crate::evaluator::judge::Judge;
use crate::evaluator::motion;
use crate::harness::options::finish;

/// What the runtime made of a prompt and a seed.
enum Made {
    Motion { joints: Vec<Pose>, unknown_words: u16, sure: Option<bool> },
    Refused(PromptError),
}

/// Runs the command on the prompts in `file`.
///
/// # Errors
/// Anything that is wrong with arguments or files, with context; what the runtime refuses for another reason than the prompt.
pub fn run(args: &Args, file: &Path) -> anyhow::Result<()> {
    let table = Actions::read(&args.actions)?;
    let dataset = Dataset::load(&args.data)?;
    let styles: BTreeSet<String> = dataset.clips.iter().filter_map(|clip| clip.style()).map(str::to_owned).collect();
    let lines = file::read(file, &table, &styles)?;
    let judge = Judge::load(&args.evaluator)
        .context("the evaluator cannot be used; make one with motionette-train evaluator")?;
    let blob = BlobFile::open(&args.blob)?;
    let seeds = args.seeds.unwrap_or(3);
    let limit = args.limit.map_or(usize::MAX, |count| usize::try_from(count).unwrap_or(usize::MAX));
    let lines: Vec<Line> = match lines.len() {
        count if count > limit => (0..limit).map(|i| lines[i * count / limit].clone()).collect(),
        _ => lines,
    };
    remark("judges on real test clips");
    let accuracies = trust::accuracies(&judge, &dataset, &table)?;
    let scores = score::scores(&dataset, Split::Test, &table);
    let unseen = Unseen {
        captions: TrainingWords::captions(&dataset).unseen_share(&lines),
        phrases: TrainingWords::templates(&Phrases::read(&args.phrases)?, &table).unseen_share(&lines),
    };
    remark(&format!("{} prompts, {seeds} motions each", lines.len()));
    let outcomes = outcomes(&lines, seeds, &blob, &Eyes { judge: &judge, table: &table }, args.generation)?;
    let bench = Bench {
        table: &table,
        accuracies: &accuracies,
        styles: judge.labels().styles.iter().map(String::as_str).collect(),
        seeds: usize::try_from(seeds)?,
    };
    let verdicts: Vec<Verdict> = outcomes.iter().map(|outcome| bench.judge(outcome)).collect();
    let facts = Facts {
        seeds,
        files: hashes(&[&file.to_path_buf(), &args.actions, &args.phrases, &args.data, &args.evaluator, &args.blob])?,
        command: format!(
            "motionette-train evaluate --prompts {}{}{}",
            file.file_name().unwrap_or_default().to_string_lossy(),
            args.chosen(),
            args.generation.flags()
        ),
        generation: args.generation.facts(),
    };
    let report = Report {
        outcomes: &outcomes,
        verdicts: &verdicts,
        accuracies: &accuracies,
        scores: &scores,
        unseen,
        facts: &facts,
    };
    tell(&report);
    report.save(&args.out)?;
    remark(&args.out.join("prompts.md").display().to_string());
    finish(args.json, &report.json())
}

/// Says the figures and the prompts that failed.
fn tell(report: &Report<'_>) {
    let trusted: Vec<String> = report
        .accuracies
        .iter()
        .filter(|(_, accuracy)| accuracy.trusted())
        .map(|(action, accuracy)| format!("{action} {:.2}", accuracy.share()))
        .collect();
    say(&format!("the evaluator judges (accuracy on real test clips): {}", trusted.join(", ")));
    for (outcome, verdict) in report.outcomes.iter().zip(report.verdicts) {
        if outcome.refused.is_some() || verdict.failed() {
            say(&described(outcome, verdict));
        }
    }
    let share = |pick: fn(&Verdict) -> Option<super::verdict::Tally>| {
        report
            .share(pick)
            .map_or("-".into(), |s| format!("{:.3} ± {:.3} of {} prompts", s.mean, s.half_width, s.prompts))
    };
    say(&format!("action: evaluator {}, detectors {}", share(|v| v.evaluator), share(|v| v.detectors)));
    say(&format!("style: {}", share(|v| v.style)));
    say(&format!("order: {}, the other way round {}", share(|v| v.order), share(|v| v.reversed)));
    let share = |share: Option<f64>| share.map_or("-".into(), |share| format!("{share:.3}"));
    let [warned, caught] = [report.warned_share(), report.caught_share()].map(share);
    say(&format!("hardly understood: of prompts {warned}, of nonsense {caught}"));
    say(&format!(
        "prompts with unknown words {:.3}, refused {:.3}, without a word of their actions' captions {:.3}, phrases {:.3}",
        report.unknown_share(),
        report.refused_share(),
        report.unseen.captions,
        report.unseen.phrases
    ));
}

/// What motions are looked at with.
struct Eyes<'a> {
    judge: &'a Judge,
    table: &'a Actions,
}

impl Eyes<'_> {
    /// What a motion made for a prompt shows.
    fn look(&self, line: &Line, joints: &[Pose]) -> anyhow::Result<Shown> {
        let features =
            |source| crate::evaluator::Error::Features { name: format!("the motion for {:?}", line.text), source };
        let prepared = motion::prepare(joints).map_err(features)?;
        let judgement = self.judge.motions(&[&prepared]).remove(0);
        let order = || order::of(joints, &line.accepted(self.table), &line.accepted_then(self.table));
        Ok(Shown {
            action: judgement.content.to_owned(),
            style: judgement.style.to_owned(),
            seen: detect::detect(joints, FPS),
            order: (!line.then.is_empty()).then(order),
        })
    }
}

/// Makes and judges the motions of all prompts.
fn outcomes(
    lines: &[Line],
    seeds: u64,
    blob: &BlobFile,
    eyes: &Eyes<'_>,
    options: generators::Options,
) -> anyhow::Result<Vec<Outcome>> {
    let asked: Vec<(&Line, u64)> = lines.iter().flat_map(|line| (0..seeds).map(move |seed| (line, seed))).collect();
    let made = parallel::map(&asked, |(line, seed)| make(blob, line, *seed, options));
    let made = made.into_iter().collect::<anyhow::Result<Vec<Made>>>()?;
    let mut outcomes: Vec<Outcome> = Vec::with_capacity(lines.len());
    for (line, made) in lines.iter().zip(made.chunks(usize::try_from(seeds)?.max(1))) {
        let mut outcome =
            Outcome { line: line.clone(), refused: None, unknown_words: 0, sure: None, motions: Vec::new() };
        for made in made {
            match made {
                Made::Refused(reason) => {
                    outcome.refused = Some(reason.to_string());
                    if let PromptError::OnlyUnknownWords { words } = reason {
                        outcome.unknown_words = u16::try_from(*words).unwrap_or(u16::MAX);
                    }
                }
                Made::Motion { joints, unknown_words, sure } => {
                    outcome.unknown_words = *unknown_words;
                    outcome.sure = *sure;
                    outcome.motions.push(eyes.look(line, joints)?);
                }
            }
        }
        outcomes.push(outcome);
    }
    Ok(outcomes)
}

/// One motion, as long as the model suggests.
fn make(blob: &BlobFile, line: &Line, seed: u64, options: generators::Options) -> anyhow::Result<Made> {
    let prompt = Prompt {
        clip: line.number,
        caption: line.text.clone(),
        content: String::new(),
        style: None,
        label: 0,
        tokens: 0,
    };
    let planning = Planning { length: Length::Predicted, ..options.planning(&prompt, seed) };
    match verify::run(blob, &line.text, &Request::text(&line.text).planned(planning)) {
        Ok(motion) => Ok(Made::Motion {
            joints: motion.joints,
            unknown_words: motion.unknown_words,
            sure: motion.understood.map(|understood| understood.sure),
        }),
        Err(verify::Error::Runtime { source: motionette::Error::Prompt(reason), .. }) => Ok(Made::Refused(reason)),
        Err(error) => Err(error).with_context(|| format!("no motion for line {}, {:?}", line.number, line.text)),
    }
}
