//! The first screen: the best result, and the errors of all learners.

use dataset::{Label, Note};
use maud::{Markup, html};

use super::messages;
use crate::bootstrap::{Estimate, Summary};
use crate::text::{
    NO_VALUE, PAPER_ERROR_BELOW, PAPER_ROUNDS, distinct, grouping_meaning, learner_name, percent,
};
use crate::{Evaluation, Input};

pub(super) fn headline(input: &Input<'_>, evaluation: &Evaluation) -> Markup {
    let count = |label| input.pairs.iter().filter(|pair| pair.label == label).count();
    let logs = distinct(input.keyframes.iter().map(|k| &*k.id.log));
    html! {
        (messages::warnings(input.losses, input.not_evaluated.iter().chain(input.notes)))
        @if !evaluation.is_validated_on_unseen_ground() { (not_validated(input)) }
        @if let Some(best) = evaluation.best_boosted(input) {
            (best_result(best, evaluation.best_baseline(input)))
        }
        p {
            (count(Label::Positive)) " matches (pairs of the same place) and "
            (count(Label::Negative)) " non-matches (pairs of different places), from "
            (input.keyframes.len()) " scans in "
            @match logs.len() { 1 => { "1 log" } n => { (n) " logs" } }
            ": " (logs.join(", ")) "."
        }
        (errors(input, evaluation))
        p class="note" { "The paper is " i { "Learning Loop Closures by Boosting" } ". This report shows the same figures and tables." }
    }
}

/// Without the grouping `place`, training and test pairs may show the same ground.
fn not_validated(input: &Input<'_>) -> Markup {
    let concerns_place = |note: &&Note| note.kind.grouping() == Some("place");
    html! {
        p class="headline" {
            b { "Not validated on unseen ground" } ": "
            @match input.not_evaluated.iter().find(concerns_place) {
                Some(note) => { (messages::with_code(&note.to_string())) "." }
                None => { code { "evaluate.groupings" } " does not contain " code { "place" } "." }
            }
            " The errors below are expected to be larger at other places."
        }
    }
}

fn best_result(best: &Summary, baseline: Option<&Summary>) -> Markup {
    let name = learner_name(&best.learner);
    html! {
        p class="headline" {
            b { (name) } " misclassifies " b { (percent(best.error.value)) } " of the pairs"
            @if let Some([low, high]) = best.error.interval {
                " (95\u{a0}% interval " (percent(low)) " to " (percent(high)) ")"
            }
            " after " (best.rounds) " rounds, " (grouping_meaning(&best.grouping)) "."
            @if let Some(baseline) = baseline {
                " The best baseline, " (learner_name(&baseline.learner)) ", misclassifies "
                (percent(baseline.error.value)) "."
            }
            " At a false alarm rate of 1\u{a0}%, " (name) " detects "
            b { (percent(best.detection_at_1_percent.value)) } " of the matches."
        }
    }
}

/// Errors by learner and grouping, with the paper's result for comparison.
fn errors(input: &Input<'_>, evaluation: &Evaluation) -> Markup {
    let groupings = evaluation.groupings();
    let learners = distinct(evaluation.summaries.iter().map(|s| &*s.learner));
    let has_retrieval = !input.retrieval.is_empty();
    html! {
        div class="scroll" {
            table class="answer" {
                thead { tr {
                    th { "error after the last round" }
                    @for grouping in &groupings { th { "by " (grouping) small { (grouping_meaning(grouping)) } } }
                    @if has_retrieval { th { "average precision" small { "of retrieval at natural prevalence" } } }
                } }
                tbody {
                    @for learner in learners {
                        tr {
                            th { (learner_name(learner)) @if !input.is_boosted(learner) { " " small { "baseline" } } }
                            @for grouping in &groupings { (error_cell(evaluation, learner, grouping)) }
                            @if has_retrieval { td { (average_precision(input, learner)) } }
                        }
                    }
                    tr class="paper-row" {
                        th { "paper\u{2019}s AdaBoost on its own campus, T\u{a0}=\u{a0}" (PAPER_ROUNDS) }
                        @for grouping in &groupings {
                            td { @if *grouping == "pair" { "below " (format!("{:.0}", PAPER_ERROR_BELOW * 100.0)) "\u{a0}%" } @else { (NO_VALUE) } }
                        }
                        @if has_retrieval { td { (NO_VALUE) } }
                    }
                }
            }
        }
    }
}

/// The error of a learner under a grouping, in bold if it is the least of all learners.
fn error_cell(evaluation: &Evaluation, learner: &str, grouping: &str) -> Markup {
    let of_grouping = || evaluation.summaries.iter().filter(|s| s.grouping == grouping);
    let least = of_grouping().map(|s| s.error.value).fold(f64::INFINITY, f64::min);
    match of_grouping().find(|s| s.learner == learner) {
        Some(s) => estimate_cell(s.error, s.error.value <= least),
        None => html! { td {} },
    }
}

fn average_precision(input: &Input<'_>, learner: &str) -> String {
    let mut rows = input.retrieval_of_all();
    let row = rows.find(|r| r.learner == learner && !r.ambiguous_as_negative);
    row.and_then(|r| r.average_precision).map_or_else(|| "not scored".to_owned(), percent)
}

/// A table cell with a value, and its interval below.
pub(super) fn estimate_cell(estimate: Estimate, is_best: bool) -> Markup {
    html! {
        td class=[is_best.then_some("best")] {
            (percent(estimate.value))
            @if let Some([low, high]) = estimate.interval {
                small { (format!("{:.1} to {:.1}", low * 100.0, high * 100.0)) }
            }
        }
    }
}
