use std::fmt;

use label::{Grouping, LabelError};
use train::{FoldError, TrainError};

/// Why an experiment fails.
#[derive(Debug, thiserror::Error)]
pub enum ExperimentError {
    /// A learner cannot be fitted to all pairs.
    #[error("cannot train `{learner}`")]
    Fit {
        /// The learner.
        learner: &'static str,
        /// The cause.
        source: TrainError,
    },
    /// Pairs cannot be drawn or assigned to folds.
    #[error(transparent)]
    Label(#[from] LabelError),
    /// A learner cannot be fitted to the training pairs of a fold.
    #[error("grouping `{}`", grouping.name())]
    Fold {
        /// The grouping.
        grouping: Grouping,
        /// The cause.
        source: FoldError,
    },
    /// None of the groupings can be evaluated.
    #[error("no grouping can be evaluated; {}", reasons(.0))]
    NoGrouping(Vec<NotEvaluated>),
}

/// A grouping that cannot be evaluated.
#[derive(Debug)]
pub struct NotEvaluated {
    /// The grouping.
    pub grouping: Grouping,
    /// Why not.
    pub error: ExperimentError,
}

/// The reason, with its causes.
impl fmt::Display for NotEvaluated {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.error)?;
        let mut cause = std::error::Error::source(&self.error);
        while let Some(error) = cause {
            write!(f, ": {error}")?;
            cause = error.source();
        }
        Ok(())
    }
}

fn reasons(not_evaluated: &[NotEvaluated]) -> String {
    let reasons: Vec<String> = not_evaluated.iter().map(ToString::to_string).collect();
    reasons.join("; ")
}
