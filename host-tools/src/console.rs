//! What a program of this project says: results on standard output, progress and complaints on standard error.

use std::io::{self, ErrorKind, Write};
use std::process::ExitCode;
use std::sync::{Mutex, PoisonError};

use motionette::refining::Strain;
use motionette::text::words::UNKNOWN;
use motionette::{Model, Motion, Words};

/// Standard output took not everything.
#[derive(Debug, thiserror::Error)]
#[error("cannot write to standard output: what was said is not complete")]
pub struct Lost(#[source] io::Error);

/// The first failure.
static FAILED: Mutex<Option<io::Error>> = Mutex::new(None);

/// A line on standard output. That it could not be written says [`finish`].
pub fn say(line: &str) {
    note(writeln!(io::stdout(), "{line}"));
}

/// Says whether everything that was to be said has been said. To be asked once, at the end.
///
/// # Errors
/// [`Lost`], with the system's first reason. A reader that has gone (`| head`) wanted no more: that is no failure.
pub fn finish() -> Result<(), Lost> {
    note(io::stdout().flush());
    FAILED.lock().unwrap_or_else(PoisonError::into_inner).take().map_or(Ok(()), |error| Err(Lost(error)))
}

fn note(result: io::Result<()>) {
    if let Err(error) = result
        && error.kind() != ErrorKind::BrokenPipe
    {
        FAILED.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(error);
    }
}

/// How much anchors ask of a motion, with a warning where that is too much; `around` is where most of it is.
pub fn strained(value: f32, around: &str) -> String {
    let warning = match value > Strain::WARNING {
        true => "; warning: bent so far, the motion may no longer do what the prompt says",
        false => "",
    };
    format!("{value:.2}, most of it around {around}{warning}")
}

/// What a motion's prompt was understood as, its clauses in the order in which they are done; `None` where nothing was to be understood.
pub fn understood(model: &Model<'_>, motion: &Motion<'_>) -> Option<String> {
    let clauses = motion.understood().into_iter().chain(motion.then());
    let clauses: Vec<String> = clauses.map(|clause| model.in_words(clause).to_string()).collect();
    (!clauses.is_empty()).then(|| clauses.join(", then "))
}

/// The words of a text that a model does not know; none of one that reads no words.
pub fn unknown_words(model: &Model<'_>, text: &str) -> Vec<String> {
    let Some(encoder) = model.text().and_then(|text| text.encoder()) else { return Vec::new() };
    let unknown = Words::new(text).filter(|word| encoder.vocabulary().id(word) == UNKNOWN);
    unknown.map(|word| word.as_str().to_owned()).collect()
}

/// A line on standard error: what is under way. A run does not end because nobody can read it.
pub fn remark(line: &str) {
    let _ = writeln!(io::stderr(), "{line}");
}

/// Ends a program: [`finish`]es, [`complain`]s when that or the program's own work failed, and gives the status to exit with.
#[must_use]
pub fn conclude(result: anyhow::Result<()>) -> ExitCode {
    match result.and_then(|()| Ok(finish()?)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            complain(&error, None);
            ExitCode::FAILURE
        }
    }
}

/// Prints an error, what caused it, and what to do, on standard error.
pub fn complain(error: &anyhow::Error, hint: Option<&str>) {
    // There is nowhere left to say that standard error fails.
    let mut stderr = io::stderr();
    let _ = writeln!(stderr, "error: {error}");
    for cause in causes(error) {
        let _ = writeln!(stderr, "  because: {cause}");
    }
    if let Some(hint) = hint {
        let _ = writeln!(stderr, "  hint: {hint}");
    }
}

/// What caused an error, from the nearest cause on. Errors of the runtime carry their cause in their own text, since firmware logs nothing
/// else: a cause that stands in a message before it is left out.
#[must_use]
pub fn causes(error: &anyhow::Error) -> Vec<String> {
    let mut said = vec![error.to_string()];
    for cause in error.chain().skip(1).map(ToString::to_string) {
        if !said.iter().any(|before| before.contains(&cause)) {
            said.push(cause);
        }
    }
    said.split_off(1)
}

#[cfg(test)]
mod tests {
    use super::*;
    use anyhow::{Context, anyhow};

    #[derive(Debug, thiserror::Error)]
    #[error("blob x: {0}")]
    struct Quoting(#[source] io::Error);

    #[test]
    fn a_cause_is_said_once() {
        let error = anyhow::Error::new(Quoting(io::Error::other("no such file"))).context("reading").context("inspect");
        assert_eq!(causes(&error), ["reading", "blob x: no such file"]);
        assert_eq!(causes(&anyhow!("alone")), [""; 0]);
        let plain: anyhow::Result<()> = Err(io::Error::other("disk gone")).context("writing");
        assert_eq!(causes(&plain.expect_err("an error")), ["disk gone"]);
    }
}
