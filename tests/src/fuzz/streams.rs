//! Streams in careless hands: tokens and requests of any kind at any time, a full queue, frames taken late, work stopped
//! anywhere, an end and what comes behind it.

use motionette::numerics::hash::Stream;
use motionette::{
    AnchorList, Bones, Error, Fixed, Frame, Generator, Model, MotionStream, Prompt, ROWS, Request, Source, Stop,
    StreamError, StreamLimits, StreamPlan, generation::tokens as planning,
};
use std::ops::ControlFlow;

use super::requests::{self, Stopper};
use super::{Entry, Memory, Tally};

/// Operations of a case.
const OPERATIONS: u32 = 24;

/// What a case has seen of its stream.
#[derive(Default)]
struct Seen {
    /// Tokens that were taken.
    tokens: Vec<u16>,
    /// Bits of the frames that came out.
    joints: Vec<u32>,
    /// The origin was moved.
    moved: bool,
}

/// Makes a motion in a random order of operations, then compares it with the same tokens decoded whole.
///
/// # Errors
/// What a stream may not do.
pub fn case(entry: &Entry<'_>, random: &mut Stream, memory: &mut Memory, tally: &mut Tally) -> Result<(), String> {
    let model = &entry.model;
    let steps = 1 + random.below(4) as u16;
    // A plan for more words than the model reads is refused.
    let words = (1 + random.below(9) as usize).min(model.text().map_or(1, |text| text.max_words()));
    let planning = planning::PlanningLimits { words, steps, guided: random.below(3) > 0, anchors: false, clauses: 1 };
    let planning = Some(planning).filter(|_| model.planning().is_some() && random.below(4) > 0);
    let limits = StreamLimits {
        tokens: 1 + random.below(model.max_tokens() as u32) as usize,
        planning,
        rows: random.below(30) as usize,
    };
    let plan = StreamPlan::new(model, &limits).map_err(|e| e.to_string())?;
    let short = random.below(8) == 0;
    let size = if short { plan.arena_bytes - 1 } else { plan.arena_bytes };
    let mut generator = Generator::new(model.clone(), memory.arena.painted(size)).map_err(|e| e.to_string())?;
    let mut stream = match generator.stream(&limits) {
        Ok(_) if short => return Err("a stream in less memory than planned".to_owned()),
        Ok(stream) => stream,
        Err(StreamError::Request(Error::Arena(e))) if short && (e.needed, e.available) == (plan.arena_bytes, size) => {
            return Ok(());
        }
        Err(e) => return Err(format!("a stream inside its limits was refused: {e}")),
    };
    let skeleton = requests::skeleton(model, random);
    let bones = if random.below(3) == 0 { Bones::Given(&skeleton) } else { Bones::Model };
    match stream.set_bones(bones) {
        Ok(()) => {}
        Err(StreamError::Request(Error::Bone { .. })) if bones != Bones::Model => return Ok(()),
        Err(e) => return Err(format!("a body was refused: {e}")),
    }
    let mut seen = Seen::default();
    for _ in 0..OPERATIONS {
        operation(model, &mut stream, random, &mut seen, tally)?;
    }
    stream.finish();
    let ahead = stream.frames_ahead();
    let before = seen.joints.len();
    while let Some(frames) = stream.frames(&mut ()).map_err(|e| e.to_string())? {
        keep(frames, plan.frames, &mut seen)?;
    }
    let frame = size_of::<Frame>() / size_of::<f32>();
    let positions = seen.tokens.len() / model.codebooks().quantizers();
    if seen.joints.len() - before != ahead * frame {
        return Err(format!("{ahead} frames were due, {} numbers came", seen.joints.len() - before));
    }
    if seen.joints.len() != positions * model.frames_per_token() * frame {
        return Err(format!("{} numbers from {positions} tokens", seen.joints.len()));
    }
    if seen.moved || positions == 0 || positions > model.max_tokens() {
        return Ok(());
    }
    drop(generator);
    let request = Request::tokens(&seen.tokens).bones(bones).unrefined();
    let need = requests::need(model, &request, ROWS).ok_or("the stream's tokens cannot be planned")?;
    let mut generator = Generator::new(model.clone(), memory.arena.painted(need)).map_err(|e| e.to_string())?;
    let whole = generator.generate(&request, &mut ()).map_err(|e| e.to_string())?;
    tally.streams += 1;
    if whole.joints().iter().map(|v| v.to_bits()).eq(seen.joints.iter().copied()) {
        Ok(())
    } else {
        Err("segments differ from the whole".to_owned())
    }
}

