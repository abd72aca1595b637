//! Loop closures of simulated drives: `run` with `[detect]`, `detect --model`, and `score`.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use dataset::tables::scans::read_scan_headers;
use dataset::tables::{
    read_closures, read_pairs, read_poses, read_registered, read_table, read_trajectory,
};

use crate::support::{self, Workplace, loopboost};

/// A drive around one building and past its start again.
const LAP: &str = r#"
[simulate]
logs = ["LOG"]
buildings = 1
length_m = 330.0
people = 2
"#;

/// Poses from wheels and gyroscope. They start at an origin of their own in each log.
pub const ODOMETRY: &str = r#"
[ingest.pose]
wheels = "/wheel_states"
imu = "/imu/data"
track_m = 0.5
wheel_speed_unit = "m/s"
fuse.gyro_noise_density = 2e-5
fuse.gyro_bias_std = 1e-4
fuse.gyro_bias_walk = 1e-7
"#;

const TRUTH: &str = "[evaluate]\ntruth = { topic = \"/ground_truth\" }\n";

fn lap(log: &str) -> String {
    format!("{}{ODOMETRY}", LAP.replace("LOG", log))
}

pub fn new_drive() -> String {
    format!("name = \"new\"\nseed = 7\n{}", lap("friday"))
}

/// Runs the stages of loop detection as commands of their own, with the starting values.
pub fn run_stages(workplace: &Workplace, out: &str, threads: usize) {
    for stage in ["simulate", "ingest", "subsample", "register", "detect", "optimize"] {
        let code = if stage == "optimize" { 3 } else { 0 };
        workplace.command_with_threads(stage, out, &[], threads).expect(code);
    }
}

/// A short drive with all stages.
const SHORT: &str = r#"
name = "short"
seed = 7
[simulate]
logs = ["monday"]
length_m = 110.0
people = 2
[ingest]
pose.topic = "/ground_truth"
[label]
pairs_per_class = 60
[train]
learners = ["discrete"]
rounds = 10
[evaluate]
groupings = ["pair", "scan"]
"#;

/// A measure of the only drive, from `evaluation/detection.parquet`.
fn measures(out: &Path) -> BTreeMap<String, f64> {
    use arrow_array::cast::AsArray;
    use arrow_array::types::Float64Type;
    let (table, _) = read_table(&out.join("evaluation/detection.parquet"), "detection").unwrap();
    let names = table.column_by_name("measure").unwrap().as_string::<i32>();
    let values = table.column_by_name("value").unwrap().as_primitive::<Float64Type>();
    let rows = names.iter().flatten().map(str::to_owned).zip(values.iter());
    rows.filter_map(|(name, value)| Some((name, value?))).collect()
}

/// The files of loop detection, without those that contain the options of the evaluation.
fn estimates(workplace: &Workplace, out: &str) -> BTreeMap<String, Vec<u8>> {
    let mut files = workplace.files(out);
    files.retain(|name, _| {
        let folders = ["registered/", "trajectory/", "scans/", "poses/"];
        let tables = ["odometry.", "candidates.", "closures.", "trajectory.", "graph."];
        folders.iter().chain(&tables).any(|start| name.starts_with(start))
    });
    assert!(files.len() >= 10, "{:?}", files.keys());
    files
}

fn check_trajectory(out: &Path, log: &str) {
    let (headers, _) = read_scan_headers(&out.join(format!("scans/{log}.parquet"))).unwrap();
    let text = fs::read_to_string(out.join(format!("trajectory/{log}.tum"))).unwrap();
    let (poses, _) = read_poses(&out.join(format!("trajectory/{log}.parquet"))).unwrap();
    assert_eq!(text.lines().count(), headers.len(), "every scan of the drive has a pose");
    for (line, pose) in text.lines().zip(poses.poses()) {
        let cells: Vec<&str> = line.split(' ').collect();
        let (seconds, rest) = cells[0].split_once('.').unwrap();
        let stamp_ns =
            seconds.parse::<i64>().unwrap() * 1_000_000_000 + rest.parse::<i64>().unwrap();
        let number = |k: usize| cells[k].parse::<f64>().unwrap();
        assert_eq!((cells.len(), stamp_ns), (8, pose.stamp_ns));
        assert!(
            (number(1) - pose.pose.x_m).abs() < 1e-8 && (number(2) - pose.pose.y_m).abs() < 1e-8
        );
        let heading_rad = 2.0 * number(6).atan2(number(7));
        assert!(dataset::wrap_angle(heading_rad - pose.pose.heading_rad).abs() < 1e-9, "{line}");
    }
    let keyframes = support::keyframes(out);
    let (optimized, _) = read_trajectory(&out.join("trajectory.parquet")).unwrap();
    assert!(keyframes.iter().map(|k| &k.id).eq(optimized.iter().map(|k| &k.id)));
    let (registered, _) = read_registered(&out.join(format!("registered/{log}.parquet"))).unwrap();
    assert_eq!(registered.iter().filter(|row| row.is_keyframe).count(), keyframes.len());
}

