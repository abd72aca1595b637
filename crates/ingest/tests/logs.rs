//! Tests of the structure of logs, intact and damaged.

#![allow(clippy::unwrap_used, reason = "a test panics if a value is missing")]

mod common;

use std::path::Path;

use common::{
    Entry, codes, error, ingest_bytes, ingest_file, options, packet_log, planar_log, small_chunks,
    write,
};
use dataset::StampedPose;
use ingest::IngestError;
use mcap::{Compression, WriteOptions};
use messages::hdl32e::PacketBuilder;
use messages::{Encoding, LaserScan, ros};

#[test]
fn every_compression_and_layout_gives_the_same_result() {
    let options = options("/scan", Some("/pose"));
    let expected = ingest_bytes(&write(&planar_log(), small_chunks()), &options).unwrap();
    assert_eq!((expected.0.len(), expected.1.trajectory.poses().len()), (10, 10));
    assert!(expected.1.losses.is_empty());
    let plain = WriteOptions::new;
    for (name, layout) in [
        ("lz4", small_chunks().compression(Some(Compression::Lz4))),
        ("none", small_chunks().compression(None)),
        ("one chunk", plain()),
        ("no chunks", plain().use_chunks(false)),
        ("no message index", small_chunks().emit_message_indexes(false)),
        ("no chunk index", small_chunks().emit_chunk_indexes(false)),
        ("no repeated channels", small_chunks().repeat_channels(false)),
        ("no statistics", small_chunks().emit_statistics(false)),
        ("no summary", small_chunks().emit_summary_records(false)),
        (
            "no channels in the summary, no chunks",
            plain().use_chunks(false).repeat_channels(false).repeat_schemas(false),
        ),
        (
            "no channels in the summary, no message index",
            small_chunks().emit_message_indexes(false).repeat_channels(false).repeat_schemas(false),
        ),
        (
            "no channels in the summary, no chunk index",
            small_chunks().emit_chunk_indexes(false).repeat_channels(false).repeat_schemas(false),
        ),
        ("no CRC", small_chunks().calculate_chunk_crcs(false)),
    ] {
        let found = ingest_bytes(&write(&planar_log(), layout), &options).unwrap();
        assert_eq!(found, expected, "{name}");
    }
}

#[test]
fn ros_1_and_ros_2_packets_give_the_same_revolutions() {
    let options = options("/packets", None);
    let (cdr, found) =
        ingest_bytes(&write(&packet_log(Encoding::Cdr), WriteOptions::new()), &options).unwrap();
    let (ros1, _) =
        ingest_bytes(&write(&packet_log(Encoding::Ros1), small_chunks()), &options).unwrap();
    assert_eq!(cdr, ros1);
    // 5280 firings of 0.17 deg. The log starts at azimuth 0, so its first revolution is complete.
    assert_eq!((cdr.len(), found.n_partial_revolutions), (2, 1));
    assert_eq!(cdr[0].len(), 2118);
    assert_eq!(cdr[0].stamp_ns, 17_280, "15 lasers of 1.152 us into the first block");
    // The first firing: 1500 counts of 2 mm, at 3/8 of 0.17 deg to the right.
    let azimuth = (0.375 * 0.17f64).to_radians();
    assert!((f64::from(cdr[0].x_m[0]) - 3.0 * azimuth.cos()).abs() < 1e-6);
    assert!((f64::from(cdr[0].y_m[0]) + 3.0 * azimuth.sin()).abs() < 1e-6);
    let ends = [(0, 3.0), (2117, 0.002 * f64::from(1500 + 35_989 / 12))];
    for (k, range_m) in ends {
        let found = f64::from(cdr[0].x_m[k]).hypot(f64::from(cdr[0].y_m[k]));
        assert!((found - range_m).abs() < 1e-5, "{found} {range_m}");
    }
}

