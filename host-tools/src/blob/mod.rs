//! The model blob on the host: its bytes where the runtime can read them, its table walked, its layers as integers.
//!
//! | file | what |
//! |---|---|
//! | [`aligned`] | bytes on the boundary that the runtime asks for |
//! | [`mod@file`] | a blob that the runtime accepts: model, table, layers, weights put back into a checkpoint |
//! | [`layer`] | a layer in integers |
//! | [`mod@write`] | header, manifest, table and weight section |
//!
//! What of a checkpoint goes into a blob, and how it is rounded, is [`crate::convert`]'s matter; nothing here knows it.

pub mod aligned;
pub mod file;
pub mod layer;
pub mod write;

pub use aligned::AlignedBlob;
pub use file::{BlobFile, Error, Parts, TableEntry};
pub use layer::QuantisedConv1d;
