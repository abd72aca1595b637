//! Logs read back with the mcap crate and `messages`, and held against the truth.

use std::io::Cursor;

use messages::hdl32e::{self, Packet};
use messages::{Source, StampedPose3, read_pose, read_velodyne};
use simulate::{
    Campus, Compression, DriveSummary, Encoding, Lasers, Options, PACKETS_TOPIC, POSE_PERIOD_NS,
    POSE_TOPIC, Point, Segment, SimulateError, write_drive,
};

/// Short drives without noise or people.
fn quiet() -> Options {
    Options { length_m: 6.0, range_noise_m: 0.0, dropout: 0.0, people: 0, ..Options::default() }
}

fn write(campus: &Campus, log: usize) -> (Vec<u8>, DriveSummary) {
    let mut out = Cursor::new(Vec::new());
    let summary = write_drive(campus, log, &mut out).unwrap();
    (out.into_inner(), summary)
}

fn on_threads(n: usize, campus: &Campus) -> Vec<u8> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(n).build().unwrap();
    pool.install(|| write(campus, 0).0)
}

/// A log as its readers see it.
#[derive(Default)]
struct Log {
    scans: Vec<Scan>,
    poses: Vec<(i64, StampedPose3)>,
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
fn same_seed_same_bytes_on_any_number_of_threads() {
    let options = Options { length_m: 12.0, ..Options::default() };
    let campus = |seed| Campus::new(&options, seed).unwrap();
    let bytes = on_threads(1, &campus(7));
    assert!(bytes == on_threads(2, &campus(7)), "1 and 2 threads differ");
    assert!(bytes == write(&campus(7), 0).0, "the second time differs");
    assert!(bytes != on_threads(1, &campus(8)), "seeds 7 and 8 do not differ");
    assert!(bytes != write(&campus(7), 1).0, "logs 0 and 1 do not differ");
}

#[test]
fn packets_follow_the_manual() {
    let campus = Campus::new(&quiet(), 3).unwrap();
    let (bytes, summary) = write(&campus, 0);
    let log = read(&bytes);
    let drive = campus.drive(0);

    // 6 m at 2 m/s: 2.8 s between the margins are 27 messages of 181 x 0.55296 ms = 0.10009 s;
    // 27.02 turns.
    let expected = DriveSummary { turns: 27, packets: 27 * 181, length_m: 6.0, duration_s: 3.0 };
    assert_eq!(summary, expected);
    assert_eq!(packets(&log).count() as u64, summary.packets);

    let mut borders = Vec::new();
    for scan in &log.scans {
        let (first, last) = (scan.packets.first().unwrap(), scan.packets.last().unwrap());
        assert_eq!(scan.packets.len(), 181);
        assert_eq!((scan.stamp_ns, scan.log_time_ns), (last.0, last.0));
        borders.push(Packet::new(&first.1).unwrap().azimuth(0));
    }
    // 181 packets are 36 030.87 counts: every border lies 31 counts after the one before.
    assert!(0 < borders[0]);
    for pair in borders.windows(2) {
        let step = (i32::from(pair[1]) - i32::from(pair[0])).rem_euclid(36_000);
        assert!((30..=32).contains(&step), "{step}");
    }

    let mut expected_ns = drive.first_firing_ns();
    let mut azimuths = Vec::new();
    for (stamp_ns, packet) in packets(&log) {
        // The stamp is the packet's end, the device's clock its first firing.
        let device_us = expected_ns / 1000 % i64::from(hdl32e::HOUR_US);
        assert_eq!(i64::from(packet.device_time_us()), device_us);
        expected_ns += hdl32e::PACKET_PERIOD_NS;
        assert_eq!(stamp_ns, expected_ns);
        azimuths.extend((0..hdl32e::BLOCKS).map(|block| i32::from(packet.azimuth(block))));
        assert_eq!(packet.product(), hdl32e::PRODUCT_HDL32E);
        assert_eq!(packet.return_mode(), Some(hdl32e::ReturnMode::Strongest));
    }
    // A block's step is 16.5888 counts: 16 or 17, and after n blocks never off by more than one.
    for (n, pair) in azimuths.windows(2).enumerate() {
        let step = (pair[1] - pair[0]).rem_euclid(36_000);
        assert!(step == 16 || step == 17, "{step} after block {n}");
        let expected = f64::from(azimuths[0]) + n as f64 * 16.5888;
        let error = (f64::from(pair[0]) - expected + 18_000.0).rem_euclid(36_000.0) - 18_000.0;
        assert!(error.abs() <= 1.0, "{error} at block {n}");
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
fn true_poses_surround_the_firings() {
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
            assert_eq!([x, y], [0.0, 0.0]);
            let heading_rad = 2.0 * z.atan2(w);
            assert!(dataset::wrap_angle(heading_rad - truth.heading_rad).abs() < 1e-12);
        }
    }
}

/// Decodes the returns of laser 15 by the manual's numbers alone, and places them in the map:
/// (point, range, expected range).
fn laser_15(campus: &Campus, log: usize) -> Vec<(Point, f64, Option<f64>)> {
    let (bytes, _) = write(campus, log);
    let drive = campus.drive(log);
    let step_deg = 360.0 * campus.options().spin_hz * 46.08e-6;
    let y_sign = if campus.options().upside_down { 1.0 } else { -1.0 };
    let mut returns = Vec::new();
    for scan in read(&bytes).scans {
        for (stamp_ns, packet) in scan.packets {
            for (block, bytes) in packet.chunks_exact(100).take(12).enumerate() {
                let u16_at = |at: usize| f64::from(u16::from_le_bytes([bytes[at], bytes[at + 1]]));
                let azimuth_deg = u16_at(2) * 0.01 + step_deg * 15.0 / 40.0;
                let range_m = u16_at(4 + 3 * 15) * 0.002;
                let ns = stamp_ns - 552_960 + block as i64 * 46_080 + 15 * 1_152;
                let pose = drive.pose_at(ns);
                let bearing = pose.heading_rad + y_sign * azimuth_deg.to_radians();
                let from = Point::new(pose.x_m, pose.y_m);
                let point =
                    Point::new(from.x + range_m * bearing.cos(), from.y + range_m * bearing.sin());
                returns.push((point, range_m, drive.range_m(from, bearing)));
            }
        }
    }
    returns
}

/// Distance to the nearest wall, if within 20 mm, else infinite \[m\].
fn distance_to_walls_m(segments: &[Segment], point: Point) -> f64 {
    let margin = 0.02;
    let is_near = |a: f64, b: f64, at: f64| a.min(b) - margin < at && at < a.max(b) + margin;
    segments
        .iter()
        .filter(|s| is_near(s.start.x, s.end.x, point.x) && is_near(s.start.y, s.end.y, point.y))
        .map(|s| s.distance_m(point))
        .fold(f64::INFINITY, f64::min)
}

/// The packet rounds ranges to 2 mm (error up to 1 mm) and azimuths to 0.01 deg: up to 0.005 deg,
/// which is 4 mm at 45 m. So a return is on its wall to 5 mm up to there, and to 7.2 mm at 70 m.
#[test]
fn every_return_of_laser_15_lies_on_a_wall() {
    for upside_down in [false, true] {
        let options = Options { upside_down, length_m: 24.0, ..quiet() };
        let campus = Campus::new(&options, 11).unwrap();
        for log in 0..2 {
            let returns = laser_15(&campus, log);
            let segments = campus.drive(log).segments();
            let (mut n_returns, mut n_as_cast) = (0, 0);
            for (point, range_m, cast_m) in &returns {
                if *range_m <= 0.0 {
                    continue;
                }
                n_returns += 1;
                let off_m = distance_to_walls_m(segments, *point);
                let limit_m = f64::max(0.005, 0.0011 + range_m * 0.005f64.to_radians());
                assert!(off_m <= limit_m, "{off_m} m off at {range_m} m");
                n_as_cast += usize::from(cast_m.is_some_and(|m| (m - range_m).abs() < 0.01));
            }
            // Indoors nearly every firing returns; at edges and under grazing incidence the rounded
            // azimuth meets the wall elsewhere.
            assert!(0.99 * (returns.len() as f64) < f64::from(n_returns), "{n_returns}");
            assert!(0.95 * f64::from(n_returns) < n_as_cast as f64, "{n_as_cast}");
        }
    }
}

#[test]
fn noise_dropouts_and_people_are_as_asked() {
    let campus = |options| Campus::new(&options, 11).unwrap();
    let ranges = |options| -> Vec<f64> {
        laser_15(&campus(options), 0).into_iter().map(|(_, range_m, _)| range_m).collect()
    };
    let clean = ranges(quiet());
    let noisy = ranges(Options { range_noise_m: 0.02, dropout: 0.1, ..quiet() });
    let pairs: Vec<_> = clean.iter().zip(&noisy).filter(|(clean, _)| 0.0 < **clean).collect();
    let lost = pairs.iter().filter(|(_, noisy)| **noisy <= 0.0).count() as f64;
    assert!((lost / pairs.len() as f64 - 0.1).abs() < 0.005, "{lost} of {}", pairs.len());
    let errors = pairs.iter().filter(|(_, noisy)| 0.0 < **noisy).map(|(c, n)| *n - *c);
    let errors: Vec<f64> = errors.collect();
    let mean = errors.iter().sum::<f64>() / errors.len() as f64;
    let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
    assert!(mean.abs() < 0.0005 && (rms - 0.02).abs() < 0.0005, "mean {mean}, rms {rms}");

    // People only ever bring something nearer, or into range.
    let crowded = ranges(Options { people: 200, ..quiet() });
    let pairs: Vec<_> = clean.iter().zip(&crowded).filter(|(clean, _)| 0.0 < **clean).collect();
    assert!(pairs.iter().all(|(clean, crowded)| 0.0 < **crowded && crowded <= clean));
    let nearer = pairs.iter().filter(|(clean, crowded)| crowded < clean).count();
    assert!(clean.len() < 100 * nearer, "{nearer} of {}", clean.len());
}

#[test]
fn all_lasers_or_three() {
    let mut horizontal = Vec::new();
    for (lasers, expected) in [(Lasers::Three, 14..17), (Lasers::All, 0..32)] {
        let campus = Campus::new(&Options { lasers, length_m: 1.0, ..quiet() }, 2).unwrap();
        let log = read(&write(&campus, 0).0);
        let blocks = || packets(&log).flat_map(|(_, p)| (0..hdl32e::BLOCKS).map(move |b| (p, b)));
        let returns = |laser: &usize| blocks().any(|(p, b)| 0 < p.distance(b, *laser));
        let found: Vec<usize> = (0..hdl32e::LASERS).filter(returns).collect();
        assert_eq!(found, expected.collect::<Vec<_>>());
        horizontal.push(blocks().map(|(p, b)| p.distance(b, 15)).collect::<Vec<_>>());
    }
    assert!(horizontal[0] == horizontal[1], "the choice of lasers changes laser 15");
}

#[test]
fn the_file_says_how_it_was_made_and_holds_to_the_format() {
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
            // 27 scans; poses from 0 s to 3 s every 0.05 s.
            assert_eq!(stats.message_count, 27 + 61);
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

            // Chunk after chunk with its CRC; times never step back, within a file.
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
fn options_have_defaults_and_unknown_keys_fail() {
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
fn bad_options_are_named() {
    #[track_caller]
    fn check(change: impl FnOnce(&mut Options), expected: &str) {
        let mut options = Options::default();
        change(&mut options);
        let error = Campus::new(&options, 1).expect_err(expected).to_string();
        assert!(error.contains(expected), "{error}\n{expected}");
    }
    check(|o| o.logs.clear(), "simulate.logs is empty");
    for name in ["", "a/b", "..", ".hidden", "-x", "a b", "lap*", "über"] {
        check(|o| o.logs = vec![name.to_owned()], &format!("{name:?}, which is no file stem"));
    }
    check(|o| o.logs = vec!["a".repeat(101)], "no file stem");
    check(|o| o.logs = ["a", "b", "A"].map(str::to_owned).into(), "simulate.logs has \"A\" twice");
    check(|o| o.length_m = f64::NAN, "simulate.length_m is NaN, expected 0.1 to 1000000");
    check(|o| o.length_m = -1.0, "simulate.length_m is -1, expected");
    check(|o| o.speed_m_s = 0.0, "simulate.speed_m_s is 0, expected");
    check(|o| o.spin_hz = f64::INFINITY, "simulate.spin_hz is inf, expected 5 to 20");
    check(|o| o.spin_hz = 4.9, "simulate.spin_hz is 4.9, expected 5 to 20");
    check(|o| o.range_noise_m = -0.1, "simulate.range_noise_m is -0.1, expected 0 to 1");
    check(|o| o.dropout = 1.5, "simulate.dropout is 1.5, expected 0 to 1");
    check(|o| o.people = 1001, "simulate.people is 1001, expected 0 to 1000");
    // A message of 0.10009 s and two margins of 0.1 s, at 2 m/s: 0.60017 m.
    check(|o| o.length_m = 0.6, "drive at least 0.600 m");
    let enough = Options { length_m: 0.6002, ..Options::default() };
    assert_eq!(write(&Campus::new(&enough, 1).unwrap(), 0).1.packets, 181);

    let campus = Campus::new(&enough, 1).unwrap();
    let error = write_drive(&campus, 2, Cursor::new(Vec::new())).unwrap_err();
    assert!(matches!(error, SimulateError::NoSuchLog { log: 2, n_logs: 2 }), "{error}");
}

#[test]
fn a_full_disk_is_an_error() {
    let campus = Campus::new(&quiet(), 1).unwrap();
    let mut room = [0; 10_000];
    let error = write_drive(&campus, 0, Cursor::new(&mut room[..])).unwrap_err();
    assert!(matches!(error, SimulateError::Write(_)), "{error}");
}
