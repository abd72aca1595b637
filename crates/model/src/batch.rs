//! Confidences of many pairs at once, with the same bits as [`Classifier::confidence`].
//!
//! The weak learners of a pair are summed in the order of the rounds, as for a single pair. A batch is
//! faster because it decides about the kind of a weak learner once per round, not once per pair and
//! round, and because it does not load features that no round uses.

use crate::{Classifier, MAX_DEPTH, Tree, WeakLearner};

/// Number of pairs scored together. The differences of all used features then stay in the cache.
const BLOCK: usize = 256;

impl Classifier {
    /// Confidences of pairs of rows of a feature table, `(n_pairs,)`.
    ///
    /// `features` is row-major, `(n_keyframes, n_features)`. A pair is two row numbers.
    ///
    /// # Panics
    /// Panics if a row number is out of range.
    pub fn score_pairs(
        &self,
        features: &[f64],
        n_features: usize,
        pairs: impl IntoIterator<Item = (usize, usize)>,
    ) -> Vec<f64> {
        let mut pairs = pairs.into_iter();
        let batch = Batch::new(self);
        let mut differences = vec![[0.0; BLOCK]; batch.used.len()];
        let mut confidences = Vec::with_capacity(pairs.size_hint().0);
        let mut block = Vec::with_capacity(BLOCK);
        loop {
            block.clear();
            block.extend(pairs.by_ref().take(BLOCK));
            if block.is_empty() {
                return confidences;
            }
            for (k, &(a, b)) in block.iter().enumerate() {
                let a = &features[a * n_features..][..n_features];
                let b = &features[b * n_features..][..n_features];
                for (column, &feature) in differences.iter_mut().zip(&batch.used) {
                    column[k] = (a[feature] - b[feature]).abs();
                }
            }
            let mut sums = [0.0; BLOCK];
            batch.add(|k| &differences[k], &mut sums);
            confidences.extend_from_slice(&sums[..block.len()]);
        }
    }

    /// Confidences of pairs, `(n_pairs,)`, from columns of feature differences,
    /// `(n_features, n_pairs)`.
    ///
    /// # Panics
    /// Panics if the columns differ in length, or if a column that a round uses is missing.
    pub fn score_columns<C: AsRef<[f64]>>(&self, columns: &[C]) -> Vec<f64> {
        let n_pairs = columns.first().map_or(0, |column| column.as_ref().len());
        assert!(columns.iter().all(|column| column.as_ref().len() == n_pairs));
        let batch = Batch::new(self);
        let mut confidences = vec![0.0; n_pairs];
        for (first, sums) in (0..).step_by(BLOCK).zip(confidences.chunks_mut(BLOCK)) {
            let n = sums.len();
            batch.add(|k| &columns[batch.used[k]].as_ref()[first..first + n], sums);
        }
        confidences
    }
}

/// A classifier and the features that its rounds use.
struct Batch<'a> {
    rounds: &'a [WeakLearner],
    /// Features that a round uses, in ascending order.
    used: Vec<usize>,
    /// Index of each feature in `used`; 0 for features that are not used.
    index_in_used: Vec<usize>,
}

impl<'a> Batch<'a> {
    fn new(classifier: &'a Classifier) -> Self {
        let rounds = &classifier.rounds[..];
        let splits = rounds.iter().flat_map(WeakLearner::splits);
        let mut used: Vec<usize> = splits.map(|split| split.feature).collect();
        used.sort_unstable();
        used.dedup();
        // A node that does not split has feature 0, which may be unused.
        let mut index_in_used = vec![0; used.last().map_or(1, |last| last + 1)];
        for (k, &feature) in used.iter().enumerate() {
            index_in_used[feature] = k;
        }
        Self { rounds, used, index_in_used }
    }

    /// Adds the values of all rounds to a block of sums. `column` gives the differences of the
    /// feature with an index in `used`.
    fn add<'c>(&self, column: impl Fn(usize) -> &'c [f64], sums: &mut [f64]) {
        let column = |feature: usize| column(self.index_in_used[feature]);
        let mut rounds = self.rounds;
        // The loops have no branches, so the compiler can vectorise them. Four rounds at a time save
        // three of four loads and stores of the sums.
        while let Some((four, rest)) = rounds.split_first_chunk::<4>() {
            let [Some(a), Some(b), Some(c), Some(d)] = four.each_ref().map(Step::of) else { break };
            let columns = column(a.feature).iter().zip(column(b.feature));
            let columns = columns.zip(column(c.feature).iter().zip(column(d.feature)));
            for (sum, ((&fa, &fb), (&fc, &fd))) in sums.iter_mut().zip(columns) {
                *sum = *sum + a.value(fa) + b.value(fb) + c.value(fc) + d.value(fd);
            }
            rounds = rest;
        }
        for weak in rounds {
            match *weak {
                WeakLearner::Line { feature, slope, intercept } => {
                    each(sums, column(feature), |f| slope * f + intercept);
                }
                WeakLearner::Tree(ref tree) => add_tree(tree, &column, sums),
                WeakLearner::Vote { .. } | WeakLearner::Step { .. } => {
                    let Some(step) = Step::of(weak) else { continue };
                    each(sums, column(step.feature), |f| step.value(f));
                }
            }
        }
    }
}

