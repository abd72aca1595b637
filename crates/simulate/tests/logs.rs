//! Reads simulated logs with the mcap crate and `messages`, and compares them with the ground truth.

#![allow(clippy::unwrap_used, reason = "a test panics if a value is missing")]

use std::io::Cursor;

use messages::hdl32e::{self, Packet};
use messages::{
    Imu, JointState, Source, StampedPose3, Transform, read_imu, read_joint_state, read_pose,
    read_transforms, read_velodyne,
};
use simulate::{
    Campus, Compression, DriveSummary, Encoding, IMU_TOPIC, Lasers, Map, Options, PACKETS_TOPIC,
    POSE_PERIOD_NS, POSE_TOPIC, SimulateError, TF_STATIC_TOPIC, TF_TOPIC, WHEELS, WHEELS_TOPIC,
    write_drive,
};

/// Short drives without noise or people.
fn quiet() -> Options {
    Options {
        length_m: 6.0,
        range_noise_m: 0.0,
        dropout: 0.0,
        mixed_pixels: 0.0,
        people: 0,
        ..Options::default()
    }
}

fn write(campus: &Campus, log: usize) -> (Vec<u8>, DriveSummary) {
    let mut out = Cursor::new(Vec::new());
    let summary = write_drive(campus, log, 0, &mut out).unwrap();
    (out.into_inner(), summary)
}

fn on_threads(n: usize, campus: &Campus) -> Vec<u8> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
    pool.install(|| write(campus, 0).0)
}

/// The decoded messages of a log.
#[derive(Default)]
struct Log {
    scans: Vec<Scan>,
    poses: Vec<(i64, StampedPose3)>,
    imu: Vec<Imu>,
    wheels: Vec<JointState>,
    tf: Vec<Vec<Transform>>,
    tf_static: Vec<Vec<Transform>>,
}

struct Scan {
    log_time_ns: i64,
    stamp_ns: i64,
    packets: Vec<(i64, Vec<u8>)>,
}

fn read(bytes: &[u8]) -> Log {
    let mut log = Log::default();
    for message in mcap::MessageStream::new(bytes).unwrap() {
        let message = message.unwrap();
        let schema = message.channel.schema.as_ref().unwrap();
        let source = Source::new(&schema.name, &message.channel.message_encoding).unwrap();
        let log_time_ns = message.log_time as i64;
        match message.channel.topic.as_str() {
            PACKETS_TOPIC => {
                let scan = read_velodyne(source, &message.data).unwrap();
                let packets = scan.packets().map(|(ns, bytes)| (ns, bytes.to_vec())).collect();
                log.scans.push(Scan { log_time_ns, stamp_ns: scan.stamp_ns, packets });
            }
            POSE_TOPIC => {
                let pose = read_pose(source, &message.data).unwrap();
                log.poses.push((log_time_ns, pose));
            }
            IMU_TOPIC => log.imu.push(read_imu(source, &message.data).unwrap()),
            WHEELS_TOPIC => log.wheels.push(read_joint_state(source, &message.data).unwrap()),
            TF_TOPIC => log.tf.push(read_transforms(source, &message.data).unwrap()),
            TF_STATIC_TOPIC => log.tf_static.push(read_transforms(source, &message.data).unwrap()),
            other => panic!("topic {other}"),
        }
    }
    log
}

fn packets(log: &Log) -> impl Iterator<Item = (i64, Packet<'_>)> {
    let packets = log.scans.iter().flat_map(|scan| &scan.packets);
    packets.map(|(stamp_ns, bytes)| (*stamp_ns, Packet::new(bytes).unwrap()))
}

