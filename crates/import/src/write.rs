//! Writes records to an MCAP file.

use std::collections::BTreeMap;
use std::io::{Seek, Write};
use std::path::PathBuf;

use dataset::{Loss, LossKind, Losses, Note, Subject};
use mcap::records::{MessageHeader, Metadata};
use mcap::{WriteOptions, Writer};
use messages::{Encoding, schemas};

use crate::encode::{encode, message_type};
use crate::error::ImportError;
use crate::format::Format;
use crate::input::file_name;
use crate::options::{Compression, Options, Topic, Topics};
use crate::record::{Record, is_representable};

/// The approximate uncompressed size of a chunk \[bytes\].
const CHUNK_BYTES: u64 = 1 << 20;
/// The default of Zstandard.
const ZSTD_LEVEL: u32 = 3;

/// The result of an import.
#[derive(Debug, Clone, PartialEq)]
pub struct Imported {
    /// The format of the recording.
    pub format: Format,
    /// The topics of the log with their types and numbers of messages, sorted by name.
    pub topics: Vec<ImportedTopic>,
    /// Log time of the first message \[ns since the epoch\].
    pub start_ns: i64,
    /// Log time of the last message \[ns since the epoch\].
    pub end_ns: i64,
    /// Data that was not imported, by kind and file. Kinds of severity `Warning` are sensor data
    /// that could not be used. Kinds of severity `Info` are harmless, for example other traffic in a
    /// capture, lines without sensor data, or stamps that step back.
    pub losses: Losses,
    /// Remarks about data that was imported.
    pub notes: Vec<Note>,
}

/// A topic of the log.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ImportedTopic {
    /// The name of the topic.
    pub topic: String,
    /// The type of its messages, for example `sensor_msgs/msg/LaserScan`.
    pub message_type: String,
    /// The number of messages.
    pub n_messages: u64,
}

/// Writes a log message by message.
pub(crate) struct LogWriter<W: Write + Seek> {
    writer: Writer<W>,
    format: Format,
    topics: Topics,
    channels: BTreeMap<Topic, Channel>,
    times: LogTimes,
}

/// The log times of messages, which never step back, because readers expect increasing log times.
#[derive(Default)]
pub(crate) struct LogTimes {
    /// Log times of the first and the last message \[ns since the epoch\].
    pub(crate) range_ns: Option<(i64, i64)>,
}

impl LogTimes {
    /// The log time of the next message: its stamp, or the log time of the previous message if that is later.
    pub(crate) fn next(&mut self, stamp_ns: i64, topic: &str, losses: &mut Losses) -> i64 {
        let (start_ns, latest_ns) = self.range_ns.unwrap_or((stamp_ns, stamp_ns));
        let log_ns = stamp_ns.max(latest_ns);
        if stamp_ns < log_ns {
            losses.add(Loss::new(LossKind::MessageTimesStepBack, Subject::topic(topic)), 1);
        }
        self.range_ns = Some((start_ns, log_ns));
        log_ns
    }
}

struct Channel {
    id: u16,
    message_type: &'static str,
    n_messages: u64,
}

/// Creates a log, and writes what it was made from.
pub(crate) fn create_log<W: Write + Seek>(
    out: W,
    format: Format,
    files: &[PathBuf],
    options: &Options,
) -> Result<Writer<W>, ImportError> {
    let (compression, level) = match options.compression {
        Compression::Zstd => (Some(mcap::Compression::Zstd), ZSTD_LEVEL),
        Compression::Lz4 => (Some(mcap::Compression::Lz4), 0),
        Compression::None => (None, 0),
    };
    let mut writer = WriteOptions::new()
        .profile(if format == Format::Bag { "ros1" } else { "ros2" })
        .library("loopboost import")
        .compression(compression)
        .compression_level(level)
        // With threads, Zstandard splits its input, and the output has other bytes.
        .compression_threads(0)
        .chunk_size(Some(CHUNK_BYTES))
        .create(out)?;
    let names: Vec<_> = files.iter().map(|path| file_name(path)).collect();
    writer.write_metadata(&Metadata {
        name: "import".to_owned(),
        metadata: [("format", format.name().to_owned()), ("files", names.join(", "))]
            .map(|(key, value)| (key.to_owned(), value))
            .into(),
    })?;
    Ok(writer)
}

