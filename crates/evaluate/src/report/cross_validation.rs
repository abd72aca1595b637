//! All measures under each grouping, with the curves.

use maud::{Markup, html};

use super::figure;
use super::headline::estimate_cell;
use crate::bootstrap::{MIN_GROUPS, Summary};
use crate::figures::Figure;
use crate::text::{NO_VALUE, grouping_meaning, grouping_unit, learner_name, percent};
use crate::{Evaluation, Input, PRECISION_RECALL_ROUNDS};

pub(super) fn section(input: &Input<'_>, evaluation: &Evaluation, figures: &[Figure]) -> Markup {
    html! {
        section {
            h2 { "Cross-validation" }
            p {
                "Each pair belongs to one or two folds. The classifier that scores it was trained without any pair of these folds, "
                "on equal numbers of both classes. The error counts a pair as a match if its confidence is 0 or more. "
                "The other measures consider all thresholds."
                @if input.resamples > 0 {
                    " Below each value is its 95\u{a0}% interval over " (input.resamples) " bootstrap resamples of the groups. "
                    "If no pair is wrong, the interval is that of Clopper and Pearson for the number of groups. "
                    "The recall at 100\u{a0}% precision has no interval: it depends on a single pair, the non-match with the highest confidence, "
                    "which a bootstrap cannot estimate."
                }
            }
            @for grouping in evaluation.groupings() {
                (grouping_section(input, evaluation, figures, grouping))
            }
        }
    }
}

fn grouping_section(
    input: &Input<'_>,
    evaluation: &Evaluation,
    figures: &[Figure],
    grouping: &str,
) -> Markup {
    let rows: Vec<&Summary> =
        evaluation.summaries.iter().filter(|s| s.grouping == grouping).collect();
    let (n_folds, n_groups) = rows.first().map_or((0, 0), |s| (s.folds, s.groups));
    let last = rows.iter().map(|s| s.rounds).max().unwrap_or(0);
    let few = last.min(PRECISION_RECALL_ROUNDS);
    let [fewest, most] = training_pairs(input, grouping);
    html! {
        h3 { "By " (grouping) ": " (grouping_meaning(grouping)) }
        p class="note" {
            @if grouping != "pair" { "The pairs are from " }
            (n_groups) " " (grouping_unit(grouping)) ", split into " (n_folds) " folds. Each classifier is trained on " (fewest)
            @if fewest < most { " to " (most) }
            " pairs."
            @if grouping == "place" && 0.0 < input.place_margin_m {
                " None of their scans is closer than " (input.place_margin_m) "\u{a0}m to the ground that the classifier is tested on."
            }
            @if n_groups < MIN_GROUPS { " No intervals: fewer than " (MIN_GROUPS) " " (grouping_unit(grouping)) "." }
            @else if input.resamples == 0 { " No intervals: " code { "evaluate.resamples" } " is 0." }
        }
        (measures_table(input, evaluation, &rows, [few, last]))
        div class="figures" {
            (figure(figures, &format!("error-curve-{grouping}"), &html! {
                "Error after T rounds, by " (grouping) " (paper, Figure\u{a0}4). Baselines have no rounds: their lines are horizontal. "
                "Hover over a line to see its values."
            }))
            (figure(figures, &format!("precision-recall-{grouping}"), &html! {
                "Precision against recall at T\u{a0}=\u{a0}" (few) ", by " (grouping) " (paper, Figure\u{a0}5)."
            }))
        }
    }
}

/// The measures of each learner after the last round. If there are more than
/// [`PRECISION_RECALL_ROUNDS`] rounds, the table also has the error after that many.
fn measures_table(
    input: &Input<'_>,
    evaluation: &Evaluation,
    rows: &[&Summary],
    [few, last]: [usize; 2],
) -> Markup {
    let error_after_few = |s: &Summary| {
        let is_row = |e: &&crate::ErrorRow| {
            e.learner == s.learner && e.grouping == s.grouping && e.rounds == few
        };
        let row = evaluation.errors.iter().find(is_row).filter(|_| input.is_boosted(&s.learner));
        row.map_or_else(|| NO_VALUE.to_owned(), |row| percent(row.confusion.error()))
    };
    html! {
        div class="scroll" {
            table {
                thead { tr {
                    th { "learner" } th { "error" small { "T\u{a0}=\u{a0}" (last) } }
                    @if few < last { th { "error" small { "T\u{a0}=\u{a0}" (few) } } }
                    th { "average precision" } (operating_point_headers()) th { "maximum F1" }
                } }
                tbody {
                    @for s in rows {
                        @let is_greatest = |of: fn(&Summary) -> f64| rows.iter().all(|other| of(other) <= of(s));
                        tr {
                            th { (learner_name(&s.learner)) }
                            (estimate_cell(s.error, rows.iter().all(|other| s.error.value <= other.error.value)))
                            @if few < last { td { (error_after_few(s)) } }
                            (estimate_cell(s.average_precision, is_greatest(|s| s.average_precision.value)))
                            (estimate_cell(s.recall_at_full_precision, is_greatest(|s| s.recall_at_full_precision.value)))
                            (estimate_cell(s.detection_at_1_percent, is_greatest(|s| s.detection_at_1_percent.value)))
                            (estimate_cell(s.max_f1, is_greatest(|s| s.max_f1.value)))
                        }
                    }
                }
            }
        }
    }
}

/// Headers of the columns of recall at full precision and of detection at 1 % false alarm.
pub(super) fn operating_point_headers() -> Markup {
    html! {
        th { "recall" small { "at 100\u{a0}% precision (0\u{a0}% false alarms)" } }
        th { "recall" small { "at 1\u{a0}% false alarms" } }
    }
}

/// The smallest and the largest number of training pairs of the fits of a grouping.
fn training_pairs(input: &Input<'_>, grouping: &str) -> [usize; 2] {
    let Some(scores) = input.scores.iter().find(|s| s.grouping == grouping) else { return [0; 2] };
    let sizes = || scores.n_training.iter().map(|&n| n as usize);
    [sizes().min(), sizes().max()].map(Option::unwrap_or_default)
}
