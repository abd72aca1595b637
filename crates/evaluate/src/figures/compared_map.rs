//! The map of a run with that of another run laid over it.

use std::collections::HashMap;

use dataset::{MapPose, Pose2, ScanId};
use maud::{Markup, html};

use super::svg::{Figure, px, round_length, thin_polyline};
use crate::comparison::{
    ChangeOfClosure, ClosureChange, ComparedTrajectory, Comparison, MappedRun,
};

const SIZE: f64 = 640.0;
const MARGIN: f64 = 20.0;
/// Height below the map for the scale bar and the legend \[px\].
const BELOW: f64 = 30.0;
/// Maps that are drawn: those with the most scans. More would make the report too large.
const MAX_MAPS: usize = 6;
/// Closures of each kind that are drawn on a map. More would cover it.
const MAX_LINES: usize = 1000;
/// Points of a path closer than this to the last drawn one are skipped \[px\].
const MIN_STEP: f64 = 0.6;

/// A keyframe in the map of A.
struct Drawn<'a> {
    keyframe: &'a MapPose,
    pose: Pose2,
}

/// Draws the largest maps of both runs. Each figure shows the entry of [`Comparison::trajectories`] with
/// the returned index.
pub(crate) fn compared_maps(
    comparison: &Comparison,
    [a, b]: [MappedRun<'_>; 2],
) -> Vec<(usize, Figure)> {
    let whole = whole_maps(&comparison.trajectories);
    let draw = |(n, k): (usize, usize)| {
        let trajectory = &comparison.trajectories[k];
        let in_a = keyframes(&a, trajectory.map_a, Pose2::default());
        let in_b = keyframes(&b, trajectory.map_b, trajectory.alignment());
        let id = format!("compared-{}", n + 1);
        (k, Figure::new(&id, svg(&id, trajectory, &comparison.closures.changes, [&in_a, &in_b])))
    };
    whole.into_iter().enumerate().map(draw).collect()
}

/// The entries of all logs of a map, those with the most scans.
fn whole_maps(trajectories: &[ComparedTrajectory]) -> Vec<usize> {
    let maps = |k: usize| (trajectories[k].map_a, trajectories[k].map_b);
    // The entry of all logs of two maps is the last one of these maps.
    let mut whole: Vec<usize> = (0..trajectories.len())
        .filter(|&k| k + 1 == trajectories.len() || maps(k) != maps(k + 1))
        .collect();
    whole.sort_by_key(|&k| (std::cmp::Reverse(trajectories[k].n_scans), k));
    whole.truncate(MAX_MAPS);
    whole
}

fn keyframes<'a>(run: &MappedRun<'a>, map: u32, a_from_map: Pose2) -> Vec<Drawn<'a>> {
    let of_map = run.keyframes.iter().filter(|keyframe| keyframe.map == map);
    of_map.map(|keyframe| Drawn { keyframe, pose: a_from_map * keyframe.pose }).collect()
}