#[test]
fn chunks_without_the_topics_are_not_decompressed() {
    let mut entries: Vec<Entry> = vec![("/camera", "sensor_msgs/msg/Image", "cdr", vec![7; 3000])];
    entries.extend(planar_log());
    let mut bytes = write(&entries, small_chunks().compression(None));
    // Corrupt the chunk of the camera, which the options do not use.
    let at = bytes.windows(100).position(|w| w == [7; 100]).unwrap();
    bytes[at + 50] = 8;
    let (scans, ingested) = ingest_bytes(&bytes, &options("/scan", Some("/pose"))).unwrap();
    assert_eq!((scans.len(), ingested.losses.is_empty()), (10, true));
}

#[test]
fn altered_chunks_are_dropped_and_counted_in_every_compression() {
    for compression in [None, Some(Compression::Zstd), Some(Compression::Lz4)] {
        let entries: Vec<Entry> = planar_log().into_iter().filter(|e| e.0 == "/scan").collect();
        let whole =
            write(&entries, WriteOptions::new().chunk_size(Some(100)).compression(compression));
        let summary = mcap::Summary::read(&whole).unwrap().unwrap();
        assert_eq!(summary.chunk_indexes.len(), 10);
        let chunk = &summary.chunk_indexes[4];
        let mut bytes = whole.clone();
        let last = (chunk.chunk_start_offset + chunk.chunk_length) as usize - 3;
        bytes[last] ^= 0x10;
        let (scans, ingested) = ingest_bytes(&bytes, &options("/scan", None)).unwrap();
        assert_eq!(scans.len(), 9, "{compression:?}");
        let found = codes(&ingested.losses);
        let expected = ["chunk_crc_mismatch", "undecompressable_chunks", "chunk_length_mismatch"];
        assert!(found.len() == 1 && found[0].1 == 1, "{found:?}");
        assert!(expected.contains(&found[0].0), "{found:?}");
    }
}

#[test]
fn a_chunk_that_claims_an_impossible_size_is_not_allocated() {
    let entries: Vec<Entry> = planar_log().into_iter().filter(|e| e.0 == "/scan").collect();
    let mut bytes = write(&entries, WriteOptions::new().chunk_size(Some(100)));
    let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
    // Opcode, length, start time and end time come before the uncompressed size.
    let at = summary.chunk_indexes[4].chunk_start_offset as usize + 9 + 16;
    bytes[at..at + 8].copy_from_slice(&(1u64 << 63).to_le_bytes());
    let (scans, ingested) = ingest_bytes(&bytes, &options("/scan", None)).unwrap();
    assert_eq!(scans.len(), 9);
    assert_eq!(codes(&ingested.losses), [("oversized_chunks", 1)]);
}

/// At every length, the complete scans are kept and equal the first scans of the intact log. The loss
/// is counted.
#[test]
fn a_log_truncated_at_any_byte_keeps_its_complete_messages() {
    let options = options("/scan", Some("/pose"));
    for layout in [
        small_chunks(),
        small_chunks().compression(Some(Compression::Lz4)),
        small_chunks().compression(None),
        WriteOptions::new().use_chunks(false),
    ] {
        let whole = write(&planar_log(), layout);
        let (all, _) = ingest_bytes(&whole, &options).unwrap();
        let mut most = 0;
        for cut in 0..whole.len() {
            match ingest_bytes(&whole[..cut], &options) {
                Ok((scans, ingested)) => {
                    assert_eq!(scans[..], all[..scans.len()], "cut at {cut}");
                    let poses = ingested.trajectory.poses();
                    assert!(
                        poses
                            .iter()
                            .zip(0..)
                            .all(|(p, k): (&StampedPose, i64)| p.stamp_ns == k * 100_000_000)
                    );
                    assert!(!ingested.losses.is_empty(), "cut at {cut} is counted");
                    most = most.max(scans.len());
                }
                Err(
                    IngestError::Empty { .. }
                    | IngestError::NotMcap { .. }
                    | IngestError::NoTopic { .. }
                    | IngestError::NoScans { .. }
                    | IngestError::NoPoses { .. },
                ) => {}
                Err(other) => panic!("cut at {cut}: {other}"),
            }
        }
        assert_eq!(most, 10, "a log that lacks only its footer keeps all scans");
    }
}

