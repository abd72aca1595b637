//! `evaluate`: scored pairs -> tables, figures, report.
//!
//! Invariant: this crate sees scores, never models.

mod bootstrap;
mod figures;
mod metrics;
mod report;
mod retrieval;
mod tables;

use dataset::{BoostingRound, Dropped, GridCell, Keyframe, Label, Pair, Retrieval, Scores};

pub use bootstrap::{Estimate, MIN_GROUPS, Summary};
pub use metrics::{
    Confusion, Measures, OperatingPoint, PrPoint, operating_points, precision_recall,
};
pub use report::{Fact, report};
pub use retrieval::{Ranked, rank};
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
    /// What each round chose.
    pub rounds: &'a [BoostingRound],
    /// How well all pairs are ranked at their natural prevalence; empty where not asked for.
    pub retrieval: &'a [Retrieval],
    /// Errors under other label rules; empty where not asked for.
    pub grid: &'a [GridCell],
    /// Bootstrap resamples for confidence intervals.
    pub resamples: u32,
    /// The run's seed.
    pub seed: u64,
    /// What all stages left out.
    pub dropped: &'a Dropped,
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