#[test]
fn the_same_seed_gives_the_same_bytes_on_any_number_of_threads() {
    // A building, and a campus with people, parked cars and all lasers.
    for (buildings, lasers) in [(1, Lasers::Three), (3, Lasers::All)] {
        let options = Options { length_m: 12.0, buildings, lasers, ..Options::default() };
        let campus = |seed| Campus::new(&options, seed).unwrap();
        let bytes = on_threads(1, &campus(7));
        assert!(bytes == on_threads(2, &campus(7)), "1 and 2 threads differ");
        assert!(bytes == on_threads(5, &campus(7)), "1 and 5 threads differ");
        assert!(bytes == write(&campus(7), 0).0, "a second run differs");
        assert!(bytes != on_threads(1, &campus(8)), "seeds 7 and 8 do not differ");
        assert!(bytes != write(&campus(7), 1).0, "logs 0 and 1 do not differ");
    }
}

#[test]
fn packets_follow_the_manual() {
    let campus = Campus::new(&quiet(), 3).unwrap();
    let (bytes, summary) = write(&campus, 0);
    let log = read(&bytes);
    let drive = campus.drive(0);

    // 6 m at 2 m/s take 3 s. The 2.8 s between the margins are 27 messages of 181 x 0.55296 ms =
    // 0.10009 s, or 27.02 revolutions.
    let expected =
        DriveSummary { revolutions: 27, packets: 27 * 181, length_m: 6.0, duration_s: 3.0 };
    assert_eq!(summary, expected);
    assert_eq!(packets(&log).count() as u64, summary.packets);

    let mut borders = Vec::new();
    for scan in &log.scans {
        let (first, last) = (scan.packets.first().unwrap(), scan.packets.last().unwrap());
        assert_eq!(scan.packets.len(), 181);
        assert_eq!((scan.stamp_ns, scan.log_time_ns), (last.0, last.0));
        borders.push(Packet::new(&first.1).unwrap().azimuth(0));
    }
    // 181 packets are 36 030.87 counts: each message starts 31 counts later than the one before.
    assert!(0 < borders[0]);
    for pair in borders.windows(2) {
        let step = (i32::from(pair[1]) - i32::from(pair[0])).rem_euclid(36_000);
        assert!((28..=34).contains(&step), "{step}");
    }

    let mut expected_ns = drive.first_firing_ns();
    let mut azimuths = Vec::new();
    for (stamp_ns, packet) in packets(&log) {
        // The stamp is the end of the packet; the device clock is the time of its first firing.
        let device_us = expected_ns / 1000 % i64::from(hdl32e::HOUR_US);
        assert_eq!(i64::from(packet.device_time_us()), device_us);
        expected_ns += hdl32e::PACKET_PERIOD_NS;
        assert_eq!(stamp_ns, expected_ns);
        azimuths.extend((0..hdl32e::BLOCKS).map(|block| i32::from(packet.azimuth(block))));
        assert_eq!(packet.product(), hdl32e::PRODUCT_HDL32E);
        assert_eq!(packet.return_mode(), Some(hdl32e::ReturnMode::Strongest));
    }
    // The azimuth step of a block is 16.5888 counts, with a standard deviation of 0.3 counts. The limit
    // after n blocks is five standard deviations plus rounding.
    for (n, pair) in azimuths.windows(2).enumerate() {
        let step = (pair[1] - pair[0]).rem_euclid(36_000);
        assert!((14..=19).contains(&step), "{step} after block {n}");
        let expected = f64::from(azimuths[0]) + n as f64 * 16.5888;
        let error = (f64::from(pair[0]) - expected + 18_000.0).rem_euclid(36_000.0) - 18_000.0;
        assert!(error.abs() <= 5.0, "{error} at block {n}");
    }
}

#[test]
fn the_device_clock_wraps_at_the_top_of_the_hour_in_the_first_log_only() {
    let campus = Campus::new(&quiet(), 3).unwrap();
    for (log, expected) in [(0, 1), (1, 0)] {
        let read = read(&write(&campus, log).0);
        let clock: Vec<u32> = packets(&read).map(|(_, p)| p.device_time_us()).collect();
        let wraps: Vec<_> = clock.windows(2).filter(|pair| pair[1] < pair[0]).collect();
        assert_eq!(wraps.len(), expected);
        for pair in wraps {
            assert!(3_599_999_400 < pair[0] && pair[1] < 600, "{pair:?}");
        }
    }
}

