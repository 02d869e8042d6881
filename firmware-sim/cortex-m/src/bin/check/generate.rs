//! Motions of every source, whole and piece by piece.

use core::{hint::black_box, ops::ControlFlow};

use motionette::ROWS;
use motionette::{
    Anchor, AnchorList, Bones, Error, Fixed, Generator, Limits, Model, Observer, Plan, Planning, PlanningLimits,
    Progress, Prompt, Request, Sampling, Source, Stop, StreamError, StreamLimits, StreamPlan, refining::Config,
};
#[cfg(feature = "timeline")]
use motionette::{BodyParts, Span};
#[cfg(feature = "obstacles")]
use motionette::{Course, Keyframe, Obstacle, Shape};
#[cfg(feature = "tracks")]
use motionette::{Joint, Track};

/// An observer whose answer the optimiser cannot know.
struct Watch(ControlFlow<Stop>);

impl Observer for Watch {
    fn progress(&mut self, progress: Progress) -> ControlFlow<Stop> {
        black_box(progress);
        black_box(self.0)
    }

    fn tokens(&mut self, step: u16, tokens: &[u16]) {
        black_box((step, tokens));
    }
}

/// Why there was no motion; the fields are read through [`black_box`] only.
#[derive(Clone, Copy)]
#[expect(dead_code, reason = "never run, only linked")]
pub enum Refused {
    Blob(motionette::blob::Error),
    Request(Error),
    Stream(StreamError),
    #[cfg(feature = "playback")]
    Robot(motionette::playback::RobotError),
}

/// Everything a firmware may ask for.
#[inline(never)]
pub fn serve(
    blob: &[u8],
    arena: &mut [u8],
    tokens: &[u16],
    u: &[f32],
    anchors: &[Anchor],
    (text, fixed): (&str, &[Fixed]),
) -> Result<u64, Refused> {
    #[cfg(feature = "tracks")]
    let (mask, (positions, _)) = (black_box([1; 8]), u.as_chunks());
    #[cfg(feature = "tracks")]
    let tracks: &[Track<'_>] =
        &black_box([Track::new(Joint::Head, 3, positions), Track::new(Joint::Pelvis, 3, positions).masked(&mask)]);
    #[cfg(not(feature = "tracks"))]
    let tracks = &[];
    #[cfg(feature = "obstacles")]
    let keys = black_box([Keyframe { frame: 0, position: [0.0; 3] }; 2]);
    #[cfg(feature = "obstacles")]
    let obstacles: &[Obstacle<'_>] = &black_box([
        Obstacle::new(Shape::Sphere { radius: 1.0 }, [0.0; 3]),
        Obstacle::new(Shape::Box { half: [1.0; 3] }, [0.0; 3]).moving(Course::Keyframes(&keys)),
    ]);
    #[cfg(not(feature = "obstacles"))]
    let obstacles = &[];
    #[cfg(feature = "timeline")]
    let timeline: &[Span<'_>] = &black_box([
        Span::new(BodyParts::RIGHT_ARM, 0, 40, text),
        Span { prompt: Prompt::Bank(text), ..Span::new(BodyParts::LEGS, 8, 40, text) },
    ]);
    #[cfg(not(feature = "timeline"))]
    let timeline = &[];
    let model = Model::open(blob).map_err(Refused::Blob)?;
    let refinement = black_box(Config::default());
    let planning =
        black_box(Some(PlanningLimits { words: text.len(), steps: 5, guided: true, anchors: true, clauses: 1 }));
    let limits = Limits {
        tokens: tokens.len(),
        anchors: anchors.len(),
        tracked: 0,
        timeline: None,
        refinement,
        planning,
        rows: ROWS,
    };
    let _ = black_box(Plan::for_request(&model, &limits));
    let mut generator = Generator::new(model, arena).map_err(Refused::Request)?;
    black_box(generator.self_test().map_err(Refused::Request)?);
    let sources = [
        Source::Tokens(tokens),
        Source::Embeddings(u),
        Source::Text(Prompt::Text(text)),
        Source::Text(Prompt::Bank(text)),
        #[cfg(feature = "published")]
        Source::Text(Prompt::Vector(u)),
    ];
    let samplings = [
        Sampling::Greedy,
        Sampling::Sample { temperature: 1.0, top_k: 5, top_p: 0.9 },
        Sampling::Gumbel { temperature: 1.0 },
    ];
    // By frame or by time: the optimiser cannot know.
    let list = black_box(AnchorList::Frames(anchors));
    let mut hash = 0;
    for source in black_box(sources) {
        let [sampling, ..] = black_box(samplings);
        let planning = black_box(Planning { sampling, fixed, ..Planning::DEFAULT });
        let request = Request {
            source,
            anchors: list,
            tracks,
            obstacles,
            timeline,
            refinement: black_box(Some(refinement)),
            planning,
            bones: black_box(Bones::Model),
        };
        black_box(generator.plan(&request).map_err(Refused::Request)?);
        let motion = generator.generate(&request, &mut Watch(ControlFlow::Continue(()))).map_err(Refused::Request)?;
        black_box((motion.frames(), motion.tokens(), motion.words(), motion.unknown_words()));
        black_box(motion.unconditioned_anchors());
        hash ^= motion.hash();
        #[cfg(feature = "playback")]
        black_box(super::play::play(blob, motion.frames(), Some(&motion)).map_err(Refused::Robot)?);
    }
    let limits = black_box(StreamLimits { tokens: tokens.len(), planning, rows: ROWS });
    let _ = black_box(StreamPlan::new(generator.model(), &limits));
    for source in black_box(sources) {
        let [sampling, ..] = black_box(samplings);
        let planning = black_box(Planning { sampling, fixed, ..Planning::DEFAULT });
        let request = black_box(Request {
            source,
            anchors: list,
            tracks: &[],
            obstacles: &[],
            timeline: &[],
            refinement: black_box(Some(Config::DEFAULT)),
            planning,
            bones: Bones::Model,
        });
        hash ^= stream(&mut generator, &limits, &request)?;
    }
    Ok(hash)
}

/// A motion made piece by piece.
#[inline(never)]
fn stream(generator: &mut Generator<'_>, limits: &StreamLimits, request: &Request<'_>) -> Result<u64, Refused> {
    let mut stream = generator.stream(limits).map_err(Refused::Stream)?;
    stream.set_bones(black_box(Bones::Model)).map_err(Refused::Stream)?;
    let mut frames = 0;
    for last in black_box([false, true]) {
        black_box((stream.room(), stream.frames_ahead(), stream.rebase()));
        let watch = &mut Watch(ControlFlow::Continue(()));
        let planned = if last { stream.plan_last(request, watch) } else { stream.plan(request, watch) };
        black_box(planned.map_err(Refused::Stream)?);
        black_box(stream.push(black_box(&[0])).map_err(Refused::Stream)?);
        black_box(stream.tokens());
        while let Some(piece) = stream.frames(watch).map_err(Refused::Stream)? {
            frames += black_box(piece).len() as u64;
        }
    }
    stream.finish();
    Ok(frames)
}
