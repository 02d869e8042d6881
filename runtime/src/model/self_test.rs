//! Checks of the section `self_test`.

use crate::blob::{Codec, Error, Generator, SELF_TEST_NUMBERS, SelfTest};

/// A self-test decodes tokens that the model can decode; without a hash there is none.
pub(super) fn check(test: &SelfTest, codec: &Codec, generator: &Generator) -> Result<(), Error> {
    if test.hash == 0 {
        return Ok(());
    }
    let most = SELF_TEST_NUMBERS / usize::from(codec.decoder().quantizers).max(1);
    let limit = (most as u32).min(u32::from(generator.max_tokens()));
    super::value::at_most("self_test.tokens", u32::from(test.tokens), limit)
}
