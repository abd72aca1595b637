//! Retrieval at natural prevalence: all pairs of keyframes of a log, not only the labelled ones.

use dataset::Retrieval;
use maud::{Markup, html};

use super::cross_validation::operating_point_headers;
use super::figure;
use crate::Input;
use crate::figures::Figure;
use crate::text::{NO_VALUE, distinct, learner_name, optional_percent, thousands};

pub(super) fn section(input: &Input<'_>, figures: &[Figure]) -> Markup {
    let Some(first) = input.retrieval_of_all().next() else { return html! {} };
    let rows = |ambiguous_as_negative: bool| -> Vec<&Retrieval> {
        let rows = input.retrieval_of_all();
        rows.filter(|r| r.ambiguous_as_negative == ambiguous_as_negative).collect()
    };
    html! {
        section {
            h2 { "Retrieval at natural prevalence" }
            p {
                "Each scan is compared with all earlier scans of its log except those from the most recent part of the path, "
                "as a robot does when it looks for loop closures. Few of these pairs match."
            }
            (pair_counts(first))
            h3 { "Ambiguous pairs excluded" }
            (table(&rows(false), "learner", |r| learner_name(&r.learner)))
            h3 { "Ambiguous pairs counted as non-matches" }
            (table(&rows(true), "learner", |r| learner_name(&r.learner)))
            div class="figures" {
                (figure(figures, "retrieval", &html! {
                    "Precision against recall at natural prevalence, ambiguous pairs excluded."
                }))
            }
            (tables_of_logs(input))
        }
    }
}

/// How many pairs there are, how many of them match, and which are missing.
fn pair_counts(first: &Retrieval) -> Markup {
    html! {
        p {
            "Of " (thousands(first.n_positive + first.n_negative)) " pairs, " (thousands(first.n_positive))
            " (" b { (prevalence(first)) } ") are matches. "
            (thousands(first.n_ambiguous)) " more pairs are ambiguous: too far apart for a match and too close for a non-match. "
            "The classifiers are those of the cross-validation by " (first.grouping) ": each pair is scored by one trained without the folds of its two scans."
            @if first.n_unscored > 0 {
                " " (thousands(first.n_unscored)) " pairs have no score: without their folds, one class has no training pairs."
            }
            @if first.query_stride > 1 {
                " To stay within " code { "evaluate.max_pairs" } ", only one in " (first.query_stride) " scans is a query."
            }
        }
    }
}

/// A table for each learner with one row per log. Nothing if there is only one log.
fn tables_of_logs(input: &Input<'_>) -> Markup {
    let has_several_logs = input.retrieval.iter().any(|r| r.log.is_none());
    if !has_several_logs {
        return html! {};
    }
    html! {
        @for learner in distinct(input.retrieval.iter().map(|r| &*r.learner)) {
            @let rows: Vec<&Retrieval> = input.retrieval.iter()
                .filter(|r| r.learner == learner && r.log.is_some() && !r.ambiguous_as_negative).collect();
            details { summary { "Results per log: " (learner_name(learner)) }
                (table(&rows, "log", |r| r.log.clone().unwrap_or_default()))
            }
        }
    }
}

fn table(rows: &[&Retrieval], heading: &str, name: impl Fn(&Retrieval) -> String) -> Markup {
    html! {
        div class="scroll" {
            table {
                thead { tr {
                    th { (heading) } th { "average precision" } (operating_point_headers())
                    th { "maximum F1" } th { "pairs" } th { "matches" }
                } }
                tbody { @for row in rows { tr {
                    th { (name(row)) }
                    td { (optional_percent(row.average_precision)) }
                    td { (optional_percent(row.recall_at_full_precision)) }
                    td { (optional_percent(row.detection_at_1_percent)) }
                    td { (optional_percent(row.max_f1)) }
                    td { (thousands(row.n_positive + row.n_negative)) }
                    td { (prevalence(row)) }
                } } }
            }
        }
    }
}

/// The share of matches among the pairs.
fn prevalence(row: &Retrieval) -> String {
    let n = row.n_positive + row.n_negative;
    if n == 0 {
        NO_VALUE.to_owned()
    } else {
        format!("{:.3}\u{a0}%", row.n_positive as f64 / n as f64 * 100.0)
    }
}
