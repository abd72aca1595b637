//! Figures as SVG.
//!
//! In the report, figures follow its light or dark colours, scale, print and need no script. The
//! same figures are written as separate files to `evaluation/figures/`.

mod chart;
mod closure_sketches;
mod closures;
mod compared_map;
mod curves;
mod first_rounds;
mod ground;
mod label_grid;
mod path;
mod scan_pair;
mod site_map;
mod sketches;
mod svg;

use dataset::Pose2;

pub use closure_sketches::ClosureSketches;
pub(crate) use closure_sketches::{DriveSketch, Overlay};
pub use closures::closure_figures;
pub(crate) use closures::{drive_name, overlay_id, source_name};
pub(crate) use compared_map::compared_maps;
pub(crate) use path::path_caption;
pub use path::path_svg;
pub(crate) use sketches::PairKind;
pub use sketches::Sketches;
pub(crate) use svg::STYLE;
pub use svg::{Figure, write_figures};

use crate::text::distinct;
use crate::{Evaluation, Input};

/// Draws all figures of the report.
pub fn figures(input: &Input<'_>, evaluation: &Evaluation, sketches: &Sketches) -> Vec<Figure> {
    let mut figures = Vec::new();
    for grouping in evaluation.groupings() {
        let charts = [
            curves::error_curve(input, evaluation, grouping),
            curves::precision_recall(input, evaluation, grouping),
        ];
        figures.extend(charts.map(|chart| Figure::new(&chart.id, chart.svg())));
    }
    if let Some(chart) = curves::retrieval(input) {
        figures.push(Figure::new(&chart.id, chart.svg()));
    }
    let heat_maps = label_grid::heat_maps(input);
    figures.extend(heat_maps.into_iter().map(|map| Figure::new(&map.id, map.svg())));
    if let Some(scatter) = first_rounds::scatter(input) {
        figures.push(Figure::new(&scatter.id, scatter.svg()));
    }
    figures.extend(scan_pair::scan_pairs(input, sketches));
    for (k, site) in distinct(input.keyframes.iter().map(|k| &*k.site)).into_iter().enumerate() {
        let id = format!("map-{}", k + 1);
        figures.push(Figure::new(&id, site_map::site_map(&id, site, input.keyframes, input.pairs)));
        if let Some(ground) = sketches.grounds.get(site) {
            let id = format!("ground-{}", k + 1);
            figures.push(Figure::new(&id, ground.svg(&id, site, &paths_of_logs(input, site))));
        }
    }
    for (k, of_log) in input.keyframes.chunk_by(|a, b| a.id.log == b.id.log).enumerate() {
        let id = format!("path-{}", k + 1);
        figures.push(Figure::new(&id, path::path(&id, of_log)));
    }
    figures.extend(closure_figures(input.detection, &evaluation.detection, &sketches.closures));
    figures
}

/// The keyframe poses of each log of a site.
fn paths_of_logs(input: &Input<'_>, site: &str) -> Vec<Vec<Pose2>> {
    let of_site: Vec<_> = input.keyframes.iter().filter(|k| &*k.site == site).collect();
    of_site
        .chunk_by(|a, b| a.id.log == b.id.log)
        .map(|log| log.iter().map(|k| k.pose).collect())
        .collect()
}
