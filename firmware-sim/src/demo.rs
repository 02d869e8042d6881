//! The main job: a prompt and anchors, or a real motion, through the embedded runtime, bent onto the anchors, played by a virtual
//! robot, checked against the reference, written to a folder.

use crate::default_model;
use crate::intervals;
use crate::planners::{self, Checkpoints, Compared};
use crate::report::{Parts, Report};
use crate::robot::{Kind, Played, Stage};
use crate::sample_clips;
use crate::session::{self, Conditions, Outcome};
use crate::source::{self, Content, Source};
use crate::viewer::{self, CurvePoint, Fact, Scene, Shown, ShownPlan, ShownSpan, ShownStage, Surroundings};
use anyhow::{Context, bail};
use clap::Args;
use motionette::generation::tokens::{Length, Planning};
use motionette::playback::Robot;
use motionette::refining::{Config, Exact};
use motionette::representation::skeleton::{NAMES, PARENTS};
use motionette::request::conditions::AnchorSet;
use motionette::{Anchor, Error, Model, Obstacle, Request, Span, Track};
use motionette_host::agreement::Agreement;
use motionette_host::blob::{AlignedBlob, BlobFile};
use motionette_host::checkpoint::TokenizerCheckpoint;
use motionette_host::cli::Refinement;
use motionette_host::console::say;
use motionette_host::followed::{self, Following};
use motionette_host::motion::{Pose, narrowed, widened};
use motionette_host::reference::bridge::reference_anchor;
use motionette_host::reference::{self, DecodePath, motion_space};
use motionette_host::scene_file::{self, OwnedObstacle, OwnedSpan, OwnedTrack};
use motionette_host::{anchors_file, export, output, robot_file, spans};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// Text or a real motion through the runtime, bent onto anchors, checked against the reference, written to a folder.
///
/// Example: motionette-sim --text "a tired person waves the right hand" --seconds 5 --anchors anchors.json
#[derive(Debug, Args)]
#[command(
    mut_arg("mapping", |arg| arg.requires("bvh").conflicts_with_all(["text", "clip"])),
    mut_arg("unit", |arg| arg.requires("bvh").conflicts_with_all(["text", "clip"]))
)]
pub struct Cmd {
    /// What the body is to do, in words. If nothing is said: a prompt and anchors that come with the simulator.
    #[arg(long, value_name = "PROMPT", conflicts_with_all = ["clip", "bvh"])]
    text: Option<String>,
    /// Length of the motion; as the prompt suggests if nothing is said.
    #[arg(long, value_name = "S", value_parser = seconds, conflicts_with_all = ["clip", "bvh"])]
    seconds: Option<f64>,
    /// Steps of the planner.
    #[arg(long, default_value_t = Planning::DEFAULT.steps)]
    steps: u16,
    /// How strongly the prompt guides; 1 is off and halves the planner's work.
    #[arg(long, default_value_t = Planning::DEFAULT.guidance)]
    guidance: f32,
    /// A bundled recorded motion by name (see --list) instead of a prompt.
    #[arg(long, value_name = "NAME", conflicts_with = "bvh")]
    clip: Option<String>,
    /// Your own recording instead of a prompt; it is encoded first.
    #[arg(long, value_name = "FILE")]
    bvh: Option<PathBuf>,
    #[command(flatten)]
    recording: motionette_host::cli::RecordingOptions,
    /// Anchors (docs/anchors.md); none, or those of a bundled motion, if nothing is said.
    #[arg(long, value_name = "FILE.json")]
    anchors: Option<PathBuf>,
    /// Where joints are to be at many frames (docs/tracks.md).
    #[arg(long, value_name = "FILE.json")]
    tracks: Option<PathBuf>,
    /// What the body keeps clear of (docs/obstacles.md).
    #[arg(long, value_name = "FILE.json")]
    scene: Option<PathBuf>,
    /// What parts of the body do instead, each over a span of the motion (docs/timeline.md).
    #[arg(long, value_name = "FILE.json")]
    timeline: Option<PathBuf>,
    /// Plan as if there were no anchors and tracks, and only bend the motion onto them.
    #[arg(long, conflicts_with_all = ["clip", "bvh"])]
    unconditioned: bool,
    /// off, exact (edited behind the decoder, feet planted; exact:free-feet without), fast:N (N decoder evaluations), fast:N+exact (both),
    /// rs100, rs200, rs500 (RouteSolver as published), or rs200 with an ablation: rs200:plain, :transport, :slope, :quadratic, :cubic,
    /// :uniform, :shuffled.
    #[arg(long, default_value = Refinement::DEFAULT)]
    refinement: Refinement,
    /// Seed of the planner and of the shuffled-activity ablation.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Another model than the built-in one.
    #[arg(long, value_name = "FILE")]
    blob: Option<PathBuf>,
    /// The unquantised checkpoint of the model; that of the built-in model if nothing is said.
    #[arg(long, value_name = "FILE")]
    checkpoint: Option<PathBuf>,
    /// The unquantised checkpoint of text encoder and planner; that of the built-in model if nothing is said.
    #[arg(long, value_name = "FILE")]
    prior: Option<PathBuf>,
    /// The unquantised checkpoint of anchor control, if the model has it; that of the built-in model if nothing is said.
    #[arg(long, value_name = "FILE")]
    control: Option<PathBuf>,
    /// The robot whose servos play the motion: a preset (`motionette robot presets`) or a robot.toml.
    #[arg(long, default_value = "upper-body", value_name = "NAME|FILE")]
    robot: String,
    /// What goes wrong on the way: nack, stuck, late, bit, brownout (buses and power), corrupt (blob), overrun, arena (generator).
    #[arg(long, value_name = "FAULT,..", value_delimiter = ',')]
    faults: Vec<Kind>,
    /// Seed of what goes wrong: when, where, how often.
    #[arg(long, default_value_t = 1, value_name = "SEED")]
    fault_seed: u64,
    /// Folder for the results.
    #[arg(long, default_value = "out", value_name = "DIR")]
    out: PathBuf,
    /// List the bundled motions.
    #[arg(long)]
    list: bool,
    /// Print one machine-readable object on the last line of standard output.
    #[arg(long)]
    json: bool,
}

