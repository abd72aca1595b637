//! Planar scans and poses made in the test: every message type, encoding and schema gives what the
//! message definitions say.

use std::f64::consts::PI;

use dataset::tables::read_poses;
use dataset::{Scan, StampedPose};

use crate::made::{Logs, Message, SCHEMAS, Schema, log};
use crate::wire::{Encoding, FOXGLOVE, Protobuf, ROS, RosMessage, foxglove_json, json_pose};

const RANGE_MIN_M: f32 = 1.0;
const RANGE_MAX_M: f32 = 30.0;
const START_NS: i64 = 1_700_000_000_000_000_000;

/// A scan as the scanner measured it.
struct Sweep {
    stamp_ns: i64,
    angle_min: f32,
    angle_increment: f32,
    ranges: Vec<f32>,
}

/// Four scans each of 180, 181 and 361 beams. Each has every reading that is not a return, and one
/// at either limit that is.
fn sweeps() -> Vec<Sweep> {
    let not_quite = RANGE_MAX_M.next_down();
    let odd = [
        f32::NAN,
        f32::INFINITY,
        f32::NEG_INFINITY,
        0.0,
        RANGE_MAX_M,
        not_quite,
        RANGE_MIN_M,
        0.01,
    ];
    (0..12)
        .map(|k| {
            let (n, step_deg) = [(180, 1.0), (181, 1.0), (361, 0.5)][k % 3];
            let mut ranges: Vec<f32> =
                (0..n).map(|beam| 2.0 + ((k * 31 + beam * beam) % 97) as f32 / 8.0).collect();
            for (place, reading) in odd.into_iter().enumerate() {
                ranges[(k + 21 * place) % n] = reading;
            }
            Sweep {
                stamp_ns: START_NS + k as i64 * 100_000_000,
                angle_min: -(PI / 2.0) as f32,
                angle_increment: (step_deg * PI / 180.0) as f32,
                ranges,
            }
        })
        .collect()
}

fn scan_message(sweep: &Sweep, encoding: Encoding) -> Message {
    let n_steps = (sweep.ranges.len() - 1) as f32;
    let data = match encoding {
        Encoding::Protobuf | Encoding::Json => foxglove_scan(sweep, encoding),
        _ => RosMessage::with_header(encoding, sweep.stamp_ns)
            .f32(sweep.angle_min)
            .f32(sweep.angle_min + sweep.angle_increment * n_steps)
            .f32(sweep.angle_increment)
            .f32(0.0)
            .f32(0.1)
            .f32(RANGE_MIN_M)
            .f32(RANGE_MAX_M)
            .f32_sequence(&sweep.ranges)
            .f32_sequence(&[])
            .finish(),
    };
    let is_foxglove = FOXGLOVE.contains(&encoding);
    let type_name = if is_foxglove { "foxglove.LaserScan" } else { "sensor_msgs/LaserScan" };
    Message { topic: "/scan", type_name, encoding, stamp_ns: sweep.stamp_ns, data }
}

/// The message has no range limits: readings outside the scanner's limits become NaN. Infinities
/// and 0 stay, as some drivers write them.
fn foxglove_scan(sweep: &Sweep, encoding: Encoding) -> Vec<u8> {
    let start_angle = f64::from(sweep.angle_min);
    let n_steps = (sweep.ranges.len() - 1) as f64;
    let end_angle = start_angle + f64::from(sweep.angle_increment) * n_steps;
    let is_written = |range: f32| {
        range.is_infinite() || range == 0.0 || (RANGE_MIN_M..RANGE_MAX_M).contains(&range)
    };
    let ranges = sweep.ranges.iter();
    let ranges = ranges.map(|&range| if is_written(range) { range.into() } else { f64::NAN });
    if encoding == Encoding::Protobuf {
        let packed: Vec<u8> = ranges.flat_map(f64::to_le_bytes).collect();
        return Protobuf::foxglove(sweep.stamp_ns)
            .message(3, &Protobuf::pose([0.0; 3], [0.0, 0.0, 0.0, 1.0]))
            .double(4, start_angle)
            .double(5, end_angle)
            .bytes(6, &packed)
            .finish();
    }
    let number = |value: f64| match value {
        f64::INFINITY => "Infinity".into(),
        f64::NEG_INFINITY => "-Infinity".into(),
        _ => serde_json::json!(value), // null if it is NaN
    };
    let ranges: Vec<serde_json::Value> = ranges.map(number).collect();
    let more = serde_json::json!({
        "pose": json_pose([0.0; 3], [0.0, 0.0, 0.0, 1.0]),
        "start_angle": start_angle,
        "end_angle": end_angle,
        "ranges": ranges,
        "intensities": [],
    });
    foxglove_json(sweep.stamp_ns, more)
}

