//! `label`: keyframes -> labelled pairs ([`label`]) and folds for cross-validation
//! ([`assign_folds`]).
//!
//! [`label`] visits each of the N (N - 1) / 2 pairs of keyframes once and decides whether it is
//! positive, negative or ambiguous. From each class it draws a uniform sample without replacement.
//! The sample is a bottom-k sketch (Cohen and Kaplan, "Summarizing data using bottom-k sketches",
//! PODC 2007): every pair gets a pseudo-random key from the seed and its two scans, and the pairs
//! with the smallest keys are drawn. The draw depends neither on the order of the logs nor on the
//! number of threads. Adding a log changes few of the drawn pairs.
//!
//! ```
//! use dataset::{Keyframe, Label, Pose2, ScanId};
//!
//! // Three scans of one log: two at the start, 1 m apart, and one 60 m away.
//! let keyframes: Vec<Keyframe> = [0.0, 1.0, 60.0]
//!     .into_iter()
//!     .zip(0..)
//!     .map(|(x_m, scan)| Keyframe {
//!         id: ScanId { log: "drive".into(), scan },
//!         site: "campus".into(),
//!         stamp_ns: i64::from(scan) * 1_000_000_000,
//!         pose: Pose2 { x_m, y_m: 0.0, heading_rad: 0.0 },
//!         covariance: None,
//!         z_m: None,
//!         segment: 0,
//!         frame: 0,
//!         travel_m: x_m,
//!         coverage_deg: 360.0,
//!     })
//!     .collect();
//!
//! let options = label::Options { pairs_per_class: 1, ..label::Options::default() };
//! let (pairs, candidates) = label::label(&options, 2436, &keyframes)?;
//! assert_eq!((candidates.positive, candidates.negative), (1, 2));
//! let positive = pairs.iter().find(|pair| pair.label == Label::Positive).unwrap();
//! assert_eq!((positive.query, positive.reference, positive.distance_m), (1, 0, 1.0));
//! # Ok::<(), label::LabelError>(())
//! ```

mod draw;
mod folds;

use std::sync::Arc;

use dataset::{FULL_RING_DEG, Keyframe, Label, OutOfRange, Pair};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

pub use folds::{FoldOptions, Folds, Grouping, assign_folds};

use draw::{Draw, keyframe_hash, pair_key};

/// The section `[label]`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema), schemars(rename = "LabelOptions"))]
#[serde(deny_unknown_fields, default)]
pub struct Options {
    /// A pair at most this far apart is positive \[m\].
    pub positive_radius_m: f64,
    /// Largest difference between the headings of a positive pair \[deg\]. Only used for scans
    /// that see less than a full circle.
    pub positive_heading_deg: f64,
    /// A pair more than this far apart is negative \[m\].
    pub negative_min_m: f64,
    /// Least path length between the two scans of a positive pair from one log \[m\]. With 0,
    /// neighbours along the path are positive too, as in the paper.
    pub min_travel_gap_m: f64,
    /// Number of pairs to draw from each class. The paper uses 1218.
    pub pairs_per_class: usize,
    /// Treat pairs from two different sites as negative. Sites do not share a map frame.
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
    /// Checks that every value is in range.
    pub fn check(&self) -> Result<(), OutOfRange> {
        let fail =
            |key: &str, found: f64, expected: &str| Err(OutOfRange::new(key, found, expected));
        let is_valid = |value: f64| value.is_finite() && 0.0 <= value;
        if !is_valid(self.positive_radius_m) {
            return fail("label.positive_radius_m", self.positive_radius_m, "0 or more");
        }
        if !is_valid(self.positive_heading_deg) || 180.0 < self.positive_heading_deg {
            return fail("label.positive_heading_deg", self.positive_heading_deg, "0 to 180");
        }
        if !is_valid(self.negative_min_m) || self.negative_min_m < self.positive_radius_m {
            return fail(
                "label.negative_min_m",
                self.negative_min_m,
                "`label.positive_radius_m` or more",
            );
        }
        if !is_valid(self.min_travel_gap_m) {
            return fail("label.min_travel_gap_m", self.min_travel_gap_m, "0 or more");
        }
        if self.pairs_per_class == 0 {
            return fail("label.pairs_per_class", 0.0, "1 or more");
        }
        Ok(())
    }
}

/// Number of pairs of keyframes of each kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Candidates {
    /// Within `positive_radius_m`, and within the limits on heading and path length.
    pub positive: u64,
    /// More than `negative_min_m` apart, or from two sites if `cross_site_negatives` is set.
    pub negative: u64,
    /// Neither positive nor negative, by distance or heading; left out.
    pub ambiguous: u64,
    /// Close enough, but with less than `min_travel_gap_m` of path in between; left out.
    pub short_travel_gap: u64,
    /// From two sites, which do not share a map frame; left out.
    pub without_common_frame: u64,
}

/// Why pairs could not be drawn or assigned to folds.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum LabelError {
    /// A class has fewer candidates than requested.
    #[error(
        "found {found} {class} pairs among {n_keyframes} keyframes, but `label.pairs_per_class` asks for {wanted} ({counts}); {remedy}"
    )]
    TooFew {
        /// `positive` or `negative`.
        class: &'static str,
        /// Number of candidates of this class.
        found: u64,
        /// Number of pairs requested.
        wanted: usize,
        /// Number of keyframes.
        n_keyframes: usize,
        /// Number of pairs of each kind, as text.
        counts: String,
        /// What the user can change.
        remedy: String,
    },
    /// An option is out of range.
    #[error(transparent)]
    OutOfRange(#[from] OutOfRange),
    /// There are too few groups to hold one out.
    #[error(
        "grouping `{grouping}` needs 2 {groups} or more, found {found}; add logs, or leave `{grouping}` out of `evaluate.groupings`"
    )]
    TooFewGroups {
        /// The grouping.
        grouping: &'static str,
        /// The plural, for the message.
        groups: &'static str,
        /// Number of groups.
        found: usize,
    },
    /// A class has fewer pairs than there are folds.
    #[error(
        "{folds} folds need at least {folds} pairs of each class, found {found} {class} pairs; lower `evaluate.folds` or raise `label.pairs_per_class`"
    )]
    TooFewForFolds {
        /// Number of folds requested.
        folds: u32,
        /// `positive` or `negative`.
        class: &'static str,
        /// Number of pairs of this class.
        found: usize,
    },
}

/// The outcome of the label rules for a pair of keyframes.
enum Kind {
    Labelled(Label),
    Ambiguous,
    ShortTravelGap,
    WithoutCommonFrame,
}

/// Draws `pairs_per_class` positive and the same number of negative pairs, sorted by query and
/// reference. Also counts the candidates.
///
/// Fails when an option is out of range or a class has too few candidates.
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

/// The label of a pair of keyframes by the rules in `options`, without the limit on the path
/// length; the caller decides about that. `None` if the pair is ambiguous or has no common frame.
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

/// Path length between two keyframes \[m\]; infinite for keyframes of two logs.
fn travel_gap_m(a: &Keyframe, b: &Keyframe) -> f64 {
    if same_name(&a.id.log, &b.id.log) { (a.travel_m - b.travel_m).abs() } else { f64::INFINITY }
}

/// Compares two shared names; equal pointers save comparing the text.
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
