//! Channels that a file does not define, or defines twice. The files are written byte by byte, because
//! no writer makes them.

#![allow(clippy::unwrap_used, reason = "a test panics if a value is missing")]

mod common;

use std::path::Path;

use common::{codes, options, planar, pose};
use dataset::Scan;
use ingest::{IngestError, Ingested, Log, Survey, survey};
use mcap::records::op;
use messages::Encoding;

fn record(opcode: u8, body: &[u8]) -> Vec<u8> {
    [&[opcode][..], &(body.len() as u64).to_le_bytes(), body].concat()
}

fn text(text: &str) -> Vec<u8> {
    [&(text.len() as u32).to_le_bytes()[..], text.as_bytes()].concat()
}

fn schema(id: u16, name: &str) -> Vec<u8> {
    record(op::SCHEMA, &[&id.to_le_bytes()[..], &text(name), &text("ros2msg"), &text("")].concat())
}

fn channel(id: u16, schema: u16, topic: &str) -> Vec<u8> {
    let ids = [id.to_le_bytes(), schema.to_le_bytes()].concat();
    record(op::CHANNEL, &[&ids[..], &text(topic), &text("cdr"), &[0; 4]].concat())
}

fn message(channel: u16, k: i64, data: &[u8]) -> Vec<u8> {
    let time = (k as u64 * 100_000_000).to_le_bytes();
    record(op::MESSAGE, &[&channel.to_le_bytes()[..], &[0; 4], &time, &time, data].concat())
}

fn chunk(records: &[u8]) -> Vec<u8> {
    let size = (records.len() as u64).to_le_bytes();
    record(op::CHUNK, &[&[0; 16], &size[..], &[0; 4], &text(""), &size, records].concat())
}

/// A file without a summary.
fn file(data: &[Vec<u8>]) -> Vec<u8> {
    let header = record(op::HEADER, &[text("ros2"), text("test")].concat());
    let end = [record(op::DATA_END, &[0; 4]), record(op::FOOTER, &[0; 20])].concat();
    [mcap::MAGIC.to_vec(), header, data.concat(), end, mcap::MAGIC.to_vec()].concat()
}

const LASER_SCAN: &str = "sensor_msgs/msg/LaserScan";
const POSE: &str = "geometry_msgs/msg/PoseStamped";

fn definitions() -> Vec<u8> {
    [schema(1, LASER_SCAN), schema(2, POSE), channel(1, 1, "/scan"), channel(2, 2, "/pose")]
        .concat()
}

/// Scans on channel 1 and poses on channel 2; every fifth message is on channel `stray`.
fn messages(stray: u16) -> Vec<Vec<u8>> {
    (0..10)
        .flat_map(|k| {
            let of = |channel| if k % 5 == 4 { stray } else { channel };
            [message(of(1), k, &planar(k, Encoding::Cdr)), message(2, k, &pose(k, Encoding::Cdr))]
        })
        .collect()
}

fn read(bytes: &[u8]) -> (Result<Ingested, IngestError>, Survey) {
    let log = Log::from_bytes(Path::new("drive.mcap"), bytes.to_owned()).unwrap();
    let take = |_: Vec<Scan>| Ok::<_, IngestError>(());
    let ingested = ingest::ingest(&[&log], &options("/scan", Some("/pose")), take, |_| ());
    (ingested, survey(&[&log], |_| ()))
}

#[test]
fn messages_of_an_undefined_channel_are_counted_by_ingest_and_survey() {
    let loose = file(&[definitions(), messages(9).concat()]);
    let chunked = file(&[chunk(&[definitions(), messages(9).concat()].concat())]);
    for bytes in [loose, chunked] {
        let (ingested, survey) = read(&bytes);
        let ingested = ingested.unwrap();
        assert_eq!(ingested.n_scans, 8);
        assert_eq!(codes(&ingested.losses), [("undefined_channel", 2)]);
        assert_eq!(codes(&survey.losses), [("undefined_channel", 2)]);
    }
}

/// Two files of one recorder, joined byte by byte: the second uses the ids for other topics.
#[test]
fn a_channel_that_is_defined_twice_is_an_error_that_names_both_topics() {
    let second = [schema(1, LASER_SCAN), channel(2, 1, "/rear_scan")].concat();
    let rear: Vec<u8> = (10..15).flat_map(|k| message(2, k, &planar(k, Encoding::Cdr))).collect();
    let first = [definitions(), messages(1).concat()].concat();
    let loose = file(&[first.clone(), second.clone(), rear.clone()]);
    let chunked = file(&[chunk(&first), chunk(&[second, rear].concat())]);
    for bytes in [loose, chunked] {
        let (ingested, survey) = read(&bytes);
        let error = ingested.unwrap_err();
        assert_eq!(error.code(), "redefined_channel");
        let expected = "channel 2 twice, as `/pose` (geometry_msgs/msg/PoseStamped, cdr) and as \
                        `/rear_scan` (sensor_msgs/msg/LaserScan, cdr)";
        assert!(error.to_string().contains(expected), "{error}");
        let redefined = codes(&survey.losses);
        assert!(redefined.contains(&("redefined_channels", 1)), "{redefined:?}");
    }
}

/// The same topic with another type is a contradiction too. An unrelated channel is only a loss.
#[test]
fn another_type_is_a_contradiction_and_another_topic_a_loss() {
    let first = [definitions(), messages(1).concat()].concat();
    let retyped = [schema(3, "std_msgs/msg/String"), channel(1, 3, "/scan")].concat();
    let (ingested, _) = read(&file(&[first.clone(), retyped]));
    assert_eq!(ingested.unwrap_err().code(), "redefined_channel");

    let unrelated = [
        schema(3, "std_msgs/msg/String"),
        channel(7, 3, "/a"),
        channel(7, 3, "/b"),
        channel(1, 1, "/scan"),
    ];
    let (ingested, survey) = read(&file(&[first, unrelated.concat()]));
    assert_eq!(codes(&ingested.unwrap().losses), [("redefined_channels", 1)]);
    assert_eq!(codes(&survey.losses), [("redefined_channels", 1)]);
}

#[test]
fn a_log_that_is_truncated_or_written_after_it_was_opened_is_an_error_with_its_name() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.mcap");
    let bytes = file(&[definitions(), messages(1).concat()]);
    let ingest = |log: &Log| {
        let take = |_: Vec<Scan>| Ok::<_, IngestError>(());
        ingest::ingest(&[log], &options("/scan", Some("/pose")), take, |_| ())
    };
    for n_bytes in [0, 5, bytes.len() / 2, bytes.len() + 1] {
        std::fs::write(&path, &bytes).unwrap();
        let log = Log::open(&path).unwrap();
        assert!(ingest(&log).is_ok() && log.check_unchanged().is_ok());
        let file = std::fs::File::options().write(true).open(&path).unwrap();
        file.set_len(n_bytes as u64).unwrap();
        let error = ingest(&log).unwrap_err();
        assert_eq!(error.code(), "changed_while_read");
        assert!(error.to_string().contains("drive.mcap was changed while it was read: its size"));
        let _ = survey(&[&log], |_| ());
        assert!(log.check_unchanged().is_err());
    }
}