fn seconds(text: &str) -> Result<f64, String> {
    let found = text.parse().ok().filter(|s: &f64| *s > 0.0 && *s <= 3600.0);
    found.ok_or_else(|| format!("{text:?} is no length: write seconds above 0, e.g. 4.5"))
}

/// A motion with the model's bones, by the reference.
fn rigid(model: &Model<'_>, motion: &[Pose]) -> Vec<Pose> {
    let offsets = model.skeleton().offsets().map(|offset| offset.map(f64::from));
    narrowed(&reference::rigid::Body::new(&offsets).posed(&widened(motion)))
}

/// Whether there is anything to refine: anchors, tracks, obstacles, or feet that stay where they stand.
fn refines(config: Config, conditions: &Conditions<'_>) -> bool {
    !conditions.anchors.is_empty() || conditions.has_rows() || config.exact.is_some_and(|exact| exact.planted)
}

/// A motion edited by the reference.
fn edited(motion: &[Pose], anchors: &[Anchor], exact: Exact, frame_rate: u16) -> Vec<Pose> {
    let anchors: Vec<_> = anchors.iter().map(reference_anchor).collect();
    let settings = motion_space::Exact { added_speed: f64::from(exact.added_speed), planted: exact.planted };
    let (edited, _) = motion_space::edited(&widened(motion), &anchors, settings, f64::from(frame_rate));
    narrowed(&edited)
}

