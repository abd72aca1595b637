//! `evaluation/*.parquet` about loop closures, and trajectories for evo.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use arrow_array::{ArrayRef, BooleanArray, Float64Array, StringArray, UInt32Array, UInt64Array};
use dataset::tables::{Provenance, Result, batch, floats, strings, write_file, write_table};
use dataset::tum;

use super::calibration::Calibration;
use super::closures::Judged;
use super::input::{Drive, FoundClosure};
use super::measure::{AgainstTruth, DriveMeasures, PoseSource, TrajectoryErrors};
use super::revisits::RevisitCounts;
use super::trajectory::Drift;
use super::truth::Truth;

/// Writes the tables and trajectories to a folder and returns their paths. `drives` and `measures` have
/// the same order.
///
/// | table | a row is | columns |
/// |---|---|---|
/// | `detection` | a measure of a drive | `log`, `segment`, `measure`, `value` (null where it is not defined, such as an error without ground truth) |
/// | `closure_errors` | a closure | `log`, `segment`, `query_scan`, `reference_scan`, `confidence`, `accepted`, `reason` (null if accepted), and where the truth is known: `verdict` (`right`, `inexact`, `false`), `error_m`, `error_rad`, `distance_m` and `heading_difference_rad` (true, between the two keyframes) |
/// | `revisits` | a keyframe that comes back to a place | `log`, `segment`, `scan`, `opposite`, `retrieved`, `proposed`, `kept`, `closed_nearby`, `closed` |
/// | `trajectory_errors` | a trajectory of a drive | `log`, `segment`, `source` (`odometry`, `scan_matched`, `optimized_keyframes`, `optimized`), `poses`, `ate_rmse_m` |
/// | `drift` | a trajectory of a drive and a path length | `log`, `segment`, `source`, `path_m`, `pairs`, `rmse_m`, `median_m`, `rmse_rad`, `median_rad` |
/// | `candidate_curve` | a threshold on the confidence of candidates | `log`, `segment`, `threshold`, `precision`, `recall` |
///
/// `trajectories/<log>-<segment>/` contains the poses of each source and the measured truth at the stamps
/// of the scans, as TUM files.
pub fn write_detection(
    folder: &Path,
    provenance: &Provenance,
    drives: &[Drive<'_>],
    measures: &[DriveMeasures],
) -> Result<Vec<PathBuf>> {
    let tables = [
        detection(measures),
        closure_errors(drives, measures),
        revisits(drives, measures),
        trajectory_errors(measures),
        drift(measures),
        candidate_curve(measures),
    ];
    let mut written = Vec::new();
    for table in tables {
        let path = folder.join(format!("{}.parquet", table.name));
        write_table(&path, table.name, provenance, &batch(table.columns, table.nullable))?;
        written.push(path);
    }
    for drive in drives {
        let of_drive = folder.join("trajectories").join(format!("{}-{}", drive.log, drive.segment));
        let Some(truth) = drive.truth else { continue };
        let truth = Truth::new(truth, drive.scans);
        let measured = drive
            .scans
            .iter()
            .filter_map(|scan| Some((scan.stamp_ns, truth.measured_at(scan.stamp_ns)?)));
        let mut files = vec![("truth", tum(measured))];
        for source in PoseSource::ALL {
            files.push((source.name(), tum(source.poses(drive))));
        }
        for (name, text) in files {
            let path = of_drive.join(format!("{name}.tum"));
            write_file(&path, text.as_bytes())?;
            written.push(path);
        }
    }
    Ok(written)
}

struct Table {
    name: &'static str,
    columns: Vec<(&'static str, ArrayRef)>,
    /// Names of the columns that may contain null.
    nullable: &'static [&'static str],
}

/// The columns `log` and `segment`.
fn drive_columns<'a>(
    of: impl Iterator<Item = &'a DriveMeasures> + Clone,
) -> Vec<(&'static str, ArrayRef)> {
    vec![("log", strings(of.clone().map(|m| &*m.log))), ("segment", numbers(of.map(|m| m.segment)))]
}

fn numbers(values: impl Iterator<Item = u32>) -> ArrayRef {
    Arc::new(UInt32Array::from_iter_values(values))
}

fn counts(values: impl Iterator<Item = usize>) -> ArrayRef {
    Arc::new(UInt64Array::from_iter_values(values.map(|n| n as u64)))
}

fn optional_floats(values: impl Iterator<Item = Option<f64>>) -> ArrayRef {
    Arc::new(values.collect::<Float64Array>())
}

fn booleans(values: impl Iterator<Item = bool>) -> ArrayRef {
    Arc::new(values.map(Some).collect::<BooleanArray>())
}

fn detection(measures: &[DriveMeasures]) -> Table {
    let rows: Vec<(&DriveMeasures, String, Option<f64>)> = measures
        .iter()
        .flat_map(|m| scalars(m).into_iter().map(move |(name, value)| (m, name, value)))
        .collect();
    let mut columns = drive_columns(rows.iter().map(|(m, ..)| *m));
    columns.push(("measure", strings(rows.iter().map(|(_, name, _)| &**name))));
    columns.push(("value", optional_floats(rows.iter().map(|(.., value)| *value))));
    Table { name: "detection", columns, nullable: &["value"] }
}

