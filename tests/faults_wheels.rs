//! Faults of wheels and IMU: each gives the correct path, or a message that names the cause.

use std::fs;

use dataset::tables::read_poses;

use crate::made::{Message, Schema, log};
use crate::support::{Finished, Workplace, loopboost};
use crate::wire::{Encoding, RosMessage};

const START_NS: i64 = 1_700_000_000_000_000_000;
const TRACK_M: f64 = 0.5;
const RADIUS_M: f64 = 0.1;
const SECS: i64 = 20;

/// The robot drives 1 m/s. Its heading is 0.8 sin(0.5 t).
fn heading_rad(t: f64) -> f64 {
    0.8 * (0.5 * t).sin()
}

fn yaw_rate(t: f64) -> f64 {
    0.4 * (0.5 * t).cos()
}

/// The true end, integrated in steps of 1 ms.
fn end_m() -> [f64; 2] {
    (0..SECS * 1000).fold([0.0; 2], |[x, y], k| {
        let (sin, cos) = heading_rad((k as f64 + 0.5) * 1e-3).sin_cos();
        [x + 1e-3 * cos, y + 1e-3 * sin]
    })
}

/// Angles \[rad\] or rates \[rad/s\] of the left and the right wheel.
fn of_wheels(forward: f64, turned: f64) -> [f64; 2] {
    [-0.5, 0.5].map(|side| (forward + side * TRACK_M * turned) / RADIUS_M)
}

fn joints(
    encoding: Encoding,
    ns: i64,
    names: &[&str],
    positions: &[f64],
    rates: &[f64],
) -> Message {
    let mut message = RosMessage::with_header(encoding, ns).u32(names.len() as u32);
    for name in names {
        message = message.string(name);
    }
    for values in [positions, rates, &[]] {
        message = message.u32(values.len() as u32);
        // CDR aligns the numbers of a sequence only if there are any.
        message = message.f64s(values);
    }
    let (topic, type_name) = ("/joints", "sensor_msgs/JointState");
    Message { topic, type_name, encoding, stamp_ns: ns, data: message.finish() }
}

fn imu(encoding: Encoding, ns: i64, orientation: [f64; 4], yaw_rate: f64) -> Message {
    imu_in_frame(encoding, ns, "lidar", orientation, yaw_rate)
}

fn imu_in_frame(
    encoding: Encoding,
    ns: i64,
    frame_id: &str,
    orientation: [f64; 4],
    yaw_rate: f64,
) -> Message {
    let message = RosMessage::new(encoding);
    let message = if encoding == Encoding::Ros1 { message.u32(0) } else { message };
    let message = message
        .time(ns)
        .string(frame_id)
        .f64s(&orientation)
        .f64s(&[0.0; 9])
        .f64s(&[0.0, 0.0, yaw_rate])
        .f64s(&[0.0; 9])
        .f64s(&[0.0, 0.0, 9.8])
        .f64s(&[0.0; 9]);
    let (topic, type_name) = ("/imu", "sensor_msgs/Imu");
    Message { topic, type_name, encoding, stamp_ns: ns, data: message.finish() }
}

fn scan(encoding: Encoding, ns: i64) -> Message {
    let ranges: Vec<f32> = (0..90).map(|beam| 3.0 + (beam % 7) as f32).collect();
    let step = std::f32::consts::TAU / 90.0;
    let message = RosMessage::with_header(encoding, ns)
        .f32(0.0)
        .f32(89.0 * step)
        .f32(step)
        .f32(0.0)
        .f32(0.2)
        .f32(0.1)
        .f32(30.0)
        .f32_sequence(&ranges)
        .f32_sequence(&[]);
    let (topic, type_name) = ("/scan", "sensor_msgs/LaserScan");
    Message { topic, type_name, encoding, stamp_ns: ns, data: message.finish() }
}

/// Names, positions and velocities of joints.
type Joints = (Vec<&'static str>, Vec<f64>, Vec<f64>);

/// A drive whose messages are made by functions of the time \[s\]: the joints from the angles and the
/// rates of the wheels, the yaw rate of the gyroscope, and the orientation of the IMU.
struct Drive<'a> {
    encoding: Encoding,
    joints: &'a dyn Fn([f64; 2], [f64; 2]) -> Joints,
    gyro: &'a dyn Fn(f64) -> f64,
    orientation: &'a dyn Fn(f64) -> [f64; 4],
    /// Lines of `[ingest.pose]`.
    options: &'a str,
}

const WHEELS: [&str; 2] = ["left_wheel_joint", "right_wheel_joint"];

impl Default for Drive<'_> {
    fn default() -> Self {
        Self {
            encoding: Encoding::Cdr,
            joints: &|_, rates| (WHEELS.to_vec(), vec![], rates.to_vec()),
            gyro: &yaw_rate,
            orientation: &|_| [0.0; 4],
            options: "wheel_radius_m = 0.1",
        }
    }
}

