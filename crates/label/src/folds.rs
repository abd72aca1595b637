//! Pairs -> folds for cross-validation.

use dataset::{Keyframe, Label, Pair};
use serde::{Deserialize, Serialize};

use crate::LabelError;
use crate::draw::{keyframe_hash, pair_key};

/// What may not stand on both sides of a fold.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "snake_case")]
pub enum Grouping {
    /// A pair (the paper's protocol): pairs are dealt to the folds at random, each class evenly.
    Pair,
}

impl Grouping {
    /// The name in options and tables.
    pub fn name(self) -> &'static str {
        match self {
            Self::Pair => "pair",
        }
    }
}

/// The fold of each pair, 0 to `n_folds - 1`, `(n_pairs,)`.
///
/// The pairs of each class are shuffled by the seed and dealt in turn, so that the folds' sizes
/// differ by at most one pair of each class.
pub fn folds(
    grouping: Grouping,
    n_folds: u32,
    seed: u64,
    keyframes: &[Keyframe],
    pairs: &[Pair],
) -> Result<Vec<u32>, LabelError> {
    if n_folds < 2 {
        return Err(LabelError::Option {
            key: "evaluate.folds",
            found: f64::from(n_folds),
            expected: "2 or more",
        });
    }
    let Grouping::Pair = grouping;
    // Another stream than the one that drew the pairs: these have small keys by construction.
    let seed = seed ^ 0xF01D_5EED;
    let hashes: Vec<u64> = keyframes.iter().map(|k| keyframe_hash(seed, k)).collect();
    let mut folds = vec![0; pairs.len()];
    for (label, class) in [(Label::Positive, "positive"), (Label::Negative, "negative")] {
        let mut shuffled: Vec<(u64, usize)> = pairs
            .iter()
            .enumerate()
            .filter(|(_, pair)| pair.label == label)
            .map(|(row, pair)| (pair_key(hashes[pair.query], hashes[pair.reference]), row))
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
            folds[row] = place;
        }
    }
    Ok(folds)
}