/// By the definition of `sensor_msgs/LaserScan`; a reading at the maximum is not a return.
fn check_scans(scans: &[Scan], sweeps: &[Sweep]) {
    assert_eq!(scans.len(), sweeps.len());
    for (scan, sweep) in scans.iter().zip(sweeps) {
        let (start, increment) = (f64::from(sweep.angle_min), f64::from(sweep.angle_increment));
        let expected: Vec<[f64; 2]> = sweep
            .ranges
            .iter()
            .enumerate()
            .filter(|(_, range)| (RANGE_MIN_M..RANGE_MAX_M).contains(*range))
            .map(|(beam, &range)| {
                let (sin, cos) = (start + increment * beam as f64).sin_cos();
                [f64::from(range) * cos, f64::from(range) * sin]
            })
            .collect();
        // Of the eight odd readings two are returns.
        assert_eq!(expected.len(), sweep.ranges.len() - 6);
        assert_eq!((scan.stamp_ns, scan.len()), (sweep.stamp_ns, expected.len()));
        let swept_deg = (increment * (sweep.ranges.len() - 1) as f64).to_degrees();
        assert!((f64::from(scan.coverage_deg) - swept_deg).abs() < 1e-4);
        for (found, expected) in scan.points().zip(expected) {
            for (found, expected) in found.into_iter().zip(expected) {
                // Half of the last bit of an f32 below 32 m.
                assert!((found - expected).abs() < 1e-6, "{found} m, expected {expected} m");
            }
        }
    }
}

/// A pose as the robot has it.
struct Tilted {
    stamp_ns: i64,
    position: [f64; 3],
    heading_rad: f64,
    orientation: [f64; 4],
}

/// Poses 5 ns after the scans, with a pitch and a roll of up to 15 deg.
fn poses() -> Vec<Tilted> {
    (0..12)
        .map(|k| {
            let k = f64::from(k);
            let heading_rad = (0.7 * k + PI).rem_euclid(2.0 * PI) - PI;
            let (pitch, roll) = (0.26 * (1.3 * k).sin(), 0.26 * (2.1 * k).cos());
            let [(sy, cy), (sp, cp), (sr, cr)] =
                [heading_rad, pitch, roll].map(|angle| (0.5 * angle).sin_cos());
            let orientation = [
                sr * cp * cy - cr * sp * sy,
                cr * sp * cy + sr * cp * sy,
                cr * cp * sy - sr * sp * cy,
                cr * cp * cy + sr * sp * sy,
            ];
            Tilted {
                stamp_ns: START_NS + k as i64 * 100_000_000 + 5,
                position: [0.5 * k, 0.1 - k, 0.3],
                heading_rad,
                orientation,
            }
        })
        .collect()
}

const ROS_POSES: [&str; 3] =
    ["geometry_msgs/PoseStamped", "geometry_msgs/PoseWithCovarianceStamped", "nav_msgs/Odometry"];
const FOXGLOVE_POSE: &str = "foxglove.PoseInFrame";

