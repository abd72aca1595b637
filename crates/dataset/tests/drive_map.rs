//! Round trips of the tables of `register`, `detect` and `optimize`.

#![allow(clippy::unwrap_used, reason = "a test panics if a value is missing")]
#![cfg(feature = "parquet")]

use std::path::PathBuf;

use dataset::tables::{
    Provenance, TableError, read_candidates, read_closures, read_odometry, read_registered,
    read_trajectory, write_candidates, write_closures, write_odometry, write_registered,
    write_trajectory,
};
use dataset::{
    CandidateClosure, JudgedClosure, MapPose, Pose2, RegisteredScan, ScanClosure, ScanId,
};

fn provenance() -> Provenance {
    let inputs = [("scans/a.parquet".to_owned(), "00ff".to_owned())].into();
    Provenance { program_version: "0.1.0".into(), seed: Some(7), inputs, ..Provenance::default() }
}

fn id(log: &str, scan: u32) -> ScanId {
    ScanId { log: log.into(), scan }
}

fn pose(x_m: f64) -> Pose2 {
    Pose2 { x_m, y_m: -2.0 * x_m, heading_rad: 0.25 * x_m }
}

fn closure(k: u32) -> ScanClosure {
    let value = |n: u32| f64::from(10 * k + n) / 16.0;
    ScanClosure {
        query: id("a", 900 + k),
        reference: id(if k == 0 { "a" } else { "b" }, k),
        reference_from_query: pose(value(1)),
        covariance: std::array::from_fn(|n| value(n as u32)),
        confidence: value(2),
        overlap: value(3),
        known_overlap: value(4),
        n_known: 60 + k,
        conflict: value(5),
        margin: value(6),
        weakness: value(7),
        classifier: (k == 1).then(|| -value(8)),
        is_degenerate: k == 1,
    }
}

struct Folder(tempfile::TempDir);

impl Folder {
    fn path(&self, name: &str) -> PathBuf {
        self.0.path().join(name)
    }
}

#[test]
fn registered_scans_are_read_as_written_and_the_odometry_has_only_keyframes() {
    let folder = Folder(tempfile::tempdir().unwrap());
    let rows: Vec<RegisteredScan> = (0..3)
        .map(|k| RegisteredScan {
            id: id("a", 4 * k),
            stamp_ns: i64::from(k) * 100,
            pose: pose(f64::from(k)),
            covariance: (0 < k).then_some([1.0, 2.0, 3.0, 4.0, 5.0, f64::from(k)]),
            odometry: pose(1.5 * f64::from(k)),
            near_share: 1.0 - f64::from(k) / 8.0,
            weakness: (0 < k).then_some(0.5),
            is_degenerate: k == 2,
            is_keyframe: k != 1,
            segment: k / 2,
            travel_m: 0.75 * f64::from(k),
        })
        .collect();
    write_registered(&folder.path("registered"), &provenance(), &rows).unwrap();
    let read = read_registered(&folder.path("registered")).unwrap();
    assert_eq!(read, (rows.clone(), provenance()));

    let keyframes: Vec<_> = rows.into_iter().filter(|row| row.is_keyframe).collect();
    write_odometry(&folder.path("odometry"), &provenance(), &keyframes).unwrap();
    assert_eq!(read_odometry(&folder.path("odometry")).unwrap(), (keyframes, provenance()));
    let wrong = read_registered(&folder.path("odometry")).unwrap_err();
    assert!(matches!(wrong, TableError::Kind { expected: "registered", .. }), "{wrong}");
}

#[test]
fn closures_are_read_as_written() {
    let folder = Folder(tempfile::tempdir().unwrap());
    let candidates: Vec<_> =
        (0..3).map(|k| CandidateClosure { closure: closure(k), rank: 4 - k }).collect();
    write_candidates(&folder.path("candidates"), &provenance(), &candidates).unwrap();
    let read = read_candidates(&folder.path("candidates")).unwrap();
    assert_eq!(read, (candidates, provenance()));

    let judged: Vec<_> = (0..3)
        .map(|k| JudgedClosure {
            closure: closure(k),
            rejected: (k == 1).then(|| "unsupported".to_owned()),
        })
        .collect();
    write_closures(&folder.path("closures"), &provenance(), &judged).unwrap();
    assert_eq!(read_closures(&folder.path("closures")).unwrap(), (judged, provenance()));

    write_closures(&folder.path("none"), &provenance(), &[]).unwrap();
    assert_eq!(read_closures(&folder.path("none")).unwrap().0, []);
}

#[test]
fn poses_in_a_map_are_read_as_written() {
    let folder = Folder(tempfile::tempdir().unwrap());
    let rows: Vec<MapPose> = (0..3)
        .map(|k| MapPose {
            id: id("a", k),
            stamp_ns: i64::from(k) * 100,
            pose: pose(f64::from(k)),
            covariance: (k != 1).then_some([1.0, 2.0, 3.0, 4.0, 5.0, f64::from(k)]),
            is_degenerate: k == 1,
            segment: k / 2,
            travel_m: 0.5 * f64::from(k),
            map: 7 + k / 2,
        })
        .collect();
    write_trajectory(&folder.path("trajectory"), &provenance(), &rows).unwrap();
    assert_eq!(read_trajectory(&folder.path("trajectory")).unwrap(), (rows, provenance()));
}
