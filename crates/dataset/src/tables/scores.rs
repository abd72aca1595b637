//! The tables that `train` writes and `evaluate` reads: cross-validated confidences and rounds of
//! boosting.

use std::path::Path;
use std::sync::Arc;

use arrow_array::builder::{Float64Builder, ListBuilder};
use arrow_array::cast::AsArray;
use arrow_array::types::{Float64Type, Int8Type, UInt32Type};
use arrow_array::{Array, ArrayRef, Float64Array, Int8Array, StringArray, UInt32Array};
use arrow_schema::{DataType, Field};

use super::columns::Columns;
use super::types::{batch, strings};
use super::{Provenance, Result, TableError, read_table, write_table};
use crate::{BoostingRound, HeldOut, Keyframe, Pair, Scores};

/// Writes `scores.parquet`: one row per learner, grouping and pair. The pairs have the same order
/// as in `pairs.parquet`.
pub fn write_scores(
    path: &Path,
    provenance: &Provenance,
    keyframes: &[Keyframe],
    pairs: &[Pair],
    scores: &[Scores],
) -> Result<()> {
    let rows = || scores.iter().flat_map(|s| pairs.iter().enumerate().map(move |(k, p)| (s, k, p)));
    let id = |k: usize| &keyframes[k].id;
    let mut confidences = ListBuilder::new(Float64Builder::new()).with_field(Field::new(
        "item",
        DataType::Float64,
        false,
    ));
    for (scores, k, _) in rows() {
        confidences
            .values()
            .append_slice(&scores.confidences[k * scores.n_rounds..][..scores.n_rounds]);
        confidences.append(true);
    }
    let numbers = |values: &mut dyn Iterator<Item = u32>| -> ArrayRef {
        Arc::new(UInt32Array::from_iter_values(values))
    };
    let columns: Vec<(&str, ArrayRef)> = vec![
        ("learner", strings(rows().map(|(s, _, _)| &*s.learner))),
        ("grouping", strings(rows().map(|(s, _, _)| &*s.grouping))),
        ("query_group", numbers(&mut rows().map(|(s, k, _)| s.groups[k][0]))),
        ("reference_group", numbers(&mut rows().map(|(s, k, _)| s.groups[k][1]))),
        ("query_fold", numbers(&mut rows().map(|(s, k, _)| s.folds[k][0]))),
        ("reference_fold", numbers(&mut rows().map(|(s, k, _)| s.folds[k][1]))),
        ("n_training", numbers(&mut rows().map(|(s, k, _)| s.n_training[k]))),
        ("query_log", strings(rows().map(|(_, _, p)| &*id(p.query).log))),
        ("query_scan", numbers(&mut rows().map(|(_, _, p)| id(p.query).scan))),
        ("reference_log", strings(rows().map(|(_, _, p)| &*id(p.reference).log))),
        ("reference_scan", numbers(&mut rows().map(|(_, _, p)| id(p.reference).scan))),
        ("label", Arc::new(Int8Array::from_iter_values(rows().map(|(_, _, p)| p.label.sign())))),
        ("confidences", Arc::new(confidences.finish())),
    ];
    write_table(path, "scores", provenance, &batch(columns, &[]))
}

