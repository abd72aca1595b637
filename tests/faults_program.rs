//! Faults that the program has to notice over several logs or topics: robots that stand still, pose
//! topics that drift, sites without a map frame, and altered files. `inspect` reports what a run
//! would report.

use std::collections::BTreeSet;
use std::f64::consts::{PI, TAU};
use std::fs;

use messages::ros::{write_laser_scan, write_odometry, write_pose_stamped};
use messages::{LaserScan, Odometry, StampedPose3};

use crate::made::{Message, Schema, log};
use crate::support::{Finished, Workplace, loopboost};
use crate::wire::Encoding;

const START_NS: i64 = 1_700_000_000_000_000_000;

const PIPELINE: &str = r#"
seed = 7
[ingest]
logs = ["logs"]
lidar.topic = "/scan"
lidar.range_min_m = 0.1
pose.topic = "/pose"
[label]
pairs_per_class = 100
"#;

/// A pose in the plane: x \[m\], y \[m\], heading \[rad\].
type Planar = [f64; 3];

/// Two laps of 160 m around a square with sides of 40 m, a pose every half metre.
fn two_laps() -> Vec<Planar> {
    let at = |k: u32| {
        let along_m = f64::from(k % 320) * 0.5;
        match along_m {
            s if s < 40.0 => [s, 0.0, 0.0],
            s if s < 80.0 => [40.0, s - 40.0, PI / 2.0],
            s if s < 120.0 => [120.0 - s, 40.0, PI],
            s => [0.0, 160.0 - s, -PI / 2.0],
        }
    };
    (0..640).map(at).collect()
}

/// The same path by odometry whose second lap is 5 m off.
fn drifted(path: &[Planar]) -> Vec<Planar> {
    let half = path.len() / 2;
    let drift_m = |k: usize| 5.0 * ((k as f64 - half as f64 + 60.0) / 60.0).clamp(0.0, 1.0);
    path.iter().enumerate().map(|(k, &[x, y, h])| [x, y + drift_m(k), h]).collect()
}

fn stamp_ns(k: usize) -> i64 {
    START_NS + k as i64 * 250_000_000
}

fn pose3(stamp_ns: i64, [x, y, heading]: Planar) -> StampedPose3 {
    let orientation = [0.0, 0.0, (heading / 2.0).sin(), (heading / 2.0).cos()];
    StampedPose3 { stamp_ns, position: [x, y, 0.0], orientation }
}

pub fn message(
    topic: &'static str,
    type_name: &'static str,
    stamp_ns: i64,
    data: Vec<u8>,
) -> Message {
    Message { topic, type_name, encoding: Encoding::Cdr, stamp_ns, data }
}

/// `PoseStamped` messages, four per second.
fn poses(topic: &'static str, frame: &str, path: &[Planar]) -> Vec<Message> {
    let of = |(k, &at): (usize, &Planar)| {
        let pose = pose3(stamp_ns(k), at);
        let data = write_pose_stamped(messages::Encoding::Cdr, frame, &pose);
        message(topic, "geometry_msgs/PoseStamped", stamp_ns(k), data)
    };
    path.iter().enumerate().map(of).collect()
}

/// `Odometry` messages, eight per second: twice as many as the poses.
fn odometry(topic: &'static str, frame: &str, path: &[Planar]) -> Vec<Message> {
    let at_half = |k: usize| {
        let [a, b] = [path[k / 2], path[(k / 2 + 1).min(path.len() - 1)]];
        let share = (k % 2) as f64 / 2.0;
        [a[0] + share * (b[0] - a[0]), a[1] + share * (b[1] - a[1]), a[2]]
    };
    let of = |k: usize| {
        let stamp_ns = START_NS + k as i64 * 125_000_000;
        let odometry = Odometry {
            pose: pose3(stamp_ns, at_half(k)),
            frame_id: frame.to_owned(),
            child_frame_id: "base_link".to_owned(),
            pose_covariance: [0.0; 36],
            linear_velocity: [2.0, 0.0, 0.0],
            angular_velocity: [0.0; 3],
        };
        let data = write_odometry(messages::Encoding::Cdr, &odometry);
        message(topic, "nav_msgs/Odometry", stamp_ns, data)
    };
    (0..2 * path.len()).map(of).collect()
}