#[test]
fn ground_truth_starts_before_the_first_firing_and_ends_after_the_last() {
    for encoding in [Encoding::Ros2, Encoding::Ros1] {
        let campus = Campus::new(&Options { encoding, ..quiet() }, 4).unwrap();
        let log = read(&write(&campus, 1).0);
        let drive = campus.drive(1);
        let (first, last) = (log.poses.first().unwrap(), log.poses.last().unwrap());
        assert!(first.0 < drive.first_firing_ns() && log.scans.last().unwrap().stamp_ns < last.0);
        for (k, (log_time_ns, pose)) in log.poses.iter().enumerate() {
            assert_eq!(pose.stamp_ns, drive.start_ns() + k as i64 * POSE_PERIOD_NS);
            assert_eq!(pose.stamp_ns, *log_time_ns);
            let truth = drive.pose_at(pose.stamp_ns);
            assert_eq!(pose.position, [truth.x_m, truth.y_m, 0.0]);
            let [x, y, z, w] = pose.orientation;
            let heading_rad = f64::atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z));
            assert!(dataset::wrap_angle(heading_rad - truth.heading_rad).abs() < 1e-12);
            let pitch_rad = (2.0 * (w * y - z * x)).asin();
            assert!((pitch_rad - drive.motion_at(pose.stamp_ns).pitch_rad).abs() < 1e-12);
        }
    }
}

/// Expected readings, worked out by hand: at rest the specific force is gravity. In motion the mean
/// of the wheel speeds is the speed, and their difference divided by the track width is the yaw rate.
#[test]
fn wheels_and_imu_measure_the_motion_of_the_robot() {
    let mut options = Options { length_m: 60.0, ..quiet() };
    (options.wheels.slip, options.wheels.scale_error, options.wheels.scale_difference) =
        (0.0, 0.0, 0.0);
    (options.imu.gyro_noise, options.imu.gyro_bias, options.imu.acceleration_noise) =
        (0.0, 0.0, 0.0);
    options.imu.gyro_bias_walk = 0.0;
    let campus = Campus::new(&options, 4).unwrap();
    let (wheels, imu) = simulate::readings(&campus, 0);
    let drive = campus.drive(0);
    // 60 m at 2 m/s: 30 s at 50 and at 100 Hz.
    assert_eq!((wheels.len(), imu.len()), (1501, 3001));
    assert_eq!(wheels[0].names, WHEELS);
    // The first reading has no motion before it.
    for reading in &wheels[1..] {
        let (now, before) = (reading.stamp_ns, reading.stamp_ns - 20_000_000);
        let (a, b) = (drive.pose_at(before), drive.pose_at(now));
        let moved_m = a.distance_m(&b);
        let turned_rad = dataset::wrap_angle(b.heading_rad - a.heading_rad);
        let [left, right] = reading.velocities[..] else { panic!("two wheels") };
        // The rounding error is one count of 0.5 mm at each end of an interval of 20 ms.
        assert!(((left + right) / 2.0 - moved_m / 0.02).abs() < 0.051, "{left} {right}");
        assert!(((right - left) / 0.5 - turned_rad / 0.02).abs() < 0.11, "{left} {right}");
    }
    for reading in &imu {
        let motion = drive.motion_at(reading.stamp_ns);
        let force = reading.linear_acceleration.unwrap();
        let size = force.iter().map(|f| f * f).sum::<f64>().sqrt();
        assert!((9.7..12.0).contains(&size), "{force:?}");
        let [x, y, z] = reading.angular_velocity;
        let yaw_rate = (x * x + z * z).sqrt();
        assert!((force[1].abs() - motion.speed_m_s.abs() * yaw_rate).abs() < 1e-6);
        assert!(y.abs() < 0.5, "{y}");
    }
    let pitched = imu.iter().map(|r| r.angular_velocity[1].abs()).fold(0.0, f64::max);
    assert!(0.02 < pitched, "{pitched}");
}

