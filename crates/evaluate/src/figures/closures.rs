//! Figures of loop closures: the map before and after, drift, and overlays of submaps.

use dataset::Pose2;
use maud::{Markup, html};

use super::chart::{Axis, Chart, Series, ticks};
use super::closure_sketches::{ClosureSketches, DriveSketch, MapSketch, Overlay};
use super::ground::Ground;
use super::svg::{Figure, dots, px, round_length, thin_polyline};
use crate::detection::{
    DRIFT_PATHS_M, Drift, Drive, DriveMeasures, FoundClosure, KeyframePoses, PoseSource, Verdict,
    differences,
};

/// Accepted and rejected closures drawn on a map. More would cover it.
const MAX_LINES: usize = 1000;
/// Points of a path closer than this to the last drawn one are skipped \[px\].
const MIN_STEP: f64 = 0.6;
/// Side of an overlay \[px\].
const SIDE: f64 = 320.0;
/// Height below an overlay for the scale bar and the legend \[px\].
const BELOW: f64 = 26.0;
/// Points drawn of each submap.
const MAX_POINTS: usize = 1500;
/// Share of the points inside the frame of an overlay.
const SHOWN: f64 = 0.98;

/// Draws the figures of loop closures. `drives` and `measures` have the same order.
pub fn closure_figures(
    drives: &[Drive<'_>],
    measures: &[DriveMeasures],
    sketches: &ClosureSketches,
) -> Vec<Figure> {
    let mut figures = Vec::new();
    for (n, map) in (1..).zip(&sketches.maps) {
        let id = format!("joined-{n}");
        figures.push(Figure::new(&id, joined_map(&id, map, drives)));
    }
    for sketch in &sketches.drives {
        let (drive, measures) = (&drives[sketch.drive], &measures[sketch.drive]);
        let n = sketch.drive + 1;
        let mut add = |id: String, svg: Markup| figures.push(Figure::new(&id, svg));
        let id = format!("before-{n}");
        add(id.clone(), map(&id, drive, measures, &sketch.before, |k| k.odometry));
        let id = format!("after-{n}");
        add(id.clone(), map(&id, drive, measures, &sketch.after, |k| k.optimized));
        for chart in drift_charts(n, drive, measures) {
            add(chart.id.clone(), chart.svg());
        }
        for overlay in &sketch.overlays {
            let id = overlay_id(sketch, overlay);
            add(id.clone(), overlay_svg(&id, drive, overlay));
        }
    }
    figures.extend(candidate_curve(measures).map(|chart| Figure::new(&chart.id, chart.svg())));
    figures
}

/// The id of the figure of an overlay.
pub(crate) fn overlay_id(sketch: &DriveSketch, overlay: &Overlay) -> String {
    format!("{}-{}", overlay.kind.id(), sketch.drive + 1)
}

/// The scans of all drives of a map with their paths.
fn joined_map(id: &str, map: &MapSketch, drives: &[Drive<'_>]) -> Markup {
    let at = |keyframe: &KeyframePoses| map.ground.at(&keyframe.optimized);
    let over = html! {
        @for &k in &map.drives {
            path class="path" d=(thin_polyline(drives[k].keyframes.iter().map(at), MIN_STEP)) {}
        }
    };
    let text = format!("Map {} of {} drives by optimized poses", map.map, map.drives.len());
    map.ground.svg_with(id, &text, &over)
}

/// The scans at some poses with the path and the closures.
fn map(
    id: &str,
    drive: &Drive<'_>,
    measures: &DriveMeasures,
    ground: &Ground,
    pose: fn(&KeyframePoses) -> Pose2,
) -> Markup {
    let at = |k: usize| ground.at(&pose(&drive.keyframes[k]));
    let verdict =
        |k: usize| measures.truth.as_ref().and_then(|t| t.judged[k]).map(|judged| judged.verdict);
    let of = |is: &dyn Fn(usize, &FoundClosure<'_>) -> bool| -> String {
        let chosen: Vec<&FoundClosure<'_>> =
            drive.closures.iter().enumerate().filter(|(k, c)| is(*k, c)).map(|(_, c)| c).collect();
        let every = chosen.len().div_ceil(MAX_LINES).max(1);
        let line = |c: &&FoundClosure<'_>| {
            let ((ax, ay), (bx, by)) = (at(c.query), at(c.reference));
            format!("M{} {}L{} {}", px(ax), px(ay), px(bx), px(by))
        };
        chosen.iter().step_by(every).map(line).collect()
    };
    let is_false = |k: usize| verdict(k) == Some(Verdict::False);
    let rejected = of(&|_, c| c.rejected.is_some());
    let accepted = of(&|k, c| c.rejected.is_none() && !is_false(k));
    let wrong = of(&|k, c| c.rejected.is_none() && is_false(k));
    let path = thin_polyline((0..drive.keyframes.len()).map(at), MIN_STEP);
    let over = html! {
        path class="path" d=(path) {}
        path class="rejected" d=(rejected) {}
        path class="accepted" d=(accepted) {}
        path class="wrong" d=(wrong) {}
    };
    let when = if id.starts_with("before") { "odometry" } else { "optimized poses" };
    let text = format!("Map of {} by {when}, with {} closures", drive.log, measures.n_accepted);
    ground.svg_with(id, &text, &over)
}

/// Errors in position and heading against path length. Without ground truth, the differences from the
/// optimized poses.
fn drift_charts(n: usize, drive: &Drive<'_>, measures: &DriveMeasures) -> Vec<Chart> {
    let of_sources: Vec<(PoseSource, Vec<Drift>)> = match &measures.truth {
        Some(truth) => truth
            .trajectories
            .iter()
            .filter(|t| t.source != PoseSource::OptimizedKeyframes)
            .map(|t| (t.source, t.drift.clone()))
            .collect(),
        None => [PoseSource::Odometry, PoseSource::ScanMatched]
            .map(|source| (source, differences(drive, source)))
            .into(),
    };
    let of = if measures.truth.is_some() { "error" } else { "difference" };
    let chart = |id: String, title: String, value: fn(&Drift) -> f64, unit: &'static str| {
        drift_chart(id, title, &of_sources, value, unit)
    };
    let position =
        chart(format!("drift-m-{n}"), format!("{of} of the position [m], rms"), |d| d.rmse_m, "m");
    let heading = chart(
        format!("drift-deg-{n}"),
        format!("{of} of the heading [deg], rms"),
        |d| d.rmse_rad.to_degrees(),
        "deg",
    );
    [position, heading].into_iter().flatten().collect()
}