/// Scans of 72 beams over the full circle, four per second. `is_blind` scans have no returns.
fn scans(frame: &str, path: &[Planar], is_blind: bool) -> Vec<Message> {
    let of = |(k, &[x, y, _]): (usize, &Planar)| {
        let range = |beam: i32| {
            let wave = f64::from(beam % 7) * x / 9.0 + f64::from(beam % 5) * y / 7.0;
            if is_blind { f32::INFINITY } else { 5.0 + 2.0 * wave.sin() as f32 }
        };
        let scan = laser_scan(stamp_ns(k), (0..72).map(range).collect());
        let data = write_laser_scan(messages::Encoding::Cdr, frame, &scan);
        message("/scan", "sensor_msgs/LaserScan", stamp_ns(k), data)
    };
    path.iter().enumerate().map(of).collect()
}

fn laser_scan(stamp_ns: i64, ranges: Vec<f32>) -> LaserScan {
    let angle_increment = TAU / 72.0;
    LaserScan {
        stamp_ns,
        angle_min: -PI,
        angle_max: Some(-PI + 71.0 * angle_increment),
        angle_increment,
        time_increment_s: 0.0,
        range_min: 0.1,
        range_max: 60.0,
        ranges,
    }
}

/// A log of these messages, in the order of their stamps.
fn made(topics: Vec<Vec<Message>>) -> Vec<u8> {
    let mut messages: Vec<Message> = topics.into_iter().flatten().collect();
    messages.sort_by_key(|message| message.stamp_ns);
    log(&messages, Schema::Empty)
}

/// A folder with the logs in `logs`.
fn workplace(pipeline: &str, logs: &[(&str, Vec<u8>)]) -> Workplace {
    let workplace = Workplace::new(pipeline);
    fs::create_dir(workplace.path("logs")).unwrap();
    for (name, bytes) in logs {
        fs::write(workplace.path(&format!("logs/{name}.mcap")), bytes).unwrap();
    }
    workplace
}

/// A drive with correct poses in the frame `map`.
fn good() -> Vec<u8> {
    let path = two_laps();
    made(vec![poses("/pose", "map", &path), scans("laser", &path, false)])
}

#[test]
fn a_log_that_stands_still_or_sees_nothing_is_left_out_and_named() {
    let path = two_laps();
    let still = vec![[3.0, 4.0, 0.5]; 40];
    let dock = made(vec![poses("/pose", "map", &still), scans("laser", &still, false)]);
    let blind = made(vec![poses("/pose", "map", &path), scans("laser", &path, true)]);
    let logs = [("blind", blind), ("dock", dock), ("good", good())];
    let workplace = workplace(PIPELINE, &logs);
    workplace.command("ingest", "out", &[]);
    let finished = workplace.command("subsample", "out", &[]).expect(3);
    assert!(finished.stdout.contains("good: "), "{}", finished.stdout);
    finished.says(&["log `dock` left out of the run", "(never_moves) (log `dock`)"]);
    workplace.command("subsample", "out", &["--strict"]).expect(1).says(&["log `"]);
    // The whole run leaves both out. The error of a later stage lists them.
    let finished = workplace.command("run", "whole", &["--set", "label.pairs_per_class=90000"]);
    finished.expect(1).says(&[
        "label.pairs_per_class",
        "before this error, the earlier stages reported:",
        "(log `dock`)",
        "(log `blind`)",
    ]);
    // Without another log, the run fails.
    for name in ["good", "blind"] {
        fs::remove_file(workplace.path(&format!("logs/{name}.mcap"))).unwrap();
    }
    workplace.command("run", "alone", &[]).expect(1).says(&["log `dock`: its 40 poses stay"]);
}

/// The odometry has twice as many messages, and both are called by neutral names.
#[test]
fn inspect_suggests_the_poses_that_do_not_drift() {
    let path = two_laps();
    let log = made(vec![
        odometry("/a/state", "robot/odom", &drifted(&path)),
        poses("/b/state", "robot/map", &path),
        scans("laser", &path, false),
    ]);
    let workplace = workplace("", &[("a", log)]);
    let (log, written) = (workplace.path("logs/a.mcap"), workplace.path("drive.toml"));
    fs::remove_file(&written).unwrap();
    let args = ["inspect", log.to_str().unwrap(), "--write", written.to_str().unwrap()];
    loopboost(&args).expect(3).says(&["warning[pose_topics_disagree]: ", "`/a/state`"]);
    let text = fs::read_to_string(&written).unwrap();
    for line in
        ["\npose.topic = \"/b/state\"", "# pose.topic = \"/a/state\"", "min_travel_gap_m = 10"]
    {
        assert!(text.contains(line), "`{line}` is not in:\n{text}");
    }
    // Such a square has places 50 m apart, and all stages up to the labels accept the pipeline.
    for stage in ["ingest", "subsample", "label"] {
        let finished = workplace.command(stage, "out", &[]);
        assert!([0, 3].contains(&finished.code), "{stage}: {}", finished.stderr);
    }
}

