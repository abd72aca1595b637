//! Deskewing, and poses from transforms, wheels and satellite fixes, tested on logs in memory.

#![allow(clippy::unwrap_used, reason = "a test panics if a value is missing")]

mod common;

use std::error::Error;
use std::f64::consts::{PI, TAU};
use std::path::Path;

use common::{Entry, codes, ingest_bytes, options, pose, small_chunks, write};
use dataset::{Pose2, Scan};
use ingest::{
    Frames, IngestError, Ingested, LidarSpeed, Log, Options, Origin, PlanarPose, PoseOptions,
    WheelSpeedUnit, ingest_with_speeds,
};
use messages::hdl32e::{BLOCK_PERIOD_NS, BLOCKS, LASER_PERIOD_NS, PACKET_PERIOD_NS, PacketBuilder};
use messages::{Encoding, Imu, JointState, LaserScan, NavSatFix, StampedPose3, Transform, ros};

/// Step of the azimuth per block, 0.18 deg: 2000 firings per revolution, 10.85 Hz.
const STEP: u64 = 18;
/// Duration of the log \[ns\].
const DURATION_NS: i64 = 1_000_000_000;
/// Standard deviation of the range \[m\] (HDL-32E manual: accuracy better than 2 cm).
const NOISE_M: f64 = 0.02;
/// The y coordinate of a wall parallel to the x axis \[m\].
const WALL_M: f64 = 5.0;

/// `map_from_base`: the robot turns on the spot with 1 rad/s.
fn robot_at(ns: i64) -> Pose2 {
    Pose2 { x_m: 0.0, y_m: 0.0, heading_rad: ns as f64 * 1e-9 }
}

const MOUNT: PlanarPose = PlanarPose { x_m: 1.0, y_m: 0.5, heading_deg: 30.0 };

fn mount() -> Pose2 {
    Pose2 { x_m: MOUNT.x_m, y_m: MOUNT.y_m, heading_rad: MOUNT.heading_deg.to_radians() }
}

/// Normally distributed noise: the sum of twelve uniform numbers (Knuth, vol. 2, 3.4.1).
struct Noise(u64);

impl Noise {
    fn next(&mut self) -> f64 {
        let mut uniform = || {
            self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (self.0 >> 11) as f64 / (1u64 << 53) as f64
        };
        (0..12).map(|_| uniform()).sum::<f64>() - 6.0
    }
}

/// Packets of a lidar on the robot. The only object is the wall at y = [`WALL_M`].
fn wall_packets() -> Vec<Entry> {
    let mut noise = Noise(7);
    let n_packets = DURATION_NS / PACKET_PERIOD_NS;
    let packets: Vec<_> = (0..n_packets)
        .map(|k| {
            let first = k as u64 * BLOCKS as u64;
            let azimuths = std::array::from_fn(|b| ((STEP * (first + b as u64)) % 36_000) as u16);
            let mut packet = PacketBuilder::new(azimuths, (k * PACKET_PERIOD_NS / 1000) as u32);
            for block in 0..BLOCKS {
                let block_at = first + block as u64;
                // Laser 15 fires 15/40 of a block period after the azimuth is read.
                let ns = block_at as i64 * BLOCK_PERIOD_NS + 15 * LASER_PERIOD_NS;
                let azimuth = (block_at as f64 + 0.375) * STEP as f64 * 1e-2;
                let lidar = robot_at(ns) * mount(); // map_from_base * base_from_lidar
                let direction = lidar.heading_rad - azimuth.to_radians();
                let range_m = (WALL_M - lidar.y_m) / direction.sin();
                if 0.0 < range_m && range_m < 20.0 {
                    let measured_m = range_m + NOISE_M * noise.next();
                    packet.set_return(block, 15, (measured_m / 0.002).round() as u16, 100);
                }
            }
            ((k + 1) * PACKET_PERIOD_NS, packet.finish())
        })
        .collect();
    let message = |chunk| ros::write_velodyne_scan(Encoding::Cdr, "velodyne", 0, chunk);
    packets
        .chunks(40)
        .map(|chunk| ("/packets", "velodyne_msgs/msg/VelodyneScan", "cdr", message(chunk)))
        .collect()
}

fn quaternion(heading_rad: f64) -> [f64; 4] {
    let (sin, cos) = (0.5 * heading_rad).sin_cos();
    [0.0, 0.0, sin, cos]
}

const MS: i64 = 1_000_000;

