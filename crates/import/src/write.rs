//! Records -> an MCAP file.

use std::collections::BTreeMap;
use std::io::{Seek, Write};
use std::path::PathBuf;

use mcap::records::{MessageHeader, Metadata};
use mcap::{WriteOptions, Writer};
use messages::{Encoding, schemas};

use crate::encode::{encode, message_type};
use crate::options::{Topic, Topics};
use crate::record::{Losses, Record, representable};
use crate::{Compression, Format, ImportError, Imported, Options, file_name};

/// Uncompressed size of a chunk, about \[bytes\].
const CHUNK_BYTES: u64 = 1 << 20;
/// Zstandard's own default.
const ZSTD_LEVEL: u32 = 3;

/// A topic that was written.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct ImportedTopic {
    /// Its name.
    pub topic: String,
    /// Its type, as `sensor_msgs/msg/LaserScan`.
    pub message_type: String,
    /// How many messages there are.
    pub n_messages: u64,
}

/// The log under construction.
pub(crate) struct LogWriter<W: Write + Seek> {
    writer: Writer<W>,
    format: Format,
    topics: Topics,
    channels: BTreeMap<Topic, Channel>,
    /// Log times of the first and the last message.
    range_ns: Option<(i64, i64)>,
}

struct Channel {
    id: u16,
    message_type: &'static str,
    n_messages: u64,
}

impl<W: Write + Seek> LogWriter<W> {
    pub fn new(
        out: W,
        format: Format,
        files: &[PathBuf],
        options: &Options,
    ) -> Result<Self, ImportError> {
        let (compression, level) = match options.compression {
            Compression::Zstd => (Some(mcap::Compression::Zstd), ZSTD_LEVEL),
            Compression::Lz4 => (Some(mcap::Compression::Lz4), 0),
            Compression::None => (None, 0),
        };
        let mut writer = WriteOptions::new()
            .profile("ros2")
            .library("loopboost import")
            .compression(compression)
            .compression_level(level)
            // With threads of its own Zstandard cuts the input, and gives other bytes.
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
        Ok(Self {
            writer,
            format,
            topics: options.topics.clone(),
            channels: BTreeMap::new(),
            range_ns: None,
        })
    }

    /// Writes one message. Its log time is its stamp, or that of the message before if that is
    /// later: a log is read by its log times.
    pub fn write(&mut self, record: &Record, losses: &mut Losses) -> Result<(), ImportError> {
        debug_assert!(representable(record.stamp_ns), "readers count what is not");
        let (start_ns, latest_ns) = self.range_ns.unwrap_or((record.stamp_ns, record.stamp_ns));
        let log_ns = record.stamp_ns.max(latest_ns);
        if record.stamp_ns < log_ns {
            let reason = "messages whose time steps back (logged at the time of the one before)";
            losses.remarks.add(reason, 1);
        }
        self.range_ns = Some((start_ns, log_ns));

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
                .expect("every type that is written has a ROS 2 schema");
            let id =
                self.writer.add_schema(schema.name, schema.encoding, schema.text.as_bytes())?;
            let name = self.topics.name(topic);
            let id = self.writer.add_channel(id, name, "cdr", &BTreeMap::new())?;
            let channel = Channel { id, message_type: schema.name, n_messages: 0 };
            self.channels.insert(topic, channel);
        }
        Ok(self.channels.get_mut(&topic).expect("the channel was just made"))
    }

    /// Ends the file. A recording of which nothing was used is an error.
    pub fn finish(mut self, files: &[PathBuf], losses: Losses) -> Result<Imported, ImportError> {
        let Losses { dropped, remarks } = losses;
        let Some((start_ns, end_ns)) = self.range_ns else {
            let names: Vec<_> = files.iter().map(|path| path.display().to_string()).collect();
            let found = match (dropped.is_empty(), remarks.is_empty()) {
                (true, true) => "nothing at all".to_owned(),
                (true, false) => remarks.to_string(),
                (false, true) => dropped.to_string(),
                (false, false) => format!("{dropped}, {remarks}"),
            };
            let expected = match self.format {
                Format::Pcap => {
                    "UDP datagrams of 1206 bytes to the sensor's data port (2368 unless \
                     `udp_port` says otherwise) from the chosen sensor"
                }
                Format::Nclt => "packets of hits, or rows of numbers",
                Format::Carmen => "FLASER, RLASER, ROBOTLASER1, ODOM or TRUEPOS lines",
            };
            return Err(ImportError::Empty { inputs: names.join(", "), found, expected });
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
        Ok(Imported { format: self.format, topics, start_ns, end_ns, dropped, remarks })
    }
}
