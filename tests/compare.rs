//! `map compare`: what changed between two runs of a simulated drive.

use std::fs;
use std::path::Path;
use std::process::Command;

use dataset::tables::{
    Provenance, read_closures, read_poses, write_closures, write_pairs, write_poses,
};
use dataset::{Label, Pair, Pose2, StampedPose, Trajectory};
use serde_json::Value;

use crate::detection::{new_drive, run_stages};
use crate::require::python_with;
use crate::support::{self, Finished, Workplace, loopboost_with_threads, root};

/// Compares two run folders.
fn compare(workplace: &Workplace, a: &str, b: &str, more: &[&str]) -> Finished {
    let paths = [workplace.path(a), workplace.path(b)];
    let [a, b] = paths.each_ref().map(|path| path.to_str().unwrap());
    loopboost_with_threads(&[&["map", "compare", a, b], more].concat(), 2)
}

/// The output of `--json`.
fn compare_json(workplace: &Workplace, a: &str, b: &str, code: i32) -> Value {
    let finished = compare(workplace, a, b, &["--json"]).expect(code);
    serde_json::from_str(&finished.stdout).unwrap()
}

fn codes(comparison: &Value) -> Vec<&str> {
    comparison["changes"].as_array().unwrap().iter().map(|code| code.as_str().unwrap()).collect()
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let copied = to.join(path.file_name().unwrap());
        if path.is_dir() {
            copy(&path, &copied);
        } else {
            fs::copy(&path, &copied).unwrap();
        }
    }
}

/// The JSON has the documented schema.
fn check_schema(comparison: &Value) {
    let Some(python) = python_with(&["jsonschema"]) else { return };
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("comparison.json");
    fs::write(&file, comparison.to_string()).unwrap();
    let script = "import json, jsonschema, sys\n\
        schema, value = (json.load(open(path)) for path in sys.argv[1:])\n\
        jsonschema.validate(value, schema)\n\
        value['closures'].pop('n_lost')\n\
        try:\n\
        \x20   jsonschema.validate(value, schema)\n\
        except jsonschema.ValidationError:\n\
        \x20   sys.exit(0)\n\
        sys.exit('a missing number passed')";
    let schema = root().join("docs/schema/comparison.json");
    let output = Command::new(python).args(["-c", script]).arg(schema).arg(file).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
}

fn accepted(run: &Path) -> usize {
    let (closures, _) = read_closures(&run.join("closures.parquet")).unwrap();
    closures.iter().filter(|closure| closure.is_accepted()).count()
}

/// The poses of all scans of the drive.
fn poses(run: &Path) -> Vec<StampedPose> {
    read_poses(&run.join("trajectory/friday.parquet")).unwrap().0.poses().to_vec()
}

/// Labels the first keyframe and each of the next ones as the same place, except one.
fn write_labels(run: &Path, negative: usize) {
    let keyframes = support::keyframes(run);
    let pair = |query| Pair {
        query,
        reference: 0,
        label: if query == negative { Label::Negative } else { Label::Positive },
        distance_m: 1.0,
        distance_std_m: None,
        heading_difference_rad: None,
        travel_gap_m: 1.0,
    };
    let pairs: Vec<Pair> = (1..=5).map(pair).collect();
    write_pairs(&run.join("pairs.parquet"), &Provenance::default(), &keyframes, &pairs).unwrap();
}