/// An altered index could hide a chunk. It is not used, and nothing is lost.
#[test]
fn a_damaged_summary_loses_no_data() {
    let whole = write(&planar_log(), small_chunks());
    let options = options("/scan", Some("/pose"));
    let expected = ingest_bytes(&whole, &options).unwrap().0;
    let start = mcap::read::footer(&whole).unwrap().summary_start as usize;
    for at in (start..whole.len() - 8).step_by(3) {
        let mut bytes = whole.clone();
        bytes[at] ^= 1;
        let (scans, ingested) = ingest_bytes(&bytes, &options).unwrap();
        assert_eq!(scans, expected, "byte {at}");
        assert_eq!(codes(&ingested.losses), [("damaged_summary", 1)], "byte {at}");
    }
}

/// Complete messages of a chunk that the end of the file cuts off are kept.
#[test]
fn a_truncated_chunk_gives_its_complete_messages() {
    let whole = write(&packet_log(Encoding::Cdr), WriteOptions::new().compression(None));
    let (scans, ingested) = ingest_bytes(&whole[..300_000], &options("/packets", None)).unwrap();
    // Two complete messages, 200 packets of 12 firings: one revolution and a part.
    assert_eq!((scans.len(), ingested.n_partial_revolutions), (1, 1));
    assert_eq!(ingested.losses.iter().count(), 1);
}

#[test]
fn random_damage_never_panics() {
    let whole = write(&planar_log(), small_chunks());
    let options = options("/scan", Some("/pose"));
    let mut state = 2436u64;
    let mut random = |below: usize| {
        state =
            state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 33) as usize % below
    };
    for _ in 0..1000 {
        let mut bytes = whole.clone();
        for _ in 0..=random(4) {
            let at = random(bytes.len());
            bytes[at] = random(256) as u8;
        }
        if let Ok((scans, _)) = ingest_bytes(&bytes, &options) {
            assert!(scans.len() <= 20);
        }
    }
}

#[test]
fn a_wrong_topic_is_an_error_that_lists_suitable_topics() {
    let message = error(&planar_log(), "/velodyne_points", None);
    assert!(message.contains("drive.mcap has no topic `/velodyne_points`"), "{message}");
    assert!(
        message.contains(
            "set `ingest.lidar.topic` to one of: `/scan` (sensor_msgs/msg/LaserScan, cdr)"
        ),
        "{message}"
    );
    let message = error(&planar_log(), "/scan", Some("/odom"));
    assert!(message.contains("`ingest.pose.topic` to one of: `/pose`"), "{message}");
    let camera = [("/camera", "sensor_msgs/msg/Image", "cdr", vec![1])];
    let message = error(&camera, "/scan", None);
    assert!(
        message.contains(
            "no topic of the log has a suitable type; its topics are `/camera` (sensor_msgs/msg/Image, cdr)"
        ),
        "{message}"
    );
}

#[test]
fn a_wrong_type_or_encoding_is_an_error_that_names_it() {
    let message = error(&planar_log(), "/pose", None);
    assert!(
        message.contains(
            "`/pose` contains `geometry_msgs/msg/PoseStamped, cdr`, expected `VelodyneScan`"
        ),
        "{message}"
    );
    let json = [("/scan", "sensor_msgs/msg/LaserScan", "json", b"{}".to_vec())];
    assert!(error(&json, "/scan", None).contains("`sensor_msgs/msg/LaserScan, json`"));
    let bare = [("/scan", "", "cdr", vec![0, 1, 0, 0])];
    assert!(error(&bare, "/scan", None).contains("`no schema, cdr`"));
}

