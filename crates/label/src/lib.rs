//! `label`: keyframes -> labelled pairs ([`label`]) and folds ([`folds`]).
//!
//! Every pair of keyframes that share a map frame is looked at once: N (N - 1) / 2 distances. Each
//! is positive, negative or ambiguous, and of each class a uniform sample without replacement is
//! drawn as a bottom-k sketch: every pair gets a pseudo-random key from the seed and the names of
//! its two scans, and the pairs with the smallest keys are drawn (Cohen and Kaplan, "Summarizing
//! data using bottom-k sketches", PODC 2007). The draw therefore depends neither on the order of
//! the logs nor on the number of threads, and a log added changes it little.

mod draw;
mod folds;

use std::sync::Arc;

use dataset::{FULL_RING_DEG, Keyframe, Label, Pair};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

pub use folds::{FoldOptions, Folds, Grouping, assign_folds};

use draw::{Draw, keyframe_hash, pair_key};

/// The section `[label]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "LabelOptions"))]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// A pair within this distance is positive \[m\].
    pub positive_radius_m: f64,
    /// For scans that see less than a full circle: a positive pair's headings differ by no more
    /// than this \[deg\].
    pub positive_heading_deg: f64,
    /// A pair farther apart than this is negative \[m\].
    pub negative_min_m: f64,
    /// A positive pair of one log has at least this much path between its scans \[m\]; 0 takes
    /// neighbours along the path too, as the paper does.
    pub min_travel_gap_m: f64,
    /// Pairs drawn of each class; 1218 in the paper.
    pub pairs_per_class: usize,
    /// Take pairs of two sites, which share no map frame, as negatives.
    pub cross_site_negatives: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            positive_radius_m: 1.5,
            positive_heading_deg: 180.0,
            negative_min_m: 50.0,
            min_travel_gap_m: 0.0,
            pairs_per_class: 1218,
            cross_site_negatives: false,
        }
    }
}

impl Options {
    /// Refuses values out of range.
    pub fn check(&self) -> Result<(), LabelError> {
        let fail = |key, found, expected| Err(LabelError::Option { key, found, expected });
        let good = |value: f64| value.is_finite() && 0.0 <= value;
        if !good(self.positive_radius_m) {
            return fail("label.positive_radius_m", self.positive_radius_m, "0 or more");
        }
        if !good(self.positive_heading_deg) || 180.0 < self.positive_heading_deg {
            return fail("label.positive_heading_deg", self.positive_heading_deg, "0 to 180");
        }
        if !good(self.negative_min_m) || self.negative_min_m < self.positive_radius_m {
            return fail(
                "label.negative_min_m",
                self.negative_min_m,
                "`label.positive_radius_m` or more",
            );
        }
        if !good(self.min_travel_gap_m) {
            return fail("label.min_travel_gap_m", self.min_travel_gap_m, "0 or more");
        }
        if self.pairs_per_class == 0 {
            return fail("label.pairs_per_class", 0.0, "1 or more");
        }
        Ok(())
    }
}

/// How many pairs of keyframes there are of each kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Candidates {
    /// Within `positive_radius_m`, with the heading and the path that the options ask for.
    pub positive: u64,
    /// Beyond `negative_min_m`, or of two sites where the options take these.
    pub negative: u64,
    /// Neither near nor far enough, or near with another heading: left out.
    pub ambiguous: u64,
    /// Near, but with less than `min_travel_gap_m` of path between: left out.
    pub short_travel_gap: u64,
    /// Of two sites, which share no map frame: left out.
    pub without_common_frame: u64,
}

/// Why there are no pairs.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum LabelError {
    /// Fewer candidates of a class than asked for.
    #[error(
        "{found} {class} pairs among {n_keyframes} keyframes, `label.pairs_per_class` asks for {wanted} ({counts}); {remedy}"
    )]
    TooFew {
        /// `positive` or `negative`.
        class: &'static str,
        /// Candidates there are.
        found: u64,
        /// Pairs asked for.
        wanted: usize,
        /// Keyframes there are.
        n_keyframes: usize,
        /// The other kinds.
        counts: String,
        /// What else could be changed.
        remedy: String,
    },
    /// An option out of range.
    #[error("`{key}` is {found}, expected {expected}")]
    Option {
        /// The option.
        key: &'static str,
        /// Its value.
        found: f64,
        /// What it must be.
        expected: &'static str,
    },
    /// A grouping that leaves nothing to hold out.
    #[error(
        "grouping `{grouping}` needs 2 {groups} or more, found {found}; add logs, or leave `{grouping}` out of `evaluate.groupings`"
    )]
    TooFewGroups {
        /// The grouping.
        grouping: &'static str,
        /// What its groups are called.
        groups: &'static str,
        /// Groups there are.
        found: usize,
    },
    /// More folds than pairs of a class.
    #[error(
        "{folds} folds need at least {folds} pairs of each class, there are {found} {class} ones; lower `evaluate.folds` or raise `label.pairs_per_class`"
    )]
    TooFewForFolds {
        /// Folds asked for.
        folds: u32,
        /// `positive` or `negative`.
        class: &'static str,
        /// Pairs there are.
        found: usize,
    },
}

/// What a pair of keyframes is.
enum Kind {
    Labelled(Label),
    Ambiguous,
    ShortTravelGap,
    WithoutCommonFrame,
}

