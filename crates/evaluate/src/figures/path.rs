//! The path of one log with position uncertainty and keyframes.

use dataset::{Keyframe, StampedPose};
use maud::{Markup, html};

use super::svg::{Figure, dots, px, round_length};

const SIZE: f64 = 640.0;
const MARGIN: f64 = 24.0;
/// Height below the path for the scale bar.
const FOOT: f64 = 28.0;
/// Ellipses drawn along a path. More would cover each other.
const MAX_ELLIPSES: usize = 20;
/// Keyframes with a tooltip.
const MAX_HOVER: usize = 150;
/// Points of the path closer than this to the last drawn one are skipped \[px\].
const MIN_STEP: f64 = 0.4;
/// 95 % quantile of the chi-square distribution with 2 degrees of freedom, -2 ln(0.05): the squared
/// radius, in standard deviations, that contains 95 % of a bivariate normal distribution.
const CHI_SQUARE_95: f64 = 5.991_464_547;
/// 97.5 % quantile of the normal distribution: plus or minus this many standard deviations contain
/// 95 %.
const NORMAL_95: f64 = 1.959_963_985;
/// Distance of the control points of a cubic Bézier curve that approximates a quarter of the unit
/// circle with an error of 0.03 %: 4/3 (sqrt(2) - 1).
const KAPPA: f64 = 0.552_284_750;

/// The path of one log as an SVG file: the poses, their 95 % ellipses and the keyframes.
pub fn path_svg(log: &str, poses: &[StampedPose], keyframes: &[Keyframe]) -> String {
    Figure::new("path", svg("path", log, poses, keyframes)).standalone()
}

/// The path through the keyframes of one log.
pub(super) fn path(id: &str, of_log: &[Keyframe]) -> Markup {
    let poses: Vec<StampedPose> = of_log.iter().map(stamped).collect();
    let log = of_log.first().map_or("", |keyframe| &*keyframe.id.log);
    svg(id, log, &poses, of_log)
}

/// The caption of [`path`].
pub(crate) fn path_caption(of_log: &[Keyframe]) -> String {
    let poses: Vec<StampedPose> = of_log.iter().map(stamped).collect();
    caption(&poses, of_log)
}

fn stamped(keyframe: &Keyframe) -> StampedPose {
    StampedPose {
        stamp_ns: keyframe.stamp_ns,
        pose: keyframe.pose,
        covariance: keyframe.covariance,
        z_m: keyframe.z_m,
        segment: keyframe.segment,
        frame: keyframe.frame,
    }
}

fn caption(poses: &[StampedPose], keyframes: &[Keyframe]) -> String {
    let travel_m = keyframes.last().map_or(0.0, |k| k.travel_m);
    let scans = format!("{} keyframes along {travel_m:.0} m", keyframes.len());
    let at_end = poses.last().and_then(|last| last.covariance);
    match at_end {
        Some(covariance) => {
            format!("{scans}; 95 % uncertainty at the end: {}", uncertainty(&covariance))
        }
        None => format!("{scans}; the poses have no covariance"),
    }
}

/// Transforms poses to pixels: x to the right, y up.
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
        Self { x_min, y_max, scale, height, bar_m: round_length((x_max - x_min).max(5.0) / 5.0) }
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

    /// The 95 % ellipse of a pose as four Bézier curves: the circle whose radius is the square root
    /// of chi-square, transformed by the Cholesky factor L of the covariance C = L L^T.
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
            // The next quarter ends 90 deg to the left of (u, v).
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