impl Cmd {
    /// Runs the job.
    ///
    /// # Errors
    /// Whatever input is refused or cannot be read, and what cannot be written.
    pub fn run(self) -> anyhow::Result<()> {
        if self.list {
            for clip in sample_clips::SampleClips::built_in()?.clips {
                say(&format!("{:44} {:3} tokens  {}", clip.id, clip.tokens.len(), clip.caption));
            }
            return Ok(());
        }
        let checkpoint = default_model::tokenizer(self.checkpoint.as_deref())?;
        let blob = match &self.blob {
            Some(path) => BlobFile::open(path)?,
            None => BlobFile::new(AlignedBlob::new(default_model::BLOB), Path::new("(built in)"))?,
        };
        motionette_host::verify::check_same_model(&blob, &checkpoint)?;
        let model = blob.model()?;
        let source = self.source(&checkpoint, &model)?;
        let robot = robot_file::load(&self.robot).context("reading the robot")?;
        let tracks: Vec<Track<'_>> = source.tracks.iter().map(OwnedTrack::borrowed).collect();
        let obstacles: Vec<Obstacle<'_>> = source.obstacles.iter().map(OwnedObstacle::borrowed).collect();
        let timeline: Vec<Span<'_>> = source.timeline.iter().map(OwnedSpan::borrowed).collect();
        let (tracks, obstacles, timeline) = (&tracks[..], &obstacles[..], &timeline[..]);
        let conditions = &Conditions { anchors: &source.anchors, tracks, obstacles, timeline };

        say(&format!("{}: {}", source.name, source.caption));
        for note in &source.notes {
            say(&format!("  {note}"));
        }
        let config = self.refinement.0.map(|config| Config { seed: self.seed as u32, ..config });
        let bar = motionette_host::cli::bar(u64::from(config.map_or(0, |c| c.evaluations)), "decoder evaluations");
        let motions = self.motions(&model, &source, conditions, config)?;
        bar.finish_and_clear();
        let after = &motions.after;
        let plan = match &source.content {
            Content::Tokens(_) => None,
            Content::Prompt(text) => {
                let anchors = if motions.conditioned { &source.anchors[..] } else { &[] };
                let checkpoints = Checkpoints { prior: self.prior.as_deref(), control: self.control.as_deref() };
                let of = (&blob, &checkpoint, checkpoints);
                Some(planners::compare((text, &self.planning(&model)), anchors, of, after)?)
            }
        };

        let started = Instant::now();
        let decoded = DecodePath::<f32>::new(&checkpoint)?.forward(&after.u).joints;
        let mut reference = rigid(&model, &decoded);
        // In front of the edit, where a stance that one of the two sees and the other does not would count as a difference.
        let plain = session::run(&model, &Request::embeddings(&after.u).unrefined(), |_| ())?;
        let mut agreement = Agreement::default();
        agreement.add(&source.name, &plain.joints, &reference);
        let refined = config.filter(|config| refines(*config, conditions));
        if let Some(exact) = refined.and_then(|config| config.exact).filter(|_| conditions.known_to_reference()) {
            reference = edited(&reference, &source.anchors, exact, model.frame_rate());
        }
        let reference_ms = started.elapsed().as_secs_f64() * 1e3;
        let Some(agreement) = agreement.clips.first() else { bail!("the motion has no frames") };

        let played = self.play(&robot, &model, (&source, conditions), config, after)?;
        let unseen = after.unconditioned_anchors > 0 || !tracks.is_empty() && !after.conditioned;
        let unseen = plan.is_some() && unseen;
        let unconditioned_because = match unseen {
            true if self.unconditioned => Some("--unconditioned".to_owned()),
            true => match followed::unseen_because(tracks).filter(|_| source.anchors.is_empty()) {
                Some(why) => Some(why.to_owned()),
                None => Some(blob.unconditioned_because(after.steps.len() > self.steps.into())?),
            },
            false => None,
        };
        let edited = after.refinement.and_then(|report| report.edited);
        let followed = edited.as_ref().and_then(|edited| edited.followed.as_ref());
        let following = Following::of(followed, (tracks, obstacles), after.joints.len(), after.frame_rate);
        let report = Report::from(&Parts {
            clip: &source.name,
            caption: &source.caption,
            tokens: after.tokens.len() / model.codebooks().quantizers().max(1),
            prompt: plan.as_ref().map(|_| source.caption.as_str()),
            unknown_words: plan.as_ref().map_or_else(Vec::new, Compared::unknown),
            planner_token_agreement: plan.as_ref().map(|plan| plan.agreement),
            anchors: &source.anchors,
            following,
            unconditioned_because,
            alone: motions.alone.as_ref(),
            conditioned: motions.conditioned,
            before: &motions.before,
            after,
            refinement: self.refinement,
            refined: config.is_some_and(|config| refines(config, conditions)),
            skeleton: model.skeleton(),
            agreement,
            reference_ms,
            robot: &played.report,
            blob_bytes: model.bytes().len(),
        });
        for (label, value) in report.lines().into_iter().chain(report.anchor_lines()) {
            say(&format!("  {label:28}{value}"));
        }
        self.write(
            &Results { source: &source, conditions, motions: &motions, plan: plan.as_ref(), played: &played },
            &reference,
            &report,
        )?;
        say(&format!("  results                     {}", self.out.join("viewer.html").display()));
        if self.json {
            say(&serde_json::to_string(&report)?);
        }
        Ok(())
    }

