//! ROS bags, written here as their formats describe them.

#![allow(clippy::unwrap_used, reason = "a test panics if a value is missing")]

use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};

use dataset::Severity;
use import::{Format, ImportError, Options, identify, sniff};
use rusqlite::{Connection, params};

mod common;

use common::Log;

/// A message as it is in the log: topic, type, encoding, definition, log time and bytes.
type Copied = (String, String, String, String, u64, Vec<u8>);

fn copied(log: &[u8]) -> Vec<Copied> {
    let of = |message: mcap::Message<'_>| {
        let schema = message.channel.schema.clone().unwrap();
        (
            message.channel.topic.clone(),
            format!("{} {}", schema.name, schema.encoding),
            message.channel.message_encoding.clone(),
            String::from_utf8(schema.data.to_vec()).unwrap(),
            message.log_time,
            message.data.to_vec(),
        )
    };
    mcap::MessageStream::new(log).unwrap().map(|message| of(message.unwrap())).collect()
}

fn import_all(paths: &[PathBuf], options: &Options) -> Result<(Log, Vec<Copied>), ImportError> {
    let log = common::import_paths_as_they_are(paths, options)?;
    let messages = copied(&log.bytes);
    Ok((log, messages))
}

// ROS 1.

fn record(fields: &[(&str, &[u8])], data: &[u8]) -> Vec<u8> {
    let mut header = Vec::new();
    for (name, value) in fields {
        header.extend((name.len() as u32 + 1 + value.len() as u32).to_le_bytes());
        header.extend(name.as_bytes());
        header.push(b'=');
        header.extend(*value);
    }
    let parts = [&(header.len() as u32).to_le_bytes(), header.as_slice()];
    [parts.concat(), (data.len() as u32).to_le_bytes().to_vec(), data.to_vec()].concat()
}

fn connection(number: u32, topic: &str, message_type: &str, definition: &str) -> Vec<u8> {
    let data = record(
        &[
            ("topic", topic.as_bytes()),
            ("type", message_type.as_bytes()),
            ("md5sum", b"00000000000000000000000000000000"),
            ("message_definition", definition.as_bytes()),
        ],
        &[],
    );
    // The data has the form of a header.
    let n_header = u32::from_le_bytes(*data.first_chunk().unwrap()) as usize;
    let fields: [(&str, &[u8]); 3] =
        [("op", &[7]), ("conn", &number.to_le_bytes()), ("topic", topic.as_bytes())];
    record(&fields, &data[4..4 + n_header])
}

fn message(connection: u32, seconds: u32, ns: u32, data: &[u8]) -> Vec<u8> {
    let time = [seconds.to_le_bytes(), ns.to_le_bytes()].concat();
    record(&[("op", &[2]), ("conn", &connection.to_le_bytes()), ("time", &time)], data)
}

fn chunk(compression: &str, data: &[u8]) -> Vec<u8> {
    let packed = match compression {
        "bz2" => {
            let mut encoder = bzip2::write::BzEncoder::new(Vec::new(), bzip2::Compression::best());
            encoder.write_all(data).unwrap();
            encoder.finish().unwrap()
        }
        "lz4" => {
            let mut encoder = lz4::EncoderBuilder::new().build(Vec::new()).unwrap();
            encoder.write_all(data).unwrap();
            encoder.finish().0
        }
        _ => data.to_vec(),
    };
    let n_bytes = (data.len() as u32).to_le_bytes();
    let fields: [(&str, &[u8]); 3] =
        [("op", &[5]), ("compression", compression.as_bytes()), ("size", &n_bytes)];
    record(&fields, &packed)
}

/// A bag with these chunks, and with an index of these connections if it was closed.
fn bag(chunks: &[Vec<u8>], index: Option<&[Vec<u8>]>) -> Vec<u8> {
    match index {
        Some(connections) => closed_bag(chunks, &[(10, 1), (10, 2), (10, 9)], connections),
        None => [start(0, 0), chunks.concat()].concat(),
    }
}

/// The first line and the header.
fn start(index_at: u64, n_chunks: u32) -> Vec<u8> {
    let fields: [(&str, &[u8]); 3] = [
        ("op", &[3]),
        ("index_pos", &index_at.to_le_bytes()),
        ("chunk_count", &n_chunks.to_le_bytes()),
    ];
    [b"#ROSBAG V2.0\n".to_vec(), record(&fields, &[b' '; 100])].concat()
}

