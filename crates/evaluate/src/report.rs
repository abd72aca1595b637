//! `report.html`: one file that opens offline, without script.

use std::collections::BTreeMap;

use dataset::tables::Provenance;
use dataset::{Label, Scores};
use maud::{DOCTYPE, Markup, PreEscaped, html};

use crate::figures::{Axis, Chart, N_STYLES, Series, map};
use crate::metrics::operating_points;
use crate::{ErrorRow, Evaluation, Input, PRECISION_RECALL_ROUNDS};

/// A line of the report's last section: where the numbers come from.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Fact {
    /// What it is.
    pub name: String,
    /// Its value.
    pub value: String,
}

/// The error that the paper reports for its own campus.
const PAPER_ERROR: &str = "under 5\u{a0}%";

/// The report as HTML; its provenance stands in `meta` elements, under the keys that tables have.
pub fn report(
    name: &str,
    input: &Input<'_>,
    evaluation: &Evaluation,
    facts: &[Fact],
    provenance: &Provenance,
) -> String {
    let groupings: Vec<&str> = distinct(evaluation.errors.iter().map(|row| &*row.grouping));
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                @for (key, value) in provenance.entries("report") {
                    meta name=(key) content=(value);
                }
                title { "loopboost: " (name) }
                style { (PreEscaped(include_str!("report.css"))) }
            }
            body {
                header {
                    p class="brand" { "loopboost report" }
                    h1 { (name) }
                    (headline(input, evaluation))
                }
                main {
                    @for grouping in &groupings {
                        (results(input, evaluation, grouping, groupings.len() > 1))
                    }
                    (selection(input))
                    (maps(input))
                    (origins(input, facts))
                }
            }
        }
    };
    page.into_string()
}

/// How good, on what, compared with what.
fn headline(input: &Input<'_>, evaluation: &Evaluation) -> Markup {
    let count = |label| input.pairs.iter().filter(|pair| pair.label == label).count();
    let last = last_rows(evaluation);
    let is_boosted = |row: &&&ErrorRow| is_boosted(input, &row.learner);
    let least = |rows: Vec<&&ErrorRow>| -> Option<ErrorRow> {
        let best =
            rows.into_iter().min_by(|a, b| a.confusion.error().total_cmp(&b.confusion.error()));
        best.map(|row| (*row).clone())
    };
    let best = least(last.iter().filter(is_boosted).collect());
    let baseline = least(last.iter().filter(|row| !is_boosted(row)).collect());
    let logs = distinct(input.keyframes.iter().map(|k| &*k.id.log));
    html! {
        @if let Some(best) = best {
            p class="headline" {
                "Of " (input.pairs.len()) " pairs of scans, "
                b { (best.learner) } " labels " b { (percent(best.confusion.error())) }
                " wrongly (" (best.grouping) " folds, T\u{a0}=\u{a0}" (best.rounds) ")"
                @if let Some(baseline) = baseline {
                    "; the better baseline, " (baseline.learner) ", " (percent(baseline.confusion.error()))
                }
                ". The paper reports " (PAPER_ERROR) " on its own campus."
            }
        }
        p {
            (count(Label::Positive)) " positive and " (count(Label::Negative)) " negative pairs among "
            (input.keyframes.len()) " keyframes of "
            @match logs.len() { 1 => { "1 log" } n => { (n) " logs" } }
            ": " (logs.join(", ")) "."
        }
    }
}

/// A learner without rounds is a baseline.
fn is_boosted(input: &Input<'_>, learner: &str) -> bool {
    input.rounds.iter().any(|round| round.learner == learner)
}

