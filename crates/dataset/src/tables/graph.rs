//! `graph.parquet`: the pose graph, with the names of its scans.

use std::path::Path;
use std::sync::Arc;

use arrow_array::{ArrayRef, UInt32Array};

use super::columns::Columns;
use super::registered::poses;
use super::scan_pairs::SCAN_PAIR_COLUMNS;
use super::types::{batch, covariance_columns, covariances, floats, scan_ids, strings};
use super::{Provenance, Result, TableError, read_table, write_table};
use crate::{GraphEdge, ScanId};

/// Columns of the relative pose.
const POSE: [&str; 3] = ["dx_m", "dy_m", "dheading_rad"];

/// Writes `graph.parquet`: one row per edge of the pose graph.
pub fn write_graph(path: &Path, provenance: &Provenance, edges: &[GraphEdge]) -> Result<()> {
    let logs = |of: fn(&GraphEdge) -> &ScanId| strings(edges.iter().map(move |e| &*of(e).log));
    let scans = |of: fn(&GraphEdge) -> &ScanId| -> ArrayRef {
        Arc::new(UInt32Array::from_iter_values(edges.iter().map(|edge| of(edge).scan)))
    };
    let numbers = |of: fn(&GraphEdge) -> f64| floats(edges.iter().map(of));
    let [query_log, query_scan, reference_log, reference_scan] = SCAN_PAIR_COLUMNS;
    let [x, y, heading] = POSE;
    let mut columns: Vec<(&str, ArrayRef)> = vec![
        (query_log, logs(|edge| &edge.query)),
        (query_scan, scans(|edge| &edge.query)),
        (reference_log, logs(|edge| &edge.reference)),
        (reference_scan, scans(|edge| &edge.reference)),
        (x, numbers(|edge| edge.reference_from_query.x_m)),
        (y, numbers(|edge| edge.reference_from_query.y_m)),
        (heading, numbers(|edge| edge.reference_from_query.heading_rad)),
    ];
    columns.extend(covariance_columns(edges.iter().map(|edge| Some(edge.covariance))));
    write_table(path, "graph", provenance, &batch(columns, &[]))
}

/// Reads `graph.parquet`.
pub fn read_graph(path: &Path) -> Result<(Vec<GraphEdge>, Provenance)> {
    let (table, provenance) = read_table(path, "graph")?;
    let columns = Columns::new(path, &table);
    let [query_log, query_scan, reference_log, reference_scan] = SCAN_PAIR_COLUMNS;
    let queries = scan_ids(&columns, query_log, query_scan)?;
    let references = scan_ids(&columns, reference_log, reference_scan)?;
    let poses = poses(&columns, POSE)?;
    let covariances = covariances(&columns)?;
    let edges = queries.into_iter().zip(references).zip(poses).zip(covariances).enumerate().map(
        |(row, (((query, reference), reference_from_query), covariance))| {
            let covariance = covariance.ok_or_else(|| TableError::Row {
                path: path.to_owned(),
                row,
                detail: "expected a covariance".to_owned(),
            })?;
            Ok(GraphEdge { reference, query, reference_from_query, covariance })
        },
    );
    Ok((edges.collect::<Result<_>>()?, provenance))
}
