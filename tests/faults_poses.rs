//! Poses that jump, step back in time, have several publishers or impossible values, in logs made in
//! the test.

use std::fs;

use dataset::Trajectory;
use dataset::tables::read_poses;
use serde_json::json;

use crate::made::{Message, Schema, log};
use crate::support::{self, Finished, Workplace};
use crate::wire::{Encoding, RosMessage};

const START_NS: i64 = 1_700_000_000_000_000_000;
const NO_ROTATION: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

fn ns(s: f64) -> i64 {
    START_NS + (s * 1e9).round() as i64
}

/// A ROS message that starts with a header.
fn ros(encoding: Encoding, stamp_ns: i64, frame_id: &str) -> RosMessage {
    let message = RosMessage::new(encoding);
    let message = if encoding == Encoding::Ros1 { message.u32(0) } else { message };
    message.time(stamp_ns).string(frame_id)
}

/// A scan of a round room, all around.
fn scan(encoding: Encoding, s: f64) -> Message {
    let step = std::f32::consts::TAU / 90.0;
    let ranges: Vec<f32> = (0..90).map(|k| 4.0 + (k % 7) as f32 * 0.25).collect();
    let data = ros(encoding, ns(s), "laser")
        .f32(0.0)
        .f32(step * 89.0)
        .f32(step)
        .f32(0.0)
        .f32(0.1)
        .f32(0.05)
        .f32(30.0)
        .f32_sequence(&ranges)
        .f32_sequence(&[])
        .finish();
    let type_name = "sensor_msgs/LaserScan";
    Message { topic: "/scan", type_name, encoding, stamp_ns: ns(s), data }
}

fn pose(encoding: Encoding, s: f64, position: [f64; 3]) -> Message {
    let data = ros(encoding, ns(s), "map").f64s(&position).f64s(&NO_ROTATION).finish();
    let type_name = "geometry_msgs/PoseStamped";
    Message { topic: "/localizer/pose", type_name, encoding, stamp_ns: ns(s), data }
}

fn odometry(encoding: Encoding, s: f64, x_m: f64, child: &str) -> Message {
    let data = ros(encoding, ns(s), "/odom")
        .string(child)
        .f64s(&[x_m, 0.0, 0.0])
        .f64s(&NO_ROTATION)
        .f64s(&[0.0; 36])
        .f64s(&[0.0; 6])
        .f64s(&[0.0; 36])
        .finish();
    let type_name = "nav_msgs/Odometry";
    Message { topic: "/odometry", type_name, encoding, stamp_ns: ns(s), data }
}

fn fix(s: f64, north_m: f64) -> Message {
    // 1 m along a meridian at latitude 48 deg is 1 / 111 200 deg.
    let data = ros(Encoding::Cdr, ns(s), "gps")
        .u8(0)
        .raw(&[0, 1, 0])
        .f64s(&[48.0 + north_m / 111_200.0, 11.0, 500.0])
        .f64s(&[0.0; 9])
        .u8(0)
        .finish();
    let type_name = "sensor_msgs/NavSatFix";
    Message { topic: "/gps", type_name, encoding: Encoding::Cdr, stamp_ns: ns(s), data }
}

/// A `foxglove.FrameTransform` in JSON.
fn transform(s: f64, (parent, child): (&str, &str), x_m: f64, rotation: [f64; 4]) -> Message {
    let stamp = json!({ "sec": ns(s) / 1_000_000_000, "nsec": ns(s) % 1_000_000_000 });
    let [x, y, z, w] = rotation;
    let message = json!({
        "timestamp": stamp,
        "parent_frame_id": parent,
        "child_frame_id": child,
        "translation": { "x": x_m, "y": 0.0, "z": 0.0 },
        "rotation": { "x": x, "y": y, "z": z, "w": w },
    });
    Message {
        topic: "/transforms",
        type_name: "foxglove.FrameTransform",
        encoding: Encoding::Json,
        stamp_ns: ns(s),
        data: message.to_string().into_bytes(),
    }
}

/// Ingests a log and selects its keyframes.
struct Ingested {
    finished: Finished,
    workplace: Workplace,
}

impl Ingested {
    /// Checks that the program printed each text.
    fn says(&self, texts: &[&str]) {
        let printed = &self.finished.stderr;
        texts
            .iter()
            .for_each(|text| assert!(printed.contains(text), "`{text}` is not in:\n{printed}"));
    }

    fn trajectory(&self) -> Trajectory {
        read_poses(&self.workplace.path("out/poses/a.parquet")).unwrap().0
    }

    /// The number of poses of each segment, and its frame.
    fn segments(&self) -> Vec<(usize, u32)> {
        let trajectory = self.trajectory();
        let segments = trajectory.poses().chunk_by(|a, b| a.segment == b.segment);
        segments.map(|segment| (segment.len(), segment[0].frame)).collect()
    }
}

fn ingest(messages: &[Message], pose: &str, code: i32) -> Ingested {
    let workplace = Workplace::new(&format!(
        "[ingest]\nlogs = [\"a.mcap\"]\nlidar.topic = \"/scan\"\n[ingest.pose]\n{pose}\n"
    ));
    fs::write(workplace.path("a.mcap"), log(messages, Schema::Empty)).unwrap();
    let finished = workplace.command("ingest", "out", &[]).expect(code);
    Ingested { finished, workplace }
}