fn results(input: &Input<'_>, evaluation: &Evaluation, grouping: &str, named: bool) -> Markup {
    let labels: Vec<Label> = input.pairs.iter().map(|pair| pair.label).collect();
    let scores: Vec<&Scores> = input.scores.iter().filter(|s| s.grouping == grouping).collect();
    let row = |learner: &str, rounds: usize| {
        evaluation
            .errors
            .iter()
            .find(|r| r.learner == learner && r.grouping == grouping && r.rounds == rounds)
    };
    let few = scores.first().map_or(0, |s| s.n_rounds).min(PRECISION_RECALL_ROUNDS);
    let folds = scores.first().map_or(0, |s| s.folds.iter().flatten().max().map_or(0, |f| f + 1));
    html! {
        section {
            h2 { "Results" @if named { ", grouping " (grouping) } }
            p {
                "Cross-validated on " (folds) " folds: each pair is scored by a classifier that did not see it; "
                "all folds are counted together. A pair is called positive where its confidence is 0 or more; the last two "
                "columns choose another threshold."
            }
            div class="scroll" {
                table {
                    thead { tr {
                        th { "learner" } th { "T" } th { "error" } th { "error at T\u{a0}=\u{a0}" (few) }
                        th { "precision" } th { "recall" } th { "recall at 100 % precision" } th { "detection at 1 % false alarm" }
                    } }
                    tbody {
                        @for s in &scores {
                            @let confidences: Vec<f64> = s.after(s.n_rounds).collect();
                            @let points = operating_points(&labels, &confidences);
                            @let recall_at = |name: &str| points.iter().find(|p| p.name == name).map(|p| p.point.confusion.recall());
                            @if let Some(last) = row(&s.learner, s.n_rounds) {
                                tr {
                                    th { (s.learner) }
                                    td { @if is_boosted(input, &s.learner) { (s.n_rounds) } @else { "baseline" } }
                                    td { (percent(last.confusion.error())) }
                                    td { (optional(row(&s.learner, few).map(|r| r.confusion.error()))) }
                                    td { (optional(last.confusion.precision())) }
                                    td { (percent(last.confusion.recall())) }
                                    td { (optional(recall_at("recall at 100 % precision"))) }
                                    td { (optional(recall_at("detection at 1 % false alarm"))) }
                                }
                            }
                        }
                    }
                }
            }
            div class="figures" {
                figure {
                    (error_chart(evaluation, grouping).svg())
                    figcaption { "Error against rounds T (paper, Figure 4). Rest on a mark for its value." }
                }
                figure {
                    (precision_recall_chart(evaluation, grouping).svg())
                    figcaption { "Precision against recall at T\u{a0}=\u{a0}" (few) " (paper, Figure 5)." }
                }
            }
        }
    }
}

fn error_chart(evaluation: &Evaluation, grouping: &str) -> Chart {
    let rows: Vec<&ErrorRow> =
        evaluation.errors.iter().filter(|r| r.grouping == grouping).collect();
    let n_rounds = rows.iter().map(|r| r.rounds).max().unwrap_or(1);
    let highest = rows.iter().map(|r| r.confusion.error()).fold(0.05, f64::max);
    let step = if highest <= 0.1 { 0.02 } else { 0.05 };
    let top = (highest / step).ceil() * step;
    let x_step = (n_rounds / 5).max(1);
    let mut x_ticks: Vec<f64> = vec![1.0];
    x_ticks.extend((1..=n_rounds / x_step).map(|k| (k * x_step) as f64).filter(|&t| t > 1.0));
    let series = distinct(rows.iter().map(|r| &*r.learner))
        .into_iter()
        .map(|learner| {
            let of: Vec<_> = rows.iter().filter(|r| r.learner == learner).collect();
            Series {
                name: learner.to_owned(),
                points: of.iter().map(|r| (r.rounds as f64, r.confusion.error())).collect(),
                hover: of
                    .iter()
                    .map(|r| {
                        format!(
                            "{learner}, T = {}: error {}",
                            r.rounds,
                            percent(r.confusion.error())
                        )
                    })
                    .collect(),
            }
        })
        .collect();
    Chart {
        id: "error-curve",
        description: format!("Error against rounds, grouping {grouping}"),
        x: Axis {
            title: "rounds T",
            min: 1.0,
            max: (n_rounds as f64).max(2.0),
            ticks: x_ticks,
            format: |t| format!("{t:.0}"),
        },
        y: Axis {
            title: "error [%]",
            min: 0.0,
            max: top,
            ticks: (0..=(top / step).round() as usize).map(|k| k as f64 * step).collect(),
            format: |t| format!("{:.0}", t * 100.0),
        },
        series,
    }
}

fn precision_recall_chart(evaluation: &Evaluation, grouping: &str) -> Chart {
    let fifths: Vec<f64> = (0..=5).map(|k| f64::from(k) / 5.0).collect();
    let series = evaluation
        .precision_recall
        .iter()
        .filter(|curve| curve.grouping == grouping)
        .map(|curve| Series {
            name: curve.learner.clone(),
            points: curve
                .points
                .iter()
                .map(|p| (p.confusion.recall(), p.confusion.precision().unwrap_or(1.0)))
                .collect(),
            hover: Vec::new(),
        })
        .collect();
    // Balanced pairs have a precision of at least about one half.
    Chart {
        id: "precision-recall",
        description: format!("Precision against recall, grouping {grouping}"),
        x: Axis {
            title: "recall",
            min: 0.0,
            max: 1.0,
            ticks: fifths,
            format: |t| format!("{t:.1}"),
        },
        y: Axis {
            title: "precision",
            min: 0.4,
            max: 1.0,
            ticks: (2..=5).map(|k| f64::from(k) / 5.0).collect(),
            format: |t| format!("{t:.1}"),
        },
        series,
    }
}

