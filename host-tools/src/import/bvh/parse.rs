//! Text to [`Bvh`].
//!
//! Why not a library: exporters stray from the format in many small ways, and people must learn the line and the cause of each.

use super::{Bvh, Channel, Joint, Problem};

/// A problem and its line (from 1; 0 = the file as a whole).
type Located = (usize, Problem);

/// Joints of a hierarchy at most: full bodies with fingers and faces have some hundred.
const MOST_JOINTS: usize = 4096;

/// Parses the text of a file. Time and memory are linear in its length.
///
/// # Errors
/// The line (from 1, 0 for the file as a whole) and the [`Problem`] there.
pub fn parse(text: &str) -> Result<Bvh, Located> {
    let mut words = Words::new(text);
    let joints = hierarchy(&mut words)?;
    if !joints.iter().any(|joint| (0..3).all(|axis| joint.channels.contains(&Channel::Position(axis)))) {
        return Err((0, Problem::NoRootMotion));
    }
    motion(words, joints)
}

/// Words of a text with their lines; a brace is a word of its own wherever it stands.
struct Words<'a> {
    lines: std::iter::Enumerate<std::str::Lines<'a>>,
    /// What is left of the current line.
    rest: &'a str,
    /// The current line, from 1.
    line: usize,
    peeked: Option<&'a str>,
}

impl<'a> Words<'a> {
    fn new(text: &'a str) -> Self {
        let text = text.trim_start_matches('\u{feff}');
        Self { lines: text.lines().enumerate(), rest: "", line: 0, peeked: None }
    }

    fn next(&mut self) -> Option<&'a str> {
        if let Some(word) = self.peeked.take() {
            return Some(word);
        }
        loop {
            self.rest = self.rest.trim_start();
            if !self.rest.is_empty() {
                let end = match self.rest.find(|c: char| c.is_whitespace() || c == '{' || c == '}') {
                    Some(0) => 1,
                    Some(end) => end,
                    None => self.rest.len(),
                };
                let (word, rest) = self.rest.split_at(end);
                self.rest = rest;
                return Some(word);
            }
            let (index, line) = self.lines.next()?;
            self.line = index + 1;
            self.rest = line;
        }
    }

    fn peek(&mut self) -> Option<&'a str> {
        self.peeked = self.next();
        self.peeked
    }

    fn need(&mut self, expected: &'static str) -> Result<&'a str, Located> {
        self.next().ok_or((self.line, Problem::Ends { expected }))
    }

    /// The next word must be this one, in any case.
    fn keyword(&mut self, expected: &'static str) -> Result<(), Located> {
        let found = self.need(expected)?;
        if found.eq_ignore_ascii_case(expected) { Ok(()) } else { Err(self.unexpected(expected, found)) }
    }

    fn unexpected(&self, expected: &'static str, found: &str) -> Located {
        (self.line, Problem::Expected { expected, found: shortened(found) })
    }

    fn number(&mut self, expected: &'static str, what: impl FnOnce() -> String) -> Result<f64, Located> {
        let word = self.need(expected)?;
        number(word, what).map_err(|problem| (self.line, problem))
    }
}

fn number(word: &str, what: impl FnOnce() -> String) -> Result<f64, Problem> {
    match word.parse::<f64>() {
        Ok(x) if x.is_finite() => Ok(x),
        Ok(_) => Err(Problem::NotFinite { found: shortened(word), what: what() }),
        Err(_) => Err(Problem::NotANumber { found: shortened(word) }),
    }
}

/// Words of a hostile file may be long; messages are not.
fn shortened(word: &str) -> String {
    word.chars().take(60).collect()
}

/// What an opening brace belongs to.
enum Open {
    Joint(usize),
    EndSite,
}

/// `HIERARCHY ROOT ... { ... }`, with an explicit stack: depth costs memory, not stack.
fn hierarchy(words: &mut Words<'_>) -> Result<Vec<Joint>, Located> {
    words.keyword("HIERARCHY")?;
    words.keyword("ROOT")?;
    let mut joints = Vec::new();
    let mut seen: Vec<(bool, bool)> = Vec::new();
    let mut open = vec![begin(words, &mut joints, None)?];
    seen.push((false, false));
    let mut channels = 0;
    while let Some(level) = open.last() {
        let word = words.need("}")?;
        match (level, word.to_ascii_uppercase().as_str()) {
            (Open::Joint(joint), "}") => {
                let (offset, channels) = seen[*joint];
                if !offset || !channels {
                    let missing = if offset { "CHANNELS" } else { "OFFSET" };
                    return Err((words.line, Problem::Incomplete { joint: joints[*joint].name.clone(), missing }));
                }
                open.pop();
            }
            (Open::EndSite, "}") => {
                open.pop();
            }
            (Open::Joint(joint), "OFFSET") => {
                let joint = *joint;
                let name = joints[joint].name.clone();
                joints[joint].offset = vector(words, &name)?;
                seen[joint].0 = true;
            }
            (Open::EndSite, "OFFSET") => {
                vector(words, "End Site")?;
            }
            (Open::Joint(joint), "CHANNELS") if !seen[*joint].1 => {
                let joint = *joint;
                joints[joint].channels = channel_list(words, &joints[joint].name)?;
                joints[joint].first_channel = channels;
                channels += joints[joint].channels.len();
                seen[joint].1 = true;
            }
            (Open::Joint(joint), "JOINT") => {
                let parent = *joint;
                open.push(begin(words, &mut joints, Some(parent))?);
                seen.push((false, false));
            }
            (Open::Joint(_), "END") => {
                // "End Site", sometimes with a name.
                name_before_brace(words)?;
                open.push(Open::EndSite);
            }
            (Open::Joint(_), _) => return Err(words.unexpected("OFFSET, CHANNELS, JOINT, End Site or }", word)),
            (Open::EndSite, _) => return Err(words.unexpected("OFFSET or }", word)),
        }
    }
    Ok(joints)
}

