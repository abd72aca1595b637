use dataset::{Keyframe, StampedPose};
use maud::{Markup, PreEscaped, html};

use super::map::scale_bar_m;
use super::px;

const SIZE: f64 = 640.0;
const MARGIN: f64 = 24.0;
/// Below the path, for the bar that tells the scale.
const FOOT: f64 = 28.0;
/// Ellipses drawn along a path, and scans that tell of themselves; more would cover each other.
const MAX_ELLIPSES: usize = 20;
const MAX_HOVER: usize = 150;
/// A point of the path that is nearer to the last one drawn is left out \[px\].
const MIN_STEP: f64 = 0.4;
/// Square of the radius within which a normal pair of numbers lies in 95 of 100 cases, in
/// deviations: chi-square with 2 degrees of freedom, -2 ln(0.05).
const CHI_SQUARE_95: f64 = 5.991_464_547;
/// The same of one number, its root: the normal distribution.
const NORMAL_95: f64 = 1.959_963_985;
/// Control points of a quarter of a circle of radius 1 by a Bézier curve, off by 0.03 %:
/// 4/3 (sqrt(2) - 1).
const KAPPA: f64 = 0.552_284_750;

/// The colours are those of the report, and plain ones in a file of its own.
const STYLE: &str = "
.path-line { fill: none; stroke: var(--faint, #5b6570); stroke-width: 1.4; stroke-linejoin: round; }
.path-kept { fill: none; stroke: var(--c0, #0072b2); stroke-width: 2.6; stroke-linecap: round; }
.path-sure { fill: var(--c1, #d55e00); fill-opacity: .12; stroke: var(--c1, #d55e00); stroke-opacity: .6; stroke-width: 1; }
.path-end { fill: var(--paper, #fff); stroke: var(--ink, #1b1f24); stroke-width: 2; }
.path-scale { fill: none; stroke: var(--ink, #1b1f24); stroke-width: 2; }
.path-text { fill: var(--ink, #1b1f24); font: 13px system-ui, sans-serif; }
.path-hover { fill: var(--c0, #0072b2); fill-opacity: 0; } .path-hover:hover { fill-opacity: 1; }
";

/// The path of one log as an SVG file: its poses, where they lie in 95 of 100 cases, and the scans
/// kept.
pub fn path_svg(log: &str, poses: &[StampedPose], kept: &[Keyframe]) -> String {
    svg(log, poses, kept, Some("http://www.w3.org/2000/svg")).into_string()
}

/// The paths of the logs by their keyframes, a figure each.
pub(crate) fn paths(keyframes: &[Keyframe]) -> Markup {
    html! {
        div class="figures" {
            @for of_log in keyframes.chunk_by(|a, b| a.id.log == b.id.log) {
                @let poses: Vec<StampedPose> = of_log.iter().map(stamped).collect();
                @let log = &*of_log[0].id.log;
                figure class="map" {
                    (svg(log, &poses, of_log, None))
                    figcaption { b { (log) } ": " (caption(&poses, of_log)) }
                }
            }
        }
    }
}

fn stamped(keyframe: &Keyframe) -> StampedPose {
    StampedPose {
        stamp_ns: keyframe.stamp_ns,
        pose: keyframe.pose,
        covariance: keyframe.covariance,
    }
}

fn caption(poses: &[StampedPose], kept: &[Keyframe]) -> String {
    let travel_m = kept.last().map_or(0.0, |k| k.travel_m);
    let scans = format!("{} scans kept along {travel_m:.0} m", kept.len());
    let at_end = poses.last().and_then(|last| last.covariance);
    match at_end {
        Some(covariance) => format!("{scans}; at the end 95 % {}", within(&covariance)),
        None => format!("{scans}; its poses do not tell how well they are known"),
    }
}

/// How poses lie on the page: x to the right, y up.
struct View {
    x_min: f64,
    y_max: f64,
    /// \[px/m\]
    scale: f64,
    height: f64,
    bar_m: f64,
}

impl View {
    fn of(poses: &[StampedPose]) -> Self {
        let range = |of: fn(&StampedPose) -> f64| {
            let ends = (f64::INFINITY, f64::NEG_INFINITY);
            poses.iter().map(of).fold(ends, |(a, b), v| (a.min(v), b.max(v)))
        };
        let ((x_min, x_max), (y_min, y_max)) = (range(|p| p.pose.x_m), range(|p| p.pose.y_m));
        let scale = (SIZE - 2.0 * MARGIN) / (x_max - x_min).max(y_max - y_min).max(1.0);
        let height = (y_max - y_min) * scale + 2.0 * MARGIN + FOOT;
        Self { x_min, y_max, scale, height, bar_m: scale_bar_m(x_max - x_min) }
    }

    fn at(&self, pose: &StampedPose) -> (f64, f64) {
        let (x, y) = (pose.pose.x_m - self.x_min, self.y_max - pose.pose.y_m);
        (x * self.scale + MARGIN, y * self.scale + MARGIN)
    }

    fn line(&self, poses: &[StampedPose]) -> String {
        let mut line = String::new();
        let mut last: Option<(f64, f64)> = None;
        for pose in poses {
            let (x, y) = self.at(pose);
            let is_near = |(a, b): (f64, f64)| (x - a).abs().max((y - b).abs()) < MIN_STEP;
            if !last.is_some_and(is_near) {
                let letter = if last.is_some() { 'L' } else { 'M' };
                line.push_str(&format!("{letter}{} {}", px(x), px(y)));
                last = Some((x, y));
            }
        }
        line
    }

    /// The ellipse around a pose, in four Bézier curves: a circle, stretched by the lower triangle
    /// L of the covariance C = L L^T (Cholesky), of which the root of chi-square is the radius.
    fn ellipse(&self, pose: &StampedPose, covariance: &[f64; 6]) -> String {
        let [xx, xy, _, yy, _, _] = *covariance;
        let a = xx.max(0.0).sqrt();
        let b = if 0.0 < a { xy / a } else { 0.0 };
        let c = (yy - b * b).max(0.0).sqrt();
        let radius = CHI_SQUARE_95.sqrt() * self.scale;
        let (x, y) = self.at(pose);
        let point = |u: f64, v: f64| {
            format!("{} {}", px(x + radius * a * u), px(y - radius * (b * u + c * v)))
        };
        let mut curve = format!("M{}", point(1.0, 0.0));
        for (u, v) in [(1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0)] {
            // From (u, v) a quarter turn to the left.
            let (to_u, to_v) = (-v, u);
            curve.push_str(&format!(
                "C{},{},{}",
                point(u + KAPPA * to_u, v + KAPPA * to_v),
                point(to_u + KAPPA * u, to_v + KAPPA * v),
                point(to_u, to_v)
            ));
        }
        curve.push('Z');
        curve
    }
}

/// A file of its own needs the namespace; in a page it would be a link to elsewhere.
fn svg(log: &str, poses: &[StampedPose], kept: &[Keyframe], namespace: Option<&str>) -> Markup {
    let (Some(first), Some(last)) = (poses.first(), poses.last()) else { return html! {} };
    let view = View::of(poses);
    let dots: String = kept
        .iter()
        .map(|keyframe| {
            let (x, y) = view.at(&stamped(keyframe));
            format!("M{} {}h0", px(x), px(y))
        })
        .collect();
    let ((start_x, start_y), (end_x, end_y)) = (view.at(first), view.at(last));
    html! {
        svg class="path-figure" xmlns=[namespace] viewBox={ "0 0 " (SIZE) " " (px(view.height)) } role="img"
            aria-label={ "Path of log " (log) ": " (caption(poses, kept)) } style="background: var(--wash, #f4f6f8)" {
            style { (PreEscaped(STYLE)) }
            @for (pose, covariance, travel_m) in sure(poses) {
                path class="path-sure" d=(view.ellipse(pose, covariance)) {
                    title { (log) ", " (format!("{travel_m:.0}")) " m: 95 % " (within(covariance)) }
                }
            }
            path class="path-line" d=(view.line(poses)) {}
            path class="path-kept" d=(dots) {}
            @for keyframe in kept.iter().step_by(kept.len().div_ceil(MAX_HOVER).max(1)) {
                @let (x, y) = view.at(&stamped(keyframe));
                circle class="path-hover" cx=(px(x)) cy=(px(y)) r="4" { title { (hover(keyframe)) } }
            }
            path class="path-end" d={ "M" (px(start_x - 5.0)) " " (px(start_y)) "l5 -5l5 5l-5 5Z" } { title { "start" } }
            path class="path-end" d={ "M" (px(end_x - 4.0)) " " (px(end_y - 4.0)) "h8v8h-8Z" } { title { "end" } }
            text class="path-text" x=(px(start_x + 9.0)) y=(px(start_y - 7.0)) { "start" }
            text class="path-text" x=(px(end_x + 9.0)) y=(px(end_y + 15.0)) { "end" }
            path class="path-scale" d={ "M" (MARGIN) " " (px(view.height - 14.0)) "h" (px(view.bar_m * view.scale)) } {}
            text class="path-text" x=(px(MARGIN + view.bar_m * view.scale + 8.0)) y=(px(view.height - 10.0)) { (view.bar_m) " m" }
        }
    }
}

/// Poses that tell how well they are known, evenly along the path and the last one of all, with the
/// path's length up to there \[m\].
fn sure(poses: &[StampedPose]) -> Vec<(&StampedPose, &[f64; 6], f64)> {
    let mut ways_m = vec![0.0];
    for pair in poses.windows(2) {
        ways_m.push(ways_m[ways_m.len() - 1] + pair[0].pose.distance_m(&pair[1].pose));
    }
    let every_m = ways_m[ways_m.len() - 1] / MAX_ELLIPSES as f64;
    let mut sure = Vec::new();
    let mut next_m = every_m;
    for (k, (pose, &way_m)) in poses.iter().zip(&ways_m).enumerate() {
        let is_last = k + 1 == poses.len();
        if let Some(covariance) = &pose.covariance
            && (next_m <= way_m || is_last)
        {
            sure.push((pose, covariance, way_m));
            next_m = way_m + every_m;
        }
    }
    sure
}

/// The half axes of the ellipse, from the eigenvalues of the covariance of x and y, and the
/// heading.
fn within(covariance: &[f64; 6]) -> String {
    let [xx, xy, _, yy, _, hh] = *covariance;
    let (mean, difference) = (0.5 * (xx + yy), 0.5 * (xx - yy));
    let root = (difference * difference + xy * xy).sqrt();
    let axis_m = |eigenvalue: f64| (CHI_SQUARE_95 * eigenvalue.max(0.0)).sqrt();
    let heading_deg = (NORMAL_95 * hh.max(0.0).sqrt()).to_degrees();
    format!(
        "within {:.2} x {:.2} m, heading within {heading_deg:.2} deg",
        axis_m(mean + root),
        axis_m(mean - root)
    )
}

fn hover(keyframe: &Keyframe) -> String {
    let pose = &keyframe.pose;
    format!(
        "{}, scan {}: {:.0} m on, at {:.2}, {:.2} m, heading {:.1} deg",
        keyframe.id.log,
        keyframe.id.scan,
        keyframe.travel_m,
        pose.x_m,
        pose.y_m,
        pose.heading_rad.to_degrees()
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use dataset::Pose2;

    /// 100 m along x, with the covariance growing to 4 m^2 along and 1 m^2 aside.
    fn poses() -> Vec<StampedPose> {
        let pose = |k: i64| StampedPose {
            stamp_ns: k,
            pose: Pose2 { x_m: k as f64, y_m: 0.0, heading_rad: 0.0 },
            covariance: Some([0.04 * k as f64, 0.0, 0.0, 0.01 * k as f64, 0.0, 0.0]),
        };
        (0..=100).map(pose).collect()
    }

    /// Half axes 2 and 1 m times the root of 5.99: 4.90 and 2.45 m; 592 px are 100 m.
    #[test]
    fn an_ellipse_by_hand() {
        let poses = poses();
        let last = poses.last().unwrap();
        let view = View::of(&poses);
        let curve = view.ellipse(last, &last.covariance.unwrap());
        // The rightmost point is 4.896 m right of 616 px, then the topmost, 2.448 m above 24 px.
        assert!(curve.starts_with("M645 24C645 16"), "{curve}");
        assert!(curve.contains(",616 9.5C"), "{curve}");
        let (_, covariance, way_m) = *sure(&poses).last().unwrap();
        assert_eq!(way_m, 100.0);
        assert_eq!(within(covariance), "within 4.90 x 2.45 m, heading within 0.00 deg");
        // Turned by 45 deg: eigenvalues 4 and 1 are 2.5 +- 1.5.
        let turned = [2.5, 1.5, 0.0, 2.5, 0.0, 1e-4];
        assert_eq!(within(&turned), "within 4.90 x 2.45 m, heading within 1.12 deg");
    }

    #[test]
    fn what_is_drawn_can_be_counted() {
        let poses = poses();
        let drawn = path_svg("a<b", &poses, &[]);
        assert_eq!(drawn.matches("class=\"path-sure\"").count(), 20);
        assert!(drawn.contains("a&lt;b") && !drawn.contains("a<b"));
        assert!(drawn.contains(">20 m</text>"), "a bar of a fifth of the width");
        let plain: Vec<StampedPose> =
            poses.iter().map(|p| StampedPose { covariance: None, ..*p }).collect();
        assert!(!path_svg("a", &plain, &[]).contains("class=\"path-sure\""));
        assert_eq!(path_svg("a", &[], &[]), "");
    }
}
