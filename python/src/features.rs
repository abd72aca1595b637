//! Features of scans.

use std::collections::BTreeMap;
use std::sync::Arc;

use ::featurize::{FeatureSet, Featurizer, Options};
use arrow_array::{ArrayRef, Float64Array, RecordBatch, RecordBatchReader, UInt32Array};
use arrow_schema::{DataType, Field, Schema, SchemaRef};
use dataset::{Scan, Unusable};
use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::prelude::*;
use pyo3::types::PyCapsule;

use crate::columns::{Wrong, column, lists, numbers};
use crate::scans::Rows;
use crate::table::{column_names, next_of, rows_of};
use crate::{Class, error};

/// The feature set of this name.
fn feature_set(py: Python<'_>, name: &str) -> PyResult<FeatureSet> {
    FeatureSet::ALL.into_iter().find(|set| set.name() == name).ok_or_else(|| {
        let known = FeatureSet::ALL.map(|set| format!("`{}`", set.name()));
        let known = known.join(" or ");
        error(py, Class::Argument, format!("no feature set `{name}`, expected {known}"))
    })
}

/// The names of the features of a set, in order.
#[pyfunction]
pub(crate) fn feature_names(py: Python<'_>, set: &str) -> PyResult<Vec<&'static str>> {
    Ok(feature_set(py, set)?.feature_names().to_vec())
}

/// The features of a scan, `(n_features,)`. `x_m` and `y_m` have the same length.
#[pyfunction]
pub(crate) fn featurize<'py>(
    py: Python<'py>,
    x_m: PyReadonlyArray1<'py, f32>,
    y_m: PyReadonlyArray1<'py, f32>,
    coverage_deg: f32,
    set: &str,
    gate_m: f64,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let options = options(py, set, gate_m)?;
    features_of(py, &x_m, &y_m, coverage_deg, &options)
}

fn options(py: Python<'_>, set: &str, gate_m: f64) -> PyResult<Options> {
    let options = Options { set: feature_set(py, set)?, gate_m };
    options.check().map_err(|wrong| error(py, Class::Argument, wrong))?;
    Ok(options)
}

/// The features of each scan of a table, next to the columns that are not points.
#[pyfunction]
pub(crate) fn featurize_table(
    py: Python<'_>,
    scans: &Bound<'_, PyCapsule>,
    set: &str,
    gate_m: f64,
) -> PyResult<Rows> {
    let options = options(py, set, gate_m)?;
    let mut scans = rows_of(scans)?;
    // Wrong columns are an error for a table without rows, too.
    let wrong = |wrong: Wrong| error(py, Class::Argument, wrong.after(0));
    scans_of(&RecordBatch::new_empty(scans.schema())).map_err(wrong)?;
    let schema = with_features(&scans.schema(), options.set.feature_names())
        .map_err(|wrong| error(py, Class::Argument, wrong))?;
    let mut batches = Vec::new();
    let mut n_rows = 0;
    let mut unusable = BTreeMap::new();
    while let Some(batch) = next_of(py, &mut scans)? {
        for first in (0..batch.num_rows()).step_by(ROWS_AT_ONCE) {
            py.check_signals()?;
            let batch = batch.slice(first, ROWS_AT_ONCE.min(batch.num_rows() - first));
            let scans = scans_of(&batch)
                .map_err(|wrong| error(py, Class::Argument, wrong.after(n_rows)))?;
            n_rows += scans.len();
            let features = py.detach(|| features_of_all(&scans, &options));
            for reason in features.iter().filter_map(|features| features.as_ref().err()) {
                *unusable.entry(reason.to_string()).or_insert(0) += 1;
            }
            batches.push(featurized(&batch, &features, &schema));
        }
    }
    let line =
        |(reason, n): (String, u64)| format!("{n} of {n_rows} scans have no features: {reason}");
    Ok(Rows::new(schema, batches, unusable.into_iter().map(line).collect()))
}

/// Scans between two looks for signals.
const ROWS_AT_ONCE: usize = 4096;

/// The columns with the points of a scan.
const POINTS: [&str; 2] = ["x_m", "y_m"];

/// The columns of a table of scans without the points, and those of the features.
fn with_features(of_scans: &Schema, features: &[&str]) -> Result<SchemaRef, String> {
    let others = of_scans.fields().iter().filter(|field| !POINTS.contains(&field.name().as_str()));
    let mut fields: Vec<Field> = others.map(|field| field.as_ref().clone()).collect();
    if let Some(twice) = fields.iter().find(|field| features.contains(&field.name().as_str())) {
        return Err(format!(
            "the table has a column `{}` already, which is the name of a feature; pass a table of scans",
            twice.name()
        ));
    }
    fields.extend(features.iter().map(|name| Field::new(*name, DataType::Float64, true)));
    Ok(Arc::new(Schema::new(fields)))
}