/// A second channel of the topic without a schema loses only its own messages.
#[test]
fn messages_in_a_channel_of_another_type_are_counted() {
    let mut entries = planar_log();
    entries.push(("/scan", "", "cdr", vec![0, 1, 0, 0]));
    let (scans, ingested) =
        ingest_bytes(&write(&entries, small_chunks()), &options("/scan", None)).unwrap();
    assert_eq!(scans.len(), 10);
    assert_eq!(
        ingested.losses.to_string(),
        "1 message of another type (no schema, cdr) (topic `/scan`)"
    );
}

#[test]
fn a_scan_with_nan_angles_is_counted() {
    let mut entries = planar_log();
    let scan = LaserScan {
        stamp_ns: 5,
        angle_min: f64::NAN,
        angle_max: None,
        angle_increment: 0.5,
        time_increment_s: 0.0,
        range_min: 0.1,
        range_max: 50.0,
        ranges: vec![1.0; 7],
    };
    entries[0].3 = ros::write_laser_scan(Encoding::Cdr, "laser", &scan);
    let (scans, ingested) =
        ingest_bytes(&write(&entries, small_chunks()), &options("/scan", None)).unwrap();
    assert_eq!(scans.len(), 9);
    assert_eq!(codes(&ingested.losses), [("undecodable_messages", 1)]);
}

#[test]
fn undecodable_messages_are_counted() {
    let mut entries = planar_log();
    entries[4].3.truncate(30); // a scan
    entries[5].3.truncate(30); // a pose
    let (scans, ingested) =
        ingest_bytes(&write(&entries, small_chunks()), &options("/scan", Some("/pose"))).unwrap();
    assert_eq!((scans.len(), ingested.trajectory.poses().len()), (9, 9));
    assert_eq!(
        ingested.losses.to_string(),
        "1 message that could not be decoded as LaserScan (malformed) (topic `/scan`), \
         1 message that could not be decoded as PoseStamped (malformed) (topic `/pose`)"
    );
}

#[test]
fn no_poses_and_no_scans_are_errors() {
    let mut entries = planar_log();
    for entry in entries.iter_mut().filter(|entry| entry.0 == "/pose") {
        entry.3.truncate(10);
    }
    let message = error(&entries, "/scan", Some("/pose"));
    assert!(
        message.contains("topic `/pose` has no usable pose (dropped: 10 messages"),
        "{message}"
    );
    let part_of_a_revolution: Vec<Entry> = packet_log(Encoding::Cdr).drain(..1).collect();
    let message = error(&part_of_a_revolution, "/packets", None);
    assert!(
        message
            .contains("`/packets` gives no scan: its packets do not cover a complete revolution"),
        "{message}"
    );
}

#[test]
fn a_file_that_is_not_mcap_is_an_error() {
    for (bytes, expected) in [
        (&b""[..], "drive.mcap is empty"),
        (b"#ROSBAG V2.0", "is not an MCAP file: it starts with 23 52 4f 53"),
    ] {
        let message = ingest_bytes(bytes, &options("/scan", None)).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
    let missing = ingest_file(Path::new("no/such.mcap"), &options("/scan", None)).unwrap_err();
    assert_eq!(missing.to_string(), "cannot read no/such.mcap");
}

#[test]
fn another_sensor_is_an_error_that_names_it() {
    // A VLP-16 whose product byte says HDL-32E. It sends a packet every 1327 us.
    let packets: Vec<_> = (0..300u32)
        .map(|k| {
            let azimuths = std::array::from_fn(|b| ((480 * k + 40 * b as u32) % 36_000) as u16);
            (i64::from(k) * 1_327_104, PacketBuilder::new(azimuths, k * 1327).finish())
        })
        .collect();
    let data = ros::write_velodyne_scan(Encoding::Cdr, "velodyne", 0, &packets);
    let message =
        error(&[("/packets", "velodyne_msgs/msg/VelodyneScan", "cdr", data)], "/packets", None);
    assert!(message.contains("packets of a Velodyne VLP-16 (a packet every 1327 us)"), "{message}");
}