/// Poses of the robot with this period, for a little longer than the packets.
fn robot_poses(every_ms: usize) -> Vec<Entry> {
    let message = |ms: i64| {
        let at = robot_at(ms * MS);
        let pose = StampedPose3 {
            stamp_ns: ms * MS,
            position: [at.x_m, at.y_m, 0.0],
            orientation: quaternion(at.heading_rad),
        };
        ros::write_pose_stamped(Encoding::Cdr, "map", &pose)
    };
    (0..=1200)
        .step_by(every_ms)
        .map(|ms| ("/pose", "geometry_msgs/msg/PoseStamped", "cdr", message(ms)))
        .collect()
}

/// Mixes the messages of two topics, in proportion to their numbers.
fn interleaved(a: Vec<Entry>, b: Vec<Entry>) -> Vec<Entry> {
    let (n_a, n_b) = (a.len() as f64, b.len() as f64);
    let place = |k: usize, n: f64| (k as f64 + 0.5) / n;
    let mut all: Vec<(f64, Entry)> =
        a.into_iter().enumerate().map(|(k, entry)| (place(k, n_a), entry)).collect();
    all.extend(b.into_iter().enumerate().map(|(k, entry)| (place(k, n_b), entry)));
    all.sort_by(|a, b| a.0.total_cmp(&b.0));
    all.into_iter().map(|(_, entry)| entry).collect()
}

fn moving(pose: PoseOptions, deskew: bool) -> Options {
    let mut options = options("/packets", None);
    options.lidar.mount = Some(MOUNT);
    options.lidar.deskew = deskew;
    options.lidar.check().unwrap();
    pose.check().unwrap();
    Options { pose: Some(pose), ..options }
}

fn has_note(ingested: &Ingested, text: &str) -> bool {
    ingested.notes.iter().any(|note| note.to_string().starts_with(text))
}

fn ingest(entries: &[Entry], options: &Options) -> (Vec<Scan>, Ingested) {
    ingest_bytes(&write(entries, small_chunks()), options).unwrap()
}

/// Root mean square distance of the points of a scan from their best fitting line \[m\].
fn line_residual_m(scan: &Scan) -> f64 {
    let points: Vec<[f64; 2]> =
        scan.x_m.iter().zip(&scan.y_m).map(|(&x, &y)| [x.into(), y.into()]).collect();
    let n = points.len() as f64;
    let [mx, my] = [0, 1].map(|k| points.iter().map(|p| p[k]).sum::<f64>() / n);
    let sum = |f: fn(f64, f64) -> f64| points.iter().map(|p| f(p[0] - mx, p[1] - my)).sum::<f64>();
    let (xx, xy, yy) = (sum(|x, _| x * x), sum(|x, y| x * y), sum(|_, y| y * y));
    let smaller = 0.5 * (xx + yy - ((xx - yy).powi(2) + 4.0 * xy * xy).sqrt());
    (smaller / n).sqrt()
}

/// Expected residual from the range noise: at an angle b from the normal of the wall, the noise
/// perpendicular to the wall is multiplied by cos b.
fn expected_residual_m(scan: &Scan, lidar: &Pose2) -> f64 {
    let along = scan.x_m.iter().zip(&scan.y_m).map(|(&x, &y)| {
        let direction = f64::from(y).atan2(f64::from(x)) + lidar.heading_rad;
        direction.sin().powi(2)
    });
    NOISE_M * (along.sum::<f64>() / scan.len() as f64).sqrt()
}

/// Without deskewing the wall is bent, because the robot turns by about 0.04 rad while the lidar
/// scans the wall. With deskewing, from poses at 20 Hz, the residual equals the range noise.
#[test]
fn deskewing_reduces_the_residual_of_a_flat_wall_to_the_range_noise() {
    let log = interleaved(wall_packets(), robot_poses(50));
    let pose = || PoseOptions::of_topic("/pose");
    let (raw, of_raw) = ingest(&log, &moving(pose(), false));
    let (deskewed, of_deskewed) = ingest(&log, &moving(pose(), true));
    assert_eq!((raw.len(), deskewed.len()), (10, 10));
    assert!(has_note(&of_raw, "scans not deskewed (`ingest.lidar.deskew = false`)"));
    assert!(has_note(&of_deskewed, "10 scans deskewed"));
    for (raw, deskewed) in raw.iter().zip(&deskewed) {
        let lidar = robot_at(raw.stamp_ns) * mount();
        let noise_m = expected_residual_m(deskewed, &lidar);
        assert!(400 < deskewed.len() && raw.len() == deskewed.len());
        let (before, after) = (line_residual_m(raw), line_residual_m(deskewed));
        assert!(2.0 * noise_m < before, "{before} m");
        // The standard error of the root mean square of 700 points is 1 / sqrt(2 * 700) = 2.7 %.
        assert!((after / noise_m - 1.0).abs() < 0.1, "{after} m, expected {noise_m} m");
        // The wall is at the correct position for the pose at the stamp.
        let mean_m = mean_wall_m(deskewed, &lidar);
        assert!((mean_m - WALL_M).abs() < 0.005, "{mean_m} m");
    }
}

