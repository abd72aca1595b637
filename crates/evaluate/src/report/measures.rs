//! How good, on what, compared with what.

use dataset::Label;
use maud::{Markup, html};

use super::{PAPER_ERROR_BELOW, PAPER_ROUNDS, distinct, figure, meaning_of, name_of, percent};
use crate::bootstrap::{Estimate, MIN_GROUPS, Summary};
use crate::figures::Figure;
use crate::{Evaluation, Input, PRECISION_RECALL_ROUNDS};

/// The first screen.
pub(super) fn headline(input: &Input<'_>, evaluation: &Evaluation) -> Markup {
    let count = |label| input.pairs.iter().filter(|pair| pair.label == label).count();
    let logs = distinct(input.keyframes.iter().map(|k| &*k.id.log));
    html! {
        @if let Some(best) = evaluation.best_boosted(input) {
            p class="headline" {
                b { (name_of(&best.learner)) } " gives " b { (percent(best.error.value)) }
                " of the pairs the wrong label"
                @if let Some([low, high]) = best.error.interval {
                    " (95\u{a0}% interval " (percent(low)) " to " (percent(high)) ")"
                }
                @if best.grouping == "pair" { " after " (best.rounds) " rounds" } @else {
                    " after " (best.rounds) " rounds, with " (meaning_of(&best.grouping)) " of a fold"
                }
                @if let Some(baseline) = evaluation.best_baseline(input) {
                    "; the better baseline, " (name_of(&baseline.learner)) ", " (percent(baseline.error.value))
                }
                ". At 1\u{a0}% false alarm it finds " b { (percent(best.detection_at_1_percent.value)) } " of the matches."
            }
        }
        p {
            (count(Label::Positive)) " pairs of the same place and " (count(Label::Negative)) " of another, among "
            (input.keyframes.len()) " scans of "
            @match logs.len() { 1 => { "1 log" } n => { (n) " logs" } }
            ": " (logs.join(", ")) "."
        }
        (side_by_side(input, evaluation))
        @for why in input.left_out { p class="note" { "Not evaluated: " (why) "." } }
    }
}

/// Errors by learner and grouping, the paper's beside them.
fn side_by_side(input: &Input<'_>, evaluation: &Evaluation) -> Markup {
    let groupings = evaluation.groupings();
    let learners = distinct(evaluation.summaries.iter().map(|s| &*s.learner));
    let of = |learner: &str, grouping: &str| {
        evaluation.summaries.iter().find(|s| s.learner == learner && s.grouping == grouping)
    };
    let least = |grouping: &str| {
        let errors = evaluation.summaries.iter().filter(|s| s.grouping == grouping);
        errors.map(|s| s.error.value).fold(f64::INFINITY, f64::min)
    };
    let found = |learner: &str| {
        input
            .retrieval_of_all()
            .find(|r| r.learner == learner && !r.ambiguous_as_negative)
            .and_then(|r| r.average_precision)
    };
    let is_retrieved = !input.retrieval.is_empty();
    html! {
        div class="scroll" {
            table class="answer" {
                thead { tr {
                    th { "error after the last round" }
                    @for grouping in &groupings { th { "by " (grouping) small { (meaning_of(grouping)) } } }
                    @if is_retrieved { th { "average precision" small { "among every pair of a log" } } }
                } }
                tbody {
                    @for learner in learners {
                        tr {
                            th { (name_of(learner)) @if !input.is_boosted(learner) { " " small { "baseline" } } }
                            @for grouping in &groupings {
                                @match of(learner, grouping) {
                                    Some(s) => { (cell(s.error, s.error.value <= least(grouping))) }
                                    None => { td {} }
                                }
                            }
                            @if is_retrieved { td { (found(learner).map_or_else(|| "not scored".to_owned(), percent)) } }
                        }
                    }
                    tr class="paper-row" {
                        th { "the paper\u{2019}s AdaBoost, its own campus, T\u{a0}=\u{a0}" (PAPER_ROUNDS) }
                        @for grouping in &groupings {
                            td { @if *grouping == "pair" { "under " (format!("{:.0}", PAPER_ERROR_BELOW * 100.0)) "\u{a0}%" } @else { "not given" } }
                        }
                        @if is_retrieved { td { "not given" } }
                    }
                }
            }
        }
    }
}

/// A value, and its interval below.
fn cell(estimate: Estimate, is_best: bool) -> Markup {
    html! {
        td class=[is_best.then_some("best")] {
            (percent(estimate.value))
            @if let Some([low, high]) = estimate.interval {
                small { (format!("{:.1} to {:.1}", low * 100.0, high * 100.0)) }
            }
        }
    }
}