impl Drive<'_> {
    fn messages(&self) -> Vec<Message> {
        let mut messages = Vec::new();
        for ms in (0..=SECS * 1000).step_by(10) {
            let (ns, t) = (START_NS + ms * 1_000_000, ms as f64 * 1e-3);
            if ms % 20 == 0 {
                let angles = of_wheels(t, heading_rad(t));
                let (names, positions, rates) = (self.joints)(angles, of_wheels(1.0, yaw_rate(t)));
                messages.push(joints(self.encoding, ns, &names, &positions, &rates));
            }
            messages.push(imu(self.encoding, ns, (self.orientation)(t), (self.gyro)(t)));
            if ms % 200 == 100 {
                messages.push(scan(self.encoding, ns));
            }
        }
        messages
    }

    fn pipeline(&self) -> String {
        let options = self.options;
        let wheels = if options.contains("wheels =") { "" } else { "wheels = \"/joints\"\n" };
        format!(
            "[ingest]\nlogs = [\"a.mcap\"]\nlidar.topic = \"/scan\"\n[ingest.pose]\nimu = \"/imu\"\ntrack_m = {TRACK_M}\n{options}\n{wheels}"
        )
    }

    fn workplace(&self) -> Workplace {
        let workplace = Workplace::new(&self.pipeline());
        fs::write(workplace.path("a.mcap"), log(&self.messages(), Schema::Empty)).unwrap();
        workplace
    }

    /// Ingests the drive. The poses must end within 0.15 m of the true end.
    #[track_caller]
    fn ends_where_it_did(&self, code: i32) -> Finished {
        let workplace = self.workplace();
        let finished = workplace.command("ingest", "out", &[]).expect(code);
        let (poses, _) = read_poses(&workplace.path("out/poses/a.parquet")).unwrap();
        let end = poses.poses().last().unwrap().pose;
        let [x, y] = end_m();
        let error_m = (end.x_m - x).hypot(end.y_m - y);
        assert!(error_m < 0.15, "{error_m:.2} m from the true end: {}", finished.stderr);
        finished
    }

    #[track_caller]
    fn is_refused(&self, texts: &[&str]) {
        self.workplace().command("ingest", "out", &[]).expect(1).says(texts);
    }
}

#[test]
fn a_drive_without_a_fault_has_no_warning_in_any_encoding() {
    for encoding in crate::wire::ROS {
        let finished = Drive { encoding, ..Drive::default() }.ends_where_it_did(0);
        let finished =
            finished.says(&["wheels: `left_wheel_joint` (left) and `right_wheel_joint` (right)"]);
        assert!(!finished.stderr.contains("warning"), "{}", finished.stderr);
    }
}

#[test]
fn grippers_arms_and_casters_are_not_wheels() {
    let names = [
        "arm_left_1_joint",
        "arm_right_1_joint",
        "gripper_left_finger_joint",
        "wheel_left_joint",
        "wheel_right_joint",
        "fl_caster_wheel_joint",
        "torso_lift_joint",
    ];
    let all = |_: [f64; 2], [left, right]: [f64; 2]| {
        (names.to_vec(), vec![], vec![0.0, 0.0, 0.0, left, right, 9.0, 0.0])
    };
    let drive = Drive { joints: &all, ..Drive::default() };
    drive.ends_where_it_did(0).says(&["wheels: `wheel_left_joint` (left)"]);
    let workplace = drive.workplace();
    let path = workplace.path("a.mcap");
    let inspected = loopboost(&["inspect", path.to_str().unwrap()]);
    let expected = "7 joints; wheels: wheel_left_joint (left), wheel_right_joint (right)";
    assert!(inspected.stdout.contains(expected), "{}", inspected.stdout);
}

#[test]
fn unequal_sides_are_refused_until_the_joints_are_named() {
    let three = |_: [f64; 2], [left, right]: [f64; 2]| {
        (
            vec!["front_left_wheel", "rear_left_wheel", "rear_right_wheel"],
            vec![],
            vec![0.0, left, right],
        )
    };
    let drive = Drive { joints: &three, ..Drive::default() };
    drive.is_refused(&["2 wheels on the left and 1 on the right", "rear_left_wheel"]);
    let options = "wheel_radius_m = 0.1\nwheels = { topic = \"/joints\", left = [\"rear_left_wheel\"], right = [\"rear_right_wheel\"] }";
    Drive { options, ..drive }.ends_where_it_did(0);
    let options =
        "wheel_radius_m = 0.1\nwheels = { topic = \"/joints\", left = [\"rear_left_wheel\"] }";
    let workplace = Drive { options, ..Drive::default() }.workplace();
    workplace.command("ingest", "out", &[]).expect(2).says(&["joints on one side only"]);
}

