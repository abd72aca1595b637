use dataset::{Keyframe, Label, Pair};
use maud::{Markup, html};

use super::{px, round_length};

const SIZE: f64 = 640.0;
const MARGIN: f64 = 20.0;
/// Negative pairs drawn on a map; all of them would cover it.
const MAX_NEGATIVES: usize = 150;

/// The keyframes of one site, their paths, and the pairs drawn among them.
pub(crate) fn map(id: &str, site: &str, keyframes: &[Keyframe], pairs: &[Pair]) -> Markup {
    let here = |k: usize| &*keyframes[k].site == site;
    let of_site: Vec<&Keyframe> = keyframes.iter().filter(|k| &*k.site == site).collect();
    let range = |of: fn(&Keyframe) -> f64| {
        of_site
            .iter()
            .map(|k| of(k))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)))
    };
    let ((x_min, x_max), (y_min, y_max)) = (range(|k| k.pose.x_m), range(|k| k.pose.y_m));
    let scale = (SIZE - 2.0 * MARGIN) / (x_max - x_min).max(y_max - y_min).max(1.0);
    let height = (y_max - y_min) * scale + 2.0 * MARGIN + 28.0;
    let at = |k: &Keyframe| {
        ((k.pose.x_m - x_min) * scale + MARGIN, (y_max - k.pose.y_m) * scale + MARGIN)
    };
    let lines = |label: Label, most: usize| {
        let of_label: Vec<&Pair> = pairs
            .iter()
            .filter(|p| p.label == label && here(p.query) && here(p.reference))
            .collect();
        let every = of_label.len().div_ceil(most).max(1);
        let path: String = of_label
            .iter()
            .step_by(every)
            .map(|pair| {
                let ((ax, ay), (bx, by)) =
                    (at(&keyframes[pair.query]), at(&keyframes[pair.reference]));
                format!("M{} {}L{} {}", px(ax), px(ay), px(bx), px(by))
            })
            .collect();
        (path, of_label.len(), of_label.len().div_ceil(every))
    };
    let (positive, n_positive, _) = lines(Label::Positive, usize::MAX);
    let (negative, n_negative, n_negative_drawn) = lines(Label::Negative, MAX_NEGATIVES);
    let mut logs: Vec<&str> = of_site.iter().map(|k| &*k.id.log).collect();
    logs.dedup();
    let paths: Vec<String> = logs
        .iter()
        .map(|log| {
            polyline(of_site.iter().filter(|k| &*k.id.log == *log).map(|keyframe| at(keyframe)))
        })
        .collect();
    let bar_m = round_length((x_max - x_min).max(5.0) / 5.0);
    let description = format!(
        "Map of site {site}: {} keyframes of {} logs, {n_positive} positive and {n_negative} negative pairs",
        of_site.len(),
        logs.len()
    );
    html! {
        svg id=(id) class="map" viewBox={ "0 0 " (SIZE) " " (px(height)) } role="img" aria-label=(description) {
            path class="negative" d=(negative) {}
            @for path in &paths { path class="path" d=(path) {} }
            path class="positive" d=(positive) {}
            g class="ticks" {
                path class="scale" d={ "M" (MARGIN) " " (px(height - 14.0)) "h" (px(bar_m * scale)) } {}
                text x=(px(MARGIN + bar_m * scale + 8.0)) y=(px(height - 10.0)) { (bar_m) " m" }
                text x=(SIZE - MARGIN) y=(px(height - 10.0)) text-anchor="end" {
                    tspan class="key-positive" { (n_positive) " positive" } " · "
                    tspan class="key-negative" { (n_negative) " negative" }
                    @if n_negative_drawn < n_negative { " (" (n_negative_drawn) " drawn)" }
                }
            }
        }
    }
}

/// A line through points, those left out that fall on the one before.
pub(super) fn polyline(points: impl Iterator<Item = (f64, f64)>) -> String {
    let mut path = String::new();
    let mut last = String::new();
    for (x, y) in points {
        let at = format!("{} {}", px(x), px(y));
        if at != last {
            path.push(if path.is_empty() { 'M' } else { 'L' });
            path.push_str(&at);
            last = at;
        }
    }
    path
}
