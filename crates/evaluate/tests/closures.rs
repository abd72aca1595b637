//! Tables, figures and report of the loop closures of a made drive.

use std::sync::Arc;

use dataset::tables::{Provenance, read_table};
use dataset::{Losses, Pose2, Scan, ScanId, StampedPose, Trajectory, wrap_angle};
use evaluate::detection::{
    Drive, DriveMeasures, Evidence, FoundCandidate, FoundClosure, KeyframePoses, ScanPoses,
    measure, write_detection,
};
use evaluate::{ClosureReport, ClosureSketches, Fact, closure_figures, closure_report};

const SECOND: i64 = 1_000_000_000;
/// Radius of the circle \[m\].
const RADIUS_M: f64 = 20.0;

/// Twice around a circle in a square hall, with a keyframe every half metre. The odometry turns too much.
struct Made {
    keyframes: Vec<KeyframePoses>,
    scans: Vec<ScanPoses>,
    candidates: Vec<FoundCandidate>,
    closures: Vec<FoundClosure<'static>>,
    truth: Trajectory,
}

fn on_circle(k: usize) -> Pose2 {
    let angle = k as f64 * 0.5 / RADIUS_M;
    Pose2 {
        x_m: RADIUS_M * angle.sin(),
        y_m: -RADIUS_M * angle.cos(),
        heading_rad: wrap_angle(angle),
    }
}

impl Made {
    fn new() -> Self {
        let n = 500;
        let mut odometry = on_circle(0);
        let mut scans = Vec::new();
        for k in 0..n {
            scans.push(ScanPoses {
                stamp_ns: k as i64 * SECOND,
                odometry,
                scan_matched: Some(on_circle(k)),
                optimized: on_circle(k),
            });
            let turn = Pose2 { heading_rad: 0.002, ..Pose2::default() };
            odometry = odometry * (on_circle(k).inverse() * on_circle(k + 1)) * turn;
        }
        let keyframes = scans
            .iter()
            .enumerate()
            .map(|(k, scan)| KeyframePoses {
                scan: k as u32,
                stamp_ns: scan.stamp_ns,
                path_m: 0.5 * k as f64,
                odometry: scan.odometry,
                scan_matched: on_circle(k),
                optimized: scan.optimized,
                covariance: Some([0.01, 0.0, 0.0, 0.01, 0.0, 0.001]),
            })
            .collect();
        let closure = |query: usize, reference: usize, dx_m: f64, confidence: f64| FoundClosure {
            query,
            reference,
            reference_from_query: Pose2 { x_m: dx_m, ..Pose2::default() }
                * (on_circle(reference).inverse() * on_circle(query)),
            covariance: [0.01, 0.0, 0.0, 0.01, 0.0, 0.001],
            confidence,
            rejected: None,
            evidence: Evidence { overlap: 0.8, known_overlap: 0.9, ..Evidence::default() },
        };
        let rejected =
            FoundClosure { rejected: Some("inconsistent"), ..closure(420, 300, 0.0, 0.7) };
        let closures = vec![
            closure(300, 49, 0.05, 0.9),
            closure(340, 89, 0.1, 0.8),
            closure(380, 129, 3.0, 0.6),
            rejected,
        ];
        let candidate = |c: &FoundClosure<'_>| FoundCandidate {
            query: c.query,
            reference: c.reference,
            reference_from_query: c.reference_from_query,
            confidence: c.confidence,
        };
        let candidates = closures.iter().map(candidate).collect();
        let poses = (0..n).map(|k| StampedPose::new(k as i64 * SECOND, on_circle(k))).collect();
        Self { keyframes, scans, candidates, closures, truth: Trajectory::new(poses).0 }
    }

    fn drive(&self, has_truth: bool) -> Drive<'_> {
        Drive {
            log: "hall",
            segment: 0,
            map: Some(0),
            keyframes: &self.keyframes,
            scans: &self.scans,
            candidates: &self.candidates,
            closures: &self.closures,
            truth: has_truth.then_some(&self.truth),
            base_from_lidar: Pose2::default(),
        }
    }
}

/// The walls of a square hall of 60 m, seen from a pose.
fn scan(pose: Pose2) -> Scan {
    let beam = |k: u32| {
        let bearing = f64::from(k).to_radians();
        let (sin, cos) = (bearing + pose.heading_rad).sin_cos();
        let to_wall = |at: f64, step: f64| (step.signum() * 30.0 - at) / step;
        let range = to_wall(pose.x_m, cos).min(to_wall(pose.y_m, sin));
        ((range * bearing.cos()) as f32, (range * bearing.sin()) as f32)
    };
    let (x_m, y_m) = (0..360).map(beam).unzip();
    Scan { x_m, y_m, coverage_deg: 360.0, ..Scan::default() }
}

