//! Why obstacles are refused, on the wire.

use motionette::ObstacleError;

use super::fault::fault;

fault! {
    /// [`motionette::ObstacleError`] on the wire: why obstacles were refused. Indices count in the request's list, from 0.
    ObstacleFault of ObstacleError {
        /// More obstacles than a request may have.
        TooMany {
            /// Obstacles given.
            obstacles: u32,
            /// Most obstacles allowed.
            limit: u32,
        },
        /// A size that is not above 0 and at most 100 m, or a plane without a direction.
        Size {
            /// Obstacle at fault.
            index: u32,
        },
        /// A margin that is not between 0 and 1 m.
        Margin {
            /// Obstacle at fault.
            index: u32,
            /// Its margin, metres.
            margin: f32,
        },
        /// A place or velocity that is not finite or too large.
        Place {
            /// Obstacle at fault.
            index: u32,
        },
        /// It moves too fast.
        TooFast {
            /// Obstacle at fault.
            index: u32,
            /// Its speed, metres a second.
            speed: f32,
            /// Most of it.
            limit: f32,
        },
        /// No keyframes, or one that does not come after the one before it.
        Keyframes {
            /// Obstacle at fault.
            index: u32,
            /// The keyframe.
            keyframe: u32,
        },
        /// No joint keeps clear of it, or one that there is not.
        Joints {
            /// Obstacle at fault.
            index: u32,
        },
        /// An anchor lies inside it.
        AnchorInside {
            /// Obstacle at fault.
            index: u32,
            /// The anchor.
            anchor: u32,
        },
        /// A track passes through it.
        TrackInside {
            /// Obstacle at fault.
            index: u32,
            /// The track.
            track: u32,
            /// The first frame at which it is inside.
            frame: u32,
        },
    }
}
