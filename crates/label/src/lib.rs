//! `label`: keyframes -> labelled pairs ([`label`]) and folds for cross-validation
//! ([`assign_folds`]).
//!
//! Each of the N (N - 1) / 2 pairs of keyframes is positive, negative or ambiguous. [`label`] counts them
//! without visiting all of them (`candidates.rs`), and draws a uniform sample of each class without
//! replacement, with a limited share from each place (`draw.rs`, `spread.rs`). Pairs are drawn by their rank
//! in an order of the candidates (`tree.rs`). The draw depends neither on the order of the logs nor on the
//! number of threads.
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
//!         map: None,
//!         travel_m: x_m,
//!         coverage_deg: 360.0,
//!     })
//!     .collect();
//!
//! let options = label::Options { pairs_per_class: 1, ..label::Options::default() };
//! let labelled = label::label(&options, 2436, &keyframes)?;
//! assert_eq!((labelled.candidates.positive, labelled.candidates.negative), (1, 2));
//! let positive = labelled.pairs.iter().find(|pair| pair.label == Label::Positive).unwrap();
//! assert_eq!((positive.query, positive.reference, positive.distance_m), (1, 0, 1.0));
//! # Ok::<(), label::LabelError>(())
//! ```

mod candidates;
mod copies;
mod draw;
mod folds;
mod names;
mod options;
mod rules;
mod spread;
mod tree;
mod uncertainty;

use dataset::{Keyframe, Label, Note, NoteKind, OutOfRange, Pair};
use rayon::prelude::*;

pub use folds::{FoldOptions, Folds, Grouping, assign_folds};
pub use options::Options;
pub use rules::{Candidates, Rules};
pub use uncertainty::{ALIGNMENT_STD_M, Measurement, PoseGraph, Vertex};

use candidates::Ranked;
use rules::Heights;
use spread::Class;
use tree::{Square, Tree};

/// Labelled pairs, and how they were selected.
#[derive(Debug, Clone, PartialEq)]
pub struct Labelled {
    /// The drawn pairs, sorted by query and reference.
    pub pairs: Vec<Pair>,
    /// The number of pairs of each kind that the pairs were drawn from.
    pub candidates: Candidates,
    /// Remarks about the draw.
    pub notes: Vec<Note>,
}

