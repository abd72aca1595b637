//! Heat maps of the error under other label rules.

use dataset::GridCell;
use maud::{Markup, html};

use super::svg::px;
use crate::Input;
use crate::text::{distinct, learner_name};

/// Errors over two label rules, as a table of shaded cells.
pub(super) struct HeatMap {
    pub(super) id: String,
    pub(super) description: String,
    /// Values of `positive_radius_m`, along x \[m\].
    pub(super) columns: Vec<f64>,
    /// Values of `negative_min_m`, along y \[m\].
    pub(super) rows: Vec<f64>,
    /// The error or the reason why it is missing, row by row, `(n_rows * n_columns,)`.
    pub(super) cells: Vec<Result<f64, String>>,
    /// The error with the darkest shade.
    pub(super) highest: f64,
}

const LEFT: f64 = 62.0;
const TOP: f64 = 8.0;
const BOTTOM: f64 = 46.0;
const WIDTH: f64 = 480.0;
const MIN_ROW: f64 = 44.0;
/// Leaves space for the title of the vertical axis.
const MIN_HEIGHT: f64 = 190.0;

/// A heat map for each learner and minimum travel gap of the grid.
pub(super) fn heat_maps(input: &Input<'_>) -> Vec<HeatMap> {
    let values = |of: fn(&GridCell) -> f64| {
        let mut values: Vec<f64> = input.grid.iter().map(of).collect();
        values.sort_by(f64::total_cmp);
        values.dedup_by(|a, b| a.total_cmp(b).is_eq());
        values
    };
    let highest =
        input.grid.iter().filter_map(|c| c.error.as_ref().ok()).fold(0.01, |a, &b| b.max(a));
    let (columns, rows) = (values(|c| c.positive_radius_m), values(|c| c.negative_min_m));
    let mut maps = Vec::new();
    for learner in distinct(input.grid.iter().map(|c| &*c.learner)) {
        for gap in values(|c| c.min_travel_gap_m) {
            let cell = |row: f64, column: f64| {
                let found = input.grid.iter().find(|c| {
                    c.learner == learner
                        && c.min_travel_gap_m.total_cmp(&gap).is_eq()
                        && c.negative_min_m.total_cmp(&row).is_eq()
                        && c.positive_radius_m.total_cmp(&column).is_eq()
                });
                found.map_or_else(|| Err("not in the grid".to_owned()), |c| c.error.clone())
            };
            maps.push(HeatMap {
                id: format!("grid-{learner}-{gap}"),
                description: format!(
                    "Error of {} under other label rules, with at least {gap} m of path between the scans of a match",
                    learner_name(learner)
                ),
                cells: rows
                    .iter()
                    .flat_map(|&row| columns.iter().map(move |&column| (row, column)))
                    .map(|(row, column)| cell(row, column))
                    .collect(),
                columns: columns.clone(),
                rows: rows.clone(),
                highest,
            });
        }
    }
    maps
}

impl HeatMap {
    pub(super) fn svg(&self) -> Markup {
        let row_height = MIN_ROW.max(MIN_HEIGHT / self.rows.len() as f64);
        let width = (WIDTH - LEFT - 8.0) / self.columns.len() as f64;
        let height = TOP + row_height * self.rows.len() as f64 + BOTTOM;
        let bottom = height - BOTTOM;
        html! {
            svg id=(self.id) class="chart" viewBox={ "0 0 " (WIDTH) " " (px(height)) } role="img" aria-label=(self.description) {
                @for (k, cell) in self.cells.iter().enumerate() {
                    @let (column, row) = (k % self.columns.len(), k / self.columns.len());
                    @let (x, y) = (LEFT + column as f64 * width, TOP + row as f64 * row_height);
                    @let rules = format!("matches within {} m, non-matches beyond {} m", self.columns[column], self.rows[row]);
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
                    text class="axis-title" x=(px(f64::midpoint(LEFT, WIDTH))) y=(bottom + 37.0) text-anchor="middle" { "matches within [m]" }
                    text class="axis-title" transform={ "translate(15 " (px(f64::midpoint(TOP, bottom))) ") rotate(-90)" } text-anchor="middle" { "non-matches beyond [m]" }
                }
            }
        }
    }
}