/// The speeds of the lidar come from elsewhere. The poses of the log are not read, and it need not have any.
#[test]
fn scans_are_deskewed_by_given_speeds() {
    let options = moving(PoseOptions::of_topic("/pose"), true);
    let (expected, _) = ingest(&interleaved(wall_packets(), robot_poses(50)), &options);
    let (raw, _) = ingest(&wall_packets(), &Options { pose: None, ..options.clone() });
    let log = Log::from_bytes(Path::new("drive.mcap"), write(&wall_packets(), small_chunks()));
    let log = log.unwrap();
    let deskewed = |deskew: bool, speeds: &[Option<LidarSpeed>]| {
        let mut options = options.clone();
        options.lidar.deskew = deskew;
        let mut scans = Vec::new();
        let take = |batch| {
            scans.extend(batch);
            Ok::<_, IngestError>(())
        };
        let ingested = ingest_with_speeds(&[&log], &options, speeds, take, |_| ()).unwrap();
        assert!(ingested.trajectory.poses().is_empty());
        (scans, ingested)
    };
    // The robot turns by 1 rad/s, so that the lidar moves at a right angle to its place on the robot.
    let (sin, cos) = mount().heading_rad.sin_cos();
    let speed = LidarSpeed {
        x_m_s: cos * -MOUNT.y_m + sin * MOUNT.x_m,
        y_m_s: -sin * -MOUNT.y_m + cos * MOUNT.x_m,
        heading_rad_s: 1.0,
    };
    let (scans, ingested) = deskewed(true, &[Some(speed); 10]);
    assert!(has_note(&ingested, "10 scans deskewed"), "{:?}", ingested.notes);
    assert_eq!((scans.len(), raw.len()), (10, 10));
    for (scan, expected) in scans.iter().zip(&expected) {
        // In 0.1 s, the direction of the speed turns by 0.1 rad: 0.1 s 1.1 m/s 0.1 / 2 = 6 mm.
        let near = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 0.007);
        assert!(scan.len() == expected.len() && near(&scan.x_m, &expected.x_m));
        assert!(near(&scan.y_m, &expected.y_m));
    }
    let far = |k: usize| raw[k].x_m.iter().zip(&expected[k].x_m).any(|(a, b)| 0.1 < (a - b).abs());
    assert!((0..10).all(far));
    // Switched off, without speeds, and with one for the third scan only.
    assert_eq!(deskewed(false, &[Some(speed); 10]).0, raw);
    assert_eq!(deskewed(true, &[]).0, raw);
    let (some, ingested) = deskewed(true, &[None, None, Some(speed)]);
    assert!((0..10).all(|k| (some[k] == raw[k], some[k] == scans[k]) == (k != 2, k == 2)));
    assert!(has_note(&ingested, "1 scan deskewed"), "{:?}", ingested.notes);
    let note = "9 scans not deskewed: the motion is not known at least every 0.25 s";
    assert!(has_note(&ingested, note), "{:?}", ingested.notes);
}

/// Mean y of the points of a scan in the map \[m\].
fn mean_wall_m(scan: &Scan, lidar: &Pose2) -> f64 {
    let y = scan.x_m.iter().zip(&scan.y_m).map(|(&x_m, &y_m)| {
        (*lidar * Pose2 { x_m: x_m.into(), y_m: y_m.into(), heading_rad: 0.0 }).y_m
    });
    y.sum::<f64>() / scan.len() as f64
}

#[test]
fn scans_with_an_unknown_motion_are_not_deskewed() {
    let pose = || PoseOptions::of_topic("/pose");
    let (raw, _) = ingest(&interleaved(wall_packets(), robot_poses(50)), &moving(pose(), false));
    let sparse = interleaved(wall_packets(), robot_poses(300));
    let (scans, ingested) = ingest(&sparse, &moving(pose(), true));
    assert_eq!(scans, raw);
    assert!(!has_note(&ingested, "scans deskewed"), "{:?}", ingested.notes);
    let note = "10 scans not deskewed: the motion is not known at least every 0.25 s";
    assert!(has_note(&ingested, note), "{:?}", ingested.notes);
}

