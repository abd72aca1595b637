//! The tables of closures: those that `detect` finds, and those that `optimize` accepts and rejects.

use std::path::Path;
use std::sync::Arc;

use arrow_array::types::{Float64Type, UInt32Type};
use arrow_array::{
    Array, ArrayRef, BooleanArray, Float64Array, RecordBatch, StringArray, UInt32Array,
};

use super::columns::Columns;
use super::registered::poses;
use super::types::{batch, covariance_columns, covariances, floats, scan_ids, strings};
use super::{Provenance, Result, TableError, read_table, write_table};
use crate::{CandidateClosure, JudgedClosure, ScanClosure, ScanId};

/// Writes `candidates.parquet`: one row per pair of places that may be the same.
pub fn write_candidates(
    path: &Path,
    provenance: &Provenance,
    rows: &[CandidateClosure],
) -> Result<()> {
    let mut columns = closure_columns(&rows.iter().map(|row| &row.closure));
    columns.push(("rank", Arc::new(UInt32Array::from_iter_values(rows.iter().map(|r| r.rank)))));
    write_table(path, "candidates", provenance, &batch(columns, &["classifier"]))
}

/// Reads `candidates.parquet`.
pub fn read_candidates(path: &Path) -> Result<(Vec<CandidateClosure>, Provenance)> {
    let (table, provenance) = read_table(path, "candidates")?;
    let ranks = Columns::new(path, &table).numbers::<UInt32Type>("rank")?;
    let closures = closure_rows(path, &table)?.into_iter().zip(ranks.values());
    let rows = closures.map(|(closure, &rank)| CandidateClosure { closure, rank }).collect();
    Ok((rows, provenance))
}

/// Writes `closures.parquet`: one row per closure that was accepted or rejected.
pub fn write_closures(path: &Path, provenance: &Provenance, rows: &[JudgedClosure]) -> Result<()> {
    let mut columns = closure_columns(&rows.iter().map(|row| &row.closure));
    let accepted = rows.iter().map(|row| Some(row.is_accepted())).collect::<BooleanArray>();
    let reasons = rows.iter().map(|row| row.rejected.as_deref()).collect::<StringArray>();
    columns.push(("accepted", Arc::new(accepted)));
    columns.push(("reason", Arc::new(reasons)));
    write_table(path, "closures", provenance, &batch(columns, &["classifier", "reason"]))
}

/// Reads `closures.parquet`. A closure has a reason if, and only if, it was rejected.
pub fn read_closures(path: &Path) -> Result<(Vec<JudgedClosure>, Provenance)> {
    let (table, provenance) = read_table(path, "closures")?;
    let columns = Columns::new(path, &table);
    let accepted = columns.booleans("accepted")?;
    let reasons = columns.nullable_strings("reason")?;
    let judge = |(row, closure)| {
        let rejected = reasons.is_valid(row).then(|| reasons.value(row).to_owned());
        match accepted.value(row) == rejected.is_none() {
            true => Ok(JudgedClosure { closure, rejected }),
            false => Err(TableError::Row {
                path: path.to_owned(),
                row,
                detail: "expected a `reason` for a rejected closure, and none for an accepted one"
                    .to_owned(),
            }),
        }
    };
    let rows = closure_rows(path, &table)?.into_iter().enumerate().map(judge);
    Ok((rows.collect::<Result<_>>()?, provenance))
}

/// The columns of closures.
fn closure_columns<'a>(
    rows: &(impl Iterator<Item = &'a ScanClosure> + Clone),
) -> Vec<(&'static str, ArrayRef)> {
    let numbers = |of: fn(&ScanClosure) -> f64| floats(rows.clone().map(of));
    let counts = |of: fn(&ScanClosure) -> u32| -> ArrayRef {
        Arc::new(UInt32Array::from_iter_values(rows.clone().map(of)))
    };
    let names = |of: fn(&ScanClosure) -> &ScanId| strings(rows.clone().map(move |r| &*of(r).log));
    let mut columns: Vec<(&str, ArrayRef)> = vec![
        ("query_log", names(|r| &r.query)),
        ("query_scan", counts(|r| r.query.scan)),
        ("reference_log", names(|r| &r.reference)),
        ("reference_scan", counts(|r| r.reference.scan)),
        ("dx_m", numbers(|r| r.reference_from_query.x_m)),
        ("dy_m", numbers(|r| r.reference_from_query.y_m)),
        ("dheading_rad", numbers(|r| r.reference_from_query.heading_rad)),
    ];
    columns.extend(covariance_columns(rows.clone().map(|r| Some(r.covariance))));
    let classifier = rows.clone().map(|r| r.classifier).collect::<Float64Array>();
    let degenerate = rows.clone().map(|r| Some(r.is_degenerate)).collect::<BooleanArray>();
    columns.extend([
        ("confidence", numbers(|r| r.confidence)),
        ("overlap", numbers(|r| r.overlap)),
        ("known_overlap", numbers(|r| r.known_overlap)),
        ("n_known", counts(|r| r.n_known)),
        ("conflict", numbers(|r| r.conflict)),
        ("margin", numbers(|r| r.margin)),
        ("weakness", numbers(|r| r.weakness)),
        ("classifier", Arc::new(classifier) as ArrayRef),
        ("degenerate", Arc::new(degenerate)),
    ]);
    columns
}

/// The rows of a table of closures.
fn closure_rows(path: &Path, table: &RecordBatch) -> Result<Vec<ScanClosure>> {
    let columns = Columns::new(path, table);
    let queries = scan_ids(&columns, "query_log", "query_scan")?;
    let references = scan_ids(&columns, "reference_log", "reference_scan")?;
    let relative = poses(&columns, ["dx_m", "dy_m", "dheading_rad"])?;
    let covariances = covariances(&columns)?;
    let number = |name| columns.numbers::<Float64Type>(name);
    let (confidence, overlap) = (number("confidence")?, number("overlap")?);
    let (known_overlap, conflict) = (number("known_overlap")?, number("conflict")?);
    let (margin, weakness) = (number("margin")?, number("weakness")?);
    let n_known = columns.numbers::<UInt32Type>("n_known")?;
    let classifier = columns.nullable_numbers::<Float64Type>("classifier")?;
    let degenerate = columns.booleans("degenerate")?;
    let rows = queries.into_iter().zip(references).enumerate();
    rows.map(|(row, (query, reference))| {
        let covariance = covariances[row].ok_or_else(|| TableError::Row {
            path: path.to_owned(),
            row,
            detail: "no covariance, expected the covariance of the closure".to_owned(),
        })?;
        Ok(ScanClosure {
            query,
            reference,
            reference_from_query: relative[row],
            covariance,
            confidence: confidence.value(row),
            overlap: overlap.value(row),
            known_overlap: known_overlap.value(row),
            n_known: n_known.value(row),
            conflict: conflict.value(row),
            margin: margin.value(row),
            weakness: weakness.value(row),
            classifier: classifier.is_valid(row).then(|| classifier.value(row)),
            is_degenerate: degenerate.value(row),
        })
    })
    .collect()
}
