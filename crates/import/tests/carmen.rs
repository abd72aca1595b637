//! Imports CARMEN logs.

#![allow(clippy::unwrap_used, reason = "a test panics if a value is missing")]

mod common;

use common::{Log, import};
use dataset::Severity;
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

/// A line with a scan of three readings, the poses of the laser and the robot, and the decimal places
/// of the time 976052857.
fn flaser(laser: &str, robot: &str, after: &str) -> String {
    format!("FLASER 3 1.5 81.91 0.25 {laser} {robot} 976052857.{after} nohost 0.1\n")
}

fn run(text: &str) -> Log {
    import(&[("intel.log", text.as_bytes())], &Options::default()).unwrap()
}

fn topics(log: &Log) -> Vec<(&str, i64)> {
    let message = |m: &'_ common::Message| m.log_ns as i64 - T0_NS;
    log.messages.iter().map(|m| (m.topic.as_str(), message(m))).collect()
}

#[test]
fn a_raw_log_gives_scans_and_odometry_from_odom_lines() {
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
    // Three readings cover 180 deg.
    assert!((scan.angle_min.to_degrees() + 90.0).abs() < 1e-4);
    assert!((scan.angle_increment.to_degrees() - 90.0).abs() < 1e-4);
    assert_eq!((scan.range_min, scan.range_max), (0.0, 80.0));

    assert_eq!(log.losses(Severity::Warning), []);
    assert_eq!(
        log.imported.losses.to_string(),
        "1 PARAM line not imported (no sensor data) (file `intel.log`), \
         1 SYNC line not imported (no sensor data) (file `intel.log`)"
    );
}

