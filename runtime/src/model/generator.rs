//! Checks of the section `generator`.

use super::MAX_TOKENS;
use super::value::{MAX_WIDTH, all_at_most, at_most, transformer, within};
use crate::blob::{Codec, Corruption, Error, Generator, TextConfig, TextEncoding};
#[cfg(any(feature = "masked", feature = "autoregressive"))]
use crate::blob::{HeadConfig, PrefixConfig};
#[cfg(any(feature = "masked", feature = "autoregressive"))]
use crate::generation::tokens::request::MAX_GUIDANCE;
use crate::request::conditions::FAMILIES;

/// Checks the generator of tokens for `codec`, in a blob that knows text or not.
pub(super) fn check(generator: &Generator, codec: &Codec, text: Option<&TextConfig<'_>>) -> Result<(), Error> {
    at_most("generator.max_tokens", u32::from(generator.max_tokens()), u32::from(MAX_TOKENS))?;
    if matches!(generator, Generator::Given { .. }) {
        return Ok(());
    }
    if text.is_none() {
        return Err(Error::Config { what: "generator without text", found: 1, limit: 0 });
    }
    at_most("generator.max_tokens with a planner", u32::from(generator.max_tokens()), u32::from(MAX_TOKENS) - 1)?;
    #[cfg(any(feature = "masked", feature = "autoregressive"))]
    if let Some(prefix) = generator.prefix() {
        return check_prefix(prefix, codec, text);
    }
    let Generator::Words(planner) = generator else { return Ok(()) };
    if text.is_some_and(|text| text.encoder == TextEncoding::Vectors) {
        return Err(Error::Config { what: "text.encoder of a planner that reads words", found: 2, limit: 1 });
    }
    transformer(&planner.transformer)?;
    at_most("codec.quantizers with a planner", u32::from(codec.decoder().quantizers), 1)?;
    if let Corruption::Near { c, a } = planner.corruption {
        within("generator.c", c, 1e-6, 1e3)?;
        within("generator.a", a, 1e-6, 4.0)?;
    }
    let Some(control) = &planner.control else { return Ok(()) };
    transformer(&control.scaffold)?;
    all_at_most(&[
        ("generator.control.frame_width", u32::from(control.frame_width), MAX_WIDTH),
        ("generator.control.rank", u32::from(control.rank), MAX_WIDTH),
        ("generator.control.families", u32::from(control.families), u32::from(FAMILIES)),
    ])
}

/// Checks a planner that is given a vector.
#[cfg(any(feature = "masked", feature = "autoregressive"))]
fn check_prefix(planner: &PrefixConfig, codec: &Codec, text: Option<&TextConfig<'_>>) -> Result<(), Error> {
    if !text.is_some_and(|text| text.encoder == TextEncoding::Vectors) {
        return Err(Error::Config { what: "text.encoder of a planner that is given vectors", found: 1, limit: 2 });
    }
    transformer(&planner.transformer)?;
    if let HeadConfig::Dense { epsilon } = planner.head {
        within("generator.head.epsilon", epsilon, 1e-12, 1.0)?;
    }
    within("generator.guidance", planner.guidance, 0.0, MAX_GUIDANCE)?;
    let Some(residual) = &planner.residual else { return Ok(()) };
    if codec.decoder().quantizers < 2 {
        return Err(Error::Config { what: "codec.quantizers with a residual planner", found: 1, limit: 2 });
    }
    transformer(&residual.transformer)?;
    within("generator.residual.epsilon", residual.epsilon, 1e-12, 1.0)?;
    within("generator.residual.guidance", residual.guidance, 0.0, MAX_GUIDANCE)
}
