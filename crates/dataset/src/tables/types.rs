//! The tables that are read and written as a whole: poses, keyframes, pairs, features.

use std::collections::{BTreeSet, HashMap};
use std::path::Path;
use std::sync::Arc;

use arrow_array::types::{Float32Type, Float64Type, Int8Type, Int64Type, UInt32Type};
use arrow_array::{
    Array, ArrayRef, Float32Array, Float64Array, Int8Array, Int64Array, RecordBatch, StringArray,
    UInt32Array,
};
use arrow_schema::{DataType, Field, Schema};

use super::columns::Columns;
use super::file::{read_table_with, write_table_with};
use super::{Provenance, Result, TableError, read_table, write_table};
use crate::{Keyframe, Label, Pair, Pose2, ScanId, StampedPose, Trajectory};

/// A batch of named columns of the same length. The columns listed in `nullable` can contain nulls.
///
/// # Panics
/// If the columns differ in length, or if a column that is not in `nullable` contains a null.
pub fn batch(columns: Vec<(&str, ArrayRef)>, nullable: &[&str]) -> RecordBatch {
    let fields: Vec<Field> = columns
        .iter()
        .map(|(name, array)| Field::new(*name, array.data_type().clone(), nullable.contains(name)))
        .collect();
    let arrays = columns.into_iter().map(|(_, array)| array).collect();
    RecordBatch::try_new(Arc::new(Schema::new(fields)), arrays)
        .expect("columns have the same length and no unexpected nulls")
}

/// A column of strings.
pub fn strings<'a>(values: impl Iterator<Item = &'a str>) -> ArrayRef {
    Arc::new(values.map(Some).collect::<StringArray>())
}

/// A column of f64.
pub fn floats(values: impl Iterator<Item = f64>) -> ArrayRef {
    Arc::new(Float64Array::from_iter_values(values))
}

/// Columns of the covariance of a pose. They are null if the covariance is not known.
pub(super) const COVARIANCE: [&str; 6] =
    ["cov_xx", "cov_xy", "cov_xh", "cov_yy", "cov_yh", "cov_hh"];

/// Columns of poses and keyframes that can contain nulls.
const NULLABLE: [&str; 8] =
    ["cov_xx", "cov_xy", "cov_xh", "cov_yy", "cov_yh", "cov_hh", "z_m", "map"];

/// The key in the metadata of a poses table with the name of the frame of the poses.
const FRAME_ID: &str = "frame_id";

/// Writes `poses/<log>.parquet`: the stamp, the pose, the upper triangle of the covariance of x, y
/// and heading \[m^2, m rad, rad^2\], the height, the segment and the frame. The metadata contain the
/// name of the frame in the log, as `loopboost.frame_id`.
pub fn write_poses(
    path: &Path,
    provenance: &Provenance,
    log: &str,
    trajectory: &Trajectory,
) -> Result<()> {
    let frame_id: Vec<(&str, &str)> =
        trajectory.frame_id().into_iter().map(|name| (FRAME_ID, name)).collect();
    write_table_with(path, "poses", provenance, &pose_batch(log, trajectory), &frame_id)
}

/// The poses of a log as rows of that table, without a file.
pub fn pose_batch(log: &str, trajectory: &Trajectory) -> RecordBatch {
    let poses = trajectory.poses();
    let mut columns: Vec<(&str, ArrayRef)> = vec![
        ("log", strings(poses.iter().map(|_| log))),
        ("stamp_ns", Arc::new(Int64Array::from_iter_values(poses.iter().map(|p| p.stamp_ns)))),
        ("x_m", floats(poses.iter().map(|p| p.pose.x_m))),
        ("y_m", floats(poses.iter().map(|p| p.pose.y_m))),
        ("heading_rad", floats(poses.iter().map(|p| p.pose.heading_rad))),
    ];
    columns.extend(covariance_columns(poses.iter().map(|p| p.covariance)));
    columns.extend(segment_columns(poses.iter().map(|p| (p.z_m, p.segment, p.frame))));
    batch(columns, &NULLABLE)
}