/// Why pairs could not be drawn or assigned to folds.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum LabelError {
    /// A class has fewer candidates than requested.
    #[error(
        "found {n_positive} positive and {n_negative} negative pairs among {n_keyframes} keyframes, but `label.pairs_per_class` asks for {wanted} of each ({counts}); {remedy}"
    )]
    TooFew {
        /// Number of positive candidates.
        n_positive: u64,
        /// Number of negative candidates.
        n_negative: u64,
        /// Number of pairs requested from each class.
        wanted: usize,
        /// Number of keyframes.
        n_keyframes: usize,
        /// Number of pairs that were left out, by reason, as text.
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
    /// There are two groups, and pairs between them.
    #[error(
        "grouping `{grouping}` cannot be evaluated with 2 {groups}: to test the pairs between the two ({n_between}), both must be held out, which leaves no pairs to train on; add a third, or leave `{grouping}` out of `evaluate.groupings`"
    )]
    TwoGroups {
        /// The grouping.
        grouping: &'static str,
        /// The plural, for the message.
        groups: &'static str,
        /// Number of pairs between the two groups.
        n_between: usize,
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

/// Draws `pairs_per_class` positive and the same number of negative pairs, with a limited share from
/// each place. Also counts the candidates.
///
/// Fails when an option is out of range or a class has too few candidates.
pub fn label(options: &Options, seed: u64, keyframes: &[Keyframe]) -> Result<Labelled, LabelError> {
    options.check()?;
    draw(&Rules::new(options, keyframes), options, seed, keyframes)
}

/// As [`label`], with poses that rest on measurements. Pairs whose label the poses cannot decide are left
/// out: their distance is less than two standard deviations from the radius of their class.
pub fn label_by_graph(
    options: &Options,
    seed: u64,
    keyframes: &[Keyframe],
    graph: &PoseGraph,
) -> Result<Labelled, LabelError> {
    options.check()?;
    let rules = Rules::with_graph(options, keyframes, graph);
    let mut labelled = draw(&rules, options, seed, keyframes)?;
    for of_query in labelled.pairs.chunk_by_mut(|a, b| a.query == b.query) {
        let stds_m = graph.distance_stds_m(keyframes, of_query[0].query);
        for pair in of_query.iter_mut().filter(|pair| pair.heading_difference_rad.is_some()) {
            pair.distance_std_m = stds_m[pair.reference];
        }
    }
    labelled.notes.extend(undecided_note(labelled.candidates));
    Ok(labelled)
}

fn draw(
    rules: &Rules<'_>,
    options: &Options,
    seed: u64,
    keyframes: &[Keyframe],
) -> Result<Labelled, LabelError> {
    let tree = Tree::new(rules, keyframes);
    let ranked = Ranked::new(rules, &tree);
    let candidates = ranked.tally.candidates;
    check_enough(options, keyframes, candidates)?;
    let mut pairs: Vec<Pair> = Vec::with_capacity(2 * options.pairs_per_class);
    let mut notes = Vec::new();
    for label in [Label::Positive, Label::Negative] {
        let first =
            |square: &Square| &keyframes[tree.keyframes[square.root.range().start] as usize];
        let places = tree.squares.iter().map(first).collect();
        let class = Class { label, firsts: ranked.of_squares(label), keyframes: places };
        let spread = class.draw(options, seed);
        let drawn = spread.ranks.into_par_iter();
        let drawn = drawn.filter_map(|rank| ranked.candidate(label, rank));
        pairs.par_extend(drawn.map(|ends| pair(rules, keyframes, label, ends)));
        notes.extend(spread.note);
    }
    pairs.sort_by_key(|pair| (pair.query, pair.reference));
    notes.extend(height_note(options, candidates, ranked.tally.heights));
    notes.extend(frame_note(candidates));
    notes.extend(copies::notes(keyframes));
    Ok(Labelled { pairs, candidates, notes })
}

fn pair(
    rules: &Rules<'_>,
    keyframes: &[Keyframe],
    label: Label,
    (query, reference): (usize, usize),
) -> Pair {
    let (a, b) = (&keyframes[query], &keyframes[reference]);
    let shares_frame = rules.shares_frame(query, reference);
    Pair {
        query,
        reference,
        label,
        distance_m: if shares_frame { a.pose.distance_m(&b.pose) } else { f64::INFINITY },
        distance_std_m: None,
        heading_difference_rad: shares_frame.then(|| a.pose.heading_difference_rad(&b.pose)),
        travel_gap_m: rules.travel_gap_m(query, reference),
    }
}

/// Share of the revisits at another height above which the heights are in doubt. A drive on two
/// floors has revisits on each of them; a drift in height separates nearly all revisits.
const MOST_REVISITS: f64 = 0.9;

/// Share of the pairs left out by height, above which the heights are in doubt, of pairs with more
/// than half of the allowed difference. Between two floors there are only the pairs on ramps. Noise
/// and drift have no gap there.
const MANY_NEAR_LIMIT: f64 = 0.1;

/// What the height limit left out, as a warning if noise or drift explain it better than floors.
fn height_note(options: &Options, candidates: Candidates, heights: Heights) -> Option<Note> {
    let n_pairs = candidates.other_height;
    let max_height_difference_m = options.max_height_difference_m;
    let Heights { upper_half, revisits, revisits_left_out } = heights;
    if n_pairs == 0 {
        return None;
    }
    let most = MOST_REVISITS * (revisits + revisits_left_out) as f64;
    let is_drift = most < revisits_left_out as f64;
    let has_no_gap = MANY_NEAR_LIMIT * n_pairs as f64 <= upper_half as f64;
    Some(Note::from(match is_drift || has_no_gap {
        false => NoteKind::PairsAtOtherHeight { n_pairs, max_height_difference_m },
        true => NoteKind::HeightsInDoubt {
            n_pairs,
            max_height_difference_m,
            n_revisits: revisits,
            n_revisits_left_out: revisits_left_out,
            n_near_limit: upper_half,
        },
    }))
}

/// What the uncertainty of the distances left out, as a warning if it is most of a class.
fn undecided_note(candidates: Candidates) -> Option<Note> {
    let Candidates { positive, negative, undecided_positive, undecided_negative, .. } = candidates;
    if undecided_positive + undecided_negative == 0 {
        return None;
    }
    Some(Note::from(match positive < undecided_positive || negative < undecided_negative {
        false => NoteKind::UndecidedPairs {
            n_positive: undecided_positive,
            n_negative: undecided_negative,
        },
        true => NoteKind::PosesTooUncertain {
            n_positive: undecided_positive,
            n_decided_positive: positive,
            n_negative: undecided_negative,
            n_decided_negative: negative,
        },
    }))
}

fn frame_note(candidates: Candidates) -> Option<Note> {
    let n_pairs = candidates.other_frame;
    (0 < n_pairs).then(|| NoteKind::PairsBetweenFrames { n_pairs }.into())
}

/// Checks both classes, so that one error names the number of pairs that works for both.
fn check_enough(
    options: &Options,
    keyframes: &[Keyframe],
    candidates: Candidates,
) -> Result<(), LabelError> {
    let wanted = options.pairs_per_class;
    let Candidates { positive, negative, .. } = candidates;
    let is_short = |n: u64| n < wanted as u64;
    if !is_short(positive) && !is_short(negative) {
        return Ok(());
    }
    let mut remedies = Vec::new();
    if is_short(positive) {
        remedies.push(
            "for more positive pairs, raise `label.positive_radius_m` or `label.positive_heading_deg`, or lower `label.min_travel_gap_m`",
        );
        if 0 < candidates.other_height {
            remedies.push("if the heights drift, raise `label.max_height_difference_m`");
        }
        if 0 < candidates.undecided_positive {
            remedies.push(
                "the poses of the map are too uncertain for some positive pairs: a map with more closures decides more of them",
            );
        }
        if 0 < candidates.other_frame {
            remedies.push(
                "if the poses before and after a jump are in one map, set `ingest.pose.jumps = \"same_frame\"`",
            );
        }
    }
    if is_short(negative) {
        remedies.push(
            "for more negative pairs, lower `label.negative_min_m`, give logs of one map frame the same `site`, or set `label.cross_site_negatives`",
        );
    }
    remedies.push("or add logs");
    let mut remedy = remedies.join("; ");
    let enough_for_both = positive.min(negative);
    if 0 < enough_for_both {
        remedy.push_str(&format!(
            "; `label.pairs_per_class = {enough_for_both}` works for both classes"
        ));
    }
    Err(LabelError::TooFew {
        n_positive: positive,
        n_negative: negative,
        wanted,
        n_keyframes: keyframes.len(),
        counts: candidates.left_out(),
        remedy,
    })
}
