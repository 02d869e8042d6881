//! A `[[channel]]`.

use motionette::Joint;
use motionette::playback::body::turns;
use motionette::playback::robot::{MAX_ANGLE, Source};
use motionette::playback::{Axis, Bus, Channel};

use super::reader::{Places, Reader, Table, commands, nearest, number, pair};

/// Keys of a channel.
pub(super) const CHANNEL_KEYS: [&str; 18] = [
    "name",
    "joint",
    "axis",
    "follows",
    "neutral",
    "start",
    "range",
    "direction",
    "gain",
    "pulse",
    "position",
    "speed",
    "acceleration",
    "bus",
    "pin",
    "address",
    "output",
    "id",
];

/// Keys of a channel that may have a default.
pub(super) const DEFAULT_KEYS: [&str; 11] =
    ["neutral", "start", "range", "direction", "gain", "pulse", "position", "speed", "acceleration", "bus", "address"];

/// Steps of an STS3215 in a turn; half of them is its middle.
const STEPS: f32 = 4096.0;

/// Where the keys of a channel stand.
pub(super) type Placed = Places;

/// Buses by name.
#[derive(Clone, Copy, PartialEq)]
enum Kind {
    Pwm,
    Pca9685,
    Sts3215,
}

/// Reads a channel. What cannot be read is complained about, marked as broken and replaced by something harmless; keys that were
/// `meant` in the defaults are not missing here.
pub(super) fn read(reader: &mut Reader<'_>, mut table: Table<'_, '_>, meant: &[&'static str]) -> (Channel, Placed) {
    let table = &mut table;
    let own = reader.unknown_keys(table.own, "a channel", &CHANNEL_KEYS);
    own.iter().chain(meant).for_each(|key| table.places.broken(key));
    let name = reader.text(table, "name");
    if name.is_none() && table.places.sound(&["name"]) {
        missing(reader, table, "name", "name = \"left elbow\"");
    }
    let source = source(reader, table);
    let range = reader.value(table, "range", "two numbers of degrees, [lowest, highest]", |v| pair(v, number));
    if range.is_none() && table.places.sound(&["range"]) {
        missing(reader, table, "range", "range = [-90, 90], degrees");
    }
    let range = range.unwrap_or([-MAX_ANGLE, MAX_ANGLE]);
    let neutral = reader.number(table, "neutral", " of degrees").unwrap_or(0.0);
    let (bus, command) = connection(reader, table, range);
    let start = start(reader, table, bus, neutral);
    let gain = gain(reader, table, source);
    let mut limit = |key, example| {
        reader.number(table, key, "").unwrap_or_else(|| {
            if table.places.sound(&[key]) {
                missing(reader, table, key, example);
            }
            1000.0
        })
    };
    let speed = limit("speed", "speed = 300, degrees a second");
    let acceleration = limit("acceleration", "acceleration = 2000, degrees a second squared");
    let name = name.unwrap_or_default();
    let channel = Channel { name, source, neutral, start, gain, range, command, speed, acceleration, bus };
    (channel, std::mem::take(&mut table.places))
}

fn missing(reader: &mut Reader<'_>, table: &mut Table<'_, '_>, key: &'static str, example: &str) {
    let place =
        if table.defaults.is_some_and(|_| DEFAULT_KEYS.contains(&key)) { ", here or in [defaults]" } else { "" };
    reader.report(table.places.head.clone(), format!("this channel has no {key}: give it one{place} ({example})"));
    table.places.broken(key);
}

fn source(reader: &mut Reader<'_>, table: &mut Table<'_, '_>) -> Source {
    const FOLLOWED: [(&str, Source); 3] =
        [("heading", Source::Heading), ("height", Source::Height), ("still", Source::Still)];
    let axis = reader.word(table, "axis", &[("x", Axis::X), ("y", Axis::Y), ("z", Axis::Z)]);
    let follows = reader.word(table, "follows", &FOLLOWED);
    let joint = joint(reader, table);
    if !table.places.sound(&["axis", "follows", "joint"]) {
        return Source::Still;
    }
    let wrong = match (follows, joint, axis) {
        (Some(source), None, None) => return source,
        (None, Some(joint), Some(axis)) => return Source::Joint(joint, axis),
        (Some(_), Some(_), _) => "both joint and follows are given: keep one",
        (Some(_), None, Some(_)) => "an axis is that of a joint: remove it, or follows",
        (None, Some(_), None) => "a joint needs an axis beside it: axis = \"x\", \"y\" or \"z\"",
        (None, None, Some(_)) => "an axis needs a joint beside it: joint = \"left_elbow\"",
        (None, None, None) => {
            "this channel does not say what it follows: give joint and axis, or follows = \"heading\", \"height\" or \"still\""
        }
    };
    reader.report(table.places.of(&["follows", "joint", "axis"]), wrong);
    table.places.broken("joint");
    Source::Still
}

