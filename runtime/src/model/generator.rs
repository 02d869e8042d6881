//! Checks of the section `generator`.

use super::MAX_TOKENS;
use super::value::{MAX_WIDTH, all_at_most, at_most, transformer, within};
use crate::blob::{Codec, Error, Generator};
use crate::request::conditions::FAMILIES;

/// Checks the generator of tokens for `codec`, in a blob that knows text or not.
pub(super) fn check(generator: &Generator, codec: &Codec, text: bool) -> Result<(), Error> {
    at_most("generator.max_tokens", u32::from(generator.max_tokens()), u32::from(MAX_TOKENS))?;
    let Generator::Tmd(planner) = generator else { return Ok(()) };
    if !text {
        return Err(Error::Config { what: "generator without text", found: 1, limit: 0 });
    }
    transformer(&planner.transformer)?;
    at_most("codec.quantizers with a planner", u32::from(codec.decoder().quantizers), 1)?;
    at_most("generator.max_tokens with a planner", u32::from(planner.max_tokens), u32::from(MAX_TOKENS) - 1)?;
    within("generator.c", planner.c, 1e-6, 1e3)?;
    within("generator.a", planner.a, 1e-6, 4.0)?;
    let Some(control) = &planner.control else { return Ok(()) };
    transformer(&control.scaffold)?;
    all_at_most(&[
        ("generator.control.frame_width", u32::from(control.frame_width), MAX_WIDTH),
        ("generator.control.rank", u32::from(control.rank), MAX_WIDTH),
        ("generator.control.families", u32::from(control.families), u32::from(FAMILIES)),
    ])
}
