//! Imports NCLT files.

#![allow(clippy::unwrap_used, reason = "a test panics if a value is missing")]

mod common;

use std::f64::consts::TAU;

use common::{Log, Message, import, import_paths};
use dataset::Severity;
use import::{ImportError, Options};
use messages::hdl32e::ELEVATION_DEG;
use messages::{
    read_imu, read_joint_state, read_nav_sat_fix, read_odometry, read_point_cloud, read_pose,
};
use proptest::prelude::*;

const T0_US: u64 = 1_326_030_975_726_043;
const T0_NS: i64 = T0_US as i64 * 1000;

fn packet(utime: u64, hits: &[[u8; 8]]) -> Vec<u8> {
    let mut out = [0x9C, 0xAD].repeat(4);
    out.extend((hits.len() as u32).to_le_bytes());
    out.extend(utime.to_le_bytes());
    out.extend([0; 4]);
    out.extend(hits.concat());
    out
}

/// A return at `x`, `y`, `z` \[m\] in the axes of the file.
fn hit([x, y, z]: [f64; 3], intensity: u8, laser: u8) -> [u8; 8] {
    let mut out = [0; 8];
    for (k, metres) in [x, y, z].into_iter().enumerate() {
        let counts = ((metres + 100.0) / 0.005).round() as u16;
        out[2 * k..2 * k + 2].copy_from_slice(&counts.to_le_bytes());
    }
    out[6] = intensity;
    out[7] = laser;
    out
}

/// One firing of all lasers of a sensor mounted upside down (x left, y forward, z down), with all
/// returns 10 m away, at an angle to the left of straight ahead.
fn firing(left_deg: f64) -> Vec<[u8; 8]> {
    let azimuth = left_deg.to_radians();
    let hit_of = |laser: usize| {
        let elevation = -ELEVATION_DEG[laser].to_radians();
        let level = 10.0 * elevation.cos();
        let position = [level * azimuth.sin(), level * azimuth.cos(), -10.0 * elevation.sin()];
        hit(position, laser as u8 * 2, laser as u8)
    };
    (0..32).map(hit_of).collect()
}

/// Packets of 12 firings. Firings are 2 deg apart, packets are 0.5 ms apart, and the first firing is
/// 1 deg to the left of straight ahead.
fn hits_file(n_packets: u64) -> Vec<u8> {
    let packet_of = |k: u64| {
        let firings = (0..12).flat_map(|block| firing(1.0 + 2.0 * (k * 12 + block) as f64));
        packet(T0_US + k * 500, &firings.collect::<Vec<_>>())
    };
    (0..n_packets).flat_map(packet_of).collect()
}

fn run(name: &str, content: &[u8]) -> Result<Log, ImportError> {
    import(&[(name, content)], &Options::default())
}

#[test]
fn hits_are_split_into_revolutions_at_azimuth_0() {
    // A revolution has 180 firings, which are 15 packets. 40 packets are 2 revolutions and 10 packets.
    let log = run("velodyne_hits.bin", &hits_file(40)).unwrap();
    let clouds: Vec<_> = log.of("/velodyne_points").collect();
    let stamps: Vec<_> = clouds.iter().map(|message| message.log_ns as i64 - T0_NS).collect();
    assert_eq!(stamps, [0, 15 * 500_000, 30 * 500_000]);
    let lengths: Vec<_> = clouds
        .iter()
        .map(|message| read_point_cloud(message.source, &message.bytes).unwrap().len())
        .collect();
    assert_eq!(lengths, [180 * 32, 180 * 32, 120 * 32]);
    assert!(log.imported.losses.is_empty());

    let cloud = read_point_cloud(clouds[1].source, &clouds[1].bytes).unwrap();
    let column = |name: &str| cloud.column(name).unwrap();
    let (x, y, z) = (column("x"), column("y"), column("z"));
    for firing in 0..180 {
        let azimuth = (1.0 + 2.0 * f64::from(firing)).to_radians();
        for (laser, elevation_deg) in ELEVATION_DEG.iter().enumerate() {
            let at = firing as usize * 32 + laser;
            let elevation = -elevation_deg.to_radians();
            let level = 10.0 * elevation.cos();
            // Slightly more than half a count of 5 mm.
            assert!((x.get(at) - level * azimuth.cos()).abs() < 0.003);
            assert!((y.get(at) - level * azimuth.sin()).abs() < 0.003);
            assert!((z.get(at) - 10.0 * elevation.sin()).abs() < 0.003);
            assert_eq!(column("intensity").get(at), 2.0 * laser as f64);
            // Laser 0 is the lowest of an upright sensor and therefore the highest of this one.
            // Laser 1 is the 17th from the top.
            let from_top = if laser % 2 == 0 { laser / 2 } else { 16 + laser / 2 };
            assert_eq!(column("ring").get(at), 31.0 - from_top as f64);
            let packet = firing as usize / 12;
            assert!((column("time").get(at) - packet as f64 * 0.0005).abs() < 1e-6);
        }
    }
}

