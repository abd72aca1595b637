//! Faults of labels: copies of a log, two floors, one place with most of the pairs, and numbers that
//! claim more than the data shows.

use std::f64::consts::PI;
use std::fs;

use dataset::Label;
use dataset::tables::read_pairs;

use crate::made::{Message, Schema, log};
use crate::support::{self, Workplace};
use crate::wire::{Encoding, RosMessage};

const SIMULATED: &str = r#"
seed = 7
[simulate]
logs = ["monday"]
length_m = 40.0
people = 0
"#;

const COPIES: &str = r#"
[ingest]
logs = ["logs"]
site = "building"
pose.topic = "/ground_truth"
"#;

/// A folder `logs` with the log `monday`.
fn monday() -> Workplace {
    let workplace = Workplace::new(SIMULATED);
    workplace.command("simulate", ".", &[]).expect(0);
    fs::write(workplace.path("drive.toml"), COPIES).unwrap();
    workplace
}

#[test]
fn a_copy_of_a_log_is_reported_and_the_log_is_used_once() {
    let workplace = monday();
    let monday = workplace.path("logs/monday.mcap");
    // Sorted by name, the copies come before and after the log.
    fs::copy(&monday, workplace.path("logs/backup.mcap")).unwrap();
    std::os::unix::fs::symlink(&monday, workplace.path("logs/tuesday.mcap")).unwrap();
    let finished = workplace.command("ingest", "out", &[]).expect(3);
    let finished = finished.says(&[
        "warning[duplicate_log]: 2 logs with the same bytes as log `backup` (equal BLAKE3 digests): only `backup` is used in 2 logs (`monday`, `tuesday`)",
    ]);
    assert_eq!(finished.stdout.lines().count(), 1, "{}", finished.stdout);
    let names: Vec<String> = workplace.files("out").into_keys().collect();
    let scans: Vec<_> = names.iter().filter(|name| name.starts_with("scans/")).collect();
    assert_eq!(scans, ["scans/backup.parquet"]);

    // Stages that run alone, and later runs, leave the copies out too.
    let finished = workplace.command("subsample", "out", &[]).expect(0);
    assert!(finished.stdout.contains("backup: ") && !finished.stdout.contains("monday: "));
    workplace.command("ingest", "out", &[]).expect(3).says(&["duplicate_log"]);

    // If the first of them is removed, another one is used.
    fs::remove_file(workplace.path("logs/backup.mcap")).unwrap();
    let finished = workplace.command("ingest", "out", &[]).expect(3);
    finished.says(&["log `monday` (equal BLAKE3 digests)", "log `tuesday`"]);
    fs::remove_file(workplace.path("logs/tuesday.mcap")).unwrap();
    workplace.command("ingest", "out", &[]).expect(0);
}

/// Two logs of equal size that differ in one byte are two logs.
#[test]
fn logs_of_equal_size_are_not_copies_if_a_byte_differs() {
    let workplace = monday();
    let mut bytes = fs::read(workplace.path("logs/monday.mcap")).unwrap();
    // A character of the library name in the header, which no reader uses.
    let place = bytes.windows(9).position(|name| name == b"loopboost").unwrap();
    bytes[place] = b'L';
    fs::write(workplace.path("logs/tuesday.mcap"), bytes).unwrap();
    let finished = workplace.command("ingest", "out", &[]);
    assert!(!finished.stderr.contains("duplicate_log"), "{}", finished.stderr);
    assert_eq!(finished.stdout.lines().count(), 2, "{}", finished.stdout);
}

const START_NS: i64 = 1_700_000_000_000_000_000;

const PIPELINE: &str = r#"
seed = 7
[ingest]
logs = ["logs"]
site = "building"
pose.topic = "/pose"
lidar.topic = "/scan"
[label]
pairs_per_class = 100
[train]
learners = ["discrete"]
rounds = 3
[evaluate]
groupings = ["pair"]
resamples = 50
"#;

/// A pose and a scan every 0.3 s along x, y and z. The scan shows walls that depend on the position.
fn drive(path: &[[f64; 3]]) -> Vec<Message> {
    let encoding = Encoding::Cdr;
    let mut messages = Vec::new();
    for (k, &[x_m, y_m, z_m]) in path.iter().enumerate() {
        let stamp_ns = START_NS + k as i64 * 300_000_000;
        let [next_x_m, next_y_m, _] = path[(k + 1).min(path.len() - 1)];
        let half_rad = (next_y_m - y_m).atan2(next_x_m - x_m) / 2.0;
        let pose = RosMessage::with_header(encoding, stamp_ns).f64s(&[x_m, y_m, z_m]).f64s(&[
            0.0,
            0.0,
            half_rad.sin(),
            half_rad.cos(),
        ]);
        let increment = (PI / 30.0) as f32;
        let range = |beam: i32| {
            let wave = f64::from(beam % 7) * x_m / 9.0 + f64::from(beam % 5) * y_m / 7.0;
            5.0 + 2.0 * wave.sin() as f32
        };
        let scan = RosMessage::with_header(encoding, stamp_ns)
            .f32(-PI as f32)
            .f32(-PI as f32 + 59.0 * increment)
            .f32(increment)
            .f32(0.0)
            .f32(0.3)
            .f32(0.1)
            .f32(60.0)
            .f32_sequence(&(0..60).map(range).collect::<Vec<f32>>())
            .f32_sequence(&[]);
        let message =
            |topic, type_name, data| Message { topic, type_name, encoding, stamp_ns, data };
        messages.push(message("/pose", "geometry_msgs/PoseStamped", pose.finish()));
        messages.push(message("/scan", "sensor_msgs/LaserScan", scan.finish()));
    }
    messages
}

