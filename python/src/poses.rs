//! Poses as files for other tools.

use std::collections::BTreeSet;
use std::path::PathBuf;

use arrow_array::cast::AsArray;
use arrow_array::types::{Float64Type, Int64Type, TimestampNanosecondType};
use arrow_array::{Array, RecordBatch, RecordBatchReader};
use arrow_schema::{DataType, TimeUnit};
use dataset::tables::write_file;
use dataset::{Pose2, tum};
use pyo3::prelude::*;
use pyo3::types::PyCapsule;

use crate::columns::{Wrong, column};
use crate::table::{next_of, rows_of};
use crate::{Class, error};

/// Writes poses as a TUM file, in the order of the table. Returns how many.
#[pyfunction]
pub(crate) fn to_tum(
    py: Python<'_>,
    poses: &Bound<'_, PyCapsule>,
    file: PathBuf,
) -> PyResult<usize> {
    let mut rows = rows_of(poses)?;
    let wrong = |message: String| error(py, Class::Argument, message);
    poses_of(&RecordBatch::new_empty(rows.schema())).map_err(|found| wrong(found.after(0)))?;
    let mut poses = Vec::new();
    let mut logs = BTreeSet::new();
    while let Some(batch) = next_of(py, &mut rows)? {
        let of_batch = poses_of(&batch).map_err(|found| wrong(found.after(poses.len())))?;
        poses.extend(of_batch);
        logs.extend(logs_of(&batch));
    }
    if 1 < logs.len() {
        let logs: Vec<String> = logs.into_iter().collect();
        return Err(wrong(format!(
            "the poses are those of several logs ({}); write a file for each of them",
            logs.join(", ")
        )));
    }
    let written = py.detach(|| write_file(&file, tum(poses.iter().copied()).as_bytes()));
    written
        .map_err(|failed| error(py, Class::Input, format!("{:#}", anyhow::Error::from(failed))))?;
    Ok(poses.len())
}

/// The different values of the column `log`, if there is one.
fn logs_of(batch: &RecordBatch) -> BTreeSet<String> {
    let Some(column) = batch.column_by_name("log") else { return BTreeSet::new() };
    let rows = 0..column.len();
    let log_of: Box<dyn Fn(usize) -> String> = match column.data_type() {
        DataType::Utf8 => Box::new(|row| column.as_string::<i32>().value(row).to_owned()),
        DataType::LargeUtf8 => Box::new(|row| column.as_string::<i64>().value(row).to_owned()),
        DataType::Utf8View => Box::new(|row| column.as_string_view().value(row).to_owned()),
        _ => return BTreeSet::new(),
    };
    rows.filter(|&row| column.is_valid(row)).map(log_of).collect()
}

/// What a table of poses has.
const EXPECTED: &str = "a table of poses has `stamp_ns`, `x_m`, `y_m` and `heading_rad`";

fn poses_of(batch: &RecordBatch) -> Result<Vec<(i64, Pose2)>, Wrong> {
    let stamps = column(batch, "stamp_ns", EXPECTED)?;
    let stamps = match stamps.data_type() {
        DataType::Int64 => stamps.as_primitive::<Int64Type>().clone(),
        DataType::Timestamp(TimeUnit::Nanosecond, _) => {
            stamps.as_primitive::<TimestampNanosecondType>().reinterpret_cast()
        }
        other => {
            return Err(Wrong::Column(format!(
                "`stamp_ns` has type {other}, expected 64 bit whole numbers of nanoseconds"
            )));
        }
    };
    let [x_m, y_m, heading_rad] = ["x_m", "y_m", "heading_rad"].map(|name| {
        let values = column(batch, name, EXPECTED)?;
        values.as_primitive_opt::<Float64Type>().ok_or_else(|| {
            let found = values.data_type();
            Wrong::Column(format!(
                "`{name}` has type {found}, expected 64 bit floating point numbers"
            ))
        })
    });
    let (x_m, y_m, heading_rad) = (x_m?, y_m?, heading_rad?);
    let of_row = |row: usize| {
        let pose =
            Pose2 { x_m: x_m.value(row), y_m: y_m.value(row), heading_rad: heading_rad.value(row) };
        let is_known = stamps.is_valid(row)
            && [x_m, y_m, heading_rad]
                .iter()
                .all(|values| values.is_valid(row) && values.value(row).is_finite());
        match is_known {
            true => Ok((stamps.value(row), pose)),
            false => Err(Wrong::Row {
                row,
                found: "a stamp or a pose that is null or not finite; leave such rows out"
                    .to_owned(),
            }),
        }
    };
    (0..batch.num_rows()).map(of_row).collect()
}
