//! The features that the classifiers use.

use dataset::BoostingRound;
use maud::{Markup, html};

use super::figure;
use crate::figures::Figure;
use crate::text::{NO_VALUE, distinct, learner_name, percent};
use crate::{Evaluation, Input};

/// Rows of the table of single features.
const FEATURES_SHOWN: usize = 20;
/// Rows of the table of selected features.
const ROUNDS_SHOWN: u32 = 10;

pub(super) fn section(input: &Input<'_>, evaluation: &Evaluation, figures: &[Figure]) -> Markup {
    let first = evaluation.first_grouping().unwrap_or_default();
    html! {
        section {
            h2 { "Selected features" }
            p {
                "The feature that each of the first " (ROUNDS_SHOWN) " rounds selects when trained on all pairs (paper, Table\u{a0}I). Below it: "
                "the error after this round, cross-validated by " (first) ", and how many of the cross-validation fits select the same feature in this round. "
                "All rounds are in " code { "evaluation/selection.parquet" } "."
            }
            (selection_table(input, evaluation, first))
            div class="figures" {
                (figure(figures, "first-rounds", &html! {
                    "The labelled pairs by the first two selected features, with the thresholds of these rounds (paper, Figure\u{a0}2). The differences of matches are small."
                }))
                (single_features(input))
            }
        }
    }
}

fn selection_table(input: &Input<'_>, evaluation: &Evaluation, grouping: &str) -> Markup {
    let learners = distinct(input.rounds.iter().map(|r| &*r.learner));
    let selected = |learner: &str, round: u32| {
        let mut of_all_pairs = input.rounds.iter().filter(|r| r.held_out.is_none());
        of_all_pairs.find(|r| r.learner == learner && r.round == round)
    };
    let error_after = |r: &BoostingRound| {
        let row = evaluation.errors.iter().find(|e| {
            e.learner == r.learner && e.grouping == grouping && e.rounds == r.round as usize
        });
        row.map_or(f64::NAN, |e| e.confusion.error())
    };
    html! {
        div class="scroll" {
            table {
                thead { tr { th { "round" } @for learner in &learners { th class="text" { (learner_name(learner)) } } } }
                tbody {
                    @for round in 1..=ROUNDS_SHOWN {
                        tr {
                            th { (round) }
                            @for learner in &learners {
                                @match selected(learner, round) {
                                    Some(r) => { td class="text" {
                                        (r.feature)
                                        small { (percent(error_after(r))) ", " (same_in_folds(input, r)) }
                                    } }
                                    None => { td class="text" { (NO_VALUE) } }
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

/// How many of the cross-validation fits select the same feature in the same round.
fn same_in_folds(input: &Input<'_>, selected: &BoostingRound) -> String {
    let of_round = || {
        input.rounds.iter().filter(|r| {
            r.held_out.is_some() && r.learner == selected.learner && r.round == selected.round
        })
    };
    let n_same = of_round().filter(|r| r.feature == selected.feature).count();
    format!("{n_same} of {}", of_round().count())
}

/// The single features with the greatest AUC. Nothing if they were not evaluated.
fn single_features(input: &Input<'_>) -> Markup {
    if input.feature_usefulness.is_empty() {
        return html! {};
    }
    let mut rows: Vec<_> = input.feature_usefulness.iter().collect();
    rows.sort_by(|a, b| b.auc.total_cmp(&a.auc).then(a.name.cmp(&b.name)));
    rows.truncate(FEATURES_SHOWN);
    html! {
        div class="scroll" {
            p { "Each feature alone. All features are in " code { "evaluation/features.parquet" } "." }
            ul {
                li { b { "AUC" } ": area under its ROC curve. 0.5 is chance, 1 is perfect." }
                li { b { "change" } ": how much it changes when every other return of a scan is removed (median, relative to its interquartile range). Lower is better." }
                li { b { "splits" } ": how many splits of all models use it." }
            }
            table {
                thead { tr { th class="text" { "feature" } th { "AUC" } th { "change" } th { "splits" } } }
                tbody { @for row in rows { tr {
                    th { (row.name) }
                    td { (format!("{:.3}", row.auc)) }
                    td { (format!("{:.3}", row.stability)) }
                    td { (row.chosen) }
                } } }
            }
        }
    }
}