/// A joint's name and opening brace.
fn begin(words: &mut Words<'_>, joints: &mut Vec<Joint>, parent: Option<usize>) -> Result<Open, Located> {
    if joints.len() == MOST_JOINTS {
        return Err((words.line, Problem::TooManyJoints { limit: MOST_JOINTS }));
    }
    let name = name_before_brace(words)?;
    joints.push(Joint { name, parent, offset: [0.0; 3], channels: Vec::new(), first_channel: 0 });
    Ok(Open::Joint(joints.len() - 1))
}

/// Words up to `{`: some exporters write names with spaces.
fn name_before_brace(words: &mut Words<'_>) -> Result<String, Located> {
    let mut name = String::new();
    loop {
        let word = words.need("{")?;
        if word == "{" {
            return Ok(name);
        }
        if name.len() > 200 || word == "}" {
            return Err(words.unexpected("{ after a joint's name", word));
        }
        if !name.is_empty() {
            name.push(' ');
        }
        name.push_str(word);
    }
}

fn vector(words: &mut Words<'_>, joint: &str) -> Result<[f64; 3], Located> {
    let mut v = [0.0; 3];
    for x in &mut v {
        *x = words.number("three numbers", || format!("OFFSET of {joint}"))?;
    }
    Ok(v)
}

fn channel_list(words: &mut Words<'_>, joint: &str) -> Result<Vec<Channel>, Located> {
    let word = words.need("a number of channels")?;
    let count = match word.parse::<usize>() {
        Ok(count) if count <= 6 => count,
        _ => return Err((words.line, Problem::ChannelCount { joint: joint.into(), found: shortened(word) })),
    };
    let mut channels = Vec::with_capacity(count);
    for _ in 0..count {
        let word = words.need("a channel name")?;
        let channel = match word.to_ascii_lowercase().as_str() {
            "xposition" => Channel::Position(0),
            "yposition" => Channel::Position(1),
            "zposition" => Channel::Position(2),
            "xrotation" => Channel::Rotation(0),
            "yrotation" => Channel::Rotation(1),
            "zrotation" => Channel::Rotation(2),
            _ => return Err((words.line, Problem::UnknownChannel { joint: joint.into(), found: shortened(word) })),
        };
        if channels.contains(&channel) {
            return Err((words.line, Problem::RepeatedChannel { joint: joint.into(), found: word.into() }));
        }
        channels.push(channel);
    }
    Ok(channels)
}

/// `MOTION Frames: n Frame Time: s`, then one line a frame.
fn motion(mut words: Words<'_>, joints: Vec<Joint>) -> Result<Bvh, Located> {
    if words.peek().is_some_and(|word| word.eq_ignore_ascii_case("ROOT")) {
        words.next();
        let name = words.next().unwrap_or_default();
        return Err((words.line, Problem::SecondRoot { name: shortened(name) }));
    }
    words.keyword("MOTION")?;
    words.keyword("Frames:")?;
    let word = words.need("a number of frames")?;
    let announced = match word.parse::<usize>() {
        Ok(frames) if frames > 0 => frames,
        _ => return Err((words.line, Problem::Frames { found: shortened(word) })),
    };
    words.keyword("Frame")?;
    words.keyword("Time:")?;
    let frame_time = words.number("a frame time", || "Frame Time".into())?;
    if !(1e-4..=1.0).contains(&frame_time) {
        return Err((words.line, Problem::FrameTime { found: frame_time }));
    }

    let channels: usize = joints.iter().map(|joint| joint.channels.len()).sum();
    // Nothing is reserved for the announced number: it may be a lie.
    let mut values = Vec::new();
    let mut frames = 0;
    let rest = words.rest.trim();
    if !rest.is_empty() {
        return Err((
            words.line,
            Problem::Expected { expected: "a new line after the frame time", found: shortened(rest) },
        ));
    }
    for (index, line) in words.lines {
        let line_number = index + 1;
        if line.trim().is_empty() {
            continue;
        }
        if frames == announced {
            return Err((line_number, Problem::ExtraFrames { announced }));
        }
        let start = values.len();
        for word in line.split_whitespace() {
            let channel = values.len() - start;
            if channel == channels {
                let found = line.split_whitespace().count();
                return Err((line_number, Problem::Row { frame: frames, expected: channels, found }));
            }
            let value = number(word, || channel_name(&joints, channel)).map_err(|problem| (line_number, problem))?;
            values.push(value);
        }
        let found = values.len() - start;
        if found != channels {
            return Err((line_number, Problem::Row { frame: frames, expected: channels, found }));
        }
        frames += 1;
    }
    if frames < announced {
        return Err((0, Problem::MissingFrames { announced, found: frames }));
    }
    Ok(Bvh { joints, frame_time, channels, values })
}

/// `joint "Hips", Xrotation` for a channel's index in a frame.
fn channel_name(joints: &[Joint], channel: usize) -> String {
    let owner = joints
        .iter()
        .find(|joint| (joint.first_channel..joint.first_channel + joint.channels.len()).contains(&channel));
    match owner {
        Some(joint) => format!("joint {:?}, {:?}", joint.name, joint.channels[channel - joint.first_channel]),
        None => format!("channel {channel}"),
    }
}
