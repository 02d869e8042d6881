//! Prompts that nobody trained on: does the motion show what was asked for? (`motionette-train evaluate --prompts FILE.jsonl`)
//!
//! Every prompt names the canonical actions and styles that a fair person accepts. The int8 runtime makes motions of it; two judges that
//! share nothing look at each: the evaluator, for the actions that it names right on real test clips in nine cases of ten, and the
//! detectors ([`motionette_host::detect`]), for the actions that a deed answers for. Styles are judged by the evaluator alone.
//!
//! | module | what it does |
//! |---|---|
//! | [`mod@file`] | the prompts, from JSON lines |
//! | [`order`] | which of two actions comes first |
//! | [`unseen`] | prompts that share no content word with captions or phrases of their actions |
//! | [`trust`] | which actions the evaluator may judge |
//! | [`verdict`] | what became of a prompt, what each judge says |
//! | [`report`] | shares with intervals, the prompts that failed, JSON |
//! | [`command`] | the command |

pub mod command;
pub mod file;
pub mod order;
pub mod report;
#[cfg(test)]
mod tests;
pub mod trust;
pub mod unseen;
pub mod verdict;
