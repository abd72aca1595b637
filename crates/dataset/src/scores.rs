/// Cross-validated confidences of all pairs for one learner and one grouping.
///
/// The confidence of a pair comes from a classifier that was trained without the folds of the pair.
#[derive(Debug, Clone, PartialEq)]
pub struct Scores {
    /// Name of the learner.
    pub learner: String,
    /// Name of the grouping. A group is never split between training and test.
    pub grouping: String,
    /// Number of boosting rounds for which each pair has a confidence.
    pub n_rounds: usize,
    /// Groups of the query and the reference of each pair, `(n_pairs, 2)`.
    pub groups: Vec<[u32; 2]>,
    /// Folds of the query and the reference of each pair, `(n_pairs, 2)`.
    pub folds: Vec<[u32; 2]>,
    /// Number of pairs that the classifier which scored each pair was trained on, `(n_pairs,)`.
    pub n_training: Vec<u32>,
    /// Confidence of each pair after each round, row-major, `(n_pairs, n_rounds)`.
    pub confidences: Vec<f64>,
}

impl Scores {
    /// Confidence of each pair after `rounds` rounds (1 to `n_rounds`), `(n_pairs,)`.
    pub fn after(&self, rounds: usize) -> impl Iterator<Item = f64> + '_ {
        self.confidences.iter().skip(rounds - 1).step_by(self.n_rounds).copied()
    }
}

/// The folds that were held out of the training.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
pub struct HeldOut {
    /// Name of the grouping. A group is never split between training and test.
    pub grouping: String,
    /// The two folds, ascending; the same fold twice if only one was held out.
    pub folds: [u32; 2],
}

/// One fitted round of boosting. If the weak learner is a tree, one split of the tree.
#[derive(Debug, Clone, PartialEq)]
pub struct BoostingRound {
    /// Name of the learner.
    pub learner: String,
    /// The folds held out; `None` for the model fitted on all pairs.
    pub held_out: Option<HeldOut>,
    /// Round, from 1.
    pub round: u32,
    /// Node of the tree. The root is 0 and the children of node k are 2 k + 1 and 2 k + 2. `None`
    /// for weak learners that use one feature.
    pub node: Option<u32>,
    /// Name of the selected feature.
    pub feature: String,
    /// Threshold of the weak learner, if it has one.
    pub threshold: Option<f64>,
    /// Error under the weights of the round. For `discrete`, the weighted share of wrong labels.
    /// For the gentle learners, the weighted mean of the squared residuals. For `logit_trees`, the
    /// sum of the squared residuals as a share of the sum of squares before the round.
    pub weighted_error: f64,
}

/// Performance of one learner on all pairs of keyframes, with the natural proportion of positives.
#[derive(Debug, Clone, PartialEq)]
pub struct Retrieval {
    /// Name of the learner.
    pub learner: String,
    /// Name of the grouping. A group is never split between training and test.
    pub grouping: String,
    /// The log whose keyframes are paired; `None` for the pairs of all logs together.
    pub log: Option<String>,
    /// Whether ambiguous pairs (neither positive nor negative) count as negative. If false, they
    /// are left out.
    pub ambiguous_as_negative: bool,
    /// Number of scored positive pairs.
    pub n_positive: u64,
    /// Number of scored negative pairs.
    pub n_negative: u64,
    /// Number of ambiguous pairs that were left out.
    pub n_ambiguous: u64,
    /// Number of pairs that were not scored because no classifier could be trained without their
    /// folds.
    pub n_unscored: u64,
    /// Every `query_stride`-th keyframe is a query. It is compared with all earlier keyframes.
    pub query_stride: u64,
    /// Average precision; `None` if there are no positives.
    pub average_precision: Option<f64>,
    /// Largest recall at which no negative is classified as positive.
    pub recall_at_full_precision: Option<f64>,
    /// Largest recall at which at most 1 % of the negatives are classified as positive.
    pub detection_at_1_percent: Option<f64>,
    /// Largest F1 score (harmonic mean of precision and recall) over all thresholds.
    pub max_f1: Option<f64>,
    /// Points of the curve by descending threshold. Not every threshold has a point. The counts of
    /// each point are exact.
    pub curve: Vec<RetrievalPoint>,
}

/// A point on the curve of a [`Retrieval`].
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RetrievalPoint {
    /// Pairs with at least this confidence are classified as positive.
    pub threshold: f64,
    /// Number of positives classified as positive.
    pub true_positive: u64,
    /// Number of negatives classified as positive.
    pub false_positive: u64,
}

/// Usefulness of one feature on its own and in the models.
#[derive(Debug, Clone, PartialEq)]
pub struct FeatureUsefulness {
    /// Name of the feature.
    pub name: String,
    /// Area under the ROC curve if only this feature ranks the pairs: 0.5 is chance, 1 is perfect.
    pub auc: f64,
    /// Median change of the feature if every other return of a scan is removed, as a share of the
    /// interquartile range of the feature.
    pub stability: f64,
    /// Number of splits on the feature, summed over the rounds of all models that are trained on
    /// all pairs.
    pub chosen: u64,
}

/// Cross-validated error of a learner on pairs that are labelled with other rules.
#[derive(Debug, Clone, PartialEq)]
pub struct GridCell {
    /// Name of the learner.
    pub learner: String,
    /// Name of the grouping. A group is never split between training and test.
    pub grouping: String,
    /// `label.positive_radius_m` \[m\].
    pub positive_radius_m: f64,
    /// `label.negative_min_m` \[m\].
    pub negative_min_m: f64,
    /// `label.min_travel_gap_m` \[m\].
    pub min_travel_gap_m: f64,
    /// Share of the pairs with a wrong label after the last round, or the reason why there is none.
    pub error: Result<f64, String>,
}
