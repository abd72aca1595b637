//! The scans of a site drawn at their poses.

use std::collections::BTreeMap;

use dataset::{Pose2, Scan};
use maud::{Markup, html};

use super::svg::{polyline, px, round_length};

const SIZE: f64 = 640.0;
const MARGIN: f64 = 16.0;
/// Cells seen by fewer scans than this are not drawn: people or noise.
const MIN_SEEN: u16 = 2;

/// The cells of a ground grid in which a scan has a return (the paper's Figure 3b).
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Ground {
    /// Width of a cell, drawn as one pixel \[m\].
    cell_m: f64,
    /// Least x and y of the grid \[m\].
    min_m: [f64; 2],
    /// Number of scans that saw a cell, by row from the north and column from the west.
    cells: BTreeMap<(u16, u16), u16>,
    /// Width and height of the grid \[m\].
    extent_m: [f64; 2],
}

impl Ground {
    /// A grid that covers the poses and a margin around them.
    pub(crate) fn new(poses: &[Pose2]) -> Self {
        let range = |of: fn(&Pose2) -> f64| {
            poses
                .iter()
                .map(of)
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)))
        };
        let ((x_min, x_max), (y_min, y_max)) = (range(|p| p.x_m), range(|p| p.y_m));
        let margin_m = 0.06 * (x_max - x_min).max(y_max - y_min) + 10.0;
        let extent_m = [x_max - x_min + 2.0 * margin_m, y_max - y_min + 2.0 * margin_m];
        Self {
            cell_m: extent_m[0].max(extent_m[1]) / (SIZE - 2.0 * MARGIN),
            min_m: [x_min - margin_m, y_min - margin_m],
            cells: BTreeMap::new(),
            extent_m,
        }
    }

    /// Adds a scan at its pose.
    pub(crate) fn add(&mut self, pose: &Pose2, scan: &Scan) {
        let (sin, cos) = libm::sincos(pose.heading_rad);
        let mut seen: Vec<(u16, u16)> = scan
            .points()
            .filter_map(|[x, y]| {
                let east = pose.x_m + cos * x - sin * y - self.min_m[0];
                let north = pose.y_m + sin * x + cos * y - self.min_m[1];
                let inside = (0.0..self.extent_m[0]).contains(&east)
                    && (0.0..self.extent_m[1]).contains(&north);
                let cell = |metres: f64| (metres / self.cell_m) as u16;
                inside.then(|| (cell(self.extent_m[1] - north), cell(east)))
            })
            .collect();
        seen.sort_unstable();
        seen.dedup();
        for cell in seen {
            let n = self.cells.entry(cell).or_insert(0);
            *n = n.saturating_add(1);
        }
    }

    pub(crate) fn svg(&self, id: &str, site: &str, path: &[Vec<Pose2>]) -> Markup {
        let text = format!("Scans of site {site} drawn along the path");
        let lines = html! {
            @for log in path {
                path class="path" d=(polyline(log.iter().map(|pose| self.at(pose)))) {}
            }
        };
        self.svg_with(id, &text, &lines)
    }

    /// The scans with other things drawn over them, at the pixels of [`Ground::at`].
    pub(crate) fn svg_with(&self, id: &str, text: &str, over: &Markup) -> Markup {
        let height = self.extent_m[1] / self.cell_m + 2.0 * MARGIN + 22.0;
        let bar_m = round_length(self.extent_m[0].max(self.extent_m[1]) / 5.0);
        html! {
            svg id=(id) class="map" viewBox={ "0 0 " (SIZE) " " (px(height)) } role="img" aria-label=(text) {
                path class="walls" d=(self.runs()) {}
                (over)
                g class="ticks" {
                    path class="scale" d={ "M" (MARGIN) " " (px(height - 12.0)) "h" (px(bar_m / self.cell_m)) } {}
                    text x=(px(MARGIN + bar_m / self.cell_m + 8.0)) y=(px(height - 7.5)) { (bar_m) " m" }
                }
            }
        }
    }

    /// The pixel of a position.
    pub(crate) fn at(&self, pose: &Pose2) -> (f64, f64) {
        let east = (pose.x_m - self.min_m[0]) / self.cell_m;
        let north = (self.extent_m[1] - (pose.y_m - self.min_m[1])) / self.cell_m;
        (MARGIN + east, MARGIN + north)
    }

    /// A line for each run of adjacent cells in a row. Each line starts relative to the end of the
    /// previous one.
    fn runs(&self) -> String {
        let mut path = String::new();
        let mut cells =
            self.cells.iter().filter(|(_, n)| MIN_SEEN <= **n).map(|(c, _)| *c).peekable();
        let mut last: Option<(u16, u16)> = None;
        while let Some((row, column)) = cells.next() {
            let mut end = column;
            while cells.next_if(|&(r, c)| r == row && c == end + 1).is_some() {
                end += 1;
            }
            match last {
                None => path.push_str(&format!(
                    "M{} {}",
                    px(MARGIN + f64::from(column)),
                    px(MARGIN + f64::from(row) + 0.5)
                )),
                Some((r, c)) => path.push_str(&format!(
                    "m{} {}",
                    i32::from(column) - i32::from(c),
                    i32::from(row) - i32::from(r)
                )),
            }
            let length = end - column + 1;
            path.push_str(&format!("h{length}"));
            last = Some((row, end + 1));
        }
        path
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two poses 1 m apart along x see a wall of three returns. Each also sees one other return.
    #[test]
    fn only_cells_seen_by_two_scans_are_drawn() {
        let poses = [0.0, 1.0].map(|x_m| Pose2 { x_m, ..Pose2::default() });
        let mut ground = Ground::new(&poses);
        let scan = |shift: f32, other: f32| Scan {
            x_m: vec![5.0 - shift, 5.0 - shift, 5.0 - shift, 2.0],
            y_m: vec![0.0, 1.0, 2.0, other],
            ..Scan::default()
        };
        ground.add(&poses[0], &scan(0.0, -3.0));
        ground.add(&poses[1], &scan(1.0, 4.0));
        assert_eq!(ground.cells.values().filter(|&&n| n == 2).count(), 3);
        let runs = ground.runs();
        assert_eq!((runs.matches('h').count(), runs.matches('M').count()), (3, 1), "{runs}");
    }
}
