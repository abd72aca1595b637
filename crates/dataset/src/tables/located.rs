//! The table that `locate` writes.

use std::path::Path;
use std::sync::Arc;

use arrow_array::types::{Float64Type, Int64Type, UInt32Type};
use arrow_array::{Array, ArrayRef, Float64Array, Int64Array, UInt32Array};

use super::columns::Columns;
use super::types::{batch, covariance_columns, covariances, floats, scan_ids, strings};
use super::{Provenance, Result, read_table, write_table};
use crate::{LocatedPose, LocatedScan, LocatedState, Pose2};

/// Columns that are null where there is no pose.
const NULLABLE: [&str; 11] = [
    "map",
    "x_m",
    "y_m",
    "heading_rad",
    "cov_xx",
    "cov_xy",
    "cov_xh",
    "cov_yy",
    "cov_yh",
    "cov_hh",
    "confidence",
];

/// Writes `located.parquet`: one row per scan, in the order of the logs and of time.
pub fn write_located(path: &Path, provenance: &Provenance, rows: &[LocatedScan]) -> Result<()> {
    let number = |of: fn(&LocatedPose) -> f64| -> ArrayRef {
        let values = rows.iter().map(|row| row.position.as_ref().map(of));
        Arc::new(values.collect::<Float64Array>())
    };
    let maps = rows.iter().map(|row| row.position.as_ref().map(|p| p.map)).collect::<UInt32Array>();
    let scans = UInt32Array::from_iter_values(rows.iter().map(|row| row.id.scan));
    let stamps = Int64Array::from_iter_values(rows.iter().map(|row| row.stamp_ns));
    let mut columns: Vec<(&str, ArrayRef)> = vec![
        ("log", strings(rows.iter().map(|row| &*row.id.log))),
        ("scan", Arc::new(scans)),
        ("stamp_ns", Arc::new(stamps)),
        ("travel_m", floats(rows.iter().map(|row| row.travel_m))),
        ("state", strings(rows.iter().map(|row| row.state.name()))),
        ("map", Arc::new(maps)),
        ("x_m", number(|p| p.pose.x_m)),
        ("y_m", number(|p| p.pose.y_m)),
        ("heading_rad", number(|p| p.pose.heading_rad)),
    ];
    columns.extend(covariance_columns(rows.iter().map(|r| r.position.map(|p| p.covariance))));
    columns.push(("confidence", number(|p| p.confidence)));
    write_table(path, "located", provenance, &batch(columns, &NULLABLE))
}

/// Reads `located.parquet`.
pub fn read_located(path: &Path) -> Result<(Vec<LocatedScan>, Provenance)> {
    let (batch, provenance) = read_table(path, "located")?;
    let columns = Columns::new(path, &batch);
    let ids = scan_ids(&columns, "log", "scan")?;
    let stamps = columns.numbers::<Int64Type>("stamp_ns")?;
    let travel = columns.numbers::<Float64Type>("travel_m")?;
    let states = columns.strings("state")?;
    let maps = columns.nullable_numbers::<UInt32Type>("map")?;
    let [x, y, heading, confidence] = ["x_m", "y_m", "heading_rad", "confidence"]
        .map(|name| columns.nullable_numbers::<Float64Type>(name));
    let (x, y, heading, confidence) = (x?, y?, heading?, confidence?);
    let covariances = covariances(&columns)?;
    let rows = ids.into_iter().enumerate().map(|(row, id)| {
        let name = states.value(row);
        let state = LocatedState::ALL.into_iter().find(|state| state.name() == name);
        let state = state.ok_or_else(|| {
            columns.error("state", "searching, located or lost", format!("`{name}`"))
        })?;
        let position = covariances[row].filter(|_| maps.is_valid(row)).map(|covariance| {
            let pose =
                Pose2 { x_m: x.value(row), y_m: y.value(row), heading_rad: heading.value(row) };
            LocatedPose {
                map: maps.value(row),
                pose,
                covariance,
                confidence: confidence.value(row),
            }
        });
        let (stamp_ns, travel_m) = (stamps.value(row), travel.value(row));
        Ok(LocatedScan { id, stamp_ns, travel_m, state, position })
    });
    Ok((rows.collect::<Result<_>>()?, provenance))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ScanId;

    #[test]
    fn a_table_is_read_as_it_was_written() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("located.parquet");
        let row = |scan: u32, state, position| LocatedScan {
            id: ScanId { log: "monday".into(), scan },
            stamp_ns: 100 * i64::from(scan),
            travel_m: 0.5 * f64::from(scan),
            state,
            position,
        };
        let position = LocatedPose {
            map: 2,
            pose: Pose2 { x_m: 1.0, y_m: -2.0, heading_rad: 0.5 },
            covariance: [1.0, 0.1, 0.2, 2.0, 0.3, 3.0],
            confidence: 0.75,
        };
        let rows = [
            row(0, LocatedState::Searching, None),
            row(1, LocatedState::Located, Some(position)),
            row(2, LocatedState::Lost, None),
        ];
        let made = Provenance { program_version: "1".to_owned(), ..Provenance::default() };
        write_located(&path, &made, &rows).unwrap();
        assert_eq!(read_located(&path).unwrap(), (rows.to_vec(), made));
    }
}