fn pose_message(pose: &Tilted, type_name: &'static str, encoding: Encoding) -> Message {
    let (position, orientation) = (pose.position, pose.orientation);
    let data = match encoding {
        Encoding::Protobuf => Protobuf::foxglove(pose.stamp_ns)
            .message(3, &Protobuf::pose(position, orientation))
            .finish(),
        Encoding::Json => {
            let more = serde_json::json!({ "pose": json_pose(position, orientation) });
            foxglove_json(pose.stamp_ns, more)
        }
        _ => {
            let header = RosMessage::with_header(encoding, pose.stamp_ns);
            let start = if type_name == ROS_POSES[2] { header.string("base") } else { header };
            let posed = start.f64s(&position).f64s(&orientation);
            let posed = if type_name == ROS_POSES[0] { posed } else { posed.f64s(&[0.01; 36]) };
            let twist = [0.0; 6 + 36];
            if type_name == ROS_POSES[2] { posed.f64s(&twist) } else { posed }.finish()
        }
    };
    Message { topic: "/pose", type_name, encoding, stamp_ns: pose.stamp_ns, data }
}

fn check_poses(found: &[StampedPose], poses: &[Tilted]) {
    assert_eq!(found.len(), poses.len());
    for (found, pose) in found.iter().zip(poses) {
        let position = [found.pose.x_m, found.pose.y_m];
        assert_eq!((found.stamp_ns, position[..].as_ref()), (pose.stamp_ns, &pose.position[..2]));
        let off_rad = (found.pose.heading_rad - pose.heading_rad + PI).rem_euclid(2.0 * PI) - PI;
        assert!(off_rad.abs() < 1e-12, "{off_rad} rad");
    }
}

/// A log of all scans and poses.
fn planar_log(pose_type: &'static str, encoding: Encoding, schema: Schema) -> Vec<u8> {
    let mut messages: Vec<Message> =
        sweeps().iter().map(|sweep| scan_message(sweep, encoding)).collect();
    messages.extend(poses().iter().map(|pose| pose_message(pose, pose_type, encoding)));
    messages.sort_by_key(|message| message.stamp_ns);
    log(&messages, schema)
}

/// A log of a scanner with a view of 180 deg. Its scans are on `/scan`.
pub fn half_circle_log() -> Vec<u8> {
    planar_log(ROS_POSES[0], ROS[0], Schema::Empty)
}

fn check(logs: &Logs, code: i32) {
    let options = ["ingest.lidar.topic=/scan", "ingest.pose.topic=/pose"];
    let ingested = logs.ingest(&options, code);
    let (sweeps, poses) = (sweeps(), poses());
    for (name, scans) in &ingested.scans {
        println!("{name}");
        check_scans(scans, &sweeps);
        let table = ingested.workplace.path(&format!("out/poses/{name}.parquet"));
        check_poses(read_poses(&table).unwrap().0.poses(), &poses);
    }
}

fn add_log(logs: &mut Logs, pose_type: &'static str, encoding: Encoding, schema: Schema) {
    let (_, pose_name) = pose_type.split_once(['/', '.']).unwrap();
    let name = format!("{pose_name}-{encoding:?}-{schema:?}");
    logs.add(&name, planar_log(pose_type, encoding, schema));
}

#[test]
fn scans_and_poses_of_ros_give_what_their_definitions_say() {
    let mut logs = Logs::default();
    for encoding in ROS {
        for pose_type in ROS_POSES {
            add_log(&mut logs, pose_type, encoding, Schema::Empty);
        }
    }
    check(&logs, 0);
}

#[test]
fn scans_and_poses_of_foxglove_give_what_their_definitions_say() {
    let mut logs = Logs::default();
    for encoding in FOXGLOVE {
        add_log(&mut logs, FOXGLOVE_POSE, encoding, Schema::Empty);
    }
    check(&logs, 0);
}

#[test]
fn scans_and_poses_with_an_incomplete_or_missing_schema_give_the_same() {
    let mut logs = Logs::default();
    for encoding in ROS {
        for pose_type in ROS_POSES {
            add_log(&mut logs, pose_type, encoding, Schema::Missing);
        }
        add_log(&mut logs, ROS_POSES[0], encoding, SCHEMAS[1]);
    }
    for encoding in FOXGLOVE {
        add_log(&mut logs, FOXGLOVE_POSE, encoding, Schema::Missing);
    }
    // A channel without a schema is a warning.
    check(&logs, 3);
}
