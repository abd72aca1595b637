//! Copies the messages of ROS bags to an MCAP log, as they are.
//!
//! Only the container changes: topics, types, definitions and the bytes of the messages stay. So everything that
//! `ingest` reads from logs of ROS 1 and ROS 2, it also reads from bags.

mod ros1;
mod ros2;

use std::collections::{BTreeMap, BTreeSet};
use std::io::{Seek, Write};
use std::path::PathBuf;

use dataset::{Loss, LossKind, Losses, Subject};
use mcap::Writer;
use mcap::records::MessageHeader;

use crate::error::ImportError;
use crate::format::Format;
use crate::input::Meter;
use crate::options::Options;
use crate::write::{Imported, ImportedTopic, LogTimes, create_log, nothing_to_import};
pub(crate) use ros2::{bag_files, is_bag_folder, is_packed};

/// What the messages of a topic are.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord)]
struct Connection {
    topic: String,
    /// For example `sensor_msgs/LaserScan` or `sensor_msgs/msg/LaserScan`.
    message_type: String,
    /// Encoding of the messages: `ros1` or `cdr`.
    encoding: String,
    /// Encoding of the definition: `ros1msg`, `ros2msg` or `ros2idl`.
    definition_encoding: String,
    /// Definition of the message type. Empty if the bag has none.
    definition: Vec<u8>,
    metadata: BTreeMap<String, String>,
}

/// A message of a bag.
struct Message {
    /// Index of its connection.
    connection: usize,
    /// When it was recorded \[ns since the epoch\].
    stamp_ns: i64,
    data: Vec<u8>,
}

/// A reader of one bag, in the order of time.
trait Bag {
    /// Whether all topics are known before the messages are read.
    fn knows_topics(&self) -> bool;

    /// The connections found so far.
    fn connections(&self) -> &[Connection];

    /// A time \[ns since the epoch\]. No message that was not read yet is earlier. `None` at the end of the bag.
    fn peek(&mut self, losses: &mut Losses) -> Result<Option<i64>, ImportError>;

    /// The message at the time of `peek`. `None` if there is none, if it cannot be read, or if its topic is not selected.
    fn next(&mut self, losses: &mut Losses) -> Result<Option<Message>, ImportError>;
}

fn topics(bags: &[Box<dyn Bag>]) -> BTreeSet<String> {
    bags.iter().flat_map(|bag| bag.connections()).map(|of| of.topic.clone()).collect()
}

/// The topics to import.
#[derive(Clone)]
struct Selection(Vec<String>);

impl Selection {
    fn contains(&self, topic: &str) -> bool {
        self.0.is_empty() || self.0.iter().any(|selected| selected == topic)
    }

    /// An error if a selected topic does not exist.
    fn check(&self, topics: &BTreeSet<String>) -> Result<(), ImportError> {
        let missing = self.0.iter().filter(|topic| !topics.contains(*topic));
        let missing: Vec<&str> = missing.map(String::as_str).collect();
        if missing.is_empty() {
            return Ok(());
        }
        let found: Vec<&str> = topics.iter().map(String::as_str).collect();
        Err(ImportError::NoTopic { missing: missing.join(", "), found: found.join(", ") })
    }
}

/// Copies the selected topics of bags to a log. Bags are merged by time.
pub(crate) fn import(
    format: Format,
    files: &[PathBuf],
    options: &Options,
    out: impl Write + Seek,
    meter: &Meter,
    progress: impl Fn(u64),
) -> Result<Imported, ImportError> {
    let selection = Selection(options.select.clone());
    let mut losses = Losses::default();
    let mut bags = open(format, files, options, &selection, meter)?;
    if bags.iter().all(|bag| bag.knows_topics()) {
        selection.check(&topics(&bags))?;
    }
    let mut log = Log::new(create_log(out, format, files, options)?, bags.len());
    let mut stamps = Vec::with_capacity(bags.len());
    for bag in &mut bags {
        stamps.push(bag.peek(&mut losses)?);
    }
    while let Some(earliest) = crate::earliest(stamps.iter().copied()) {
        let bag = &mut bags[earliest];
        if let Some(message) = bag.next(&mut losses)? {
            let connection = &bag.connections()[message.connection];
            log.write(earliest, connection, &message, &mut losses)?;
        }
        stamps[earliest] = bag.peek(&mut losses)?;
        progress(meter.bytes());
    }
    progress(meter.bytes());
    selection.check(&topics(&bags))?;
    log.finish(format, files, losses)
}

