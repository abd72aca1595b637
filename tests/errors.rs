//! Errors name what is wrong and what to do, and set the exit code.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs;
use std::io::Cursor;
use std::sync::Arc;

use messages::NavSatFix;
use messages::ros::{self, Encoding, LaserScan, StampedPose3};

use crate::support::{Workplace, loopboost};

/// A small log: `n` planar scans on `/scan` and `n` poses on `/pose`, half a metre apart.
fn log(n: i64) -> Vec<u8> {
    let mut writer =
        mcap::WriteOptions::new().chunk_size(Some(4000)).create(Cursor::new(Vec::new())).unwrap();
    let channel = |id: u16, topic: &str, schema: &str| {
        Arc::new(mcap::Channel {
            id,
            topic: topic.to_owned(),
            schema: Some(Arc::new(mcap::Schema {
                id,
                name: schema.to_owned(),
                encoding: "ros2msg".into(),
                data: Cow::Borrowed(b""),
            })),
            message_encoding: "cdr".into(),
            metadata: BTreeMap::new(),
        })
    };
    let scans = channel(1, "/scan", "sensor_msgs/msg/LaserScan");
    let poses = channel(2, "/pose", "geometry_msgs/msg/PoseStamped");
    let fixes = channel(3, "/fix", "sensor_msgs/msg/NavSatFix");
    for k in 0..n {
        let stamp_ns = k * 100_000_000;
        let scan = LaserScan {
            stamp_ns,
            angle_min: -1.5,
            angle_max: None,
            angle_increment: 0.03,
            time_increment_s: 0.0,
            range_min: 0.1,
            range_max: 50.0,
            ranges: (0..100).map(|beam| 2.0 + ((k * 7 + beam * beam) % 13) as f32).collect(),
        };
        let pose = StampedPose3 {
            stamp_ns,
            position: [0.5 * k as f64, 0.0, 0.0],
            orientation: [0.0, 0.0, 0.0, 1.0],
        };
        let fix = NavSatFix {
            stamp_ns,
            status: 0,
            latitude_deg: 42.0,
            longitude_deg: -83.0 + 6e-6 * k as f64,
            altitude_m: 200.0,
            covariance: [0.0; 9],
        };
        for (channel, data) in [
            (&fixes, ros::write_nav_sat_fix(Encoding::Cdr, "gps", &fix)),
            (&scans, ros::write_laser_scan(Encoding::Cdr, "laser", &scan)),
            (&poses, ros::write_pose_stamped(Encoding::Cdr, "map", &pose)),
        ] {
            let message = mcap::Message {
                channel: channel.clone(),
                sequence: k as u32,
                log_time: stamp_ns as u64,
                publish_time: stamp_ns as u64,
                data: Cow::Owned(data),
            };
            writer.write(&message).unwrap();
        }
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

const PIPELINE: &str = r#"
[ingest]
logs = ["a.mcap"]
lidar = { topic = "/scan", range_min_m = 0.1 }
pose.topic = "/pose"

[label]
pairs_per_class = 100

[evaluate]
groupings = ["pair"]
"#;

fn workplace(pipeline: &str) -> Workplace {
    let workplace = Workplace::new(pipeline);
    fs::write(workplace.path("a.mcap"), log(200)).unwrap();
    workplace
}

#[test]
fn the_small_log_has_no_errors() {
    workplace(PIPELINE).command("run", "out", &[]).expect(0);
}

#[test]
fn usage_errors_exit_with_2() {
    loopboost(&["walk"]).expect(2).says(&["unrecognized subcommand"]);
    loopboost(&["run", "no.toml", "--out", "x"])
        .expect(2)
        .says(&["cannot read the pipeline file no.toml"]);
    workplace("[label]\npositive_radius = 2\n").command("run", "out", &[]).expect(2).says(&[
        "drive.toml",
        "unknown field `positive_radius`",
        "did you mean `positive_radius_m`?",
    ]);
    workplace(PIPELINE)
        .command("run", "out", &["--set", "subsample.spacing_m=0"])
        .expect(2)
        .says(&["`subsample.spacing_m` is 0, expected more than 0"]);
    for (option, says) in [
        ("evaluate.folds=101", "at most `label.pairs_per_class`"),
        ("train.rounds=4000000000", "`train.rounds` is 4000000000"),
        ("evaluate.groupings=[\"pair\", \"pair\"]", "expected each grouping once"),
        ("evaluate.recent_m=20", "was renamed: use `evaluate.min_separation_m`"),
        ("simulate.spin_hz=50", "spin_hz"),
        ("ingest.logs=[]", "`ingest.logs` is empty"),
    ] {
        workplace(PIPELINE).command("run", "out", &["--set", option]).expect(2).says(&[says]);
    }
    workplace("name = [\n").command("run", "out", &[]).expect(2).says(&["drive.toml", "line 1"]);
}

#[test]
fn a_wrong_topic_or_schema_is_an_error() {
    workplace(PIPELINE)
        .command("ingest", "out", &["--set", "ingest.lidar.topic=/laser"])
        .expect(1)
        .says(&[
            "a.mcap has no topic `/laser`",
            "`ingest.lidar.topic`",
            "`/scan` (sensor_msgs/msg/LaserScan, cdr)",
        ]);
    workplace(PIPELINE)
        .command("ingest", "out", &["--set", "ingest.lidar.topic=/pose"])
        .expect(1)
        .says(&[
            "`/pose` contains `geometry_msgs/msg/PoseStamped, cdr`",
            "expected `VelodyneScan`, `VelodynePacket`, `PointCloud2`, `LaserScan`, `foxglove.PointCloud` or `foxglove.LaserScan`",
        ]);
    workplace(PIPELINE)
        .command("ingest", "out", &["--set", "ingest.pose.topic=/odom"])
        .expect(1)
        .says(&["a.mcap has no topic `/odom`", "`ingest.pose.topic`", "`/pose`"]);
}

#[test]
fn poses_in_a_frame_of_their_own_cannot_share_a_site() {
    let pipeline = "[ingest]\nlogs = [\"a.mcap\", \"b.mcap\"]\nsite = \"mit\"\npose = { wheels = \"/wheels\", track_m = 0.5 }\n";
    workplace(pipeline)
        .command("ingest", "out", &[])
        .expect(2)
        .says(&["start in their own frame", "[ingest.log.a.pose.start]"]);
    workplace(&pipeline.replace(", track_m = 0.5", ""))
        .command("ingest", "out", &[])
        .expect(2)
        .says(&["`wheels` without `track_m`"]);
}

#[test]
fn a_log_without_poses_is_an_error_in_subsample() {
    let workplace = workplace(&PIPELINE.replace("pose.topic = \"/pose\"", ""));
    workplace.command("ingest", "out", &[]).expect(0);
    workplace
        .command("subsample", "out", &[])
        .expect(1)
        .says(&["log `a` has no poses", "set `ingest.pose.topic`"]);
}

#[test]
fn a_truncated_log_keeps_its_complete_messages_and_exits_with_3() {
    let workplace = workplace(PIPELINE);
    let whole = log(200);
    fs::write(workplace.path("a.mcap"), &whole[..whole.len() * 3 / 4]).unwrap();
    let finished =
        workplace.command("run", "out", &["--set", "label.pairs_per_class=20"]).expect(3);
    assert!(
        finished.stdout.contains("ingest     a: 1"),
        "more than 99 scans:\n{}",
        finished.stdout
    );
    finished.says(&[
        "warning[truncated_file]: 1 file cut off at the end (no footer",
        "done with 1 warning",
    ]);
    // The report contains the same warning.
    let report = String::from_utf8(workplace.files("out")["report.html"].clone()).unwrap();
    assert!(report.contains("1 file cut off at the end"));
}

#[test]
fn a_file_that_is_not_mcap_or_is_missing_is_an_error() {
    let workplace = workplace(PIPELINE);
    fs::write(workplace.path("a.mcap"), b"#ROSBAG V2.0\n").unwrap();
    workplace.command("run", "out", &[]).expect(1).says(&[
        "a.mcap is not an MCAP file",
        "23 52 4f 53",
        "convert",
    ]);
    assert!(!workplace.path("out").join("scans").join("a.parquet").exists());
    fs::remove_file(workplace.path("a.mcap")).unwrap();
    workplace
        .command("run", "out", &[])
        .expect(1)
        .says(&["a.mcap does not exist", "relative to the pipeline file"]);
    workplace
        .command("run", "out", &["--set", "ingest.logs=[\"*.mcap\"]"])
        .expect(1)
        .says(&["no *.mcap file in `*.mcap`"]);
}

#[test]
fn too_few_pairs_is_an_error_that_states_their_number() {
    // 200 keyframes are 0.5 m apart. The 99 x 100 / 2 pairs at least 101 steps apart are more than
    // 50 m apart, and 199 + 198 + 197 pairs are within 1.5 m.
    workplace(PIPELINE)
        .command("run", "out", &["--set", "label.pairs_per_class=1218"])
        .expect(1)
        .says(&[
            "found 594 positive and 4950 negative pairs among 200 keyframes",
            "asks for 1218 of each",
            "`label.pairs_per_class = 594` works for both classes",
        ]);
}

#[test]
fn a_missing_input_is_an_error_that_names_the_command_to_run() {
    let workplace = workplace(PIPELINE);
    for (stage, before) in [
        ("subsample", "ingest"),
        ("label", "subsample"),
        ("featurize", "subsample"),
        ("train", "subsample"),
        ("evaluate", "subsample"),
    ] {
        workplace
            .command(stage, "out", &[])
            .expect(1)
            .says(&["does not exist", &format!("loopboost {before} PIPELINE.toml --out DIR")]);
    }
}

#[test]
fn a_table_made_with_other_options_or_inputs_is_an_error() {
    let workplace = workplace(PIPELINE);
    workplace.command("run", "out", &[]).expect(0);
    // The pairs, features and scans were made with other options.
    for (option, says) in [
        (
            "label.positive_radius_m=2.9",
            ["pairs.parquet", "positive_radius_m: 1.5 -> 2.9", "loopboost label"],
        ),
        ("featurize.gate_m=9", ["features/a.parquet", "gate_m: 2.5 -> 9", "loopboost featurize"]),
        (
            "ingest.lidar.range_max_m=12",
            ["a.parquet", "range_max_m: 70.0 -> 12", "loopboost ingest"],
        ),
        ("seed=8", ["pairs.parquet", "seed: 2436 -> 8", "loopboost run"]),
    ] {
        workplace.command("train", "out", &["--set", option]).expect(1).says(&says);
    }
    // The keyframes are new; the pairs and features belong to the old ones.
    let spacing = ["--set", "subsample.spacing_m=1"];
    let few = [&spacing[..], &["--set", "label.pairs_per_class=40"]].concat();
    workplace.command("subsample", "out", &spacing).expect(0);
    workplace.command("train", "out", &few).expect(1).says(&[
        "pairs.parquet was not made with this pipeline",
        "keyframes/a.parquet has changed",
    ]);
    workplace.command("label", "out", &few).expect(0);
    workplace
        .command("train", "out", &few)
        .expect(1)
        .says(&["features/a.parquet was not made with this pipeline", "loopboost featurize"]);
    workplace.command("featurize", "out", &few).expect(0);
    workplace.command("train", "out", &few).expect(0);
}

/// Satellite fixes of two logs of one site need a common origin. The pose source of one log replaces
/// the common one.
#[test]
fn satellite_fixes_of_one_site_need_a_common_origin() {
    let workplace = workplace(&PIPELINE.replace("[\"a.mcap\"]", "[\"a.mcap\", \"b.mcap\"]"));
    fs::write(workplace.path("b.mcap"), log(201)).unwrap();
    let site = ["--set", "ingest.site=campus"];
    let by_fixes = ["--set", "ingest.log.b.pose.topic=/fix"];
    let args = [site, by_fixes].concat();
    workplace.command("ingest", "out", &args).expect(2).says(&[
        "poses of log `b` are counted from its first satellite fix",
        "[ingest.log.b.pose.origin]",
    ]);
    let origin = [
        "--set",
        "ingest.log.b.pose.origin={ latitude_deg = 42.0, longitude_deg = -83.0, altitude_m = 0 }",
    ];
    workplace.command("ingest", "out", &[args, origin.to_vec()].concat()).expect(0);
    let by_frames = ["--set", "ingest.log.b.pose.frames={ parent = \"map\", child = \"base\" }"];
    workplace
        .command("ingest", "out", &[site, by_frames].concat())
        .expect(3)
        .says(&["b.mcap has no topic `/tf`", "no topic of the log has a suitable type"]);
}

#[test]
fn later_stages_do_not_need_the_logs() {
    let workplace = workplace(PIPELINE);
    workplace.command("ingest", "out", &[]).expect(0);
    fs::remove_file(workplace.path("a.mcap")).unwrap();
    for stage in ["subsample", "label", "featurize", "train", "evaluate"] {
        workplace.command(stage, "out", &[]).expect(0);
    }
}

#[test]
fn paths_may_contain_the_characters_of_globs() {
    let workplace = workplace(&PIPELINE.replace("a.mcap", "drives [1]/a.mcap"));
    fs::create_dir(workplace.path("drives [1]")).unwrap();
    fs::rename(workplace.path("a.mcap"), workplace.path("drives [1]/a.mcap")).unwrap();
    workplace.command("ingest", "out", &[]).expect(0);
    workplace.command("ingest", "out", &["--set", "ingest.logs=[\"drives [1]\"]"]).expect(0);
    workplace.command("ingest", "out", &["--set", "ingest.logs=[\"*/*.mcap\"]"]).expect(0);
}

#[test]
fn a_log_listed_twice_and_options_of_an_unknown_log_are_errors() {
    let workplace = workplace(&PIPELINE.replace("[\"a.mcap\"]", "[\"a.mcap\", \"./a.mcap\"]"));
    workplace.command("ingest", "out", &[]).expect(2).says(&[
        "two logs are named `a`",
        "a.mcap and ",
        "./a.mcap",
        "rename one",
    ]);
    let stray = format!("{PIPELINE}\n[ingest.log.c]\nsite = \"x\"\n");
    self::workplace(&stray)
        .command("ingest", "out", &[])
        .expect(2)
        .says(&["[ingest.log.c]", "no log of this run"]);
}

#[test]
fn a_folder_that_cannot_be_created_is_named() {
    let workplace = workplace(PIPELINE);
    fs::write(workplace.path("out"), b"a file").unwrap();
    workplace.command("ingest", "out", &[]).expect(1).says(&["cannot create folder", "out"]);
}
