//! `evaluate`: scored pairs -> tables, figures, report.
//!
//! Invariant: this crate sees scores, never models.

mod bootstrap;
mod drawn;
mod figures;
mod json;
mod metrics;
mod report;
mod retrieval;
mod sketches;
mod tables;

use dataset::tables::FeatureTable;
use dataset::{BoostingRound, Dropped, GridCell, Keyframe, Label, Pair, Retrieval, Scores};

pub use bootstrap::{Estimate, MIN_GROUPS, Summary};
pub use drawn::figures;
pub use figures::{Figure, path_svg, write_figures};
pub use json::json;
pub use metrics::{
    Confusion, Measures, OperatingPoint, PrPoint, operating_points, precision_recall,
};
pub use report::{Fact, report};
pub use retrieval::{Ranked, rank};
pub use sketches::Sketches;
pub use tables::write_tables;

/// Rounds at which precision-recall is drawn (the paper's Figure 5).
pub const PRECISION_RECALL_ROUNDS: usize = 10;

/// What the pipeline hands over.
#[derive(Debug, Clone, Copy)]
pub struct Input<'a> {
    /// The keyframes.
    pub keyframes: &'a [Keyframe],
    /// The labelled pairs.
    pub pairs: &'a [Pair],
    /// Their scores, `(n_learners x n_groupings,)`.
    pub scores: &'a [Scores],
    /// Groupings that were asked for and could not be evaluated, and why.
    pub left_out: &'a [String],
    /// What each round chose.
    pub rounds: &'a [BoostingRound],
    /// How well all pairs are ranked at their natural prevalence; empty where not asked for.
    pub retrieval: &'a [Retrieval],
    /// Errors under other label rules; empty where not asked for.
    pub grid: &'a [GridCell],
    /// The features of the keyframes, a row each.
    pub features: &'a FeatureTable,
    /// What is known of each feature; may be empty.
    pub feature_rows: &'a [FeatureRow],
    /// Bootstrap resamples for confidence intervals.
    pub resamples: u32,
    /// The run's seed.
    pub seed: u64,
    /// What all stages left out.
    pub dropped: &'a Dropped,
}

/// What is known of one feature.
#[derive(Debug, Clone, PartialEq)]
pub struct FeatureRow {
    /// Its name.
    pub name: String,
    /// Area under the ROC curve of the feature alone: 0.5 tells nothing, 1 all.
    pub auc: f64,
    /// How far it moves when a scan is thinned to every other return: the median, as a share of the
    /// feature's interquartile range over the scans.
    pub stability: f64,
    /// Splits that look at it, of all learners' rounds fitted on all pairs.
    pub chosen: usize,
}

impl Input<'_> {
    /// Whether a learner boosts; one without rounds is a baseline.
    pub(crate) fn is_boosted(&self, learner: &str) -> bool {
        self.rounds.iter().any(|round| round.learner == learner)
    }

    /// How well all pairs are ranked, of all logs together.
    pub(crate) fn retrieval_of_all(&self) -> impl Iterator<Item = &Retrieval> {
        let has_all = self.retrieval.iter().any(|r| r.log.is_none());
        // Of one log alone, that log is all.
        self.retrieval.iter().filter(move |r| r.log.is_none() || !has_all)
    }
}

/// Errors of one learner under one grouping after so many rounds.
#[derive(Debug, Clone, PartialEq)]
pub struct ErrorRow {
    /// The learner's name.
    pub learner: String,
    /// What was kept together on one side of a fold.
    pub grouping: String,
    /// Boosting rounds T.
    pub rounds: usize,
    /// What was called what, all folds together, at threshold 0.
    pub confusion: Confusion,
}

/// The precision-recall curve of one learner under one grouping.
#[derive(Debug, Clone, PartialEq)]
pub struct PrCurve {
    /// The learner's name.
    pub learner: String,
    /// What was kept together on one side of a fold.
    pub grouping: String,
    /// Boosting rounds T.
    pub rounds: usize,
    /// Points of falling threshold.
    pub points: Vec<PrPoint>,
}