/// A bag with chunks that start at these times [s, ns], and the connections in its index.
fn closed_bag(chunks: &[Vec<u8>], starts: &[(u32, u32)], connections: &[Vec<u8>]) -> Vec<u8> {
    let n_start = start(0, 0).len();
    let n_chunks = chunks.len() as u32;
    let mut index = connections.concat();
    let mut at = n_start as u64;
    for (chunk, (seconds, ns)) in chunks.iter().zip(starts) {
        let time = [seconds.to_le_bytes(), ns.to_le_bytes()].concat();
        let fields: [(&str, &[u8]); 3] =
            [("op", &[6]), ("chunk_pos", &at.to_le_bytes()), ("start_time", &time)];
        index.extend(record(&fields, &[]));
        at += chunk.len() as u64;
    }
    [start(at, n_chunks), chunks.concat(), index].concat()
}

const DEFINITION: &str = "# angle in \u{b0}\nfloat64 data\n";

/// Three chunks, each packed in another way. The last message comes before the one ahead of it.
fn chunks() -> (Vec<Vec<u8>>, Vec<Vec<u8>>) {
    let odom = connection(0, "/odom", "nav_msgs/Odometry", DEFINITION);
    let scan = connection(7, "/scan", "sensor_msgs/LaserScan", "float32[] ranges\n");
    let contents = [
        [odom.clone(), message(0, 10, 1, b"first")].concat(),
        [scan.clone(), message(7, 10, 2, &[9; 100_000]), message(0, 10, 3, b"")].concat(),
        [message(0, 11, 0, b"last"), message(7, 10, 999_999_999, b"before it")].concat(),
    ];
    let packed = ["none", "lz4", "bz2"].iter().zip(&contents);
    (packed.map(|(how, data)| chunk(how, data)).collect(), vec![odom, scan])
}

fn write(folder: &Path, name: &str, content: &[u8]) -> PathBuf {
    let path = folder.join(name);
    std::fs::write(&path, content).unwrap();
    path
}

fn expected() -> Vec<(String, u64, Vec<u8>)> {
    let second = 1_000_000_000;
    [
        ("/odom", 10 * second + 1, b"first".to_vec()),
        ("/scan", 10 * second + 2, vec![9; 100_000]),
        ("/odom", 10 * second + 3, Vec::new()),
        ("/scan", 10 * second + 999_999_999, b"before it".to_vec()),
        ("/odom", 11 * second, b"last".to_vec()),
    ]
    .map(|(topic, ns, data)| (topic.to_owned(), ns, data))
    .into()
}

fn content(messages: &[Copied]) -> Vec<(String, u64, Vec<u8>)> {
    let of = |(topic, .., ns, data): &Copied| (topic.clone(), *ns, data.clone());
    messages.iter().map(of).collect()
}

#[test]
fn messages_of_a_ros_1_bag_are_copied_with_their_definitions() {
    let folder = tempfile::tempdir().unwrap();
    let (chunks, index) = chunks();
    let path = write(folder.path(), "drive.bag", &bag(&chunks, Some(&index)));
    assert_eq!(sniff(&path).unwrap(), Format::Bag);
    let (log, messages) = import_all(std::slice::from_ref(&path), &Options::default()).unwrap();
    assert_eq!(content(&messages), expected());
    let (_, message_type, encoding, definition, ..) = &messages[0];
    assert_eq!((message_type.as_str(), encoding.as_str()), ("nav_msgs/Odometry ros1msg", "ros1"));
    assert_eq!(definition, DEFINITION);
    assert!(log.imported.losses.is_empty(), "{}", log.imported.losses);
    assert_eq!(log.imported.topics.len(), 2);

    let only_scans = Options { select: vec!["/scan".to_owned()], ..Options::default() };
    let (_, scans) = import_all(std::slice::from_ref(&path), &only_scans).unwrap();
    assert_eq!(content(&scans), [expected()[1].clone(), expected()[3].clone()]);
    let unknown = Options { select: vec!["/laser".to_owned()], ..Options::default() };
    let error = import_all(&[path], &unknown).unwrap_err().to_string();
    assert_eq!(error, "no topic /laser; the topics are /odom, /scan");
}

