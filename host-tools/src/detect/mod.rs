//! What a body was seen to do, judged from its joints alone.
//!
//! [`detect`] takes `[T][22][3]` metres at a frame rate and names deeds ([`Deed`]) with their side. Every rule is plain geometry over
//! heights, headings and speeds with thresholds that are named, with their units, beside the rule; nothing is learned, no text and no
//! feature of a model takes part. So it is a second opinion beside a trained judge: it shares no errors with it.
//!
//! | module | deeds |
//! |---|---|
//! | `arms` | wave, clap, raise, punch |
//! | `legs` | jump, leap, jumping jack, kick, raise a leg |
//! | `posture` | squat, sit, rise, crouch, lie, get up, crawl, bow, reach for the floor, stand |
//! | `gait` | walk and run by direction, with turns, turn, step in place |
//! | [`actions`] | which deed answers for which action of `docs/actions.toml` |
//! | [`score`] | how often the rules are right on clips whose action is known |
//!
//! A motion can show several deeds: somebody waves and walks. Thresholds were tuned on training clips; [`score`] reports on test clips.

pub mod actions;
mod arms;
mod body;
mod gait;
mod legs;
mod posture;
pub mod score;

use crate::dataset::Side;
use crate::motion::Pose;
use body::Body;

/// Where a body goes, seen from itself.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Direction {
    /// Ahead, give or take 50 degrees.
    Forward,
    /// Back.
    Backward,
    /// To one side, perhaps ahead as well.
    Drift,
    /// To one side and hardly ahead.
    Sideways,
}

/// Something that a body does.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
#[non_exhaustive]
pub enum Deed {
    /// A hand, up, goes from side to side.
    Wave,
    /// Hands meet, part and meet again in front of the body.
    Clap,
    /// A hand is held above the shoulder.
    Raise,
    /// An arm is stretched forward all at once.
    Punch,
    /// Both feet leave the ground and the pelvis rises.
    Jump,
    /// A jump that carries the body over the ground.
    Leap,
    /// A jump with feet apart and hands up.
    JumpingJack,
    /// A stretched leg swings up fast.
    Kick,
    /// One foot is held up.
    RaiseLeg,
    /// Down and up again.
    Squat,
    /// From standing to a lower, upright posture.
    Sit,
    /// The reverse of sitting down.
    Rise,
    /// The pelvis is low, the body does not lie.
    Crouch,
    /// Flat on the floor.
    Lie,
    /// From lying to anything higher.
    GetUp,
    /// Along the floor.
    Crawl,
    /// The trunk goes forward and back.
    Bow,
    /// A hand comes near the floor.
    ReachDown,
    /// Nothing moves.
    Stand,
    /// Steps in a direction.
    Walk(Direction),
    /// Faster, with flights.
    Run(Direction),
    /// A walk that changes its heading.
    WalkTurn,
    /// A run that changes its heading.
    RunTurn,
    /// A turn on the spot.
    Turn,
    /// Steps without getting anywhere.
    StepInPlace,
}

impl std::fmt::Display for Deed {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let words = match self {
            Self::Wave => "wave",
            Self::Clap => "clap",
            Self::Raise => "raise a hand",
            Self::Punch => "punch",
            Self::Jump => "jump",
            Self::Leap => "leap",
            Self::JumpingJack => "jumping jack",
            Self::Kick => "kick",
            Self::RaiseLeg => "raise a leg",
            Self::Squat => "squat",
            Self::Sit => "sit down",
            Self::Rise => "rise",
            Self::Crouch => "crouch",
            Self::Lie => "lie",
            Self::GetUp => "get up",
            Self::Crawl => "crawl",
            Self::Bow => "bow",
            Self::ReachDown => "reach down",
            Self::Stand => "stand",
            Self::Walk(Direction::Forward) => "walk",
            Self::Walk(Direction::Backward) => "walk backward",
            Self::Walk(Direction::Drift) => "walk to a side",
            Self::Walk(Direction::Sideways) => "step sideways",
            Self::Run(Direction::Forward) => "run",
            Self::Run(Direction::Backward) => "run backward",
            Self::Run(Direction::Drift) => "run to a side",
            Self::Run(Direction::Sideways) => "run sideways",
            Self::WalkTurn => "walk and turn",
            Self::RunTurn => "run and turn",
            Self::Turn => "turn",
            Self::StepInPlace => "step in place",
        };
        f.write_str(words)
    }
}

/// A deed that was seen, and on which side.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub struct Seen {
    /// What.
    pub deed: Deed,
    /// Which side of the body did it, or to which side it went; none where the deed has no side.
    pub side: Side,
}

impl std::fmt::Display for Seen {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.side {
            Side::None => write!(f, "{}", self.deed),
            side => write!(f, "{} {side}", self.deed),
        }
    }
}

/// Deeds and what belongs to them: the hands of a jumping jack do not wave, who lands from a jump does not squat.
const PARTS: &[(Deed, Deed)] = &[
    (Deed::JumpingJack, Deed::Wave),
    (Deed::Clap, Deed::Wave),
    (Deed::Jump, Deed::Squat),
    (Deed::StepInPlace, Deed::Stand),
    (Deed::Kick, Deed::RaiseLeg),
];

/// What the motion shows, in no particular order; each deed at most once a side.
///
/// `motion` is `[T]` global joints, metres, y up; `fps` in 1/s. Empty when T is below 3 or a value is not finite: nothing was seen.
pub fn detect(motion: &[Pose], fps: f64) -> Vec<Seen> {
    let Some(body) = Body::new(motion, fps) else { return Vec::new() };
    let mut seen = [arms::detect(&body), legs::detect(&body), posture::detect(&body), gait::detect(&body)].concat();
    // What is part of something larger is not done for its own sake.
    for (larger, part) in PARTS {
        if seen.iter().any(|seen| seen.deed == *larger) {
            seen.retain(|seen| seen.deed != *part);
        }
    }
    seen
}
