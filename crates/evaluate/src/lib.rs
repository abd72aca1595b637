//! Evaluates scored pairs of scans: measures, tables, figures and the HTML report.
//!
//! [`evaluate`] computes the measures. [`write_tables`], [`figures`], [`json`] and [`report`] present
//! them.
//!
//! ```
//! use dataset::Label::{Negative, Positive};
//! use evaluate::{Confusion, operating_points};
//!
//! let labels = [Positive, Positive, Negative, Negative];
//! let confidences = [2.0, -0.5, 0.3, -1.0];
//!
//! // At threshold 0, one positive is missed and one negative is a false alarm.
//! let counts = Confusion::count(&labels, confidences.into_iter(), 0.0);
//! assert_eq!(counts.error(), 0.5);
//! assert_eq!(counts.precision(), Some(0.5));
//!
//! // Without false alarms, half of the positives are detected.
//! let point = &operating_points(&labels, &confidences)[0];
//! assert_eq!(point.name, "recall at 100 % precision");
//! assert_eq!((point.point.threshold, point.point.confusion.recall()), (2.0, 0.5));
//! ```
//!
//! Invariant: this crate uses scores and never models.

mod bootstrap;
pub mod comparison;
pub mod detection;
mod exact;
mod figures;
mod json;
mod metrics;
mod options;
mod report;
mod retrieval;
mod spread;
mod tables;
mod text;

use dataset::tables::FeatureTable;
use dataset::{
    BoostingRound, FeatureUsefulness, GridCell, Keyframe, Label, Losses, Note, Pair, Retrieval,
    Scores,
};

pub use bootstrap::{Estimate, MIN_GROUPS, Summary};
pub use figures::{
    ClosureSketches, Figure, Sketches, closure_figures, figures, path_svg, write_figures,
};
pub use json::{closure_json, json};
pub use metrics::{
    Confusion, Measures, OperatingPoint, PrPoint, operating_points, precision_recall,
};
pub use options::Options;
pub use report::{ClosureReport, Fact, closure_report, comparison_report, report};
pub use retrieval::{Ranked, rank};
pub use spread::Spread;
pub use tables::write_tables;

/// Number of boosting rounds of the precision-recall curves (the paper's Figure 5).
pub const PRECISION_RECALL_ROUNDS: usize = 10;

/// The results of a run that are evaluated.
#[derive(Debug, Clone, Copy)]
pub struct Input<'a> {
    /// The keyframes.
    pub keyframes: &'a [Keyframe],
    /// The labelled pairs.
    pub pairs: &'a [Pair],
    /// What the labels rest on, one sentence per source of poses.
    pub label_basis: &'a [String],
    /// Width of a place for the spread of the pairs \[m\].
    pub place_m: f64,
    /// Height of a place for the spread of the pairs, where keyframes have a height \[m\].
    pub max_height_difference_m: f64,
    /// Margin between training and test ground of the grouping `place` \[m\].
    pub place_margin_m: f64,
    /// The scores of the pairs, `(n_learners * n_groupings,)`.
    pub scores: &'a [Scores],
    /// For each requested grouping that could not be evaluated, the reason.
    pub not_evaluated: &'a [Note],
    /// The feature that each boosting round selected.
    pub rounds: &'a [BoostingRound],
    /// Retrieval at natural prevalence; empty if not requested.
    pub retrieval: &'a [Retrieval],
    /// Errors under other label rules; empty if not requested.
    pub grid: &'a [GridCell],
    /// The features of the keyframes, one row per keyframe.
    pub features: &'a FeatureTable,
    /// The usefulness of each feature; may be empty.
    pub feature_usefulness: &'a [FeatureUsefulness],
    /// Number of bootstrap resamples for confidence intervals.
    pub resamples: u32,
    /// The run's seed.
    pub seed: u64,
    /// What the stages of the run left out.
    pub losses: &'a Losses,
    /// The notes of the stages of the run, without `not_evaluated`.
    pub notes: &'a [Note],
    /// The drives whose loop closures were searched; empty if none were.
    pub detection: &'a [detection::Drive<'a>],
    /// The sites with several drives.
    pub sites: &'a [detection::SiteDrives],
}