/// All measures of a drive that are one number, with their names.
pub(crate) fn scalars(m: &DriveMeasures) -> Vec<(String, Option<f64>)> {
    let mut all = Vec::new();
    let mut add = |name: &str, value: Option<f64>| all.push((name.to_owned(), value));
    let count = |n: usize| Some(n as f64);
    add("n_scans", count(m.n_scans));
    add("n_keyframes", count(m.n_keyframes));
    add("path_m", Some(m.path_m));
    add("n_candidates", count(m.n_candidates));
    add("n_accepted", count(m.n_accepted));
    for rejected in &m.rejected {
        add(&format!("n_rejected_{}", rejected.reason), count(rejected.n));
    }
    if let Some(truth) = &m.truth {
        all.extend(scalars_of_truth(truth));
    }
    all
}

fn scalars_of_truth(truth: &AgainstTruth) -> Vec<(String, Option<f64>)> {
    let mut all = Vec::new();
    let mut add = |name: &str, value: Option<f64>| all.push((name.to_owned(), value));
    let count = |n: usize| Some(n as f64);
    add("n_keyframes_with_truth", count(truth.n_known));
    add("n_doubtful_truth", count(truth.n_doubtful));
    add("n_false_by_pose_with_doubtful_truth", count(truth.n_false_with_doubtful));
    let closures = &truth.closures;
    add("n_judged", count(closures.n_judged));
    add("n_false_by_pose", count(closures.n_false_by_pose));
    for (metres, n) in ["1.5", "3", "5"].into_iter().zip(closures.n_false_by_place) {
        add(&format!("n_beyond_{metres}_m"), count(n));
    }
    add("closure_median_m", closures.median_m);
    add("closure_p90_m", closures.p90_m);
    add("closure_mean_m", closures.mean_m);
    add("closure_median_deg", closures.median_deg);
    add("closure_p90_deg", closures.p90_deg);
    add("candidates_right", count(truth.candidates.n_right));
    add("candidates_inexact", count(truth.candidates.n_inexact));
    add("candidates_false", count(truth.candidates.n_false));
    let revisits = &truth.revisits;
    for (suffix, of) in [
        ("", &revisits.all),
        ("_same_direction", &revisits.same_direction),
        ("_opposite_direction", &revisits.opposite_direction),
    ] {
        for (name, n) in revisit_columns(of) {
            add(&format!("revisits{name}{suffix}"), count(n));
        }
        add(&format!("recall{suffix}"), of.recall());
    }
    for (name, calibration) in [
        ("closure_nees", &truth.closure_calibration),
        ("keyframe_nees", &truth.keyframe_calibration),
    ] {
        let value = |of: fn(&Calibration) -> f64| calibration.as_ref().map(of);
        add(&format!("{name}_mean"), value(|c| c.mean));
        add(&format!("{name}_low"), value(|c| c.low));
        add(&format!("{name}_high"), value(|c| c.high));
        add(&format!("{name}_factor"), value(|c| c.factor));
        add(&format!("{name}_median_factor"), value(|c| c.median_factor));
    }
    for trajectory in &truth.trajectories {
        add(&format!("ate_rmse_m_{}", trajectory.source.name()), trajectory.ate_rmse_m);
    }
    all
}

