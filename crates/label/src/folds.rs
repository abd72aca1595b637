//! Assigns pairs to folds for cross-validation.
//!
//! All groupings follow one scheme. Each keyframe belongs to a group, each group is assigned to a
//! fold, and a pair touches the folds of its two keyframes. The pair is scored by a classifier
//! trained on the pairs that touch neither of these folds. The grouping `pair` is the exception: it
//! assigns the pairs themselves.

use std::collections::BTreeMap;

use dataset::{Keyframe, Label, OutOfRange, Pair};
use serde::{Deserialize, Serialize};

use crate::LabelError;
use crate::draw::{keyframe_hash, name_hash, pair_key};

/// What is kept in one fold and never split between training and test.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Grouping {
    /// A pair (the paper's protocol): pairs are assigned to folds at random, each class evenly.
    Pair,
    /// A scan.
    Scan,
    /// A block of ground: a square in the map of a site, `evaluate.place_m` wide.
    Place,
    /// A log.
    Log,
}

impl Grouping {
    /// The name in options and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pair => "pair",
            Self::Scan => "scan",
            Self::Place => "place",
            Self::Log => "log",
        }
    }

    /// The plural, for messages.
    fn groups(self) -> &'static str {
        match self {
            Self::Pair => "pairs",
            Self::Scan => "scans",
            Self::Place => "places",
            Self::Log => "logs",
        }
    }
}

/// How pairs are assigned to folds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FoldOptions {
    /// What is kept in one fold.
    pub grouping: Grouping,
    /// Largest number of folds. With fewer groups than this, each group is a fold.
    pub n_folds: u32,
    /// Width of a block of ground \[m\].
    pub place_m: f64,
    /// The run's seed.
    pub seed: u64,
}

/// The folds of pairs.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Folds {
    /// Number of folds.
    pub n_folds: u32,
    /// Groups of each pair's query and reference, `(n_pairs, 2)`.
    pub groups: Vec<[u32; 2]>,
    /// Folds of each pair's query and reference, `(n_pairs, 2)`.
    pub folds: Vec<[u32; 2]>,
    /// Fold of each keyframe, `(n_keyframes,)`; empty for the grouping `pair`.
    pub keyframe_folds: Vec<u32>,
    /// A pseudo-random number for each pair, `(n_pairs,)`. It depends only on the seed and the
    /// pair's two scans. A training set with too many pairs of one class drops the pairs with the
    /// largest keys.
    pub keys: Vec<u64>,
}

/// Assigns pairs to folds. The result depends only on the options (which contain the seed) and on
/// the keyframes and pairs, not on their order.
///
/// Fails when an option is out of range, when there are fewer than 2 groups, or, for the grouping
/// `pair`, when a class has fewer pairs than there are folds.
pub fn assign_folds(
    options: &FoldOptions,
    keyframes: &[Keyframe],
    pairs: &[Pair],
) -> Result<Folds, LabelError> {
    let FoldOptions { grouping, n_folds, place_m, seed } = *options;
    if n_folds < 2 {
        return Err(OutOfRange::new("evaluate.folds", n_folds, "2 or more").into());
    }
    if !(place_m.is_finite() && 0.0 < place_m) {
        return Err(OutOfRange::new("evaluate.place_m", place_m, "more than 0").into());
    }
    // The draw of the pairs kept those with the smallest keys, so the folds need other keys.
    let seed = seed ^ 0xF01D_5EED;
    let hashes: Vec<u64> = keyframes.iter().map(|k| keyframe_hash(seed, k)).collect();
    let keys: Vec<u64> =
        pairs.iter().map(|p| pair_key(hashes[p.query], hashes[p.reference])).collect();
    let groups = match grouping {
        Grouping::Pair => {
            let folds = assign_pairs(n_folds, &keys, pairs)?;
            let groups = (0..pairs.len() as u32).map(|k| [k, k]).collect();
            return Ok(Folds { n_folds, groups, folds, keyframe_folds: Vec::new(), keys });
        }
        Grouping::Scan => Groups { keyframe_groups: (0..keyframes.len() as u32).collect(), hashes },
        Grouping::Place => Groups::by(
            keyframes,
            |k| {
                let cell = |metres: f64| (metres / place_m).floor() as i64;
                (&*k.site, cell(k.pose.x_m), cell(k.pose.y_m))
            },
            |(site, x, y)| name_hash(seed, &[site.as_bytes(), &x.to_le_bytes(), &y.to_le_bytes()]),
        ),
        Grouping::Log => {
            Groups::by(keyframes, |k| &*k.id.log, |log| name_hash(seed, &[log.as_bytes()]))
        }
    };
    let n_groups = groups.hashes.len();
    if n_groups < 2 {
        return Err(LabelError::TooFewGroups {
            grouping: grouping.name(),
            groups: grouping.groups(),
            found: n_groups,
        });
    }
    let n_folds = n_folds.min(n_groups as u32);
    let group_folds = groups.assign(n_folds);
    let keyframe_folds: Vec<u32> =
        groups.keyframe_groups.iter().map(|&group| group_folds[group as usize]).collect();
    let ends = |of: &[u32]| pairs.iter().map(|p| [of[p.query], of[p.reference]]).collect();
    Ok(Folds {
        n_folds,
        groups: ends(&groups.keyframe_groups),
        folds: ends(&keyframe_folds),
        keyframe_folds,
        keys,
    })
}

