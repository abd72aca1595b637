//! A robot that is carried to another building while its odometry goes on, in a log made by the test.

use std::collections::BTreeMap;
use std::f64::consts::{FRAC_PI_2, PI, TAU};
use std::fs;

use dataset::tables::{read_closures, read_poses, read_registered, read_trajectory};
use dataset::{JudgedClosure, Pose2};
use messages::ros::{write_laser_scan, write_pose_stamped};
use messages::{LaserScan, StampedPose3};

use crate::faults_program::message;
use crate::made::{Schema, log};
use crate::support::Workplace;

const START_NS: i64 = 1_700_000_000_000_000_000;
const STEP_NS: i64 = 250_000_000;

const PIPELINE: &str = r#"
name = "carried"
seed = 7
[ingest]
logs = ["logs"]
lidar.topic = "/scan"
lidar.range_min_m = 0.1
pose.topic = "/pose"
[train]
learners = []
[detect]
"#;

/// The ends of a wall \[m\].
type Wall = [[f64; 2]; 2];

fn rectangle([x0, y0]: [f64; 2], [x1, y1]: [f64; 2]) -> [Wall; 4] {
    let corners = [[x0, y0], [x1, y0], [x1, y1], [x0, y1]];
    std::array::from_fn(|k| [corners[k], corners[(k + 1) % 4]])
}

/// A corridor of 2.5 m around a block of 12 m by 8 m, with columns.
fn corridor() -> Vec<Wall> {
    let mut walls = Vec::new();
    walls.extend(rectangle([0.0, 0.0], [12.0, 8.0]));
    walls.extend(rectangle([-2.5, -2.5], [14.5, 10.5]));
    for x_m in [0.7, 2.2, 5.1, 6.3, 9.8, 12.9] {
        walls.extend(rectangle([x_m, -2.5], [x_m + 0.3, -2.2]));
        walls.extend(rectangle([x_m + 0.9, 10.2], [x_m + 1.2, 10.5]));
    }
    for y_m in [1.1, 4.2, 6.0, 8.3] {
        walls.extend(rectangle([14.2, y_m], [14.5, y_m + 0.4]));
        walls.extend(rectangle([-2.5, y_m + 0.6], [-2.1, y_m + 1.0]));
    }
    walls
}

/// A hall of 23 m by 20 m, with pillars and a long table.
fn hall() -> Vec<Wall> {
    let mut walls = Vec::new();
    walls.extend(rectangle([-6.0, -5.5], [17.0, 14.5]));
    for [x_m, y_m] in [[1.0, 2.0], [5.5, 4.5], [9.0, 1.5], [10.5, 6.5], [-4.5, 9.0], [15.5, -3.5]] {
        walls.extend(rectangle([x_m, y_m], [x_m + 0.5, y_m + 0.7]));
    }
    walls.extend(rectangle([3.0, -4.5], [8.0, -4.0]));
    walls
}

/// The lap in the middle of the corridor, 0.2 m per step.
fn lap() -> Vec<Pose2> {
    let mut poses = vec![Pose2 { x_m: 0.0, y_m: -1.25, heading_rad: 0.0 }];
    let mut drive = |n: usize, step: Pose2| {
        for _ in 0..n {
            poses.push(poses[poses.len() - 1] * step);
        }
    };
    for n_straight in [60, 40, 60, 40] {
        drive(n_straight, Pose2 { x_m: 0.2, y_m: 0.0, heading_rad: 0.0 });
        // A quarter of a circle of 1.25 m.
        let turn_rad = FRAC_PI_2 / 10.0;
        let chord_m = 2.5 * (turn_rad / 2.0).sin();
        let (sin, cos) = (turn_rad / 2.0).sin_cos();
        drive(10, Pose2 { x_m: chord_m * cos, y_m: chord_m * sin, heading_rad: turn_rad });
    }
    poses.pop();
    poses
}

/// Distance along a ray to a wall \[m\].
fn range_m(from: &Pose2, direction_rad: f64, [a, b]: &Wall) -> Option<f64> {
    let (dy, dx) = direction_rad.sin_cos();
    let (ex, ey) = (b[0] - a[0], b[1] - a[1]);
    let (fx, fy) = (a[0] - from.x_m, a[1] - from.y_m);
    let determinant = dx * ey - dy * ex;
    let along_ray = (fx * ey - fy * ex) / determinant;
    let along_wall = (fx * dy - fy * dx) / determinant;
    (0.0 < along_ray && (0.0..=1.0).contains(&along_wall)).then_some(along_ray)
}

/// Scans after the robot was put down, before it moves.
const N_AT_REST: usize = 12;