#[test]
fn a_corrected_log_gives_both_poses_of_each_scan() {
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
fn a_log_with_equal_poses_gives_only_the_odometry() {
    let log = run(&flaser("1 2 0.5", "1 2 0.5", "245617"));
    assert_eq!(topics(&log), [("/odom", 0), ("/scan", 0)]);
}

#[test]
fn a_robotlaser_scan_has_its_own_angles_and_range() {
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
fn the_true_pose_of_a_simulator_becomes_ground_truth() {
    let log = run("TRUEPOS 1 2 0 9 9 9 976052857.245617 nohost 0.1\n");
    assert_eq!(topics(&log), [("/ground_truth", 0)]);
}

#[test]
fn a_time_that_steps_back_stays_in_the_message() {
    let pose = "1 2 0.5";
    let text = flaser(pose, pose, "345617") + &flaser(pose, pose, "245617");
    let log = run(&text);
    let last = log.of("/scan").last().unwrap();
    assert_eq!(last.log_ns as i64, T0_NS + 100_000_000);
    assert_eq!(last.publish_ns as i64, T0_NS);
    assert_eq!(read_laser_scan(last.source, &last.bytes).unwrap().stamp_ns, T0_NS);
    assert_eq!(log.losses(Severity::Info), [("message_times_step_back", 1); 2]);
    assert_eq!(log.losses(Severity::Warning), []);
}

#[test]
fn lines_that_cannot_be_used_are_losses() {
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
        log.losses(Severity::Warning),
        [("times_out_of_range", 1), ("malformed_lines", 4), ("malformed_lines", 1)]
    );
    assert_eq!(log.losses(Severity::Info), [("lines_not_imported", 1)]);
    let losses = log.imported.losses.to_string();
    assert!(losses.contains("4 malformed FLASER lines (file `intel.log`)"), "{losses}");
    assert!(losses.contains("1 malformed unknown line (file `intel.log`)"), "{losses}");
}

#[test]
fn topic_names_can_be_changed() {
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
fn a_truncated_log_keeps_its_complete_lines() {
    let text: String =
        (0..3).map(|k| flaser("1 2 0.5", "1 2 0.25", &format!("{}45617", k + 2))).collect();
    let complete = run(&text);
    for cut in 0..text.len() {
        match import(&[("a.log", &text.as_bytes()[..cut])], &Options::default()) {
            Ok(log) => {
                let scans: Vec<_> = log.of("/scan").map(|message| &message.bytes).collect();
                let expected: Vec<_> = complete.of("/scan").map(|message| &message.bytes).collect();
                assert_eq!(scans, expected[..scans.len()]);
            }
            Err(ImportError::UnknownFormat { .. } | ImportError::Empty { .. }) => {}
            Err(error) => panic!("{cut}: {error}"),
        }
    }
}

/// A corrected log: a robot at 1 m/s, corrected by 0.19 m to the side. `time` gives the time of line
/// `k`, and `odom` whether there are `ODOM` lines.
fn corrected(time: impl Fn(usize) -> String, odom: bool) -> String {
    let mut text = HEAD.to_owned();
    for k in 0..20 {
        let (x, time) = (0.2 * k as f64, time(k));
        if odom {
            text += &format!("ODOM {x} 0 0 0.9 0 0 {time} h {time}\n");
        }
        text += &format!("FLASER 3 1.5 1.6 1.5 {x} 0.19 0 {x} 0.19 0 {time} h {time}\n");
    }
    text
}

/// Checks that each scan has a pose on `topic` with its own stamp, at (0.2 k, 0.19).
fn check_own_poses(log: &Log, topic: &str) {
    let scans: Vec<_> = log.of("/scan").collect();
    let poses: Vec<_> = log.of(topic).collect();
    assert_eq!((scans.len(), poses.len()), (20, 20));
    for (k, (scan, pose)) in scans.into_iter().zip(poses).enumerate() {
        let stamp_ns = read_laser_scan(scan.source, &scan.bytes).unwrap().stamp_ns;
        let pose = read_pose(pose.source, &pose.bytes).unwrap();
        assert_eq!(pose.stamp_ns, stamp_ns);
        assert_eq!(pose.position, [0.2 * k as f64, 0.19, 0.0]);
    }
}

fn note_codes(log: &Log) -> Vec<&str> {
    log.imported.notes.iter().map(dataset::Note::code).collect()
}

#[test]
fn corrected_poses_of_scans_take_precedence_over_odom_lines_of_the_same_time() {
    let log = run(&corrected(|k| format!("{:.1}", 100.0 + 0.2 * k as f64), true));
    check_own_poses(&log, "/odom");
    check_own_poses(&log, "/pose");
    assert_eq!(note_codes(&log), ["corrected_scan_poses"]);
    assert!(log.imported.notes[0].to_string().contains("20 of 20 scans"), "the poses differ");
    let odom = log.of("/odom_lines").next().unwrap();
    assert_eq!(read_odometry(odom.source, &odom.bytes).unwrap().linear_velocity, [0.9, 0.0, 0.0]);
    assert_eq!(log.of("/odom_lines").count(), 20);
    assert_eq!(log.losses(Severity::Warning), []);
}

/// Zero, negative, wrapped (a millisecond counter in 16 bits), coarse and constant times.
#[test]
fn a_log_whose_times_cannot_be_used_is_stamped_by_line() {
    type Times = fn(usize) -> String;
    let times: [(Times, &str); 6] = [
        (|_| "0".to_owned(), "20 of them are 0"),
        (|k| format!("{:.1}", 0.2 * k as f64 - 2.0), "10 of them are negative"),
        (|k| format!("{:.3}", (60.0 + 0.7 * k as f64) % 65.536), "step back by up to 64.8 s"),
        (|k| format!("{}", 7 + k / 5), "16 of them repeat"),
        (|_| "1e9".to_owned(), "19 of them repeat"),
        (|k| format!("{}", 976_052_857_000.0 + 200.0 * k as f64), "20 of them are after 2037"),
    ];
    for (time, fault) in times {
        for odom in [false, true] {
            let log = run(&corrected(time, odom));
            check_own_poses(&log, "/odom");
            assert_eq!(note_codes(&log), ["stamped_by_line"]);
            assert_eq!(log.imported.notes[0].severity(), Severity::Warning);
            assert!(log.imported.notes[0].to_string().contains(fault), "{:?}", log.imported.notes);
            let lost: &[_] = if odom { &[("lines_without_time", 20)] } else { &[] };
            assert_eq!(log.losses(Severity::Warning), lost);
            // 5 scans per second.
            let stamps: Vec<_> = log.of("/scan").map(|scan| scan.log_ns).collect();
            assert!(stamps.windows(2).all(|pair| pair[1] - pair[0] == 200_000_000), "{stamps:?}");
        }
    }
}

#[test]
fn a_few_lines_with_wrong_times_are_dropped_and_counted() {
    let mut text = HEAD.to_owned();
    for k in 0..400 {
        let time = match k {
            100 => "0".to_owned(),
            200 => "-3.5".to_owned(),
            _ => format!("{:.1}", 976_052_857.0 + 0.2 * f64::from(k)),
        };
        text += &format!("FLASER 3 1.5 1.6 1.5 {k} 0 0 {k} 0 0 {time} h 1\n");
    }
    let log = run(&text);
    assert_eq!((log.of("/scan").count(), log.of("/odom").count()), (398, 398));
    assert_eq!(
        log.losses(Severity::Warning),
        [("times_out_of_range", 1), ("lines_without_time", 1)]
    );
    assert_eq!(note_codes(&log), [""; 0]);
}

/// The scans have times, the odometry does not: the poses are those of the scans.
#[test]
fn odom_lines_without_times_are_left_out() {
    let mut text = HEAD.to_owned();
    for k in 0..20 {
        let x = 0.2 * f64::from(k);
        text += &format!("ODOM {x} 0 0 0.9 0 0 0 h 0\n");
        let time = 100.0 + 0.2 * f64::from(k);
        text += &format!("FLASER 3 1.5 1.6 1.5 {x} 0.19 0 {x} 0.19 0 {time:.1} h 1\n");
    }
    let log = run(&text);
    check_own_poses(&log, "/odom");
    assert_eq!(log.losses(Severity::Warning), [("lines_without_time", 20)]);
}

#[test]
fn two_logs_without_times_follow_each_other() {
    let text = corrected(|_| "0".to_owned(), false);
    let files = [("a.log", text.as_bytes()), ("b.log", text.as_bytes())];
    let log = import(&files, &Options::default()).unwrap();
    let stamps: Vec<_> = log.of("/scan").map(|scan| scan.log_ns).collect();
    assert_eq!(stamps.len(), 40);
    assert!(stamps.windows(2).all(|pair| pair[1] - pair[0] == 200_000_000), "{stamps:?}");
}

#[test]
fn raw_scans_are_imported_unless_other_lines_have_them() {
    let raw = "0 -1.5707963 3.1415926 0.0174533 30.0 0.01 0 2 1.25 2.5 0 976052857.345617 h 0.1\n";
    let odom = "ODOM 1 2 0.5 0 0 0 976052857.245617 h 0\n";
    let log = run(&format!("{odom}RAWLASER1 {raw}RAWLASER2 {raw}"));
    assert_eq!(topics(&log), [("/odom", 0), ("/scan", 100_000_000), ("/rear_scan", 100_000_000)]);
    let scan = read_laser_scan(log.messages[1].source, &log.messages[1].bytes).unwrap();
    assert_eq!((scan.ranges.as_slice(), scan.range_max), ([1.25, 2.5].as_slice(), 30.0));

    let log = run(&format!("{odom}RAWLASER1 {raw}{}", flaser("1 2 0.5", "1 2 0.5", "345617")));
    assert_eq!(topics(&log), [("/odom", 0), ("/scan", 100_000_000)]);
    assert_eq!(log.losses(Severity::Info), [("repeated_scan_lines", 1)]);
}

proptest! {
    #[test]
    fn arbitrary_text_does_not_panic(words in "[A-Z0-9.eE \n-]{0,200}", bytes in prop::collection::vec(any::<u8>(), 0..200)) {
        let head = flaser("0 0 0", "1 0 0", "245617");
        for keyword in ["FLASER ", "ROBOTLASER1 ", "RAWLASER1 ", "ODOM ", ""] {
            let text = [head.as_bytes(), keyword.as_bytes(), words.as_bytes(), &bytes].concat();
            let _ = import(&[("a.log", &text)], &Options::default());
        }
    }
}
