//! The paths and labelled pairs of a site.

use dataset::{Keyframe, Label, Pair};
use maud::{Markup, html};

use super::svg::{polyline, px, round_length};

const SIZE: f64 = 640.0;
const MARGIN: f64 = 20.0;
/// Negative pairs drawn on a map. All of them would cover it.
const MAX_NEGATIVES: usize = 150;

/// The paths of one site and the labelled pairs of its keyframes.
pub(super) fn site_map(id: &str, site: &str, keyframes: &[Keyframe], pairs: &[Pair]) -> Markup {
    let is_here = |k: usize| &*keyframes[k].site == site;
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
            .filter(|p| p.label == label && is_here(p.query) && is_here(p.reference))
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
        "Map of site {site}: {} keyframes in {} logs, {n_positive} matches and {n_negative} non-matches",
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
                    tspan class="key-positive" { (n_positive) " matches" } " · "
                    tspan class="key-negative" { (n_negative) " non-matches" }
                    @if n_negative_drawn < n_negative { " (" (n_negative_drawn) " drawn)" }
                }
            }
        }
    }
}
