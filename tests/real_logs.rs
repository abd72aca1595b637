//! Logs that others recorded, or made from real drives. Each test is skipped if they are missing.

use std::collections::BTreeSet;
use std::fs;
use std::path::Path;
use std::process::Command;

use dataset::tables::TableError;
use dataset::tables::read_pairs;
use dataset::tables::scans::read_scans;
use dataset::{Label, Scan, StampedPose, Trajectory};

use crate::require::{python_with, shared_data};
use crate::support::{self, Workplace, drift, loopboost_with_threads, root};

/// Real paths through real floor plans, seen by a simulated HDL-32E.
pub const DRIVES: [&str; 3] =
    ["logs/hdl32e-killian.mcap", "logs/hdl32e-csail.mcap", "logs/hdl32e-aces.mcap"];

/// `pipelines/killian.toml` gives 1218 + 1218 unique pairs. They obey the label rules when checked
/// against the ground truth in the logs. One thread and two give the same bytes.
#[test]
fn killian_gives_the_2436_pairs() {
    let Some(data) = shared_data(&DRIVES) else { return };
    let workplace = Workplace::new("");
    let pipeline = root().join("pipelines/killian.toml");
    let logs = DRIVES.map(|log| data.join(log));
    let run = |out: &str, threads| {
        let logs =
            format!("ingest.logs={:?}", logs.each_ref().map(|log| fs::canonicalize(log).unwrap()));
        let out = workplace.path(out);
        let args =
            ["run", pipeline.to_str().unwrap(), "--out", out.to_str().unwrap(), "--set", &logs];
        loopboost_with_threads(&args, threads).expect(0)
    };
    run("one", 1);
    run("two", 2);
    let (one, two) = (workplace.files("one"), workplace.files("two"));
    assert!(one.keys().eq(two.keys()));
    for (name, bytes) in &one {
        assert!(two[name] == *bytes, "{name} differs between 1 and 2 threads");
    }

    let out = workplace.path("one");
    let keyframes = support::keyframes(&out);
    let (pairs, _) = read_pairs(&out.join("pairs.parquet"), &keyframes).unwrap();
    let count = |label| pairs.iter().filter(|pair| pair.label == label).count();
    assert_eq!((count(Label::Positive), count(Label::Negative)), (1218, 1218));
    let unique: BTreeSet<_> = pairs.iter().map(|pair| (pair.query, pair.reference)).collect();
    assert_eq!(unique.len(), 2436);
    let truth = logs.each_ref().map(|log| ground_truth(log));
    let position = |k: usize| {
        let keyframe = &keyframes[k];
        let log =
            logs.iter().position(|log| log.file_stem().unwrap() == &*keyframe.id.log).unwrap();
        truth[log].pose_at(keyframe.stamp_ns, 200_000_000).unwrap()
    };
    for pair in &pairs {
        let (query, reference) = (&keyframes[pair.query], &keyframes[pair.reference]);
        assert_ne!(query.id, reference.id);
        assert_eq!(query.id.log, reference.id.log, "each log is its own site");
        let distance_m = position(pair.query).distance_m(&position(pair.reference));
        assert!((distance_m - pair.distance_m).abs() < 1e-9);
        match pair.label {
            Label::Positive => assert!(distance_m <= 1.5),
            Label::Negative => assert!(50.0 < distance_m),
        }
    }
}

/// The poses of `/ground_truth`, read with the `mcap` crate and decoded here: the stamp, the frame
/// "map", then seven f64.
fn ground_truth(log: &Path) -> Trajectory {
    let bytes = fs::read(log).unwrap();
    let poses = mcap::MessageStream::new(&bytes)
        .unwrap()
        .map(|message| message.unwrap())
        .filter(|message| message.channel.topic == "/ground_truth")
        .map(|message| {
            let word = |at: usize| {
                i64::from(u32::from_le_bytes(message.data[at..at + 4].try_into().unwrap()))
            };
            let number =
                |at: usize| f64::from_le_bytes(message.data[at..at + 8].try_into().unwrap());
            let pose = dataset::Pose2 {
                x_m: number(20),
                y_m: number(28),
                heading_rad: 2.0 * number(60).atan2(number(68)),
            };
            StampedPose::new(word(4) * 1_000_000_000 + word(8), pose)
        })
        .collect();
    Trajectory::new(poses).0
}