/// Both axes are logarithmic. `None` without values.
fn drift_chart(
    id: String,
    title: String,
    of_sources: &[(PoseSource, Vec<Drift>)],
    value: fn(&Drift) -> f64,
    unit: &str,
) -> Option<Chart> {
    // Less than a hundredth of a millimetre or degree is drawn as that.
    let log = |v: f64| libm::log10(v.max(1e-5));
    let values: Vec<f64> =
        of_sources.iter().flat_map(|(_, drifts)| drifts.iter().map(|d| log(value(d)))).collect();
    let low = values.iter().copied().reduce(f64::min)?.floor();
    let high = values.iter().copied().reduce(f64::max)?.ceil().max(low + 1.0);
    let series = of_sources.iter().filter(|(_, drifts)| !drifts.is_empty());
    let series = series.map(|(source, drifts)| Series {
        name: source_name(*source).to_owned(),
        style: *source as usize,
        points: drifts.iter().map(|d| (log(d.path_m), log(value(d)))).collect(),
        marks: drifts
            .iter()
            .map(|d| {
                let text = format!(
                    "{}: {:.3} {unit} over {} m ({} pairs)",
                    source_name(*source),
                    value(d),
                    d.path_m,
                    d.n_pairs
                );
                (log(d.path_m), log(value(d)), text)
            })
            .collect(),
    });
    Some(Chart {
        id,
        description: format!("{title} against path length"),
        x: Axis {
            title: "path length [m]".to_owned(),
            min: log(DRIFT_PATHS_M[0]),
            max: log(DRIFT_PATHS_M[DRIFT_PATHS_M.len() - 1]),
            ticks: DRIFT_PATHS_M.map(log).into(),
            format: |tick| format!("{:.0}", libm::pow(10.0, tick)),
        },
        y: Axis {
            title,
            min: low,
            max: high,
            ticks: (0..=(high - low) as usize).map(|k| low + k as f64).collect(),
            format: |tick| format!("{}", (libm::pow(10.0, tick) * 1e5).round() / 1e5),
        },
        series: series.collect(),
        bound: None,
    })
}

pub(crate) fn source_name(source: PoseSource) -> &'static str {
    match source {
        PoseSource::Odometry => "odometry",
        PoseSource::ScanMatched => "scan matching",
        PoseSource::OptimizedKeyframes => "optimized, keyframes",
        PoseSource::Optimized => "optimized",
    }
}