fn provenance() -> Provenance {
    Provenance {
        program_version: "1.2.3".to_owned(),
        seed: Some(1),
        options: serde_json::Value::Null,
        inputs: std::collections::BTreeMap::new(),
        losses: Losses::default(),
        notes: Vec::new(),
    }
}

fn report(made: &Made, has_truth: bool) -> String {
    let drives = [made.drive(has_truth)];
    let measures: Vec<DriveMeasures> = drives.iter().map(measure).collect();
    let mut sketches = ClosureSketches::new(&drives);
    let log: Arc<str> = "hall".into();
    for k in 0..made.keyframes.len() {
        let id = ScanId { log: log.clone(), scan: k as u32 };
        sketches.add(&drives, &id, &scan(on_circle(k)));
    }
    let figures = closure_figures(&drives, &measures, &sketches);
    let losses = Losses::default();
    let report = ClosureReport {
        sites: &[],
        keyframes: &[],
        drives: &drives,
        measures: &measures,
        sketches: &sketches,
        figures: &figures,
        losses: &losses,
        notes: &[],
    };
    let option = Fact { name: "seed".to_owned(), value: "1".to_owned() };
    closure_report("hall", &report, (&[], &[option]), &provenance())
}

const FIGURES: [&str; 7] = [
    "before-1",
    "after-1",
    "drift-m-1",
    "drift-deg-1",
    "strongest-accepted-1",
    "weakest-accepted-1",
    "strongest-rejected-1",
];

/// Closure 380 is 3 m off: 1 of 3 accepted closures is false.
#[test]
fn the_report_shows_errors_and_figures() {
    let made = Made::new();
    let html = report(&made, true);
    for id in FIGURES.into_iter().chain(["candidates"]) {
        assert!(html.contains(&format!("svg id=\"{id}\"")), "{id}");
    }
    assert!(html.contains("1 of 3") && html.contains("show 1 rejected closures"));
    assert!(!html.contains("<script") && !html.contains("http://") && !html.contains("https://"));
    assert!(html.len() < 400_000, "{} bytes", html.len());
    assert_eq!(html, report(&made, true));
}

#[test]
fn the_report_works_without_ground_truth() {
    let made = Made::new();
    let html = report(&made, false);
    for id in FIGURES {
        assert!(html.contains(&format!("svg id=\"{id}\"")), "{id}");
    }
    assert!(html.contains("There is no ground truth") && !html.contains("ATE"));
    assert!(!html.contains("svg id=\"candidates\""));
}

#[test]
fn tables_and_trajectories_are_written() {
    let made = Made::new();
    let drives = [made.drive(true)];
    let measures: Vec<DriveMeasures> = drives.iter().map(measure).collect();
    let folder = tempfile::tempdir().unwrap();
    let written = write_detection(folder.path(), &provenance(), &drives, &measures).unwrap();
    assert_eq!(written.len(), 6 + 5);
    let rows = |name: &'static str| {
        let path = folder.path().join(format!("{name}.parquet"));
        read_table(&path, name).unwrap().0.num_rows()
    };
    // 6 path lengths for each of 4 sources.
    assert_eq!((rows("closure_errors"), rows("trajectory_errors"), rows("drift")), (4, 4, 24));
    let truth = measures[0].truth.as_ref().unwrap();
    assert_eq!(rows("revisits"), truth.revisits.all.n);
    assert_eq!(rows("candidate_curve"), truth.curve.len());
    let path = folder.path().join("trajectories/hall-0/truth.tum");
    let text = std::fs::read_to_string(path).unwrap();
    assert_eq!(text.lines().count(), 500);
    assert!(text.starts_with("0.000000000 0.000000000 -20.000000000 0 0 0 0.000000000000 1.0"));

    // Without ground truth: the same tables, and no trajectories.
    let drives = [made.drive(false)];
    let measures: Vec<DriveMeasures> = drives.iter().map(measure).collect();
    let folder = tempfile::tempdir().unwrap();
    let written = write_detection(folder.path(), &provenance(), &drives, &measures).unwrap();
    assert_eq!(written.len(), 6);
}
