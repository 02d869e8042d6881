//! Why tracks are refused, on the wire.

use motionette::TrackError;

use super::fault::fault;

fault! {
    /// [`motionette::TrackError`] on the wire: why tracks were refused. Indices count in the request's list, from 0.
    TrackFault of TrackError {
        /// More tracks than a request may carry.
        TooMany {
            /// Tracks given.
            tracks: u32,
            /// Most tracks allowed.
            limit: u32,
        },
        /// Nothing of it counts: no positions, a mask without any, or no axis.
        Nothing {
            /// Track at fault.
            index: u32,
        },
        /// The mask has another length than the positions.
        Mask {
            /// Track at fault.
            index: u32,
            /// Length of its mask.
            found: u32,
            /// Its positions.
            positions: u32,
        },
        /// There is no such joint.
        JointOutOfRange {
            /// Track at fault.
            index: u32,
            /// Its joint.
            joint: u8,
            /// Joints of the skeleton.
            joints: u32,
        },
        /// A position lies behind the end of the motion.
        FrameOutOfRange {
            /// Track at fault.
            index: u32,
            /// Frame of its last position.
            frame: u32,
            /// Frames of the motion.
            frames: u32,
        },
        /// A coordinate is not finite or too large.
        Position {
            /// Track at fault.
            index: u32,
            /// Frame of the position.
            frame: u32,
            /// Largest magnitude allowed, metres.
            limit: f32,
        },
        /// A tolerance that is negative, not a number or more than a metre.
        Tolerance {
            /// Track at fault.
            index: u32,
            /// Its tolerance, metres.
            tolerance: f32,
        },
        /// Two tracks want one joint in two places at one frame.
        Conflict {
            /// The earlier track of the two.
            first: u32,
            /// The later one.
            second: u32,
            /// The first frame at which they do.
            frame: u32,
        },
        /// A track and an anchor want one joint in two places at one frame.
        AnchorConflict {
            /// The track.
            track: u32,
            /// The anchor.
            anchor: u32,
            /// Their frame.
            frame: u32,
        },
        /// The request's refinement leaves the edit out that meets tracks and obstacles.
        NotExact,
    }
}