/// A pair that got the wrong label at the last round.
#[derive(Debug, Clone, PartialEq)]
pub struct Mistake {
    /// The learner's name.
    pub learner: String,
    /// What was kept together on one side of a fold.
    pub grouping: String,
    /// Index of the pair.
    pub pair: usize,
    /// Its confidence.
    pub confidence: f64,
}

/// All that is measured.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Evaluation {
    /// For each learner and grouping, after the last round.
    pub summaries: Vec<Summary>,
    /// For each learner, grouping and T = 1, 2, ...
    pub errors: Vec<ErrorRow>,
    /// For each learner and grouping, at T = 10 (or the last round, if that is less).
    pub precision_recall: Vec<PrCurve>,
    /// For each learner and grouping, worst first.
    pub mistakes: Vec<Mistake>,
}

impl Evaluation {
    /// The groupings, in the order asked for.
    pub(crate) fn groupings(&self) -> Vec<&str> {
        report::distinct(self.summaries.iter().map(|s| &*s.grouping))
    }

    /// The grouping that the report speaks of first: `place` where it was asked for, else the one
    /// that keeps most apart.
    pub(crate) fn first_grouping(&self) -> Option<&str> {
        let groupings = self.groupings();
        ["place", "log", "scan", "pair"].into_iter().find(|g| groupings.contains(g))
    }

    /// The learner of the least error under the first grouping, of the boosted ones or of the
    /// baselines.
    fn least_error(&self, input: &Input<'_>, boosted: bool) -> Option<&Summary> {
        let first = self.first_grouping()?;
        self.summaries
            .iter()
            .filter(|s| s.grouping == first && input.is_boosted(&s.learner) == boosted)
            .min_by(|a, b| a.error.value.total_cmp(&b.error.value))
    }

    pub(crate) fn best_boosted(&self, input: &Input<'_>) -> Option<&Summary> {
        self.least_error(input, true)
    }

    pub(crate) fn best_baseline(&self, input: &Input<'_>) -> Option<&Summary> {
        self.least_error(input, false)
    }
}

/// Measures.
pub fn evaluate(input: &Input<'_>) -> Evaluation {
    let labels: Vec<Label> = input.pairs.iter().map(|pair| pair.label).collect();
    let mut evaluation = Evaluation {
        summaries: bootstrap::summaries(&labels, input.scores, input.resamples, input.seed),
        ..Evaluation::default()
    };
    for scores in input.scores {
        let (learner, grouping) = (&scores.learner, &scores.grouping);
        for rounds in 1..=scores.n_rounds {
            evaluation.errors.push(ErrorRow {
                learner: learner.clone(),
                grouping: grouping.clone(),
                rounds,
                confusion: Confusion::count(&labels, scores.after(rounds), 0.0),
            });
        }
        let rounds = PRECISION_RECALL_ROUNDS.min(scores.n_rounds);
        let confidences: Vec<f64> = scores.after(rounds).collect();
        evaluation.precision_recall.push(PrCurve {
            learner: learner.clone(),
            grouping: grouping.clone(),
            rounds,
            points: precision_recall(&labels, &confidences),
        });
        let mut wrong: Vec<Mistake> = scores
            .after(scores.n_rounds)
            .enumerate()
            .filter(|(pair, confidence)| Label::from_confidence(*confidence, 0.0) != labels[*pair])
            .map(|(pair, confidence)| Mistake {
                learner: learner.clone(),
                grouping: grouping.clone(),
                pair,
                confidence,
            })
            .collect();
        wrong.sort_by(|a, b| {
            b.confidence.abs().total_cmp(&a.confidence.abs()).then(a.pair.cmp(&b.pair))
        });
        evaluation.mistakes.extend(wrong);
    }
    evaluation
}
