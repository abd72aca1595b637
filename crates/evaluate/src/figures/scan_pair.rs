use maud::{Markup, html};

use super::{dots, px, round_length};

const SIDE: f64 = 150.0;
const GAP: f64 = 12.0;
const BELOW: f64 = 22.0;
/// Share of the returns within the frame.
const SHOWN: f64 = 0.95;

/// Two scans side by side, as the robot saw them: it stands in the middle and looks up.
pub(crate) fn scan_pair(id: &str, kind: &str, text: &str, scans: [&[[f64; 2]]; 2]) -> Markup {
    let mut reach: Vec<f64> =
        scans.into_iter().flatten().map(|p| p[0].abs().max(p[1].abs())).collect();
    reach.sort_by(f64::total_cmp);
    let place = (reach.len().saturating_sub(1) as f64 * SHOWN) as usize;
    let most = reach.get(place).copied().unwrap_or(1.0).max(1.0);
    let scale = SIDE / 2.0 / most;
    let bar_m = round_length(most / 2.0);
    html! {
        svg id=(id) class={ "scan-pair " (kind) } viewBox={ "0 0 " (2.0 * SIDE + GAP) " " (SIDE + BELOW) } role="img" aria-label=(text) {
            title { (text) }
            @for (k, scan) in scans.into_iter().enumerate() {
                @let (x, y) = (k as f64 * (SIDE + GAP) + SIDE / 2.0, SIDE / 2.0);
                rect class="frame" x=(px(x - SIDE / 2.0 + 0.5)) y="0.5" width=(SIDE - 1.0) height=(SIDE - 1.0) rx="4" {}
                // Forward is up, left is left.
                path class="returns" d=(dots(scan.iter().filter(|p| p[0].abs().max(p[1].abs()) <= most * 0.98).map(|p| (x - p[1] * scale, y - p[0] * scale)))) {}
                path class="robot" d={ "M" (px(x)) " " (px(y - 5.0)) "l3.5 8h-7z" } {}
            }
            g class="ticks" {
                path class="scale" d={ "M2 " (SIDE + 12.0) "h" (px(bar_m * scale)) } {}
                text x=(px(bar_m * scale + 8.0)) y=(SIDE + 16.0) { (bar_m) " m" }
            }
        }
    }
}
