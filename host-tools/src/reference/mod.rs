//! The reference: plain loops in f32 or f64 from the unquantised checkpoint.
//!
//! It exists to be right and readable. It shares no numerical code with the runtime; both are held against `published/`, which
//! nobody here wrote, and against each other. All of it is generic over [`Real`], so that the same loops run in f32 (what PyTorch
//! does) and in f64 (the oracle of rounding and of gradients).
//!
//! Layout everywhere: time major, channels last (`[T][C]`), so that inner loops run over neighbours in memory.
//!
//! | file | what |
//! |---|---|
//! | [`conv1d`] | convolution with stride, padding, dilation; its input gradient |
//! | [`resblock`] | `x + conv2(relu(conv1(relu(x))))` and its input gradient |
//! | [`encoder`] | features to latent |
//! | [`quantizer`] | latent to ids and back |
//! | [`decoder`] | latent to features, every stage kept, and its input gradient |
//! | [`recover`] | features to joints and its gradient |
//! | [`decode_path`] | latent to joints: decoder, denormalisation, recovery |
//! | [`anchors`], [`objective`] | control residuals and `J(u)` with its gradient |
//! | [`interval_basis`], [`route_solver`], [`quasi_newton`] | the solver as published, and a quasi-Newton method in its coefficients |
//! | [`rigid`] | a body of rigid bones |
//! | [`motion_space`] | anchors met in the motion itself |
//! | [`clearance`] | how near bones come to obstacles |
//! | [`transformer`] | linears, norms, attention, blocks |
//! | [`text`] | a prompt to words to a memory and a length |
//! | [`planner`] | noisy tokens and a text to logits |
//! | [`scaffold`] | anchors to frame features |
//! | [`control`] | frame features to what the planner sees of anchors |
//! | [`tmd`] | corruption of tokens and sampling from proposals |
//! | [`masked`] | masked tokens, the least certain ones again |
//! | [`sampler`] | which of both a prior has |
//! | [`prior`] | a prior made ready: prompt to tokens |
//! | [`published`] | MoMask's and T2M-GPT's planners |
//! | [`tokenizer`] | a checkpoint made ready: motion to ids, ids to motion |
//! | [`bridge`] | tokens and anchors in the runtime's types and back |

pub mod anchors;
pub mod bridge;
pub mod clearance;
pub mod control;
pub mod conv1d;
pub mod decode_path;
pub mod decoder;
pub mod encoder;
pub mod interval_basis;
pub mod masked;
pub mod motion_space;
pub mod objective;
pub mod planner;
pub mod prior;
pub mod published;
pub mod quantizer;
pub mod quasi_newton;
pub mod reach;
pub mod real;
pub mod recover;
pub mod resblock;
pub mod rigid;
pub mod route_solver;
pub mod sampler;
pub mod scaffold;
pub mod text;
pub mod tmd;
pub mod tokenizer;
pub mod transformer;

pub use anchors::{Anchor, Target};
pub use control::Control;
pub use decode_path::DecodePath;
pub use decoder::{Decoder, Trace};
pub use encoder::Encoder;
pub use prior::Prior;
pub use quantizer::Quantizer;
pub use real::Real;
pub use sampler::Sampler;
pub use tokenizer::Tokenizer;