fn svg(
    id: &str,
    trajectory: &ComparedTrajectory,
    changes: &[ClosureChange],
    [a, b]: [&[Drawn<'_>]; 2],
) -> Markup {
    let all = || a.iter().chain(b).map(|drawn| &drawn.pose);
    let range = |of: fn(&Pose2) -> f64| {
        all()
            .map(of)
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), v| (low.min(v), high.max(v)))
    };
    let ((x_min, x_max), (y_min, y_max)) = (range(|p| p.x_m), range(|p| p.y_m));
    let scale = (SIZE - 2.0 * MARGIN) / (x_max - x_min).max(y_max - y_min).max(1.0);
    let height = (y_max - y_min) * scale + 2.0 * MARGIN + BELOW;
    let at = |p: &Pose2| ((p.x_m - x_min) * scale + MARGIN, (y_max - p.y_m) * scale + MARGIN);
    let [path_a, path_b] = [a, b].map(|drawn| path(drawn, &at));
    let lines =
        |change: ChangeOfClosure, drawn: &[Drawn<'_>]| closures(changes, change, drawn, &at);
    let lost = lines(ChangeOfClosure::Lost, a);
    let gained = lines(ChangeOfClosure::Gained, b);
    let moved = lines(ChangeOfClosure::Moved, a);
    let farthest = &trajectory.farthest;
    let (x, y) = at(&Pose2 { x_m: farthest.x_m, y_m: farthest.y_m, heading_rad: 0.0 });
    let bar_m = round_length((x_max - x_min).max(5.0) / 5.0);
    let text = format!(
        "Paths of {} in A and B, with {} lost, {} gained and {} moved closures",
        trajectory.logs.join(", "),
        lost.1,
        gained.1,
        moved.1
    );
    html! {
        svg id=(id) class="map compared" viewBox={ "0 0 " (SIZE) " " (px(height)) } role="img" aria-label=(text) {
            title { (text) }
            path class="path-a" d=(path_a) {}
            path class="path-b" d=(path_b) {}
            path class="gained" d=(gained.0) {}
            path class="moved" d=(moved.0) {}
            path class="lost" d=(lost.0) {}
            @if 0.0 < trajectory.max_m {
                circle class="farthest" cx=(px(x)) cy=(px(y)) r="7" { title { (format!("{:.3} m", trajectory.max_m)) } }
            }
            g class="ticks" {
                path class="scale" d={ "M" (MARGIN) " " (px(height - 14.0)) "h" (px(bar_m * scale)) } {}
                text x=(px(MARGIN + bar_m * scale + 8.0)) y=(px(height - 10.0)) { (bar_m) " m" }
                text x=(SIZE - MARGIN) y=(px(height - 10.0)) text-anchor="end" {
                    tspan class="key-a" { "path A" } " · " tspan class="key-b" { "path B" } " · "
                    tspan class="key-lost" { (lost.1) " lost" } " · "
                    tspan class="key-gained" { (gained.1) " gained" } " · "
                    tspan class="key-moved" { (moved.1) " moved" }
                }
            }
        }
    }
}

/// The path of each segment of each log.
fn path(drawn: &[Drawn<'_>], at: &dyn Fn(&Pose2) -> (f64, f64)) -> String {
    let same = |a: &Drawn<'_>, b: &Drawn<'_>| {
        a.keyframe.id.log == b.keyframe.id.log && a.keyframe.segment == b.keyframe.segment
    };
    let segments = drawn.chunk_by(same);
    segments.map(|segment| thin_polyline(segment.iter().map(|k| at(&k.pose)), MIN_STEP)).collect()
}

/// The changed closures between two keyframes of a map, and their number.
fn closures(
    changes: &[ClosureChange],
    change: ChangeOfClosure,
    drawn: &[Drawn<'_>],
    at: &dyn Fn(&Pose2) -> (f64, f64),
) -> (String, usize) {
    let poses: HashMap<&ScanId, &Pose2> =
        drawn.iter().map(|drawn| (&drawn.keyframe.id, &drawn.pose)).collect();
    let pose = |log: &str, scan: u32| poses.get(&ScanId { log: log.into(), scan }).copied();
    let ends: Vec<(&Pose2, &Pose2)> = changes
        .iter()
        .filter(|closure| closure.change == change)
        .filter_map(|closure| {
            let query = pose(&closure.query_log, closure.query_scan)?;
            Some((query, pose(&closure.reference_log, closure.reference_scan)?))
        })
        .collect();
    let every = ends.len().div_ceil(MAX_LINES).max(1);
    let line = |(query, reference): &(&Pose2, &Pose2)| {
        let ((ax, ay), (bx, by)) = (at(query), at(reference));
        format!("M{} {}L{} {}", px(ax), px(ay), px(bx), px(by))
    };
    (ends.iter().step_by(every).map(line).collect(), ends.len())
}