impl Input<'_> {
    /// Whether a learner has boosting rounds. A learner without rounds is a baseline.
    pub fn is_boosted(&self, learner: &str) -> bool {
        self.rounds.iter().any(|round| round.learner == learner)
    }

    /// Retrieval over all logs.
    pub(crate) fn retrieval_of_all(&self) -> impl Iterator<Item = &Retrieval> {
        let has_all = self.retrieval.iter().any(|r| r.log.is_none());
        // If there is only one log, there is no row for all logs.
        self.retrieval.iter().filter(move |r| r.log.is_none() || !has_all)
    }
}

/// The errors of one learner under one grouping after `rounds` rounds.
#[derive(Debug, Clone, PartialEq)]
pub struct ErrorRow {
    /// The learner's name.
    pub learner: String,
    /// Unit that is never split between folds: `pair`, `scan`, `place` or `log`.
    pub grouping: String,
    /// Number of boosting rounds T.
    pub rounds: usize,
    /// The counts over all folds at threshold 0.
    pub confusion: Confusion,
}

/// The precision-recall curve of one learner under one grouping.
#[derive(Debug, Clone, PartialEq)]
pub struct PrCurve {
    /// The learner's name.
    pub learner: String,
    /// Unit that is never split between folds: `pair`, `scan`, `place` or `log`.
    pub grouping: String,
    /// Number of boosting rounds T.
    pub rounds: usize,
    /// Points in order of falling threshold.
    pub points: Vec<PrPoint>,
}

/// A pair that is misclassified after the last round.
#[derive(Debug, Clone, PartialEq)]
pub struct Mistake {
    /// The learner's name.
    pub learner: String,
    /// Unit that is never split between folds: `pair`, `scan`, `place` or `log`.
    pub grouping: String,
    /// Index of the pair.
    pub pair: usize,
    /// Confidence of the pair.
    pub confidence: f64,
}

/// All measures.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Evaluation {
    /// How the pairs of each class are spread over the ground.
    pub spreads: Vec<Spread>,
    /// The measures of each learner and grouping after the last round.
    pub summaries: Vec<Summary>,
    /// The errors of each learner and grouping after T = 1, 2, ... rounds.
    pub errors: Vec<ErrorRow>,
    /// The curve of each learner and grouping after [`PRECISION_RECALL_ROUNDS`] rounds, or after the
    /// last round if there are fewer.
    pub precision_recall: Vec<PrCurve>,
    /// The mistakes of each learner and grouping, the most confident first.
    pub mistakes: Vec<Mistake>,
    /// The measures of the loop closures of each drive.
    pub detection: Vec<detection::DriveMeasures>,
    /// The measures of each site with several drives.
    pub sites: Vec<detection::SiteMeasures>,
}

impl Evaluation {
    /// The groupings, in the order of the scores.
    pub(crate) fn groupings(&self) -> Vec<&str> {
        text::distinct(self.summaries.iter().map(|s| &*s.grouping))
    }

    /// Whether pairs were scored by classifiers that were trained on other ground.
    pub fn is_validated_on_unseen_ground(&self) -> bool {
        self.groupings().contains(&"place")
    }

    /// The grouping of the headline: `place` if present, otherwise the strictest one.
    pub(crate) fn first_grouping(&self) -> Option<&str> {
        let groupings = self.groupings();
        ["place", "log", "scan", "pair"].into_iter().find(|g| groupings.contains(g))
    }

    /// The learner with the least error under the first grouping, among the boosted learners or
    /// among the baselines.
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

/// Computes all measures.
pub fn evaluate(input: &Input<'_>) -> Evaluation {
    let labels: Vec<Label> = input.pairs.iter().map(|pair| pair.label).collect();
    let mut evaluation = Evaluation {
        spreads: spread::spreads(input),
        summaries: bootstrap::summaries(&labels, input.scores, input.resamples, input.seed),
        detection: input.detection.iter().map(detection::measure).collect(),
        sites: (input.sites.iter())
            .map(|site| detection::measure_site(site, input.detection))
            .collect(),
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
        let mut mistakes: Vec<Mistake> = scores
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
        mistakes.sort_by(|a, b| {
            b.confidence.abs().total_cmp(&a.confidence.abs()).then(a.pair.cmp(&b.pair))
        });
        evaluation.mistakes.extend(mistakes);
    }
    evaluation
}