/// Draws `pairs_per_class` positive and as many negative pairs, in order of the keyframes.
pub fn label(
    options: &Options,
    seed: u64,
    keyframes: &[Keyframe],
) -> Result<(Vec<Pair>, Candidates), LabelError> {
    options.check()?;
    let hashes: Vec<u64> = keyframes.iter().map(|k| keyframe_hash(seed, k)).collect();
    let wanted = options.pairs_per_class;
    let start = || (Candidates::default(), Draw::new(wanted), Draw::new(wanted));

    let (candidates, positive, negative) = (0..keyframes.len())
        .into_par_iter()
        .fold(start, |(mut counts, mut positive, mut negative), query| {
            for reference in 0..query {
                let key = || (pair_key(hashes[query], hashes[reference]), query, reference);
                match kind(options, &keyframes[query], &keyframes[reference]) {
                    Kind::Labelled(Label::Positive) => {
                        counts.positive += 1;
                        positive.offer(key());
                    }
                    Kind::Labelled(Label::Negative) => {
                        counts.negative += 1;
                        negative.offer(key());
                    }
                    Kind::Ambiguous => counts.ambiguous += 1,
                    Kind::ShortTravelGap => counts.short_travel_gap += 1,
                    Kind::WithoutCommonFrame => counts.without_common_frame += 1,
                }
            }
            (counts, positive, negative)
        })
        .reduce(start, |a, b| (a.0.plus(b.0), a.1.union(b.1), a.2.union(b.2)));

    check_enough(Label::Positive, candidates.positive, wanted, keyframes, candidates)?;
    check_enough(Label::Negative, candidates.negative, wanted, keyframes, candidates)?;
    let pair = |label| {
        move |(query, reference): (usize, usize)| {
            let (a, b) = (&keyframes[query], &keyframes[reference]);
            let shares_frame = a.site == b.site;
            Pair {
                query,
                reference,
                label,
                distance_m: if shares_frame { a.pose.distance_m(&b.pose) } else { f64::INFINITY },
                heading_difference_rad: shares_frame
                    .then(|| a.pose.heading_difference_rad(&b.pose)),
                travel_gap_m: travel_gap_m(a, b),
            }
        }
    };
    let mut pairs: Vec<Pair> = positive
        .into_pairs()
        .map(pair(Label::Positive))
        .chain(negative.into_pairs().map(pair(Label::Negative)))
        .collect();
    pairs.sort_by_key(|pair| (pair.query, pair.reference));
    Ok((pairs, candidates))
}

/// The label of two keyframes of one log by the label rules; none where they are neither near nor
/// far enough. How far apart they are along the path is left to the caller.
pub fn label_of(options: &Options, a: &Keyframe, b: &Keyframe) -> Option<Label> {
    match kind(options, a, b) {
        Kind::Labelled(label) => Some(label),
        Kind::ShortTravelGap => Some(Label::Positive),
        Kind::Ambiguous | Kind::WithoutCommonFrame => None,
    }
}

fn kind(options: &Options, a: &Keyframe, b: &Keyframe) -> Kind {
    if !same_name(&a.site, &b.site) {
        return match options.cross_site_negatives {
            true => Kind::Labelled(Label::Negative),
            false => Kind::WithoutCommonFrame,
        };
    }
    let distance_m = a.pose.distance_m(&b.pose);
    if options.negative_min_m < distance_m {
        return Kind::Labelled(Label::Negative);
    }
    let sees_full_circle = FULL_RING_DEG <= a.coverage_deg.min(b.coverage_deg);
    let near = distance_m <= options.positive_radius_m
        && (sees_full_circle
            || a.pose.heading_difference_rad(&b.pose) <= options.positive_heading_deg.to_radians());
    if !near {
        Kind::Ambiguous
    } else if travel_gap_m(a, b) < options.min_travel_gap_m {
        Kind::ShortTravelGap
    } else {
        Kind::Labelled(Label::Positive)
    }
}

/// Path between two keyframes \[m\]; no path joins two logs.
fn travel_gap_m(a: &Keyframe, b: &Keyframe) -> f64 {
    if same_name(&a.id.log, &b.id.log) { (a.travel_m - b.travel_m).abs() } else { f64::INFINITY }
}

/// Equality of shared names, the pointers first.
fn same_name(a: &Arc<str>, b: &Arc<str>) -> bool {
    Arc::ptr_eq(a, b) || a == b
}

impl Candidates {
    fn plus(self, other: Self) -> Self {
        Self {
            positive: self.positive + other.positive,
            negative: self.negative + other.negative,
            ambiguous: self.ambiguous + other.ambiguous,
            short_travel_gap: self.short_travel_gap + other.short_travel_gap,
            without_common_frame: self.without_common_frame + other.without_common_frame,
        }
    }
}

fn check_enough(
    label: Label,
    found: u64,
    wanted: usize,
    keyframes: &[Keyframe],
    counts: Candidates,
) -> Result<(), LabelError> {
    if wanted as u64 <= found {
        return Ok(());
    }
    let Candidates { positive, negative, ambiguous, short_travel_gap, without_common_frame } =
        counts;
    let (class, remedy) = match label {
        Label::Positive => (
            "positive",
            "raise `label.positive_radius_m` or `label.positive_heading_deg`, lower `label.min_travel_gap_m`",
        ),
        Label::Negative => (
            "negative",
            "lower `label.negative_min_m`, give logs of one map frame the same `site`, set `label.cross_site_negatives`",
        ),
    };
    let mut remedy = format!("{remedy}, or add logs");
    if found > 0 {
        remedy.push_str(&format!("; or set `label.pairs_per_class` to {found} or less"));
    }
    Err(LabelError::TooFew {
        class,
        found,
        wanted,
        n_keyframes: keyframes.len(),
        counts: format!(
            "{positive} positive, {negative} negative, {ambiguous} ambiguous, {short_travel_gap} too close along the path, {without_common_frame} without a common frame"
        ),
        remedy,
    })
}
