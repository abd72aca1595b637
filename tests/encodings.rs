//! The same measurements in every encoding give the same scans and poses. `tests/peers/encodings.py`
//! writes the logs with other libraries, from recorded data. The `made_` tests do the same on data made
//! in code.

use std::fs;
use std::path::Path;
use std::process::Command;

use crate::require::{python_with, shared_data};
use crate::support::{Finished, Workplace, loopboost, root};

const DATA: [&str; 3] =
    ["logs/hdl32e-street.ros2.mcap", "logs/mit-killian.mcap", "logs/mit-csail.mcap"];
const MODULES: [&str; 7] = [
    "mcap",
    "mcap_protobuf",
    "foxglove_schemas_protobuf",
    "rosbags",
    "numpy",
    "pyarrow",
    "velodyne_decoder",
];

/// A group of logs, ingested with the same options.
struct Group {
    name: &'static str,
    options: &'static [&'static str],
    /// The ring of the scans; empty if the logs have no clouds.
    ring: &'static str,
    /// The exit code: 3 with logs that lose data or have no schema.
    code: i32,
}

const CLOUDS: &str = "ingest.lidar.topic=/velodyne_points";
const SCANS: &str = "ingest.lidar.topic=/scan";
const POSES: &str = "ingest.pose.topic=/pose";

#[rustfmt::skip]
const GROUPS: [Group; 7] = [
    Group { name: "packets", options: &[], ring: "23", code: 3 },
    Group { name: "lossy", options: &[], ring: "23", code: 3 },
    Group { name: "clouds", options: &[CLOUDS], ring: "23", code: 3 },
    Group { name: "clouds", options: &[CLOUDS, "ingest.lidar.ring=23"], ring: "23", code: 3 },
    Group { name: "clouds", options: &[CLOUDS, "ingest.lidar.elevation_deg=-9.33"], ring: "16", code: 3 },
    Group { name: "planar", options: &[SCANS, POSES], ring: "", code: 0 },
    Group { name: "bare", options: &[SCANS, POSES], ring: "", code: 3 },
];

#[test]
fn every_encoding_gives_the_same() {
    let Some(data) = shared_data(&DATA) else { return };
    let Some(python) = python_with(&MODULES) else { return };
    let workplace = Workplace::new("");
    let logs = workplace.path("logs");
    let script = |args: &[&Path]| {
        let output = Command::new(&python)
            .arg("-B") // writes no bytecode next to the scripts
            .arg(root().join("tests/peers/encodings.py"))
            .args(args)
            .output()
            .unwrap();
        let printed = String::from_utf8_lossy(&output.stdout).into_owned();
        assert!(output.status.success(), "{printed}\n{}", String::from_utf8_lossy(&output.stderr));
        print!("{printed}");
    };
    script(&[Path::new("write"), &data, &logs]);
    let reference = logs.join("packets/reference.mcap");
    ingest(&workplace, "reference", &[reference.display().to_string()], &[]).expect(0);
    let table = workplace.path("reference/scans/reference.parquet");
    fs::copy(table, logs.join("reference.parquet")).unwrap();

    for (k, group) in GROUPS.iter().enumerate() {
        let out = k.to_string();
        let of_group = files(&logs.join(group.name));
        let finished = ingest(&workplace, &out, &of_group, group.options).expect(group.code);
        check_findings(group.name, &workplace.path(&out), &finished);
        check_inspect(group.name, &of_group);
        let [compare, name, ring] = ["compare", group.name, group.ring].map(Path::new);
        let run = workplace.path(&out);
        match group.ring {
            "" => script(&[compare, &logs, name, &run]),
            _ => script(&[compare, &logs, name, &run, ring]),
        }
    }
}

fn ingest(workplace: &Workplace, out: &str, logs: &[String], options: &[&str]) -> Finished {
    let logs = format!("ingest.logs={logs:?}");
    let sets = [logs.as_str()].into_iter().chain(options.iter().copied());
    let args: Vec<&str> = sets.flat_map(|set| ["--set", set]).collect();
    workplace.command("ingest", out, &args)
}

fn files(folder: &Path) -> Vec<String> {
    let mut files: Vec<_> = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path().display().to_string())
        .collect();
    files.sort();
    files
}

/// `inspect` finds what `ingest` can read: a lidar in every log, poses where the log has some.
fn check_inspect(group: &str, logs: &[String]) {
    for log in logs {
        let printed = loopboost(&["inspect", log]).stdout;
        assert!(printed.contains("suggested pipeline"), "{printed}");
        let has_poses = ["planar", "bare"].contains(&group);
        assert_eq!(has_poses, printed.contains("pose.topic = \"/pose\""), "{printed}");
    }
}

/// The run records which logs had no schema and whose packets were put back in order. stderr has the
/// sum of all losses.
fn check_findings(group: &str, run: &Path, finished: &Finished) {
    let text = fs::read_to_string(run.join("run.json")).unwrap();
    let run: serde_json::Value = serde_json::from_str(&text).unwrap();
    let tasks = run["tasks"].as_object().unwrap();
    for (task, made) in tasks {
        let notes = made["notes"].as_array().unwrap();
        let has = |code: &str| notes.iter().any(|note| note["code"] == code);
        assert_eq!(has("no_schema"), task.ends_with("-schema-none"), "{task}");
        let is_late = task.contains("shuffled-") || task.contains("all-");
        assert_eq!(has("packets_reordered"), is_late, "{task}");
    }
    let has_bare = tasks.keys().any(|task| task.ends_with("-schema-none"));
    assert_eq!(has_bare, ["packets", "clouds", "bare"].contains(&group), "{group}");
    if group == "lossy" {
        // Six of the 18 logs have 72 duplicate packets and six have 10 position packets. The other
        // six have both; there, one of the duplicates is a position packet: 72 and 11.
        let expected =
            ["864 duplicate packets", "126 packets without the layout of an HDL-32E data packet"];
        for text in expected {
            assert!(finished.stderr.contains(text), "{}", finished.stderr);
        }
    }
}
