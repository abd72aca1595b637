use std::fmt;

/// An option has a value out of its range.
///
/// ```
/// use dataset::OutOfRange;
///
/// let error = OutOfRange::new("subsample.spacing_m", 0.0, "more than 0");
/// assert_eq!(error.to_string(), "`subsample.spacing_m` is 0, expected more than 0");
/// ```
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{key}` is {found}, expected {expected}")]
pub struct OutOfRange {
    /// The option, with its section.
    pub key: String,
    /// Its value.
    pub found: String,
    /// What it must be.
    pub expected: String,
}

impl OutOfRange {
    /// An option, its value, and what it must be.
    pub fn new(
        key: impl Into<String>,
        found: impl fmt::Display,
        expected: impl Into<String>,
    ) -> Self {
        Self { key: key.into(), found: found.to_string(), expected: expected.into() }
    }
}