    /// The request's motion and those that show what each stage did to it.
    fn motions(
        &self,
        model: &Model<'_>,
        source: &Source,
        conditions: &Conditions<'_>,
        config: Option<Config>,
    ) -> anyhow::Result<Motions> {
        let request = self.request(model, source);
        let through = session::through(request, conditions, config);
        let after = session::run(model, &through, |_| ()).map_err(|error| refused(model, source, error))?;
        // Where something is refined the same tokens are decoded as they are, with the same spans.
        let tokens = Request::tokens(&after.tokens).planned(request.planning).timeline(conditions.timeline);
        let before = match config.is_some_and(|config| refines(config, conditions)) {
            false => after.clone(),
            true => session::run(model, &tokens.unrefined(), |_| ())?,
        };
        let distinct = AnchorSet::new(conditions.anchors, after.joints.len())?.len();
        let seen = usize::from(after.unconditioned_anchors) < distinct;
        let seen = seen || !conditions.tracks.is_empty() && after.conditioned;
        // Anchors may have made a motion of predicted length longer: it is to be compared frame by frame.
        let same_length = Length::Tokens((after.tokens.len() / model.codebooks().quantizers().max(1)) as u16);
        let alone = match seen || !conditions.timeline.is_empty() {
            true => {
                // What differs from the others is to be that they are led or told, not that their feet are planted.
                let refinement = if seen { request.refinement } else { config };
                Some(session::run(model, &Request { refinement, ..request.length(same_length) }, |_| ())?)
            }
            false => None,
        };
        Ok(Motions { alone, conditioned: seen, before, after })
    }