/// All measures under each grouping, with the curves.
pub(super) fn measures(input: &Input<'_>, evaluation: &Evaluation, figures: &[Figure]) -> Markup {
    html! {
        section {
            h2 { "Cross-validated" }
            p {
                "Each pair is scored by a classifier that was trained on pairs that touch neither of the two folds it touches; "
                "as many of either class. A pair is called a match where its confidence is 0 or more; the measures from average "
                "precision on look at all thresholds. Below each value stands where 95\u{a0}% of " (input.resamples)
                " bootstrap resamples of the groups lie."
            }
            @for grouping in evaluation.groupings() {
                (of_grouping(input, evaluation, figures, grouping))
            }
        }
    }
}

fn of_grouping(
    input: &Input<'_>,
    evaluation: &Evaluation,
    figures: &[Figure],
    grouping: &str,
) -> Markup {
    let rows: Vec<&Summary> =
        evaluation.summaries.iter().filter(|s| s.grouping == grouping).collect();
    let error_at = |learner: &str, rounds: usize| {
        let row = evaluation
            .errors
            .iter()
            .find(|r| r.learner == learner && r.grouping == grouping && r.rounds == rounds);
        row.map(|r| r.confusion.error())
    };
    let (folds, groups) = rows.first().map_or((0, 0), |s| (s.folds, s.groups));
    let few = rows.first().map_or(0, |s| s.rounds).min(PRECISION_RECALL_ROUNDS);
    let [fewest, most] = training_pairs(input, grouping);
    html! {
        h3 { "By " (grouping) ": " (meaning_of(grouping)) }
        p class="note" {
            (folds) " folds of " (groups) " groups; trained on " (fewest)
            @if fewest < most { " to " (most) } " pairs."
            @if groups < MIN_GROUPS { " Fewer than " (MIN_GROUPS) " groups: no intervals." }
            @else if input.resamples == 0 { " No resamples: no intervals." }
        }
        div class="scroll" {
            table {
                thead { tr {
                    th { "learner" } th { "error" } th { "error at T\u{a0}=\u{a0}" (few) } th { "average precision" }
                    th { "recall at 100\u{a0}% precision" small { "= detection at 0\u{a0}% false alarm" } }
                    th { "detection at 1\u{a0}% false alarm" } th { "max F1" }
                } }
                tbody {
                    @for s in &rows {
                        @let greatest = |of: fn(&Summary) -> f64| rows.iter().all(|other| of(other) <= of(s));
                        tr {
                            th { (name_of(&s.learner)) }
                            (cell(s.error, rows.iter().all(|other| s.error.value <= other.error.value)))
                            td { (error_at(&s.learner, few).filter(|_| input.is_boosted(&s.learner)).map_or_else(|| "\u{2013}".to_owned(), percent)) }
                            (cell(s.average_precision, greatest(|s| s.average_precision.value)))
                            (cell(s.recall_at_full_precision, greatest(|s| s.recall_at_full_precision.value)))
                            (cell(s.detection_at_1_percent, greatest(|s| s.detection_at_1_percent.value)))
                            (cell(s.max_f1, greatest(|s| s.max_f1.value)))
                        }
                    }
                }
            }
        }
        div class="figures" {
            (figure(figures, &format!("error-curve-{grouping}"), &html! {
                "Error against rounds T, by " (grouping) " (paper, Figure 4); baselines are lines. Rest on a line for its values."
            }))
            (figure(figures, &format!("precision-recall-{grouping}"), &html! {
                "Precision against recall at T\u{a0}=\u{a0}" (few) ", by " (grouping) " (paper, Figure 5)."
            }))
        }
    }
}

/// The fewest and the most pairs that a fit of a grouping learned from.
fn training_pairs(input: &Input<'_>, grouping: &str) -> [usize; 2] {
    let Some(scores) = input.scores.iter().find(|s| s.grouping == grouping) else { return [0; 2] };
    let mut left_out: Vec<[u32; 2]> =
        scores.folds.iter().map(|&[a, b]| [a.min(b), a.max(b)]).collect();
    left_out.sort_unstable();
    left_out.dedup();
    let sizes = left_out.iter().map(|[a, b]| {
        let count = |label| {
            let touches = |folds: &[u32; 2]| folds.contains(a) || folds.contains(b);
            let pairs = input.pairs.iter().zip(&scores.folds);
            pairs.filter(|(pair, folds)| pair.label == label && !touches(folds)).count()
        };
        2 * count(Label::Positive).min(count(Label::Negative))
    });
    let sizes: Vec<usize> = sizes.collect();
    [sizes.iter().min(), sizes.iter().max()].map(|size| size.copied().unwrap_or(0))
}
