//! What the runtime does not allow, at the line that it is about.

use motionette::playback::Robot;
use motionette::playback::robot::{Fault, Violation};

use super::channel::Placed;
use super::error::line_of;
use super::reader::{Places, Reader};

/// Keys of a servo's output.
const OUTPUT: [&str; 4] = ["output", "pin", "id", "address"];

/// Complains about every violation that is not the consequence of a complaint made before.
pub(super) fn report(reader: &mut Reader<'_>, robot: &Robot, whole: &Places, channels: &[Placed]) {
    let mut violations = Vec::new();
    robot.violations(&mut |violation| violations.push(violation));
    for Violation { channel, what } in violations {
        let places = channel.and_then(|channel| channels.get(usize::from(channel))).unwrap_or(whole);
        let causes = causes(&what, robot);
        let rate = matches!(what, Fault::Acceleration { .. }) && !whole.sound(&["tick_rate"]);
        let other = other(&what).map(|other| (other, &channels[other]));
        let others = other.is_none_or(|(_, places)| places.sound(causes));
        if !places.sound(causes) || !others || rate {
            continue;
        }
        let message = match other {
            None => what.to_string(),
            Some((other, places)) => {
                let same = match what {
                    Fault::SameName { .. } => "this name is also that",
                    Fault::SameOutput { .. } => "this is also the output",
                    _ => "this axis of the joint is also followed by that",
                };
                let (line, name) = (line_of(reader.source(), places.of(causes).start), &robot.channels[other].name);
                format!("{same} of the channel {name:?} (line {line}): change one of them")
            }
        };
        reader.report(places.of(causes), message);
    }
}

/// The channel that stands in the way.
fn other(fault: &Fault) -> Option<usize> {
    match fault {
        Fault::SameName { other } | Fault::SameOutput { other } | Fault::SameAxis { other } => Some((*other).into()),
        _ => None,
    }
}

/// Keys that a fault comes from; the first that was given is the one to change.
fn causes(fault: &Fault, robot: &Robot) -> &'static [&'static str] {
    match fault {
        Fault::NoChannels => &["channel"],
        Fault::TickRate(_) => &["tick_rate"],
        Fault::Times if (0.0..=60.0).contains(&robot.fade) => &["return_time"],
        Fault::Times => &["fade"],
        Fault::Name | Fault::SameName { .. } => &["name"],
        Fault::SameOutput { .. } | Fault::Output { .. } => &OUTPUT,
        Fault::SameAxis { .. } => &["axis", "joint", "follows"],
        Fault::Joint(_) => &["joint"],
        Fault::Range { .. } => &["range"],
        Fault::Neutral { .. } => &["neutral", "range"],
        Fault::NoStart => &["start"],
        Fault::Start { .. } => &["start", "range"],
        Fault::Creep(_) => &["creep"],
        Fault::Gain(_) => &["gain"],
        Fault::Command { .. } => &["pulse", "position", "range"],
        Fault::Speed(_) => &["speed"],
        Fault::Acceleration { .. } => &["acceleration"],
        Fault::Address(_) => &["address"],
        _ => &[],
    }
}