#[test]
fn equal_runs_have_no_differences_and_exit_with_0() {
    let workplace = Workplace::new(&new_drive());
    run_stages(&workplace, "a", 2);
    let run = workplace.path("a");
    copy(&run, &workplace.path("b"));
    let report = workplace.path("report.html");
    let more = ["--report", report.to_str().unwrap()];
    let printed = compare(&workplace, "a", "b", &more).expect(0).stdout;
    assert!(printed.contains("nothing changed beyond the tolerances"), "{printed}");
    let found = compare_json(&workplace, "a", "b", 0);
    check_schema(&found);
    assert_eq!((codes(&found).len(), &found["origins"]), (0, &serde_json::json!([])));
    let closures = &found["closures"];
    for count in ["n_a", "n_b", "n_kept"] {
        assert_eq!(closures[count], accepted(&run), "{count}");
    }
    for count in ["n_lost", "n_gained", "n_moved", "n_closed_keyframes_only_a"] {
        assert_eq!(closures[count], 0, "{count}");
    }
    assert_eq!(
        (&closures["kept"]["max_m"], &closures["kept"]["max_std"]),
        (&0.0.into(), &0.0.into())
    );
    let trajectory = &found["trajectories"][0];
    assert_eq!(trajectory["n_scans"], poses(&run).len());
    assert_eq!((&trajectory["max_m"], &trajectory["max_deg"]), (&0.0.into(), &0.0.into()));
    assert_eq!((&found["labels"], &found["places"]["n_only_a"]), (&Value::Null, &0.into()));
    let html = fs::read_to_string(report).unwrap();
    assert!(html.contains("<svg id=\"compared-1\"") && html.contains("Nothing changed"));
    assert!(!html.contains("http"), "the report opens offline");
}

/// B is a copy of A with known differences: of two accepted closures, one is rejected and one is missing;
/// a third one moves by 0.3 m; the scan in the middle turns by 3 deg and moves by 0.3 m; one label flips.
#[test]
fn known_differences_are_found_with_their_numbers() {
    let workplace = Workplace::new(&new_drive());
    run_stages(&workplace, "a", 2);
    let [a, b] = ["a", "b"].map(|name| workplace.path(name));
    write_labels(&a, 0);
    copy(&a, &b);
    write_labels(&b, 3);
    let path = b.join("closures.parquet");
    let (mut closures, provenance) = read_closures(&path).unwrap();
    let rows: Vec<usize> = (0..closures.len()).filter(|&k| closures[k].is_accepted()).collect();
    closures[rows[1]].rejected = Some("inconsistent".to_owned());
    closures[rows[2]].closure.reference_from_query.y_m += 0.3;
    let moved = closures[rows[2]].closure.clone();
    closures.remove(rows[0]);
    write_closures(&path, &provenance, &closures).unwrap();
    let path = b.join("trajectory/friday.parquet");
    let (trajectory, provenance) = read_poses(&path).unwrap();
    let mut turned = trajectory.poses().to_vec();
    let middle = turned.len() / 2;
    turned[middle].pose.x_m += 0.3;
    turned[middle].pose.heading_rad += 3f64.to_radians();
    let stamp_ns = turned[middle].stamp_ns;
    write_poses(&path, &provenance, "friday", &Trajectory::new(turned).0).unwrap();

    let found = compare_json(&workplace, "a", "b", 3);
    check_schema(&found);
    let expected = ["closures_lost", "closures_moved", "trajectory_changed", "labels_changed"];
    assert_eq!(codes(&found), expected);
    let closures = &found["closures"];
    let n = accepted(&a);
    assert_eq!((&closures["n_a"], &closures["n_b"]), (&n.into(), &(n - 2).into()));
    assert_eq!((&closures["n_lost"], &closures["n_kept"]), (&2.into(), &(n - 2).into()));
    let reasons = serde_json::json!([{ "reason": "inconsistent", "n": 1 }, { "reason": "not_found", "n": 1 }]);
    assert_eq!((&closures["lost"], &closures["n_moved"]), (&reasons, &1.into()));
    let change = closures["changes"].as_array().unwrap().last().unwrap();
    assert_eq!(
        (&change["query_scan"], &change["change"]),
        (&moved.query.scan.into(), &"moved".into())
    );
    assert!((change["shift_m"].as_f64().unwrap() - 0.3).abs() < 1e-9, "{change}");
    // The alignment takes up 0.3 m / 1647 of the shift.
    let trajectory = &found["trajectories"][0];
    let number = |name: &str| trajectory[name].as_f64().unwrap();
    assert!((number("max_m") - 0.3).abs() < 1e-3 && number("median_m") < 1e-3, "{trajectory}");
    assert!((number("max_deg") - 3.0).abs() < 1e-2 && number("median_deg") < 1e-2);
    assert_eq!(trajectory["farthest"]["stamp_ns"], stamp_ns);
    let labels = &found["labels"];
    assert_eq!((&labels["n_common"], &labels["n_positive_to_negative"]), (&5.into(), &1.into()));

    let printed = compare(&workplace, "a", "b", &[]).expect(3);
    printed.says(&["warning[closures_lost]: 2 of", "warning[labels_changed]: of 5 labelled pairs"]);
    let tolerated = ["--max-lost=2", "--max-shift-m=0.4", "--max-turn-deg=4", "--max-flips=1"];
    compare(&workplace, "a", "b", &tolerated).expect(0);
    compare(&workplace, "b", "a", &tolerated).expect(3).says(&["closures_gained"]);
}

