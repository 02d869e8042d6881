//! The standard request of the budgets: 49 tokens from text with guidance, two root anchors and two wrists, default refinement.
//!
//! The bare-metal image includes this very file, so it uses nothing but the runtime.

use motionette::{Anchors, Joint, Request};

/// Its text.
pub const PROMPT: &str = "a person walks forward and waves the right hand";
/// Its frames.
pub const FRAMES: u16 = 196;

/// Its anchors.
#[must_use]
pub fn anchors() -> Anchors {
    Anchors::new()
        .root_at(4.0, [0.2, 0.9, 2.0])
        .root_at(9.7, [0.4, 0.9, 5.0])
        .joint_at(6.0, Joint::RightWrist, [0.0, 1.5, 3.2])
        .joint_at(8.0, Joint::LeftWrist, [0.5, 1.0, 4.2])
}

/// The request, without its anchors.
#[must_use]
pub fn request() -> Request<'static> {
    Request::text(PROMPT).frames(FRAMES).seed(1)
}