#[test]
fn positions_are_unwrapped_and_replace_velocities_of_zero() {
    let wrap = |rad: f64| rad.sin().atan2(rad.cos());
    for rates in [vec![], vec![0.0; 2], vec![f64::NAN; 2]] {
        let wrapped = |angles: [f64; 2], _: [f64; 2]| {
            (WHEELS.to_vec(), angles.map(wrap).to_vec(), rates.clone())
        };
        let drive = Drive { joints: &wrapped, ..Drive::default() };
        let finished = drive.ends_where_it_did(0).says(&["unwrapped"]);
        let is_zero = rates.first() == Some(&0.0);
        assert_eq!(finished.stderr.contains("zero_wheel_velocities"), is_zero);
    }
}

#[test]
fn the_unit_of_the_wheels_is_stated_or_confirmed() {
    let without = Drive { options: "", ..Drive::default() };
    without.is_refused(&["`ingest.pose.wheel_radius_m` is not set", "a radius of 0.100 m"]);
    let in_m_s = |_: [f64; 2], rates: [f64; 2]| {
        (WHEELS.to_vec(), vec![], rates.map(|r| r * RADIUS_M).to_vec())
    };
    let confirmed = Drive { joints: &in_m_s, options: "", ..Drive::default() };
    confirmed.ends_where_it_did(0).says(&["info[wheel_unit_confirmed]"]);
    let stated = Drive { options: "wheel_speed_unit = \"m/s\"", ..confirmed };
    let finished = stated.ends_where_it_did(0);
    assert!(!finished.stderr.contains("wheel_unit_confirmed"), "{}", finished.stderr);
}

#[test]
fn a_gyroscope_with_another_sign_or_unit_is_refused_and_can_be_scaled() {
    let reversed = |t: f64| -yaw_rate(t);
    let degrees = |t: f64| yaw_rate(t).to_degrees();
    Drive { gyro: &reversed, ..Drive::default() }
        .is_refused(&["turn in opposite senses", "-1.00 times"]);
    Drive { gyro: &degrees, ..Drive::default() }.is_refused(&["57.3 times as much as the wheels"]);
    Drive { gyro: &|_| 0.01, ..Drive::default() }.is_refused(&["The gyroscope is dead"]);
    let options = "wheel_radius_m = 0.1\ngyro_scale = -1";
    Drive { gyro: &reversed, options, ..Drive::default() }.ends_where_it_did(0);
    let options = "wheel_radius_m = 0.1\ngyro_scale = 0.0174533";
    Drive { gyro: &degrees, options, ..Drive::default() }.ends_where_it_did(0);
}

/// A second IMU, in another frame, writes to the same topic.
#[test]
fn two_imus_on_one_topic_are_refused_until_one_is_selected() {
    let workplace = Drive::default().workplace();
    let with_two = |options: &str| {
        let drive = Drive { options, ..Drive::default() };
        let mut messages = drive.messages();
        for ms in (0..=SECS * 1000).step_by(50) {
            let ns = START_NS + ms * 1_000_000 + 5_000_000;
            messages.push(imu_in_frame(Encoding::Cdr, ns, "camera_imu", [0.0; 4], 0.0));
        }
        fs::write(workplace.path("a.mcap"), log(&messages, Schema::Empty)).unwrap();
        fs::write(workplace.path("drive.toml"), drive.pipeline()).unwrap();
        workplace.command("ingest", "out", &[])
    };
    let refused = with_two("wheel_radius_m = 0.1").expect(1);
    refused.says(&["`camera_imu` (401 messages)", "ingest.pose.imu_frame_id"]);
    with_two("wheel_radius_m = 0.1\nimu_frame_id = \"lidar\"").expect(0);
}

#[test]
fn a_reversed_encoder_is_named() {
    let reversed =
        |_: [f64; 2], [left, right]: [f64; 2]| (WHEELS.to_vec(), vec![], vec![left, -right]);
    let drive = Drive { joints: &reversed, ..Drive::default() };
    drive.is_refused(&["If one wheel counts backward, they agree"]);
}

/// Half the true radius: the wheels turn half as much.
#[test]
fn a_wrong_radius_is_reported_with_the_ratio() {
    let workplace = Drive { options: "wheel_radius_m = 0.05", ..Drive::default() }.workplace();
    let finished = workplace.command("ingest", "out", &[]).expect(3);
    finished.says(&["warning[turn_ratio]: the gyroscope turns 2.00 times as much as the wheels"]);
}

#[test]
fn headings_that_do_not_turn_with_the_robot_are_not_used() {
    let about_z = |rad: f64| [0.0, 0.0, (0.5 * rad).sin(), (0.5 * rad).cos()];
    let with = |orientation: &dyn Fn(f64) -> [f64; 4], code: i32, says: &str| {
        Drive { orientation, ..Drive::default() }.ends_where_it_did(code).says(&[says]);
    };
    with(&|_| [0.0, 0.0, 0.0, 1.0], 0, "info[constant_heading]");
    with(&|t| about_z(-heading_rad(t)), 3, "warning[heading_turns_opposite]");
    with(&|t| about_z(0.02 * t.sin()), 3, "warning[heading_does_not_turn]");
    with(&|t| about_z(heading_rad(t)), 0, "info[headings_used]");
}
