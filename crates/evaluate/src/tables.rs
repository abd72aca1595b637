//! `evaluation/*.parquet`.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_array::{ArrayRef, Float64Array, Int8Array, StringArray, UInt32Array, UInt64Array};
use dataset::tables::{Provenance, Result, batch, floats, strings, write_table};

use crate::{Evaluation, Input, Summary};

/// Writes `summary`, `errors`, `precision_recall`, `selection`, `features` and `mistakes` into a
/// folder; returns their paths.
///
/// | table | a row is | columns |
/// |---|---|---|
/// | `summary` | a measure of a learner after the last round | `learner`, `grouping`, `rounds`, `folds`, `groups`, `measure` (`error`, `average_precision`, `recall_at_full_precision`, `detection_at_1_percent`, `max_f1`), `value`, `low` and `high` (the 95 % interval; null where there are too few groups) |
/// | `errors` | a learner after T rounds | `learner`, `grouping`, `rounds`, `error`, `precision` (null where no pair is called positive), `recall`, and the four counts |
/// | `precision_recall` | a threshold | `learner`, `grouping`, `rounds`, `threshold`, `precision`, `recall`, `false_alarm` |
/// | `selection` | a round of a fit | `learner`, `grouping`, `fold` (both null: fitted on all pairs), `round`, `feature`, `threshold`, `weighted_error`, `error` (cross-validated, after this round; only where fitted on all pairs) |
/// | `features` | a feature | `feature`, `auc` (of the feature alone), `stability` (how far it moves when scans are thinned to every other return: median, as a share of its interquartile range), `chosen` (how often the models' rounds did) |
/// | `mistakes` | a wrongly labelled pair, worst first | `learner`, `grouping`, the pair's names, `label`, `confidence`, `distance_m` |
pub fn write_tables(
    folder: &Path,
    provenance: &Provenance,
    input: &Input<'_>,
    evaluation: &Evaluation,
) -> Result<Vec<PathBuf>> {
    let mut written = Vec::new();
    let mut write = |name: &str, columns: Vec<(&str, ArrayRef)>, nullable: &[&str]| {
        let path = folder.join(format!("{name}.parquet"));
        write_table(&path, name, provenance, &batch(columns, nullable))?;
        written.push(path);
        Ok(())
    };

    let rows = || evaluation.summaries.iter().flat_map(|s| s.measures().map(|m| (s, m.0, m.1)));
    let numbers = |of: fn(&Summary) -> u32| -> ArrayRef {
        Arc::new(UInt32Array::from_iter_values(rows().map(|(s, _, _)| of(s))))
    };
    let bound = |end: usize| -> ArrayRef {
        let bounds = rows().map(|(_, _, e)| e.interval.map(|interval| interval[end]));
        Arc::new(bounds.collect::<Float64Array>())
    };
    let columns: Vec<(&str, ArrayRef)> = vec![
        ("learner", strings(rows().map(|(s, _, _)| &*s.learner))),
        ("grouping", strings(rows().map(|(s, _, _)| &*s.grouping))),
        ("rounds", numbers(|s| s.rounds as u32)),
        ("folds", numbers(|s| s.folds)),
        ("groups", numbers(|s| s.groups as u32)),
        ("measure", strings(rows().map(|(_, name, _)| name))),
        ("value", floats(rows().map(|(_, _, e)| e.value))),
        ("low", bound(0)),
        ("high", bound(1)),
    ];
    write("summary", columns, &["low", "high"])?;

    let rows = &evaluation.errors;
    let count = |of: fn(&crate::Confusion) -> usize| -> ArrayRef {
        Arc::new(UInt64Array::from_iter_values(rows.iter().map(|r| of(&r.confusion) as u64)))
    };
    let columns: Vec<(&str, ArrayRef)> = vec![
        ("learner", strings(rows.iter().map(|r| &*r.learner))),
        ("grouping", strings(rows.iter().map(|r| &*r.grouping))),
        ("rounds", Arc::new(UInt32Array::from_iter_values(rows.iter().map(|r| r.rounds as u32)))),
        ("error", floats(rows.iter().map(|r| r.confusion.error()))),
        (
            "precision",
            Arc::new(rows.iter().map(|r| r.confusion.precision()).collect::<Float64Array>()),
        ),
        ("recall", floats(rows.iter().map(|r| r.confusion.recall()))),
        ("true_positive", count(|c| c.true_positive)),
        ("false_positive", count(|c| c.false_positive)),
        ("true_negative", count(|c| c.true_negative)),
        ("false_negative", count(|c| c.false_negative)),
    ];
    write("errors", columns, &["precision"])?;

    let rows =
        || evaluation.precision_recall.iter().flat_map(|c| c.points.iter().map(move |p| (c, p)));
    let columns: Vec<(&str, ArrayRef)> = vec![
        ("learner", strings(rows().map(|(c, _)| &*c.learner))),
        ("grouping", strings(rows().map(|(c, _)| &*c.grouping))),
        ("rounds", Arc::new(UInt32Array::from_iter_values(rows().map(|(c, _)| c.rounds as u32)))),
        ("threshold", floats(rows().map(|(_, p)| p.threshold))),
        // Every point calls at least one pair positive.
        ("precision", floats(rows().map(|(_, p)| p.confusion.precision().unwrap_or(0.0)))),
        ("recall", floats(rows().map(|(_, p)| p.confusion.recall()))),
        ("false_alarm", floats(rows().map(|(_, p)| p.confusion.false_alarm()))),
    ];
    write("precision_recall", columns, &[])?;

    let rows = input.rounds;
    let left_out = |of: usize| -> ArrayRef {
        let folds = rows.iter().map(|r| r.left_out.as_ref().map(|l| l.folds[of]));
        Arc::new(folds.collect::<UInt32Array>())
    };
    let error_after = |r: &dataset::BoostingRound| {
        let of_all = r.left_out.is_none();
        let row = evaluation
            .errors
            .iter()
            .find(|e| of_all && e.learner == r.learner && e.rounds == r.round as usize);
        row.map(|e| e.confusion.error())
    };
    let columns: Vec<(&str, ArrayRef)> = vec![
        ("learner", strings(rows.iter().map(|r| &*r.learner))),
        (
            "grouping",
            Arc::new(
                rows.iter()
                    .map(|r| r.left_out.as_ref().map(|l| &*l.grouping))
                    .collect::<StringArray>(),
            ),
        ),
        ("fold", left_out(0)),
        ("other_fold", left_out(1)),
        ("round", Arc::new(UInt32Array::from_iter_values(rows.iter().map(|r| r.round)))),
        ("feature", strings(rows.iter().map(|r| &*r.feature))),
        ("threshold", Arc::new(rows.iter().map(|r| r.threshold).collect::<Float64Array>())),
        ("weighted_error", floats(rows.iter().map(|r| r.weighted_error))),
        ("error", Arc::new(rows.iter().map(error_after).collect::<Float64Array>())),
    ];
    write("selection", columns, &["grouping", "fold", "other_fold", "threshold", "error"])?;

    let rows = input.feature_rows;
    let columns: Vec<(&str, ArrayRef)> = vec![
        ("feature", strings(rows.iter().map(|r| &*r.name))),
        ("auc", floats(rows.iter().map(|r| r.auc))),
        ("stability", floats(rows.iter().map(|r| r.stability))),
        ("chosen", Arc::new(UInt64Array::from_iter_values(rows.iter().map(|r| r.chosen as u64)))),
    ];
    write("features", columns, &[])?;

    let rows = &evaluation.mistakes;
    let pair = |m: &crate::Mistake| &input.pairs[m.pair];
    let query = |m: &crate::Mistake| &input.keyframes[pair(m).query].id;
    let reference = |m: &crate::Mistake| &input.keyframes[pair(m).reference].id;
    let columns: Vec<(&str, ArrayRef)> = vec![
        ("learner", strings(rows.iter().map(|m| &*m.learner))),
        ("grouping", strings(rows.iter().map(|m| &*m.grouping))),
        ("query_log", strings(rows.iter().map(|m| &*query(m).log))),
        ("query_scan", Arc::new(UInt32Array::from_iter_values(rows.iter().map(|m| query(m).scan)))),
        ("reference_log", strings(rows.iter().map(|m| &*reference(m).log))),
        (
            "reference_scan",
            Arc::new(UInt32Array::from_iter_values(rows.iter().map(|m| reference(m).scan))),
        ),
        ("label", Arc::new(Int8Array::from_iter_values(rows.iter().map(|m| pair(m).label.sign())))),
        ("confidence", floats(rows.iter().map(|m| m.confidence))),
        ("distance_m", floats(rows.iter().map(|m| pair(m).distance_m))),
    ];
    write("mistakes", columns, &[])?;
    Ok(written)
}
