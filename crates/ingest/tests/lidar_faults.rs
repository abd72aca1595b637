//! Lidar messages whose stamps, frames, angles, ranges or point times are wrong.

#![allow(clippy::unwrap_used, reason = "a test panics if a value is missing")]

mod common;

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::io::Cursor;
use std::path::Path;
use std::sync::Arc;

use dataset::Scan;
use ingest::{IngestError, Ingested, LidarOptions, Log, Options, PoseOptions, Stamp, survey};
use messages::hdl32e::{BLOCKS, PACKET_PERIOD_NS, PacketBuilder};
use messages::{
    Encoding, LaserScan, MessageType, PointCloud, PointField, Scalar, StampedPose3, foxglove, ros,
};

use common::{codes, ingest_logs};

const START_NS: i64 = 1_700_000_000_000_000_000;
const S: i64 = 1_000_000_000;
const MS: i64 = 1_000_000;

/// A message with its log time \[ns\].
struct Recorded {
    topic: &'static str,
    message_type: MessageType,
    encoding: Encoding,
    log_ns: i64,
    data: Vec<u8>,
}

fn log_of(messages: &[Recorded]) -> Log {
    let options = mcap::WriteOptions::new().chunk_size(Some(4000));
    let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
    let mut channels: BTreeMap<&str, Arc<mcap::Channel<'_>>> = BTreeMap::new();
    for message in messages {
        let id = channels.len() as u16 + 1;
        let channel = channels.entry(message.topic).or_insert_with(|| {
            let name = message.message_type.schema_name(message.encoding).unwrap().to_owned();
            let schema =
                mcap::Schema { id, name, encoding: "ros2msg".to_owned(), data: Cow::Borrowed(b"") };
            Arc::new(mcap::Channel {
                id,
                topic: message.topic.to_owned(),
                schema: Some(Arc::new(schema)),
                message_encoding: message.encoding.name().to_owned(),
                metadata: BTreeMap::new(),
            })
        });
        let (log_time, data) = (message.log_ns as u64, Cow::Borrowed(&message.data[..]));
        let channel = channel.clone();
        let message =
            mcap::Message { channel, sequence: 0, log_time, publish_time: log_time, data };
        writer.write(&message).unwrap();
    }
    writer.finish().unwrap();
    Log::from_bytes(Path::new("drive.mcap"), writer.into_inner().into_inner()).unwrap()
}

fn ingest(messages: &[Recorded], options: &Options) -> Result<(Vec<Scan>, Ingested), IngestError> {
    ingest_logs(&[log_of(messages)], options)
}

fn options() -> Options {
    Options {
        lidar: LidarOptions { topic: "/lidar".to_owned(), ..LidarOptions::default() },
        pose: Some(PoseOptions::of_topic("/pose")),
    }
}

/// When message `k` of 10 per second was measured \[ns\].
fn at(k: i64) -> i64 {
    START_NS + k * S / 10
}

fn laser(stamp_ns: i64) -> LaserScan {
    LaserScan {
        stamp_ns,
        angle_min: -1.5,
        angle_max: Some(1.5),
        angle_increment: 0.5,
        time_increment_s: 0.0,
        range_min: 0.1,
        range_max: 50.0,
        ranges: (0..7).map(|beam| (stamp_ns % 7 + 2 + beam) as f32).collect(),
    }
}

fn scan_message(frame: &str, scan: &LaserScan, log_ns: i64, encoding: Encoding) -> Recorded {
    let is_ros = matches!(encoding, Encoding::Cdr | Encoding::Ros1);
    let (message_type, data) = match is_ros {
        true => (MessageType::LaserScan, ros::write_laser_scan(encoding, frame, scan)),
        false => {
            (MessageType::FoxgloveLaserScan, foxglove::write_laser_scan(encoding, frame, scan))
        }
    };
    Recorded { topic: "/lidar", message_type, encoding, log_ns, data }
}

fn pose_message(stamp_ns: i64, log_ns: i64, x_m: f64) -> Recorded {
    let orientation = [0.0, 0.0, 0.0, 1.0];
    let pose = StampedPose3 { stamp_ns, position: [x_m, 0.0, 0.0], orientation };
    let data = ros::write_pose_stamped(Encoding::Cdr, "odom", &pose);
    let message_type = MessageType::PoseStamped;
    Recorded { topic: "/pose", message_type, encoding: Encoding::Cdr, log_ns, data }
}

