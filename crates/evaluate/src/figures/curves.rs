//! Line charts: error curves and precision-recall curves.

use dataset::RetrievalPoint;

use super::chart::{Axis, Bound, Chart, Series, ticks};
use crate::text::{
    PAPER_ERROR_BELOW, PAPER_ROUNDS, distinct, learner_name, percent, short_learner_name,
};
use crate::{ErrorRow, Evaluation, Input, PrPoint};

/// The error against the number of boosting rounds, one line per learner.
pub(super) fn error_curve(input: &Input<'_>, evaluation: &Evaluation, grouping: &str) -> Chart {
    let rows: Vec<&ErrorRow> =
        evaluation.errors.iter().filter(|r| r.grouping == grouping).collect();
    let n_rounds = rows.iter().map(|r| r.rounds).max().unwrap_or(1);
    let series = distinct(rows.iter().map(|r| &*r.learner)).into_iter().map(|learner| {
        let of_learner: Vec<&ErrorRow> =
            rows.iter().copied().filter(|r| r.learner == learner).collect();
        error_series(input, learner, &of_learner, n_rounds)
    });
    let highest = rows.iter().map(|r| r.confusion.error()).fold(0.05, f64::max);
    // The paper assigned pairs to folds at random.
    let is_comparable = grouping == "pair" && PAPER_ROUNDS as usize <= n_rounds;
    Chart {
        id: format!("error-curve-{grouping}"),
        description: format!("Error against the number of boosting rounds, by {grouping}"),
        x: rounds_axis(n_rounds),
        y: error_axis(highest),
        series: series.collect(),
        bound: is_comparable.then(|| Bound {
            x: f64::from(PAPER_ROUNDS),
            y: PAPER_ERROR_BELOW,
            text: format!("paper: below {:.0} % at T = {PAPER_ROUNDS}", PAPER_ERROR_BELOW * 100.0),
        }),
    }
}

/// The errors of one learner after each round. A baseline has no rounds: its line is horizontal and
/// ends at `n_rounds`.
fn error_series(input: &Input<'_>, learner: &str, rows: &[&ErrorRow], n_rounds: usize) -> Series {
    let name = learner_name(learner);
    let is_boosted = input.is_boosted(learner);
    let mut points: Vec<(f64, f64)> =
        rows.iter().map(|r| (r.rounds as f64, r.confusion.error())).collect();
    if let (false, Some(last)) = (is_boosted, rows.last()) {
        points.push((n_rounds as f64, last.confusion.error()));
    }
    // A baseline has one hover mark, a boosted learner one per round.
    let mark_step = if is_boosted { 1 } else { rows.len().max(1) };
    let mark = |row: &&ErrorRow| {
        let error = row.confusion.error();
        let text = format!("{name}, T = {}: error {}", row.rounds, percent(error));
        (row.rounds as f64, error, text)
    };
    let marks = rows.iter().skip(mark_step - 1).step_by(mark_step).map(mark).collect();
    Series { name: short_learner_name(learner), style: line_style(input, learner), points, marks }
}

fn rounds_axis(n_rounds: usize) -> Axis {
    let step = (n_rounds / 5).max(1);
    let mut ticks: Vec<f64> = vec![1.0];
    ticks.extend((1..=n_rounds / step).map(|k| (k * step) as f64).filter(|&tick| tick > 1.0));
    Axis {
        title: "rounds T".to_owned(),
        min: 1.0,
        max: (n_rounds as f64).max(2.0),
        ticks,
        format: |tick| format!("{tick:.0}"),
    }
}

fn error_axis(highest: f64) -> Axis {
    let step = match highest {
        h if h <= 0.1 => 0.02,
        h if h <= 0.3 => 0.05,
        _ => 0.1,
    };
    let max = (highest / step).ceil() * step;
    Axis {
        title: "error [%]".to_owned(),
        min: 0.0,
        max,
        ticks: (0..=(max / step).round() as usize).map(|k| k as f64 * step).collect(),
        format: |tick| format!("{:.0}", tick * 100.0),
    }
}

/// Precision against recall after [`crate::PRECISION_RECALL_ROUNDS`], one line per learner.
pub(super) fn precision_recall(
    input: &Input<'_>,
    evaluation: &Evaluation,
    grouping: &str,
) -> Chart {
    let point = |p: &PrPoint| (p.confusion.recall(), p.confusion.precision().unwrap_or(1.0));
    let curves = evaluation.precision_recall.iter().filter(|curve| curve.grouping == grouping);
    let series = curves.map(|curve| {
        let points = curve.points.iter().map(point).collect();
        precision_recall_series(input, &curve.learner, points)
    });
    Chart {
        id: format!("precision-recall-{grouping}"),
        description: format!("Precision against recall, by {grouping}"),
        x: recall_axis(),
        // With equal numbers of both classes, the precision is about 0.5 or more.
        y: precision_axis(0.4),
        series: series.collect(),
        bound: None,
    }
}

/// Precision against recall at natural prevalence, over all logs, without ambiguous pairs.
pub(super) fn retrieval(input: &Input<'_>) -> Option<Chart> {
    let rows = input.retrieval_of_all().filter(|row| !row.ambiguous_as_negative);
    let series: Vec<Series> = rows
        .map(|row| {
            let point = |p: &RetrievalPoint| {
                let n_called_positive = (p.true_positive + p.false_positive) as f64;
                let recall = p.true_positive as f64 / row.n_positive as f64;
                (recall, p.true_positive as f64 / n_called_positive)
            };
            precision_recall_series(input, &row.learner, row.curve.iter().map(point).collect())
        })
        .collect();
    (!series.is_empty()).then(|| Chart {
        id: "retrieval".to_owned(),
        description: "Precision against recall at natural prevalence".to_owned(),
        x: recall_axis(),
        y: precision_axis(0.0),
        series,
        bound: None,
    })
}

/// A curve through points (recall, precision), with a hover mark at each tenth of recall.
fn precision_recall_series(input: &Input<'_>, learner: &str, points: Vec<(f64, f64)>) -> Series {
    let name = learner_name(learner);
    let mut marks = Vec::new();
    for &(recall, precision) in &points {
        if (marks.len() + 1) as f64 / 10.0 <= recall {
            let text =
                format!("{name}: precision {} at recall {}", percent(precision), percent(recall));
            marks.push((recall, precision, text));
        }
    }
    Series { name: short_learner_name(learner), style: line_style(input, learner), points, marks }
}

fn recall_axis() -> Axis {
    Axis {
        title: "recall".to_owned(),
        min: 0.0,
        max: 1.0,
        ticks: (0..=5).map(|k| f64::from(k) / 5.0).collect(),
        format: |tick| format!("{tick:.1}"),
    }
}

fn precision_axis(min: f64) -> Axis {
    Axis {
        title: "precision".to_owned(),
        min,
        max: 1.0,
        ticks: ticks(min, 1.0),
        format: |tick| format!("{tick:.1}"),
    }
}

/// The line style of a learner: its index among all learners, the same in all charts.
fn line_style(input: &Input<'_>, learner: &str) -> usize {
    let learners = distinct(input.scores.iter().map(|s| &*s.learner));
    learners.iter().position(|name| *name == learner).unwrap_or(0)
}