/// The log is written topic by topic, with the poses first or last, with and without chunks.
#[test]
fn the_position_of_the_poses_in_the_file_does_not_matter() {
    let pose = || PoseOptions::of_topic("/pose");
    let options = moving(pose(), true);
    let (packets, poses) = (wall_packets(), robot_poses(50));
    let (expected, _) = ingest(&interleaved(packets.clone(), poses.clone()), &options);
    let last: Vec<Entry> = packets.iter().chain(&poses).cloned().collect();
    let first: Vec<Entry> = poses.iter().chain(&packets).cloned().collect();
    for entries in [&last, &first] {
        for writing in [small_chunks(), small_chunks().use_chunks(false)] {
            let (scans, ingested) = ingest_bytes(&write(entries, writing), &options).unwrap();
            assert_eq!(scans, expected);
            assert_eq!((ingested.trajectory.poses().len(), ingested.losses.is_empty()), (25, true));
        }
    }
}

/// A planar scanner with 0.1 s per scan drives toward a wall with 1 m/s.
#[test]
fn planar_scans_with_return_times_are_deskewed() {
    let beams = 101;
    let scan = LaserScan {
        stamp_ns: 100 * MS,
        angle_min: -0.5,
        angle_max: None,
        angle_increment: 0.01,
        time_increment_s: 0.001,
        range_min: 0.1,
        range_max: 50.0,
        ranges: (0..beams)
            .map(|beam| {
                let angle = -0.5 + 0.01 * f64::from(beam);
                ((WALL_M - 0.001 * f64::from(beam)) / angle.cos()) as f32
            })
            .collect(),
    };
    let mut log: Vec<Entry> = vec![(
        "/scan",
        "sensor_msgs/msg/LaserScan",
        "cdr",
        ros::write_laser_scan(Encoding::Cdr, "laser", &scan),
    )];
    // 0.1 m every 0.1 s, the motion in the scan.
    let slow_pose = |k: i64| StampedPose3 {
        stamp_ns: k * 100 * MS,
        position: [0.1 * k as f64, 0.0, 0.0],
        orientation: quaternion(0.0),
    };
    let stamped = |k| ros::write_pose_stamped(Encoding::Cdr, "map", &slow_pose(k));
    log.extend((0..4).map(|k| ("/pose", "geometry_msgs/msg/PoseStamped", "cdr", stamped(k))));
    let (scans, _) = ingest(&log, &options("/scan", Some("/pose")));
    assert!(scans[0].x_m.iter().all(|x| (f64::from(*x) - WALL_M).abs() < 1e-5));
    // Steps of 1 m in 0.1 s, 10 m/s, are below the default limit of 15 m/s. With a limit of 5 m/s
    // they are too fast.
    let fast: Vec<Entry> = [log[0].clone()]
        .into_iter()
        .chain(
            (0..4)
                .map(|k| ("/pose", "geometry_msgs/msg/PoseStamped", "cdr", pose(k, Encoding::Cdr))),
        )
        .collect();
    let mut limited = options("/scan", Some("/pose"));
    let (_, ingested) = ingest(&fast, &limited);
    assert!(has_note(&ingested, "1 scan deskewed"));
    limited.pose.as_mut().unwrap().max_speed_m_s = 5.0;
    let (_, ingested) = ingest(&fast, &limited);
    let note =
        "3 steps between poses with more than 5 m/s; the longest is 1.00 m in 0.100 s at 0 ns";
    assert!(has_note(&ingested, note), "{:?}", ingested.notes);
    assert!(!has_note(&ingested, "scans deskewed"), "{:?}", ingested.notes);
}