/// map -> odom -> base_link gives the true pose. The static transform of the lidar is at the start of
/// every file.
#[test]
fn transforms_give_the_true_pose() {
    for upside_down in [false, true] {
        let options = Options { buildings: 3, upside_down, length_m: 30.0, ..quiet() };
        let campus = Campus::new(&options, 4).unwrap();
        let log = read(&write(&campus, 1).0);
        let [mounted] = &log.tf_static[..] else {
            panic!("{} static transforms", log.tf_static.len())
        };
        assert_eq!((&*mounted[0].parent, &*mounted[0].child), ("base_link", "velodyne"));
        assert_eq!(mounted[0].translation, [0.0, 0.0, simulate::SENSOR_HEIGHT_M]);
        assert_eq!(mounted[0].rotation[0], f64::from(u8::from(upside_down)));
        assert_eq!(log.tf.len(), log.wheels.len());
        for transforms in &log.tf {
            let [a, b] = &transforms[..] else { panic!("two transforms") };
            let names = [&*a.parent, &*a.child, &*b.parent, &*b.child];
            assert_eq!(names, ["map", "odom", "odom", "base_link"]);
            let heading_rad = 2.0 * a.rotation[2].atan2(a.rotation[3]);
            let (sin, cos) = heading_rad.sin_cos();
            let x = a.translation[0] + cos * b.translation[0] - sin * b.translation[1];
            let y = a.translation[1] + sin * b.translation[0] + cos * b.translation[1];
            let truth = campus.drive(1).pose_at(a.stamp_ns);
            assert!((x - truth.x_m).abs() < 1e-9 && (y - truth.y_m).abs() < 1e-9);
        }
    }
}

#[test]
fn a_log_split_into_three_files_has_the_same_messages() {
    let whole = Campus::new(&Options { length_m: 12.0, ..quiet() }, 5).unwrap();
    let split = Campus::new(&Options { length_m: 12.0, files: 3, ..quiet() }, 5).unwrap();
    let mut joined = Log::default();
    let mut n_packets = 0;
    for file in 0..3 {
        let mut out = Cursor::new(Vec::new());
        n_packets += write_drive(&split, 0, file, &mut out).unwrap().packets;
        let part = read(&out.into_inner());
        assert_eq!(part.tf_static.len(), 1);
        assert!(!part.scans.is_empty());
        joined.scans.extend(part.scans);
        joined.poses.extend(part.poses);
        joined.imu.extend(part.imu);
        joined.wheels.extend(part.wheels);
    }
    let (bytes, summary) = write(&whole, 0);
    let whole = read(&bytes);
    assert_eq!(n_packets, summary.packets);
    let packets =
        |log: &Log| -> Vec<_> { log.scans.iter().flat_map(|scan| scan.packets.clone()).collect() };
    assert!(packets(&joined) == packets(&whole));
    assert!(
        joined.poses == whole.poses && joined.imu == whole.imu && joined.wheels == whole.wheels
    );
}

/// Two blocks have the same azimuth: one with the last return and one with the strongest. There are
/// twice as many packets, each of half the duration.
#[test]
fn dual_returns_are_in_pairs_of_blocks() {
    let options = Options { dual_return: true, buildings: 3, length_m: 20.0, ..quiet() };
    let campus = Campus::new(&options, 3).unwrap();
    let log = read(&write(&campus, 0).0);
    let mut n_two = 0;
    let mut last_ns = None;
    for (stamp_ns, packet) in packets(&log) {
        assert_eq!(packet.return_mode(), Some(hdl32e::ReturnMode::Dual));
        assert_eq!(last_ns.map_or(276_480, |last: i64| stamp_ns - last), 276_480);
        last_ns = Some(stamp_ns);
        for block in (0..hdl32e::BLOCKS).step_by(2) {
            assert_eq!(packet.azimuth(block), packet.azimuth(block + 1));
            let (last, strongest) = (packet.distance(block, 15), packet.distance(block + 1, 15));
            assert!(strongest <= last || 0 == last);
            assert_eq!(last == 0, strongest == 0);
            n_two += usize::from(last != strongest);
        }
    }
    assert!(100 < n_two, "{n_two} firings with two returns");
}