#[test]
fn another_option_and_another_seed_are_named() {
    let workplace = Workplace::new(&new_drive());
    run_stages(&workplace, "a", 2);
    let [a, b] = ["a", "b"].map(|name| workplace.path(name));
    copy(&a, &b);
    for stage in ["register", "detect", "optimize"] {
        let code = if stage == "optimize" { 3 } else { 0 };
        workplace.command(stage, "b", &["--set", "register.max_range_m=8"]).expect(code);
    }
    let found = compare_json(&workplace, "a", "b", 3);
    assert!(codes(&found).contains(&"trajectory_changed"), "{:?}", codes(&found));
    let origin = &found["origins"][0];
    assert_eq!(origin["key"], "register.max_range_m");
    assert_eq!((&origin["a"], &origin["b"]), (&"25.0".into(), &"8.0".into()));
    assert_eq!(found["origins"].as_array().unwrap().len(), 1);
    // The same error as that of a trajectory against the truth.
    let of = |run: &Path| poses(run).iter().map(|pose| pose.pose).collect::<Vec<Pose2>>();
    let expected = evaluate::detection::align(&of(&a), &of(&b)).unwrap();
    let rmse_m = found["trajectories"][0]["rmse_m"].as_f64().unwrap();
    assert!(0.0 < rmse_m && (rmse_m - expected.rmse_m).abs() < 1e-12, "{rmse_m}");

    // Another drive under the same name.
    fs::write(workplace.path("drive.toml"), new_drive().replace("seed = 7", "seed = 8")).unwrap();
    run_stages(&workplace, "other", 2);
    let found = compare_json(&workplace, "a", "other", 3);
    assert_eq!(codes(&found)[0], "other_scans");
    assert_eq!(found["closures"]["n_lost"], accepted(&a));
    assert_eq!(found["closures"]["n_gained"], accepted(&workplace.path("other")));
    assert_eq!(
        (&found["logs"][0]["n_common_keyframes"], &found["closures"]["n_kept"]),
        (&0.into(), &0.into())
    );
    let origins = found["origins"].as_array().unwrap();
    let keys: Vec<&str> = origins.iter().map(|origin| origin["key"].as_str().unwrap()).collect();
    assert_eq!(keys, ["seed", "logs/friday.mcap"]);
}

#[test]
fn folders_and_options_that_cannot_be_compared_are_named() {
    let workplace = Workplace::new("");
    fs::create_dir(workplace.path("empty")).unwrap();
    compare(&workplace, "missing", "empty", &[])
        .expect(1)
        .says(&["missing is not a folder", "loopboost detect"]);
    compare(&workplace, "empty", "empty", &[])
        .expect(1)
        .says(&["closures.parquet does not exist", "loopboost optimize"]);
    for (option, message) in [
        ("--max-shift-m=-1", "`--max-shift-m` is -1, expected 0 or more"),
        ("--positive-radius-m=0", "`--positive-radius-m` is 0, expected more than 0"),
        ("--report=report.txt", "--report is report.txt, expected a file name that ends in .html"),
    ] {
        compare(&workplace, "empty", "empty", &[option]).expect(2).says(&[message]);
    }
}
