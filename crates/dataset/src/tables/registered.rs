//! The tables of poses that `register` and `optimize` write.

use std::path::Path;
use std::sync::Arc;

use arrow_array::types::{Float64Type, Int64Type, UInt32Type};
use arrow_array::{
    Array, ArrayRef, BooleanArray, Float64Array, Int64Array, RecordBatch, UInt32Array,
};

use super::columns::Columns;
use super::types::{COVARIANCE, batch, covariance_columns, covariances, floats, scan_ids, strings};
use super::{Provenance, Result, read_table, write_table};
use crate::{MapPose, Pose2, RegisteredScan};

/// Columns that can contain nulls.
const NULLABLE: [&str; 7] =
    ["cov_xx", "cov_xy", "cov_xh", "cov_yy", "cov_yh", "cov_hh", "weakness"];

/// Writes `registered/<log>.parquet`: one row per registered scan, keyframes included.
pub fn write_registered(
    path: &Path,
    provenance: &Provenance,
    rows: &[RegisteredScan],
) -> Result<()> {
    let mut columns = registered_columns(rows);
    let keyframes = rows.iter().map(|r| Some(r.is_keyframe)).collect::<BooleanArray>();
    columns.push(("keyframe", Arc::new(keyframes)));
    write_table(path, "registered", provenance, &batch(columns, &NULLABLE))
}

/// Reads `registered/<log>.parquet`.
pub fn read_registered(path: &Path) -> Result<(Vec<RegisteredScan>, Provenance)> {
    let (batch, provenance) = read_table(path, "registered")?;
    let keyframes =
        Columns::new(path, &batch).booleans("keyframe")?.iter().map(Option::unwrap_or_default);
    let mut rows = registered_rows(path, &batch)?;
    rows.iter_mut().zip(keyframes).for_each(|(row, is_keyframe)| row.is_keyframe = is_keyframe);
    Ok((rows, provenance))
}

/// Writes `odometry/<log>.parquet`: one row per keyframe, with its pose by scan matching.
pub fn write_odometry(path: &Path, provenance: &Provenance, rows: &[RegisteredScan]) -> Result<()> {
    write_table(path, "odometry", provenance, &batch(registered_columns(rows), &NULLABLE))
}

/// Reads `odometry/<log>.parquet`.
pub fn read_odometry(path: &Path) -> Result<(Vec<RegisteredScan>, Provenance)> {
    let (batch, provenance) = read_table(path, "odometry")?;
    let mut rows = registered_rows(path, &batch)?;
    rows.iter_mut().for_each(|row| row.is_keyframe = true);
    Ok((rows, provenance))
}

/// The columns of registered scans, without `keyframe`.
fn registered_columns(rows: &[RegisteredScan]) -> Vec<(&'static str, ArrayRef)> {
    let numbers = |of: fn(&RegisteredScan) -> f64| floats(rows.iter().map(of));
    let counts = |of: fn(&RegisteredScan) -> u32| -> ArrayRef {
        Arc::new(UInt32Array::from_iter_values(rows.iter().map(of)))
    };
    let mut columns: Vec<(&str, ArrayRef)> = vec![
        ("log", strings(rows.iter().map(|r| &*r.id.log))),
        ("scan", counts(|r| r.id.scan)),
        ("stamp_ns", Arc::new(Int64Array::from_iter_values(rows.iter().map(|r| r.stamp_ns)))),
        ("x_m", numbers(|r| r.pose.x_m)),
        ("y_m", numbers(|r| r.pose.y_m)),
        ("heading_rad", numbers(|r| r.pose.heading_rad)),
    ];
    columns.extend(covariance_columns(rows.iter().map(|r| r.covariance)));
    let weakness = rows.iter().map(|r| r.weakness).collect::<Float64Array>();
    let degenerate = rows.iter().map(|r| Some(r.is_degenerate)).collect::<BooleanArray>();
    columns.extend([
        ("odometry_x_m", numbers(|r| r.odometry.x_m)),
        ("odometry_y_m", numbers(|r| r.odometry.y_m)),
        ("odometry_heading_rad", numbers(|r| r.odometry.heading_rad)),
        ("near_share", numbers(|r| r.near_share)),
        ("weakness", Arc::new(weakness) as ArrayRef),
        ("degenerate", Arc::new(degenerate)),
        ("segment", counts(|r| r.segment)),
        ("travel_m", numbers(|r| r.travel_m)),
    ]);
    columns
}