/// Precision against recall of the candidates, a line for each drive with right candidates.
fn candidate_curve(measures: &[DriveMeasures]) -> Option<Chart> {
    let series: Vec<Series> = measures
        .iter()
        .filter_map(|m| {
            let curve = &m.truth.as_ref()?.curve;
            let points: Vec<(f64, f64)> = curve
                .iter()
                .map(|p| (p.confusion.recall(), p.confusion.precision().unwrap_or(1.0)))
                .filter(|(recall, _)| recall.is_finite())
                .collect();
            (!points.is_empty()).then_some((m, points))
        })
        .take(super::svg::N_STYLES)
        .enumerate()
        .map(|(k, (m, points))| Series { name: drive_name(m), style: k, points, marks: Vec::new() })
        .collect();
    let share = |title: &str| Axis {
        title: title.to_owned(),
        min: 0.0,
        max: 1.0,
        ticks: ticks(0.0, 1.0),
        format: |tick| format!("{tick:.1}"),
    };
    (!series.is_empty()).then(|| Chart {
        id: "candidates".to_owned(),
        description: "Precision against recall of the candidates".to_owned(),
        x: share("recall"),
        y: share("precision"),
        series,
        bound: None,
    })
}

/// The log, and the segment if it is not the first.
pub(crate) fn drive_name(measures: &DriveMeasures) -> String {
    match measures.segment {
        0 => measures.log.clone(),
        segment => format!("{}, segment {segment}", measures.log),
    }
}

/// Both submaps in the frame of the reference, which is at the centre and faces up.
fn overlay_svg(id: &str, drive: &Drive<'_>, overlay: &Overlay) -> Markup {
    let closure = &drive.closures[overlay.closure];
    let moved = |[x_m, y_m]: [f64; 2]| {
        let point = closure.reference_from_query * Pose2 { x_m, y_m, heading_rad: 0.0 };
        [point.x_m, point.y_m]
    };
    let reference: Vec<[f64; 2]> = overlay.reference.points(MAX_POINTS).collect();
    let query: Vec<[f64; 2]> = overlay.query.points(MAX_POINTS).map(moved).collect();
    let mut extents_m: Vec<f64> =
        reference.iter().chain(&query).map(|p| p[0].abs().max(p[1].abs())).collect();
    extents_m.sort_by(f64::total_cmp);
    let index = (extents_m.len().saturating_sub(1) as f64 * SHOWN) as usize;
    let extent_m = extents_m.get(index).copied().unwrap_or(1.0).max(1.0);
    let scale = SIDE / 2.0 / extent_m;
    let at = |p: &[f64; 2]| (SIDE / 2.0 - p[1] * scale, SIDE / 2.0 - p[0] * scale);
    let is_shown = |p: &&[f64; 2]| p[0].abs().max(p[1].abs()) <= extent_m * 0.98;
    let drawn = |points: &[[f64; 2]]| dots(points.iter().filter(is_shown).map(at));
    let robot = |pose: Pose2| {
        let (x, y) = at(&[pose.x_m, pose.y_m]);
        format!("translate({} {}) rotate({})", px(x), px(y), px(-pose.heading_rad.to_degrees()))
    };
    let bar_m = round_length(extent_m / 2.0);
    let [query_scan, reference_scan] =
        [closure.query, closure.reference].map(|k| drive.keyframes[k].scan);
    let text = format!(
        "Submaps of scans {query_scan} and {reference_scan} of {}, {}",
        drive.log,
        overlay.kind.title()
    );
    html! {
        svg id=(id) class="overlay" viewBox={ "0 0 " (SIDE) " " (SIDE + BELOW) } role="img" aria-label=(text) {
            title { (text) }
            rect class="frame" x="0.5" y="0.5" width=(SIDE - 1.0) height=(SIDE - 1.0) rx="4" {}
            path class="reference-points" d=(drawn(&reference)) {}
            path class="query-points" d=(drawn(&query)) {}
            path class="reference-robot" transform=(robot(Pose2::default())) d="M0 -7l5 11h-10z" {}
            path class="query-robot" transform=(robot(closure.reference_from_query)) d="M0 -7l5 11h-10z" {}
            g class="ticks" {
                path class="scale" d={ "M2 " (SIDE + 13.0) "h" (px(bar_m * scale)) } {}
                text x=(px(bar_m * scale + 8.0)) y=(SIDE + 17.5) { (bar_m) " m" }
                text x=(SIDE - 2.0) y=(SIDE + 17.5) text-anchor="end" {
                    tspan class="key-positive" { "scan " (reference_scan) } " · "
                    tspan class="key-negative" { "scan " (query_scan) }
                }
            }
        }
    }
}