/// Messages at 5 Hz for 40 s, and scans in between.
fn drive(encoding: Encoding, mut at: impl FnMut(usize, f64) -> Option<Message>) -> Vec<Message> {
    let mut messages = Vec::new();
    for k in 0..200 {
        let s = 0.2 * k as f64;
        messages.extend(at(k, s));
        messages.push(scan(encoding, s + 0.1));
    }
    messages
}

/// A robot at 0.8 m/s whose localizer corrects it by 3 m after 20 s. The scan in between has no pose,
/// and the path does not contain the 3 m.
#[test]
fn a_jump_of_a_slow_robot_splits_the_trajectory() {
    for encoding in [Encoding::Ros1, Encoding::CdrBigEndian] {
        let messages = drive(encoding, |k, s| {
            let y_m = if k < 100 { 0.0 } else { 3.0 };
            Some(pose(encoding, s, [0.8 * s, y_m, 0.0]))
        });
        let ingested = ingest(&messages, "topic = \"/localizer/pose\"", 3);
        ingested.says(&["warning[pose_jumps]", "the poses jump once", "3.00 m in 0.200 s"]);
        assert_eq!(ingested.segments(), [(100, 0), (100, 1)]);
        assert_eq!(ingested.trajectory().frame_id(), Some("map"));
        let finished = ingested.workplace.command("subsample", "out", &[]).expect(3);
        finished.says(&["1 scan between two segments"]);
        let keyframes = support::keyframes(&ingested.workplace.path("out"));
        let last = keyframes.last().unwrap();
        assert_eq!((last.segment, last.frame), (1, 1));
        // 39.8 s at 0.8 m/s are 31.84 m.
        assert!(29.0 < last.travel_m && last.travel_m < 31.9, "{}", last.travel_m);

        let same = "topic = \"/localizer/pose\"\njumps = \"same_frame\"";
        assert_eq!(ingest(&messages, same, 3).segments(), [(100, 0), (100, 0)]);
    }
}

/// Corrections of 0.4 m every 2 s, and a vehicle at 30 m/s with poses at 1 Hz.
#[test]
fn corrections_of_a_localizer_and_fast_vehicles_do_not_jump() {
    let messages = drive(Encoding::Cdr, |k, s| {
        let y_m = if k / 10 % 2 == 0 { 0.0 } else { 0.4 };
        Some(pose(Encoding::Cdr, s, [1.2 * s, y_m, 0.0]))
    });
    assert_eq!(ingest(&messages, "topic = \"/localizer/pose\"", 0).segments(), [(200, 0)]);
    let messages = drive(Encoding::Cdr, |k, s| {
        (k % 5 == 0).then(|| pose(Encoding::Cdr, s, [30.0 * s, 0.0, 0.0]))
    });
    let fast = "topic = \"/localizer/pose\"\nmax_speed_m_s = 40.0";
    assert_eq!(ingest(&messages, fast, 0).segments(), [(40, 0)]);
    let ingested = ingest(&messages, "topic = \"/localizer/pose\"", 3);
    ingested.says(&["warning[poses_too_fast]", "39 steps between poses with more than 15 m/s"]);
    assert_eq!(ingested.segments(), [(40, 0)]);
}

/// The robot takes a lift from the first to the third floor, in which the localizer is silent.
#[test]
fn a_jump_in_height_splits_the_trajectory_and_heights_are_kept() {
    let messages = drive(Encoding::Ros1, |k, s| {
        let z_m = if k < 120 { 1.5 } else { 7.5 };
        Some(pose(Encoding::Ros1, s, [s, 2.0, z_m]))
    });
    let ingested = ingest(&messages, "topic = \"/localizer/pose\"", 3);
    ingested.says(&["warning[height_jumps]", "6.00 m in 0.200 s"]);
    assert_eq!(ingested.segments(), [(120, 0), (80, 1)]);
    let trajectory = ingested.trajectory();
    assert!(trajectory.poses().iter().all(|p| p.z_m == Some(if p.frame == 0 { 1.5 } else { 7.5 })));
}

/// Satellite fixes at 5 Hz: three of them are 60 m off. The course of the others is north.
#[test]
fn satellite_fixes_that_jump_away_and_back_are_left_out() {
    let messages = drive(Encoding::Cdr, |k, s| {
        let off_m = if (90..93).contains(&k) { 60.0 } else { 0.0 };
        Some(fix(s, 1.5 * s + off_m))
    });
    let ingested = ingest(&messages, "topic = \"/gps\"", 3);
    ingested.says(&["warning[pose_outliers]: 3 outliers among the poses"]);
    assert_eq!(ingested.segments(), [(197, 0)]);
    let trajectory = ingested.trajectory();
    let north_rad = std::f64::consts::FRAC_PI_2;
    assert!(trajectory.poses().iter().all(|p| (p.pose.heading_rad - north_rad).abs() < 1e-3));
    assert_eq!(trajectory.frame_id(), None);
}