#[test]
fn packet_loss_has_the_requested_rate() {
    let options = Options { packet_loss: 0.1, length_m: 20.0, ..quiet() };
    let campus = Campus::new(&options, 3).unwrap();
    let (bytes, summary) = write(&campus, 0);
    assert_eq!(packets(&read(&bytes)).count() as u64, summary.packets);
    let whole = Campus::new(&Options { packet_loss: 0.0, ..options }, 3).unwrap();
    let share = 1.0 - summary.packets as f64 / write(&whole, 0).1.packets as f64;
    // With 17 557 packets the standard deviation is 0.0023.
    assert!((share - 0.1).abs() < 0.01, "{share}");
}

/// Ranges of laser 15.
fn ranges(options: &Options) -> Vec<f64> {
    let campus = Campus::new(options, 11).unwrap();
    let log = read(&write(&campus, 0).0);
    packets(&log)
        .flat_map(|(_, packet)| (0..hdl32e::BLOCKS).map(move |block| packet.distance(block, 15)))
        .map(|counts| f64::from(counts) * hdl32e::METRES_PER_COUNT)
        .collect()
}

#[test]
fn noise_dropouts_and_people_match_the_options() {
    // Random draws depend on what the beams hit, so only totals can be compared.
    let clean = ranges(&quiet());
    let lost = |ranges: &[f64]| ranges.iter().filter(|r| **r <= 0.0).count() as f64;
    let dropped = ranges(&Options { dropout: 0.1, ..quiet() });
    let share = 1.0 - (dropped.len() as f64 - lost(&dropped)) / (clean.len() as f64 - lost(&clean));
    assert!((share - 0.1).abs() < 0.006, "{share}");

    let noisy = ranges(&Options { range_noise_m: 0.02, ..quiet() });
    let pairs = clean.iter().zip(&noisy).filter(|(a, b)| 0.0 < **a && 0.0 < **b);
    let mut errors: Vec<f64> = pairs.map(|(a, b)| b - a).collect();
    errors.sort_by(f64::total_cmp);
    let quantile = |share: f64| errors[(share * errors.len() as f64) as usize];
    let (median, spread) = (quantile(0.5), (quantile(0.8413) - quantile(0.1587)) / 2.0);
    // The azimuth noise differs as well, which adds a little noise on slanted walls.
    assert!(median.abs() < 0.001 && (0.019..0.024).contains(&spread), "{median}, {spread}");

    let crowded = ranges(&Options { people: 200, ..quiet() });
    let nearer = clean.iter().zip(&crowded).filter(|(a, b)| **b < **a - 0.1).count();
    let farther = clean.iter().zip(&crowded).filter(|(a, b)| **a + 0.1 < **b).count();
    assert!(clean.len() < 100 * nearer && 5 * farther < nearer, "{nearer} {farther}");
}