    /// The robot plays the motion.
    fn play(
        &self,
        robot: &Robot,
        model: &Model<'_>,
        (source, conditions): (&Source, &Conditions<'_>),
        config: Option<Config>,
        after: &Outcome,
    ) -> anyhow::Result<Played> {
        let mut faults = self.faults.clone();
        faults.sort_unstable();
        faults.dedup();
        let request = session::through(self.request(model, source), conditions, config);
        let stage = Stage {
            robot,
            model,
            request: &request,
            frames: &after.joints,
            anchors: &source.anchors,
            faults: &faults,
            seed: self.fault_seed,
        };
        stage.run()
    }

    /// The request without what it is to meet and without its timeline.
    fn request<'r>(&self, model: &Model<'_>, source: &'r Source) -> Request<'r> {
        match &source.content {
            // Spans are planned, whatever the motion comes from.
            Content::Tokens(tokens) => Request::tokens(tokens).planned(self.planning(model)),
            Content::Prompt(text) => Request::text(text).planned(self.planning(model)),
        }
    }

    /// What the request is made from, its anchors checked.
    fn source(&self, checkpoint: &TokenizerCheckpoint, model: &Model<'_>) -> anyhow::Result<Source> {
        let mut source = match (&self.text, &self.bvh, &self.clip) {
            (Some(text), _, _) => source::prompt(text),
            (None, Some(path), _) => {
                source::recording(path, &self.recording.reading()?, checkpoint, model.max_tokens())?
            }
            (None, None, Some(name)) => source::bundled(Some(name), model.frame_rate())?,
            // Its anchors might contradict tracks, obstacles and spans of the user's own.
            (None, None, None) if self.tracks.is_some() || self.scene.is_some() || self.timeline.is_some() => {
                source::prompt(source::DEFAULT_PROMPT)
            }
            (None, None, None) => source::default_job(model.frame_rate())?,
        };
        if let Some(path) = &self.anchors {
            source.anchors = anchors_file::read(path, model.frame_rate())?;
            let numbers = model.codebooks().quantizers().max(1);
            let tokens = match (&source.content, self.seconds) {
                (Content::Tokens(tokens), _) => tokens.len() / numbers,
                // Longer than its anchors need if the prompt suggests it.
                (Content::Prompt(_), None) => model.max_tokens(),
                (Content::Prompt(_), Some(s)) => self.frames(s, model).div_ceil(model.frames_per_token().max(1)),
            };
            anchors_file::check_at(&source.anchors, tokens * model.frames_per_token(), model.frame_rate())
                .with_context(|| format!("{}", path.display()))?;
            let far = anchors_file::out_of_reach(&source.anchors, model.frame_rate());
            source.notes.extend(far.iter().map(|far| format!("warning: {far}")));
            source.anchors = anchors_file::distinct(&source.anchors);
        }
        if let Some(path) = &self.tracks {
            source.tracks = scene_file::read_tracks(path, model.frame_rate())
                .with_context(|| format!("reading the tracks in {}", path.display()))?;
        }
        if let Some(path) = &self.scene {
            source.obstacles = scene_file::read_scene(path, model.frame_rate())
                .with_context(|| format!("reading the scene in {}", path.display()))?;
        }
        if let Some(path) = &self.timeline {
            source.timeline = scene_file::read_timeline(path, model.frame_rate())
                .with_context(|| format!("reading the timeline in {}", path.display()))?;
        }
        Ok(source)
    }

    fn frames(&self, seconds: f64, model: &Model<'_>) -> usize {
        (seconds * f64::from(model.frame_rate())).round() as usize
    }

    fn planning(&self, model: &Model<'_>) -> Planning<'static> {
        let asked = self.anchors.is_some() || self.tracks.is_some() || self.timeline.is_some();
        let default = if self.text.is_none() && !asked { Some(5.0) } else { None };
        let length = match self.seconds.or(default) {
            Some(s) => Length::Frames(self.frames(s, model).try_into().unwrap_or(u16::MAX)),
            None => Length::Predicted,
        };
        let (seed, steps, guidance, conditioned) = (self.seed, self.steps, self.guidance, !self.unconditioned);
        Planning { length, seed, steps, guidance, conditioned, ..Planning::DEFAULT }
    }

    fn write(&self, results: &Results<'_>, reference: &[Pose], report: &Report) -> anyhow::Result<()> {
        let Results { source, conditions, motions, plan, played } = *results;
        let Motions { alone, before, after, .. } = motions;
        std::fs::create_dir_all(&self.out)
            .with_context(|| format!("cannot make the folder {}; give another one with --out", self.out.display()))?;
        let frame_time = 1.0 / f64::from(after.frame_rate);
        for (name, motion) in [("before.bvh", &before.joints), ("motion.bvh", &after.joints)] {
            output::write_atomic(self.out.join(name), |file| export::bvh::write_bvh(motion, frame_time, file))?;
        }
        let bent = match conditions.has_rows() || conditions.anchors.is_empty() {
            true => "as it was edited",
            false => "bent onto the anchors",
        };
        let mut shown = vec![Shown::new("after", "Refined", bent, &after.joints)];
        shown.push(match plan {
            None => Shown::new("before", "As given", "as the tokens say, before refinement", &before.joints),
            Some(_) => Shown::new("before", "Generated", "as it was planned, before refinement", &before.joints),
        });
        if let Some(alone) = alone {
            let (name, label) = match (motions.conditioned, conditions.timeline.is_empty()) {
                (true, true) => {
                    ("Prompt alone", "what the planner makes when it does not see where the motion is to pass")
                }
                (true, false) => {
                    ("Prompt alone", "what the planner makes of the prompt, without places to pass and without spans")
                }
                (false, _) => ("Without spans", "the motion as it was generated, without the spans of the timeline"),
            };
            shown.push(Shown::new("alone", name, label, &alone.joints));
        }
        let label = "what the servos made of the refined motion, by forward kinematics";
        shown.push(Shown::new("robot", "Robot", label, &played.body));
        let label = match conditions.known_to_reference() {
            false => "f32 reference in front of the edit, which knows no tracks, obstacles or spans",
            true => "f32 reference of the refined embeddings",
        };
        shown.push(Shown::new("reference", "Reference", label, reference));
        let tolerance = self.refinement.0.unwrap_or_default().tolerance;
        let compared: [&[Pose]; 2] = [&before.joints, &after.joints];
        let intervals = intervals::of(&source.anchors, report.tokens, &compared, &tolerance)?;
        let around = Surroundings { conditions, frame_rate: after.frame_rate };
        let scene = Scene {
            title: source.name.clone(),
            caption: source.caption.clone(),
            fps: after.frame_rate,
            frames: after.joints.len(),
            frames_per_token: after.joints.len() / report.tokens.max(1),
            plan: plan.map(|plan| ShownPlan {
                words: plan.words.clone(),
                steps: plan.steps.clone(),
                fixed: Vec::new(),
            }),
            stages: stages(after),
            joint_names: NAMES.to_vec(),
            parents: PARENTS.to_vec(),
            motions: shown,
            anchors: report.anchor_errors.clone(),
            note: report.unconditioned_because.as_ref().map(|_| format!("The planner saw {}.", report.seen())),
            intervals,
            tracks: around.tracks(compared),
            obstacles: around.obstacles(after.joints.len()),
            clearance: around.clearance(compared),
            timeline: ShownSpan::of_all(conditions.timeline, &after.spans),
            robot: &played.shown,
            refinement: report.refinement.clone(),
            curve: curve(&after.errors),
            error_alone_cm: report.control_error_unconditioned_cm.filter(|_| alone.is_some()),
            error_before_cm: report.control_error_before_cm,
            error_after_cm: report.control_error_after_cm,
            facts: report.lines().into_iter().map(|(label, value)| Fact { label, value }).collect(),
        };
        let page = viewer::page(&scene)?;
        output::write_atomic(self.out.join("viewer.html"), |file| file.write_all(page.as_bytes()))?;
        let markdown = report.markdown();
        output::write_atomic(self.out.join("summary.md"), |file| file.write_all(markdown.as_bytes()))?;
        let json = serde_json::to_string_pretty(report)?;
        output::write_atomic(self.out.join("summary.json"), |file| writeln!(file, "{json}"))?;
        Ok(())
    }
}

/// A refusal of the runtime, with what may have been wrong or could be asked for instead.
fn refused(model: &Model<'_>, source: &Source, error: Error) -> anyhow::Error {
    let instead = match (error, &source.content) {
        (Error::Timeline(error), content) => spans::instead(model, error, matches!(content, Content::Prompt(_))),
        (_, Content::Prompt(_)) => " (`motionette inspect --vocabulary` lists the words that a model knows)".into(),
        (_, Content::Tokens(_)) => String::new(),
    };
    anyhow::Error::new(error).context(format!("the runtime refused the request{instead}"))
}

/// What a run gave.
#[derive(Clone, Copy)]
struct Results<'r> {
    source: &'r Source,
    conditions: &'r Conditions<'r>,
    motions: &'r Motions,
    plan: Option<&'r Compared>,
    played: &'r Played,
}

/// The motions of a run.
struct Motions {
    /// What the prompt, or the tokens, give alone, where the others have spans or their planner saw anchors.
    alone: Option<Outcome>,
    /// Whether it saw any.
    conditioned: bool,
    /// As it was planned or given.
    before: Outcome,
    /// Bent onto the anchors.
    after: Outcome,
}

/// Work and time of each stage.
fn stages(after: &Outcome) -> Vec<ShownStage> {
    let plan = &after.plan;
    let milliseconds = |time: std::time::Duration| time.as_secs_f64() * 1e3;
    let refining = plan.macs - plan.planning_macs - plan.decoding_macs;
    [
        ("text and planning", plan.planning_macs, after.planning),
        ("refinement", refining, after.refining),
        ("decoding", plan.decoding_macs, after.decoding),
    ]
    .into_iter()
    .filter(|(_, macs, _)| *macs > 0)
    .map(|(label, macs, time)| ShownStage { label, macs, milliseconds: milliseconds(time) })
    .collect()
}

/// Best control error so far after each decoder evaluation.
fn curve(errors: &[f32]) -> Vec<CurvePoint> {
    let mut best = f64::INFINITY;
    errors
        .iter()
        .enumerate()
        .map(|(index, error)| {
            best = best.min(100.0 * f64::from(*error));
            CurvePoint { evaluations: index + 1, error_cm: best }
        })
        .collect()
}