/// The error of a recording without a message.
pub(crate) fn nothing_to_import(format: Format, files: &[PathBuf], losses: &Losses) -> ImportError {
    let names: Vec<_> = files.iter().map(|path| path.display().to_string()).collect();
    let found = match losses.is_empty() {
        true => "no data".to_owned(),
        false => losses.to_string(),
    };
    let expected = match format {
        Format::Pcap => {
            "UDP datagrams of 1206 bytes from the selected sensor to its data port (2368, or the port \
             given by `--udp-port`); set `--udp-port` to the port of the sensor"
        }
        Format::Nclt => "packets of velodyne_hits.bin, or rows of numbers",
        Format::Carmen => "FLASER, RLASER, ROBOTLASER, RAWLASER, ODOM or TRUEPOS lines",
        Format::Bag | Format::Bag2 => "messages",
    };
    ImportError::Empty { inputs: names.join(", "), found, expected }
}

impl<W: Write + Seek> LogWriter<W> {
    pub fn new(
        out: W,
        format: Format,
        files: &[PathBuf],
        options: &Options,
    ) -> Result<Self, ImportError> {
        let writer = create_log(out, format, files, options)?;
        Ok(Self {
            writer,
            format,
            topics: options.topics.clone(),
            channels: BTreeMap::new(),
            times: LogTimes::default(),
        })
    }

    /// Writes one message.
    pub fn write(&mut self, record: &Record, losses: &mut Losses) -> Result<(), ImportError> {
        debug_assert!(is_representable(record.stamp_ns), "readers drop other times");
        let log_ns = self.times.next(record.stamp_ns, self.topics.name(record.topic), losses);
        let channel = self.channel(record.topic)?;
        let header = MessageHeader {
            channel_id: channel.id,
            sequence: channel.n_messages as u32,
            log_time: log_ns as u64,
            publish_time: record.stamp_ns as u64,
        };
        channel.n_messages += 1;
        self.writer.write_to_known_channel(&header, &encode(record))?;
        Ok(())
    }

    fn channel(&mut self, topic: Topic) -> Result<&mut Channel, ImportError> {
        if !self.channels.contains_key(&topic) {
            let schema = schemas::of(message_type(topic), Encoding::Cdr)
                .expect("every message type of an import has a ROS 2 schema");
            let id =
                self.writer.add_schema(schema.name, schema.encoding, schema.text.as_bytes())?;
            let name = self.topics.name(topic);
            let id = self.writer.add_channel(id, name, "cdr", &BTreeMap::new())?;
            let channel = Channel { id, message_type: schema.name, n_messages: 0 };
            self.channels.insert(topic, channel);
        }
        Ok(self.channels.get_mut(&topic).expect("the channel was just inserted"))
    }

    /// Finishes the file. It is an error if no message was written.
    pub fn finish(
        mut self,
        files: &[PathBuf],
        losses: Losses,
        notes: Vec<Note>,
    ) -> Result<Imported, ImportError> {
        let Some((start_ns, end_ns)) = self.times.range_ns else {
            return Err(nothing_to_import(self.format, files, &losses));
        };
        self.writer.finish()?;
        let mut topics: Vec<_> = self
            .channels
            .iter()
            .map(|(&topic, channel)| ImportedTopic {
                topic: self.topics.name(topic).to_owned(),
                message_type: channel.message_type.to_owned(),
                n_messages: channel.n_messages,
            })
            .collect();
        topics.sort_by(|a, b| a.topic.cmp(&b.topic));
        Ok(Imported { format: self.format, topics, start_ns, end_ns, losses, notes })
    }
}
