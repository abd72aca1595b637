use maud::{Markup, html};

use super::px;

/// Errors over two label rules, as a table of shaded cells.
pub(crate) struct Heat {
    pub(crate) id: String,
    pub(crate) description: String,
    /// Positive radii, along x \[m\].
    pub(crate) columns: Vec<f64>,
    /// Negative distances, along y \[m\].
    pub(crate) rows: Vec<f64>,
    /// Row by row: the error, or why there is none.
    pub(crate) cells: Vec<Result<f64, String>>,
    /// The error that is shaded fully.
    pub(crate) highest: f64,
}

const LEFT: f64 = 62.0;
const TOP: f64 = 8.0;
const BOTTOM: f64 = 46.0;
const WIDTH: f64 = 480.0;
const MIN_ROW: f64 = 44.0;
/// So that the axis has room for its title.
const MIN_HEIGHT: f64 = 150.0;

impl Heat {
    pub(crate) fn svg(&self) -> Markup {
        let row_height = MIN_ROW.max(MIN_HEIGHT / self.rows.len() as f64);
        let width = (WIDTH - LEFT - 8.0) / self.columns.len() as f64;
        let height = TOP + row_height * self.rows.len() as f64 + BOTTOM;
        let bottom = height - BOTTOM;
        html! {
            svg id=(self.id) class="chart" viewBox={ "0 0 " (WIDTH) " " (px(height)) } role="img" aria-label=(self.description) {
                @for (k, cell) in self.cells.iter().enumerate() {
                    @let (column, row) = (k % self.columns.len(), k / self.columns.len());
                    @let (x, y) = (LEFT + column as f64 * width, TOP + row as f64 * row_height);
                    @let rules = format!("positive within {} m, negative beyond {} m", self.columns[column], self.rows[row]);
                    g {
                        @match cell {
                            Ok(error) => {
                                title { (rules) ": error " (format!("{:.2} %", error * 100.0)) }
                                rect class="heat" x=(px(x + 1.5)) y=(px(y + 1.5)) width=(px(width - 3.0)) height=(px(row_height - 3.0)) rx="3"
                                    fill-opacity=(format!("{:.2}", 0.08 + 0.62 * (error / self.highest).min(1.0))) {}
                                text class="cell" x=(px(x + width / 2.0)) y=(px(y + row_height / 2.0 + 5.0)) text-anchor="middle" { (format!("{:.1}", error * 100.0)) }
                            }
                            Err(reason) => {
                                title { (rules) ": " (reason) }
                                rect class="empty" x=(px(x + 1.5)) y=(px(y + 1.5)) width=(px(width - 3.0)) height=(px(row_height - 3.0)) rx="3" {}
                                text class="cell faint" x=(px(x + width / 2.0)) y=(px(y + row_height / 2.0 + 5.0)) text-anchor="middle" { "too few" }
                            }
                        }
                    }
                }
                g class="ticks" {
                    @for (k, value) in self.columns.iter().enumerate() {
                        text x=(px(LEFT + (k as f64 + 0.5) * width)) y=(bottom + 17.0) text-anchor="middle" { (value) }
                    }
                    @for (k, value) in self.rows.iter().enumerate() {
                        text x=(LEFT - 7.0) y=(px(TOP + (k as f64 + 0.5) * row_height + 4.0)) text-anchor="end" { (value) }
                    }
                    text class="axis-title" x=(px(f64::midpoint(LEFT, WIDTH))) y=(bottom + 37.0) text-anchor="middle" { "positive within [m]" }
                    text class="axis-title" transform={ "translate(15 " (px(f64::midpoint(TOP, bottom))) ") rotate(-90)" } text-anchor="middle" { "negative beyond [m]" }
                }
            }
        }
    }
}