/// The same turn on the spot, as transforms map -> odom -> base (50 Hz) -> lidar.
#[test]
fn transforms_give_poses_and_deskew_scans() {
    let transform = |parent: &str, child: &str, ms: i64, at: Pose2| Transform {
        stamp_ns: ms * MS,
        parent: parent.to_owned(),
        child: child.to_owned(),
        translation: [at.x_m, at.y_m, 0.7],
        rotation: quaternion(at.heading_rad),
    };
    // The transform from map to odom has a low rate.
    let map_from_odom = Pose2 { x_m: 30.0, y_m: -4.0, heading_rad: 2.0 };
    let mut entries: Vec<Entry> = Vec::new();
    let tf = |topic, transforms: &[Transform]| -> Entry {
        (topic, "tf2_msgs/msg/TFMessage", "cdr", ros::write_tf(Encoding::Cdr, transforms))
    };
    entries.push(tf("/tf_static", &[transform("base", "lidar", 0, mount())]));
    for ms in (0..=1200).step_by(20) {
        let wheel = transform("base", "wheel", ms, robot_at(ms * 50 * MS));
        let base = transform("odom", "base", ms, robot_at(ms * MS));
        let map = transform("map", "odom", ms, map_from_odom);
        entries.push(match ms % 200 {
            0 => tf("/tf", &[wheel, base, map]),
            _ => tf("/tf", &[wheel, base]),
        });
    }
    let log = interleaved(wall_packets(), entries);
    let of = |parent: &str, child: &str| {
        let topics = vec!["/tf".to_owned(), "/tf_static".to_owned()];
        let (parent, child) = (parent.to_owned(), child.to_owned());
        PoseOptions { frames: Some(Frames { parent, child, topics }), ..PoseOptions::default() }
    };
    let mut options = moving(of("map", "lidar"), true);
    options.lidar.mount = None;
    let (scans, ingested) = ingest(&log, &options);
    assert_eq!(ingested.trajectory.poses().len(), 61);
    for stamped in ingested.trajectory.poses() {
        let expected = map_from_odom * robot_at(stamped.stamp_ns) * mount();
        assert!(expected.distance_m(&stamped.pose) < 1e-12);
        assert!(expected.heading_difference_rad(&stamped.pose) < 1e-12);
    }
    // The same scans as with poses of the robot and a mount. The pose steps are 20 and 50 ms, and
    // the points are f32.
    let by_pose = moving(PoseOptions::of_topic("/pose"), true);
    let (expected, _) = ingest(&interleaved(wall_packets(), robot_poses(50)), &by_pose);
    assert_eq!(scans.len(), expected.len());
    for (a, b) in scans.iter().zip(&expected) {
        let steps = a.x_m.iter().zip(&b.x_m).chain(a.y_m.iter().zip(&b.y_m));
        assert!(steps.map(|(a, b)| (a - b).abs()).fold(0.0, f32::max) < 1e-3);
    }
    let error = |parent, child| {
        let options = moving(of(parent, child), true);
        let error = ingest_bytes(&write(&log, small_chunks()), &options).unwrap_err();
        (error.to_string(), error.source().unwrap().to_string())
    };
    let (message, cause) = error("map", "camera");
    assert_eq!(
        message,
        "drive.mcap: no poses of frame `camera` in frame `map`; the transforms contain the frames `base`, `lidar`, `map`, `odom`, `wheel`; set `ingest.pose.frames` to two connected frames"
    );
    assert_eq!(cause, "no chain of transforms connects the two frames");
    let (_, cause) = error("base", "lidar");
    assert_eq!(cause, "all transforms between the two frames are static");
}

/// The same turn on the spot, measured by wheels at 50 Hz and an IMU at 100 Hz that is mounted
/// upside down.
#[test]
fn dead_reckoning_from_wheels_deskews_scans() {
    let mut entries: Vec<Entry> = Vec::new();
    for ms in (0..=1200i64).step_by(10) {
        let imu = Imu {
            stamp_ns: ms * MS,
            orientation: None,
            angular_velocity: [0.0, 0.0, -1.0],
            linear_acceleration: Some([0.0, 0.0, -9.8]),
        };
        let bytes = ros::write_imu(Encoding::Cdr, "imu", &imu);
        entries.push(("/imu", "sensor_msgs/msg/Imu", "cdr", bytes));
        if ms % 20 == 0 {
            let joints = JointState {
                stamp_ns: ms * MS,
                names: vec!["left".to_owned(), "right".to_owned()],
                positions: vec![-0.25 * ms as f64 * 1e-3, 0.25 * ms as f64 * 1e-3],
                velocities: vec![],
            };
            let bytes = ros::write_joint_state(Encoding::Cdr, "base", &joints);
            entries.push(("/wheels", "sensor_msgs/msg/JointState", "cdr", bytes));
        }
    }
    let log = interleaved(wall_packets(), entries);
    for imu in [Some("/imu".to_owned()), None] {
        let pose = PoseOptions {
            wheels: Some("/wheels".into()),
            wheel_speed_unit: Some(WheelSpeedUnit::MetresPerSecond),
            imu,
            track_m: Some(0.5),
            ..PoseOptions::default()
        };
        let (scans, ingested) = ingest(&log, &moving(pose, true));
        // The first revolution starts before the first speed, which is computed from two positions.
        let is_deskewed = |n| has_note(&ingested, &format!("{n} scans deskewed"));
        assert!(is_deskewed(9) || is_deskewed(10), "{:?}", ingested.notes);
        for scan in &scans[1..] {
            let noise_m = expected_residual_m(scan, &(robot_at(scan.stamp_ns) * mount()));
            let residual_m = line_residual_m(scan);
            assert!((residual_m / noise_m - 1.0).abs() < 0.1, "{residual_m} m, {noise_m} m");
        }
        // These are the poses of the lidar, 1.118 m from the center of the turn.
        for stamped in ingested.trajectory.poses() {
            let radius_m = stamped.pose.distance_m(&Pose2::default());
            assert!((radius_m - 1.25f64.sqrt()).abs() < 0.02, "{radius_m} m");
            assert!(stamped.covariance.is_some());
        }
    }
}

