//! `locate`: a short simulated drive in the map of another drive.

use std::path::Path;

use dataset::LocatedState;
use dataset::tables::{read_located, read_poses};
use serde_json::Value;

use crate::detection::{new_drive, run_stages};
use crate::support::{Workplace, loopboost};

/// The log that the map was made from is located where the map has it.
#[test]
fn a_log_is_located_in_the_map_of_its_own_drive() {
    let workplace = Workplace::new(&new_drive());
    run_stages(&workplace, "map", 2);
    let (map, log) = (workplace.path("map"), workplace.path("map/logs/friday.mcap"));
    let table = workplace.path("located.parquet");
    let [map, log, out] = [&map, &log, &table].map(|path| path.to_string_lossy().into_owned());
    let args = ["locate", "--map", &map, &log, "--no-odometry", "--out", &out, "--json"];
    let done = loopboost(&args);
    let (rows, made) = read_located(Path::new(&out)).unwrap();
    let summary: Value = serde_json::from_str(&done.stdout).unwrap();
    let first = &summary["logs"][0]["first"];
    assert!(first["travel_m"].as_f64().unwrap() < 30.0, "{summary}");
    assert_eq!(summary["logs"][0]["n_scans"].as_u64(), Some(rows.len() as u64));
    assert!(made.inputs.contains_key("friday.mcap"), "{:?}", made.inputs);
    let (poses, _) = read_poses(&workplace.path("map/trajectory/friday.parquet")).unwrap();
    let mut n_located = 0;
    for row in &rows {
        assert_eq!(row.position.is_some(), row.state == LocatedState::Located);
        let Some(position) = row.position else { continue };
        let expected = poses.pose_at(row.stamp_ns, 0).unwrap();
        assert!(position.pose.distance_m(&expected) < 0.5, "{row:?}, {expected:?}");
        n_located += 1;
    }
    assert!(rows.len() < 2 * n_located, "{n_located} of {} scans", rows.len());

    let error = loopboost(&["locate", "--map", &map, &log, "--map-log", "monday", "--out", &out]);
    assert_eq!(error.code, 2, "{}", error.stderr);
    assert!(error.stderr.contains("no such log, expected one of `friday`"), "{}", error.stderr);
}

#[test]
fn a_run_without_a_map_is_an_error() {
    let workplace = Workplace::new(&new_drive());
    workplace.command("simulate", "run", &[]).expect(0);
    let (run, log) = (workplace.path("run"), workplace.path("run/logs/friday.mcap"));
    let [run, log] = [&run, &log].map(|path| path.to_string_lossy().into_owned());
    let done = loopboost(&["locate", "--map", &run, &log]);
    assert_eq!(done.code, 1, "{}", done.stderr);
    assert!(done.stderr.contains("has no map: `optimize` has not finished"), "{}", done.stderr);
}