/// Reads `poses/<log>.parquet`.
pub fn read_poses(path: &Path) -> Result<(Trajectory, Provenance)> {
    let (batch, provenance, frame_id) = read_table_with(path, "poses", FRAME_ID)?;
    let columns = Columns::new(path, &batch);
    let stamps = columns.numbers::<Int64Type>("stamp_ns")?;
    let x = columns.numbers::<Float64Type>("x_m")?;
    let y = columns.numbers::<Float64Type>("y_m")?;
    let heading = columns.numbers::<Float64Type>("heading_rad")?;
    let covariances = covariances(&columns)?;
    let heights = columns.nullable_numbers::<Float64Type>("z_m")?;
    let segments = columns.numbers::<UInt32Type>("segment")?;
    let frames = columns.numbers::<UInt32Type>("frame")?;
    let poses = (0..batch.num_rows())
        .map(|row| StampedPose {
            stamp_ns: stamps.value(row),
            pose: Pose2 { x_m: x.value(row), y_m: y.value(row), heading_rad: heading.value(row) },
            covariance: covariances[row],
            z_m: heights.is_valid(row).then(|| heights.value(row)),
            segment: segments.value(row),
            frame: frames.value(row),
        })
        .collect();
    Ok((Trajectory::new(poses).0.in_frame(frame_id), provenance))
}

/// The columns of covariances.
pub(super) fn covariance_columns(
    covariances: impl Iterator<Item = Option<[f64; 6]>> + Clone,
) -> impl Iterator<Item = (&'static str, ArrayRef)> {
    COVARIANCE.into_iter().enumerate().map(move |(k, name)| {
        let entry = covariances.clone().map(|covariance| covariance.map(|entries| entries[k]));
        (name, Arc::new(entry.collect::<Float64Array>()) as ArrayRef)
    })
}

