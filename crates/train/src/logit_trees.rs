//! LogitBoost over small regression trees (Friedman, Hastie and Tibshirani 2000, "Additive logistic
//! regression: a statistical view of boosting", Algorithm 3), with short steps (Friedman 2001,
//! "Greedy function approximation: a gradient boosting machine"). Gains and leaves are computed as in
//! Chen and Guestrin 2016, "XGBoost: a scalable tree boosting system", equations 5 to 7.
//!
//! ```text
//! v_i = 1 / (2 Np) for positive, 1 / (2 Nn) for negative pairs, times N;  F_i = 0
//! for t = 1..T:
//!     p_i = 1 / (1 + exp(-F_i));  g_i = v_i (y*_i - p_i), y* = 1 or 0;  h_i = v_i p_i (1 - p_i)
//!     a tree, level by level: at each node the feature and threshold of the greatest gain
//!         Gl^2 / (Hl + LAMBDA) + Gr^2 / (Hr + LAMBDA) - G^2 / (H + LAMBDA)
//!         with MIN_LEAF pairs or more on each side; no split if no gain exceeds 0
//!     leaf = SHRINKAGE G / (H + LAMBDA);  F_i += the leaf of i
//! confidence(x) = sum of the leaves = ln(p / (1 - p)), the logarithm of the odds
//! ```
//!
//! The values of each feature are put into [`MAX_BINS`] bins with about equal numbers of pairs, and
//! thresholds are tried between the bins. If a feature has at most that many distinct values, every
//! threshold is tried. The cost is linear in the number of pairs.

use dataset::Label;
use model::{Node, Tree, WeakLearner};
use rayon::prelude::*;

use crate::matrix::{Matrix, midpoint};
use crate::{Round, TIE};

/// Number of levels of splits: up to three features decide together.
const DEPTH: usize = 3;
/// The step taken, as a share of a Newton step.
const SHRINKAGE: f64 = 0.1;
/// Least number of pairs in a leaf.
const MIN_LEAF: u32 = 20;
/// Regularisation of the leaves, in units of h (a pair with p = 1/2 has h = 1/4).
const LAMBDA: f64 = 1.0;
/// Largest number of bins of a feature.
const MAX_BINS: usize = 256;

/// The values of a feature, as bins.
struct Binned {
    /// The bin of each pair, `(n_pairs,)`.
    bins: Vec<u8>,
    /// The threshold between each bin and the next, `(n_bins - 1,)`.
    thresholds: Vec<f64>,
}

/// Sums over the pairs of a bin or a side: gradient, second derivative and number.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    g: f64,
    h: f64,
    n: u32,
}

impl Sums {
    fn add(&mut self, other: Self) {
        self.g += other.g;
        self.h += other.h;
        self.n += other.n;
    }

    fn less(self, other: Self) -> Self {
        Self { g: self.g - other.g, h: self.h - other.h, n: self.n - other.n }
    }

    fn score(self) -> f64 {
        self.g * self.g / (self.h + LAMBDA)
    }
}

/// The best split of a node by one feature.
#[derive(Debug, Clone, Copy)]
struct Best {
    gain: f64,
    feature: usize,
    /// The last bin on the left side.
    bin: usize,
}

pub(crate) fn fit(n_rounds: u32, data: &Matrix) -> Vec<Round> {
    let binned: Vec<Binned> = data.columns().par_iter().map(|column| bin(column)).collect();
    let n = data.n_rows() as f64;
    let share = |label| n / (2.0 * data.count(label) as f64);
    let (positive, negative) = (share(Label::Positive), share(Label::Negative));
    let mut margins = vec![0.0; data.n_rows()];
    let mut sums = vec![Sums::default(); data.n_rows()];
    let mut rounds = Vec::with_capacity(n_rounds as usize);
    for _ in 0..n_rounds {
        let mut squares = 0.0;
        for ((sums, &margin), label) in sums.iter_mut().zip(&margins).zip(data.labels()) {
            let p = 1.0 / (1.0 + libm::exp(-margin));
            let (v, target) =
                if *label == Label::Positive { (positive, 1.0) } else { (negative, 0.0) };
            *sums = Sums { g: v * (target - p), h: v * p * (1.0 - p), n: 1 };
            // h (g / h)^2: the working response g / h has the weight h.
            squares += if 0.0 < sums.h { sums.g * sums.g / sums.h } else { 0.0 };
        }
        let Some((tree, leaf_of)) = grow(&binned, &sums) else { break };
        let mut explained = 0.0;
        for ((margin, &leaf), sums) in margins.iter_mut().zip(&leaf_of).zip(&sums) {
            let step = tree.leaves()[leaf];
            *margin += step;
            explained += step * (2.0 * sums.g - step * sums.h);
        }
        let left = if 0.0 < squares { (1.0 - explained / squares).clamp(0.0, 1.0) } else { 0.0 };
        rounds.push(Round { weak: WeakLearner::Tree(tree), weighted_error: left });
    }
    rounds
}

