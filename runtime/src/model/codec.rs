//! Checks of the section `codec`.

use super::value::all_at_most;
use crate::blob::{Codec, DecoderConfig, Error, MAX_BLOCKS, MAX_CONVOLUTIONS, MAX_STAGES, Representation};
use crate::codec::codebook::MAX_QUANTIZERS;
use crate::representation::humanml3d;

/// Checks the codec, which is to make frames of `representation`.
pub(super) fn check(codec: &Codec, representation: &Representation<'_>) -> Result<(), Error> {
    let Codec::Vq(decoder) = codec;
    all_at_most(&[
        ("codec.width", u32::from(decoder.width), 2048),
        ("codec.code_width", u32::from(decoder.code_width), 2048),
        ("codec.codes", u32::from(decoder.codes), u32::from(u16::MAX) - 1),
        ("codec.quantizers", u32::from(decoder.quantizers), MAX_QUANTIZERS as u32),
        ("codec.stages", u32::from(decoder.stages), MAX_STAGES as u32),
        ("codec.dilations", decoder.dilations.len() as u32, MAX_BLOCKS as u32),
    ])?;
    if let Some(&found) = decoder.dilations.iter().find(|&&d| d == 0) {
        return Err(Error::Config { what: "codec.dilations", found: u32::from(found), limit: 255 });
    }
    padding(decoder)?;
    let features = match representation {
        Representation::HumanMl3d(_) => humanml3d::FEATURES as u32,
    };
    let found = u32::from(decoder.features);
    if found == features { Ok(()) } else { Err(Error::Config { what: "codec.features", found, limit: features }) }
}

/// Every convolution keeps the number of rows, and looks no farther ahead than back.
fn padding(decoder: &DecoderConfig) -> Result<(), Error> {
    let (found, limit) = (decoder.padding.len(), decoder.convolutions().take(MAX_CONVOLUTIONS + 1).count());
    if found != limit {
        return Err(Error::Config { what: "entries of codec.padding", found: found as u32, limit: limit as u32 });
    }
    for (padding, dilation) in decoder.padding.iter().zip(decoder.convolutions()) {
        let (found, limit) = (u32::from(padding.left) + u32::from(padding.right), 2 * u32::from(dilation));
        if found != limit {
            return Err(Error::Config { what: "codec.padding, left and right together", found, limit });
        }
        if padding.right > padding.left {
            let (found, limit) = (u32::from(padding.right), u32::from(padding.left));
            return Err(Error::Config { what: "codec.padding on the right, beside the left", found, limit });
        }
    }
    Ok(())
}