fn joint(reader: &mut Reader<'_>, table: &mut Table<'_, '_>) -> Option<u8> {
    let known: Vec<&str> = Joint::ALL.into_iter().filter(|joint| turns(*joint)).map(Joint::name).collect();
    let name = reader.value(table, "joint", "the name of a joint in quotes", |v| v.as_str().map(str::to_owned))?;
    let joints = known.join(", ");
    let complaint = match (Joint::from_name(&name), nearest(&name, &known)) {
        (Some(joint), _) if turns(joint) => return Some(joint.into()),
        (Some(_), _) => format!("positions do not tell how the {name} turns; these can be followed: {joints}"),
        (None, Some(near)) => format!("there is no joint {name:?}: did you mean {near}? Joints: {joints}"),
        (None, None) => format!("there is no joint {name:?}; joints are {joints}"),
    };
    reader.report(table.places.of(&["joint"]), complaint);
    table.places.broken("joint");
    None
}

/// Where a servo that cannot say it stands when power comes up.
fn start(reader: &mut Reader<'_>, table: &mut Table<'_, '_>, bus: Bus, neutral: f32) -> Option<f32> {
    if bus.reads_back() {
        // A default is for the others.
        return None;
    }
    let start = reader.value(table, "start", "a number of degrees, or \"neutral\"", |value| match value.as_str() {
        Some("neutral") => Some(neutral),
        Some(_) => None,
        None => number(value),
    });
    if start.is_none() && table.places.sound(&["start", "bus"]) {
        missing(reader, table, "start", "start = \"neutral\", or the angle at which it stands when power comes up");
    }
    start
}

fn gain(reader: &mut Reader<'_>, table: &mut Table<'_, '_>, source: Source) -> f32 {
    let reversed = reader.word(table, "direction", &[("normal", false), ("reversed", true)]).unwrap_or(false);
    let gain = reader.number(table, "gain", "");
    if gain.is_some_and(|gain| gain < 0.0) {
        let wrong = "the gain must be positive: turn the servo round with direction = \"reversed\"";
        reader.report(table.places.of(&["gain"]), wrong);
        table.places.broken("gain");
    } else if gain.is_none() && source == Source::Height && table.places.sound(&["gain"]) {
        missing(reader, table, "gain", "gain = 200, degrees a metre of height");
    }
    let gain = gain.unwrap_or(1.0);
    if reversed { -gain } else { gain }
}

/// How a servo is connected, and its commands at the ends of `range`.
fn connection(reader: &mut Reader<'_>, table: &mut Table<'_, '_>, range: [f32; 2]) -> (Bus, [u16; 2]) {
    const KINDS: [(&str, Kind); 3] = [("pwm", Kind::Pwm), ("pca9685", Kind::Pca9685), ("sts3215", Kind::Sts3215)];
    let Some(kind) = reader.word(table, "bus", &KINDS) else {
        if table.places.sound(&["bus"]) {
            missing(reader, table, "bus", "bus = \"pca9685\", or \"pwm\" or \"sts3215\"");
        }
        table.places.broken("pulse");
        return (Bus::Pwm { pin: 0 }, [1000, 2000]);
    };
    let (own, foreign): (&'static str, &[&str]) = match kind {
        Kind::Pwm => ("pin", &["address", "output", "id", "position"]),
        Kind::Pca9685 => ("output", &["pin", "id", "position"]),
        Kind::Sts3215 => ("id", &["pin", "address", "output", "pulse", "start"]),
    };
    for (key, value) in table.own.iter().filter(|(key, _)| foreign.contains(&&**key.get_ref())) {
        let name = KINDS.iter().find(|(_, other)| *other == kind).map_or("", |(name, _)| name);
        reader.report(value.span(), format!("a servo on bus \"{name}\" has no {}: remove it", key.get_ref()));
    }
    let number = reader.whole(table, own, 255);
    if number.is_none() && table.places.sound(&[own]) {
        missing(reader, table, own, &format!("{own} = 3"));
    }
    let number = number.unwrap_or(0);
    let bus = match kind {
        Kind::Pwm => Bus::Pwm { pin: number },
        Kind::Pca9685 => Bus::Pca9685 { address: reader.whole(table, "address", 127).unwrap_or(0x40), output: number },
        Kind::Sts3215 => Bus::Sts3215 { id: number },
    };
    if kind != Kind::Sts3215 {
        let pulse = reader.value(table, "pulse", "two whole numbers of microseconds, [at low, at high]", commands);
        if pulse.is_none() && table.places.sound(&["pulse"]) {
            missing(reader, table, "pulse", "pulse = [500, 2500], microseconds at the ends of the range");
        }
        return (bus, pulse.unwrap_or([1000, 2000]));
    }
    let position = reader.value(table, "position", "two whole numbers of 4096 a turn, [at low, at high]", commands);
    if position.is_some() || !table.places.sound(&["position", "range"]) {
        return (bus, position.unwrap_or([0, 4095]));
    }
    let [first, last] = range.map(|end| (STEPS / 2.0 + end * STEPS / 360.0).round());
    if first < last && (first < 0.0 || last >= STEPS) {
        let wrong =
            "the range reaches beyond a turn of the servo, -180 to 179.9 degrees with its middle at 0: give position";
        reader.report(table.places.of(&["range"]), wrong);
        table.places.broken("position");
    }
    // A range whose ends are the wrong way round is complained about as such.
    (bus, if first < last { [first as u16, last as u16] } else { [0, 4095] })
}
