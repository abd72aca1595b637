//! Assigns pairs to folds for cross-validation.
//!
//! All groupings follow one scheme. Each keyframe belongs to a group, each group is assigned to a
//! fold, and a pair touches the folds of its two keyframes. The pair is scored by a classifier
//! trained on the pairs that touch neither of these folds. The grouping `pair` is the exception: it
//! assigns the pairs themselves.

use std::collections::BTreeMap;

use dataset::{Keyframe, Label, OutOfRange, Pair, SplitMix64, common_frames};
use serde::{Deserialize, Serialize};

use crate::LabelError;
use crate::draw::name_hash;

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
    /// Margin around a block of ground \[m\]: a pair with a scan this close to a block is not used
    /// to train a classifier that is tested there. Up to 10 times `place_m`.
    pub place_margin_m: f64,
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
    /// Other folds with a block of ground within the margin around the pair's two scans,
    /// `(n_pairs,)`. Empty lists except for the grouping `place`.
    pub near_folds: Vec<Vec<u32>>,
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
    let FoldOptions { grouping, n_folds, place_m, place_margin_m, seed } = *options;
    if n_folds < 2 {
        return Err(OutOfRange::new("evaluate.folds", n_folds, "2 or more").into());
    }
    if !(place_m.is_finite() && 0.0 < place_m) {
        return Err(OutOfRange::new("evaluate.place_m", place_m, "more than 0").into());
    }
    if !(place_margin_m.is_finite() && 0.0 <= place_margin_m) {
        return Err(OutOfRange::new("evaluate.place_margin_m", place_margin_m, "0 or more").into());
    }
    // Other numbers than those that the pairs are drawn by.
    let seed = seed ^ 0xF01D_5EED;
    let hashes: Vec<u64> = keyframes.iter().map(|k| keyframe_hash(seed, k)).collect();
    let keys: Vec<u64> =
        pairs.iter().map(|p| pair_key(hashes[p.query], hashes[p.reference])).collect();
    let groups = match grouping {
        Grouping::Pair => {
            let folds = assign_pairs(n_folds, &keys, pairs)?;
            let groups = (0..pairs.len() as u32).map(|k| [k, k]).collect();
            let near_folds = vec![Vec::new(); pairs.len()];
            return Ok(Folds {
                n_folds,
                groups,
                folds,
                near_folds,
                keyframe_folds: Vec::new(),
                keys,
            });
        }
        Grouping::Scan => Groups { keyframe_groups: (0..keyframes.len() as u32).collect(), hashes },
        Grouping::Place => Blocks::new(keyframes, place_m).groups(keyframes, seed),
        Grouping::Log => Groups::by(keyframes.iter().map(|k| &*k.id.log), |log| {
            name_hash(seed, &[log.as_bytes()])
        }),
    };
    let ends = |of: &[u32]| -> Vec<[u32; 2]> {
        pairs.iter().map(|p| [of[p.query], of[p.reference]]).collect()
    };
    let of_pairs = ends(&groups.keyframe_groups);
    check_groups(grouping, groups.hashes.len(), &of_pairs)?;
    let n_folds = n_folds.min(groups.hashes.len() as u32);
    let group_folds = groups.assign(n_folds);
    let keyframe_folds: Vec<u32> =
        groups.keyframe_groups.iter().map(|&group| group_folds[group as usize]).collect();
    let folds = ends(&keyframe_folds);
    let near_folds = match grouping {
        Grouping::Place => {
            let near = Blocks::new(keyframes, place_m);
            let near = near.near_folds(keyframes, &keyframe_folds, place_margin_m);
            near_pairs(pairs, &near, &folds)
        }
        _ => vec![Vec::new(); pairs.len()],
    };
    Ok(Folds { n_folds, groups: of_pairs, folds, near_folds, keyframe_folds, keys })
}

/// Checks that a group can be held out and that pairs are then left to train on.
fn check_groups(
    grouping: Grouping,
    n_groups: usize,
    of_pairs: &[[u32; 2]],
) -> Result<(), LabelError> {
    let (name, groups) = (grouping.name(), grouping.groups());
    if n_groups < 2 {
        return Err(LabelError::TooFewGroups { grouping: name, groups, found: n_groups });
    }
    let n_between = of_pairs.iter().filter(|[a, b]| a != b).count();
    if n_groups == 2 && 0 < n_between {
        return Err(LabelError::TwoGroups { grouping: name, groups, n_between });
    }
    Ok(())
}

