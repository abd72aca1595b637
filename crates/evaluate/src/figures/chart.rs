use maud::{Markup, html};

use super::map::polyline;
use super::{N_STYLES, px, round_length};

/// One axis of a chart.
pub(crate) struct Axis {
    /// What it shows, with its unit.
    pub(crate) title: String,
    pub(crate) min: f64,
    pub(crate) max: f64,
    pub(crate) ticks: Vec<f64>,
    /// How a tick is written.
    pub(crate) format: fn(f64) -> String,
}

/// A line of a chart.
pub(crate) struct Series {
    pub(crate) name: String,
    /// Its colour and dashes: the same for a learner in all charts.
    pub(crate) style: usize,
    pub(crate) points: Vec<(f64, f64)>,
    /// Points whose values are shown when the pointer rests on them.
    pub(crate) marks: Vec<(f64, f64, String)>,
}

/// Lines over two axes, the legend below.
pub(crate) struct Chart {
    pub(crate) id: String,
    /// What a reader who cannot see the figure is told.
    pub(crate) description: String,
    pub(crate) x: Axis,
    pub(crate) y: Axis,
    pub(crate) series: Vec<Series>,
    /// A bound that others report: below this value at this place.
    pub(crate) below: Option<(f64, f64, String)>,
}

/// Drawn small, so that text can be read on a phone.
const WIDTH: f64 = 480.0;
const PLOT_HEIGHT: f64 = 330.0;
const LEFT: f64 = 58.0;
const RIGHT: f64 = 14.0;
const TOP: f64 = 12.0;
const BOTTOM: f64 = 48.0;
const LEGEND_ROW: f64 = 22.0;

impl Chart {
    pub(crate) fn svg(&self) -> Markup {
        let (bottom, right) = (PLOT_HEIGHT - BOTTOM, WIDTH - RIGHT);
        let height = PLOT_HEIGHT + LEGEND_ROW * self.series.len().div_ceil(2) as f64;
        html! {
            svg id=(self.id) class="chart" viewBox={ "0 0 " (WIDTH) " " (px(height)) } role="img" aria-label=(self.description) {
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
                @for series in &self.series {
                    g class={ "series-" (series.style % N_STYLES) } {
                        path class="line" d=(self.path(&series.points)) {}
                        @for (x, y, text) in &series.marks {
                            circle cx=(px(self.at_x(*x))) cy=(px(self.at_y(*y))) r="4" { title { (text) } }
                        }
                    }
                }
                @if let Some((x, y, text)) = &self.below {
                    @let (x, y) = (self.at_x(*x), self.at_y(*y));
                    // On the side where there is room.
                    @let is_left = WIDTH / 2.0 < x;
                    g class="below" {
                        path d={ "M" (px(x - 12.0)) " " (px(y)) "h12m-6 0v10m-3.5 -4l3.5 4l3.5 -4" } {}
                        @if is_left {
                            text x=(px(x - 17.0)) y=(px(y + 4.5)) text-anchor="end" { (text) }
                        } @else {
                            text x=(px(x + 5.0)) y=(px(y + 14.0)) { (text) }
                        }
                    }
                }
                g class="legend" {
                    @for (k, series) in self.series.iter().enumerate() {
                        (self.key(k, series))
                    }
                }
            }
        }
    }

    fn key(&self, k: usize, series: &Series) -> Markup {
        let x = LEFT + (k % 2) as f64 * (WIDTH - LEFT - RIGHT) / 2.0;
        let y = PLOT_HEIGHT + LEGEND_ROW * (k / 2) as f64 + 8.0;
        html! {
            g class={ "series-" (series.style % N_STYLES) } {
                path class="line" d={ "M" (px(x)) " " (px(y)) "h26" } {}
                text x=(px(x + 33.0)) y=(px(y + 4.5)) { (series.name) }
            }
        }
    }

    fn path(&self, points: &[(f64, f64)]) -> String {
        polyline(points.iter().map(|&(x, y)| (self.at_x(x), self.at_y(y))))
    }

    fn at_x(&self, x: f64) -> f64 {
        let share = (x - self.x.min) / (self.x.max - self.x.min);
        LEFT + share * (WIDTH - LEFT - RIGHT)
    }

    /// Values beyond the axis are drawn at its end.
    fn at_y(&self, y: f64) -> f64 {
        let share = ((y - self.y.min) / (self.y.max - self.y.min)).clamp(0.0, 1.0);
        PLOT_HEIGHT - BOTTOM - share * (PLOT_HEIGHT - TOP - BOTTOM)
    }
}

/// Round values from `min`, a multiple of the step, to `max`, about five of them.
pub(crate) fn ticks(min: f64, max: f64) -> Vec<f64> {
    let step = round_length((max - min) / 4.0);
    let n = ((max - min) / step + 1e-9).floor() as usize;
    (0..=n).map(|k| min + k as f64 * step).collect()
}
