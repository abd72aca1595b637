//! The error under other label rules.

use maud::{Markup, html};

use super::figure;
use crate::Input;
use crate::figures::Figure;
use crate::text::{distinct, learner_name};

pub(super) fn section(input: &Input<'_>, figures: &[Figure]) -> Markup {
    let Some(first) = input.grid.first() else { return html! {} };
    let mut gaps_m: Vec<f64> = input.grid.iter().map(|c| c.min_travel_gap_m).collect();
    gaps_m.sort_by(f64::total_cmp);
    gaps_m.dedup_by(|a, b| a.total_cmp(b).is_eq());
    html! {
        section {
            h2 { "Other label rules" }
            p {
                "The label rules decide which pairs are matches and which are non-matches, and therefore how hard the task is. "
                "For each cell, the same number of pairs is sampled again under the cell\u{2019}s rules and cross-validated by "
                (first.grouping) ". Cells show the error in per cent."
            }
            div class="figures" {
                @for learner in distinct(input.grid.iter().map(|c| &*c.learner)) {
                    @for gap_m in &gaps_m {
                        (figure(figures, &format!("grid-{learner}-{gap_m}"), &html! {
                            (learner_name(learner)) ". "
                            @if *gap_m > 0.0 { "Only revisits are matches: at least " (gap_m) " m of path between the two scans." }
                            @else { "Scans that follow each other along the path are matches too." }
                        }))
                    }
                }
            }
        }
    }
}