fn revisit_columns(of: &RevisitCounts) -> [(&'static str, usize); 6] {
    [
        ("", of.n),
        ("_retrieved", of.n_retrieved),
        ("_proposed", of.n_proposed),
        ("_kept", of.n_kept),
        ("_closed_nearby", of.n_closed_nearby),
        ("_closed", of.n_closed),
    ]
}

fn closure_errors(drives: &[Drive<'_>], measures: &[DriveMeasures]) -> Table {
    struct Row<'a> {
        drive: &'a Drive<'a>,
        measures: &'a DriveMeasures,
        closure: &'a FoundClosure<'a>,
        judged: Option<Judged>,
    }
    let rows: Vec<Row<'_>> = drives
        .iter()
        .zip(measures)
        .flat_map(|(drive, measures)| {
            let judged = move |k: usize| measures.truth.as_ref().and_then(|t| t.judged[k]);
            drive.closures.iter().enumerate().map(move |(k, closure)| Row {
                drive,
                measures,
                closure,
                judged: judged(k),
            })
        })
        .collect();
    let scan = |of: fn(&FoundClosure<'_>) -> usize| {
        numbers(rows.iter().map(|r| r.drive.keyframes[of(r.closure)].scan))
    };
    let value =
        |of: fn(&Judged) -> f64| optional_floats(rows.iter().map(|r| r.judged.as_ref().map(of)));
    let reasons = rows.iter().map(|r| r.closure.rejected);
    let verdicts = rows.iter().map(|r| r.judged.map(|j| j.verdict.name()));
    let mut columns = drive_columns(rows.iter().map(|r| r.measures));
    columns.extend([
        ("query_scan", scan(|c| c.query)),
        ("reference_scan", scan(|c| c.reference)),
        ("confidence", floats(rows.iter().map(|r| r.closure.confidence))),
        ("accepted", booleans(rows.iter().map(|r| r.closure.rejected.is_none()))),
        ("reason", Arc::new(reasons.collect::<StringArray>()) as ArrayRef),
        ("verdict", Arc::new(verdicts.collect::<StringArray>()) as ArrayRef),
        ("error_m", value(|j| j.error_m)),
        ("error_rad", value(|j| j.error_rad)),
        ("distance_m", value(|j| j.distance_m)),
        ("heading_difference_rad", value(|j| j.heading_difference_rad)),
    ]);
    Table {
        name: "closure_errors",
        columns,
        nullable: &[
            "reason",
            "verdict",
            "error_m",
            "error_rad",
            "distance_m",
            "heading_difference_rad",
        ],
    }
}

fn revisits(drives: &[Drive<'_>], measures: &[DriveMeasures]) -> Table {
    let rows = || {
        drives.iter().zip(measures).flat_map(|(drive, m)| {
            let revisits = m.truth.iter().flat_map(|truth| &truth.revisit);
            revisits.map(move |revisit| (drive, m, revisit))
        })
    };
    let mut columns = drive_columns(rows().map(|(_, m, _)| m).collect::<Vec<_>>().into_iter());
    columns.extend([
        ("scan", numbers(rows().map(|(drive, _, r)| drive.keyframes[r.keyframe].scan))),
        ("opposite", booleans(rows().map(|(.., r)| r.is_opposite))),
        ("retrieved", booleans(rows().map(|(.., r)| r.is_retrieved))),
        ("proposed", booleans(rows().map(|(.., r)| r.is_proposed))),
        ("kept", booleans(rows().map(|(.., r)| r.is_kept))),
        ("closed_nearby", booleans(rows().map(|(.., r)| r.is_closed_nearby))),
        ("closed", booleans(rows().map(|(.., r)| r.is_closed))),
    ]);
    Table { name: "revisits", columns, nullable: &[] }
}

/// The trajectories of all drives with ground truth.
fn trajectories<'a>(
    measures: &'a [DriveMeasures],
) -> Vec<(&'a DriveMeasures, &'a TrajectoryErrors)> {
    let of_drive = |m: &'a DriveMeasures| {
        m.truth.iter().flat_map(|truth| &truth.trajectories).map(move |t| (m, t))
    };
    measures.iter().flat_map(of_drive).collect()
}

fn trajectory_errors(measures: &[DriveMeasures]) -> Table {
    let rows = trajectories(measures);
    let mut columns = drive_columns(rows.iter().map(|(m, _)| *m));
    columns.extend([
        ("source", strings(rows.iter().map(|(_, t)| t.source.name()))),
        ("poses", counts(rows.iter().map(|(_, t)| t.n_poses))),
        ("ate_rmse_m", optional_floats(rows.iter().map(|(_, t)| t.ate_rmse_m))),
    ]);
    Table { name: "trajectory_errors", columns, nullable: &["ate_rmse_m"] }
}

fn drift(measures: &[DriveMeasures]) -> Table {
    let rows: Vec<(&DriveMeasures, PoseSource, &Drift)> = trajectories(measures)
        .into_iter()
        .flat_map(|(m, t)| t.drift.iter().map(move |d| (m, t.source, d)))
        .collect();
    let value = |of: fn(&Drift) -> f64| floats(rows.iter().map(|(.., d)| of(d)));
    let mut columns = drive_columns(rows.iter().map(|(m, ..)| *m));
    columns.extend([
        ("source", strings(rows.iter().map(|(_, source, _)| source.name()))),
        ("path_m", value(|d| d.path_m)),
        ("pairs", counts(rows.iter().map(|(.., d)| d.n_pairs))),
        ("rmse_m", value(|d| d.rmse_m)),
        ("median_m", value(|d| d.median_m)),
        ("rmse_rad", value(|d| d.rmse_rad)),
        ("median_rad", value(|d| d.median_rad)),
    ]);
    Table { name: "drift", columns, nullable: &[] }
}

fn candidate_curve(measures: &[DriveMeasures]) -> Table {
    let rows: Vec<_> = measures
        .iter()
        .flat_map(|m| m.truth.iter().flat_map(|t| &t.curve).map(move |p| (m, p)))
        .collect();
    let mut columns = drive_columns(rows.iter().map(|(m, _)| *m));
    columns.extend([
        ("threshold", floats(rows.iter().map(|(_, p)| p.threshold))),
        // At every point, at least one candidate has the confidence.
        ("precision", floats(rows.iter().map(|(_, p)| p.confusion.precision().unwrap_or(0.0)))),
        ("recall", optional_floats(rows.iter().map(|(_, p)| p.confusion.recall()).map(if_finite))),
    ]);
    Table { name: "candidate_curve", columns, nullable: &["recall"] }
}

/// Null without right candidates.
fn if_finite(value: f64) -> Option<f64> {
    value.is_finite().then_some(value)
}
