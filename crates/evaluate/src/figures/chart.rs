use maud::{Markup, html};

use super::{N_STYLES, px};

/// One axis of a chart.
pub(crate) struct Axis {
    /// What it shows, with its unit.
    pub(crate) title: &'static str,
    pub(crate) min: f64,
    pub(crate) max: f64,
    pub(crate) ticks: Vec<f64>,
    /// How a tick is written.
    pub(crate) format: fn(f64) -> String,
}

/// A line of a chart.
pub(crate) struct Series {
    pub(crate) name: String,
    pub(crate) points: Vec<(f64, f64)>,
    /// Texts shown when the pointer rests on a point; empty for a line without marks.
    pub(crate) hover: Vec<String>,
}

/// Lines over two axes.
pub(crate) struct Chart {
    pub(crate) id: &'static str,
    /// What a reader who cannot see the figure is told.
    pub(crate) description: String,
    pub(crate) x: Axis,
    pub(crate) y: Axis,
    pub(crate) series: Vec<Series>,
}

const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 400.0;
const LEFT: f64 = 64.0;
const RIGHT: f64 = 16.0;
const TOP: f64 = 12.0;
const BOTTOM: f64 = 52.0;

impl Chart {
    pub(crate) fn svg(&self) -> Markup {
        let (bottom, right) = (HEIGHT - BOTTOM, WIDTH - RIGHT);
        html! {
            svg id=(self.id) class="chart" viewBox={ "0 0 " (WIDTH) " " (HEIGHT) } role="img" aria-label=(self.description) {
                g class="grid" {
                    @for &tick in &self.x.ticks {
                        line x1=(px(self.at_x(tick))) x2=(px(self.at_x(tick))) y1=(TOP) y2=(bottom) {}
                    }
                    @for &tick in &self.y.ticks {
                        line x1=(LEFT) x2=(right) y1=(px(self.at_y(tick))) y2=(px(self.at_y(tick))) {}
                    }
                }
                g class="ticks" {
                    @for &tick in &self.x.ticks {
                        text x=(px(self.at_x(tick))) y=(bottom + 18.0) text-anchor="middle" { ((self.x.format)(tick)) }
                    }
                    @for &tick in &self.y.ticks {
                        text x=(LEFT - 8.0) y=(px(self.at_y(tick) + 4.0)) text-anchor="end" { ((self.y.format)(tick)) }
                    }
                    text class="axis-title" x=(px(f64::midpoint(LEFT, right))) y=(HEIGHT - 10.0) text-anchor="middle" { (self.x.title) }
                    text class="axis-title" transform={ "translate(16 " (px(f64::midpoint(TOP, bottom))) ") rotate(-90)" } text-anchor="middle" { (self.y.title) }
                }
                @for (k, series) in self.series.iter().enumerate() {
                    g class={ "series-" (k % N_STYLES) } {
                        path class="line" d=(self.path(&series.points)) {}
                        @for (&(x, y), hover) in series.points.iter().zip(&series.hover) {
                            circle cx=(px(self.at_x(x))) cy=(px(self.at_y(y))) r="3" { title { (hover) } }
                        }
                    }
                }
            }
            p class="legend" {
                @for (k, series) in self.series.iter().enumerate() {
                    span class={ "key series-" (k % N_STYLES) } {
                        svg viewBox="0 0 28 10" aria-hidden="true" { path class="line" d="M1 5H27" {} }
                        (series.name)
                    }
                }
            }
        }
    }

    fn path(&self, points: &[(f64, f64)]) -> String {
        let mut path = String::new();
        for (k, &(x, y)) in points.iter().enumerate() {
            path.push(if k == 0 { 'M' } else { 'L' });
            path.push_str(&px(self.at_x(x)));
            path.push(' ');
            path.push_str(&px(self.at_y(y)));
        }
        path
    }

    fn at_x(&self, x: f64) -> f64 {
        let share = (x - self.x.min) / (self.x.max - self.x.min);
        LEFT + share * (WIDTH - LEFT - RIGHT)
    }

    /// Values beyond the axis are drawn at its end.
    fn at_y(&self, y: f64) -> f64 {
        let share = ((y - self.y.min) / (self.y.max - self.y.min)).clamp(0.0, 1.0);
        HEIGHT - BOTTOM - share * (HEIGHT - TOP - BOTTOM)
    }
}