/// `n` scans and poses. The functions give the stamps; all messages are recorded 10 ms after they
/// were measured.
fn drive(n: i64, scan_ns: impl Fn(i64) -> i64, pose_ns: impl Fn(i64) -> i64) -> Vec<Recorded> {
    (0..n)
        .flat_map(|k| {
            let log_ns = at(k) + 10 * MS;
            let scan = LaserScan { stamp_ns: scan_ns(k), ..laser(k) };
            [
                scan_message("laser", &scan, log_ns, Encoding::Cdr),
                pose_message(pose_ns(k), log_ns, k as f64 * 0.1),
            ]
        })
        .collect()
}

fn note_codes(ingested: &Ingested) -> Vec<&'static str> {
    let codes = ingested.notes.iter().map(dataset::Note::code);
    codes.filter(|code| !code.contains("deskewed")).collect()
}

#[test]
fn regular_messages_give_no_note() {
    let (scans, ingested) = ingest(&drive(60, at, at), &options()).unwrap();
    assert_eq!((scans.len(), ingested.trajectory.poses().len()), (60, 60));
    assert_eq!(note_codes(&ingested), [""; 0]);
    assert!(ingested.losses.is_empty());
    // A log that was played and recorded again.
    let old = |k| at(k) - 300_000_000 * S;
    let (_, ingested) = ingest(&drive(60, old, old), &options()).unwrap();
    assert_eq!(note_codes(&ingested), [""; 0]);
    // A simulation that starts at 0, and whose log times are those of the simulation.
    let mut simulated = drive(60, |k| k * S / 10, |k| k * S / 10);
    simulated.iter_mut().for_each(|message| message.log_ns -= START_NS);
    let (scans, ingested) = ingest(&simulated, &options()).unwrap();
    assert_eq!((scans.len(), ingested.losses.is_empty()), (60, true));
    // The same with the log times of the clock on the wall: the stamps 0 of the first messages are times.
    let simulated = drive(60, |k| k * S / 10, |k| k * S / 10);
    let (scans, ingested) = ingest(&simulated, &options()).unwrap();
    let n_poses = ingested.trajectory.poses().len();
    assert_eq!((scans.len(), n_poses, ingested.losses.is_empty()), (60, 60, true));
}

#[test]
fn stamps_that_are_all_zero_or_equal_are_an_error_that_names_the_option() {
    for stamp_ns in [0, at(3)] {
        let error = ingest(&drive(40, |_| stamp_ns, at), &options()).unwrap_err();
        assert_eq!(error.code(), "no_stamps");
        let text = error.to_string();
        assert!(
            text.contains(&format!(
                "all 40 messages of topic `/lidar` have the stamp {stamp_ns} ns"
            ))
        );
        assert!(text.contains("set `ingest.lidar.stamp = \"log\"`"), "{text}");
        let error = ingest(&drive(40, at, |_| stamp_ns), &options()).unwrap_err().to_string();
        assert!(error.contains("topic `/pose`") && error.contains("`ingest.pose.stamp = \"log\"`"));
    }
    // Log times serve for both.
    let mut by_log = options();
    by_log.lidar.stamp = Stamp::Log;
    by_log.pose.as_mut().unwrap().stamp = Stamp::Log;
    let (scans, ingested) = ingest(&drive(40, |_| 0, |_| 0), &by_log).unwrap();
    let expected: Vec<i64> = (0..40).map(|k| at(k) + 10 * MS).collect();
    assert_eq!(scans.iter().map(|scan| scan.stamp_ns).collect::<Vec<_>>(), expected);
    let poses = ingested.trajectory.poses().iter().map(|pose| pose.stamp_ns);
    assert_eq!(poses.collect::<Vec<_>>(), expected);
    assert_eq!(note_codes(&ingested), [""; 0]);
}

#[test]
fn a_few_messages_without_stamp_are_counted_and_not_used() {
    let late_clock = |k| if k < 5 { 0 } else { at(k) };
    let (scans, ingested) = ingest(&drive(40, late_clock, late_clock), &options()).unwrap();
    assert_eq!((scans.len(), ingested.trajectory.poses().len()), (35, 35));
    assert_eq!(codes(&ingested.losses), [("unstamped_messages", 5), ("unstamped_messages", 5)]);
}