#[test]
fn a_pause_ends_a_revolution() {
    let mut file = hits_file(5);
    file.extend(packet(T0_US + 1_000_000, &firing(125.0)));
    let log = run("velodyne_hits.bin", &file).unwrap();
    assert_eq!(log.messages.len(), 2);
    assert_eq!(log.messages[1].log_ns as i64, T0_NS + 1_000_000_000);
}

#[test]
fn hits_that_cannot_be_used_are_losses() {
    let mut file = packet(T0_US, &firing(10.0));
    file.extend([0x9C, 0xAD, 1, 2, 3]);
    file.extend(packet(T0_US + 500, &firing(20.0)));
    // A number of hits that is too large for a packet.
    let mut damaged = packet(T0_US + 1000, &firing(30.0));
    damaged[10] = 1;
    file.extend(damaged);
    file.extend(packet(T0_US + 1500, &[hit([1.0, 2.0, 3.0], 0, 32)]));
    file.extend(packet(u64::MAX, &firing(40.0)));
    file.extend(&packet(T0_US + 2000, &firing(50.0))[..100]);
    let log = run("hits_renamed.dat", &file).unwrap();
    assert_eq!(
        log.losses(Severity::Warning),
        [
            ("times_out_of_range", 1),
            ("truncated_hits", 1),
            ("bytes_between_packets", 2),
            ("hits_of_unknown_laser", 1)
        ]
    );
    assert_eq!(read_point_cloud(log.messages[0].source, &log.messages[0].bytes).unwrap().len(), 64);
}

#[test]
fn lasers_in_an_unknown_order_keep_their_numbers_as_rings() {
    let shuffled: Vec<_> =
        firing(0.5).into_iter().map(|mut hit| (hit[7] = hit[7] * 13 % 32, hit).1).collect();
    let log = run("velodyne_hits.bin", &packet(T0_US, &shuffled)).unwrap();
    let cloud = read_point_cloud(log.messages[0].source, &log.messages[0].bytes).unwrap();
    assert_eq!(cloud.column("ring").unwrap().get(1), 13.0);
    assert_eq!(log.losses(Severity::Info), [("rings_by_file_number", 1)]);
}

#[test]
fn a_truncated_file_of_hits_keeps_its_complete_packets() {
    let file = hits_file(3);
    let complete = run("velodyne_hits.bin", &file).unwrap();
    let bytes = |log: &Log| {
        let message = &log.messages[0];
        read_point_cloud(message.source, &message.bytes).unwrap().data.to_vec()
    };
    let complete = bytes(&complete);
    let mut lengths = Vec::new();
    for cut in 0..file.len() {
        match run("velodyne_hits.bin", &file[..cut]) {
            Ok(log) => {
                let found = bytes(&log);
                assert!(complete.starts_with(&found));
                assert_eq!(log.imported.losses.is_empty(), cut % (file.len() / 3) == 0);
                lengths.push(found.len() / 22);
            }
            Err(_) => assert!(cut < file.len() / 3),
        }
    }
    lengths.dedup();
    assert_eq!(lengths, [12 * 32, 24 * 32]);
}

/// The tables of a session, with a few rows each.
fn tables() -> Vec<(&'static str, String)> {
    let t = |after_us: u64| T0_US + after_us;
    vec![
        ("odometry_mu_100hz.csv", format!("{},5.0,2.0,-0.5,0.0,0.0,0.2\n", t(10))),
        ("odometry_mu.csv", format!("{},5.0,2.0,-0.5,0.0,0.0,0.2\n", t(11))),
        ("wheels.csv", format!("{},0.5,0.75\n{},nan,1\n", t(20), t(21))),
        (
            "ms25.csv",
            format!(
                "{},0.1,0.2,0.3,1.0,2.0,-9.81,0.1,0.2,0.3\n{},0,0,0,0,0,0,0,0,0\n",
                t(30),
                t(90_000)
            ),
        ),
        ("ms25_euler.csv", format!("{},0.0,0.0,1.5707963267948966\n{},1,1,1\n", t(5), t(95_000))),
        ("kvh.csv", format!("{},3.1\n{},-3.1\n{},-3.0\n", t(40), t(10_040), t(900_000))),
        (
            "groundtruth_2012-01-08.csv",
            format!("{},NaN,NaN,NaN,NaN,NaN,NaN\n{}, 3.0, 2.0, -1.0, 0.0, 0.0, 0.0\n", t(1), t(50)),
        ),
        (
            "gps.csv",
            format!(
                "{},3,8,0.75,-1.5,270.5,0,0\n{},1,0,0,0,0,0,0\n{},2,4,0.75,-1.5,nan,0,0\n",
                t(60),
                t(61),
                t(62)
            ),
        ),
    ]
}

