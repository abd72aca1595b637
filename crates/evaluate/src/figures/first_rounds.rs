//! The pairs over the first two selected features (the paper's Figure 2).

use dataset::Label;
use maud::{Markup, html};

use super::chart::ticks;
use super::svg::{dots, px};
use crate::Input;
use crate::text::distinct;

/// Pairs over the differences of two features, with a threshold on each.
pub(super) struct Scatter {
    pub(super) id: String,
    /// The thresholds on x and y.
    pub(super) thresholds: [FeatureThreshold; 2],
    /// Feature differences of the positive pairs, `(n, 2)`.
    pub(super) positive: Vec<[f64; 2]>,
    /// Feature differences of the negative pairs, `(n, 2)`.
    pub(super) negative: Vec<[f64; 2]>,
}

/// The feature and threshold that a boosting round selects.
pub(super) struct FeatureThreshold {
    /// The feature's name.
    pub(super) feature: String,
    /// The round, starting at 1.
    pub(super) round: u32,
    /// The threshold on the feature difference.
    pub(super) threshold: f64,
}

const WIDTH: f64 = 480.0;
const HEIGHT: f64 = 400.0;
const LEFT: f64 = 66.0;
const RIGHT: f64 = 14.0;
const TOP: f64 = 24.0;
const BOTTOM: f64 = 70.0;
/// Share of the pairs inside each axis; the others are outside the plot.
const SHOWN: f64 = 0.97;

/// The pairs over the first two distinct features that a learner selects. The learner is the first
/// one with thresholds on both.
pub(super) fn scatter(input: &Input<'_>) -> Option<Scatter> {
    let thresholds_of = |learner: &str| -> Option<[FeatureThreshold; 2]> {
        let mut found: Vec<FeatureThreshold> = Vec::new();
        for r in input.rounds.iter().filter(|r| r.held_out.is_none() && r.learner == learner) {
            if found.iter().all(|t| t.feature != r.feature) {
                let (feature, threshold) = (r.feature.clone(), r.threshold?);
                found.push(FeatureThreshold { feature, round: r.round, threshold });
            }
            if found.len() == 2 {
                break;
            }
        }
        found.try_into().ok()
    };
    let learners = distinct(input.rounds.iter().map(|r| &*r.learner));
    let thresholds = learners.into_iter().find_map(thresholds_of)?;
    let column =
        |t: &FeatureThreshold| input.features.names.iter().position(|name| *name == t.feature);
    let (x, y) = (column(&thresholds[0])?, column(&thresholds[1])?);
    let points = |label: Label| -> Vec<[f64; 2]> {
        let of_label = input.pairs.iter().filter(|p| p.label == label);
        of_label
            .map(|p| {
                let (a, b) = (input.features.row(p.query), input.features.row(p.reference));
                [(a[x] - b[x]).abs(), (a[y] - b[y]).abs()]
            })
            .collect()
    };
    let (positive, negative) = (points(Label::Positive), points(Label::Negative));
    Some(Scatter { id: "first-rounds".to_owned(), thresholds, positive, negative })
}

