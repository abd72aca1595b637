//! `locate`: a short simulated drive in the map of another drive.

use std::fs;
use std::path::Path;

use dataset::tables::{read_located, read_poses};
use dataset::{LocatedScan, LocatedState};
use serde_json::Value;

use crate::detection::{new_drive, run_stages};
use crate::made_planar::half_circle_log;
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
    let mut errors_m = Vec::new();
    for row in &rows {
        assert_eq!(row.position.is_some(), row.state == LocatedState::Located);
        let Some(position) = row.position else { continue };
        let expected = poses.pose_at(row.stamp_ns, 0).unwrap();
        let error_m = position.pose.distance_m(&expected);
        assert!(error_m < 0.5, "{row:?}, {expected:?}");
        errors_m.push(error_m);
    }
    assert!(rows.len() < 2 * errors_m.len(), "{} of {} scans", errors_m.len(), rows.len());
    // At 2 m/s, the lidar moves 0.2 m during a scan. Without deskewing, the median is 0.13 m.
    errors_m.sort_by(f64::total_cmp);
    assert!(errors_m[errors_m.len() / 2] < 0.01, "{errors_m:?}");
    let deskewed = format!("info[deskewed]: {} scans deskewed", rows.len());
    assert!(done.stderr.contains(&deskewed), "{}", done.stderr);

    let error = loopboost(&["locate", "--map", &map, &log, "--map-log", "monday", "--out", &out]);
    assert_eq!(error.code, 2, "{}", error.stderr);
    assert!(error.stderr.contains("no such log, expected one of `friday`"), "{}", error.stderr);
}

/// A log of another building is not located. A log that cannot be read, or that is from another kind of scanner,
/// does not stop the others.
#[test]
fn logs_that_cannot_be_located_are_reported() {
    let workplace = Workplace::new(&new_drive());
    run_stages(&workplace, "map", 2);
    let other = Workplace::new(&new_drive().replace("seed = 7", "seed = 8").replace("330", "60"));
    other.command("simulate", "run", &[]).expect(0);
    fs::copy(other.path("run/logs/friday.mcap"), workplace.path("other.mcap")).unwrap();
    fs::write(workplace.path("half.mcap"), half_circle_log()).unwrap();
    fs::write(workplace.path("bad.mcap"), "not a log").unwrap();
    fs::write(
        workplace.path("half.toml"),
        "[ingest]\nlogs = [\"half.mcap\"]\nlidar.topic = \"/scan\"\n",
    )
    .unwrap();
    let out = workplace.path("located.parquet");
    let locate = |logs: &[&str], more: &[&str]| {
        let paths: Vec<String> = ["map"]
            .iter()
            .chain(logs)
            .map(|name| workplace.path(name).to_string_lossy().into_owned())
            .collect();
        let mut args = vec!["locate", "--json", "--out", out.to_str().unwrap(), "--map"];
        args.extend(paths.iter().map(String::as_str));
        args.extend(more);
        loopboost(&args)
    };
    let table = || read_located(&out).unwrap().0;

    let done = locate(&["other.mcap"], &[]).expect(3).says(&["not_located"]);
    let summary: Value = serde_json::from_str(&done.stdout).unwrap();
    assert_eq!(summary["logs"][0]["has_odometry"], true);
    assert_eq!(summary["logs"][0]["n_located"], 0);
    let with_odometry = table();
    assert!(!with_odometry.is_empty());

    // Without the odometry, the path is another one.
    let done = locate(&["bad.mcap", "other.mcap"], &["--no-odometry"]).expect(3).says(&[
        "error[log_not_located]: ",
        "(log `bad`)",
        "warning[not_located]: ",
        "(log `other`)",
    ]);
    let summary: Value = serde_json::from_str(&done.stdout).unwrap();
    assert_eq!(summary["logs"].as_array().map(Vec::len), Some(1));
    assert_eq!(summary["logs"][0]["has_odometry"], false);
    let rows = table();
    assert_eq!(rows.len(), with_odometry.len());
    let paths_m = |rows: &[LocatedScan]| rows.last().map(|row| row.travel_m);
    assert_ne!(paths_m(&rows), paths_m(&with_odometry));
    assert!(rows.iter().all(|row| row.id.log.to_string() == "other"));

    let pipeline = workplace.path("half.toml");
    let options = ["--pipeline", pipeline.to_str().unwrap()];
    locate(&["half.mcap"], &options).expect(1).says(&["cover 179 deg", "those of the map 360 deg"]);
    locate(&["half.mcap"], &[]).expect(1).says(&["name a pipeline for it with --pipeline"]);
    locate(&["half.mcap", "bad.mcap"], &options).expect(1).says(&["half: ", "bad: "]);
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