/// Cuts the sorted values into bins of about n / [`MAX_BINS`] pairs. It never cuts between equal
/// values, or between two values with no number in between.
fn bin(column: &[f64]) -> Binned {
    let mut rows: Vec<u32> = (0..column.len() as u32).collect();
    rows.sort_unstable_by(|&a, &b| {
        column[a as usize].total_cmp(&column[b as usize]).then(a.cmp(&b))
    });
    let value = |rank: usize| column[rows[rank] as usize];
    let cuts: Vec<(usize, f64)> = (1..rows.len())
        .filter_map(|rank| Some((rank, midpoint(value(rank - 1), value(rank))?)))
        .collect();
    // If there are too many places to cut, take the first one after each equal share of the pairs.
    let mut kept = Vec::with_capacity(MAX_BINS - 1);
    let mut due = 1;
    for (k, &(rank, threshold)) in cuts.iter().enumerate() {
        let is_due = cuts.len() < MAX_BINS || due * rows.len() <= rank * MAX_BINS;
        if is_due && kept.len() < MAX_BINS - 1 {
            kept.push((cuts[k].0, threshold));
            due = rank * MAX_BINS / rows.len() + 1;
        }
    }
    let mut bins = vec![0; column.len()];
    for (bin, (start, _)) in (1..).zip(&kept) {
        let end = kept.get(usize::from(bin)).map_or(rows.len(), |next| next.0);
        for &row in &rows[*start..end] {
            bins[row as usize] = bin;
        }
    }
    Binned { bins, thresholds: kept.into_iter().map(|(_, threshold)| threshold).collect() }
}

/// A tree and the leaf of each pair; `None` if not even the root can be split.
fn grow(binned: &[Binned], sums: &[Sums]) -> Option<(Tree, Vec<usize>)> {
    let mut nodes = Vec::with_capacity((1 << DEPTH) - 1);
    // The node of each pair within the level.
    let mut places = vec![0usize; sums.len()];
    for level in 0..DEPTH {
        let n_nodes = 1 << level;
        let totals = totals(&places, sums, n_nodes);
        let found: Vec<Vec<Option<Best>>> = binned
            .par_iter()
            .enumerate()
            .map_init(Vec::new, |histogram, (feature, column)| {
                splits(feature, column, &places, sums, &totals, histogram)
            })
            .collect();
        let best = |node: usize| {
            // If gains are equal, the first feature and the lowest threshold are chosen.
            let better = |best: Option<Best>, next: Option<Best>| match (best, next) {
                (Some(best), Some(next)) if next.gain <= best.gain + TIE => Some(best),
                (best, next) => next.or(best),
            };
            found.iter().map(|of_feature| of_feature[node]).fold(None, better)
        };
        let bests: Vec<Option<Best>> = (0..n_nodes).map(best).collect();
        if level == 0 && bests[0].is_none() {
            return None;
        }
        nodes.extend(bests.iter().map(|best| match *best {
            Some(Best { feature, bin, .. }) => {
                Node { feature, threshold: binned[feature].thresholds[bin] }
            }
            None => Node::PASS,
        }));
        for (row, place) in places.iter_mut().enumerate() {
            let is_right = bests[*place]
                .is_some_and(|best| best.bin < usize::from(binned[best.feature].bins[row]));
            *place = 2 * *place + usize::from(is_right);
        }
    }
    let leaves: Vec<f64> = totals(&places, sums, 1 << DEPTH)
        .into_iter()
        .map(|side| SHRINKAGE * side.g / (side.h + LAMBDA))
        .collect();
    Some((Tree::new(&nodes, &leaves)?, places))
}

fn totals(places: &[usize], sums: &[Sums], n_nodes: usize) -> Vec<Sums> {
    let mut totals = vec![Sums::default(); n_nodes];
    for (&place, &one) in places.iter().zip(sums) {
        totals[place].add(one);
    }
    totals
}