/// Codes of the losses and notes in the JSON of `inspect`.
fn codes(finished: &Finished) -> BTreeSet<String> {
    let json: serde_json::Value = serde_json::from_str(&finished.stdout).unwrap();
    let lists = ["losses", "notes"].map(|list| json[list].as_array().unwrap().clone());
    lists.iter().flatten().map(|of| of["code"].as_str().unwrap().to_owned()).collect()
}

/// The warnings that `ingest` prints, by code.
fn warnings(finished: &Finished) -> BTreeSet<String> {
    let code = |line: &str| {
        let (severity, rest) = line.split_once('[')?;
        let is_warning = ["warning", "error"].contains(&severity);
        is_warning.then(|| rest.split(']').next().unwrap_or_default().to_owned())
    };
    finished.stderr.lines().filter_map(code).collect()
}

#[test]
fn inspect_reports_what_ingest_warns_about() {
    let path = two_laps();
    let mut jumping = path.clone();
    jumping[200..].iter_mut().for_each(|[x, _, _]| *x += 30.0);
    let mut absurd = path.clone();
    absurd[100][0] = 1e300;
    let mut late = path.clone();
    late.truncate(300);
    let logs = [
        ("absurd", made(vec![poses("/pose", "map", &absurd), scans("l", &path, false)])),
        ("jumping", made(vec![poses("/pose", "map", &jumping), scans("l", &path, false)])),
        ("late", made(vec![poses("/pose", "map", &late), scans("l", &path, false)])),
    ];
    for (name, log) in logs {
        let workplace = workplace("", &[(name, log)]);
        let (log, written) =
            (workplace.path(&format!("logs/{name}.mcap")), workplace.path("drive.toml"));
        fs::remove_file(&written).unwrap();
        let log = log.to_str().unwrap();
        let inspected = codes(&loopboost(&["inspect", log, "--json"]).expect(3));
        loopboost(&["inspect", log, "--write", written.to_str().unwrap()]).expect(3);
        let mut warned = warnings(&workplace.command("ingest", "out", &[]));
        warned.extend(warnings(&workplace.command("subsample", "out", &[])));
        assert!(!warned.is_empty(), "{name}");
        assert!(warned.is_subset(&inspected), "{name}: {warned:?}, but inspect: {inspected:?}");
    }
}

/// A pipeline that `ingest` refuses is not written, and inspect says why.
#[test]
fn inspect_does_not_suggest_a_pipeline_that_a_stage_refuses() {
    let path = two_laps();
    let blind = made(vec![poses("/pose", "map", &path), scans("laser", &path, true)]);
    let workplace = workplace("", &[("blind", blind)]);
    let (log, written) = (workplace.path("logs/blind.mcap"), workplace.path("written.toml"));
    let log = log.to_str().unwrap();
    let finished = loopboost(&["inspect", log]).expect(3);
    assert!(finished.stdout.contains("`loopboost run` refuses it"), "{}", finished.stdout);
    finished.says(&["error[pipeline_refused]: "]);
    let args = ["inspect", log, "--write", written.to_str().unwrap()];
    loopboost(&args).expect(1).says(&["cannot suggest a pipeline for", "fails: "]);
    assert!(!written.exists());
}

