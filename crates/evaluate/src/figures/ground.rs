use std::collections::BTreeMap;

use dataset::{Pose2, Scan};
use maud::{Markup, html};

use super::{px, round_length};

const SIZE: f64 = 640.0;
const MARGIN: f64 = 16.0;
/// Cells that fewer scans than this have seen are people, or noise.
const MIN_SEEN: u16 = 2;

/// Scans laid out along the path: which cells of the ground returned a beam (the paper's Figure
/// 3b).
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct Ground {
    /// Width of a cell \[m\]; one unit of the drawing.
    cell_m: f64,
    min_m: [f64; 2],
    /// By row from the north, then column: how many scans saw it.
    cells: BTreeMap<(u16, u16), u16>,
    extent: [f64; 2],
}

impl Ground {
    /// For poses within these limits; scans may reach a little beyond.
    pub(crate) fn new(poses: &[Pose2]) -> Self {
        let range = |of: fn(&Pose2) -> f64| {
            poses
                .iter()
                .map(of)
                .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)))
        };
        let ((x_min, x_max), (y_min, y_max)) = (range(|p| p.x_m), range(|p| p.y_m));
        // A strip around the path for what it saw.
        let beyond = 0.06 * (x_max - x_min).max(y_max - y_min) + 10.0;
        let extent = [x_max - x_min + 2.0 * beyond, y_max - y_min + 2.0 * beyond];
        Self {
            cell_m: extent[0].max(extent[1]) / (SIZE - 2.0 * MARGIN),
            min_m: [x_min - beyond, y_min - beyond],
            cells: BTreeMap::new(),
            extent,
        }
    }

    /// Lays a scan out at its pose.
    pub(crate) fn add(&mut self, pose: &Pose2, scan: &Scan) {
        let (sin, cos) = libm::sincos(pose.heading_rad);
        let mut seen: Vec<(u16, u16)> = scan
            .points()
            .filter_map(|[x, y]| {
                let east = pose.x_m + cos * x - sin * y - self.min_m[0];
                let north = pose.y_m + sin * x + cos * y - self.min_m[1];
                let inside =
                    (0.0..self.extent[0]).contains(&east) && (0.0..self.extent[1]).contains(&north);
                let cell = |metres: f64| (metres / self.cell_m) as u16;
                inside.then(|| (cell(self.extent[1] - north), cell(east)))
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
        let at = |p: &Pose2| {
            let east = (p.x_m - self.min_m[0]) / self.cell_m;
            let north = (self.extent[1] - (p.y_m - self.min_m[1])) / self.cell_m;
            (MARGIN + east, MARGIN + north)
        };
        let height = self.extent[1] / self.cell_m + 2.0 * MARGIN + 22.0;
        let bar_m = round_length(self.extent[0].max(self.extent[1]) / 5.0);
        html! {
            svg id=(id) class="map" viewBox={ "0 0 " (SIZE) " " (px(height)) } role="img" aria-label={ "Scans of site " (site) " laid out along the path" } {
                path class="walls" d=(self.runs()) {}
                @for log in path {
                    path class="path" d=(super::map::polyline(log.iter().map(at))) {}
                }
                g class="ticks" {
                    path class="scale" d={ "M" (MARGIN) " " (px(height - 12.0)) "h" (px(bar_m / self.cell_m)) } {}
                    text x=(px(MARGIN + bar_m / self.cell_m + 8.0)) y=(px(height - 7.5)) { (bar_m) " m" }
                }
            }
        }
    }

    /// Neighbouring cells of a row as one line, each from where the last one began.
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

    /// A wall of three returns seen from two poses 1 m apart along x, and a passer-by seen once.
    #[test]
    fn what_two_scans_saw_is_drawn_once_and_what_one_saw_is_not() {
        let poses = [0.0, 1.0].map(|x_m| Pose2 { x_m, ..Pose2::default() });
        let mut ground = Ground::new(&poses);
        let wall = |shift: f32, more: f32| Scan {
            x_m: vec![5.0 - shift, 5.0 - shift, 5.0 - shift, 2.0],
            y_m: vec![0.0, 1.0, 2.0, more],
            ..Scan::default()
        };
        ground.add(&poses[0], &wall(0.0, -3.0));
        ground.add(&poses[1], &wall(1.0, 4.0));
        assert_eq!(ground.cells.values().filter(|&&n| n == 2).count(), 3);
        let runs = ground.runs();
        assert_eq!((runs.matches('h').count(), runs.matches('M').count()), (3, 1), "{runs}");
    }
}