/// The real capture has 2.5 revolutions that start at 222.5 deg. They pass azimuth 0 three times, so
/// two revolutions are complete. 1335 and 1350 returns of laser 15 were counted in their packets.
#[test]
fn street_in_ros_1_and_ros_2_gives_the_same_revolutions() {
    let streets = ["ros1", "ros2"].map(|encoding| format!("logs/hdl32e-street.{encoding}.mcap"));
    let Some(data) = shared_data(&streets.each_ref().map(String::as_str)) else { return };
    let workplace = Workplace::new("");
    let revolutions = ["ros1", "ros2"].map(|encoding| {
        let log = data.join(format!("logs/hdl32e-street.{encoding}.mcap"));
        let log = fs::canonicalize(log).unwrap();
        workplace.command("ingest", "out", &["--set", &format!("ingest.logs=[{log:?}]")]).expect(0);
        scans(&workplace.path("out").join(format!("scans/hdl32e-street.{encoding}.parquet")))
    });
    assert_eq!(revolutions[0], revolutions[1]);
    let found: Vec<_> = revolutions[0].iter().map(|scan| (scan.len(), scan.is_ring())).collect();
    assert_eq!(found, [(1335, true), (1350, true)]);

    const MODULES: [&str; 4] = ["mcap", "numpy", "pyarrow", "velodyne_decoder"];
    // Compare every return with `velodyne-decoder`.
    let Some(python) = python_with(&MODULES) else { return };
    let output = Command::new(&python)
        .arg(root().join("tests/peers/street.py"))
        .arg(data.join("logs/hdl32e-street.ros2.mcap"))
        .arg(workplace.path("out/scans/hdl32e-street.ros2.parquet"))
        .output()
        .unwrap();
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    assert!(output.status.success(), "{printed}\n{}", String::from_utf8_lossy(&output.stderr));
    println!("{printed}");
}

/// All scans of a table.
pub fn scans(table: &Path) -> Vec<Scan> {
    let (headers, _) = dataset::tables::scans::read_scan_headers(table).unwrap();
    let all: Vec<u32> = (0..headers.len() as u32).collect();
    let mut scans = Vec::new();
    read_scans(table, &all, |batch| {
        scans.extend(batch);
        Ok::<_, TableError>(())
    })
    .unwrap();
    scans
}

/// Real scans of half a circle. Three of the four logs have poses for some scans only: the run
/// reports how many scans it dropped and exits with 3.
#[test]
fn the_planar_pipeline_runs_and_reports_dropped_scans() {
    const LOGS: [&str; 4] = [
        "logs/mit-killian.mcap",
        "logs/intel-lab.mcap",
        "logs/mit-csail.mcap",
        "logs/austin-aces.mcap",
    ];
    let Some(data) = shared_data(&LOGS) else { return };
    let workplace = Workplace::new("");
    let logs = LOGS.map(|log| fs::canonicalize(data.join(log)).unwrap());
    let (pipeline, out) = (root().join("pipelines/planar.toml"), workplace.path("out"));
    let logs = format!("ingest.logs={logs:?}");
    let args = ["run", pipeline.to_str().unwrap(), "--out", out.to_str().unwrap(), "--set", &logs];
    loopboost_with_threads(&args, 2).expect(3).says(&[
        "scans in a gap between poses",
        "scans before the first pose",
        "scans after the last pose",
    ]);
    let keyframes = support::keyframes(&out);
    let (pairs, _) = read_pairs(&out.join("pairs.parquet"), &keyframes).unwrap();
    assert_eq!(pairs.len(), 2436);
    for pair in pairs.iter().filter(|pair| pair.label == Label::Positive) {
        assert!(pair.heading_difference_rad.unwrap() <= 45f64.to_radians());
    }
}

/// Poses fused from wheels and gyroscope end close to the ground truth. With the first pose aligned,
/// the last one is off by less than 0.5 % of the path in Killian and CSAIL. In ACES the ground truth
/// moves sideways, which wheels cannot measure: 1.7 %.
#[test]
fn poses_fused_from_wheels_and_imu_stay_near_the_truth() {
    let Some(data) = shared_data(&DRIVES) else { return };
    for (log, most) in [("killian", 0.005), ("csail", 0.005), ("aces", 0.02)] {
        let path = fs::canonicalize(data.join(format!("logs/hdl32e-{log}.mcap"))).unwrap();
        let workplace = Workplace::new(&format!(
            "[ingest]\nlogs = [{path:?}]\n[ingest.pose]\nwheels = \"/wheel_states\"\nimu = \"/imu/data\"\ntrack_m = 0.5\n"
        ));
        workplace.command("ingest", "out", &[]).expect(0);
        let table = workplace.path(&format!("out/poses/hdl32e-{log}.parquet"));
        let fused = dataset::tables::read_poses(&table).unwrap().0;
        assert!(fused.poses().iter().all(|pose| pose.covariance.is_some()));
        let truth = ground_truth(&path);
        let (drift_m, path_m) = drift(&truth, &fused);
        assert!(drift_m < most * path_m, "{log}: {drift_m:.2} m of {path_m:.0} m");
    }
}
