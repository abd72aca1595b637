//! Simulated logs, read by other programs.

use std::path::Path;
use std::process::Command;

use crate::require::{mcap_command, python_with, shared_data};
use crate::support::{Workplace, loopboost, root};

const CAMPUS: &str = r#"
seed = 7
[simulate]
logs = ["one", "two"]
buildings = 3
lasers = "all"
length_m = 10.0
people = 3
[ingest]
site = "campus"
pose.topic = "/ground_truth"
"#;

/// `mcap` (PyPI) decodes every message and finds no faults, with every compression.
#[test]
fn the_mcap_package_finds_no_faults() {
    let workplace = Workplace::new(CAMPUS);
    let modules = ["mcap", "mcap_ros2", "numpy", "pyarrow", "velodyne_decoder"];
    let Some(python) = python_with(&modules) else { return };
    for compression in ["zstd", "lz4", "none"] {
        let set = format!("simulate.compression={compression}");
        workplace.command("simulate", compression, &["--set", &set]).expect(0);
        let script = root().join("tests/peers/simulation.py");
        let mut command = Command::new(&python);
        command.arg(script).arg(workplace.path(&format!("{compression}/logs/one.mcap")));
        if let Some(data) = shared_data(&["logs/hdl32e-street.ros2.mcap"]) {
            command.arg(data.join("logs/hdl32e-street.ros2.mcap"));
        }
        let output = command.output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        println!("{}", String::from_utf8_lossy(&output.stdout));
    }
}

/// `mcap doctor` prints neither warnings nor errors.
#[test]
fn mcap_doctor_finds_no_faults() {
    let Some(mcap) = mcap_command() else { return };
    let workplace = Workplace::new(CAMPUS);
    for (encoding, compression, files) in
        [("ros2", "zstd", 1), ("ros2", "lz4", 1), ("ros2", "none", 2), ("ros1", "zstd", 2)]
    {
        let out = format!("{encoding}-{compression}");
        let sets = [
            format!("simulate.encoding={encoding}"),
            format!("simulate.compression={compression}"),
            format!("simulate.files={files}"),
        ];
        let more: Vec<&str> = sets.iter().flat_map(|set| ["--set", set]).collect();
        workplace.command("simulate", &out, &more).expect(0);
        let logs = match files {
            1 => vec!["logs/one.mcap"],
            _ => vec!["logs/one/one_0.mcap", "logs/one/one_1.mcap"],
        };
        for log in logs {
            check_with_doctor(&mcap, &workplace.path(&out).join(log));
        }
    }
}

/// Checks a log with the `mcap` command.
pub fn check_with_doctor(mcap: &str, log: &Path) {
    let output = Command::new(mcap).args(["doctor", "--strict-message-order"]).arg(log).output();
    let output = output.unwrap();
    let printed = [output.stdout, output.stderr].concat();
    let printed = String::from_utf8_lossy(&printed).to_lowercase();
    let has_no_faults = !printed.contains("warning") && !printed.contains("error");
    assert!(output.status.success() && has_no_faults, "{}: {printed}", log.display());
}

/// The files of a split log are one drive, with the same scans as an unsplit log.
#[test]
fn the_files_of_a_split_log_are_read_as_one_drive() {
    let workplace = Workplace::new(CAMPUS);
    let files = ["--set", "simulate.files=3"];
    workplace.command("simulate", "split", &files).expect(0);
    let finished = workplace.command("ingest", "split", &files).expect(0);
    finished.says(&["read from 3 files of one drive"]);
    workplace.command("simulate", "whole", &[]).expect(0);
    workplace.command("ingest", "whole", &[]).expect(0);
    let scans = |out: &str, log: &str| {
        let path = workplace.path(&format!("{out}/scans/{log}.parquet"));
        dataset::tables::scans::read_scan_headers(&path).unwrap().0
    };
    assert!(50 < scans("split", "one").len() + scans("split", "two").len());
    for log in ["one", "two"] {
        assert_eq!(scans("split", log), scans("whole", log));
    }
}

/// `inspect` lists every topic and reports no missing packets.
#[test]
fn inspect_lists_every_topic() {
    let workplace = Workplace::new(CAMPUS);
    for encoding in ["ros2", "ros1"] {
        let set = format!("simulate.encoding={encoding}");
        workplace.command("simulate", encoding, &["--set", &set]).expect(0);
        let log = workplace.path(&format!("{encoding}/logs/two.mcap"));
        let printed = loopboost(&["inspect", log.to_str().unwrap()]).expect(0).stdout;
        for text in [
            "/velodyne_packets",
            "Velodyne HDL-32E",
            "0 missing",
            "/ground_truth",
            "/imu/data",
            "/wheel_states",
            "/tf",
            "/tf_static",
        ] {
            assert!(printed.contains(text), "`{text}` is not in:\n{printed}");
        }
    }
}