fn check_graph(out: &Path) {
    let text = fs::read_to_string(out.join("graph.g2o")).unwrap();
    let (mut n_vertices, mut n_edges) = (0, 0);
    for line in text.lines().filter(|line| !line.starts_with('#')) {
        let cells: Vec<&str> = line.split(' ').collect();
        match cells[0] {
            "VERTEX_SE2" => {
                assert_eq!((cells.len(), cells[1]), (5, &*n_vertices.to_string()));
                n_vertices += 1;
            }
            "EDGE_SE2" => {
                let ids = [1, 2].map(|k| cells[k].parse::<usize>().unwrap());
                assert!(cells.len() == 12 && ids.iter().all(|&id| id < n_vertices), "{line}");
                let information = [6, 9, 11].map(|k| cells[k].parse::<f64>().unwrap());
                assert!(information.iter().all(|&entry| 0.0 < entry), "{line}");
                n_edges += 1;
            }
            other => panic!("unknown element {other}"),
        }
    }
    assert!(n_vertices <= n_edges + 1 && 0 < n_edges, "{n_vertices} vertices, {n_edges} edges");
}

/// Trains on one simulated campus, and finds the loop closures of another one.
#[test]
fn a_trained_model_finds_the_closures_of_a_new_drive_and_no_false_ones() {
    let train = format!(
        "name = \"campus\"\nseed = 2436\n{}[label]\npairs_per_class = 200\n[train]\nlearners = [\"discrete\"]\nrounds = 10\n[detect]\n{TRUTH}groupings = [\"pair\"]\n",
        lap("monday")
    );
    let workplace = Workplace::new(&train);
    workplace.command("run", "out", &[]).expect(0);
    let out = workplace.path("out");
    let found = measures(&out);
    assert_eq!(found["n_false_by_pose"], 0.0, "{found:?}");
    assert!(found["revisits"] > 50.0 && found["recall"] > 0.95, "{found:?}");
    check_trajectory(&out, "monday");
    check_graph(&out);
    let model = out.join("models/campus-discrete/1.0.0/model.json");
    let model = ["--model", model.to_str().unwrap()];

    // A new drive, with ground truth to measure against ...
    fs::write(workplace.path("drive.toml"), new_drive() + TRUTH).unwrap();
    workplace.command("detect", "new", &model).expect(0);
    let new = workplace.path("new");
    let found = measures(&new);
    assert_eq!(found["n_false_by_pose"], 0.0, "{found:?}");
    assert!(found["revisits"] > 50.0 && found["recall"] > 0.95, "{found:?}");
    check_trajectory(&new, "friday");
    check_graph(&new);
    let (closures, _) = read_closures(&new.join("closures.parquet")).unwrap();
    assert!(
        closures
            .iter()
            .all(|closure| closure.closure.classifier.is_some() || closure.is_accepted())
    );
    assert!(new.join("report.html").is_file() && !new.join("pairs.parquet").exists());
    let again = workplace.command("detect", "new", &model).expect(0).stdout;
    assert!(again.lines().all(|line| line.ends_with("(unchanged)")), "{again}");

    // ... and without it: the estimates are the same.
    fs::write(workplace.path("drive.toml"), new_drive()).unwrap();
    workplace.command("detect", "blind", &model).expect(0);
    assert!(!workplace.path("blind/truth").exists());
    assert!(estimates(&workplace, "new") == estimates(&workplace, "blind"));

    // Without the classifier, no features are computed.
    let without = [&model[..], &["--set", "detect.classifier=false"]].concat();
    workplace.command("detect", "without", &without).expect(0);
    let (closures, _) = read_closures(&workplace.path("without/closures.parquet")).unwrap();
    assert!(closures.iter().all(|closure| closure.closure.classifier.is_none()));
    assert!(!workplace.path("without/features").exists());
}