/// Two laps in the corridor, and as many in the hall, after some time at rest. The poses are those of four laps with a
/// stop after the second one.
fn carried() -> Vec<u8> {
    let (corridor, hall) = (corridor(), hall());
    let lap = lap();
    let laps = || lap.iter().chain(&lap);
    let at_rest = std::iter::repeat_n(&lap[lap.len() - 1], N_AT_REST);
    let mut messages = Vec::new();
    for (k, pose) in laps().chain(at_rest).chain(laps()).enumerate() {
        let stamp_ns = START_NS + k as i64 * STEP_NS;
        let (sin, cos) = (pose.heading_rad / 2.0).sin_cos();
        let stamped = StampedPose3 {
            stamp_ns,
            position: [pose.x_m, pose.y_m, 0.0],
            orientation: [0.0, 0.0, sin, cos],
        };
        let data = write_pose_stamped(messages::Encoding::Cdr, "odom", &stamped);
        messages.push(message("/pose", "geometry_msgs/PoseStamped", stamp_ns, data));
        let walls = if k < 2 * lap.len() { &corridor } else { &hall };
        let range = |beam: u32| {
            let direction_rad = pose.heading_rad - PI + f64::from(beam) * TAU / 360.0;
            let hits = walls.iter().filter_map(|wall| range_m(pose, direction_rad, wall));
            hits.fold(f64::INFINITY, f64::min) as f32
        };
        let scan = LaserScan {
            stamp_ns,
            angle_min: -PI,
            angle_max: Some(-PI + 359.0 * TAU / 360.0),
            angle_increment: TAU / 360.0,
            time_increment_s: 0.0,
            range_min: 0.1,
            range_max: 60.0,
            ranges: (0..360).map(range).collect(),
        };
        let data = write_laser_scan(messages::Encoding::Cdr, "laser", &scan);
        messages.push(message("/scan", "sensor_msgs/LaserScan", stamp_ns, data));
    }
    log(&messages, Schema::Empty)
}

/// The two buildings get a segment and a map each, and the laps in each of them are closed.
#[test]
fn a_robot_that_was_carried_begins_a_new_segment() {
    let workplace = Workplace::new(PIPELINE);
    fs::create_dir(workplace.path("logs")).unwrap();
    fs::write(workplace.path("logs/monday.mcap"), carried()).unwrap();
    let made = workplace.command("run", "out", &[]).expect(3);
    let read = |file: &str| workplace.path(&format!("out/{file}"));
    let rows = read_registered(&read("registered/monday.parquet")).unwrap().0;
    let first = rows.iter().position(|row| row.segment == 1).unwrap();
    let [last, next] = [first - 1, first].map(|k| rows[k].id.scan);
    let n_lap = lap().len() as u32;
    let moves_again = 2 * n_lap + N_AT_REST as u32;
    assert!(last < 2 * n_lap && moves_again <= next && next < moves_again + 4, "{last} {next}");
    assert!(rows[first..].iter().all(|row| row.segment == 1));
    assert_eq!(rows[first].travel_m, 0.0, "the path of a segment begins with 0");
    let secs = 1_700_000_000.0 + 0.25 * f64::from(next);
    let n_between = next - last - 1;
    made.says(&[
        "warning[scans_of_another_place]",
        &format!("1 time; first at {secs:.3} s"),
        &format!("{n_between} scans between get no pose"),
    ]);
    let keyframes = read_trajectory(&read("trajectory.parquet")).unwrap().0;
    let is_second = |scan: u32| 2 * n_lap <= scan;
    for keyframe in &keyframes {
        let segment = u32::from(is_second(keyframe.id.scan));
        assert_eq!((keyframe.segment, keyframe.map), (segment, segment), "{:?}", keyframe.id);
    }
    let poses = read_poses(&read("trajectory/monday.parquet")).unwrap().0;
    let n_poses = 4 * n_lap + N_AT_REST as u32 - n_between;
    assert_eq!(poses.poses().len() as u32, n_poses);
    for (k, pose) in (0..).zip(poses.poses()) {
        assert_eq!(pose.segment, u32::from(last < k), "{k}");
    }
    let (mut closures, _) = read_closures(&read("closures.parquet")).unwrap();
    closures.retain(JudgedClosure::is_accepted);
    let mut of_buildings: BTreeMap<bool, usize> = BTreeMap::new();
    for JudgedClosure { closure, .. } in &closures {
        let [reference, query] = [&closure.reference, &closure.query].map(|id| is_second(id.scan));
        assert_eq!(reference, query, "{closure:?}");
        *of_buildings.entry(query).or_default() += 1;
    }
    assert!(of_buildings.len() == 2 && of_buildings.values().all(|n| 20 < *n), "{of_buildings:?}");
}