fn svg(id: &str, log: &str, poses: &[StampedPose], keyframes: &[Keyframe]) -> Markup {
    let (Some(first), Some(last)) = (poses.first(), poses.last()) else {
        return html! { svg id=(id) class="map" {} };
    };
    let view = View::of(poses);
    let dots = dots(keyframes.iter().map(|keyframe| view.at(&stamped(keyframe))));
    let ((start_x, start_y), (end_x, end_y)) = (view.at(first), view.at(last));
    html! {
        svg id=(id) class="map" viewBox={ "0 0 " (SIZE) " " (px(view.height)) } role="img"
            aria-label={ "Path of log " (log) ": " (caption(poses, keyframes)) } {
            @for (pose, covariance, travel_m) in poses_with_ellipse(poses) {
                path class="path-sure" d=(view.ellipse(pose, covariance)) {
                    title { (log) " at " (format!("{travel_m:.0}")) " m: 95 % uncertainty " (uncertainty(covariance)) }
                }
            }
            path class="path-line" d=(view.line(poses)) {}
            path class="path-kept" d=(dots) {}
            @for keyframe in keyframes.iter().step_by(keyframes.len().div_ceil(MAX_HOVER).max(1)) {
                @let (x, y) = view.at(&stamped(keyframe));
                circle class="path-hover" cx=(px(x)) cy=(px(y)) r="4" { title { (tooltip(keyframe)) } }
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

/// Poses with a covariance at even distances along the path, and the last pose. The third value is
/// the length of the path up to the pose \[m\].
fn poses_with_ellipse(poses: &[StampedPose]) -> Vec<(&StampedPose, &[f64; 6], f64)> {
    let mut travels_m = vec![0.0];
    for pair in poses.windows(2) {
        travels_m.push(travels_m[travels_m.len() - 1] + pair[0].pose.distance_m(&pair[1].pose));
    }
    let spacing_m = travels_m[travels_m.len() - 1] / MAX_ELLIPSES as f64;
    let mut selected = Vec::new();
    let mut next_m = spacing_m;
    for (k, (pose, &travel_m)) in poses.iter().zip(&travels_m).enumerate() {
        let is_last = k + 1 == poses.len();
        if let Some(covariance) = &pose.covariance
            && (next_m <= travel_m || is_last)
        {
            selected.push((pose, covariance, travel_m));
            next_m = travel_m + spacing_m;
        }
    }
    selected
}

/// The half axes of the 95 % ellipse, from the eigenvalues of the covariance of x and y, and the
/// 95 % interval of the heading.
fn uncertainty(covariance: &[f64; 6]) -> String {
    let [xx, xy, _, yy, _, hh] = *covariance;
    let (mean, difference) = (0.5 * (xx + yy), 0.5 * (xx - yy));
    let root = (difference * difference + xy * xy).sqrt();
    let axis_m = |eigenvalue: f64| (CHI_SQUARE_95 * eigenvalue.max(0.0)).sqrt();
    let heading_deg = (NORMAL_95 * hh.max(0.0).sqrt()).to_degrees();
    format!(
        "\u{b1}{:.2} m by \u{b1}{:.2} m, heading \u{b1}{heading_deg:.2} deg",
        axis_m(mean + root),
        axis_m(mean - root)
    )
}

fn tooltip(keyframe: &Keyframe) -> String {
    let pose = &keyframe.pose;
    format!(
        "{}, scan {}: {:.0} m along the path, x {:.2} m, y {:.2} m, heading {:.1} deg",
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

    /// 100 m along x. The variance grows to 4 m^2 in x and 1 m^2 in y.
    fn poses() -> Vec<StampedPose> {
        let pose = |k: i64| StampedPose {
            covariance: Some([0.04 * k as f64, 0.0, 0.0, 0.01 * k as f64, 0.0, 0.0]),
            ..StampedPose::new(k, Pose2 { x_m: k as f64, y_m: 0.0, heading_rad: 0.0 })
        };
        (0..=100).map(pose).collect()
    }

    /// Half axes: 2 m and 1 m times the square root of 5.99, or 4.90 m and 2.45 m. Scale: 592 px are
    /// 100 m.
    #[test]
    fn ellipses_match_values_computed_by_hand() {
        let poses = poses();
        let last = poses.last().unwrap();
        let view = View::of(&poses);
        let curve = view.ellipse(last, &last.covariance.unwrap());
        // The curve starts 4.896 m right of 616 px. Its top is 2.448 m above 24 px.
        assert!(curve.starts_with("M645 24C645 16"), "{curve}");
        assert!(curve.contains(",616 9.5C"), "{curve}");
        let (_, covariance, travel_m) = *poses_with_ellipse(&poses).last().unwrap();
        assert_eq!(travel_m, 100.0);
        assert_eq!(uncertainty(covariance), "\u{b1}4.90 m by \u{b1}2.45 m, heading \u{b1}0.00 deg");
        // Rotated by 45 deg: the eigenvalues 4 and 1 are 2.5 +- 1.5.
        let rotated = [2.5, 1.5, 0.0, 2.5, 0.0, 1e-4];
        assert_eq!(uncertainty(&rotated), "\u{b1}4.90 m by \u{b1}2.45 m, heading \u{b1}1.12 deg");
    }

    #[test]
    fn a_path_shows_20_ellipses_a_scale_bar_and_escaped_names() {
        let poses = poses();
        let with_covariance = path_svg("a<b", &poses, &[]);
        assert_eq!(with_covariance.matches("class=\"path-sure\"").count(), 20);
        assert!(with_covariance.contains("a&lt;b") && !with_covariance.contains("a<b"));
        assert!(with_covariance.contains(">20 m</text>"), "the scale bar is a fifth of the width");
        let without_covariance: Vec<StampedPose> =
            poses.iter().map(|p| StampedPose { covariance: None, ..*p }).collect();
        assert!(!path_svg("a", &without_covariance, &[]).contains("class=\"path-sure\""));
        assert!(!path_svg("a", &[], &[]).contains("<path"));
    }
}
