//! Beyond the labelled pairs: every pair, and pairs by other label rules.

use dataset::Retrieval;
use maud::{Markup, html};

use super::{distinct, figure, name_of, optional, thousands};
use crate::Input;
use crate::figures::Figure;

/// All pairs of keyframes at their natural prevalence.
pub(super) fn every_pair(input: &Input<'_>, figures: &[Figure]) -> Markup {
    let Some(first) = input.retrieval_of_all().next() else { return html! {} };
    let unscored: u64 = first.n_unscored;
    html! {
        section {
            h2 { "Every pair of a log" }
            p {
                "A robot that looks for loops meets few matches among many pairs. Here every scan is compared with every earlier scan "
                "of its log, but for the recent path, by classifiers that saw neither scan\u{2019}s fold (by " (first.grouping) "); their confidences are taken together as they are. "
                "Of " (thousands(first.n_positive + first.n_negative)) " pairs " (thousands(first.n_positive))
                " are matches: " b { (prevalence(first)) } ". "
                (thousands(first.n_ambiguous)) " pairs that are neither near nor far are left out; "
                "in the second reading they count as another place."
                @if unscored > 0 { " " (thousands(unscored)) " pairs could not be scored: without their folds one class is left." }
                @if first.query_stride > 1 { " Every " (first.query_stride) "th scan is a query: `evaluate.max_pairs`." }
            }
            (table(&input.retrieval_of_all().filter(|r| !r.ambiguous_as_negative).collect::<Vec<_>>(), "learner", |r| name_of(&r.learner)))
            h3 { "What is not a match counts as another place" }
            (table(&input.retrieval_of_all().filter(|r| r.ambiguous_as_negative).collect::<Vec<_>>(), "learner", |r| name_of(&r.learner)))
            div class="figures" {
                (figure(figures, "every-pair", &html! { "Precision against recall among every pair, ambiguous pairs left out." }))
            }
            @if input.retrieval.iter().any(|r| r.log.is_none()) {
                @for learner in distinct(input.retrieval.iter().map(|r| &*r.learner)) {
                    @let rows: Vec<&Retrieval> = input.retrieval.iter()
                        .filter(|r| r.learner == learner && r.log.is_some() && !r.ambiguous_as_negative).collect();
                    details { summary { "Log by log, " (name_of(learner)) }
                        (table(&rows, "log", |r| r.log.clone().unwrap_or_default()))
                    }
                }
            }
        }
    }
}

fn table(rows: &[&Retrieval], what: &str, name: impl Fn(&Retrieval) -> String) -> Markup {
    html! {
        div class="scroll" {
            table {
                thead { tr {
                    th { (what) } th { "average precision" }
                    th { "recall at 100\u{a0}% precision" small { "= detection at 0\u{a0}% false alarm" } }
                    th { "detection at 1\u{a0}% false alarm" } th { "max F1" } th { "pairs" } th { "matches" }
                } }
                tbody { @for row in rows { tr {
                    th { (name(row)) }
                    td { (optional(row.average_precision)) }
                    td { (optional(row.recall_at_full_precision)) }
                    td { (optional(row.detection_at_1_percent)) }
                    td { (optional(row.max_f1)) }
                    td { (thousands(row.n_positive + row.n_negative)) }
                    td { (prevalence(row)) }
                } } }
            }
        }
    }
}

fn prevalence(row: &Retrieval) -> String {
    let n = row.n_positive + row.n_negative;
    if n == 0 {
        "none".to_owned()
    } else {
        format!("{:.3}\u{a0}%", row.n_positive as f64 / n as f64 * 100.0)
    }
}

/// The error under other label rules.
pub(super) fn grid(input: &Input<'_>, figures: &[Figure]) -> Markup {
    let Some(first) = input.grid.first() else { return html! {} };
    let mut gaps: Vec<f64> = input.grid.iter().map(|c| c.min_travel_gap_m).collect();
    gaps.sort_by(f64::total_cmp);
    gaps.dedup_by(|a, b| a.total_cmp(b).is_eq());
    html! {
        section {
            h2 { "Other label rules" }
            p {
                "What counts as the same place, and what as another, decides how hard the task is. Each cell draws as many pairs anew by "
                "its own rules and cross-validates by " (first.grouping) "; error in per cent."
            }
            div class="figures" {
                @for learner in distinct(input.grid.iter().map(|c| &*c.learner)) {
                    @for gap in &gaps {
                        (figure(figures, &format!("grid-{learner}-{gap}"), &html! {
                            (name_of(learner)) ", "
                            @if *gap > 0.0 { "true revisits only: at least " (gap) " m of path between the scans of a match" }
                            @else { "neighbours along the path are matches too" }
                        }))
                    }
                }
            }
        }
    }
}
