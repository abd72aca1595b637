//! What the classifiers look at.

use dataset::BoostingRound;
use maud::{Markup, html};

use super::{distinct, figure, name_of, percent};
use crate::figures::Figure;
use crate::{Evaluation, Input};

/// Features shown in the table of what each is worth.
const FEATURES_SHOWN: usize = 20;
/// Rounds shown in the table of chosen features.
const SELECTION_ROUNDS: u32 = 10;

pub(super) fn features(input: &Input<'_>, evaluation: &Evaluation, figures: &[Figure]) -> Markup {
    let learners = distinct(input.rounds.iter().map(|r| &*r.learner));
    let of_all = |learner: &str, round: u32| {
        input
            .rounds
            .iter()
            .find(|r| r.left_out.is_none() && r.learner == learner && r.round == round)
    };
    let first = evaluation.first_grouping().unwrap_or_default();
    let error_at = |r: &BoostingRound| {
        let row = evaluation.errors.iter().find(|e| {
            e.learner == r.learner && e.grouping == first && e.rounds == r.round as usize
        });
        row.map_or(f64::NAN, |e| e.confusion.error())
    };
    html! {
        section {
            h2 { "Features chosen" }
            p {
                "The feature that each of the first " (SELECTION_ROUNDS) " rounds chose, fitted on all pairs; the cross-validated error, by "
                (first) ", after that round (paper, Table I); and in how many of the fits on folds the same round chose the same. "
                "All rounds are in " code { "evaluation/selection.parquet" } "."
            }
            div class="scroll" {
                table {
                    thead { tr { th { "round" } @for learner in &learners { th class="text" { (name_of(learner)) } } } }
                    tbody {
                        @for round in 1..=SELECTION_ROUNDS {
                            tr {
                                th { (round) }
                                @for learner in &learners {
                                    @match of_all(learner, round) {
                                        Some(r) => { td class="text" {
                                            (r.feature)
                                            small { (percent(error_at(r))) " · " (in_folds(input, r)) }
                                        } }
                                        None => { td class="text" { "–" } }
                                    }
                                }
                            }
                        }
                    }
                }
            }
            div class="figures" {
                (figure(figures, "first-rounds", &html! {
                    "The first two features chosen, and where they were cut (paper, Figure 2): a pair is called a match where its differences are small."
                }))
                (table_of_features(input))
            }
        }
    }
}

fn in_folds(input: &Input<'_>, chosen: &BoostingRound) -> String {
    let of_round = || {
        input.rounds.iter().filter(|r| {
            r.left_out.is_some() && r.learner == chosen.learner && r.round == chosen.round
        })
    };
    let same = of_round().filter(|r| r.feature == chosen.feature).count();
    format!("{same}/{}", of_round().count())
}

/// The best first, where features were looked at one by one.
fn table_of_features(input: &Input<'_>) -> Markup {
    if input.feature_rows.is_empty() {
        return html! {};
    }
    let mut rows: Vec<_> = input.feature_rows.iter().collect();
    rows.sort_by(|a, b| b.auc.total_cmp(&a.auc).then(a.name.cmp(&b.name)));
    rows.truncate(FEATURES_SHOWN);
    html! {
        div class="scroll" {
            p {
                "Each feature by itself: the area under its ROC curve (0.5 tells nothing); how far it moves when every other return of a scan is left out (median, as a share of its interquartile range: less is better); how many splits of all models look at it. All are in "
                code { "evaluation/features.parquet" } "."
            }
            table {
                thead { tr { th class="text" { "feature" } th { "AUC alone" } th { "moves by" } th { "chosen" } } }
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
