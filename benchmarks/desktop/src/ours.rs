//! The runtime, called as `runtime/examples/speed.rs` calls it.

use std::ops::ControlFlow;

use anyhow::{Context, Result, ensure};
use motionette::channels::Channels;
use motionette::codec::Decode;
use motionette::codec::vq::decoder::Workspace;
use motionette::generation::tokens::session::Modules;
use motionette::generation::tokens::{PlanningLimits, Session};
use motionette::memory::Arena;
use motionette::numerics::hash::Stream;
use motionette::refining::{Config, Report};
use motionette::{Anchors, Generator, Joint, MOST_ROWS, Model, Planning, Prompt, Request, Sampling};
use motionette_host::blob::BlobFile;

/// What is asked for.
pub const PROMPT: &str = "a person walks forward and waves the right hand";
/// Planner steps of a request.
pub const STEPS: u16 = Planning::DEFAULT.steps;
/// Decoder evaluations that refine it.
pub const EVALUATIONS: u16 = 20;
/// Joints that the request's anchors control, a bit each.
pub const ANCHORED: u32 = 1 << Joint::LeftWrist as u32 | 1 << Joint::RightWrist as u32;

/// Memory on a 16-byte boundary that is given to a runtime for good.
fn memory(bytes: usize) -> &'static mut [u8] {
    bytemuck::cast_slice_mut(vec![0u128; bytes.div_ceil(16)].leak())
}

/// The decoder at a fixed length and choice of channels.
pub struct Decoder<'m> {
    model: &'m Model<'m>,
    channels: Channels,
    work: Workspace<'m>,
    /// Normalised features `[T][channels]`.
    pub features: Vec<f32>,
    /// `dJ/dlatent` `[L][du]`.
    pub gradient: Vec<f32>,
}

impl<'m> Decoder<'m> {
    /// Takes the buffers for the longest motion.
    ///
    /// # Errors
    /// When they are too small, which would be a bug.
    pub fn new(model: &'m Model<'m>, channels: Channels) -> Result<Self> {
        let (decoder, tokens) = (model.decoder(), model.max_tokens());
        let mut arena = Arena::new(memory(decoder.workspace_bytes(tokens, channels.count(), MOST_ROWS)));
        let work = decoder.workspace(&mut arena, tokens, channels.count(), MOST_ROWS)?;
        let features = vec![0.0; tokens * model.frames_per_token() * channels.count()];
        Ok(Self { model, channels, work, features, gradient: vec![0.0; tokens * decoder.code_width()] })
    }

    /// Latent `[L][du]` to features.
    ///
    /// # Errors
    /// Never: nobody interrupts.
    pub fn forward(&mut self, latent: &[f32]) -> Result<()> {
        let Self { model, channels, work, features, .. } = self;
        let done = model.decoder().forward(latent, channels, features, work, &mut || ControlFlow::Continue(()));
        ensure!(done.is_continue(), "the decoder was interrupted");
        Ok(())
    }

    /// `dJ/dfeatures` at the last pass to `dJ/dlatent`.
    ///
    /// # Errors
    /// Never: nobody interrupts.
    pub fn backward(&mut self, gradient: &[f32]) -> Result<()> {
        let Self { model, channels, work, gradient: du, .. } = self;
        let done = model.decoder().backward(gradient, channels, du, work, &mut || ControlFlow::Continue(()));
        ensure!(done.is_continue(), "the decoder was interrupted");
        Ok(())
    }
}

/// The guided planner at the longest motion.
pub struct Planner<'m> {
    session: Session<'m, 'm, 'm>,
    stream: Stream,
}