/// A vote or a step: `below` if F < threshold, else `above`.
#[derive(Clone, Copy)]
struct Step {
    feature: usize,
    threshold: f64,
    below: f64,
    above: f64,
}

impl Step {
    fn of(weak: &WeakLearner) -> Option<Self> {
        match *weak {
            WeakLearner::Vote { feature, threshold, polarity, alpha } if 0.0 < polarity => {
                Some(Self { feature, threshold, below: alpha, above: -alpha })
            }
            // This vote is positive if theta < F: negative if F is less than the next number after
            // theta.
            WeakLearner::Vote { feature, threshold, alpha, .. } => {
                Some(Self { feature, threshold: threshold.next_up(), below: -alpha, above: alpha })
            }
            WeakLearner::Step { feature, threshold, below, above } => {
                Some(Self { feature, threshold, below, above })
            }
            WeakLearner::Line { .. } | WeakLearner::Tree(_) => None,
        }
    }

    #[inline]
    fn value(self, f: f64) -> f64 {
        if f < self.threshold { self.below } else { self.above }
    }
}

#[inline]
fn each(sums: &mut [f64], column: &[f64], value: impl Fn(f64) -> f64) {
    for (sum, &f) in sums.iter_mut().zip(column) {
        *sum += value(f);
    }
}

/// Adds the leaves of a tree: for each pair, follows the tree from the root down.
fn add_tree<'c>(tree: &Tree, column: &impl Fn(usize) -> &'c [f64], sums: &mut [f64]) {
    let n_nodes = tree.nodes().len();
    let mut columns = [&[][..]; (1 << MAX_DEPTH) - 1];
    for (column_of, node) in columns.iter_mut().zip(tree.nodes()) {
        *column_of = column(node.feature);
    }
    for (k, sum) in sums.iter_mut().enumerate() {
        let mut node = 0;
        for _ in 0..tree.depth() {
            let is_right = tree.nodes()[node].threshold <= columns[node][k];
            node = 2 * node + 1 + usize::from(is_right);
        }
        *sum += tree.leaves()[node - n_nodes];
    }
}

#[cfg(test)]
mod tests {
    use crate::{Classifier, Learner, Node, Tree, WeakLearner};

    /// The values in the feature table repeat, so some differences equal a threshold. There are more
    /// pairs than a block has, and the rounds use the features out of order.
    #[test]
    fn a_batch_gives_the_same_bits_as_single_pairs() {
        let split = |feature, threshold| Node { feature, threshold };
        let nodes = [split(4, 2.0), Node::PASS, split(1, 3.0)];
        let tree = Tree::new(&nodes, &[0.17, 0.0, -0.19, 0.23]).unwrap();
        let rounds = vec![
            WeakLearner::Vote { feature: 3, threshold: 2.0, polarity: 1.0, alpha: 0.3 },
            WeakLearner::Vote { feature: 0, threshold: 1.0, polarity: -1.0, alpha: 0.7 },
            WeakLearner::Vote { feature: 1, threshold: 3.0, polarity: -1.0, alpha: 0.2 },
            WeakLearner::Step { feature: 2, threshold: 2.0, below: 0.21, above: -0.33 },
            WeakLearner::Vote { feature: 2, threshold: 0.0, polarity: -1.0, alpha: 0.02 },
            WeakLearner::Line { feature: 1, slope: -0.1, intercept: 0.9 },
            WeakLearner::Step { feature: 3, threshold: 4.0, below: 0.11, above: -0.13 },
            WeakLearner::Tree(tree),
        ];
        let classifier = Classifier { learner: Learner::Discrete, rounds };
        let features: Vec<f64> = (0..40 * 5).map(|k| f64::from(k * k % 7)).collect();
        let pairs: Vec<(usize, usize)> =
            (0..40).flat_map(|a| (0..a).map(move |b| (a, b))).collect();
        let rows: Vec<Vec<f64>> = pairs
            .iter()
            .map(|&(a, b)| {
                let of = |f: usize| (features[a * 5 + f] - features[b * 5 + f]).abs();
                (0..5).map(of).collect()
            })
            .collect();
        let expected: Vec<f64> = rows.iter().map(|row| classifier.confidence(row)).collect();
        assert_eq!(classifier.score_pairs(&features, 5, pairs.iter().copied()), expected);
        let columns: Vec<Vec<f64>> =
            (0..5).map(|f| rows.iter().map(|row| row[f]).collect()).collect();
        assert_eq!(classifier.score_columns(&columns), expected);
        assert!(classifier.score_pairs(&features, 5, []).is_empty());
    }
}
