//! Settings that are out of range.

/// A setting has a value that it cannot have.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{field} is {value}; allowed: {allowed}")]
pub struct OutOfRange {
    /// Name of the setting.
    pub field: &'static str,
    /// Its value.
    pub value: String,
    /// What it may be.
    pub allowed: &'static str,
}

/// Checks that `holds`, which says that setting `field` may have this `value`.
///
/// # Errors
/// [`OutOfRange`] otherwise.
pub fn require(
    holds: bool,
    field: &'static str,
    value: impl ToString,
    allowed: &'static str,
) -> Result<(), OutOfRange> {
    if holds { Ok(()) } else { Err(OutOfRange { field, value: value.to_string(), allowed }) }
}
