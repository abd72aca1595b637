//! Whether two keyframes are a positive or a negative pair, or none.

use dataset::{FULL_RING_DEG, Keyframe, Label, NEIGHBOUR_GAP_M, Pose2, common_frames};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::Options;
use crate::names::numbers;
use crate::uncertainty::PoseGraph;

/// The label rules for the keyframes of a run.
#[derive(Debug, Clone)]
pub struct Rules<'a> {
    options: &'a Options,
    /// What the rules compare of each keyframe, `(n_keyframes,)`.
    rows: Vec<Row>,
    /// The pairs whose label the poses cannot decide: for each query a bit per reference,
    /// `(n_keyframes, n / 64)`. Empty if the uncertainty of the distances is not known.
    undecided: Vec<Vec<u64>>,
}

/// What the rules compare of a keyframe. It is small, because millions of them are compared.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Row {
    pub(crate) pose: Pose2,
    z_m: Option<f64>,
    travel_m: f64,
    coverage_deg: f32,
    /// The number of the keyframe.
    pub(crate) keyframe: u32,
    /// The frame of its pose, see [`common_frames`].
    pub(crate) frame: u32,
    /// Its site and its log, numbered in order of their names.
    pub(crate) site: u32,
    pub(crate) log: u32,
}

/// The label of a pair is decided if its distance is farther from the radius than so many standard
/// deviations. With a normal error, 2.3 % of the pairs exactly at this distance are on the other side.
pub(crate) const DECIDED_STDS: f64 = 2.0;

/// The outcome of the rules for a pair of keyframes.
pub(crate) enum Kind {
    Labelled(Label),
    Ambiguous,
    /// The uncertainty of the distance allows another label.
    Undecided(Label),
    OtherHeight,
    ShortTravelGap,
    OtherFrame,
    WithoutCommonFrame,
}

impl<'a> Rules<'a> {
    /// The rules of some options. The options must be in range.
    pub fn new(options: &'a Options, keyframes: &[Keyframe]) -> Self {
        let frames = common_frames(keyframes);
        let sites = numbers(keyframes.iter().map(|keyframe| &keyframe.site));
        let logs = numbers(keyframes.iter().map(|keyframe| &keyframe.id.log));
        let row = |(k, keyframe): (usize, &Keyframe)| Row {
            pose: keyframe.pose,
            z_m: keyframe.z_m,
            travel_m: keyframe.travel_m,
            coverage_deg: keyframe.coverage_deg,
            keyframe: k as u32,
            frame: frames[k],
            site: sites[k],
            log: logs[k],
        };
        let rows = keyframes.iter().enumerate().map(row).collect();
        Self { options, rows, undecided: Vec::new() }
    }

    /// As [`Rules::new`], but a pair has a label only if its distance is clearly within the positive radius, or
    /// clearly beyond the negative one: by [`DECIDED_STDS`] standard deviations.
    pub(crate) fn with_graph(
        options: &'a Options,
        keyframes: &[Keyframe],
        graph: &PoseGraph,
    ) -> Self {
        let rules = Self::new(options, keyframes);
        let bits = |query| rules.undecided(keyframes, graph, query);
        let undecided = (0..keyframes.len()).into_par_iter().map(bits).collect();
        Self { undecided, ..rules }
    }

    /// The bits of the references whose label the graph cannot decide.
    fn undecided(&self, keyframes: &[Keyframe], graph: &PoseGraph, query: usize) -> Vec<u64> {
        let mut bits = vec![0; query.div_ceil(64)];
        for (reference, std_m) in graph.distance_stds_m(keyframes, query).into_iter().enumerate() {
            let Some(std_m) = std_m.filter(|_| self.shares_frame(query, reference)) else {
                continue;
            };
            let [a, b] = [query, reference].map(|k| &self.rows[k]);
            let distance_m = a.pose.distance_m(&b.pose);
            let margin_m = match self.kind_by_distance(a, b) {
                Kind::Labelled(Label::Negative) => distance_m - self.options.negative_min_m,
                Kind::Labelled(Label::Positive) | Kind::ShortTravelGap => {
                    self.options.positive_radius_m - distance_m
                }
                _ => continue,
            };
            if margin_m < DECIDED_STDS * std_m {
                bits[reference / 64] |= 1 << (reference % 64);
            }
        }
        bits
    }

