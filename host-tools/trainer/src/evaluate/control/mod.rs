//! The tables of anchor control: what generator and solver make of anchors that real motion passed.
//!
//! | module | what it does |
//! |---|---|
//! | [`problem`] | anchors of a clip: family, number, seed |
//! | [`mod@bench`] | motions of one way to make them, judged; groups of them are kept on disk |
//! | [`tables`] | which ways and problems make which table |
//! | [`page`] | Markdown, SVG, JSON |

pub mod bench;
pub mod page;
pub mod problem;
pub mod tables;