#[test]
fn logs_of_one_site_need_a_common_map_frame() {
    let path = two_laps();
    // The second drive is shorter: it is not a copy of the first.
    let drive = |frame: &str, start_m: f64, n_poses: usize| {
        let path: Vec<Planar> =
            path[..n_poses].iter().map(|&[x, y, h]| [x + start_m, y, h]).collect();
        made(vec![poses("/pose", frame, &path), scans("laser", &path, false)])
    };
    let subsampled = |frames: [&str; 2], starts_m: [f64; 2], site: &str| {
        let logs =
            [("a", drive(frames[0], starts_m[0], 640)), ("b", drive(frames[1], starts_m[1], 560))];
        let workplace = workplace(PIPELINE, &logs);
        let site = format!("ingest.site={site}");
        let set = if site.ends_with('=') { vec![] } else { vec!["--set", &*site] };
        workplace.command("ingest", "out", &set).expect(0);
        let finished = workplace.command("subsample", "out", &set);
        // The notes are stored: the report of a later stage repeats them.
        (finished.code, warnings(&finished).into_iter().collect::<Vec<_>>())
    };
    let expected = |code: &str| (3, vec![code.to_owned()]);
    let odometry = ["r1/odom", "r1/odom"];
    assert_eq!(subsampled(odometry, [7.0, 0.0], "x"), expected("site_in_odometry_frame"));
    assert_eq!(subsampled(["map", "odom"], [7.0, 5.0], "x"), expected("site_in_odometry_frame"));
    assert_eq!(subsampled(["map", "map"], [0.0, 0.05], "x"), expected("site_starts_at_origin"));
    assert_eq!(subsampled(["map", "map"], [0.0, 7.0], "x"), (0, vec![]));
    assert_eq!(subsampled(odometry, [0.0, 0.0], ""), (0, vec![]), "each log is its own site");
}

#[test]
fn a_table_that_was_altered_is_refused_by_the_next_stage() {
    let workplace = workplace(PIPELINE, &[("good", good())]);
    workplace.command("ingest", "out", &[]).expect(0);
    workplace.command("subsample", "out", &[]).expect(0);
    workplace.command("label", "out", &[]).expect(0);
    // Another valid table, with the same provenance.
    let keyframes = workplace.path("out/keyframes/good.parquet");
    let set = ["--set", "subsample.spacing_m=0.5", "--set", "seed=7"];
    workplace.command("ingest", "other", &set).expect(0);
    workplace.command("subsample", "other", &set).expect(0);
    let mut bytes = fs::read(workplace.path("other/keyframes/good.parquet")).unwrap();
    assert_eq!(bytes, fs::read(&keyframes).unwrap());
    let place = bytes.len() / 2;
    bytes[place] ^= 1;
    fs::write(&keyframes, bytes).unwrap();
    workplace.command("label", "out", &[]).expect(1).says(&[
        "keyframes/good.parquet was altered after `subsample` wrote it",
        "loopboost subsample",
    ]);
    workplace.command("subsample", "out", &[]).expect(0);
    workplace.command("label", "out", &[]).expect(0);
}

#[test]
fn wrong_command_lines_and_pipelines_exit_with_2() {
    let workplace = workplace(PIPELINE, &[("good", good())]);
    workplace.command("simulate", "out", &[]).expect(2).says(&["no [simulate] section"]);
    fs::create_dir(workplace.path("logs/more")).unwrap();
    fs::write(workplace.path("logs/more/good.mcap"), good()).unwrap();
    let entries = ["--set", "ingest.logs=['logs/good.mcap', 'logs/good.mcap']"];
    let finished = workplace.command("ingest", "out", &entries).expect(2);
    finished.says(&["two logs are named `logs/good`", "logs/good.mcap and ", "rename one"]);
}

/// All stamps of the poses are 0. The log times show that the robot moves, and the pipeline uses them.
#[test]
fn inspect_suggests_log_times_for_poses_without_stamps() {
    let path = two_laps();
    let mut unstamped = poses("/pose", "map", &path);
    for (k, message) in unstamped.iter_mut().enumerate() {
        message.data = write_pose_stamped(messages::Encoding::Cdr, "map", &pose3(0, path[k]));
    }
    let workplace = workplace("", &[("a", made(vec![unstamped, scans("laser", &path, false)]))]);
    let finished = loopboost(&["inspect", workplace.path("logs/a.mcap").to_str().unwrap()]);
    for line in ["640 of 640 stamps are 0", "pose.topic = \"/pose\"", "pose.stamp = \"log\""] {
        assert!(finished.stdout.contains(line), "`{line}` is not in:\n{}", finished.stdout);
    }
    assert!(!finished.stdout.contains("refused: `ingest`"), "{}", finished.stdout);
}