/// The wheels and a camera publish odometry on one topic, in the same frame.
#[test]
fn two_publishers_on_one_topic_are_an_error_unless_one_is_selected() {
    let mut messages = drive(Encoding::Cdr, |_, s| Some(odometry(Encoding::Cdr, s, s, "base")));
    for k in 0..100 {
        let s = 0.4 * f64::from(k) + 0.05;
        messages.push(odometry(Encoding::Cdr, s, 1.1 * s, "camera"));
    }
    let ingested = ingest(&messages, "topic = \"/odometry\"", 1);
    ingested.says(&[
        "several publishers use topic `/odometry` at the same time",
        "`base` in `odom` (200 messages)",
        "`camera` in `odom` (100 messages)",
        "ingest.pose.frame_id",
    ]);
    let ingested = ingest(&messages, "topic = \"/odometry\"\nframe_id = \"camera\"", 0);
    assert_eq!(ingested.trajectory().poses().len(), 100);
    assert_eq!(ingested.trajectory().frame_id(), Some("odom"));
    let ingested = ingest(&messages, "topic = \"/odometry\"\nframe_id = \"map\"", 1);
    ingested.says(&["has no pose in frame `map`", "`base` in `odom` (200 messages)"]);
}

/// The clock is set back by 4 s while the robot drives. The stamps of poses and scans step back.
#[test]
fn a_clock_that_is_set_back_cuts_the_trajectory() {
    let encoding = Encoding::Cdr;
    let messages = drive(encoding, |k, s| {
        let stamp_s = if k < 100 { s } else { s - 4.0 };
        Some(pose(encoding, stamp_s, [1.5 * s, 0.0, 0.0]))
    });
    let messages: Vec<Message> = (messages.into_iter().enumerate())
        .map(|(k, message)| match message.topic {
            "/scan" if 200 <= k => scan(encoding, 0.1 * k as f64 - 4.0),
            _ => message,
        })
        .collect();
    let ingested = ingest(&messages, "topic = \"/localizer/pose\"", 3);
    ingested.says(&[
        "warning[pose_clock_steps_back]",
        "warning[poses_at_repeated_times]: 40 poses at times that occur twice",
    ]);
    // 16.0 to 19.8 s occur twice: 20 poses before the step, and 20 after it up to 19.8 s.
    let trajectory = ingested.trajectory();
    let is_repeated = |stamp_ns| (ns(16.0)..=ns(19.8)).contains(&stamp_ns);
    assert!(trajectory.poses().iter().all(|p| !is_repeated(p.stamp_ns)));
    assert_eq!(ingested.segments(), [(80, 0), (80, 0)]);
    let finished = ingested.workplace.command("subsample", "out", &[]).expect(3);
    finished.says(&["scans between two segments"]);
}

/// Transforms: one without rotation on the way to the lidar, and an impossible translation.
#[test]
fn transforms_that_cannot_be_used_are_named() {
    let of_odometry = |k: usize, s: f64| {
        let x_m = if k == 50 { -1e200 } else { s };
        Some(transform(s, ("odom", "base"), x_m, NO_ROTATION))
    };
    let mut messages = drive(Encoding::Cdr, of_odometry);
    let frames = |child: &str| {
        format!("frames = {{ parent = \"odom\", child = \"{child}\", topics = [\"/transforms\"] }}")
    };
    let ingested = ingest(&messages, &frames("base"), 3);
    ingested.says(&[
        "warning[impossible_positions]: 1 message with a position farther than 100000000 m",
        "transform `odom -> base`",
    ]);
    assert_eq!(ingested.segments(), [(199, 0)]);
    assert_eq!(ingested.trajectory().frame_id(), Some("odom"));
    messages.push(transform(0.0, ("base", "lidar"), 0.3, [0.0; 4]));
    let ingested = ingest(&messages, &frames("lidar"), 1);
    ingested.says(&[
        "no poses of frame `lidar` in frame `odom`",
        "(0, 0, 0, 0)",
        "transform `base -> lidar`",
    ]);
}

/// The correction of the map comes every 1.6 s and is silent from 12.8 to 30.4 s.
#[test]
fn poses_are_left_out_while_a_slow_transform_is_silent() {
    let mut messages =
        drive(Encoding::Cdr, |_, s| Some(transform(s, ("odom", "base"), 1.2 * s, NO_ROTATION)));
    for k in (0..=8).chain(19..25) {
        messages.push(transform(1.6 * f64::from(k), ("map", "odom"), 2.0, NO_ROTATION));
    }
    let frames = "frames = { parent = \"map\", child = \"base\", topics = [\"/transforms\"] }";
    let ingested = ingest(&messages, frames, 3);
    ingested.says(&["warning[poses_without_transform]"]);
    let silent = ns(12.8) + 1..ns(30.4);
    let trajectory = ingested.trajectory();
    assert!(trajectory.poses().iter().all(|p| !silent.contains(&p.stamp_ns)));
    assert!(trajectory.poses().iter().any(|p| ns(30.4) <= p.stamp_ns));
    assert_eq!(ingested.segments().len(), 1);
}
