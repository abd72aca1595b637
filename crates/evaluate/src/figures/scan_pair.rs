//! Two scans side by side.

use dataset::Label;
use maud::{Markup, html};

use super::sketches::Sketches;
use super::svg::{Figure, dots, px, round_length};
use crate::Input;

const SIDE: f64 = 150.0;
const GAP: f64 = 12.0;
const BELOW: f64 = 22.0;
/// Share of the returns inside the frame.
const SHOWN: f64 = 0.95;

/// Draws the example pairs.
pub(super) fn scan_pairs(input: &Input<'_>, sketches: &Sketches) -> Vec<Figure> {
    let mut figures = Vec::new();
    let mut counts = [0; 4];
    for example in &sketches.pairs {
        let pair = &input.pairs[example.pair];
        let returns = |k: usize| sketches.returns.get(&k).map_or(&[][..], Vec::as_slice);
        counts[example.kind as usize] += 1;
        let id = format!("{}-{}", example.kind.id(), counts[example.kind as usize]);
        let class = if pair.label == Label::Positive { "same" } else { "another" };
        let id_of = |k: usize| &input.keyframes[k].id;
        let (a, b) = (id_of(pair.query), id_of(pair.reference));
        let text = format!(
            "{}: scan {} of {} and scan {} of {}, confidence {:+.2}",
            example.kind.title(),
            a.scan,
            a.log,
            b.scan,
            b.log,
            example.confidence
        );
        let svg = scan_pair(&id, class, &text, [returns(pair.query), returns(pair.reference)]);
        figures.push(Figure::new(&id, svg));
    }
    figures
}

/// Two scans in the frame of the robot, which is at the centre and faces up.
fn scan_pair(id: &str, kind: &str, text: &str, scans: [&[[f64; 2]]; 2]) -> Markup {
    let mut extents_m: Vec<f64> =
        scans.into_iter().flatten().map(|p| p[0].abs().max(p[1].abs())).collect();
    extents_m.sort_by(f64::total_cmp);
    let index = (extents_m.len().saturating_sub(1) as f64 * SHOWN) as usize;
    let extent_m = extents_m.get(index).copied().unwrap_or(1.0).max(1.0);
    let scale = SIDE / 2.0 / extent_m;
    let bar_m = round_length(extent_m / 2.0);
    html! {
        svg id=(id) class={ "scan-pair " (kind) } viewBox={ "0 0 " (2.0 * SIDE + GAP) " " (SIDE + BELOW) } role="img" aria-label=(text) {
            title { (text) }
            @for (k, scan) in scans.into_iter().enumerate() {
                @let (x, y) = (k as f64 * (SIDE + GAP) + SIDE / 2.0, SIDE / 2.0);
                rect class="frame" x=(px(x - SIDE / 2.0 + 0.5)) y="0.5" width=(SIDE - 1.0) height=(SIDE - 1.0) rx="4" {}
                // The robot faces up, its left is left.
                path class="returns" d=(dots(scan.iter().filter(|p| p[0].abs().max(p[1].abs()) <= extent_m * 0.98).map(|p| (x - p[1] * scale, y - p[0] * scale)))) {}
                path class="robot" d={ "M" (px(x)) " " (px(y - 5.0)) "l3.5 8h-7z" } {}
            }
            g class="ticks" {
                path class="scale" d={ "M2 " (SIDE + 12.0) "h" (px(bar_m * scale)) } {}
                text x=(px(bar_m * scale + 8.0)) y=(SIDE + 16.0) { (bar_m) " m" }
            }
        }
    }
}