impl Scatter {
    pub(super) fn svg(&self) -> Markup {
        let max = [self.axis_max(0), self.axis_max(1)];
        let (right, bottom) = (WIDTH - RIGHT, HEIGHT - BOTTOM);
        let at = |p: [f64; 2]| {
            (LEFT + p[0] / max[0] * (right - LEFT), bottom - p[1] / max[1] * (bottom - TOP))
        };
        let inside = |p: &&[f64; 2]| p[0] <= max[0] && p[1] <= max[1];
        let cloud = |points: &[[f64; 2]]| dots(points.iter().filter(inside).map(|p| at(*p)));
        let [x, y] = &self.thresholds;
        let (threshold_x, threshold_y) = (at([x.threshold, 0.0]).0, at([0.0, y.threshold]).1);
        let n_outside = self.positive.iter().chain(&self.negative).filter(|p| !inside(p)).count();
        let format_tick = |max: f64| -> fn(f64) -> String {
            if max < 1.0 {
                |v| format!("{v:.2}")
            } else if max < 10.0 {
                |v| format!("{v:.1}")
            } else {
                |v| format!("{v:.0}")
            }
        };
        html! {
            svg id=(self.id) class="chart" viewBox={ "0 0 " (WIDTH) " " (HEIGHT) } role="img"
                aria-label={ "Pairs by the differences of " (x.feature) " and " (y.feature) ", with the thresholds of rounds " (x.round) " and " (y.round) } {
                g class="grid" {
                    @for tick in ticks(0.0, max[0]) { path d={ "M" (px(at([tick, 0.0]).0)) " " (TOP) "V" (bottom) } {} }
                    @for tick in ticks(0.0, max[1]) { path d={ "M" (LEFT) " " (px(at([0.0, tick]).1)) "H" (right) } {} }
                }
                g class="ticks" {
                    @for tick in ticks(0.0, max[0]) { text x=(px(at([tick, 0.0]).0)) y=(bottom + 17.0) text-anchor="middle" { (format_tick(max[0])(tick)) } }
                    @for tick in ticks(0.0, max[1]) { text x=(LEFT - 7.0) y=(px(at([0.0, tick]).1 + 4.0)) text-anchor="end" { (format_tick(max[1])(tick)) } }
                    text class="axis-title" x=(px(f64::midpoint(LEFT, right))) y=(bottom + 37.0) text-anchor="middle" { "difference of " (x.feature) }
                    text class="axis-title" transform={ "translate(15 " (px(f64::midpoint(TOP, bottom))) ") rotate(-90)" } text-anchor="middle" { "difference of " (y.feature) }
                }
                path class="dots negative-dots" d=(cloud(&self.negative)) {}
                path class="dots positive-dots" d=(cloud(&self.positive)) {}
                @if x.threshold <= max[0] {
                    path class="threshold" d={ "M" (px(threshold_x)) " " (TOP) "V" (bottom) } { title { "round " (x.round) ": " (x.feature) " < " (format!("{:.4}", x.threshold)) } }
                    text class="threshold-name" x=(px(threshold_x)) y=(TOP - 7.0) text-anchor="middle" { "round " (x.round) }
                }
                @if y.threshold <= max[1] {
                    path class="threshold" d={ "M" (LEFT) " " (px(threshold_y)) "H" (right) } { title { "round " (y.round) ": " (y.feature) " < " (format!("{:.4}", y.threshold)) } }
                    text class="threshold-name" x=(right - 2.0) y=(px(threshold_y - 6.0)) text-anchor="end" { "round " (y.round) }
                }
                g class="legend" {
                    path class="dots positive-dots" d={ "M" (LEFT + 6.0) " " (HEIGHT - 12.0) "h0" } {}
                    text x=(LEFT + 16.0) y=(HEIGHT - 7.5) { (self.positive.len()) " matches" }
                    path class="dots negative-dots" d={ "M" (LEFT + 146.0) " " (HEIGHT - 12.0) "h0" } {}
                    text x=(LEFT + 156.0) y=(HEIGHT - 7.5) { (self.negative.len()) " non-matches" }
                    text class="faint" x=(right) y=(HEIGHT - 7.5) text-anchor="end" { (n_outside) " outside" }
                }
            }
        }
    }

    /// The maximum of an axis: above [`SHOWN`] of the pairs and above the threshold.
    fn axis_max(&self, feature: usize) -> f64 {
        let mut values: Vec<f64> =
            self.positive.iter().chain(&self.negative).map(|p| p[feature]).collect();
        values.sort_by(f64::total_cmp);
        let index = (values.len().saturating_sub(1) as f64 * SHOWN) as usize;
        let max =
            values.get(index).copied().unwrap_or(1.0).max(self.thresholds[feature].threshold * 1.1);
        if 0.0 < max { max } else { 1.0 }
    }
}
