//! Confidences of many pairs at once, to the bit those of [`Classifier::confidence`].
//!
//! A pair's weak learners are summed in the order of the rounds, one pair as in a batch; what a
//! batch saves is the decision, pair by pair and round by round, what kind of weak learner it is,
//! and the loads of features that no round looks at.

use crate::{Classifier, MAX_DEPTH, Tree, WeakLearner};

/// Pairs scored together: the differences of all features that rounds look at stay in the cache.
const BLOCK: usize = 256;

impl Classifier {
    /// Confidences of pairs of rows of a feature table, `(n_pairs,)`.
    ///
    /// `features` is row-major, `(n_keyframes, n_features)`; a pair names two of its rows.
    ///
    /// # Panics
    /// If a pair names a row that is not there.
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
            batch.add(|place| &differences[place], &mut sums);
            confidences.extend_from_slice(&sums[..block.len()]);
        }
    }

    /// Confidences of pairs whose feature differences are given column by column,
    /// `(n_features, n_pairs)`; `(n_pairs,)`.
    ///
    /// # Panics
    /// If the columns are not of one length, or one that a round looks at is missing.
    pub fn score_columns<C: AsRef<[f64]>>(&self, columns: &[C]) -> Vec<f64> {
        let n_pairs = columns.first().map_or(0, |column| column.as_ref().len());
        assert!(columns.iter().all(|column| column.as_ref().len() == n_pairs));
        let batch = Batch::new(self);
        let mut confidences = vec![0.0; n_pairs];
        for (first, sums) in (0..).step_by(BLOCK).zip(confidences.chunks_mut(BLOCK)) {
            let n = sums.len();
            batch.add(|place| &columns[batch.used[place]].as_ref()[first..first + n], sums);
        }
        confidences
    }
}

/// A classifier, and the features that its rounds look at.
struct Batch<'a> {
    rounds: &'a [WeakLearner],
    /// Ascending.
    used: Vec<usize>,
    /// Place of each feature among those used; 0 for the others.
    places: Vec<usize>,
}

impl<'a> Batch<'a> {
    fn new(classifier: &'a Classifier) -> Self {
        let rounds = &classifier.rounds[..];
        let splits = rounds.iter().flat_map(WeakLearner::splits);
        let mut used: Vec<usize> = splits.map(|split| split.feature).collect();
        used.sort_unstable();
        used.dedup();
        // A node that does not split names feature 0.
        let mut places = vec![0; used.last().map_or(1, |last| last + 1)];
        for (place, &feature) in used.iter().enumerate() {
            places[feature] = place;
        }
        Self { rounds, used, places }
    }

    /// Adds the values of all rounds to a block of sums; `column` has the differences of the
    /// feature of a place.
    fn add<'c>(&self, column: impl Fn(usize) -> &'c [f64], sums: &mut [f64]) {
        let column = |feature: usize| column(self.places[feature]);
        let mut rounds = self.rounds;
        // No loop has a branch in it, so that they run on vectors; four rounds at a time spare
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

/// A vote or a step: `below` where F < threshold, else `above`.
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
            // + where theta < F: - where F < the next number after theta.
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

/// Level by level: the node each pair stands at.
fn add_tree<'c>(tree: &Tree, column: &impl Fn(usize) -> &'c [f64], sums: &mut [f64]) {
    let n_nodes = tree.nodes().len();
    let mut columns = [&[][..]; (1 << MAX_DEPTH) - 1];
    for (column_of, node) in columns.iter_mut().zip(tree.nodes()) {
        *column_of = column(node.feature);
    }
    for (k, sum) in sums.iter_mut().enumerate() {
        let mut place = 0;
        for _ in 0..tree.depth() {
            let is_right = tree.nodes()[place].threshold <= columns[place][k];
            place = 2 * place + 1 + usize::from(is_right);
        }
        *sum += tree.leaves()[place - n_nodes];
    }
}

#[cfg(test)]
mod tests {
    use crate::{Classifier, Learner, Node, Tree, WeakLearner};

    /// A feature table whose values repeat, so that differences meet thresholds exactly, more pairs
    /// than a block holds, and no feature in order.
    #[test]
    fn a_batch_gives_what_pairs_give_one_by_one() {
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