fn operation(
    model: &Model<'_>,
    stream: &mut MotionStream<'_, '_>,
    random: &mut Stream,
    seen: &mut Seen,
    tally: &mut Tally,
) -> Result<(), String> {
    let most = 4 * model.frames_per_token();
    let wish = if random.below(2) == 0 { ControlFlow::Break(Stop::Finish) } else { ControlFlow::Break(Stop::Abort) };
    let mut stopper = Stopper { left: if random.below(2) == 0 { random.below(60) } else { 0 }, wish };
    let tokens: Vec<u16> = (0..requests::length(random, model, model.codebooks().quantizers()))
        .map(|_| requests::token(random, model))
        .collect();
    let known = stream.tokens().to_vec();
    let taken = match random.below(12) {
        0..4 => stream.push(&tokens).map(|()| tokens.len()),
        4..7 => {
            let text = requests::prompt(random);
            let fixed: Vec<Fixed> = (0..random.below(3)).map(|_| requests::given(random, model)).collect();
            let anchors = [requests::anchor(random, 40)];
            let vector = requests::vector(random, model);
            let source = match random.below(8) {
                0 => Source::Tokens(&tokens),
                1 => Source::Embeddings(&[0.0]),
                2 => Source::Text(Prompt::Bank(&text)),
                _ if model.vector_width().is_some() => Source::Text(Prompt::Vector(&vector)),
                _ => Source::Text(Prompt::Text(&text)),
            };
            let anchors = if random.below(8) == 0 { &anchors[..] } else { &[] };
            let planning = requests::planning(random, &fixed);
            let request = Request {
                source,
                tracks: &[],
                obstacles: &[],
                timeline: &[],
                anchors: AnchorList::Frames(anchors),
                refinement: None,
                planning,
                bones: Bones::Model,
            };
            let last = random.below(16) == 0;
            let planned =
                if last { stream.plan_last(&request, &mut stopper) } else { stream.plan(&request, &mut stopper) };
            planned.map(|segment| segment.tokens * model.codebooks().quantizers())
        }
        7..11 => {
            for _ in 0..random.below(5) {
                match stream.frames(&mut stopper) {
                    Ok(Some(frames)) => keep(frames, most, seen)?,
                    Ok(None) => break,
                    Err(StreamError::Request(Error::Aborted)) => {}
                    Err(e) => return Err(format!("frames were refused: {e}")),
                }
            }
            return Ok(());
        }
        _ if random.below(8) == 0 => {
            seen.moved = true;
            return if stream.rebase().iter().all(|v| v.is_finite()) {
                Ok(())
            } else {
                Err("an origin nowhere".to_owned())
            };
        }
        _ => {
            if random.below(8) == 0 {
                stream.finish();
            }
            return Ok(());
        }
    };
    match taken {
        Ok(count) => {
            let all = stream.tokens();
            let new = all.len().checked_sub(count).and_then(|first| all.get(first..)).ok_or("tokens are missing")?;
            seen.tokens.extend(new);
            Ok(())
        }
        Err(error) => {
            tally.requests_refused += 1;
            let same = known == stream.tokens();
            if same && !error.to_string().is_empty() { Ok(()) } else { Err(format!("changed by a refusal: {error}")) }
        }
    }
}

fn keep(frames: &[Frame], most: usize, seen: &mut Seen) -> Result<(), String> {
    if frames.len() > most {
        return Err(format!("{} frames at once, {most} were planned", frames.len()));
    }
    let numbers = frames.iter().flatten().flatten();
    if !numbers.clone().all(|v| v.is_finite()) {
        return Err("a frame that is not finite".to_owned());
    }
    seen.joints.extend(numbers.map(|v| v.to_bits()));
    Ok(())
}
