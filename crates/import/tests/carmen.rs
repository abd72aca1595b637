//! CARMEN logs.

mod common;

use common::{Log, import};
use import::{ImportError, Options, Topics};
use messages::{read_laser_scan, read_odometry, read_pose};
use proptest::prelude::*;

const HEAD: &str = "\
# CARMEN Logfile
# FLASER num_readings [range_readings] x y theta odom_x odom_y odom_theta
PARAM robot_frontlaser_offset 0.0 nohost 0
SYNC logger nohost 0
";

const T0_NS: i64 = 976_052_857_245_617_000;

/// A scan of three readings; poses of the laser and of the robot; seconds after 976052857.
fn flaser(laser: &str, robot: &str, after: &str) -> String {
    format!("FLASER 3 1.5 81.91 0.25 {laser} {robot} 976052857.{after} nohost 0.1\n")
}

fn run(text: &str) -> Log {
    import(&[("intel.log", text.as_bytes())], &Options::default()).unwrap()
}

fn topics(log: &Log) -> Vec<(&str, i64)> {
    let message = |message: &'_ common::Message| message.log_ns as i64 - T0_NS;
    log.messages.iter().map(|m| (m.topic.as_str(), message(m))).collect()
}

#[test]
fn a_raw_log_gives_scans_and_the_odometry_of_its_odom_lines() {
    let text = HEAD.to_owned()
        + "ODOM 1.0 2.0 0.5 0.3 -0.1 0.0 976052857.245617 nohost 0.0\n"
        + &flaser("1 2 0.5", "1 2 0.5", "345617")
        + "ODOM 1.5 2.0 0.5 0.3 -0.1 0.0 976052857.445617 nohost 0.2\n";
    let log = run(&text);
    assert_eq!(topics(&log), [("/odom", 0), ("/scan", 100_000_000), ("/odom", 200_000_000)]);

    let odom = read_odometry(log.messages[0].source, &log.messages[0].bytes).unwrap();
    assert_eq!(odom.pose.position, [1.0, 2.0, 0.0]);
    assert!((2.0 * odom.pose.orientation[2].asin() - 0.5).abs() < 1e-12);
    assert_eq!(odom.linear_velocity, [0.3, 0.0, 0.0]);
    assert_eq!(odom.angular_velocity, [0.0, 0.0, -0.1]);

    let scan = read_laser_scan(log.messages[1].source, &log.messages[1].bytes).unwrap();
    assert_eq!(scan.stamp_ns, T0_NS + 100_000_000);
    assert_eq!(scan.ranges, [1.5, 81.91, 0.25]);
    // Three readings over half a circle.
    assert!((scan.angle_min.to_degrees() + 90.0).abs() < 1e-4);
    assert!((scan.angle_increment.to_degrees() - 90.0).abs() < 1e-4);
    assert_eq!((scan.range_min, scan.range_max), (0.0, 80.0));

    assert!(log.imported.dropped.is_empty());
    assert_eq!(
        log.remarks(),
        "1 PARAM (no sensor data) lines, which are not imported, \
         1 SYNC (no sensor data) lines, which are not imported"
    );
}

#[test]
fn a_corrected_log_gives_both_poses_of_every_scan() {
    let text = flaser("0 0 0", "0 0 0", "245617") + &flaser("3 4 0.2", "3.5 4 0.3", "345617");
    let log = run(&text);
    assert_eq!(
        topics(&log),
        [
            ("/odom", 0),
            ("/pose", 0),
            ("/scan", 0),
            ("/odom", 100_000_000),
            ("/pose", 100_000_000),
            ("/scan", 100_000_000)
        ]
    );
    let pose = read_pose(log.messages[4].source, &log.messages[4].bytes).unwrap();
    assert_eq!(pose.position, [3.0, 4.0, 0.0]);
    let odom = read_odometry(log.messages[3].source, &log.messages[3].bytes).unwrap();
    assert_eq!(odom.pose.position, [3.5, 4.0, 0.0]);
}

#[test]
fn a_log_whose_poses_agree_has_none_but_the_odometry() {
    let log = run(&flaser("1 2 0.5", "1 2 0.5", "245617"));
    assert_eq!(topics(&log), [("/odom", 0), ("/scan", 0)]);
}