/// Laps of 180 m around a rectangle of 60 by 30 m, a pose every 0.75 m. `z_m` is the height after a
/// path length.
fn laps(n_laps: usize, z_m: impl Fn(f64) -> f64) -> Vec<[f64; 3]> {
    let at = |k: usize| {
        let path_m = 0.75 * k as f64;
        let side_m = path_m % 180.0;
        let [x_m, y_m] = match side_m {
            s if s < 60.0 => [s, 0.0],
            s if s < 90.0 => [60.0, s - 60.0],
            s if s < 150.0 => [150.0 - s, 30.0],
            s => [0.0, 180.0 - s],
        };
        [x_m, y_m, z_m(path_m)]
    };
    (0..n_laps * 240).map(at).collect()
}

/// A folder with a pipeline and these logs.
fn workplace(logs: &[(&str, &[[f64; 3]])]) -> Workplace {
    let workplace = Workplace::new(PIPELINE);
    fs::create_dir(workplace.path("logs")).unwrap();
    for (name, path) in logs {
        let bytes = log(&drive(path), Schema::Empty);
        fs::write(workplace.path(&format!("logs/{name}.mcap")), bytes).unwrap();
    }
    workplace
}

/// The positive pairs of a run with the heights of both scans \[m\] and the path between them \[m\].
fn positives(workplace: &Workplace) -> Vec<([f64; 2], f64)> {
    let keyframes = support::keyframes(&workplace.path("out"));
    let (pairs, _) = read_pairs(&workplace.path("out/pairs.parquet"), &keyframes).unwrap();
    let height = |k: usize| keyframes[k].z_m.expect("a height");
    let positives = pairs.iter().filter(|pair| pair.label == Label::Positive);
    positives.map(|p| ([height(p.query), height(p.reference)], p.travel_gap_m)).collect()
}

fn spread(workplace: &Workplace, class: usize) -> serde_json::Value {
    let text = fs::read(workplace.path("out/evaluation/summary.json")).unwrap();
    serde_json::from_slice::<serde_json::Value>(&text).unwrap()["spread"][class].clone()
}

/// One lap on each of two floors 4 m apart, with a ramp of 10 % in between, and two laps with a
/// lift in between.
#[test]
fn scans_of_two_floors_are_not_the_same_place() {
    let ramp = |path_m: f64| ((path_m - 180.0) / 10.0).clamp(0.0, 4.0);
    let lift = |path_m: f64| if path_m < 180.0 { 0.0 } else { 4.0 };
    for (path, says) in [(laps(2, ramp), "at another height"), (laps(2, lift), "not used")] {
        let workplace = workplace(&[("a", &path)]);
        let finished = workplace.command("ingest", "out", &[]);
        assert!(matches!(finished.code, 0 | 3), "{}", finished.stderr);
        workplace.command("subsample", "out", &[]);
        let finished = workplace.command("label", "out", &[]);
        assert!(finished.stdout.contains(says), "{}", finished.stdout);
        let positives = positives(&workplace);
        assert_eq!(positives.len(), 100);
        for ([a, b], _) in positives {
            assert!((a - b).abs() <= 2.5, "heights {a} m and {b} m are one place");
        }
    }
}

/// Three laps over a hill of 8 m, with a drift of 0.6 m per lap: revisits are positives.
#[test]
fn a_hill_with_drift_keeps_its_revisits() {
    let hill = |path_m: f64| 4.0 * (2.0 * PI * path_m / 180.0).sin() + 0.6 * path_m / 180.0;
    let workplace = workplace(&[("a", &laps(3, hill))]);
    workplace.command("ingest", "out", &[]).expect(0);
    workplace.command("subsample", "out", &[]).expect(0);
    let set = ["--set", "label.min_travel_gap_m=10"];
    let finished = workplace.command("label", "out", &set).expect(0);
    assert!(!finished.stdout.contains("at another height"), "{}", finished.stdout);
    assert!(positives(&workplace).iter().all(|&(_, travel_gap_m)| 10.0 <= travel_gap_m));
}