/// Rounds shown in the table of chosen features.
const SELECTION_ROUNDS: u32 = 10;

fn selection(input: &Input<'_>) -> Markup {
    let learners = distinct(input.rounds.iter().map(|r| &*r.learner));
    let of_all = |learner: &str, round: u32| {
        input
            .rounds
            .iter()
            .find(|r| r.left_out.is_none() && r.learner == learner && r.round == round)
    };
    let in_folds = |learner: &str, round: u32, feature: &str| {
        let of_round: Vec<_> = input
            .rounds
            .iter()
            .filter(|r| r.left_out.is_some() && r.learner == learner && r.round == round)
            .collect();
        let same = of_round.iter().filter(|r| r.feature == feature).count();
        format!("{same}/{}", of_round.len())
    };
    html! {
        section {
            h2 { "Features chosen" }
            p {
                "The feature of each of the first " (SELECTION_ROUNDS) " rounds, fitted on all pairs (paper, Table I); "
                "in brackets, in how many of the folds the same round chose it too. The full table is "
                code { "evaluation/selection.parquet" } "."
            }
            div class="scroll" {
                table {
                    thead { tr { th { "round" } @for learner in &learners { th class="text" { (learner) } } } }
                    tbody {
                        @for round in 1..=SELECTION_ROUNDS {
                            tr {
                                th { (round) }
                                @for learner in &learners {
                                    @match of_all(learner, round) {
                                        Some(r) => { td class="text" { (r.feature) " " small { "(" (in_folds(learner, round, &r.feature)) ")" } } }
                                        None => { td class="text" { "stopped" } }
                                    }
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

fn maps(input: &Input<'_>) -> Markup {
    html! {
        section {
            h2 { "Keyframes and pairs" }
            div class="figures" {
                @for site in distinct(input.keyframes.iter().map(|k| &*k.site)) {
                    (map(site, input.keyframes, input.pairs))
                }
            }
        }
    }
}

fn origins(input: &Input<'_>, facts: &[Fact]) -> Markup {
    let mut keyframes: BTreeMap<&str, usize> = BTreeMap::new();
    for keyframe in input.keyframes {
        *keyframes.entry(&keyframe.id.log).or_default() += 1;
    }
    html! {
        section {
            h2 { "Where this comes from" }
            @if input.dropped.is_empty() {
                p { "Nothing was dropped: every scan and pose in the logs could be used." }
            } @else {
                p { b { "Left out" } ", by reason:" }
                ul { @for (reason, n) in input.dropped.iter() { li { (n) " " (reason) } } }
            }
            div class="scroll" {
                table class="facts" {
                    tbody {
                        @for (log, n) in &keyframes { tr { th { (log) } td class="text" { (n) " keyframes" } } }
                        @for fact in facts { tr { th { (fact.name) } td class="text" { code { (fact.value) } } } }
                    }
                }
            }
        }
    }
}

/// The row of the last round of each learner and grouping.
fn last_rows(evaluation: &Evaluation) -> Vec<&ErrorRow> {
    let mut last: BTreeMap<(&str, &str), &ErrorRow> = BTreeMap::new();
    for row in &evaluation.errors {
        let entry = last.entry((&row.learner, &row.grouping)).or_insert(row);
        if entry.rounds < row.rounds {
            *entry = row;
        }
    }
    last.into_values().collect()
}

/// The distinct values, in order of first appearance.
fn distinct<'a>(values: impl Iterator<Item = &'a str>) -> Vec<&'a str> {
    let mut distinct: Vec<&str> = Vec::new();
    for value in values {
        if !distinct.contains(&value) {
            distinct.push(value);
        }
    }
    distinct
}

fn percent(share: f64) -> String {
    format!("{:.1}\u{a0}%", share * 100.0)
}

fn optional(share: Option<f64>) -> String {
    share.map_or_else(|| "none".to_owned(), percent)
}

// The style sheet has a rule for each line style.
const _: () = assert!(N_STYLES == 5);