/// The features of each scan, or why it has none.
fn features_of_all(scans: &[Scan], options: &Options) -> Vec<Result<Vec<f64>, Unusable>> {
    let n_features = options.set.feature_names().len();
    let mut features: Vec<Result<Vec<f64>, Unusable>> = vec![Ok(Vec::new()); scans.len()];
    // Threads of this call only: those of a pool are missing in a process that Python's multiprocessing forked.
    let n_threads = std::thread::available_parallelism().map_or(1, usize::from);
    let chunk = scans.len().div_ceil(n_threads).max(1);
    std::thread::scope(|scope| {
        for (scans, features) in scans.chunks(chunk).zip(features.chunks_mut(chunk)) {
            scope.spawn(move || {
                let mut featurizer = Featurizer::new(options);
                for (scan, features) in scans.iter().zip(features) {
                    let mut values = vec![0.0; n_features];
                    *features = featurizer.features(scan, &mut values).map(|()| values);
                }
            });
        }
    });
    features
}

/// The rows of a batch with the features of their scans, null where there are none.
fn featurized(
    batch: &RecordBatch,
    features: &[Result<Vec<f64>, Unusable>],
    schema: &SchemaRef,
) -> RecordBatch {
    let names = column_names(batch.schema_ref()).into_iter().zip(batch.columns());
    let others = names.filter(|(name, _)| !POINTS.contains(name));
    let mut columns: Vec<ArrayRef> = others.map(|(_, column)| copied(column)).collect();
    columns.extend((0..schema.fields().len() - columns.len()).map(|feature| -> ArrayRef {
        let of_scan = |features: &Result<Vec<f64>, Unusable>| {
            features.as_ref().ok().map(|values| values[feature])
        };
        Arc::new(features.iter().map(of_scan).collect::<Float64Array>())
    }));
    RecordBatch::try_new(schema.clone(), columns).expect("the columns are those of the schema")
}

/// A copy. All columns of a stream share their memory with the points, which would be kept with any of them.
fn copied(column: &ArrayRef) -> ArrayRef {
    let rows = UInt32Array::from_iter_values(0..column.len() as u32);
    arrow_select::take::take(column, &rows, None).expect("the rows are those of the column")
}

/// What a table of scans has.
const EXPECTED: &str = "a table of scans has `x_m`, `y_m` and `coverage_deg`";

/// The scans of a batch: the columns `x_m` and `y_m`, lists of numbers, and `coverage_deg`.
fn scans_of(batch: &RecordBatch) -> Result<Vec<Scan>, Wrong> {
    let [x_m, y_m] = POINTS.map(|name| lists(batch, name, EXPECTED));
    let (x_m, y_m, coverage_deg) =
        (x_m?, y_m?, numbers(column(batch, "coverage_deg", EXPECTED)?, "coverage_deg")?);
    let scans = x_m.into_iter().zip(y_m).zip(coverage_deg).enumerate();
    scans
        .map(|(row, ((x_m, y_m), coverage_deg))| match x_m.len() == y_m.len() {
            true => Ok(Scan { x_m, y_m, coverage_deg, ..Scan::default() }),
            false => {
                let found = format!("{} numbers in `x_m` and {} in `y_m`", x_m.len(), y_m.len());
                Err(Wrong::Row { row, found })
            }
        })
        .collect()
}

/// The features of a scan with options that were checked.
pub(crate) fn features_of<'py>(
    py: Python<'py>,
    x_m: &PyReadonlyArray1<'py, f32>,
    y_m: &PyReadonlyArray1<'py, f32>,
    coverage_deg: f32,
    options: &Options,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    let [x_m, y_m] = [x_m.as_slice()?.to_vec(), y_m.as_slice()?.to_vec()];
    let features = py.detach(|| {
        let scan = Scan { x_m, y_m, coverage_deg, ..Scan::default() };
        let mut features = vec![0.0; options.set.feature_names().len()];
        Featurizer::new(options).features(&scan, &mut features).map(|()| features)
    });
    let features = features.map_err(|unusable| {
        error(py, Class::Input, format!("no features can be computed from this scan: {unusable}"))
    })?;
    Ok(PyArray1::from_vec(py, features))
}