/// The rows of a table of registered scans. None of them is marked as a keyframe.
fn registered_rows(path: &Path, batch: &RecordBatch) -> Result<Vec<RegisteredScan>> {
    let columns = Columns::new(path, batch);
    let ids = scan_ids(&columns, "log", "scan")?;
    let stamps = columns.numbers::<Int64Type>("stamp_ns")?;
    let poses = poses(&columns, ["x_m", "y_m", "heading_rad"])?;
    let odometry = self::poses(&columns, ["odometry_x_m", "odometry_y_m", "odometry_heading_rad"])?;
    let covariances = covariances(&columns)?;
    let near_shares = columns.numbers::<Float64Type>("near_share")?;
    let weakness = columns.nullable_numbers::<Float64Type>("weakness")?;
    let degenerate = columns.booleans("degenerate")?;
    let segments = columns.numbers::<UInt32Type>("segment")?;
    let travel = columns.numbers::<Float64Type>("travel_m")?;
    let rows = ids.into_iter().enumerate().map(|(row, id)| RegisteredScan {
        id,
        stamp_ns: stamps.value(row),
        pose: poses[row],
        covariance: covariances[row],
        odometry: odometry[row],
        near_share: near_shares.value(row),
        weakness: weakness.is_valid(row).then(|| weakness.value(row)),
        is_degenerate: degenerate.value(row),
        is_keyframe: false,
        segment: segments.value(row),
        travel_m: travel.value(row),
    });
    Ok(rows.collect())
}

/// The poses in three columns.
pub(super) fn poses(columns: &Columns<'_>, names: [&str; 3]) -> Result<Vec<Pose2>> {
    let [x, y, heading] = names.map(|name| columns.numbers::<Float64Type>(name));
    let (x, y, heading) = (x?, y?, heading?);
    let of_row =
        |row| Pose2 { x_m: x.value(row), y_m: y.value(row), heading_rad: heading.value(row) };
    Ok((0..x.len()).map(of_row).collect())
}

/// Writes `trajectory.parquet`: one row per keyframe, with its optimized pose.
pub fn write_trajectory(path: &Path, provenance: &Provenance, rows: &[MapPose]) -> Result<()> {
    let numbers = |of: fn(&MapPose) -> f64| floats(rows.iter().map(of));
    let counts = |of: fn(&MapPose) -> u32| -> ArrayRef {
        Arc::new(UInt32Array::from_iter_values(rows.iter().map(of)))
    };
    let mut columns: Vec<(&str, ArrayRef)> = vec![
        ("log", strings(rows.iter().map(|r| &*r.id.log))),
        ("scan", counts(|r| r.id.scan)),
        ("stamp_ns", Arc::new(Int64Array::from_iter_values(rows.iter().map(|r| r.stamp_ns)))),
        ("x_m", numbers(|r| r.pose.x_m)),
        ("y_m", numbers(|r| r.pose.y_m)),
        ("heading_rad", numbers(|r| r.pose.heading_rad)),
    ];
    columns.extend(covariance_columns(rows.iter().map(|r| r.covariance)));
    let degenerate = rows.iter().map(|r| Some(r.is_degenerate)).collect::<BooleanArray>();
    columns.extend([
        ("degenerate", Arc::new(degenerate) as ArrayRef),
        ("segment", counts(|r| r.segment)),
        ("travel_m", numbers(|r| r.travel_m)),
        ("map", counts(|r| r.map)),
    ]);
    write_table(path, "trajectory", provenance, &batch(columns, &COVARIANCE))
}

/// Reads `trajectory.parquet`.
pub fn read_trajectory(path: &Path) -> Result<(Vec<MapPose>, Provenance)> {
    let (batch, provenance) = read_table(path, "trajectory")?;
    let columns = Columns::new(path, &batch);
    let ids = scan_ids(&columns, "log", "scan")?;
    let stamps = columns.numbers::<Int64Type>("stamp_ns")?;
    let poses = poses(&columns, ["x_m", "y_m", "heading_rad"])?;
    let covariances = covariances(&columns)?;
    let degenerate = columns.booleans("degenerate")?;
    let segments = columns.numbers::<UInt32Type>("segment")?;
    let travel = columns.numbers::<Float64Type>("travel_m")?;
    let maps = columns.numbers::<UInt32Type>("map")?;
    let rows = ids.into_iter().enumerate().map(|(row, id)| MapPose {
        id,
        stamp_ns: stamps.value(row),
        pose: poses[row],
        covariance: covariances[row],
        is_degenerate: degenerate.value(row),
        segment: segments.value(row),
        travel_m: travel.value(row),
        map: maps.value(row),
    });
    Ok((rows.collect(), provenance))
}