/// The folds near the two scans of each pair, without the folds of the pair, `(n_pairs,)`. `near` are
/// the folds near each keyframe.
fn near_pairs(pairs: &[Pair], near: &[Vec<u32>], folds: &[[u32; 2]]) -> Vec<Vec<u32>> {
    let of_pair = |(pair, own): (&Pair, &[u32; 2])| {
        let mut of_pair = [&*near[pair.query], &*near[pair.reference]].concat();
        of_pair.retain(|fold| !own.contains(fold));
        of_pair.sort_unstable();
        of_pair.dedup();
        of_pair
    };
    pairs.iter().zip(folds).map(of_pair).collect()
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

/// Blocks of ground: squares in the frame of a site.
struct Blocks {
    width_m: f64,
    /// Frame, column and row of the block of each keyframe, `(n_keyframes,)`.
    of_keyframes: Vec<(u32, i64, i64)>,
}

impl Blocks {
    fn new(keyframes: &[Keyframe], width_m: f64) -> Self {
        let cell = |metres: f64| (metres / width_m).floor() as i64;
        let frames = common_frames(keyframes);
        let of_keyframes = keyframes
            .iter()
            .zip(frames)
            .map(|(k, frame)| (frame, cell(k.pose.x_m), cell(k.pose.y_m)))
            .collect();
        Self { width_m, of_keyframes }
    }

    /// The groups of the grouping `place`.
    fn groups(&self, keyframes: &[Keyframe], seed: u64) -> Groups {
        let names = self.of_keyframes.iter().zip(keyframes);
        Groups::by(names.map(|(&(frame, x, y), k)| (frame, &*k.site, x, y)), |(_, site, x, y)| {
            name_hash(seed, &[site.as_bytes(), &x.to_le_bytes(), &y.to_le_bytes()])
        })
    }

    /// For each keyframe, the folds with a block closer than the margin, `(n_keyframes,)`.
    fn near_folds(&self, keyframes: &[Keyframe], folds: &[u32], margin_m: f64) -> Vec<Vec<u32>> {
        let fold_of: BTreeMap<(u32, i64, i64), u32> =
            self.of_keyframes.iter().copied().zip(folds.iter().copied()).collect();
        let reach = (margin_m / self.width_m).ceil() as i64;
        // Distance to a column or row of blocks, 0 within it.
        let gap_m = |metres: f64, cell: i64| {
            let low_m = cell as f64 * self.width_m;
            (low_m - metres).max(metres - (low_m + self.width_m)).max(0.0)
        };
        let near = |(k, &(frame, column, row)): (&Keyframe, &(u32, i64, i64))| {
            let mut near = Vec::new();
            for x in column - reach..=column + reach {
                let x_gap_m = gap_m(k.pose.x_m, x);
                for y in row - reach..=row + reach {
                    let distance_m = libm::hypot(x_gap_m, gap_m(k.pose.y_m, y));
                    if distance_m < margin_m {
                        near.extend(fold_of.get(&(frame, x, y)));
                    }
                }
            }
            near
        };
        keyframes.iter().zip(&self.of_keyframes).map(near).collect()
    }
}

/// The group of each keyframe.
struct Groups {
    /// `(n_keyframes,)`
    keyframe_groups: Vec<u32>,
    /// A pseudo-random number for each group, `(n_groups,)`.
    hashes: Vec<u64>,
}

impl Groups {
    /// Groups the keyframes by their names. Groups are numbered in the order of their names.
    fn by<N: Ord>(names: impl Iterator<Item = N> + Clone, hash: impl Fn(&N) -> u64) -> Self {
        let mut numbers: BTreeMap<N, u32> = names.clone().map(|name| (name, 0)).collect();
        for (number, entry) in (0..).zip(numbers.values_mut()) {
            *entry = number;
        }
        Self {
            keyframe_groups: names.map(|name| numbers[&name]).collect(),
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

/// A keyframe's contribution to the keys of its pairs. It depends only on the seed and on the
/// scan's log and number.
fn keyframe_hash(seed: u64, keyframe: &Keyframe) -> u64 {
    let mut hasher = blake3::Hasher::new();
    hasher.update(&seed.to_le_bytes());
    hasher.update(&keyframe.id.scan.to_le_bytes());
    hasher.update(keyframe.id.log.as_bytes());
    let [a, b, c, d, e, f, g, h, ..] = *hasher.finalize().as_bytes();
    u64::from_le_bytes([a, b, c, d, e, f, g, h])
}

/// The key of a pair, the first output of [`SplitMix64`] for the sum of both hashes. Exchanging `a`
/// and `b` gives the same key.
#[inline]
fn pair_key(a: u64, b: u64) -> u64 {
    SplitMix64::new(a.wrapping_add(b)).next_u64()
}
