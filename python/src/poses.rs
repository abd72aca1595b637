//! Poses as files for other tools.

use std::path::PathBuf;

use arrow_array::cast::AsArray;
use arrow_array::types::{Float64Type, Int64Type, TimestampNanosecondType};
use arrow_array::{Array, RecordBatch};
use arrow_schema::{DataType, TimeUnit};
use dataset::tables::write_file;
use dataset::{Pose2, tum};
use pyo3::prelude::*;
use pyo3::types::PyCapsule;

use crate::columns::{Wrong, column};
use crate::table::rows_of;
use crate::{Class, error};

/// Writes poses as a TUM file, in the order of the table. Returns how many.
#[pyfunction]
pub(crate) fn to_tum(
    py: Python<'_>,
    poses: &Bound<'_, PyCapsule>,
    file: PathBuf,
) -> PyResult<usize> {
    let rows = rows_of(poses)?;
    let read = || -> Result<Vec<(i64, Pose2)>, String> {
        let mut poses = Vec::new();
        for batch in rows {
            let batch = batch.map_err(|failed| failed.to_string())?;
            let of_batch = poses_of(&batch).map_err(|wrong| wrong.after(poses.len()))?;
            poses.extend(of_batch);
        }
        Ok(poses)
    };
    let poses = py.detach(read).map_err(|wrong| error(py, Class::Argument, wrong))?;
    let written = py.detach(|| write_file(&file, tum(poses.iter().copied()).as_bytes()));
    written.map_err(|failed| error(py, Class::Input, anyhow::Error::from(failed)))?;
    Ok(poses.len())
}

/// What a table of poses has.
const EXPECTED: &str = "a table of poses has `stamp_ns`, `x_m`, `y_m` and `heading_rad`";

fn poses_of(batch: &RecordBatch) -> Result<Vec<(i64, Pose2)>, Wrong> {
    let stamps = column(batch, "stamp_ns", EXPECTED)?;
    let of_type = |found: &DataType| {
        Wrong::Column(format!(
            "`stamp_ns` has type {found}, expected 64 bit whole numbers of nanoseconds"
        ))
    };
    let stamps = match stamps.data_type() {
        DataType::Int64 => stamps.as_primitive::<Int64Type>().clone(),
        DataType::Timestamp(TimeUnit::Nanosecond, _) => {
            stamps.as_primitive::<TimestampNanosecondType>().reinterpret_cast()
        }
        other => return Err(of_type(other)),
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
