//! Pairs -> folds for cross-validation.
//!
//! One scheme for all groupings: each keyframe belongs to a group, groups are dealt to folds, and a
//! pair touches the folds of its two keyframes. It is scored by a classifier that was trained on
//! the pairs that touch neither. For the grouping `pair` the pair itself is what is dealt.

use std::collections::BTreeMap;

use dataset::{Keyframe, Label, Pair};
use serde::{Deserialize, Serialize};

use crate::LabelError;
use crate::draw::{keyframe_hash, name_hash, pair_key};

/// What may not stand on both sides of a fold.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Grouping {
    /// A pair (the paper's protocol): pairs are dealt to the folds at random, each class evenly.
    Pair,
    /// A scan.
    Scan,
    /// A block of ground: a square of a site's map, `evaluate.place_m` wide.
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

    /// What its groups are called.
    fn groups(self) -> &'static str {
        match self {
            Self::Pair => "pairs",
            Self::Scan => "scans",
            Self::Place => "places",
            Self::Log => "logs",
        }
    }
}

/// How pairs are dealt to folds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FoldOptions {
    /// What may not stand on both sides.
    pub grouping: Grouping,
    /// Folds at most; fewer groups give a fold each.
    pub n_folds: u32,
    /// Width of a place \[m\].
    pub place_m: f64,
    /// The run's seed.
    pub seed: u64,
}

/// Pairs dealt to folds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Folds {
    /// Number of folds.
    pub n_folds: u32,
    /// Group of each pair's query and of its reference, `(n_pairs, 2)`.
    pub groups: Vec<[u32; 2]>,
    /// Fold of each pair's query and of its reference, `(n_pairs, 2)`.
    pub folds: Vec<[u32; 2]>,
    /// Fold of each keyframe, `(n_keyframes,)`; empty where pairs were dealt.
    pub keyframe_folds: Vec<u32>,
    /// A pseudo-random number for each pair, from the seed and its scans' names, `(n_pairs,)`: a
    /// surplus of one class in a training set is the pairs of the largest keys.
    pub keys: Vec<u64>,
}

/// Deals pairs to folds by the seed.
pub fn assign_folds(
    options: &FoldOptions,
    keyframes: &[Keyframe],
    pairs: &[Pair],
) -> Result<Folds, LabelError> {
    let FoldOptions { grouping, n_folds, place_m, seed } = *options;
    let refuse = |key, found, expected| Err(LabelError::Option { key, found, expected });
    if n_folds < 2 {
        return refuse("evaluate.folds", f64::from(n_folds), "2 or more");
    }
    if !(place_m.is_finite() && 0.0 < place_m) {
        return refuse("evaluate.place_m", place_m, "more than 0");
    }
    // Another stream than the one that drew the pairs: these have small keys by construction.
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
    let of_groups = groups.assign(n_folds);
    let keyframe_folds: Vec<u32> =
        groups.keyframe_groups.iter().map(|&group| of_groups[group as usize]).collect();
    let ends = |of: &[u32]| pairs.iter().map(|p| [of[p.query], of[p.reference]]).collect();
    Ok(Folds {
        n_folds,
        groups: ends(&groups.keyframe_groups),
        folds: ends(&keyframe_folds),
        keyframe_folds,
        keys,
    })
}

/// The pairs of each class are shuffled by their keys and dealt in turn, so that the folds' sizes
/// differ by at most one pair of each class.
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
        for (place, (_, row)) in (0..n_folds).cycle().zip(shuffled) {
            folds[row] = [place; 2];
        }
    }
    Ok(folds)
}

/// Which group each keyframe is of.
struct Groups {
    /// `(n_keyframes,)`
    keyframe_groups: Vec<u32>,
    /// A pseudo-random number for each group, `(n_groups,)`.
    hashes: Vec<u64>,
}

impl Groups {
    /// Groups by name, numbered in order of their names.
    fn by<'a, N: Ord>(
        keyframes: &'a [Keyframe],
        name: impl Fn(&'a Keyframe) -> N,
        hash: impl Fn(&N) -> u64,
    ) -> Self {
        let mut numbers: BTreeMap<N, u32> = keyframes.iter().map(|k| (name(k), 0)).collect();
        for (number, place) in (0..).zip(numbers.values_mut()) {
            *place = number;
        }
        Self {
            keyframe_groups: keyframes.iter().map(|k| numbers[&name(k)]).collect(),
            hashes: numbers.keys().map(hash).collect(),
        }
    }

    /// The fold of each group: the largest group first, each to the fold that holds the fewest
    /// keyframes so far (Graham 1969, "Bounds on multiprocessing timing anomalies"); groups of one
    /// size in the seed's order.
    fn assign(&self, n_folds: u32) -> Vec<u32> {
        let mut sizes = vec![0u32; self.hashes.len()];
        for &group in &self.keyframe_groups {
            sizes[group as usize] += 1;
        }
        let mut order: Vec<usize> = (0..sizes.len()).collect();
        order.sort_unstable_by_key(|&g| (std::cmp::Reverse(sizes[g]), self.hashes[g], g));
        let mut folds = vec![0; sizes.len()];
        let mut sizes_of_folds = vec![0u32; n_folds as usize];
        for group in order {
            let fold = (0..n_folds).min_by_key(|&fold| sizes_of_folds[fold as usize]).unwrap_or(0);
            sizes_of_folds[fold as usize] += sizes[group];
            folds[group] = fold;
        }
        folds
    }
}