#[test]
fn loop_detection_gives_the_same_bytes_with_any_number_of_threads() {
    let workplace = Workplace::new(&new_drive());
    for (out, threads) in [("one", 1), ("two", 2), ("eight", 8)] {
        run_stages(&workplace, out, threads);
    }
    let expected = estimates(&workplace, "one");
    for out in ["two", "eight"] {
        for (name, bytes) in estimates(&workplace, out) {
            assert!(expected[&name] == bytes, "{out} threads: {name} has other bytes");
        }
    }
    let (closures, _) = read_closures(&workplace.path("one/closures.parquet")).unwrap();
    assert!(closures.iter().any(dataset::JudgedClosure::is_accepted));
}

/// `LOOPBOOST_KILLS` sets the number of kills.
#[test]
fn a_killed_run_with_detection_resumes_to_the_same_bytes() {
    let workplace = Workplace::new(&format!("{SHORT}{}\n[detect]\n", &TRUTH[11..]));
    let start = std::time::Instant::now();
    workplace.command("run", "whole", &[]).expect(3).says(&["detector_part_not_fitted"]);
    let whole_ms = start.elapsed().as_millis() as u64;
    let expected = workplace.files("whole");
    let n: u64 = std::env::var("LOOPBOOST_KILLS").map_or(3, |n| n.parse().expect("a number"));
    for k in 0..n {
        let out = workplace.path("killed");
        let mut child = Command::new(assert_cmd::cargo::cargo_bin!("loopboost"))
            .args(["run", workplace.path("drive.toml").to_str().unwrap(), "--out"])
            .arg(&out)
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        // Spread over the whole run.
        std::thread::sleep(Duration::from_millis(whole_ms * (2 * k + 1) / (2 * n)));
        child.kill().unwrap();
        child.wait().unwrap();
        workplace.command("run", "killed", &[]).expect(3);
        let found = workplace.files("killed");
        assert!(found.keys().eq(expected.keys()), "kill {k}: {:?}", found.keys());
        for (name, bytes) in &expected {
            assert!(found[name] == *bytes, "kill {k}: {name} has other bytes");
        }
        fs::remove_dir_all(&out).unwrap();
    }
}

#[test]
fn a_model_without_a_detector_is_an_error_that_says_how_to_get_one() {
    let workplace = Workplace::new(SHORT);
    workplace.command("run", "out", &[]).expect(0);
    let model = workplace.path("out/models/short-discrete/1.0.0/model.json");
    let model = ["--model", model.to_str().unwrap()];
    workplace.command("detect", "new", &model).expect(1).says(&[
        "has no `detector`",
        "a section [detect]",
        "evaluate.truth",
    ]);
    assert!(!workplace.path("new").exists());
    workplace
        .command("detect", "new", &["--model", "nothing.json"])
        .expect(1)
        .says(&["nothing.json"]);

    // A pipeline with [detect] and no ground truth finds closures with the starting values.
    fs::write(workplace.path("drive.toml"), format!("{SHORT}\n[detect]\n")).unwrap();
    workplace.command("run", "out", &[]).expect(3).says(&["warning[detector_not_trained]"]);
    check_trajectory(&workplace.path("out"), "monday");
}

#[test]
fn the_options_of_loop_detection_are_checked() {
    let workplace = Workplace::new(SHORT);
    for (option, message) in [
        ("detect.min_path_m=5", "`detect.min_path_m` is 5, expected twice `detect.place_half_m`"),
        ("register.spacing_m=0", "`register.spacing_m` is 0, expected more than 0"),
        (
            "register.matcher.search_m=-0.1",
            "`register.matcher.search_m` is -0.1, expected more than 0",
        ),
        ("detect.places=3", "did you mean"),
        ("evaluate.truth={}", "`evaluate.truth` has the options of `ingest.pose`"),
    ] {
        workplace.command("run", "out", &["--set", option]).expect(2).says(&[message]);
    }
}

