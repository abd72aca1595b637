use dataset::OutOfRange;

/// Largest number of bootstrap resamples. A larger number is a typing error and would take hours.
const MAX_RESAMPLES: u32 = 100_000;

/// The keys of the section `[evaluate]` that only `evaluate` uses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Options {
    /// Bootstrap resamples for the confidence intervals; 0 gives no intervals.
    pub resamples: u32,
}

impl Default for Options {
    fn default() -> Self {
        Self { resamples: 1000 }
    }
}

impl Options {
    /// Checks that every value is in range.
    pub fn check(&self) -> Result<(), OutOfRange> {
        if MAX_RESAMPLES < self.resamples {
            let expected = format!("0 to {MAX_RESAMPLES}");
            return Err(OutOfRange::new("evaluate.resamples", self.resamples, expected));
        }
        Ok(())
    }
}
