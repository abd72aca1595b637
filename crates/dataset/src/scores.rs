/// Confidences of all pairs under one learner and one grouping of the folds, each by a
/// classifier that saw no pair of a fold that the pair touches.
#[derive(Debug, Clone, PartialEq)]
pub struct Scores {
    /// The learner's name.
    pub learner: String,
    /// What was kept together on one side of a fold.
    pub grouping: String,
    /// Rounds that each confidence is given for.
    pub n_rounds: usize,
    /// Group of each pair's query and of its reference, `(n_pairs, 2)`.
    pub groups: Vec<[u32; 2]>,
    /// Fold of each pair's query and of its reference, `(n_pairs, 2)`.
    pub folds: Vec<[u32; 2]>,
    /// Confidence of each pair after each round, row-major, `(n_pairs, n_rounds)`.
    pub confidences: Vec<f64>,
}

impl Scores {
    /// Confidence of each pair after `rounds` rounds (1 to `n_rounds`), `(n_pairs,)`.
    pub fn after(&self, rounds: usize) -> impl Iterator<Item = f64> + '_ {
        self.confidences.iter().skip(rounds - 1).step_by(self.n_rounds).copied()
    }
}

/// The folds that a fit did not train on.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct HeldOut {
    /// What was kept together on one side of a fold.
    pub grouping: String,
    /// The two folds, ascending; the same fold twice if only one was held out.
    pub folds: [u32; 2],
}

/// One round of boosting, as it was fitted; of a tree, one of its splits.
#[derive(Debug, Clone, PartialEq)]
pub struct BoostingRound {
    /// The learner's name.
    pub learner: String,
    /// The folds held out; `None` for the model fitted on all pairs.
    pub held_out: Option<HeldOut>,
    /// Round, from 1.
    pub round: u32,
    /// Node of the tree, 0 its root, the children of k at 2 k + 1 and 2 k + 2; none for weak
    /// learners of one feature.
    pub node: Option<u32>,
    /// Name of the feature chosen.
    pub feature: String,
    /// Its threshold, for weak learners that have one.
    pub threshold: Option<f64>,
    /// Error under the round's weights: the share of wrong labels (`discrete`) or the mean of
    /// the squared residuals (the others; of a tree, as a share of the squares there were).
    pub weighted_error: f64,
}

/// How well one learner finds the positives among all pairs of keyframes, as they come: at their
/// natural prevalence.
#[derive(Debug, Clone, PartialEq)]
pub struct Retrieval {
    /// The learner's name.
    pub learner: String,
    /// What was kept together on one side of a fold.
    pub grouping: String,
    /// The log whose keyframes are paired; none for the pairs of all logs together.
    pub log: Option<String>,
    /// Whether a pair that is neither positive nor negative counts as negative; it is left out
    /// otherwise.
    pub ambiguous_as_negative: bool,
    /// Positive pairs scored.
    pub n_positive: u64,
    /// Negative pairs scored.
    pub n_negative: u64,
    /// Pairs left out: neither positive nor negative.
    pub n_ambiguous: u64,
    /// Pairs left out: no classifier could be trained without the folds they touch.
    pub n_unscored: u64,
    /// Every so many-th keyframe was a query, against all before it.
    pub query_stride: u64,
    /// Average precision; none without positives.
    pub average_precision: Option<f64>,
    /// Greatest share of the positives called positive while no negative is.
    pub recall_at_full_precision: Option<f64>,
    /// Greatest share of the positives called positive while at most 1 % of the negatives are.
    pub detection_at_1_percent: Option<f64>,
    /// Greatest harmonic mean of precision and recall over all thresholds.
    pub max_f1: Option<f64>,
    /// Points of falling threshold, thinned: the counts are exact.
    pub curve: Vec<RetrievalPoint>,
}

/// A point of a [`Retrieval`]'s curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RetrievalPoint {
    /// Pairs whose confidence is not less than this are called positive.
    pub threshold: f64,
    /// Positives called positive.
    pub true_positive: u64,
    /// Negatives called positive.
    pub false_positive: u64,
}

/// How useful one feature is on its own, and to the models.
#[derive(Debug, Clone, PartialEq)]
pub struct FeatureUsefulness {
    /// The feature's name.
    pub name: String,
    /// Area under the ROC curve when the feature alone ranks the pairs: 0.5 is chance, 1 is
    /// perfect.
    pub auc: f64,
    /// Median change of the feature when a scan loses every other return, as a share of the
    /// feature's interquartile range.
    pub stability: f64,
    /// Number of splits on the feature, over the rounds of all models fitted on all pairs.
    pub chosen: u64,
}

/// The cross-validated error of a learner on pairs drawn by other label rules.
#[derive(Debug, Clone, PartialEq)]
pub struct GridCell {
    /// The learner's name.
    pub learner: String,
    /// What was kept together on one side of a fold.
    pub grouping: String,
    /// `label.positive_radius_m` \[m\].
    pub positive_radius_m: f64,
    /// `label.negative_min_m` \[m\].
    pub negative_min_m: f64,
    /// `label.min_travel_gap_m` \[m\].
    pub min_travel_gap_m: f64,
    /// Share of the pairs given the wrong label at the last round, or why there is none.
    pub error: Result<f64, String>,
}