/// A drift of 5 m per lap leaves out every revisit. The message says so, and what to do.
#[test]
fn heights_that_drift_too_far_are_reported() {
    let workplace = workplace(&[("a", &laps(2, |path_m| path_m / 36.0))]);
    workplace.command("ingest", "out", &[]).expect(0);
    workplace.command("subsample", "out", &[]).expect(0);
    let finished = workplace.command("label", "out", &[]).expect(3);
    finished.says(&["warning[heights_in_doubt]", "raise `label.max_height_difference_m`"]);
    let raised = ["--set", "label.max_height_difference_m=12"];
    workplace.command("label", "out", &raised).expect(0);
}

/// A lap, then 15 times to and fro over 4 m at its start.
#[test]
fn one_place_does_not_fill_the_set() {
    let mut path = laps(1, |_| 0.0);
    for k in 0..15 {
        let there = (0..6).map(|k| 0.75 * f64::from(k));
        let way: Vec<f64> = if k % 2 == 0 { there.collect() } else { there.rev().collect() };
        path.extend(way.into_iter().map(|x_m| [x_m, 0.0, 0.0]));
    }
    let workplace = workplace(&[("a", &path)]);
    let finished = workplace.command("run", "out", &[]).expect(0);
    let finished = finished.says(&["info[place_share_limited]: at most 10 of 100 positive pairs"]);
    assert!(finished.stderr.contains("at (2.5, 2.5) m of site `building`"), "{}", finished.stderr);
    for class in 0..2 {
        let spread = spread(&workplace, class);
        assert!(spread["largest_share"].as_f64().unwrap() <= 0.1, "{spread}");
        assert!(9 < spread["n_places"].as_u64().unwrap(), "{spread}");
    }
    let report = fs::read_to_string(workplace.path("out/report.html")).unwrap();
    assert!(report.contains("Labelled pairs") && report.contains("neighbours along the path"));

    // Without the limit, the spot has most of the pairs.
    workplace.command("run", "out", &["--set", "label.max_place_share=1"]).expect(0);
    let share = spread(&workplace, 0)["largest_share"].as_f64().unwrap();
    assert!(0.5 < share, "{share}");
}

/// The same messages in a file with other bytes.
#[test]
fn a_copy_with_other_bytes_is_reported() {
    let path = laps(1, |_| 0.0);
    let workplace = workplace(&[("monday", &path)]);
    let copy = log(&drive(&path), Schema::Truncated);
    fs::write(workplace.path("logs/monday-2.mcap"), copy).unwrap();
    workplace.command("ingest", "out", &[]).expect(0);
    workplace.command("subsample", "out", &[]).expect(3);
    let finished = workplace.command("label", "out", &[]).expect(3);
    finished.says(&[
        "warning[same_scans_in_two_logs]",
        "in log `monday` (100 % of the shorter log)",
        "(log `monday-2`)",
    ]);
}

/// Two logs of a site cannot be held out one by one. Without `place`, the report says that the result
/// is not validated on unseen ground; with it, it does not.
#[test]
fn the_report_states_what_was_not_validated() {
    let [a, b] = [0.0, 0.3].map(|shift_m| {
        let moved = |[x_m, y_m, z_m]: [f64; 3]| [x_m + shift_m, y_m, z_m];
        laps(1, |_| 0.0).into_iter().map(moved).collect::<Vec<_>>()
    });
    let workplace = workplace(&[("a", &a), ("b", &b)]);
    let set = ["--set", "evaluate.groupings=['pair', 'log']"];
    let finished = workplace.command("run", "out", &set).expect(3);
    let finished =
        finished.says(&["warning[two_groups]: grouping `log` not evaluated: ", "add a third"]);
    let line = "evaluate   not validated on unseen ground";
    assert!(finished.stdout.contains(line), "{}", finished.stdout);
    let report = || fs::read_to_string(workplace.path("out/report.html")).unwrap();
    let statement = "Not validated on unseen ground";
    assert!(report().contains(statement));
    assert!(report().contains("<code>evaluate.groupings</code> does not contain"));
    let card = fs::read_dir(workplace.path("out/models")).unwrap().next().unwrap().unwrap().path();
    let card = fs::read_to_string(card.join("1.0.0/card.md")).unwrap();
    assert!(card.contains(statement), "{card}");

    // One square of ground is too few.
    let one = ["--set", "evaluate.groupings=['pair', 'place']", "--set", "evaluate.place_m=500"];
    workplace.command("run", "out", &one).expect(3).says(&["warning[too_few_groups]"]);
    assert!(report().contains(statement) && report().contains("it needs 2 places or more"));

    let smaller =
        ["evaluate.groupings=['place']", "evaluate.place_m=10", "label.negative_min_m=30"];
    let place: Vec<&str> = smaller.iter().flat_map(|&set| ["--set", set]).collect();
    workplace.command("run", "out", &place).expect(0);
    assert!(!report().contains(statement));

    // Retrieval with few pairs has few matches.
    let few = [&place[..], &["--set", "evaluate.max_pairs=1000"]].concat();
    let finished = workplace.command("run", "out", &few).expect(3);
    finished.says(&["warning[few_matches_scored]", "raise `evaluate.max_pairs`"]);
}
