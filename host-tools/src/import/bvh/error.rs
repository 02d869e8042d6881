//! What can be wrong with a BVH file.

use std::path::PathBuf;

/// A problem with its place.
#[derive(Debug, thiserror::Error)]
#[error("{}{}", path.display(), place(*line))]
pub struct Error {
    /// The file.
    pub path: PathBuf,
    /// Line, from 1; 0 when it concerns the whole file.
    pub line: usize,
    /// What is wrong and what to do.
    #[source]
    pub problem: Problem,
}

fn place(line: usize) -> String {
    if line == 0 { " cannot be imported".into() } else { format!(" line {line} cannot be read") }
}

/// What is wrong and what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Problem {
    /// The file cannot be read at all.
    #[error("the file cannot be opened")]
    Read(#[source] std::io::Error),
    /// Another word should stand here.
    #[error("expected {expected}, found {found:?}; is this a BVH file?")]
    Expected {
        /// What should stand here.
        expected: &'static str,
        /// What does.
        found: String,
    },
    /// The file ends in the middle.
    #[error("the file ends where {expected} should follow; it is truncated, export it again")]
    Ends {
        /// What should follow.
        expected: &'static str,
    },
    /// A number does not parse.
    #[error("{found:?} is not a number (decimals take a point, not a comma)")]
    NotANumber {
        /// The word found.
        found: String,
    },
    /// A number is NaN or infinite.
    #[error("{found} for {what} is not finite; repair or cut the recording there")]
    NotFinite {
        /// The word found.
        found: String,
        /// Joint and channel, or field.
        what: String,
    },
    /// A number is larger than any place or angle.
    #[error("{found} for {what} is no place or angle of a body (at most {limit:e}); repair or cut the recording there")]
    TooLarge {
        /// The word found.
        found: String,
        /// Joint and channel, or field.
        what: String,
        /// Largest number taken.
        limit: f64,
    },
    /// A channel name is not one of the six.
    #[error(
        "joint {joint:?} has the channel {found:?}; channels are Xposition, Yposition, Zposition, Xrotation, Yrotation, Zrotation"
    )]
    UnknownChannel {
        /// The joint.
        joint: String,
        /// The word found.
        found: String,
    },
    /// A joint names a channel twice.
    #[error("joint {joint:?} has the channel {found:?} twice; correct its CHANNELS line")]
    RepeatedChannel {
        /// The joint.
        joint: String,
        /// The channel.
        found: String,
    },
    /// More or fewer than 0 to 6 channels.
    #[error("joint {joint:?} announces {found} channels; there can be 0 to 6")]
    ChannelCount {
        /// The joint.
        joint: String,
        /// Number announced.
        found: String,
    },
    /// A joint lacks its OFFSET or CHANNELS line.
    #[error("joint {joint:?} has no {missing} line; add it or export the file again")]
    Incomplete {
        /// The joint.
        joint: String,
        /// `OFFSET` or `CHANNELS`.
        missing: &'static str,
    },
    /// No joint has three position channels.
    #[error(
        "no joint has position channels, so the recording does not say where the body is; export it with root translation"
    )]
    NoRootMotion,
    /// A second hierarchy begins.
    #[error("a second ROOT ({name:?}) begins; split the file, one body each")]
    SecondRoot {
        /// Name of the second root.
        name: String,
    },
    /// The hierarchy is larger than any body.
    #[error("more than {limit} joints; this is not a recording of a body, remove helper joints")]
    TooManyJoints {
        /// Largest number accepted.
        limit: usize,
    },
    /// The number of frames is not a positive whole number.
    #[error("{found:?} is not a number of frames; it must be at least 1")]
    Frames {
        /// The word found.
        found: String,
    },
    /// The time of a frame is zero, negative or absurd.
    #[error(
        "{found} is not a frame time: it must be between 0.0001 and 1 seconds; correct the \"Frame Time:\" line (30 fps = 0.033333)"
    )]
    FrameTime {
        /// The value found.
        found: f64,
    },
    /// A frame has another number of values than there are channels.
    #[error(
        "frame {frame} has {found} values for {expected} channels; the file is damaged there, cut or export it again"
    )]
    Row {
        /// Frame, from 0.
        frame: usize,
        /// Channels.
        expected: usize,
        /// Values.
        found: usize,
    },
    /// There are fewer frames than announced.
    #[error(
        "{announced} frames announced but only {found} present; the file is truncated, or correct its \"Frames:\" line"
    )]
    MissingFrames {
        /// Number announced.
        announced: usize,
        /// Number present.
        found: usize,
    },
    /// Something follows the last frame.
    #[error("more data follows the {announced} announced frames; correct the \"Frames:\" line")]
    ExtraFrames {
        /// Number announced.
        announced: usize,
    },
    /// Joints are called something no table knows and whose meaning cannot be guessed.
    #[error(
        "no built-in joint mapping fits, and the names do not say which joints are {unclear}; the closest table, {closest}, finds no \
         {missing}. The file has: {present}. Give a mapping with --mapping FILE.json (see `motionette import bvh --help`)"
    )]
    NoMapping {
        /// Parts of the body that no name tells.
        unclear: Box<str>,
        /// Name of the closest table.
        closest: Box<str>,
        /// Joints of the file it looks for in vain.
        missing: String,
        /// Joints of the file.
        present: String,
    },
    /// The mapping names joints the file does not have.
    #[error("mapping {mapping} needs joints the file does not have: {missing}. The file has: {present}")]
    Unmapped {
        /// Name of the mapping.
        mapping: String,
        /// Joints looked for in vain.
        missing: String,
        /// Joints of the file.
        present: String,
    },
    /// The file has two joints of a name that the mapping uses.
    #[error("the file has more than one joint {name:?}, so the mapping is ambiguous; rename one")]
    Ambiguous {
        /// The name.
        name: String,
    },
    /// Nothing is left after dropping the rest pose.
    #[error("no frame is left after dropping the first {dropped} (rest pose)")]
    NothingLeft {
        /// Frames dropped.
        dropped: usize,
    },
    /// The body has no size.
    #[error(
        "frame {frame}: {bones} of the 21 bones have no length, so there is no body to see; check the mapping, and that the file was \
         exported with its bone lengths (OFFSET) or with positions for every joint"
    )]
    Collapsed {
        /// Frame at 20 frames a second, from 0.
        frame: usize,
        /// Bones without length.
        bones: usize,
    },
    /// The body is of a size that no body has in this unit.
    #[error("in {unit} the body would be {metres:.3} m tall; {advice}")]
    Height {
        /// The unit.
        unit: super::Unit,
        /// The height in it, metres.
        metres: f64,
        /// What to do.
        advice: String,
    },
    /// A joint moves faster than anything does.
    #[error(
        "frame {frame} ({seconds:.2} s): {joint} is {metres:.0} m from where it was 0.05 s before; repair or cut the recording there"
    )]
    Jump {
        /// Frame at 20 frames a second, from 0.
        frame: usize,
        /// Its time.
        seconds: f64,
        /// SMPL joint.
        joint: &'static str,
        /// Distance, metres.
        metres: f64,
    },
    /// The body is too far from the origin for single precision.
    #[error(
        "frame {frame}: {joint} is {metres:.0} m from the origin, more than {limit} m; move the recording to the origin"
    )]
    TooFar {
        /// Frame at 20 frames a second, from 0.
        frame: usize,
        /// SMPL joint.
        joint: &'static str,
        /// Distance, metres.
        metres: f64,
        /// Largest distance taken.
        limit: f64,
    },
}