#[test]
fn a_clock_that_is_set_is_reported_with_its_size() {
    let note = |messages: &[Recorded]| {
        let (_, ingested) = ingest(messages, &options()).unwrap();
        let note = ingested.notes.iter().find(|note| note.code().starts_with("stamp"));
        note.map(ToString::to_string).unwrap_or_default()
    };
    let set = |by_ns: i64| move |k: i64| at(k) + if k < 40 { 0 } else { by_ns };
    let text = note(&drive(80, set(-3 * S), at));
    assert!(text.contains("step back by up to 3.00 s, once") && text.contains("/lidar"), "{text}");
    let text = note(&drive(80, set(18 * S), at));
    assert!(text.contains("by up to +18.00 s against the log times, once"), "{text}");
    // Both computers, and the recorder: only the order of the messages shows it.
    let mut together = drive(80, set(-3 * S), set(-3 * S));
    together.iter_mut().skip(80).for_each(|message| message.log_ns -= 3 * S);
    let (_, ingested) = ingest(&together, &options()).unwrap();
    let texts: Vec<String> = ingested.notes.iter().map(ToString::to_string).collect();
    assert!(texts.iter().any(|text| text.contains("the log times step back, too")), "{texts:?}");
    assert_eq!(note(&drive(80, set(-150 * MS), at)), "", "within the delays of a busy host");
}

#[test]
fn clocks_that_differ_are_reported() {
    for offset_ns in [-18 * S, 3600 * S, -2 * S, 300 * MS] {
        let (_, ingested) = ingest(&drive(60, |k| at(k) + offset_ns, at), &options()).unwrap();
        assert_eq!(note_codes(&ingested), ["stamp_offsets_differ"], "{offset_ns}");
    }
    // A lidar driver that takes 0.3 s.
    let (_, ingested) = ingest(&drive(60, |k| at(k) - 300 * MS, at), &options()).unwrap();
    assert_eq!(note_codes(&ingested), [""; 0]);
}

#[test]
fn messages_that_are_recorded_twice_are_used_once() {
    let messages: Vec<Recorded> = (0..30)
        .map(|k| scan_message("laser", &laser(at(k / 2)), at(k / 2) + k, Encoding::Cdr))
        .collect();
    let no_pose = Options { pose: None, ..options() };
    let (scans, ingested) = ingest(&messages, &no_pose).unwrap();
    assert_eq!((scans.len(), codes(&ingested.losses)), (15, vec![("duplicate_scans", 15)]));
}

#[test]
fn one_of_several_frames_must_be_selected() {
    for encoding in [Encoding::Cdr, Encoding::Ros1, Encoding::Protobuf, Encoding::Json] {
        let messages: Vec<Recorded> = (0..30)
            .map(|k| {
                let frame = ["/front", "rear", "rear"][(k % 3) as usize];
                scan_message(frame, &laser(at(k)), at(k), encoding)
            })
            .collect();
        let mut options = Options { pose: None, ..options() };
        let error = ingest(&messages, &options).unwrap_err();
        assert_eq!(error.code(), "several_frames");
        let text = error.to_string();
        assert!(text.contains("`front` (10 messages), `rear` (20 messages)"), "{text}");
        assert!(text.contains("set `ingest.lidar.frame_id`"), "{text}");
        options.lidar.frame_id = Some("/rear".to_owned());
        let (scans, ingested) = ingest(&messages, &options).unwrap();
        let stamps: Vec<i64> = scans.iter().map(|scan| scan.stamp_ns).collect();
        let expected: Vec<i64> = (0..30).filter(|k| k % 3 != 0).map(at).collect();
        assert_eq!((stamps, note_codes(&ingested)), (expected, vec!["other_frames"]));
        options.lidar.frame_id = Some("top".to_owned());
        assert_eq!(ingest(&messages, &options).unwrap_err().code(), "frame_not_on_topic");
        let survey = survey(&[&log_of(&messages)], |_| ());
        let frames = survey.topics[0].frames.iter();
        let frames: Vec<_> = frames.map(|frame| (&frame.frame_id[..], frame.n_messages)).collect();
        assert_eq!(frames, [("front", 10), ("rear", 20)]);
    }
}

