//! The tables of `train` about all pairs of keyframes, and about pairs that are labelled with other
//! rules.

use std::path::Path;
use std::sync::Arc;

use arrow_array::builder::{Float64Builder, ListBuilder, UInt64Builder};
use arrow_array::cast::AsArray;
use arrow_array::types::{Float64Type, UInt64Type};
use arrow_array::{
    Array, ArrayRef, BooleanArray, Float64Array, ListArray, StringArray, UInt64Array,
};
use arrow_schema::{DataType, Field};

use super::columns::Columns;
use super::types::{batch, floats, strings};
use super::{Provenance, Result, TableError, read_table, write_table};
use crate::{GridCell, Retrieval, RetrievalPoint};

/// Writes `retrieval.parquet`: one row per learner, log and treatment of ambiguous pairs. The log
/// is null for all logs together. The columns of the curve are lists of the same length.
pub fn write_retrieval(path: &Path, provenance: &Provenance, rows: &[Retrieval]) -> Result<()> {
    write_table(path, "retrieval", provenance, &retrieval_batch(rows))
}

/// The columns of `retrieval.parquet`.
pub fn retrieval_batch(rows: &[Retrieval]) -> arrow_array::RecordBatch {
    let counts = |of: fn(&Retrieval) -> u64| -> ArrayRef {
        Arc::new(UInt64Array::from_iter_values(rows.iter().map(of)))
    };
    let shares = |of: fn(&Retrieval) -> Option<f64>| -> ArrayRef {
        Arc::new(rows.iter().map(of).collect::<Float64Array>())
    };
    let mut thresholds = ListBuilder::new(Float64Builder::new()).with_field(Field::new(
        "item",
        DataType::Float64,
        false,
    ));
    let count_list = || {
        ListBuilder::new(UInt64Builder::new()).with_field(Field::new(
            "item",
            DataType::UInt64,
            false,
        ))
    };
    let (mut true_positives, mut false_positives) = (count_list(), count_list());
    for row in rows {
        for point in &row.curve {
            thresholds.values().append_value(point.threshold);
            true_positives.values().append_value(point.true_positive);
            false_positives.values().append_value(point.false_positive);
        }
        thresholds.append(true);
        true_positives.append(true);
        false_positives.append(true);
    }
    let columns: Vec<(&str, ArrayRef)> = vec![
        ("learner", strings(rows.iter().map(|r| &*r.learner))),
        ("grouping", strings(rows.iter().map(|r| &*r.grouping))),
        ("log", Arc::new(rows.iter().map(|r| r.log.as_deref()).collect::<StringArray>())),
        (
            "ambiguous_as_negative",
            Arc::new(rows.iter().map(|r| Some(r.ambiguous_as_negative)).collect::<BooleanArray>()),
        ),
        ("n_positive", counts(|r| r.n_positive)),
        ("n_negative", counts(|r| r.n_negative)),
        ("n_ambiguous", counts(|r| r.n_ambiguous)),
        ("n_unscored", counts(|r| r.n_unscored)),
        ("query_stride", counts(|r| r.query_stride)),
        ("average_precision", shares(|r| r.average_precision)),
        ("recall_at_full_precision", shares(|r| r.recall_at_full_precision)),
        ("detection_at_1_percent", shares(|r| r.detection_at_1_percent)),
        ("max_f1", shares(|r| r.max_f1)),
        ("threshold", Arc::new(thresholds.finish())),
        ("true_positive", Arc::new(true_positives.finish())),
        ("false_positive", Arc::new(false_positives.finish())),
    ];
    let nullable = [
        "log",
        "average_precision",
        "recall_at_full_precision",
        "detection_at_1_percent",
        "max_f1",
    ];
    batch(columns, &nullable)
}