fn segment_columns(
    rows: impl Iterator<Item = (Option<f64>, u32, u32)> + Clone,
) -> [(&'static str, ArrayRef); 3] {
    let numbers = |of: fn((Option<f64>, u32, u32)) -> u32| -> ArrayRef {
        Arc::new(UInt32Array::from_iter_values(rows.clone().map(of)))
    };
    let [segments, frames] = [numbers(|(_, segment, _)| segment), numbers(|(.., frame)| frame)];
    let heights = rows.map(|(z_m, ..)| z_m).collect::<Float64Array>();
    [("z_m", Arc::new(heights)), ("segment", segments), ("frame", frames)]
}

/// Reads the columns of covariances.
pub(super) fn covariances(columns: &Columns<'_>) -> Result<Vec<Option<[f64; 6]>>> {
    let entries = COVARIANCE
        .iter()
        .map(|name| columns.nullable_numbers::<Float64Type>(name))
        .collect::<Result<Vec<_>>>()?;
    let is_known = |row| entries.iter().all(|entry| entry.is_valid(row));
    let of_row = |row| is_known(row).then(|| std::array::from_fn(|k| entries[k].value(row)));
    Ok((0..entries[0].len()).map(of_row).collect())
}

/// Writes `keyframes/<log>.parquet`.
pub fn write_keyframes(path: &Path, provenance: &Provenance, keyframes: &[Keyframe]) -> Result<()> {
    let mut columns: Vec<(&str, ArrayRef)> = vec![
        ("log", strings(keyframes.iter().map(|k| &*k.id.log))),
        ("scan", Arc::new(UInt32Array::from_iter_values(keyframes.iter().map(|k| k.id.scan)))),
        ("stamp_ns", Arc::new(Int64Array::from_iter_values(keyframes.iter().map(|k| k.stamp_ns)))),
        ("x_m", floats(keyframes.iter().map(|k| k.pose.x_m))),
        ("y_m", floats(keyframes.iter().map(|k| k.pose.y_m))),
        ("heading_rad", floats(keyframes.iter().map(|k| k.pose.heading_rad))),
        ("travel_m", floats(keyframes.iter().map(|k| k.travel_m))),
        (
            "coverage_deg",
            Arc::new(Float32Array::from_iter_values(keyframes.iter().map(|k| k.coverage_deg))),
        ),
        ("site", strings(keyframes.iter().map(|k| &*k.site))),
    ];
    columns.extend(covariance_columns(keyframes.iter().map(|k| k.covariance)));
    columns.extend(segment_columns(keyframes.iter().map(|k| (k.z_m, k.segment, k.frame))));
    columns.push(("map", Arc::new(keyframes.iter().map(|k| k.map).collect::<UInt32Array>())));
    write_table(path, "keyframes", provenance, &batch(columns, &NULLABLE))
}

/// Reads `keyframes/<log>.parquet`.
pub fn read_keyframes(path: &Path) -> Result<(Vec<Keyframe>, Provenance)> {
    let (batch, provenance) = read_table(path, "keyframes")?;
    let columns = Columns::new(path, &batch);
    let ids = scan_ids(&columns, "log", "scan")?;
    let stamps = columns.numbers::<Int64Type>("stamp_ns")?;
    let x = columns.numbers::<Float64Type>("x_m")?;
    let y = columns.numbers::<Float64Type>("y_m")?;
    let heading = columns.numbers::<Float64Type>("heading_rad")?;
    let travel = columns.numbers::<Float64Type>("travel_m")?;
    let coverage = columns.numbers::<Float32Type>("coverage_deg")?;
    let sites = columns.strings("site")?;
    let covariances = covariances(&columns)?;
    let heights = columns.nullable_numbers::<Float64Type>("z_m")?;
    let segments = columns.numbers::<UInt32Type>("segment")?;
    let frames = columns.numbers::<UInt32Type>("frame")?;
    let maps = columns.nullable_numbers::<UInt32Type>("map")?;
    let mut names = Names::default();
    let keyframes = ids
        .into_iter()
        .enumerate()
        .map(|(row, id)| Keyframe {
            id,
            site: names.intern(sites.value(row)),
            stamp_ns: stamps.value(row),
            pose: Pose2 { x_m: x.value(row), y_m: y.value(row), heading_rad: heading.value(row) },
            covariance: covariances[row],
            z_m: heights.is_valid(row).then(|| heights.value(row)),
            segment: segments.value(row),
            frame: frames.value(row),
            map: maps.is_valid(row).then(|| maps.value(row)),
            travel_m: travel.value(row),
            coverage_deg: coverage.value(row),
        })
        .collect();
    Ok((keyframes, provenance))
}

/// Writes `pairs.parquet`.
pub fn write_pairs(
    path: &Path,
    provenance: &Provenance,
    keyframes: &[Keyframe],
    pairs: &[Pair],
) -> Result<()> {
    let log = |k: usize| &*keyframes[k].id.log;
    let scan = |k: usize| keyframes[k].id.scan;
    let columns: Vec<(&str, ArrayRef)> = vec![
        ("query_log", strings(pairs.iter().map(|p| log(p.query)))),
        (
            "query_scan",
            Arc::new(UInt32Array::from_iter_values(pairs.iter().map(|p| scan(p.query)))),
        ),
        ("reference_log", strings(pairs.iter().map(|p| log(p.reference)))),
        (
            "reference_scan",
            Arc::new(UInt32Array::from_iter_values(pairs.iter().map(|p| scan(p.reference)))),
        ),
        ("label", Arc::new(Int8Array::from_iter_values(pairs.iter().map(|p| p.label.sign())))),
        ("distance_m", floats(pairs.iter().map(|p| p.distance_m))),
        (
            "distance_std_m",
            Arc::new(pairs.iter().map(|p| p.distance_std_m).collect::<Float64Array>()),
        ),
        (
            "heading_difference_rad",
            Arc::new(pairs.iter().map(|p| p.heading_difference_rad).collect::<Float64Array>()),
        ),
        ("travel_gap_m", floats(pairs.iter().map(|p| p.travel_gap_m))),
    ];
    let nullable = ["distance_std_m", "heading_difference_rad"];
    write_table(path, "pairs", provenance, &batch(columns, &nullable))
}

/// Reads `pairs.parquet` and converts the scans to indices of `keyframes`.
pub fn read_pairs(path: &Path, keyframes: &[Keyframe]) -> Result<(Vec<Pair>, Provenance)> {
    let (batch, provenance) = read_table(path, "pairs")?;
    let columns = Columns::new(path, &batch);
    let index: HashMap<&ScanId, usize> =
        keyframes.iter().enumerate().map(|(k, keyframe)| (&keyframe.id, k)).collect();
    let row_error = |row, detail| TableError::Row { path: path.to_owned(), row, detail };
    let resolve = |ids: Vec<ScanId>| -> Result<Vec<usize>> {
        ids.iter()
            .enumerate()
            .map(|(row, id)| {
                index.get(id).copied().ok_or_else(|| {
                    let detail = format!("scan {} of log `{}` is not a keyframe", id.scan, id.log);
                    row_error(row, detail)
                })
            })
            .collect()
    };
    let queries = resolve(scan_ids(&columns, "query_log", "query_scan")?)?;
    let references = resolve(scan_ids(&columns, "reference_log", "reference_scan")?)?;
    let labels = columns.numbers::<Int8Type>("label")?;
    let distances = columns.numbers::<Float64Type>("distance_m")?;
    let deviations = columns.nullable_numbers::<Float64Type>("distance_std_m")?;
    let headings = columns.nullable_numbers::<Float64Type>("heading_difference_rad")?;
    let gaps = columns.numbers::<Float64Type>("travel_gap_m")?;
    let pairs = (0..batch.num_rows())
        .map(|row| {
            Ok(Pair {
                query: queries[row],
                reference: references[row],
                label: Label::from_sign(labels.value(row)).ok_or_else(|| {
                    row_error(row, format!("label {}, expected 1 or -1", labels.value(row)))
                })?,
                distance_m: distances.value(row),
                distance_std_m: deviations.is_valid(row).then(|| deviations.value(row)),
                heading_difference_rad: headings.is_valid(row).then(|| headings.value(row)),
                travel_gap_m: gaps.value(row),
            })
        })
        .collect::<Result<_>>()?;
    Ok((pairs, provenance))
}

/// The features of keyframes, one row per keyframe.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct FeatureTable {
    /// Names of the features, `(n_features,)`.
    pub names: Vec<String>,
    /// The keyframe of each row, `(n_rows,)`.
    pub ids: Vec<ScanId>,
    /// Row-major values, `(n_rows, n_features)`.
    pub values: Vec<f64>,
}