/// A log without the topic of the ground truth is measured against nothing, and says so.
#[test]
fn a_log_without_ground_truth_is_reported() {
    let workplace =
        Workplace::new(&SHORT.replace("groupings", "truth = { topic = \"/none\" }\ngroupings"));
    workplace.command("simulate", "out", &[]).expect(0);
    workplace.command("ingest", "out", &[]).expect(3).says(&[
        "warning[log_without_truth]",
        "/none",
        "correct `evaluate.truth`",
    ]);
    let (truth, _) = read_poses(&workplace.path("out/truth/monday.parquet")).unwrap();
    assert!(truth.poses().is_empty());
}

#[test]
fn score_gives_the_confidence_of_the_model_for_pairs_of_a_run() {
    let workplace = Workplace::new(SHORT);
    workplace.command("run", "out", &[]).expect(0);
    let path = |name: &str| workplace.path(name).to_str().unwrap().to_owned();
    let (model, run) = (path("out/models/short-discrete/1.0.0/model.json"), path("out"));
    let score = |pairs: &str, more: &[&str]| {
        let pairs = path(pairs);
        let mut args = vec!["score", &model, "--run", &run, "--pairs", &pairs];
        args.extend(more);
        loopboost(&args)
    };
    // The pairs of the run, and their confidences from the features of the run.
    let printed = score("out/pairs.parquet", &[]).expect(0).stdout;
    let loaded = model::load(Path::new(&model)).unwrap();
    let keyframes = support::keyframes(&workplace.path("out"));
    let (pairs, _) = read_pairs(&workplace.path("out/pairs.parquet"), &keyframes).unwrap();
    let features = support::features(&workplace.path("out"));
    let mut lines = printed.lines();
    let header = "query_log,query_scan,reference_log,reference_scan,confidence,label";
    assert_eq!(lines.next(), Some(header));
    for (line, pair) in lines.by_ref().zip(&pairs) {
        let rows = features.row(pair.query).iter().zip(features.row(pair.reference));
        let difference: Vec<f64> = rows.map(|(a, b)| (a - b).abs()).collect();
        let confidence = loaded.classifier.confidence(&difference);
        let label = if 0.0 <= confidence { 1 } else { -1 };
        let id = |k: usize| format!("monday,{}", keyframes[k].id.scan);
        let expected = format!("{},{},{confidence},{label}", id(pair.query), id(pair.reference));
        assert_eq!(line, expected);
    }
    assert_eq!(lines.next(), None);

    // CSV in, Parquet out, with the threshold of an operating point.
    let name = &loaded.operating_points[0].name;
    let points = loaded.operating_points.iter().filter(|point| point.name == *name);
    let threshold = points.map(|point| point.threshold).fold(f64::NEG_INFINITY, f64::max);
    fs::write(workplace.path("pairs.csv"), printed.as_bytes()).unwrap();
    let table = path("scores.parquet");
    score("pairs.csv", &["--out", &table, "--point", name]).expect(0);
    let (scores, made) = read_table(Path::new(&table), "pair_scores").unwrap();
    assert_eq!(scores.num_rows(), pairs.len());
    assert_eq!(made.options["threshold"], threshold);
    assert!(made.inputs.keys().any(|name| name == "scans/monday.parquet"), "{:?}", made.inputs);

    // Errors name what is wrong and what to do.
    score("pairs.csv", &["--point", "no such point"]).expect(2).says(&["no such point", name]);
    fs::write(workplace.path("other.csv"), printed.replace("monday", "tuesday")).unwrap();
    score("other.csv", &[]).expect(1).says(&["scans/tuesday.parquet", "--run"]);
    fs::write(workplace.path("beyond.csv"), format!("{header}\nmonday,1,monday,99999999,0,1\n"))
        .unwrap();
    score("beyond.csv", &[]).expect(1).says(&["scans/monday.parquet", "99999999"]);
    fs::write(workplace.path("empty.csv"), header).unwrap();
    score("empty.csv", &[]).expect(1).says(&["has no pairs"]);
}