/// The recorder was killed: no index, and the last chunk is incomplete.
#[test]
fn a_bag_that_was_not_closed_keeps_its_complete_chunks() {
    let folder = tempfile::tempdir().unwrap();
    let (chunks, _) = chunks();
    let whole = bag(&chunks, None);
    let path = write(folder.path(), "drive.bag.active", &whole);
    let (log, messages) = import_all(&[path], &Options::default()).unwrap();
    assert!(content(&messages) == expected() && log.imported.losses.is_empty());

    let without_last = whole.len() - chunks[2].len();
    for n_cut in [1, 50, chunks[2].len() - 1] {
        let path = write(folder.path(), "cut.bag", &whole[..whole.len() - n_cut]);
        let (log, messages) = import_all(&[path], &Options::default()).unwrap();
        assert_eq!(content(&messages), expected()[..3], "{n_cut}");
        assert_eq!(log.losses(Severity::Warning), [("truncated_bag", 1)]);
    }
    let path = write(folder.path(), "cut.bag", &whole[..without_last]);
    assert!(import_all(&[path], &Options::default()).unwrap().0.imported.losses.is_empty());
}

#[test]
fn damage_of_a_ros_1_bag_is_counted() {
    let folder = tempfile::tempdir().unwrap();
    let (mut chunks, index) = chunks();
    // Within the packed data of the last chunk: bzip2 has a checksum.
    let middle = chunks[2].len() / 2;
    chunks[2][middle..middle + 4].fill(0xFF);
    let path = write(folder.path(), "a.bag", &bag(&chunks, Some(&index)));
    let (log, messages) = import_all(&[path], &Options::default()).unwrap();
    assert_eq!(log.losses(Severity::Warning), [("damaged_bag_chunks", 1)]);
    assert_eq!(content(&messages), expected()[..3]);

    // A record of an unknown kind ends the bag.
    let (chunks, _) = self::chunks();
    let odd = record(&[("op", &[0x42])], b"what is this");
    let path = write(folder.path(), "b.bag", &bag(&[chunks[0].clone(), odd], None));
    let (log, messages) = import_all(&[path], &Options::default()).unwrap();
    assert_eq!(log.losses(Severity::Warning), [("damaged_bag", 1)]);
    assert_eq!(content(&messages), expected()[..1]);

    // The second chunk has the connection that the third one needs.
    let path = write(folder.path(), "c.bag", &bag(&[chunks[0].clone(), chunks[2].clone()], None));
    let (log, _) = import_all(&[path], &Options::default()).unwrap();
    assert_eq!(log.losses(Severity::Warning), [("messages_without_connection", 1)]);

    for (name, content, found) in [
        ("d.bag", b"#ROSBAG V1.2\n".to_vec(), "found `#ROSBAG V1.2`, expected `#ROSBAG V2.0`"),
        ("e.bag", b"#ROSBAG V2.0\n".to_vec(), "found no record"),
        ("f.bag", bag(&[], None), "nothing to import: found no data, expected messages"),
    ] {
        let path = write(folder.path(), name, &content);
        let error = import_all(&[path], &Options::default()).unwrap_err().to_string();
        assert!(error.contains(found), "{error}");
    }
}

/// The messages of the second topic were written after those of the first one.
#[test]
fn a_bag_that_was_written_topic_by_topic_is_sorted_by_its_index() {
    let folder = tempfile::tempdir().unwrap();
    let odom = connection(0, "/odom", "nav_msgs/Odometry", DEFINITION);
    let scan = connection(1, "/scan", "sensor_msgs/LaserScan", DEFINITION);
    let of = |number: u32, seconds: [u32; 2]| -> Vec<u8> {
        seconds.map(|seconds| message(number, seconds, number, &[number as u8])).concat()
    };
    let chunks = [of(0, [10, 11]), of(0, [12, 13]), of(1, [10, 11]), of(1, [12, 13])];
    let chunks = chunks.map(|data| chunk("none", &data)).to_vec();
    let starts = [(10, 0), (12, 0), (10, 1), (12, 1)];
    let index = [odom, scan];
    let content = closed_bag(&chunks, &starts, &index);
    let path = write(folder.path(), "a.bag", &content);
    let (log, messages) = import_all(&[path], &Options::default()).unwrap();
    let topics: Vec<&str> = messages.iter().map(|message| message.0.as_str()).collect();
    assert_eq!(topics, ["/odom", "/scan"].repeat(4));
    assert!(log.imported.losses.is_empty(), "{}", log.imported.losses);

    // Cut off between the records of the index: only some chunks are listed.
    let path = write(folder.path(), "cut.bag", &content[..content.len() - 20]);
    let (log, messages) = import_all(&[path], &Options::default()).unwrap();
    assert_eq!((messages.len(), log.losses(Severity::Warning)), (8, vec![("truncated_bag", 1)]));
}