#[test]
fn a_robotlaser_says_what_it_sees() {
    let line = "0 -1.5707963 3.1415926 0.0174533 30.0 0.01 0 2 1.25 2.5 1 7 \
                1 2 0.5 0.9 2 0.5 0.1 0.2 0.5 0.5 0.0 976052857.245617 nohost 0.1\n";
    let text =
        format!("ROBOTLASER1 {line}ROBOTLASER2 {line}RLASER 1 5 1 2 3 1 2 3 976052857.3 h 1\n");
    let log = run(&text);
    assert_eq!(
        topics(&log),
        [("/odom", 0), ("/scan", 0), ("/rear_scan", 0), ("/rear_scan", 54_383_000)]
    );
    let scan = read_laser_scan(log.messages[1].source, &log.messages[1].bytes).unwrap();
    assert_eq!(scan.ranges, [1.25, 2.5]);
    assert_eq!(scan.range_max, 30.0);
    assert!((scan.angle_min.to_degrees() + 90.0).abs() < 1e-4);
    assert!((scan.angle_increment - 0.017_453_3).abs() < 1e-8);
    let odom = read_pose(log.messages[0].source, &log.messages[0].bytes).unwrap();
    assert_eq!(odom.position, [0.9, 2.0, 0.0]);
}

#[test]
fn the_truth_of_a_simulator_is_kept() {
    let log = run("TRUEPOS 1 2 0 9 9 9 976052857.245617 nohost 0.1\n");
    assert_eq!(topics(&log), [("/ground_truth", 0)]);
}

#[test]
fn a_time_that_steps_back_is_kept_in_the_message() {
    let pose = "1 2 0.5";
    let text = flaser(pose, pose, "345617") + &flaser(pose, pose, "245617");
    let log = run(&text);
    let last = log.of("/scan").last().unwrap();
    assert_eq!(last.log_ns as i64, T0_NS + 100_000_000);
    assert_eq!(last.publish_ns as i64, T0_NS);
    assert_eq!(read_laser_scan(last.source, &last.bytes).unwrap().stamp_ns, T0_NS);
    assert_eq!(
        log.remarks(),
        "2 messages whose time steps back (logged at the time of the one before)"
    );
}

#[test]
fn lines_that_cannot_be_used_are_counted() {
    let good = flaser("0 0 0", "0 0 0", "245617");
    let text = good.clone()
        + "FLASER 3 1.0 2.0\n"
        + "FLASER 99999999999 1.0\n"
        + "FLASER 1 inf nan 0 0 0 0 0 976052857.5 h 1\n"
        + "ODOM 0 0 0 0 0 0 5000000000 h 1\n"
        + "IMU 0 0 0\n"
        + "\u{fffd}\u{1}garbage\n"
        + "\n"
        + &good[..good.len() - 20];
    let log = run(&text);
    assert_eq!(log.of("/scan").count(), 1);
    assert_eq!(
        log.dropped(),
        "4 FLASER lines that are cut or damaged, 1 lines before 1970 or after 2037, \
         1 unknown lines that are cut or damaged"
    );
    assert_eq!(log.remarks(), "1 IMU lines, which are not imported");
}

#[test]
fn topics_can_be_named() {
    let options = Options {
        topics: Topics { scan: "/front".to_owned(), ..Topics::default() },
        ..Options::default()
    };
    let text = flaser("0 0 0", "0 0 0", "245617");
    let log = import(&[("a.log", text.as_bytes())], &options).unwrap();
    assert_eq!(log.imported.topics[0].topic, "/front");
    assert_eq!(log.imported.topics[0].message_type, "sensor_msgs/msg/LaserScan");
}

#[test]
fn every_cut_keeps_whole_lines() {
    let text: String =
        (0..3).map(|k| flaser("1 2 0.5", "1 2 0.25", &format!("{}45617", k + 2))).collect();
    let whole = run(&text);
    for cut in 0..text.len() {
        match import(&[("a.log", &text.as_bytes()[..cut])], &Options::default()) {
            Ok(log) => {
                let scans: Vec<_> = log.of("/scan").map(|message| &message.bytes).collect();
                let expected: Vec<_> = whole.of("/scan").map(|message| &message.bytes).collect();
                assert_eq!(scans, expected[..scans.len()]);
            }
            Err(ImportError::Unrecognised { .. } | ImportError::Empty { .. }) => {}
            Err(error) => panic!("{cut}: {error}"),
        }
    }
}

proptest! {
    #[test]
    fn no_text_panics(words in "[A-Z0-9.eE \n-]{0,200}", bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        let head = flaser("0 0 0", "1 0 0", "245617");
        for keyword in ["FLASER ", "ROBOTLASER1 ", "ODOM ", ""] {
            let text = [head.as_bytes(), keyword.as_bytes(), words.as_bytes(), &bytes].concat();
            let _ = import(&[("a.log", &text)], &Options::default());
        }
    }
}
