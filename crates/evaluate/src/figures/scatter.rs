use maud::{Markup, html};

use super::chart::ticks;
use super::{dots, px};

/// Pairs over two features, with the thresholds that cut them (the paper's Figure 2).
pub(crate) struct Scatter {
    pub(crate) id: String,
    /// The two cuts; x first.
    pub(crate) cuts: [Cut; 2],
    /// Feature differences of the positive pairs, `(n, 2)`.
    pub(crate) positive: Vec<[f64; 2]>,
    /// Of the negative pairs.
    pub(crate) negative: Vec<[f64; 2]>,
}

/// What a round of boosting chose.
pub(crate) struct Cut {
    /// The feature's name.
    pub(crate) feature: String,
    /// The round, from 1.
    pub(crate) round: u32,
    /// The threshold on the difference.
    pub(crate) threshold: f64,
}

const WIDTH: f64 = 480.0;
const HEIGHT: f64 = 400.0;
const LEFT: f64 = 66.0;
const RIGHT: f64 = 14.0;
const TOP: f64 = 24.0;
const BOTTOM: f64 = 70.0;
/// Share of the pairs within the axes; the rest lies beyond.
const SHOWN: f64 = 0.97;

impl Scatter {
    pub(crate) fn svg(&self) -> Markup {
        let most = [self.most(0), self.most(1)];
        let (right, bottom) = (WIDTH - RIGHT, HEIGHT - BOTTOM);
        let at = |p: [f64; 2]| {
            (LEFT + p[0] / most[0] * (right - LEFT), bottom - p[1] / most[1] * (bottom - TOP))
        };
        let inside = |p: &&[f64; 2]| p[0] <= most[0] && p[1] <= most[1];
        let cloud = |points: &[[f64; 2]]| dots(points.iter().filter(inside).map(|p| at(*p)));
        let [x, y] = &self.cuts;
        let (cut_x, cut_y) = (at([x.threshold, 0.0]).0, at([0.0, y.threshold]).1);
        let n_beyond = self.positive.iter().chain(&self.negative).filter(|p| !inside(p)).count();
        let write = |most: f64| -> fn(f64) -> String {
            if most < 1.0 {
                |v| format!("{v:.2}")
            } else if most < 10.0 {
                |v| format!("{v:.1}")
            } else {
                |v| format!("{v:.0}")
            }
        };
        html! {
            svg id=(self.id) class="chart" viewBox={ "0 0 " (WIDTH) " " (HEIGHT) } role="img"
                aria-label={ "Pairs over the differences of " (x.feature) " and " (y.feature) ", with the thresholds of rounds " (x.round) " and " (y.round) } {
                g class="grid" {
                    @for tick in ticks(0.0, most[0]) { path d={ "M" (px(at([tick, 0.0]).0)) " " (TOP) "V" (bottom) } {} }
                    @for tick in ticks(0.0, most[1]) { path d={ "M" (LEFT) " " (px(at([0.0, tick]).1)) "H" (right) } {} }
                }
                g class="ticks" {
                    @for tick in ticks(0.0, most[0]) { text x=(px(at([tick, 0.0]).0)) y=(bottom + 17.0) text-anchor="middle" { (write(most[0])(tick)) } }
                    @for tick in ticks(0.0, most[1]) { text x=(LEFT - 7.0) y=(px(at([0.0, tick]).1 + 4.0)) text-anchor="end" { (write(most[1])(tick)) } }
                    text class="axis-title" x=(px(f64::midpoint(LEFT, right))) y=(bottom + 37.0) text-anchor="middle" { "difference of " (x.feature) }
                    text class="axis-title" transform={ "translate(15 " (px(f64::midpoint(TOP, bottom))) ") rotate(-90)" } text-anchor="middle" { "difference of " (y.feature) }
                }
                path class="dots negative-dots" d=(cloud(&self.negative)) {}
                path class="dots positive-dots" d=(cloud(&self.positive)) {}
                @if x.threshold <= most[0] {
                    path class="cut" d={ "M" (px(cut_x)) " " (TOP) "V" (bottom) } { title { "round " (x.round) ": " (x.feature) " < " (format!("{:.4}", x.threshold)) } }
                    text class="cut-name" x=(px(cut_x)) y=(TOP - 7.0) text-anchor="middle" { "round " (x.round) }
                }
                @if y.threshold <= most[1] {
                    path class="cut" d={ "M" (LEFT) " " (px(cut_y)) "H" (right) } { title { "round " (y.round) ": " (y.feature) " < " (format!("{:.4}", y.threshold)) } }
                    text class="cut-name" x=(right - 2.0) y=(px(cut_y - 6.0)) text-anchor="end" { "round " (y.round) }
                }
                g class="legend" {
                    path class="dots positive-dots" d={ "M" (LEFT + 6.0) " " (HEIGHT - 12.0) "h0" } {}
                    text x=(LEFT + 16.0) y=(HEIGHT - 7.5) { (self.positive.len()) " same place" }
                    path class="dots negative-dots" d={ "M" (LEFT + 146.0) " " (HEIGHT - 12.0) "h0" } {}
                    text x=(LEFT + 156.0) y=(HEIGHT - 7.5) { (self.negative.len()) " another place" }
                    text class="faint" x=(right) y=(HEIGHT - 7.5) text-anchor="end" { (n_beyond) " beyond" }
                }
            }
        }
    }

    /// The end of an axis: most pairs lie below, and the threshold does.
    fn most(&self, feature: usize) -> f64 {
        let mut values: Vec<f64> =
            self.positive.iter().chain(&self.negative).map(|p| p[feature]).collect();
        values.sort_by(f64::total_cmp);
        let place = (values.len().saturating_sub(1) as f64 * SHOWN) as usize;
        let most =
            values.get(place).copied().unwrap_or(1.0).max(self.cuts[feature].threshold * 1.1);
        if 0.0 < most { most } else { 1.0 }
    }
}