/// The index says that the bag is longer, although it ends between two chunks.
#[test]
fn a_closed_bag_that_was_cut_off_between_chunks_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let (chunks, index) = chunks();
    let n_kept = start(0, 0).len() + chunks[0].len();
    let path = write(folder.path(), "cut.bag", &bag(&chunks, Some(&index))[..n_kept]);
    let (log, messages) = import_all(&[path], &Options::default()).unwrap();
    assert_eq!(content(&messages), expected()[..1]);
    assert_eq!(log.losses(Severity::Warning), [("truncated_bag", 1)]);
}

/// The recorder was still writing the last chunk: it has no length, and its records follow.
#[test]
fn messages_of_an_open_chunk_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let (chunks, _) = chunks();
    let open = [chunk("none", b""), message(0, 20, 0, b"late"), message(0, 21, 0, b"cut")].concat();
    let whole = bag(&[chunks[0].clone(), open], None);
    let path = write(folder.path(), "a.bag.active", &whole[..whole.len() - 2]);
    // A closed bag next to it does not know its topics.
    let data =
        [connection(0, "/imu", "sensor_msgs/Imu", "int8 x\n"), message(0, 9, 0, b"x")].concat();
    let closed =
        closed_bag(&[chunk("none", &data)], &[(9, 0)], &[connection(0, "/imu", "a/B", "")]);
    let closed = write(folder.path(), "b.bag", &closed);
    let only_odom = Options { select: vec!["/odom".to_owned()], ..Options::default() };
    let (log, messages) = import_all(&[closed, path], &only_odom).unwrap();
    let data: Vec<&[u8]> = messages.iter().map(|message| message.5.as_slice()).collect();
    assert_eq!(data, [b"first".as_slice(), b"late"]);
    assert_eq!(log.losses(Severity::Warning), [("truncated_bag", 1)]);
}

/// Two bags of one drive, recorded at the same time.
#[test]
fn bags_are_merged_by_time() {
    let folder = tempfile::tempdir().unwrap();
    let (chunks, index) = chunks();
    let imu = connection(0, "/imu", "sensor_msgs/Imu", "float64 x\n");
    let data = [imu, message(0, 10, 2, b"between"), message(0, 12, 0, b"after")].concat();
    let paths = [
        write(folder.path(), "a.bag", &bag(&chunks, Some(&index))),
        write(folder.path(), "b.bag", &bag(&[chunk("none", &data)], None)),
    ];
    let (_, messages) = import_all(&paths, &Options::default()).unwrap();
    let topics: Vec<&str> = messages.iter().map(|message| message.0.as_str()).collect();
    assert_eq!(topics, ["/odom", "/scan", "/imu", "/odom", "/scan", "/odom", "/imu"]);
}

// ROS 2.

/// Writes a database with two topics. `definitions`: with the table of definitions.
fn database(path: &Path, rows: &[(i64, i64, &[u8])], definitions: bool, with_index: bool) {
    let database = Connection::open(path).unwrap();
    database
        .execute_batch(
            "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, \
             serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL); \
             CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, \
             timestamp INTEGER NOT NULL, data BLOB NOT NULL); \
             INSERT INTO topics VALUES (1, '/odom', 'nav_msgs/msg/Odometry', 'cdr', ''), \
             (2, '/odd', 'my_msgs/msg/Odd', 'cdr', '');",
        )
        .unwrap();
    if with_index {
        database.execute("CREATE INDEX timestamp_idx ON messages (timestamp ASC)", []).unwrap();
    }
    if definitions {
        database
            .execute_batch(
                "CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT, \
                 encoding TEXT, encoded_message_definition TEXT, type_description_hash TEXT); \
                 INSERT INTO message_definitions VALUES (1, 'my_msgs/msg/Odd', 'ros2msg', \
                 'int8 odd', '');",
            )
            .unwrap();
    }
    for (topic, ns, data) in rows {
        let insert = "INSERT INTO messages(topic_id, timestamp, data) VALUES (?1, ?2, ?3)";
        database.execute(insert, params![topic, ns, data]).unwrap();
    }
}