impl<'m> Planner<'m> {
    /// Reads the prompt.
    ///
    /// # Errors
    /// When the model knows none of its words.
    pub fn new(modules: Modules<'m, 'm>, tokens: usize) -> Result<Self> {
        let limits =
            PlanningLimits { words: PROMPT.split(' ').count(), steps: STEPS, guided: true, anchors: false, clauses: 1 };
        let mut arena = Arena::new(memory(modules.bytes(tokens, &limits, MOST_ROWS).all()));
        let mut session = Session::new(modules, &mut arena, tokens, &limits, MOST_ROWS)?;
        let read = session.read(&Prompt::Text(PROMPT), &mut || ControlFlow::Continue(()))?;
        ensure!(read.is_continue(), "reading was interrupted");
        Ok(Self { session, stream: Stream::new(2) })
    }

    /// A step: both passes over `tokens` at a time, then logits, a proposal and a draw for every position; `tokens` stay.
    ///
    /// # Errors
    /// Never: nobody interrupts.
    pub fn step(&mut self, tokens: &[u16], time: f32) -> Result<()> {
        self.advance(tokens, time, &Planning::DEFAULT, Some((time * f32::from(STEPS)) as u16))
    }

    /// What the networks do of a step: both passes, the logits of every position and the most probable token of each.
    ///
    /// # Errors
    /// Never: nobody interrupts.
    pub fn networks(&mut self, tokens: &[u16], time: f32) -> Result<()> {
        self.advance(tokens, time, &Planning { sampling: Sampling::Greedy, ..Planning::DEFAULT }, None)
    }

    fn advance(&mut self, tokens: &[u16], time: f32, planning: &Planning<'_>, step: Option<u16>) -> Result<()> {
        let passed = self.session.pass(tokens, time, planning, &mut || ControlFlow::Continue(()));
        ensure!(passed.is_continue(), "the planner was interrupted");
        self.session.advance(planning, step, &mut self.stream, &mut tokens.to_vec());
        Ok(())
    }

    /// Guided logits `[L][V]` of the last step.
    pub fn logits(&mut self, tokens: usize) -> Vec<f32> {
        (0..tokens).flat_map(|position| self.session.logits(position).to_vec()).collect()
    }
}

/// The standard request: the longest motion from text through two places of the root and two of the wrists.
pub struct Whole<'m> {
    generator: Generator<'m>,
    anchors: Anchors,
    frames: u16,
}

impl<'m> Whole<'m> {
    /// A generator with an arena of just the size that the request takes, as many rows at a time as may be: a desktop has the memory.
    ///
    /// # Errors
    /// When the model refuses the request.
    pub fn new(blob: &'m BlobFile) -> Result<Self> {
        let anchors = Anchors::new()
            .root_at(2.0, [0.2, 0.9, 1.2])
            .joint_at(4.0, Joint::RightWrist, [-0.3, 1.4, 2.2])
            .joint_at(6.0, Joint::LeftWrist, [0.4, 1.1, 3.2])
            .root_at(9.0, [0.5, 0.9, 4.5]);
        let model = blob.model()?;
        let frames = u16::try_from(model.max_tokens() * model.frames_per_token())?;
        let mut empty = Generator::new(model, &mut [])?;
        empty.set_rows(MOST_ROWS);
        let bytes = empty.plan(&request(&anchors, frames))?.arena_bytes;
        let mut generator = Generator::new(blob.model()?, memory(bytes))?;
        generator.set_rows(MOST_ROWS);
        Ok(Self { generator, anchors, frames })
    }

    /// Makes the motion.
    ///
    /// # Errors
    /// When the model refuses the request.
    pub fn generate(&mut self) -> Result<Report> {
        let motion = self.generator.generate(&request(&self.anchors, self.frames), &mut ())?;
        motion.refinement.context("the request was not refined")
    }
}

fn request(anchors: &Anchors, frames: u16) -> Request<'_> {
    // The whole budget is spent, however near the anchors are.
    let refinement = Config { stop_error: 0.0, ..Config::fast(EVALUATIONS) };
    Request::text(PROMPT).frames(frames).seed(7).through(anchors).refined(refinement)
}
