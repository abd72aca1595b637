use std::collections::BTreeMap;
use std::fmt;

use serde::{Deserialize, Serialize};

/// What a stage had to leave out, counted by reason.
///
/// Anything here means that some input did not reach the output; the program then exits with 3.
#[derive(Debug, Clone, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Dropped(BTreeMap<String, u64>);

impl Dropped {
    /// Counts `n` more for a reason; the reason starts with the thing counted, in the plural
    /// ("scans before the first pose").
    pub fn add(&mut self, reason: impl Into<String>, n: u64) {
        if n > 0 {
            *self.0.entry(reason.into()).or_default() += n;
        }
    }

    /// Adds all counts of another.
    pub fn merge(&mut self, other: Self) {
        for (reason, n) in other.0 {
            self.add(reason, n);
        }
    }

    /// Whether nothing was left out.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Reasons and counts, by reason.
    pub fn iter(&self) -> impl Iterator<Item = (&str, u64)> {
        self.0.iter().map(|(reason, &n)| (reason.as_str(), n))
    }
}

impl fmt::Display for Dropped {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (k, (reason, n)) in self.iter().enumerate() {
            let separator = if k == 0 { "" } else { ", " };
            write!(f, "{separator}{n} {reason}")?;
        }
        Ok(())
    }
}