/// Reads `scores.parquet`. Its rows must match `pairs`.
pub fn read_scores(path: &Path, pairs: &[Pair]) -> Result<(Vec<Scores>, Provenance)> {
    let (table, provenance) = read_table(path, "scores")?;
    let columns = Columns::new(path, &table);
    let learners = columns.strings("learner")?;
    let groupings = columns.strings("grouping")?;
    let groups = ["query_group", "reference_group"].map(|name| columns.numbers::<UInt32Type>(name));
    let folds = ["query_fold", "reference_fold"].map(|name| columns.numbers::<UInt32Type>(name));
    let ([group_a, group_b], [fold_a, fold_b]) = (groups, folds);
    let (group_a, group_b, fold_a, fold_b) = (group_a?, group_b?, fold_a?, fold_b?);
    let n_training = columns.numbers::<UInt32Type>("n_training")?;
    let labels = columns.numbers::<Int8Type>("label")?;
    let column = columns.column("confidences")?;
    let lists = column
        .as_list_opt::<i32>()
        .filter(|list| list.values().data_type() == &DataType::Float64)
        .ok_or_else(|| {
            columns.error("confidences", "a list of f64", column.data_type().to_string())
        })?;
    let row_error = |row, detail: &str| TableError::Row {
        path: path.to_owned(),
        row,
        detail: detail.to_owned(),
    };
    if pairs.is_empty() || table.num_rows() % pairs.len() != 0 {
        return Err(row_error(table.num_rows(), "the table does not have one row per pair"));
    }
    let mut scores = Vec::new();
    for start in (0..table.num_rows()).step_by(pairs.len()) {
        let n_rounds = lists.value(start).len();
        let mut block = Scores {
            learner: learners.value(start).to_owned(),
            grouping: groupings.value(start).to_owned(),
            n_rounds,
            groups: Vec::with_capacity(pairs.len()),
            folds: Vec::with_capacity(pairs.len()),
            n_training: Vec::with_capacity(pairs.len()),
            confidences: Vec::with_capacity(pairs.len() * n_rounds),
        };
        for (row, pair) in (start..).zip(pairs) {
            let values = lists.value(row);
            if learners.value(row) != block.learner
                || groupings.value(row) != block.grouping
                || labels.value(row) != pair.label.sign()
                || values.len() != n_rounds
                || n_rounds == 0
            {
                return Err(row_error(row, "does not match the pair in pairs.parquet"));
            }
            block.groups.push([group_a.value(row), group_b.value(row)]);
            block.folds.push([fold_a.value(row), fold_b.value(row)]);
            block.n_training.push(n_training.value(row));
            block.confidences.extend_from_slice(values.as_primitive::<Float64Type>().values());
        }
        scores.push(block);
    }
    Ok((scores, provenance))
}

/// Writes `rounds.parquet`.
pub fn write_rounds(path: &Path, provenance: &Provenance, rounds: &[BoostingRound]) -> Result<()> {
    let fold = |of: usize| -> ArrayRef {
        let folds = rounds.iter().map(|r| r.held_out.as_ref().map(|held_out| held_out.folds[of]));
        Arc::new(folds.collect::<UInt32Array>())
    };
    let columns: Vec<(&str, ArrayRef)> = vec![
        ("learner", strings(rounds.iter().map(|r| &*r.learner))),
        (
            "grouping",
            Arc::new(
                rounds
                    .iter()
                    .map(|r| r.held_out.as_ref().map(|held_out| &*held_out.grouping))
                    .collect::<StringArray>(),
            ),
        ),
        ("fold", fold(0)),
        ("other_fold", fold(1)),
        ("round", Arc::new(UInt32Array::from_iter_values(rounds.iter().map(|r| r.round)))),
        ("node", Arc::new(rounds.iter().map(|r| r.node).collect::<UInt32Array>())),
        ("feature", strings(rounds.iter().map(|r| &*r.feature))),
        ("threshold", Arc::new(rounds.iter().map(|r| r.threshold).collect::<Float64Array>())),
        (
            "weighted_error",
            Arc::new(Float64Array::from_iter_values(rounds.iter().map(|r| r.weighted_error))),
        ),
    ];
    write_table(
        path,
        "rounds",
        provenance,
        &batch(columns, &["grouping", "fold", "other_fold", "node", "threshold"]),
    )
}

/// Reads `rounds.parquet`.
pub fn read_rounds(path: &Path) -> Result<(Vec<BoostingRound>, Provenance)> {
    let (table, provenance) = read_table(path, "rounds")?;
    let columns = Columns::new(path, &table);
    let learners = columns.strings("learner")?;
    let groupings = columns.nullable_strings("grouping")?;
    let folds = columns.nullable_numbers::<UInt32Type>("fold")?;
    let others = columns.nullable_numbers::<UInt32Type>("other_fold")?;
    let rounds = columns.numbers::<UInt32Type>("round")?;
    let nodes = columns.nullable_numbers::<UInt32Type>("node")?;
    let features = columns.strings("feature")?;
    let thresholds = columns.nullable_numbers::<Float64Type>("threshold")?;
    let errors = columns.numbers::<Float64Type>("weighted_error")?;
    let rows = (0..table.num_rows())
        .map(|row| BoostingRound {
            learner: learners.value(row).to_owned(),
            held_out: folds.is_valid(row).then(|| HeldOut {
                grouping: groupings.value(row).to_owned(),
                folds: [folds.value(row), others.value(row)],
            }),
            round: rounds.value(row),
            node: nodes.is_valid(row).then(|| nodes.value(row)),
            feature: features.value(row).to_owned(),
            threshold: thresholds.is_valid(row).then(|| thresholds.value(row)),
            weighted_error: errors.value(row),
        })
        .collect();
    Ok((rows, provenance))
}
