//! Imports recordings made in code and reads the logs back.

// Each test binary uses only some of these functions.
#![allow(dead_code)]

use std::io::Cursor;
use std::path::PathBuf;

use dataset::Severity;
use import::{ImportError, Imported, Options};
use messages::Source;

/// A message of the log.
#[derive(Debug, Clone, PartialEq)]
pub struct Message {
    pub topic: String,
    pub source: Source,
    pub log_ns: u64,
    pub publish_ns: u64,
    pub bytes: Vec<u8>,
}

/// The result of an import, the bytes of the log, and its messages.
#[derive(Debug)]
pub struct Log {
    pub imported: Imported,
    pub bytes: Vec<u8>,
    pub messages: Vec<Message>,
}

impl Log {
    pub fn of<'a>(&'a self, topic: &'a str) -> impl Iterator<Item = &'a Message> {
        self.messages.iter().filter(move |message| message.topic == topic)
    }

    /// The codes and counts of the losses of a severity.
    pub fn losses(&self, severity: Severity) -> Vec<(&'static str, u64)> {
        let losses = self.imported.losses.iter();
        losses
            .filter(|(loss, _)| loss.kind.severity() == severity)
            .map(|(loss, n)| (loss.kind.code(), n))
            .collect()
    }
}

/// Imports files with these names and contents.
pub fn import(files: &[(&str, &[u8])], options: &Options) -> Result<Log, ImportError> {
    let folder = tempfile::tempdir().unwrap();
    let paths: Vec<PathBuf> = files
        .iter()
        .map(|(name, content)| {
            let path = folder.path().join(name);
            std::fs::write(&path, content).unwrap();
            path
        })
        .collect();
    import_paths(&paths, options)
}

/// Imports bags. Their messages can have any type.
pub fn import_paths_as_they_are(paths: &[PathBuf], options: &Options) -> Result<Log, ImportError> {
    let mut out = Cursor::new(Vec::new());
    let imported = import::import(paths, options, &mut out, |_| {})?;
    Ok(Log { imported, bytes: out.into_inner(), messages: Vec::new() })
}

pub fn import_paths(paths: &[PathBuf], options: &Options) -> Result<Log, ImportError> {
    let mut out = Cursor::new(Vec::new());
    let imported = import::import(paths, options, &mut out, |_| {})?;
    let bytes = out.into_inner();
    let messages: Vec<Message> = mcap::MessageStream::new(&bytes)
        .unwrap()
        .map(|message| {
            let message = message.unwrap();
            let schema = message.channel.schema.as_ref().unwrap();
            assert!(!schema.data.is_empty() && schema.encoding == "ros2msg");
            Message {
                topic: message.channel.topic.clone(),
                source: Source::new(&schema.name, &message.channel.message_encoding).unwrap(),
                log_ns: message.log_time,
                publish_ns: message.publish_time,
                bytes: message.data.to_vec(),
            }
        })
        .collect();
    assert!(messages.is_sorted_by_key(|message| message.log_ns), "messages are sorted by log time");
    let counted: u64 = imported.topics.iter().map(|topic| topic.n_messages).sum();
    assert_eq!(counted, messages.len() as u64);
    assert_eq!(imported.start_ns as u64, messages[0].log_ns);
    assert_eq!(imported.end_ns as u64, messages[messages.len() - 1].log_ns);
    Ok(Log { imported, bytes, messages })
}