#[test]
fn only_the_selected_lasers_return() {
    let mut horizontal = Vec::new();
    for (lasers, expected) in [(Lasers::Three, 14..17), (Lasers::All, 0..32)] {
        let campus = Campus::new(&Options { lasers, length_m: 1.0, ..quiet() }, 2).unwrap();
        let log = read(&write(&campus, 0).0);
        let blocks = || packets(&log).flat_map(|(_, p)| (0..hdl32e::BLOCKS).map(move |b| (p, b)));
        let returns = |laser: &usize| blocks().any(|(p, b)| 0 < p.distance(b, *laser));
        let found: Vec<usize> = (0..hdl32e::LASERS).filter(returns).collect();
        assert_eq!(found, expected.collect::<Vec<_>>());
        let ranges = blocks().map(|(p, b)| f64::from(p.distance(b, 15)) * 0.002);
        horizontal.push(ranges.collect::<Vec<_>>());
    }
    let pairs = horizontal[0].iter().zip(&horizontal[1]);
    let same = pairs.filter(|(a, b)| (*a - *b).abs() < 0.01).count();
    assert!(0.98 * (horizontal[0].len() as f64) < same as f64, "{same} of {}", horizontal[0].len());
}

#[test]
fn a_file_is_valid_mcap_and_stores_its_seed_and_options() {
    for (encoding, profile, schema_encoding, scan_name) in [
        (Encoding::Ros2, "ros2", "ros2msg", "velodyne_msgs/msg/VelodyneScan"),
        (Encoding::Ros1, "ros1", "ros1msg", "velodyne_msgs/VelodyneScan"),
    ] {
        for compression in [Compression::Zstd, Compression::Lz4, Compression::None] {
            let options = Options { encoding, compression, ..quiet() };
            let campus = Campus::new(&options, 9).unwrap();
            let (bytes, _) = write(&campus, 1);
            let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
            let stats = summary.stats.clone().unwrap();
            // 27 scans. From 0 s to 3 s: poses every 0.05 s, wheels and transforms every 0.02 s, IMU
            // every 0.01 s. One static transform.
            assert_eq!(stats.message_count, 27 + 61 + 2 * 151 + 301 + 1);
            let drive = campus.drive(1);
            assert_eq!(stats.message_start_time as i64, drive.start_ns());
            let scans = summary.channels.values().find(|c| c.topic == PACKETS_TOPIC).unwrap();
            let schema = scans.schema.as_ref().unwrap();
            assert_eq!((&*schema.name, &*schema.encoding), (scan_name, schema_encoding));

            let mut found = Vec::new();
            for record in mcap::read::LinearReader::new(&bytes).unwrap() {
                match record.unwrap() {
                    mcap::records::Record::Header(header) => {
                        found.push((header.profile, header.library));
                    }
                    mcap::records::Record::Metadata(metadata) => {
                        assert_eq!(metadata.metadata["seed"], "9");
                        assert_eq!(metadata.metadata["log"], "lap-2");
                        let json = &metadata.metadata["options"];
                        assert_eq!(serde_json::from_str::<Options>(json).unwrap(), options);
                    }
                    _ => {}
                }
            }
            assert_eq!(found, [(profile.to_owned(), "loopboost simulate".to_owned())]);

            // Reading each chunk checks its CRC. Log times never decrease within a file.
            let mut last = 0;
            assert!(1 < summary.chunk_indexes.len());
            for chunk in &summary.chunk_indexes {
                for message in summary.stream_chunk(&bytes, chunk).unwrap() {
                    let message = message.unwrap();
                    assert!(last <= message.log_time);
                    last = message.log_time;
                }
            }
        }
    }
}

#[test]
fn options_have_defaults_and_unknown_keys_are_errors() {
    let parse = toml::from_str::<Options>;
    assert_eq!(parse("").unwrap(), Options::default());
    let options = parse("encoding = \"ros1\"\ncompression = \"none\"\nlasers = \"all\"").unwrap();
    assert_eq!(options.encoding, Encoding::Ros1);
    assert_eq!(options.compression, Compression::None);
    assert_eq!(options.lasers, Lasers::All);
    assert!(parse("lenght_m = 5.0").unwrap_err().to_string().contains("lenght_m"));
    let text = toml::to_string(&options).unwrap();
    assert_eq!(parse(&text).unwrap(), options);
}

