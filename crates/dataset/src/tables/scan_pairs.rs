//! Pairs of scans from any program, and their scores.

use std::fs::File;
use std::path::Path;
use std::sync::Arc;

use arrow_array::cast::AsArray;
use arrow_array::types::{Int32Type, Int64Type, UInt32Type, UInt64Type};
use arrow_array::{ArrayRef, Float64Array, Int8Array, UInt32Array};
use arrow_schema::DataType;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;

use super::columns::Columns;
use super::file::{read_error, unreadable};
use super::types::{Names, batch, strings};
use super::{Provenance, Result, write_table};
use crate::ScanId;

/// The columns that name a pair of scans, in any Parquet table.
pub const SCAN_PAIR_COLUMNS: [&str; 4] =
    ["query_log", "query_scan", "reference_log", "reference_scan"];

/// The score of a pair of scans.
#[derive(Debug, Clone, PartialEq)]
pub struct PairScore {
    /// Query and reference.
    pub scans: [ScanId; 2],
    /// Confidence of the classifier. `None` if one of the scans has no features.
    pub confidence: Option<f64>,
    /// 1 if the confidence is at least the threshold, else -1.
    pub label: Option<i8>,
}

/// Reads pairs of scans from a Parquet table, which can be of any program: the columns
/// [`SCAN_PAIR_COLUMNS`], with names of logs as strings and numbers of scans as integers.
pub fn read_scan_pairs(path: &Path) -> Result<Vec<[ScanId; 2]>> {
    let file = File::open(path).map_err(|source| read_error(path, source))?;
    let reader = ParquetRecordBatchReaderBuilder::try_new(file)
        .and_then(ParquetRecordBatchReaderBuilder::build)
        .map_err(|e| unreadable(path, e))?;
    let mut names = Names::default();
    let mut pairs = Vec::new();
    for batch in reader {
        let batch = batch.map_err(|e| unreadable(path, e))?;
        let columns = Columns::new(path, &batch);
        let [query_log, query_scan, reference_log, reference_scan] = SCAN_PAIR_COLUMNS;
        let [query_logs, reference_logs] =
            [query_log, reference_log].map(|name| texts(&columns, name));
        let [query_scans, reference_scans] =
            [query_scan, reference_scan].map(|name| scan_numbers(&columns, name));
        let queries = query_logs?.into_iter().zip(query_scans?);
        let references = reference_logs?.into_iter().zip(reference_scans?);
        for ((query_log, query), (reference_log, reference)) in queries.zip(references) {
            pairs.push([
                ScanId { log: names.intern(query_log), scan: query },
                ScanId { log: names.intern(reference_log), scan: reference },
            ]);
        }
    }
    Ok(pairs)
}

fn texts<'a>(columns: &Columns<'a>, name: &str) -> Result<Vec<&'a str>> {
    let column = columns.column(name)?;
    if 0 < column.null_count() {
        return Err(columns.error(name, "no nulls", format!("{} nulls", column.null_count())));
    }
    match column.data_type() {
        DataType::Utf8 => Ok(column.as_string::<i32>().iter().flatten().collect()),
        DataType::LargeUtf8 => Ok(column.as_string::<i64>().iter().flatten().collect()),
        DataType::Utf8View => Ok(column.as_string_view().iter().flatten().collect()),
        other => Err(columns.error(name, "a string column", other.to_string())),
    }
}

/// Numbers of scans, from integers of any width.
fn scan_numbers(columns: &Columns<'_>, name: &str) -> Result<Vec<u32>> {
    let column = columns.column(name)?;
    if 0 < column.null_count() {
        return Err(columns.error(name, "no nulls", format!("{} nulls", column.null_count())));
    }
    let numbers: Vec<i128> = match column.data_type() {
        DataType::UInt32 => {
            column.as_primitive::<UInt32Type>().values().iter().map(|&n| n.into()).collect()
        }
        DataType::UInt64 => {
            column.as_primitive::<UInt64Type>().values().iter().map(|&n| n.into()).collect()
        }
        DataType::Int32 => {
            column.as_primitive::<Int32Type>().values().iter().map(|&n| n.into()).collect()
        }
        DataType::Int64 => {
            column.as_primitive::<Int64Type>().values().iter().map(|&n| n.into()).collect()
        }
        other => return Err(columns.error(name, "an integer column", other.to_string())),
    };
    let number = |n: i128| {
        u32::try_from(n)
            .map_err(|_| columns.error(name, "numbers of scans, 0 or more", n.to_string()))
    };
    numbers.into_iter().map(number).collect()
}

/// Writes the scores of pairs of scans.
pub fn write_pair_scores(path: &Path, provenance: &Provenance, rows: &[PairScore]) -> Result<()> {
    let log = |which: usize| strings(rows.iter().map(move |row| &*row.scans[which].log));
    let scan = |which: usize| -> ArrayRef {
        Arc::new(UInt32Array::from_iter_values(rows.iter().map(|row| row.scans[which].scan)))
    };
    let [query_log, query_scan, reference_log, reference_scan] = SCAN_PAIR_COLUMNS;
    let confidences = rows.iter().map(|row| row.confidence).collect::<Float64Array>();
    let labels = rows.iter().map(|row| row.label).collect::<Int8Array>();
    let columns: Vec<(&str, ArrayRef)> = vec![
        (query_log, log(0)),
        (query_scan, scan(0)),
        (reference_log, log(1)),
        (reference_scan, scan(1)),
        ("confidence", Arc::new(confidences)),
        ("label", Arc::new(labels)),
    ];
    write_table(path, "pair_scores", provenance, &batch(columns, &["confidence", "label"]))
}