fn pack(data: &[u8]) -> Vec<u8> {
    zstd::encode_all(data, 0).unwrap()
}

/// More messages than are read at a time, several of them at the same time, stored in another order.
#[test]
fn messages_of_a_ros_2_bag_are_copied_in_the_order_of_time() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive_0.db3");
    let data: Vec<[u8; 5]> = (0..100).map(|k| [0, 1, 0, 0, k]).collect();
    let rows: Vec<(i64, i64, &[u8])> =
        (0..100).map(|k| (1 + k % 2, 5_000 - 10 * (k / 3), &data[k as usize][..])).collect();
    for (with_index, definitions) in [(true, true), (true, false), (false, true)] {
        let _ = std::fs::remove_file(&path);
        database(&path, &rows, definitions, with_index);
        assert_eq!(sniff(&path).unwrap(), Format::Bag2);
        let (log, messages) = import_all(std::slice::from_ref(&path), &Options::default()).unwrap();
        let mut sorted = rows.clone();
        sorted.sort_by_key(|(_, ns, _)| *ns);
        let bytes = |messages: &[Copied]| messages.iter().map(|m| m.5.clone()).collect::<Vec<_>>();
        let expected: Vec<Vec<u8>> = sorted.iter().map(|row| row.2.to_vec()).collect();
        assert_eq!(bytes(&messages), expected);
        let mut losses: Vec<(&str, u64)> = Vec::new();
        losses.extend((!definitions).then_some(("types_without_definition", 1)));
        let mut found: BTreeMap<&str, u64> = BTreeMap::new();
        for (code, n) in log.losses(Severity::Info) {
            *found.entry(code).or_default() += n;
        }
        assert_eq!(found, losses.into_iter().collect());
        let odom = messages.iter().find(|message| message.0 == "/odom").unwrap();
        assert_eq!((odom.1.as_str(), odom.2.as_str()), ("nav_msgs/msg/Odometry ros2msg", "cdr"));
        assert!(odom.3.contains("geometry_msgs/PoseWithCovariance pose"), "{}", odom.3);
        let odd = messages.iter().find(|message| message.0 == "/odd").unwrap();
        assert_eq!(odd.3, if definitions { "int8 odd" } else { "" });
    }
}

#[test]
fn packed_and_split_ros_2_bags_are_unpacked() {
    let folder = tempfile::tempdir().unwrap();
    let bag = folder.path().join("drive");
    std::fs::create_dir(&bag).unwrap();
    let packed = pack(&[0, 1, 0, 0, 8]);
    database(&bag.join("drive_0.db3"), &[(1, 10, &[0, 1, 0, 0, 7]), (1, 20, &packed)], true, true);
    let second = folder.path().join("second.db3");
    database(
        &second,
        &[(1, 30, &[0, 1, 0, 0, 9]), (2, 40, b"\x28\xB5\x2F\xFDdamaged")],
        true,
        true,
    );
    let content = pack(&std::fs::read(&second).unwrap());
    std::fs::write(bag.join("drive_1.db3.zstd"), &content).unwrap();
    // The description has the name before packing.
    let description = "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: sqlite3\n  \
                       relative_file_paths:\n    - drive_0.db3\n    - drive_1.db3\n";
    std::fs::write(bag.join("metadata.yaml"), description).unwrap();
    assert_eq!(sniff(&bag).unwrap(), Format::Bag2);
    let scratch = folder.path().join("scratch");
    std::fs::create_dir(&scratch).unwrap();
    let options = Options { scratch: Some(scratch.clone()), ..Options::default() };
    let (log, messages) = import_all(std::slice::from_ref(&bag), &options).unwrap();
    let last: Vec<u8> = messages.iter().map(|message| *message.5.last().unwrap()).collect();
    assert_eq!(last, [7, 8, 9]);
    assert_eq!(log.losses(Severity::Warning), [("damaged_messages", 1)]);
    assert!(std::fs::read_dir(&scratch).unwrap().next().is_none(), "unpacked files are deleted");

    std::fs::remove_file(bag.join("drive_1.db3.zstd")).unwrap();
    let error = import_all(std::slice::from_ref(&bag), &options).unwrap_err().to_string();
    assert!(error.contains("cannot read") && error.contains("drive_1.db3"), "{error}");
    std::fs::write(bag.join("metadata.yaml"), "a: 1\n").unwrap();
    let error = import_all(&[bag], &options).unwrap_err().to_string();
    assert!(error.contains("metadata.yaml") && error.contains("relative_file_paths"), "{error}");
}

fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).unwrap();
    let mut names: Vec<String> =
        entries.map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    names
}

/// A bag that was played has its unpacked file next to the packed one. Descriptions of old versions name files from the folder
/// around the bag. A database with a write-ahead log is read without writing next to it.
#[test]
fn each_file_of_a_ros_2_bag_is_read_once_and_nothing_is_written_next_to_it() {
    let root = tempfile::tempdir().unwrap();
    let bag = root.path().join("drive");
    std::fs::create_dir(&bag).unwrap();
    let path = bag.join("drive_0.db3");
    database(&path, &[(1, 10, &[0, 1, 0, 0, 7])], true, true);
    let journal: String = Connection::open(&path)
        .unwrap()
        .query_row("PRAGMA journal_mode = WAL", [], |row| row.get(0))
        .unwrap();
    assert_eq!(journal, "wal");
    std::fs::write(bag.join("drive_0.db3.zstd"), pack(&std::fs::read(&path).unwrap())).unwrap();
    std::fs::write(bag.join("drive_1.db3"), b"").unwrap();
    let description = |name: &str| {
        let text = format!("rosbag2_bagfile_information:\n  relative_file_paths: [{name}]\n");
        std::fs::write(bag.join("metadata.yaml"), text).unwrap();
    };
    for name in ["drive_0.db3", "drive_0.db3.zstd", "drive/drive_0.db3", "drive/drive_0.db3.zstd"] {
        description(name);
        let before = names(&bag);
        let (log, messages) = import_all(std::slice::from_ref(&bag), &Options::default()).unwrap();
        assert_eq!(messages.len(), 1, "{name}");
        assert_eq!(log.losses(Severity::Warning), [("truncated_bag", 1)], "the empty file");
        assert_eq!(names(&bag), before);
    }
    std::fs::remove_file(bag.join("metadata.yaml")).unwrap();
    assert_eq!(import_all(&[bag], &Options::default()).unwrap().1.len(), 1);
}

/// The index of the times is damaged, and so is one row.
#[test]
fn messages_of_a_damaged_database_are_counted() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive_0.db3");
    let large = vec![0; 50_000];
    let rows: Vec<(i64, i64, &[u8])> = (0..40).map(|k| (1, 100 * k, &large[..])).collect();
    database(&path, &rows, true, true);
    let insert = "INSERT INTO messages(topic_id, timestamp, data) VALUES (1, 5000, 'text')";
    Connection::open(&path).unwrap().execute(insert, []).unwrap();
    let (log, messages) = import_all(std::slice::from_ref(&path), &Options::default()).unwrap();
    assert_eq!(
        (messages.len(), log.losses(Severity::Warning)),
        (40, vec![("damaged_messages", 1)])
    );

    let whole = std::fs::read(&path).unwrap();
    for n_kept in [whole.len() * 9 / 10, whole.len() / 2] {
        std::fs::write(&path, &whole[..n_kept]).unwrap();
        match import_all(std::slice::from_ref(&path), &Options::default()) {
            Ok((log, messages)) => {
                assert!(
                    messages.len() == 40 || !log.losses(Severity::Warning).is_empty(),
                    "{n_kept}"
                );
            }
            Err(error) => assert!(error.to_string().contains("copy the file again"), "{error}"),
        }
    }
}

#[test]
fn a_database_that_is_not_a_bag_is_an_error_that_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("other.db3");
    Connection::open(&path).unwrap().execute("CREATE TABLE cats(name TEXT)", []).unwrap();
    let error =
        import_all(std::slice::from_ref(&path), &Options::default()).unwrap_err().to_string();
    assert!(error.contains("no such table: topics") && error.contains("of a ROS 2 bag"), "{error}");
    let recording = identify(&path).unwrap();
    assert!(recording.remedy.contains("loopboost import"), "{}", recording.remedy);

    let carmen = write(folder.path(), "a.log", b"ODOM 0 0 0 0 0 0 1.0 h 0\n");
    let topics = Options { select: vec!["/odom".to_owned()], ..Options::default() };
    let error = common::import_paths(&[carmen], &topics).unwrap_err().to_string();
    assert_eq!(error, "a CARMEN log has no topics to select; leave out `--topic`");
}
