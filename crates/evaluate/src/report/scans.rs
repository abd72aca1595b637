//! Scans: example pairs and maps.

use maud::{Markup, html};

use super::figure;
use crate::Input;
use crate::figures::{Figure, PairKind, Sketches, path_caption};
use crate::text::{distinct, learner_name};

pub(super) fn pairs_section(input: &Input<'_>, sketches: &Sketches, figures: &[Figure]) -> Markup {
    let Some((learner, grouping)) = &sketches.selected_by else { return html! {} };
    let correct = [PairKind::CorrectMatch, PairKind::CorrectNonMatch];
    let mistakes = [PairKind::FalseAlarm, PairKind::MissedMatch];
    let has_mistakes = sketches.pairs.iter().any(|pair| mistakes.contains(&pair.kind));
    html! {
        section {
            h2 { "Example pairs" }
            p {
                "The most confident decisions of " (learner_name(learner)) ", cross-validated by " (grouping)
                ". The robot is at the centre of each scan and faces up."
            }
            h3 { "Correct (paper, Figure\u{a0}1)" }
            div class="pairs" { (pair_figures(input, sketches, figures, correct)) }
            @if has_mistakes {
                h3 { "Worst mistakes (paper, Figure\u{a0}6)" }
                div class="pairs" { (pair_figures(input, sketches, figures, mistakes)) }
                p class="note" { "All mistakes are in " code { "evaluation/mistakes.parquet" } ", the most confident first." }
            } @else {
                p { (learner_name(learner)) " makes no mistakes." }
            }
        }
    }
}

fn pair_figures(
    input: &Input<'_>,
    sketches: &Sketches,
    figures: &[Figure],
    kinds: [PairKind; 2],
) -> Markup {
    html! {
        @for kind in kinds {
            @for (k, example) in sketches.pairs.iter().filter(|p| p.kind == kind).enumerate() {
                @let pair = &input.pairs[example.pair];
                @let (a, b) = (&input.keyframes[pair.query].id, &input.keyframes[pair.reference].id);
                (figure(figures, &format!("{}-{}", kind.id(), k + 1), &html! {
                    b { (kind.title()) } ", confidence " (format!("{:+.2}", example.confidence)) br;
                    "scan " (a.scan)
                    @if a.log != b.log { " of " (a.log) }
                    " and scan " (b.scan) " of " (b.log)
                    @if pair.distance_m.is_finite() { ", " (format!("{:.1}", pair.distance_m)) "\u{a0}m\u{a0}apart" }
                }))
            }
        }
    }
}

pub(super) fn maps_section(input: &Input<'_>, figures: &[Figure]) -> Markup {
    html! {
        section {
            h2 { "Maps" }
            div class="figures" {
                @for (k, site) in distinct(input.keyframes.iter().map(|k| &*k.site)).into_iter().enumerate() {
                    @let n = input.keyframes.iter().filter(|k| &*k.site == site).count();
                    (figure(figures, &format!("ground-{}", k + 1), &html! {
                        b { (site) } ": " (n) " scans drawn along the path (paper, Figure\u{a0}3b)"
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