    fn is_undecided(&self, query: usize, reference: usize) -> bool {
        let bits = self.undecided.get(query);
        bits.is_some_and(|bits| bits[reference / 64] & (1 << (reference % 64)) != 0)
    }

    /// The label of a pair of keyframes, without the limit on the path length; the caller decides
    /// about that. `None` if the pair has no label: it is ambiguous, at different heights, or
    /// without a common frame.
    pub fn label_of(&self, query: usize, reference: usize) -> Option<Label> {
        match self.kind(query, reference) {
            Kind::Labelled(label) => Some(label),
            Kind::ShortTravelGap => Some(Label::Positive),
            Kind::Ambiguous
            | Kind::Undecided(_)
            | Kind::OtherHeight
            | Kind::OtherFrame
            | Kind::WithoutCommonFrame => None,
        }
    }

    /// Whether the poses of two keyframes can be compared.
    pub fn shares_frame(&self, query: usize, reference: usize) -> bool {
        self.rows[query].frame == self.rows[reference].frame
    }

    /// Path length between two keyframes \[m\]; infinite for keyframes of two logs.
    pub(crate) fn travel_gap_m(&self, query: usize, reference: usize) -> f64 {
        self.rows[query].travel_gap_m(&self.rows[reference])
    }

    pub(crate) fn options(&self) -> &'a Options {
        self.options
    }

    /// Whether all distances count as exact.
    pub(crate) fn is_exact(&self) -> bool {
        self.undecided.is_empty()
    }

    /// What the rules compare of each keyframe, `(n_keyframes,)`.
    pub(crate) fn rows(&self) -> &[Row] {
        &self.rows
    }

    fn kind(&self, query: usize, reference: usize) -> Kind {
        self.kind_of(&self.rows[query], &self.rows[reference])
    }

    /// The kind of a pair. The query has the larger number.
    #[inline]
    pub(crate) fn kind_of(&self, query: &Row, reference: &Row) -> Kind {
        match self.kind_by_distance(query, reference) {
            Kind::Labelled(label)
                if self.is_undecided(query.keyframe as usize, reference.keyframe as usize) =>
            {
                Kind::Undecided(label)
            }
            kind => kind,
        }
    }

    /// The kind of a pair with a distance that is exact.
    #[inline]
    fn kind_by_distance(&self, a: &Row, b: &Row) -> Kind {
        let options = self.options;
        if a.frame != b.frame {
            return if a.site == b.site {
                Kind::OtherFrame
            } else if options.cross_site_negatives {
                Kind::Labelled(Label::Negative)
            } else {
                Kind::WithoutCommonFrame
            };
        }
        let distance_m = a.pose.distance_m(&b.pose);
        if options.negative_min_m < distance_m {
            return Kind::Labelled(Label::Negative);
        }
        let sees_full_circle = FULL_RING_DEG <= a.coverage_deg.min(b.coverage_deg);
        let near = distance_m <= options.positive_radius_m
            && (sees_full_circle
                || a.pose.heading_difference_rad(&b.pose)
                    <= options.positive_heading_deg.to_radians());
        if !near {
            Kind::Ambiguous
        } else if a.height_difference_m(b).is_some_and(|m| options.max_height_difference_m < m) {
            Kind::OtherHeight
        } else if a.travel_gap_m(b) < options.min_travel_gap_m {
            Kind::ShortTravelGap
        } else {
            Kind::Labelled(Label::Positive)
        }
    }
}

/// Number of pairs of keyframes of each kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct Candidates {
    /// Within `positive_radius_m`, and within the limits on heading, height and path length.
    pub positive: u64,
    /// More than `negative_min_m` apart, or from two sites if `cross_site_negatives` is set.
    pub negative: u64,
    /// Neither positive nor negative, by distance or heading; left out.
    pub ambiguous: u64,
    /// Positive by the distance, but the uncertainty of the distance allows more than
    /// `positive_radius_m`; left out.
    pub undecided_positive: u64,
    /// Negative by the distance, but the uncertainty of the distance allows `negative_min_m` or less;
    /// left out.
    pub undecided_negative: u64,
    /// Close enough in the plane, but more than `max_height_difference_m` apart in height; left
    /// out.
    pub other_height: u64,
    /// Close enough, but with less than `min_travel_gap_m` of path in between; left out.
    pub short_travel_gap: u64,
    /// From one site, but not from one coordinate frame: one of the logs has several, or the poses are in two
    /// maps of a run; left out.
    pub other_frame: u64,
    /// From two sites, which do not share a map frame; left out.
    pub without_common_frame: u64,
}

