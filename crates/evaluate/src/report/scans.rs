//! Scans: pairs of them, and laid out on the ground.

use maud::{Markup, html};

use super::{distinct, figure, name_of};
use crate::Input;
use crate::figures::{Figure, path_caption};
use crate::sketches::{Kind, Sketches};

pub(super) fn scan_pairs(input: &Input<'_>, sketches: &Sketches, figures: &[Figure]) -> Markup {
    let Some((learner, grouping)) = &sketches.by else { return html! {} };
    html! {
        section {
            h2 { "Pairs of scans" }
            p {
                "By " (name_of(learner)) ", by " (grouping) ": the most confident of each kind. The robot stands in the middle and looks up."
            }
            h3 { "Told rightly (paper, Figure 1)" }
            div class="pairs" { (of_kinds(input, sketches, figures, [Kind::Match, Kind::NonMatch])) }
            h3 { "The worst mistakes (paper, Figure 6)" }
            div class="pairs" { (of_kinds(input, sketches, figures, [Kind::FalseAlarm, Kind::Missed])) }
            p class="note" { "All mistakes are in " code { "evaluation/mistakes.parquet" } ", worst first." }
        }
    }
}

fn of_kinds(
    input: &Input<'_>,
    sketches: &Sketches,
    figures: &[Figure],
    kinds: [Kind; 2],
) -> Markup {
    html! {
        @for kind in kinds {
            @for (k, drawn) in sketches.pairs.iter().filter(|p| p.kind == kind).enumerate() {
                @let pair = &input.pairs[drawn.pair];
                @let (a, b) = (&input.keyframes[pair.query].id, &input.keyframes[pair.reference].id);
                (figure(figures, &format!("{}-{}", kind.id(), k + 1), &html! {
                    b { (kind.title()) } ", confidence " (format!("{:+.2}", drawn.confidence)) br;
                    (a.log) " " (a.scan) " and "
                    @if a.log != b.log { (b.log) " " } (b.scan)
                    @if pair.distance_m.is_finite() { ", " (format!("{:.1}", pair.distance_m)) " m apart" }
                }))
            }
        }
    }
}

pub(super) fn maps(input: &Input<'_>, figures: &[Figure]) -> Markup {
    html! {
        section {
            h2 { "Where" }
            div class="figures" {
                @for (k, site) in distinct(input.keyframes.iter().map(|k| &*k.site)).into_iter().enumerate() {
                    @let n = input.keyframes.iter().filter(|k| &*k.site == site).count();
                    (figure(figures, &format!("ground-{}", k + 1), &html! {
                        b { (site) } ": " (n) " scans laid out along the path (paper, Figure 3b)"
                    }))
                    (figure(figures, &format!("map-{}", k + 1), &html! {
                        b { (site) } ": the path and the labelled pairs"
                    }))
                }
                @for (k, of_log) in input.keyframes.chunk_by(|a, b| a.id.log == b.id.log).enumerate() {
                    (figure(figures, &format!("path-{}", k + 1), &html! {
                        b { (of_log[0].id.log) } ": " (path_caption(of_log))
                    }))
                }
            }
        }
    }
}