/// 20 satellite messages toward the northeast, 4 of them without a fix.
#[test]
fn satellite_fixes_give_poses_relative_to_an_origin() {
    let fix = |k: i64| NavSatFix {
        stamp_ns: k * 100 * MS,
        status: if k % 5 == 4 { -1 } else { 0 },
        latitude_deg: 42.29 + 1e-5 * k as f64,
        longitude_deg: -83.71 + 1e-5 * k as f64,
        altitude_m: 250.0,
        covariance: [0.0; 9],
    };
    let schema = "sensor_msgs/msg/NavSatFix";
    let message = |k| ros::write_nav_sat_fix(Encoding::Cdr, "gps", &fix(k));
    let fixes: Vec<Entry> = (0..20).map(|k| ("/fix", schema, "cdr", message(k))).collect();
    let log = interleaved(common::planar_log(), fixes);
    let mut options = options("/scan", Some("/fix"));
    let (_, ingested) = ingest(&log, &options);
    assert_eq!(codes(&ingested.losses), [("no_gnss_fix", 4)]);
    assert!(ingested.is_own_frame);
    let poses = ingested.trajectory.poses();
    assert_eq!((poses.len(), poses[0].pose.x_m, poses[0].pose.y_m), (16, 0.0, 0.0));
    // At latitude 42.29 deg, one degree of latitude is 111 068 m and one degree of longitude 82 464
    // m (radii of curvature of WGS 84). An altitude of 250 m adds 250 m to the radii.
    let far = poses.last().unwrap().pose;
    assert!((far.y_m - 18e-5 * 111_068.0 * (1.0 + 250.0 / 6.37e6)).abs() < 2e-3, "{far:?}");
    assert!((far.x_m - 18e-5 * 82_464.0 * (1.0 + 250.0 / 6.37e6)).abs() < 2e-3, "{far:?}");
    assert!((far.heading_rad - (111_068.0f64 / 82_464.0).atan()).abs() < 1e-3);
    let note = "poses from 16 satellite fixes, headings from the course, origin { latitude_deg = 42.29, longitude_deg = -83.71, altitude_m = 250 }";
    assert!(has_note(&ingested, note), "{:?}", ingested.notes);
    // An origin 1e-3 deg farther south is 111 m away.
    let origin = Origin { latitude_deg: 42.289, longitude_deg: -83.71, altitude_m: 250.0 };
    options.pose.as_mut().unwrap().origin = Some(origin);
    let (_, ingested) = ingest(&log, &options);
    assert!(!ingested.is_own_frame);
    assert!((ingested.trajectory.poses()[0].pose.y_m - 111.07).abs() < 0.02);
}

/// The lidar is mounted backward on the robot.
#[test]
fn the_trajectory_contains_the_poses_of_the_lidar() {
    let mut options = options("/scan", Some("/pose"));
    options.lidar.mount = Some(PlanarPose { x_m: 0.5, y_m: -0.25, heading_deg: 180.0 });
    let (_, ingested) = ingest(&common::planar_log(), &options);
    for (k, stamped) in ingested.trajectory.poses().iter().enumerate() {
        assert_eq!((stamped.pose.x_m, stamped.pose.y_m), (k as f64 + 0.5, -0.25));
        assert!((stamped.pose.heading_rad.rem_euclid(TAU) - PI).abs() < 1e-12);
    }
}