/// Two HDL-32E, switched on 500 s apart, whose messages of 20 packets alternate.
fn two_velodynes(frames: [&str; 2]) -> Vec<Recorded> {
    (0..400i64)
        .map(|k| {
            let sensor = k % 2;
            let packets: Vec<_> = (0..20)
                .map(|j| {
                    let packet = k / 2 * 20 + j;
                    let azimuths = std::array::from_fn(|block| {
                        ((packet * BLOCKS as i64 + block as i64 + sensor * 900) * 20 % 36_000)
                            as u16
                    });
                    let device_us = (packet * 553 + sensor * 500_000_000) as u32;
                    let mut builder = PacketBuilder::new(azimuths, device_us);
                    (0..BLOCKS).for_each(|block| builder.set_return(block, 15, 2500, 9));
                    (START_NS + packet * PACKET_PERIOD_NS + sensor * 20_000, builder.finish())
                })
                .collect();
            let log_ns = packets[19].0;
            let frame = frames[sensor as usize];
            let data = ros::write_velodyne_scan(Encoding::Cdr, frame, log_ns, &packets);
            let message_type = MessageType::VelodyneScan;
            Recorded { topic: "/lidar", message_type, encoding: Encoding::Cdr, log_ns, data }
        })
        .collect()
}

#[test]
fn two_velodynes_on_one_topic_are_told_apart_by_frame_or_clock() {
    let mut options = Options { pose: None, ..options() };
    let two = two_velodynes(["velodyne_left", "velodyne_right"]);
    let error = ingest(&two, &options).unwrap_err();
    assert_eq!(error.code(), "several_frames");
    assert!(error.to_string().contains("`velodyne_left` (200 messages)"), "{error}");
    options.lidar.frame_id = Some("velodyne_right".to_owned());
    let (scans, ingested) = ingest(&two, &options).unwrap();
    assert_eq!(scans.len(), ingested.n_scans);
    // 48,000 firings of 0.2 deg are 26.7 revolutions.
    assert!((24..=26).contains(&scans.len()), "{}", scans.len());
    assert!(ingested.losses.is_empty(), "{:?}", ingested.losses);
    options.lidar.frame_id = None;
    let error = ingest(&two_velodynes(["velodyne"; 2]), &options).unwrap_err();
    assert_eq!(error.code(), "two_sensors");
    assert!(error.to_string().contains("4000 packets with a device clock"), "{error}");
}

#[test]
fn contradictory_scans_are_left_out_with_their_numbers() {
    let clockwise = |k: i64| match k % 4 {
        0 => LaserScan { angle_increment: -0.5, ..laser(at(k)) },
        _ => laser(at(k)),
    };
    let messages = |scan: &dyn Fn(i64) -> LaserScan| -> Vec<Recorded> {
        (0..40).map(|k| scan_message("laser", &scan(k), at(k), Encoding::Cdr)).collect()
    };
    let options = Options { pose: None, ..options() };
    let (scans, ingested) = ingest(&messages(&clockwise), &options).unwrap();
    assert_eq!((scans.len(), codes(&ingested.losses)), (30, vec![("contradictory_angles", 10)]));
    let text = ingested.losses.to_string();
    assert!(text.contains("angle_max is 85.94 deg: off by 343.77 deg"), "{text}");

    let degrees = |k| LaserScan {
        angle_min: -90.0,
        angle_max: Some(90.0),
        angle_increment: 30.0,
        ..laser(at(k))
    };
    let error = ingest(&messages(&degrees), &options).unwrap_err();
    assert_eq!(error.code(), "no_scans");
    let text = error.to_string();
    assert!(text.contains("40 planar scans") && text.contains("180.0 deg"), "{text}");

    let unset = |k| LaserScan { range_max: 0.0, ..laser(at(k)) };
    let (scans, ingested) = ingest(&messages(&unset), &options).unwrap();
    assert!(scans.iter().all(|scan| scan.len() == 7));
    assert_eq!(note_codes(&ingested), ["range_max_unset"]);

    let millimetres = |k| LaserScan { ranges: vec![2500.0; 7], ..laser(at(k)) };
    let error = ingest(&messages(&millimetres), &options).unwrap_err();
    assert_eq!(error.code(), "no_returns");
    assert!(error.to_string().contains("all 280 positive readings"), "{error}");
    assert!(error.to_string().contains("are they millimetres?"), "{error}");

    let slow = |k| LaserScan { time_increment_s: 0.5, ..laser(at(k)) };
    let (_, ingested) = ingest(&messages(&slow), &options).unwrap();
    assert_eq!(note_codes(&ingested), ["time_increment_ignored"]);
}