#[test]
fn errors_name_the_invalid_option() {
    #[track_caller]
    fn check(change: impl FnOnce(&mut Options), expected: &str) {
        let mut options = Options::default();
        change(&mut options);
        let error = Campus::new(&options, 1).expect_err(expected).to_string();
        assert!(error.contains(expected), "{error}\n{expected}");
    }
    check(|o| o.logs.clear(), "`simulate.logs` is empty");
    for name in ["", "a/b", "..", ".hidden", "-x", "a b", "lap*", "über"] {
        check(
            |o| o.logs = vec![name.to_owned()],
            &format!("{name:?}, which is not a valid file stem"),
        );
    }
    check(|o| o.logs = vec!["a".repeat(101)], "not a valid file stem");
    check(
        |o| o.logs = ["a", "b", "A"].map(str::to_owned).into(),
        "`simulate.logs` contains \"A\" twice",
    );
    check(|o| o.length_m = f64::NAN, "`simulate.length_m` is NaN, expected 0.1 to 1000000");
    check(|o| o.length_m = -1.0, "`simulate.length_m` is -1, expected");
    check(|o| o.speed_m_s = 0.0, "`simulate.speed_m_s` is 0, expected");
    check(|o| o.spin_hz = f64::INFINITY, "`simulate.spin_hz` is inf, expected 5 to 20");
    check(|o| o.spin_hz = 4.9, "`simulate.spin_hz` is 4.9, expected 5 to 20");
    check(|o| o.range_noise_m = -0.1, "`simulate.range_noise_m` is -0.1, expected 0 to 1");
    check(|o| o.dropout = 1.5, "`simulate.dropout` is 1.5, expected 0 to 1");
    check(|o| o.people = 1001, "`simulate.people` is 1001, expected 0 to 1000");
    check(|o| o.buildings = 0, "`simulate.buildings` is 0, expected 1 to 40");
    check(|o| o.imu.gyro_bias = -1.0, "`simulate.imu.gyro_bias` is -1, expected 0 to 1");
    check(|o| o.wheels.track_m = 0.0, "`simulate.wheels.track_m` is 0, expected 0.05 to 5");
    // 200 s are 1998 revolutions: at most 999 files of two each.
    check(|o| o.files = 1000, "`simulate.files` is 1000, expected 1 to 999");
    check(|o| o.map = Some("map.yaml".to_owned()), "`simulate.map` is set");
    // A message of 0.10009 s and two margins of 0.1 s at 2 m/s: 0.60017 m.
    check(|o| o.length_m = 0.6, "`simulate.length_m` is 0.6, expected 0.600 or more");
    let enough = Options { length_m: 0.6002, ..Options::default() };
    assert_eq!(write(&Campus::new(&enough, 1).unwrap(), 0).1.packets, 181);

    let campus = Campus::new(&enough, 1).unwrap();
    for (log, file) in [(2, 0), (0, 1)] {
        let error = write_drive(&campus, log, file, Cursor::new(Vec::new())).unwrap_err();
        assert!(matches!(error, SimulateError::NoSuchLog { n_logs: 2, .. }), "{error}");
    }
}

#[test]
fn a_full_disk_is_an_error() {
    let campus = Campus::new(&quiet(), 1).unwrap();
    let mut room = [0; 10_000];
    let error = write_drive(&campus, 0, 0, Cursor::new(&mut room[..])).unwrap_err();
    assert!(matches!(error, SimulateError::Write(_)), "{error}");
}