/// Shuffles the pairs of each class by their keys and assigns them to the folds in turn. Within a
/// class, the sizes of two folds differ by at most one pair.
fn assign_pairs(n_folds: u32, keys: &[u64], pairs: &[Pair]) -> Result<Vec<[u32; 2]>, LabelError> {
    let mut folds = vec![[0; 2]; pairs.len()];
    for (label, class) in [(Label::Positive, "positive"), (Label::Negative, "negative")] {
        let mut shuffled: Vec<(u64, usize)> = (0..pairs.len())
            .filter(|&row| pairs[row].label == label)
            .map(|row| (keys[row], row))
            .collect();
        if shuffled.len() < n_folds as usize {
            return Err(LabelError::TooFewForFolds {
                folds: n_folds,
                class,
                found: shuffled.len(),
            });
        }
        shuffled.sort_unstable();
        for (fold, (_, row)) in (0..n_folds).cycle().zip(shuffled) {
            folds[row] = [fold; 2];
        }
    }
    Ok(folds)
}

/// The group of each keyframe.
struct Groups {
    /// `(n_keyframes,)`
    keyframe_groups: Vec<u32>,
    /// A pseudo-random number for each group, `(n_groups,)`.
    hashes: Vec<u64>,
}

impl Groups {
    /// Groups the keyframes by a name. Groups are numbered in the order of their names.
    fn by<'a, N: Ord>(
        keyframes: &'a [Keyframe],
        name: impl Fn(&'a Keyframe) -> N,
        hash: impl Fn(&N) -> u64,
    ) -> Self {
        let mut numbers: BTreeMap<N, u32> = keyframes.iter().map(|k| (name(k), 0)).collect();
        for (number, entry) in (0..).zip(numbers.values_mut()) {
            *entry = number;
        }
        Self {
            keyframe_groups: keyframes.iter().map(|k| numbers[&name(k)]).collect(),
            hashes: numbers.keys().map(hash).collect(),
        }
    }

    /// The fold of each group. The largest group comes first, and each group goes to the fold with
    /// the fewest keyframes so far (Graham 1969, "Bounds on multiprocessing timing anomalies").
    /// Groups of equal size are ordered by their hashes, which depend on the seed.
    fn assign(&self, n_folds: u32) -> Vec<u32> {
        let mut group_sizes = vec![0u32; self.hashes.len()];
        for &group in &self.keyframe_groups {
            group_sizes[group as usize] += 1;
        }
        let mut order: Vec<usize> = (0..group_sizes.len()).collect();
        order.sort_unstable_by_key(|&g| (std::cmp::Reverse(group_sizes[g]), self.hashes[g], g));
        let mut folds = vec![0; group_sizes.len()];
        let mut fold_sizes = vec![0u32; n_folds as usize];
        for group in order {
            let fold = (0..n_folds).min_by_key(|&fold| fold_sizes[fold as usize]).unwrap_or(0);
            fold_sizes[fold as usize] += group_sizes[group];
            folds[group] = fold;
        }
        folds
    }
}