impl FeatureTable {
    /// The features of one row.
    pub fn row(&self, row: usize) -> &[f64] {
        &self.values[row * self.names.len()..][..self.names.len()]
    }
}

/// Writes `features/<log>.parquet`.
pub fn write_features(path: &Path, provenance: &Provenance, table: &FeatureTable) -> Result<()> {
    let n = table.names.len();
    let mut columns: Vec<(&str, ArrayRef)> = vec![
        ("log", strings(table.ids.iter().map(|id| &*id.log))),
        ("scan", Arc::new(UInt32Array::from_iter_values(table.ids.iter().map(|id| id.scan)))),
    ];
    for (feature, name) in table.names.iter().enumerate() {
        columns.push((name, floats(table.values.iter().skip(feature).step_by(n).copied())));
    }
    write_table(path, "features", provenance, &batch(columns, &[]))
}

/// Reads `features/<log>.parquet`.
pub fn read_features(path: &Path) -> Result<(FeatureTable, Provenance)> {
    let (batch, provenance) = read_table(path, "features")?;
    let columns = Columns::new(path, &batch);
    let ids = scan_ids(&columns, "log", "scan")?;
    let names: Vec<String> = batch
        .schema()
        .fields()
        .iter()
        .filter(|field| *field.data_type() == DataType::Float64)
        .map(|field| field.name().clone())
        .collect();
    let arrays = names
        .iter()
        .map(|name| columns.numbers::<Float64Type>(name))
        .collect::<Result<Vec<_>>>()?;
    let values =
        (0..ids.len()).flat_map(|row| arrays.iter().map(move |array| array.value(row))).collect();
    Ok((FeatureTable { names, ids, values }, provenance))
}

/// Reads the two columns that identify a scan.
pub(super) fn scan_ids(columns: &Columns<'_>, log: &str, scan: &str) -> Result<Vec<ScanId>> {
    let logs = columns.strings(log)?;
    let scans = columns.numbers::<UInt32Type>(scan)?;
    let mut names = Names::default();
    Ok((0..logs.len())
        .map(|row| ScanId { log: names.intern(logs.value(row)), scan: scans.value(row) })
        .collect())
}

/// Stores each distinct name once and shares the allocation.
#[derive(Default)]
pub(super) struct Names(BTreeSet<Arc<str>>);

impl Names {
    pub(super) fn intern(&mut self, name: &str) -> Arc<str> {
        if let Some(known) = self.0.get(name) {
            return known.clone();
        }
        let name: Arc<str> = name.into();
        self.0.insert(name.clone());
        name
    }
}
