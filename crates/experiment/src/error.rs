use std::fmt;

use dataset::{Note, NoteKind};
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
    #[error("cannot evaluate grouping `{}`", grouping.name())]
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

impl NotEvaluated {
    /// The reason as a warning.
    pub fn note(&self) -> Note {
        let grouping = self.grouping.name().to_owned();
        let kind = match &self.error {
            ExperimentError::Label(LabelError::TooFewGroups { groups, found, .. }) => {
                let (groups, n_found) = ((*groups).to_owned(), *found as u64);
                NoteKind::TooFewGroups { grouping, groups, n_found }
            }
            ExperimentError::Label(LabelError::TwoGroups { groups, n_between, .. }) => {
                let (groups, n_pairs) = ((*groups).to_owned(), *n_between as u64);
                NoteKind::TwoGroups { grouping, groups, n_pairs }
            }
            ExperimentError::Label(LabelError::TooFewForFolds { folds, class, found }) => {
                let (n_folds, n_found) = (u64::from(*folds), *found as u64);
                let class = (*class).to_owned();
                NoteKind::TooFewPairsForFolds { grouping, n_folds, class, n_found }
            }
            ExperimentError::Fold {
                source: FoldError::OneClass { n_positive, n_negative, .. },
                ..
            } => NoteKind::OneClassLeft {
                grouping,
                n_positive: *n_positive as u64,
                n_negative: *n_negative as u64,
            },
            _ => NoteKind::GroupingNotTrainable { grouping },
        };
        kind.into()
    }
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