fn close(found: &[f64], expected: &[f64]) {
    assert_eq!(found.len(), expected.len());
    for (a, b) in found.iter().zip(expected) {
        assert!((a - b).abs() < 1e-9, "{found:?}, expected {expected:?}");
    }
}

/// The log of a folder with all tables, one packet of hits, and a file that does not belong to the
/// data set.
fn session() -> Log {
    let folder = tempfile::tempdir().unwrap();
    for (name, content) in tables() {
        std::fs::write(folder.path().join(name), content).unwrap();
    }
    std::fs::write(folder.path().join("velodyne_hits.bin"), hits_file(1)).unwrap();
    std::fs::write(folder.path().join("README.txt"), "not part of the data set").unwrap();
    import_paths(&[folder.path().to_owned()], &Options::default()).unwrap()
}

/// The only message of a topic.
fn only<'a>(log: &'a Log, topic: &'a str) -> &'a Message {
    let messages: Vec<_> = log.of(topic).collect();
    let [message] = messages[..] else { panic!("{topic}: {} messages", messages.len()) };
    message
}

#[test]
fn a_folder_becomes_one_log_sorted_by_time() {
    let log = session();
    let order: Vec<_> = log
        .messages
        .iter()
        .map(|message| (message.topic.as_str(), (message.log_ns as i64 - T0_NS) / 1000))
        .collect();
    assert_eq!(
        order,
        [
            ("/velodyne_points", 0),
            ("/odom", 10),
            ("/wheel_states", 20),
            ("/imu/data", 30),
            ("/ground_truth", 50),
            ("/fix", 60),
            ("/fix", 62),
            ("/kvh", 10_040),
            ("/imu/data", 90_000),
        ]
    );
    assert_eq!(
        log.losses(Severity::Warning),
        [("rows_with_nan", 1), ("rows_with_nan", 1)],
        "one in wheels.csv, one in groundtruth_2012-01-08.csv"
    );
    assert_eq!(
        log.losses(Severity::Info),
        [("rows_without_fix", 1), ("rows_without_predecessor", 2), ("superseded_file", 1)]
    );
}

/// Without the file at 100 Hz: 1 m forward, then 2 m forward and 90 deg to the right, a row without values, and 3 m
/// forward, which is to the right of where the robot started.
#[test]
fn motions_of_odometry_mu_are_summed() {
    let turn = std::f64::consts::FRAC_PI_2;
    let rows = format!(
        "{},1,0,0,0,0,0\n{},2,0,0,0,0,{turn}\n{},nan,0,0,0,0,0\n{},3,0,0,0,0,0\n",
        T0_US,
        T0_US + 200_000,
        T0_US + 300_000,
        T0_US + 400_000
    );
    let log = import(&[("odometry_mu.csv", rows.as_bytes())], &Options::default()).unwrap();
    let read = |message: &Message| read_odometry(message.source, &message.bytes).unwrap().pose;
    let found: Vec<[f64; 3]> = log.of("/odom").map(|m| read(m).position).collect();
    assert_eq!(found.len(), 3);
    close(&found.concat(), &[1.0, 0.0, 0.0, 3.0, 0.0, 0.0, 3.0, -3.0, 0.0]);
    assert_eq!(log.losses(Severity::Warning), [("rows_with_nan", 1)]);
}

#[test]
fn odometry_and_ground_truth_have_z_up() {
    let log = session();
    let odom = only(&log, "/odom");
    let odom = read_odometry(odom.source, &odom.bytes).unwrap();
    close(&odom.pose.position, &[5.0, -2.0, 0.5]);
    // 0.2 rad to the right. A quaternion and its negative are the same rotation.
    let sign = odom.pose.orientation[3].signum();
    let half = odom.pose.orientation.map(|value| value * sign);
    close(&half, &[0.0, 0.0, (-0.1f64).sin(), 0.1f64.cos()]);
    assert_eq!((odom.frame_id.as_str(), odom.child_frame_id.as_str()), ("odom", "base_link"));

    let truth = only(&log, "/ground_truth");
    let truth = read_pose(truth.source, &truth.bytes).unwrap();
    close(&truth.position, &[2.0, 3.0, 1.0]);
    // North is 90 deg from east.
    let half = std::f64::consts::FRAC_1_SQRT_2;
    close(&truth.orientation.map(f64::abs), &[0.0, 0.0, half, half]);
    assert!(0.0 < truth.orientation[2] * truth.orientation[3]);
}

