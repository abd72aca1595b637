use serde::{Deserialize, Serialize};

use crate::tree::Tree;

/// The learners.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Learner {
    /// Discrete AdaBoost over decision stumps (the paper's Algorithm 1).
    Discrete,
    /// Gentle AdaBoost over weighted least-squares lines (Algorithm 2, following the paper's text).
    GentleLine,
    /// Gentle AdaBoost over regression stumps (Friedman, Hastie and Tibshirani 2000).
    GentleStump,
    /// LogitBoost over small regression trees (Friedman, Hastie and Tibshirani 2000, Algorithm 3).
    LogitTrees,
}

impl Learner {
    /// The name in options, tables and files.
    pub fn name(self) -> &'static str {
        match self {
            Self::Discrete => "discrete",
            Self::GentleLine => "gentle_line",
            Self::GentleStump => "gentle_stump",
            Self::LogitTrees => "logit_trees",
        }
    }
}

/// One round of boosting. It adds a function of one feature, or a tree over a few features, to the
/// confidence.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum WeakLearner {
    /// `alpha` if p F < p theta, else `-alpha`.
    Vote {
        /// Index of the feature.
        feature: usize,
        /// theta.
        threshold: f64,
        /// p, +1.0 or -1.0.
        polarity: f64,
        /// Weight of the vote, ln(1 / beta).
        alpha: f64,
    },
    /// `slope` * F + `intercept`.
    Line {
        /// Index of the feature.
        feature: usize,
        /// Slope, per unit of the feature.
        slope: f64,
        /// Value at F = 0.
        intercept: f64,
    },
    /// `below` if F < theta, else `above`.
    Step {
        /// Index of the feature.
        feature: usize,
        /// theta.
        threshold: f64,
        /// Weighted mean of the labels below the threshold.
        below: f64,
        /// Weighted mean of the labels at or above the threshold.
        above: f64,
    },
    /// The value of the leaf that the pair reaches.
    Tree(Tree),
}

/// The use of a feature by a weak learner.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Split {
    /// The node of the tree. Node 0 is the root, and the children of node k are nodes 2 k + 1 and
    /// 2 k + 2. `None` for weak learners of one feature.
    pub node: Option<u32>,
    /// Index of the feature.
    pub feature: usize,
    /// The threshold; `None` for a line.
    pub threshold: Option<f64>,
}

impl WeakLearner {
    /// The features that it uses: one, or those of the nodes of a tree in order.
    pub fn splits(&self) -> impl Iterator<Item = Split> + '_ {
        let one = match *self {
            Self::Vote { feature, threshold, .. } | Self::Step { feature, threshold, .. } => {
                Some(Split { node: None, feature, threshold: Some(threshold) })
            }
            Self::Line { feature, .. } => Some(Split { node: None, feature, threshold: None }),
            Self::Tree(_) => None,
        };
        let nodes = if let Self::Tree(tree) = self { tree.nodes() } else { &[] };
        let of_tree = (0..).zip(nodes).filter(|(_, node)| node.is_split()).map(|(k, node)| Split {
            node: Some(k),
            feature: node.feature,
            threshold: Some(node.threshold),
        });
        one.into_iter().chain(of_tree)
    }

    /// The value that it adds to the confidence of a pair with these feature differences.
    #[inline]
    pub fn value(&self, difference: &[f64]) -> f64 {
        self.value_of(|feature| difference[feature])
    }

    /// The same as [`Self::value`], with a function that returns the difference of a feature.
    #[inline]
    pub fn value_of(&self, difference: impl Fn(usize) -> f64) -> f64 {
        match *self {
            Self::Vote { feature, threshold, polarity, alpha } => {
                let f = difference(feature);
                if polarity * f < polarity * threshold { alpha } else { -alpha }
            }
            Self::Line { feature, slope, intercept } => slope * difference(feature) + intercept,
            Self::Step { feature, threshold, below, above } => {
                if difference(feature) < threshold {
                    below
                } else {
                    above
                }
            }
            Self::Tree(ref tree) => tree.value_of(difference),
        }
    }
}

/// A sum of weak learners.
#[derive(Debug, Clone, PartialEq)]
pub struct Classifier {
    /// The learner that trained it.
    pub learner: Learner,
    /// One weak learner per round, `(n_rounds,)`.
    pub rounds: Vec<WeakLearner>,
}

impl Classifier {
    /// The confidence that both scans of a pair show the same place, from the feature differences
    /// `|f_a - f_b|`, `(n_features,)`. The pair is classified as positive if the confidence is at
    /// least the threshold, which is 0 by default.
    pub fn confidence(&self, difference: &[f64]) -> f64 {
        self.rounds.iter().map(|weak| weak.value(difference)).sum()
    }

    /// The confidence after each round, `(n_rounds,)`.
    pub fn staged_confidences(&self, difference: &[f64]) -> impl Iterator<Item = f64> {
        self.rounds.iter().scan(0.0, |sum, weak| {
            *sum += weak.value(difference);
            Some(*sum)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_confidence_is_the_sum_of_votes_lines_and_steps() {
        let classifier = Classifier {
            learner: Learner::Discrete,
            rounds: vec![
                WeakLearner::Vote { feature: 1, threshold: 2.0, polarity: 1.0, alpha: 0.5 },
                WeakLearner::Vote { feature: 0, threshold: 1.0, polarity: -1.0, alpha: 0.25 },
                WeakLearner::Line { feature: 0, slope: -2.0, intercept: 1.0 },
                WeakLearner::Step { feature: 1, threshold: 2.0, below: 0.75, above: -0.125 },
            ],
        };
        // Feature 0 is 3, which is more than 1: the second vote is positive. Feature 1 is 1, which is
        // less than 2.
        assert_eq!(classifier.confidence(&[3.0, 1.0]), 0.5 + 0.25 - 5.0 + 0.75);
        let staged: Vec<f64> = classifier.staged_confidences(&[3.0, 1.0]).collect();
        assert_eq!(staged, [0.5, 0.75, -4.25, -3.5]);
        // At the threshold, a vote is negative for both polarities, and a step takes `above`.
        assert_eq!(classifier.confidence(&[1.0, 2.0]), -0.5 - 0.25 - 1.0 - 0.125);
    }
}