/// Reads `retrieval.parquet`.
pub fn read_retrieval(path: &Path) -> Result<(Vec<Retrieval>, Provenance)> {
    let (table, provenance) = read_table(path, "retrieval")?;
    let columns = Columns::new(path, &table);
    let (learners, groupings) = (columns.strings("learner")?, columns.strings("grouping")?);
    let logs = columns.nullable_strings("log")?;
    let as_negative = columns.column("ambiguous_as_negative")?;
    let as_negative = as_negative.as_boolean_opt().ok_or_else(|| {
        let found = as_negative.data_type().to_string();
        columns.error("ambiguous_as_negative", "a boolean column", found)
    })?;
    let count = |name| columns.numbers::<UInt64Type>(name);
    let (positive, negative) = (count("n_positive")?, count("n_negative")?);
    let (ambiguous, unscored) = (count("n_ambiguous")?, count("n_unscored")?);
    let strides = count("query_stride")?;
    let share = |name| columns.nullable_numbers::<Float64Type>(name);
    let average_precision = share("average_precision")?;
    let recall = share("recall_at_full_precision")?;
    let detection = share("detection_at_1_percent")?;
    let max_f1 = share("max_f1")?;
    let list = |name, item: DataType| -> Result<&ListArray> {
        let column = columns.column(name)?;
        column
            .as_list_opt::<i32>()
            .filter(|list| *list.values().data_type() == item)
            .ok_or_else(|| columns.error(name, "a list of numbers", column.data_type().to_string()))
    };
    let thresholds = list("threshold", DataType::Float64)?;
    let true_positives = list("true_positive", DataType::UInt64)?;
    let false_positives = list("false_positive", DataType::UInt64)?;
    let value = |of: &Float64Array, row: usize| of.is_valid(row).then(|| of.value(row));
    let rows = (0..table.num_rows())
        .map(|row| {
            let (t, tp, fp) =
                (thresholds.value(row), true_positives.value(row), false_positives.value(row));
            if t.len() != tp.len() || t.len() != fp.len() {
                return Err(TableError::Row {
                    path: path.to_owned(),
                    row,
                    detail: "the lists of the curve differ in length".to_owned(),
                });
            }
            let t = t.as_primitive::<Float64Type>().values();
            let tp = tp.as_primitive::<UInt64Type>().values();
            let fp = fp.as_primitive::<UInt64Type>().values();
            let point = |((&threshold, &true_positive), &false_positive)| RetrievalPoint {
                threshold,
                true_positive,
                false_positive,
            };
            Ok(Retrieval {
                learner: learners.value(row).to_owned(),
                grouping: groupings.value(row).to_owned(),
                log: logs.is_valid(row).then(|| logs.value(row).to_owned()),
                ambiguous_as_negative: as_negative.value(row),
                n_positive: positive.value(row),
                n_negative: negative.value(row),
                n_ambiguous: ambiguous.value(row),
                n_unscored: unscored.value(row),
                query_stride: strides.value(row),
                average_precision: value(average_precision, row),
                recall_at_full_precision: value(recall, row),
                detection_at_1_percent: value(detection, row),
                max_f1: value(max_f1, row),
                curve: t.iter().zip(tp).zip(fp).map(point).collect(),
            })
        })
        .collect::<Result<_>>()?;
    Ok((rows, provenance))
}

/// Writes `grid.parquet`. If there are too few pairs, `error` is null and `reason` states why.
pub fn write_grid(path: &Path, provenance: &Provenance, cells: &[GridCell]) -> Result<()> {
    write_table(path, "grid", provenance, &grid_batch(cells))
}

/// The columns of `grid.parquet`.
pub fn grid_batch(cells: &[GridCell]) -> arrow_array::RecordBatch {
    let errors = cells.iter().map(|c| c.error.as_ref().ok().copied());
    let reasons = cells.iter().map(|c| c.error.as_ref().err().map(String::as_str));
    let columns: Vec<(&str, ArrayRef)> = vec![
        ("learner", strings(cells.iter().map(|c| &*c.learner))),
        ("grouping", strings(cells.iter().map(|c| &*c.grouping))),
        ("positive_radius_m", floats(cells.iter().map(|c| c.positive_radius_m))),
        ("negative_min_m", floats(cells.iter().map(|c| c.negative_min_m))),
        ("min_travel_gap_m", floats(cells.iter().map(|c| c.min_travel_gap_m))),
        ("error", Arc::new(errors.collect::<Float64Array>())),
        ("reason", Arc::new(reasons.collect::<StringArray>())),
    ];
    batch(columns, &["error", "reason"])
}

/// Reads `grid.parquet`.
pub fn read_grid(path: &Path) -> Result<(Vec<GridCell>, Provenance)> {
    let (table, provenance) = read_table(path, "grid")?;
    let columns = Columns::new(path, &table);
    let (learners, groupings) = (columns.strings("learner")?, columns.strings("grouping")?);
    let radii = columns.numbers::<Float64Type>("positive_radius_m")?;
    let distances = columns.numbers::<Float64Type>("negative_min_m")?;
    let gaps = columns.numbers::<Float64Type>("min_travel_gap_m")?;
    let errors = columns.nullable_numbers::<Float64Type>("error")?;
    let reasons = columns.nullable_strings("reason")?;
    let cells = (0..table.num_rows())
        .map(|row| GridCell {
            learner: learners.value(row).to_owned(),
            grouping: groupings.value(row).to_owned(),
            positive_radius_m: radii.value(row),
            negative_min_m: distances.value(row),
            min_travel_gap_m: gaps.value(row),
            error: match errors.is_valid(row) {
                true => Ok(errors.value(row)),
                false => Err(reasons.value(row).to_owned()),
            },
        })
        .collect();
    Ok((cells, provenance))
}