#[test]
fn wheels_keep_their_speeds() {
    let log = session();
    let wheels = only(&log, "/wheel_states");
    let wheels = read_joint_state(wheels.source, &wheels.bytes).unwrap();
    assert_eq!(wheels.names, ["left_wheel", "right_wheel"]);
    assert_eq!(wheels.velocities, [0.5, 0.75]);
}

#[test]
fn an_imu_reading_has_z_up_and_a_recent_attitude() {
    let log = session();
    let [imu, late_imu] = log.of("/imu/data").collect::<Vec<_>>()[..] else { panic!() };
    let imu = read_imu(imu.source, &imu.bytes).unwrap();
    assert_eq!(imu.angular_velocity, [0.1, -0.2, -0.3]);
    assert_eq!(imu.linear_acceleration, Some([1.0, -2.0, 9.81]));
    // A heading of 90 deg from north is east, which is 0 in east-north-up axes.
    close(&imu.orientation.unwrap().map(f64::abs), &[0.0, 0.0, 0.0, 1.0]);
    // The last attitude is 90 ms old, and the next one is later than the reading.
    assert_eq!(read_imu(late_imu.source, &late_imu.bytes).unwrap().orientation, None);
}

#[test]
fn satellite_fixes_are_in_degrees_and_may_lack_an_altitude() {
    let log = session();
    let [fix, flat_fix] = log.of("/fix").collect::<Vec<_>>()[..] else { panic!() };
    let fix = read_nav_sat_fix(fix.source, &fix.bytes).unwrap();
    close(
        &[fix.latitude_deg, fix.longitude_deg, fix.altitude_m],
        &[0.75 * 360.0 / TAU, -1.5 * 360.0 / TAU, 270.5],
    );
    assert!(read_nav_sat_fix(flat_fix.source, &flat_fix.bytes).unwrap().altitude_m.is_nan());
}

#[test]
fn a_change_of_heading_across_pi_gives_the_yaw_rate() {
    let log = session();
    let kvh = only(&log, "/kvh");
    // From 3.1 to -3.1 across pi is a change of tau - 6.2 in 10 ms, clockwise.
    let kvh = read_imu(kvh.source, &kvh.bytes).unwrap();
    close(&kvh.angular_velocity, &[0.0, 0.0, -(TAU - 6.2) / 0.01]);
    close(&[2.0 * kvh.orientation.unwrap()[2].atan2(kvh.orientation.unwrap()[3])], &[3.1]);
    assert_eq!(kvh.linear_acceleration, None);
}

#[test]
fn a_malformed_row_is_a_loss_and_an_unexpected_table_is_an_error() {
    let rows = format!("# comment\n\n{T0_US},1,2\n{T0_US},1\nx\n{},3,4", T0_US + 1);
    let log = run("wheels.csv", rows.as_bytes()).unwrap();
    assert_eq!(log.messages.len(), 2);
    assert_eq!(
        log.imported.losses.to_string(),
        "2 malformed rows (expected utime [us], left, right [m/s]) (file `wheels.csv`), \
         1 last row without a line break (file `wheels.csv`)"
    );

    let named = format!("utime,left,right\n{T0_US},1,2\n");
    assert_eq!(run("wheels.csv", named.as_bytes()).unwrap().messages.len(), 1);

    let error = run("wheels.csv", b"name,value\nfrost,12\n").unwrap_err().to_string();
    assert!(error.contains("wheels.csv, line 2: found `frost,12`"), "{error}");
    assert!(error.ends_with("expected utime [us], left, right [m/s]"), "{error}");

    let error = run("ms25_euler.csv", b"1,0,0,0\n").unwrap_err().to_string();
    assert!(
        error.contains("1 file not used (ms25.csv is missing) (file `ms25_euler.csv`)"),
        "{error}"
    );
    assert!(run("kvh.csv", b"\n").is_err());
}

#[test]
fn a_file_of_hits_with_other_content_is_an_error() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("velodyne_hits.bin"), b"something else").unwrap();
    let paths = [folder.path().to_owned()];
    let error = import_paths(&paths, &Options::default()).unwrap_err().to_string();
    assert!(error.contains("velodyne_hits.bin, byte 0: found [73, 6f,"), "{error}");
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn arbitrary_bytes_do_not_panic(bytes in prop::collection::vec(any::<u8>(), 0..400), at in 0usize..9_000) {
        let file = hits_file(2);
        let _ = run("velodyne_hits.bin", &[&file[..at % file.len()], &bytes].concat());
        let mut flipped = file;
        let at = at % flipped.len();
        flipped[at] = bytes.first().copied().unwrap_or(0);
        let _ = run("velodyne_hits.bin", &flipped);
        for (name, mut content) in tables() {
            content.push_str(&String::from_utf8_lossy(&bytes));
            let _ = run(name, content.as_bytes());
            let _ = run(name, &bytes);
        }
    }
}