impl Candidates {
    /// The pairs of neither class, by reason, as text.
    pub fn left_out(&self) -> String {
        let mut text = format!("not used: {} ambiguous", self.ambiguous);
        for (n, reason) in [
            (
                self.undecided_positive + self.undecided_negative,
                "with a label that the poses cannot decide",
            ),
            (self.other_height, "at another height"),
            (self.short_travel_gap, "too close along the path"),
            (self.other_frame, "in two coordinate frames"),
            (self.without_common_frame, "without a common map frame"),
        ] {
            if 0 < n {
                text.push_str(&format!(", {n} {reason}"));
            }
        }
        text
    }
}

/// The number of pairs of each kind, and what the heights of pairs that are close in the plane
/// look like.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Tally {
    pub(crate) candidates: Candidates,
    pub(crate) heights: Heights,
}

/// Pairs that are close in the plane and have a height.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub(crate) struct Heights {
    /// Positives with a height difference of more than half the limit.
    pub(crate) upper_half: u64,
    /// Positives that do not follow each other along the path.
    pub(crate) revisits: u64,
    /// The same, but left out because of their heights.
    pub(crate) revisits_left_out: u64,
}

impl Tally {
    #[inline]
    pub(crate) fn add(&mut self, options: &Options, kind: &Kind, a: &Row, b: &Row) {
        let of = &mut self.candidates;
        let count = match kind {
            Kind::Labelled(Label::Positive) => &mut of.positive,
            Kind::Labelled(Label::Negative) => &mut of.negative,
            Kind::Ambiguous => &mut of.ambiguous,
            Kind::Undecided(Label::Positive) => &mut of.undecided_positive,
            Kind::Undecided(Label::Negative) => &mut of.undecided_negative,
            Kind::OtherHeight => &mut of.other_height,
            Kind::ShortTravelGap => &mut of.short_travel_gap,
            Kind::OtherFrame => &mut of.other_frame,
            Kind::WithoutCommonFrame => &mut of.without_common_frame,
        };
        *count += 1;
        if matches!(kind, Kind::Labelled(Label::Positive) | Kind::OtherHeight) {
            self.add_height(options.max_height_difference_m, a, b);
        }
    }

    fn add_height(&mut self, limit_m: f64, a: &Row, b: &Row) {
        let Some(difference_m) = a.height_difference_m(b) else { return };
        let is_revisit = NEIGHBOUR_GAP_M <= a.travel_gap_m(b);
        let heights = &mut self.heights;
        if limit_m < difference_m {
            heights.revisits_left_out += u64::from(is_revisit);
        } else {
            heights.revisits += u64::from(is_revisit);
            heights.upper_half += u64::from(limit_m / 2.0 < difference_m);
        }
    }

    pub(crate) fn plus(self, other: Self) -> Self {
        let (a, b) = (self.candidates, other.candidates);
        let (c, d) = (self.heights, other.heights);
        Self {
            candidates: Candidates {
                positive: a.positive + b.positive,
                negative: a.negative + b.negative,
                ambiguous: a.ambiguous + b.ambiguous,
                undecided_positive: a.undecided_positive + b.undecided_positive,
                undecided_negative: a.undecided_negative + b.undecided_negative,
                other_height: a.other_height + b.other_height,
                short_travel_gap: a.short_travel_gap + b.short_travel_gap,
                other_frame: a.other_frame + b.other_frame,
                without_common_frame: a.without_common_frame + b.without_common_frame,
            },
            heights: Heights {
                upper_half: c.upper_half + d.upper_half,
                revisits: c.revisits + d.revisits,
                revisits_left_out: c.revisits_left_out + d.revisits_left_out,
            },
        }
    }
}

impl Row {
    /// Difference between the heights \[m\]; `None` if one of them is not known.
    fn height_difference_m(&self, other: &Self) -> Option<f64> {
        Some((self.z_m? - other.z_m?).abs())
    }

    /// Path length between two keyframes \[m\]; infinite for keyframes of two logs.
    pub(crate) fn travel_gap_m(&self, other: &Self) -> f64 {
        if self.log == other.log { (self.travel_m - other.travel_m).abs() } else { f64::INFINITY }
    }
}
