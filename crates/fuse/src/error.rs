use dataset::{Losses, OutOfRange};

/// The reason why a drive could not be fused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FuseError {
    /// An option is out of range.
    #[error(transparent)]
    Option(#[from] OutOfRange),
    /// There are fewer than two usable wheel samples.
    #[error(
        "found {found} usable wheel samples{}, expected 2 or more; check the wheel topic and check that its stamps increase",
        in_parentheses(.losses)
    )]
    TooFewWheelSamples {
        /// Number of usable wheel samples.
        found: usize,
        /// The samples that could not be used.
        losses: Losses,
    },
}

fn in_parentheses(losses: &Losses) -> String {
    match losses.is_empty() {
        true => String::new(),
        false => format!(" ({losses})"),
    }
}