fn open(
    format: Format,
    files: &[PathBuf],
    options: &Options,
    selection: &Selection,
    meter: &Meter,
) -> Result<Vec<Box<dyn Bag>>, ImportError> {
    let mut bags: Vec<Box<dyn Bag>> = Vec::new();
    for path in files {
        bags.push(match format {
            Format::Bag => Box::new(ros1::File::open(path, selection, meter)?),
            _ => Box::new(ros2::File::open(path, options, selection, meter)?),
        });
    }
    Ok(bags)
}

/// The log that is written.
struct Log<W: Write + Seek> {
    writer: Writer<W>,
    /// The channel of each connection of each bag.
    of_bags: Vec<BTreeMap<usize, u16>>,
    channels: BTreeMap<Connection, u16>,
    n_messages: BTreeMap<u16, u64>,
    times: LogTimes,
}

impl<W: Write + Seek> Log<W> {
    fn new(writer: Writer<W>, n_bags: usize) -> Self {
        let of_bags = vec![BTreeMap::new(); n_bags];
        Self {
            writer,
            of_bags,
            channels: BTreeMap::new(),
            n_messages: BTreeMap::new(),
            times: LogTimes::default(),
        }
    }

    /// Writes a message. As for other recordings, the log time never steps back.
    fn write(
        &mut self,
        bag: usize,
        connection: &Connection,
        message: &Message,
        losses: &mut Losses,
    ) -> Result<(), ImportError> {
        let stamp_ns = message.stamp_ns;
        let log_ns = self.times.next(stamp_ns, &connection.topic, losses);
        let channel = match self.of_bags[bag].get(&message.connection) {
            Some(&channel) => channel,
            None => {
                let channel = self.channel(connection, losses)?;
                self.of_bags[bag].insert(message.connection, channel);
                channel
            }
        };
        let n_messages = self.n_messages.entry(channel).or_default();
        let header = MessageHeader {
            channel_id: channel,
            sequence: *n_messages as u32,
            log_time: log_ns as u64,
            publish_time: stamp_ns as u64,
        };
        *n_messages += 1;
        self.writer.write_to_known_channel(&header, &message.data)?;
        Ok(())
    }

    fn channel(
        &mut self,
        connection: &Connection,
        losses: &mut Losses,
    ) -> Result<u16, ImportError> {
        if let Some(&channel) = self.channels.get(connection) {
            return Ok(channel);
        }
        let Connection { topic, message_type, encoding, definition_encoding, definition, metadata } =
            connection;
        if definition.is_empty() {
            let kind = LossKind::TypesWithoutDefinition { message_type: message_type.clone() };
            losses.add(Loss::new(kind, Subject::topic(topic)), 1);
        }
        let schema = self.writer.add_schema(message_type, definition_encoding, definition)?;
        let channel = self.writer.add_channel(schema, topic, encoding, metadata)?;
        self.channels.insert(connection.clone(), channel);
        Ok(channel)
    }

    fn finish(
        mut self,
        format: Format,
        files: &[PathBuf],
        losses: Losses,
    ) -> Result<Imported, ImportError> {
        let Some((start_ns, end_ns)) = self.times.range_ns else {
            return Err(nothing_to_import(format, files, &losses));
        };
        self.writer.finish()?;
        let mut topics: BTreeMap<(&str, &str), u64> = BTreeMap::new();
        for (connection, channel) in &self.channels {
            let key = (connection.topic.as_str(), connection.message_type.as_str());
            *topics.entry(key).or_default() += self.n_messages.get(channel).copied().unwrap_or(0);
        }
        let topics = topics.into_iter().map(|((topic, message_type), n_messages)| ImportedTopic {
            topic: topic.to_owned(),
            message_type: message_type.to_owned(),
            n_messages,
        });
        let topics = topics.collect();
        Ok(Imported { format, topics, start_ns, end_ns, losses, notes: Vec::new() })
    }
}
