//! Faults of files: other formats, compressed logs, and trajectories from other programs.

use std::fs;
use std::path::Path;

use dataset::Trajectory;
use dataset::tables::read_poses;

use crate::support::{Workplace, loopboost};

const ZSTD: &[u8] = b"\x28\xB5\x2F\xFD\x60";
const CARMEN: &[u8] = b"# a log\nODOM 0 0 0 0 0 0 1.0 h 0\n";

#[test]
fn inspect_and_ingest_name_the_format_of_a_file_and_the_command_that_reads_it() {
    let workplace = Workplace::new("");
    for (name, content, format, command) in [
        ("a.mcap.zstd", ZSTD, "is compressed with Zstandard", "`zstd -d {in} -o {stem}.mcap`"),
        ("b.mcap.lz4", b"\x04\x22\x4D\x18", "is compressed with LZ4", "`lz4 -d {in} {stem}.mcap`"),
        ("c.mcap.gz", b"\x1F\x8B\x08", "is compressed with gzip", "`gzip -dc {in} > {stem}.mcap`"),
        (
            "d.pcap",
            b"\xD4\xC3\xB2\xA1",
            "capture (pcap)",
            "`loopboost import {in} --out {stem}.mcap`",
        ),
        ("e.pcapng", b"\x0A\x0D\x0D\x0A", "capture (pcapng)", "`loopboost import {in} --out"),
        ("f.bag", b"#ROSBAG V2.0\n", "is a ROS 1 bag", "`loopboost import {in} --out {stem}.mcap`"),
        (
            "g.db3",
            b"SQLite format 3\0",
            "an SQLite database",
            "`loopboost import {in} --out {stem}.mcap`",
        ),
        ("h.rawlog", b"\x1F\x8B\x08", "an MRPT rawlog", "`rawlog-edit --info -i {in}`"),
        (
            "k.mcap",
            b"#ROSBAG V2.0\n",
            "is a ROS 1 bag",
            "`loopboost import {in} --out {stem}.converted.mcap`",
        ),
        ("i", b"\x8DCSensoryFrame\x02", "an MRPT rawlog", "`rawlog-edit --info -i {in}`"),
        ("j.log", CARMEN, "is a CARMEN log", "`loopboost import {in} --out {stem}.mcap`"),
        ("groundtruth_2013-01-10.csv", b"1,2,3\n", "NCLT data set", "`loopboost import {in} --out"),
    ] {
        let path = workplace.path(name);
        fs::write(&path, content).unwrap();
        let path = path.to_str().unwrap();
        let stem = path.trim_end_matches(".lz4").trim_end_matches(".zstd").trim_end_matches(".gz");
        let stem = Path::new(stem).with_extension("").to_string_lossy().into_owned();
        let command = command.replace("{in}", path).replace("{stem}", &stem);
        let says = ["is not an MCAP file", format, &command];
        loopboost(&["inspect", path]).expect(1).says(&says);
        let logs = format!("ingest.logs=[{path:?}]");
        workplace.command("ingest", "out", &["--set", &logs]).expect(1).says(&says);
    }
}

/// rosbag2 with `--compression-mode file` leaves a folder with `bag_0.mcap.zstd`.
#[test]
fn a_folder_with_other_recordings_names_them() {
    let workplace = Workplace::new("");
    let folder = |name: &str, file: &str, content: &[u8]| {
        fs::create_dir(workplace.path(name)).unwrap();
        fs::write(workplace.path(name).join(file), content).unwrap();
        workplace.path(name).to_str().unwrap().to_owned()
    };
    let bag = folder("bag", "bag_0.mcap.zstd", ZSTD);
    loopboost(&["inspect", &bag]).expect(1).says(&["bag_0.mcap.zstd is not", "`zstd -d "]);
    let sqlite = folder("sqlite", "bag_0.db3", b"SQLite format 3\0");
    loopboost(&["inspect", &sqlite]).expect(1).says(&["is a ROS 2 bag", "`loopboost import "]);
    let logs = format!("ingest.logs=[{sqlite:?}]");
    workplace.command("ingest", "out", &["--set", &logs]).expect(1).says(&["`loopboost import "]);
    let nclt = folder("nclt", "groundtruth_2013-01-10.csv", b"1,2,3\n");
    loopboost(&["inspect", &nclt]).expect(1).says(&["is NCLT data", "`loopboost import "]);
}