/// A cloud of a lidar at `x_m`, with rings at -10, 0 and 10 deg, in a room of 20 x 10 m around the
/// lidar. The points are moved by `shift`. The fields are f32 or, for the time, `time.1`.
fn cloud(
    stamp_ns: i64,
    shift: [f64; 3],
    time: (&str, Scalar),
    time_of: impl Fn(f64) -> f64,
) -> PointCloud<'static> {
    let mut data = Vec::new();
    for column in 0..360 {
        let azimuth = -f64::from(column).to_radians();
        let (sin, cos) = azimuth.sin_cos();
        let range = (10.0 / cos.abs()).min(5.0 / sin.abs());
        for (ring, elevation_deg) in [-10.0f64, 0.0, 10.0].into_iter().enumerate() {
            let z = range * elevation_deg.to_radians().tan();
            for (v, by) in [range * cos, range * sin, z].into_iter().zip(shift) {
                data.extend(((v + by) as f32).to_le_bytes());
            }
            data.extend((ring as u16).to_le_bytes());
            let t = time_of(f64::from(column) / 3600.0);
            match time.1 {
                Scalar::F32 => data.extend((t as f32).to_le_bytes()),
                Scalar::F64 => data.extend(t.to_le_bytes()),
                _ => data.extend((t as u32).to_le_bytes()),
            }
        }
    }
    let fields = [("x", 0, Scalar::F32), ("y", 4, Scalar::F32), ("z", 8, Scalar::F32)];
    let fields = fields.into_iter().chain([("ring", 12, Scalar::U16), (time.0, 14, time.1)]);
    let field = |(name, offset, kind): (&str, usize, Scalar)| PointField {
        name: name.to_owned(),
        offset,
        kind,
    };
    let point_step = 14 + time.1.n_bytes();
    PointCloud {
        stamp_ns,
        width: 1080,
        height: 1,
        point_step,
        row_step: 1080 * point_step,
        big_endian: false,
        fields: fields.map(field).collect(),
        data: data.into(),
    }
}

fn cloud_message(frame: &str, cloud: &PointCloud<'_>, log_ns: i64, encoding: Encoding) -> Recorded {
    let is_ros = matches!(encoding, Encoding::Cdr | Encoding::Ros1);
    let (message_type, data) = match is_ros {
        true => (MessageType::PointCloud2, ros::write_point_cloud2(encoding, frame, cloud)),
        false => {
            (MessageType::FoxglovePointCloud, foxglove::write_point_cloud(encoding, frame, cloud))
        }
    };
    Recorded { topic: "/lidar", message_type, encoding, log_ns, data }
}

