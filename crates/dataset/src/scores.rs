/// Confidences of all pairs under one learner and one grouping of the folds, each by a
/// classifier that did not see the pair.
#[derive(Debug, Clone, PartialEq)]
pub struct Scores {
    /// The learner's name.
    pub learner: String,
    /// What was kept together on one side of a fold.
    pub grouping: String,
    /// Rounds that each confidence is given for.
    pub n_rounds: usize,
    /// Fold of each pair, `(n_pairs,)`.
    pub folds: Vec<u32>,
    /// Confidence of each pair after each round, row-major, `(n_pairs, n_rounds)`.
    pub confidences: Vec<f64>,
}

impl Scores {
    /// Confidence of each pair after `rounds` rounds (1 to `n_rounds`), `(n_pairs,)`.
    pub fn after(&self, rounds: usize) -> impl Iterator<Item = f64> + '_ {
        self.confidences.iter().skip(rounds - 1).step_by(self.n_rounds).copied()
    }
}

/// One round of boosting, as it was fitted; of a tree, one of its splits.
#[derive(Debug, Clone, PartialEq)]
pub struct BoostingRound {
    /// The learner's name.
    pub learner: String,
    /// Grouping and number of the fold left out; none for the model fitted on all pairs.
    pub left_out: Option<(String, u32)>,
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
