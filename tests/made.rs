//! Logs made in a test, and what the program reads from them.

use std::borrow::Cow;
use std::collections::BTreeMap;
use std::fs;
use std::io::Cursor;
use std::sync::Arc;

use dataset::Scan;

use crate::real_logs::scans;
use crate::support::{Finished, Workplace};
use crate::wire::Encoding;

/// A message of a log.
#[derive(Debug, Clone)]
pub struct Message {
    pub topic: &'static str,
    /// As in ROS 1, for example `sensor_msgs/LaserScan`, or as Foxglove names it.
    pub type_name: &'static str,
    pub encoding: Encoding,
    pub stamp_ns: i64,
    pub data: Vec<u8>,
}

/// The schema of a log's channels.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Schema {
    /// Its text is empty.
    Empty,
    /// Its text ends in the middle of a line.
    Truncated,
    /// The channel has none.
    Missing,
}

pub const SCHEMAS: [Schema; 3] = [Schema::Empty, Schema::Truncated, Schema::Missing];

/// Writes messages into an MCAP log.
pub fn log(messages: &[Message], schema: Schema) -> Vec<u8> {
    let options = mcap::WriteOptions::new().chunk_size(Some(100_000));
    let mut writer = options.create(Cursor::new(Vec::new())).unwrap();
    let mut channels: BTreeMap<&str, Arc<mcap::Channel<'_>>> = BTreeMap::new();
    for message in messages {
        let id = channels.len() as u16 + 1;
        let channel = channels.entry(message.topic).or_insert_with(|| {
            let text: &[u8] = match schema {
                Schema::Truncated => b"std_msgs/Header header\nfloat64 x\nflo",
                Schema::Empty | Schema::Missing => b"",
            };
            let of_channel = mcap::Schema {
                id,
                name: message.encoding.schema_name(message.type_name),
                encoding: message.encoding.schema_encoding().to_owned(),
                data: Cow::Borrowed(text),
            };
            Arc::new(mcap::Channel {
                id,
                topic: message.topic.to_owned(),
                schema: (schema != Schema::Missing).then(|| Arc::new(of_channel)),
                message_encoding: message.encoding.name().to_owned(),
                metadata: BTreeMap::new(),
            })
        });
        let message = mcap::Message {
            channel: channel.clone(),
            sequence: 0,
            log_time: message.stamp_ns as u64,
            publish_time: message.stamp_ns as u64,
            data: Cow::Borrowed(&message.data),
        };
        writer.write(&message).unwrap();
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

/// Logs to ingest in one run, by name.
#[derive(Default)]
pub struct Logs {
    logs: BTreeMap<String, Vec<u8>>,
}

impl Logs {
    pub fn add(&mut self, name: &str, log: Vec<u8>) {
        let before = self.logs.insert(name.to_owned(), log);
        assert!(before.is_none(), "two logs are named {name}");
    }

    /// Ingests the logs with some options, checks the exit code and returns the scans of each log.
    pub fn ingest(&self, options: &[&str], code: i32) -> Ingested {
        let workplace = Workplace::new("");
        let files: Vec<String> = self.logs.keys().map(|name| format!("{name}.mcap")).collect();
        for (file, log) in files.iter().zip(self.logs.values()) {
            fs::write(workplace.path(file), log).unwrap();
        }
        let sets = [format!("ingest.logs={files:?}")];
        let sets = sets.iter().map(String::as_str).chain(options.iter().copied());
        let args: Vec<&str> = sets.flat_map(|set| ["--set", set]).collect();
        let finished = workplace.command("ingest", "out", &args).expect(code);
        let table = |name: &String| workplace.path(&format!("out/scans/{name}.parquet"));
        let scans = self.logs.keys().map(|name| (name.clone(), scans(&table(name)))).collect();
        Ingested { workplace, finished, scans }
    }
}

/// What the program made of some logs.
pub struct Ingested {
    pub workplace: Workplace,
    pub finished: Finished,
    pub scans: BTreeMap<String, Vec<Scan>>,
}
