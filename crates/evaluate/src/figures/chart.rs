//! A line chart.

use maud::{Markup, html};

use super::svg::{N_STYLES, polyline, px, round_length};

/// One axis of a chart.
pub(crate) struct Axis {
    /// The quantity, with its unit.
    pub(crate) title: String,
    pub(crate) min: f64,
    pub(crate) max: f64,
    pub(crate) ticks: Vec<f64>,
    /// Formats the label of a tick.
    pub(crate) format: fn(f64) -> String,
}

/// A line of a chart.
pub(crate) struct Series {
    pub(crate) name: String,
    /// Index of the colour and dash pattern.
    pub(crate) style: usize,
    pub(crate) points: Vec<(f64, f64)>,
    /// Points with a tooltip: x, y, text.
    pub(crate) marks: Vec<(f64, f64, String)>,
}

/// A value reported elsewhere, drawn as an upper bound.
pub(crate) struct Bound {
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) text: String,
}

/// Lines over two axes, with the legend below.
pub(crate) struct Chart {
    pub(crate) id: String,
    /// Text for screen readers.
    pub(crate) description: String,
    pub(crate) x: Axis,
    pub(crate) y: Axis,
    pub(crate) series: Vec<Series>,
    pub(crate) bound: Option<Bound>,
}

// The drawing is small to keep its text readable on a phone.
const WIDTH: f64 = 480.0;
const PLOT_HEIGHT: f64 = 330.0;
const LEFT: f64 = 58.0;
const RIGHT: f64 = 14.0;
const TOP: f64 = 12.0;
const BOTTOM: f64 = 48.0;
const LEGEND_ROW: f64 = 22.0;

impl Chart {
    pub(crate) fn svg(&self) -> Markup {
        let height = PLOT_HEIGHT + LEGEND_ROW * self.series.len().div_ceil(2) as f64;
        html! {
            svg id=(self.id) class="chart" viewBox={ "0 0 " (WIDTH) " " (px(height)) } role="img" aria-label=(self.description) {
                (self.axes())
                @for series in &self.series {
                    g class={ "series-" (series.style % N_STYLES) } {
                        path class="line" d=(self.polyline(&series.points)) {}
                        @for (x, y, text) in &series.marks {
                            circle cx=(px(self.at_x(*x))) cy=(px(self.at_y(*y))) r="4" { title { (text) } }
                        }
                    }
                }
                @if let Some(bound) = &self.bound { (self.bound_mark(bound)) }
                g class="legend" {
                    @for (k, series) in self.series.iter().enumerate() {
                        (self.legend_entry(k, series))
                    }
                }
            }
        }
    }

    fn axes(&self) -> Markup {
        let (bottom, right) = (PLOT_HEIGHT - BOTTOM, WIDTH - RIGHT);
        html! {
            g class="grid" {
                @for &tick in &self.x.ticks {
                    path d={ "M" (px(self.at_x(tick))) " " (TOP) "V" (bottom) } {}
                }
                @for &tick in &self.y.ticks {
                    path d={ "M" (LEFT) " " (px(self.at_y(tick))) "H" (right) } {}
                }
            }
            g class="ticks" {
                @for &tick in &self.x.ticks {
                    text x=(px(self.at_x(tick))) y=(bottom + 17.0) text-anchor="middle" { ((self.x.format)(tick)) }
                }
                @for &tick in &self.y.ticks {
                    text x=(LEFT - 7.0) y=(px(self.at_y(tick) + 4.0)) text-anchor="end" { ((self.y.format)(tick)) }
                }
                text class="axis-title" x=(px(f64::midpoint(LEFT, right))) y=(bottom + 37.0) text-anchor="middle" { (self.x.title) }
                text class="axis-title" transform={ "translate(15 " (px(f64::midpoint(TOP, bottom))) ") rotate(-90)" } text-anchor="middle" { (self.y.title) }
            }
        }
    }

    fn bound_mark(&self, bound: &Bound) -> Markup {
        let (x, y) = (self.at_x(bound.x), self.at_y(bound.y));
        // The text is on the side with more space.
        let is_left = WIDTH / 2.0 < x;
        html! {
            g class="below" {
                path d={ "M" (px(x - 12.0)) " " (px(y)) "h12m-6 0v10m-3.5 -4l3.5 4l3.5 -4" } {}
                @if is_left {
                    text x=(px(x - 17.0)) y=(px(y + 4.5)) text-anchor="end" { (bound.text) }
                } @else {
                    text x=(px(x + 5.0)) y=(px(y + 14.0)) { (bound.text) }
                }
            }
        }
    }

    fn legend_entry(&self, k: usize, series: &Series) -> Markup {
        let x = LEFT + (k % 2) as f64 * (WIDTH - LEFT - RIGHT) / 2.0;
        let y = PLOT_HEIGHT + LEGEND_ROW * (k / 2) as f64 + 8.0;
        html! {
            g class={ "series-" (series.style % N_STYLES) } {
                path class="line" d={ "M" (px(x)) " " (px(y)) "h26" } {}
                text x=(px(x + 33.0)) y=(px(y + 4.5)) { (series.name) }
            }
        }
    }

    fn polyline(&self, points: &[(f64, f64)]) -> String {
        polyline(points.iter().map(|&(x, y)| (self.at_x(x), self.at_y(y))))
    }

    fn at_x(&self, x: f64) -> f64 {
        let share = (x - self.x.min) / (self.x.max - self.x.min);
        LEFT + share * (WIDTH - LEFT - RIGHT)
    }

    /// Values outside the axis are drawn at its end.
    fn at_y(&self, y: f64) -> f64 {
        let share = ((y - self.y.min) / (self.y.max - self.y.min)).clamp(0.0, 1.0);
        PLOT_HEIGHT - BOTTOM - share * (PLOT_HEIGHT - TOP - BOTTOM)
    }
}

/// About five evenly spaced round values from `min` to `max`; `min` must be a multiple of the step.
pub(crate) fn ticks(min: f64, max: f64) -> Vec<f64> {
    let step = round_length((max - min) / 4.0);
    let n = ((max - min) / step + 1e-9).floor() as usize;
    (0..=n).map(|k| min + k as f64 * step).collect()
}