/// The lidar drives with 2 m/s. Every driver's times give the same deskewed scan.
#[test]
fn point_times_of_every_driver_deskew_alike() {
    type Times<'a> = &'a dyn Fn(i64, f64) -> f64;
    let drivers: [(&str, Scalar, Times<'_>, usize); 8] = [
        ("time", Scalar::F32, &|_, s| s, 0),
        ("t", Scalar::U32, &|_, s| s * 1e9, 0),
        ("t", Scalar::U32, &|_, s| s * 1e6, 1),
        ("time", Scalar::F32, &|_, s| s * 1e3, 1),
        ("offset_time", Scalar::U32, &|_, s| s * 1e9, 0),
        ("timestamp", Scalar::F64, &|stamp_ns, s| stamp_ns as f64 * 1e-9 + s, 0),
        ("timestamp", Scalar::F64, &|stamp_ns, s| stamp_ns as f64 + s * 1e9, 1),
        ("time_stamp", Scalar::F64, &|stamp_ns, s| stamp_ns as f64 * 1e-3 + s * 1e6, 1),
    ];
    let mut first: Option<Vec<Scan>> = None;
    for (name, kind, time_of, n_notes) in drivers {
        for encoding in [Encoding::Cdr, Encoding::Ros1, Encoding::Protobuf] {
            let messages: Vec<Recorded> = (0..12)
                .flat_map(|k| {
                    let cloud = cloud(at(k), [0.0; 3], (name, kind), |s| time_of(at(k), s));
                    let log_ns = at(k) + S / 10;
                    let pose = |j: i64| {
                        pose_message(at(k) + j * 50 * MS, log_ns, 0.2 * k as f64 + 0.1 * j as f64)
                    };
                    [cloud_message("velodyne", &cloud, log_ns, encoding), pose(0), pose(1)]
                })
                .collect();
            let (scans, ingested) = ingest(&messages, &options()).unwrap();
            assert_eq!(
                note_codes(&ingested),
                vec!["point_time_unit"; n_notes],
                "{name} {encoding:?}"
            );
            let deskewed = ingested.notes.iter().find(|note| note.code() == "deskewed").unwrap();
            assert!(deskewed.to_string().starts_with("11 scans deskewed"), "{name}: {deskewed}");
            // The last column is measured 0.0997 s after the first, 0.1994 m farther along x.
            let last = (scans[3].x_m[359], scans[3].y_m[359]);
            assert!((last.0 - 10.1994).abs() < 2e-3, "{name} {encoding:?} {last:?}");
            let first = first.get_or_insert_with(|| scans.clone());
            for (scan, expected) in scans.iter().zip(first) {
                // A time in seconds since the epoch has a resolution of 0.24 us.
                assert!((scan.stamp_ns - expected.stamp_ns).abs() < 1000);
                let points = scan.x_m.iter().zip(&expected.x_m);
                points.for_each(|(a, b)| assert!((a - b).abs() < 1e-4, "{name} {a} {b}"));
            }
        }
    }
}

#[test]
fn clouds_without_usable_times_are_not_called_deskewed() {
    type Times<'a> = &'a dyn Fn(f64) -> f64;
    let times: [(Times<'_>, &[&str]); 2] =
        [(&|_| 0.0, &[]), (&|s| s * 1e14, &["point_times_implausible"])];
    for (time_of, expected) in times {
        let messages: Vec<Recorded> = (0..12)
            .flat_map(|k| {
                let cloud = cloud(at(k), [0.0; 3], ("time", Scalar::F64), time_of);
                let pose = |j: i64| pose_message(at(k) + j * 50 * MS, at(k), 0.0);
                [cloud_message("velodyne", &cloud, at(k), Encoding::Cdr), pose(0), pose(1)]
            })
            .collect();
        let (scans, ingested) = ingest(&messages, &options()).unwrap();
        assert_eq!((scans.len(), note_codes(&ingested)), (12, expected.to_vec()));
        let texts: Vec<String> = ingested.notes.iter().map(ToString::to_string).collect();
        assert!(texts.iter().any(|text| text.starts_with("12 scans not deskewed")), "{texts:?}");
    }
}

#[test]
fn with_log_times_the_last_point_has_the_log_time() {
    let messages: Vec<Recorded> = (0..12)
        .map(|k| {
            let cloud = cloud(0, [0.0; 3], ("t", Scalar::U32), |s| s * 1e9);
            cloud_message("velodyne", &cloud, at(k) + 200 * MS, Encoding::Cdr)
        })
        .collect();
    let mut by_log = Options { pose: None, ..options() };
    by_log.lidar.stamp = Stamp::Log;
    let (scans, _) = ingest(&messages, &by_log).unwrap();
    // The last column is measured 99.722 ms after the first.
    let expected: Vec<i64> = (0..12).map(|k| at(k) + 200 * MS - 99_722_222).collect();
    assert_eq!(scans.iter().map(|scan| scan.stamp_ns).collect::<Vec<_>>(), expected);
    by_log.lidar.stamp = Stamp::Header;
    assert_eq!(ingest(&messages, &by_log).unwrap_err().code(), "no_stamps");
}

#[test]
fn clouds_that_were_moved_to_another_frame_are_refused() {
    let drive = |frame: &'static str, shift: &dyn Fn(i64) -> [f64; 3]| -> Vec<Recorded> {
        (0..20)
            .flat_map(|k| {
                let cloud = cloud(at(k), shift(k), ("t", Scalar::U32), |s| s * 1e9);
                let message = cloud_message(frame, &cloud, at(k), Encoding::Cdr);
                [message, pose_message(at(k), at(k), 0.3 * k as f64)]
            })
            .collect()
    };
    let along = |k: i64| [0.3 * k as f64, 0.0, 0.0];
    let mounted = |_| [0.4, 0.0, 0.8];
    for (frame, shift) in [
        ("odom", &along as &dyn Fn(i64) -> [f64; 3]),
        ("slam_map", &along),
        ("velodyne", &along),
        ("base_link", &mounted),
        ("robot1/base_link", &mounted),
    ] {
        let error = ingest(&drive(frame, shift), &options()).unwrap_err();
        assert_eq!(error.code(), "not_in_sensor_frame", "{frame}");
        let text = error.to_string();
        assert!(text.contains(&format!("in the frame `{frame}`")), "{text}");
        assert!(text.contains("not at one elevation"), "{text}");
    }
    let in_sensor = |_| [0.0; 3];
    let (_, ingested) = ingest(&drive("velodyne", &in_sensor), &options()).unwrap();
    assert_eq!(note_codes(&ingested), [""; 0]);
    // Named after the frame of the poses, but seen from the sensor.
    let (_, ingested) = ingest(&drive("odom", &in_sensor), &options()).unwrap();
    assert_eq!(note_codes(&ingested), ["lidar_frame_doubtful"]);
}