const DRIVE: &str = r#"
seed = 7
[simulate]
logs = ["one"]
length_m = 20.0
people = 0
"#;

/// Writes poses in TUM format, with full precision.
fn tum(poses: &Trajectory, from: impl Fn(f64, f64) -> [f64; 4]) -> String {
    let line = |pose: &dataset::StampedPose| {
        let (sin, cos) = (pose.pose.heading_rad / 2.0).sin_cos();
        let [a, b, c, d] = from(sin, cos);
        let (s, ns) = (pose.stamp_ns / 1_000_000_000, pose.stamp_ns % 1_000_000_000);
        format!("{s}.{ns:09} {} {} 0 {a} {b} {c} {d}\n", pose.pose.x_m, pose.pose.y_m)
    };
    poses.poses().iter().map(line).collect()
}

fn poses(workplace: &Workplace, out: &str) -> Trajectory {
    read_poses(&workplace.path(&format!("{out}/poses/one.parquet"))).unwrap().0
}

#[test]
fn a_trajectory_file_gives_the_poses_and_a_changed_file_repeats_the_stage() {
    let workplace = Workplace::new(DRIVE);
    workplace.command("simulate", "out", &[]).expect(0);
    let logs = "[ingest]\nlogs = [\"out/logs/one.mcap\"]\n";
    let with =
        |pose: &str| fs::write(workplace.path("drive.toml"), logs.to_owned() + pose).unwrap();
    with("pose.topic = \"/ground_truth\"\n");
    workplace.command("ingest", "topic", &[]).expect(0);
    let truth = poses(&workplace, "topic");

    // Relative to the pipeline file, with the name of the log.
    with("pose.file = \"poses/{log}.tum\"\n");
    fs::create_dir(workplace.path("poses")).unwrap();
    let missing = ["poses/one.tum", "cannot read the file of `ingest.pose.file`"];
    workplace.command("ingest", "file", &[]).expect(1).says(&missing);
    let write = |text: String| fs::write(workplace.path("poses/one.tum"), text).unwrap();
    write(tum(&truth, |sin, cos| [0.0, 0.0, sin, cos]));
    workplace.command("ingest", "file", &[]).expect(0);
    let found = poses(&workplace, "file");
    assert_eq!(found.poses().len(), truth.poses().len());
    for (found, truth) in found.poses().iter().zip(truth.poses()) {
        assert_eq!(found.stamp_ns, truth.stamp_ns);
        assert!(found.pose.distance_m(&truth.pose) < 1e-9);
        assert!(found.pose.heading_difference_rad(&truth.pose) < 1e-9);
    }
    // Scans are deskewed as with the topic.
    let scans =
        |out: &str| fs::metadata(workplace.path(&format!("{out}/scans/one.parquet"))).unwrap();
    assert!(scans("file").len().abs_diff(scans("topic").len()) < 2000);

    let dry = || workplace.command("run", "file", &["--dry-run"]).expect(0).stdout;
    assert!(dry().contains("ingest one               up to date"), "{}", dry());
    let half = tum(&truth, |sin, cos| [0.0, 0.0, sin, cos]);
    write(half.lines().take(half.lines().count() / 2).map(|line| format!("{line}\n")).collect());
    assert!(dry().contains("would run: one.tum has changed"), "{}", dry());
    // Scans after the last pose are counted when keyframes are selected.
    workplace.command("ingest", "file", &[]).expect(0);
    workplace.command("subsample", "file", &[]).expect(3).says(&["warning[scans_after_poses]"]);

    write(tum(&truth, |sin, cos| [cos, 0.0, 0.0, sin]));
    workplace.command("ingest", "file", &[]).expect(1).says(&["poses/one.tum", "order w x y z"]);
    write("1 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n".to_owned());
    workplace
        .command("ingest", "file", &[])
        .expect(1)
        .says(&["its poses are from 1.000 to 2.000 s"]);
    with("pose = { file = \"a.tum\", topic = \"/ground_truth\" }\n");
    workplace.command("ingest", "file", &[]).expect(2).says(&["sets `topic` and `file`"]);
}