/// A ring of corridors, 2 m wide, around a block of 16 m x 6 m that contains a closed room. The drives
/// go around the ring in both directions, clear of walls, and the ranges match the map.
#[test]
fn drives_on_a_map_keep_clear_of_walls() {
    let folder = tempfile::tempdir().unwrap();
    let (n_x, n_y) = (220, 120); // 0.1 m per pixel, 1 m of border
    let shade = |i: i32, j: i32| {
        let (x, y) = (f64::from(i) * 0.1, f64::from(j) * 0.1);
        let in_block = (3.0..19.0).contains(&x) && (3.0..9.0).contains(&y);
        let in_room = (8.0..12.0).contains(&x) && (5.0..7.0).contains(&y);
        let is_free = (1.0..21.0).contains(&x) && (1.0..11.0).contains(&y) && !in_block;
        if is_free || in_room { 254 } else { 0 }
    };
    let pixels = (0..n_y).flat_map(|j| (0..n_x).map(move |i| shade(i, j)));
    let yaml = folder.path().join("map.yaml");
    let text = "image: map.pgm\nresolution: 0.1\norigin: [-3.0, 2.0, 0.0]\nnegate: 0\n\
                occupied_thresh: 0.65\nfree_thresh: 0.196\n";
    std::fs::write(&yaml, text).unwrap();
    let header = |magic: &str| format!("{magic}\n# a ring\n{n_x} {n_y}\n255\n");
    let plain: Vec<String> = pixels.clone().map(|shade| shade.to_string()).collect();
    std::fs::write(folder.path().join("map.pgm"), header("P2") + &plain.join(" ")).unwrap();
    let options = Options { length_m: 120.0, map: Some("map.yaml".to_owned()), ..quiet() };
    let bytes = || {
        let map = Map::load(&yaml).unwrap();
        let campus = Campus::on_map(&options, 5, map).unwrap();
        for log in 0..2 {
            let drive = campus.drive(log);
            for k in 0..2000 {
                let pose = drive.pose_at(drive.start_ns() + k * 30_000_000);
                // In the frame of the lower left corner of the image.
                let (x, y) = (pose.x_m + 3.0, pose.y_m - 2.0);
                let outer_m = (x - 1.0).min(21.0 - x).min(y - 1.0).min(11.0 - y);
                let inner_m = (3.0 - x).max(x - 19.0).max(3.0 - y).max(y - 9.0);
                assert!(0.3 < outer_m && 0.3 < inner_m, "{x} {y}");
            }
        }
        write(&campus, 0).0
    };
    let written = bytes();
    std::fs::write(
        folder.path().join("map.pgm"),
        [header("P5").into_bytes(), pixels.map(|shade| shade as u8).collect()].concat(),
    )
    .unwrap();
    assert!(bytes() == written, "plain and raw images differ");
    // In the ring every level beam hits a wall within its diagonal of 22.4 m. Some beams do not return
    // because of grazing incidence, and some hit the floor because of the pitch.
    let log = read(&written);
    let ranges = packets(&log).flat_map(|(_, p)| (0..12).map(move |b| p.distance(b, 15)));
    let (n, n_off) = ranges.fold((0, 0), |(n, n_off), counts| {
        (n + 1, n_off + usize::from(counts == 0 || 11_200 < counts))
    });
    assert!(20 * n_off < n, "{n_off} of {n}");

    let error = |text: &str| {
        std::fs::write(&yaml, text).unwrap();
        Map::load(&yaml).unwrap_err().to_string()
    };
    assert!(error("resolution: 0.1\n").contains("map.yaml: `image` is missing"));
    assert!(
        error(&text.replace("0.1\n", "x\n")).contains("`resolution` is `x`, expected a number")
    );
    assert!(
        error(&text.replace(", 0.0]", ", 1.0]")).contains("the yaw of `origin` is 1, expected 0")
    );
    let missing = error(&text.replace("map.pgm", "none.pgm"));
    assert!(missing.contains("cannot read") && missing.contains("none.pgm"), "{missing}");
    std::fs::write(folder.path().join("map.pgm"), header("P5")).unwrap();
    assert!(error(text).contains("map.pgm: contains 0 pixels, expected 26400"));
    std::fs::write(folder.path().join("map.pgm"), "P6").unwrap();
    assert!(error(text).contains("is not a PGM image"));
}