/// The best split of each node of a level by one feature.
fn splits(
    feature: usize,
    column: &Binned,
    places: &[usize],
    sums: &[Sums],
    totals: &[Sums],
    histogram: &mut Vec<Sums>,
) -> Vec<Option<Best>> {
    histogram.clear();
    histogram.resize(totals.len() * MAX_BINS, Sums::default());
    for ((&place, &bin), &one) in places.iter().zip(&column.bins).zip(sums) {
        histogram[place * MAX_BINS + usize::from(bin)].add(one);
    }
    let best_of = |(node, &total): (usize, &Sums)| {
        let mut left = Sums::default();
        let mut best: Option<Best> = None;
        for (bin, _) in column.thresholds.iter().enumerate() {
            left.add(histogram[node * MAX_BINS + bin]);
            let right = total.less(left);
            if left.n < MIN_LEAF {
                continue;
            }
            if right.n < MIN_LEAF {
                break;
            }
            let gain = left.score() + right.score() - total.score();
            if best.map_or(0.0, |best| best.gain) + TIE < gain {
                best = Some(Best { gain, feature, bin });
            }
        }
        best
    };
    totals.iter().enumerate().map(best_of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use Label::{Negative, Positive};

    /// The second feature is 1 for 40 positives and 2 for 40 negatives; the first is constant.
    ///
    /// v = 80 / 80 = 1, p = 1/2, g = +-1/2, h = 1/4. The only split is at 1.5. Left G = 20 and
    /// H = 10, right G = -20 and H = 10: the leaves are 0.1 x 20 / 11 = 2/11 and -2/11. Each pair
    /// has the square (g/h)^2 h = 1, of which (2/11) (2 x 1/2 - 2/11 x 1/4) is explained. That
    /// leaves 1 - 2/11 + (2/11)^2 / 4 = 100/121.
    #[test]
    fn two_values_give_the_trees_worked_out_by_hand() {
        let labels = [[Positive; 40], [Negative; 40]].concat();
        let x = labels.iter().map(|l| if *l == Positive { 1.0 } else { 2.0 }).collect();
        let rounds = fit(2, &Matrix::new(vec![vec![7.0; 80], x], labels));
        let WeakLearner::Tree(tree) = rounds[0].weak else { panic!("expected a tree") };
        let splits: Vec<_> = rounds[0].weak.splits().collect();
        assert_eq!(splits.len(), 1);
        assert_eq!((splits[0].feature, splits[0].threshold), (1, Some(1.5)));
        let value = |x: f64| tree.value_of(|_| x);
        assert!((value(1.0) - 2.0 / 11.0).abs() < 1e-12);
        assert!((value(2.0) + 2.0 / 11.0).abs() < 1e-12);
        assert!((rounds[0].weighted_error - 100.0 / 121.0).abs() < 1e-12);
        // Round 2: the positives have p = 1 / (1 + e^(-2/11)), G = 40 (1 - p), H = 40 p (1 - p).
        let p = 1.0 / (1.0 + (-2.0f64 / 11.0).exp());
        let expected = 0.1 * 40.0 * (1.0 - p) / (40.0 * p * (1.0 - p) + 1.0);
        let WeakLearner::Tree(tree) = rounds[1].weak else { unreachable!() };
        assert!((tree.value_of(|_| 1.0) - expected).abs() < 1e-12);
    }

    /// The label depends on both features: neither feature alone separates the classes.
    #[test]
    fn a_tree_learns_a_label_that_depends_on_two_features() {
        let quarter = |k: usize| k % 100 / 25;
        let columns = vec![
            (0..400).map(|k| f64::from(quarter(k) < 2) + k as f64 * 1e-6).collect(),
            (0..400).map(|k| (quarter(k) % 2) as f64 + k as f64 * 1e-6).collect(),
        ];
        let label = |k| if (quarter(k) < 2) == (quarter(k) % 2 == 0) { Positive } else { Negative };
        let data = Matrix::new(columns, (0..400).map(label).collect());
        let rounds = fit(30, &data);
        let classifier = crate::classifier(model::Learner::LogitTrees, &rounds);
        let confidences = classifier.score_columns(data.columns());
        let right = confidences.iter().zip(data.labels());
        assert!(right.filter(|(c, l)| Label::from_confidence(**c, 0.0) == **l).count() > 390);
    }

    #[test]
    fn too_few_pairs_or_a_constant_feature_give_no_rounds() {
        let labels = [[Positive; 19], [Negative; 19]].concat();
        let x: Vec<f64> = (0..38).map(f64::from).collect();
        assert!(fit(3, &Matrix::new(vec![x], labels.clone())).is_empty());
        assert!(fit(3, &Matrix::new(vec![vec![1.0; 38]], labels)).is_empty());
    }

    #[test]
    fn bins_have_equal_numbers_of_pairs_and_never_split_equal_values() {
        let few = bin(&[2.0, 1.0, 2.0, 3.0]);
        assert_eq!((few.bins, few.thresholds), (vec![1, 0, 1, 2], vec![1.5, 2.5]));
        let column: Vec<f64> = (0..10_000).map(|k| f64::from(k * 7919 % 10_000)).collect();
        let many = bin(&column);
        assert_eq!(many.thresholds.len(), MAX_BINS - 1);
        let mut counts = [0; MAX_BINS];
        for (&bin, &x) in many.bins.iter().zip(&column) {
            counts[usize::from(bin)] += 1;
            let below = many.thresholds.iter().filter(|&&t| t < x).count();
            assert_eq!(usize::from(bin), below);
        }
        // 10,000 / 256 = 39.06
        assert!(counts.iter().all(|n| (39..=40).contains(n)), "{counts:?}");
    }
}
