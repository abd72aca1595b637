//! Recordings built byte by byte, imported and read back.

// Not every test looks at all of it.
#![allow(dead_code)]

use std::io::Cursor;
use std::path::PathBuf;

use import::{ImportError, Imported, Options};
use messages::Source;

/// A message of the log that was written.
#[derive(Debug, Clone, PartialEq)]
pub struct Message {
    pub topic: String,
    pub source: Source,
    pub log_ns: u64,
    pub publish_ns: u64,
    pub bytes: Vec<u8>,
}

/// What an import gave: its account, the log's bytes, its messages.
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

    pub fn dropped(&self) -> String {
        self.imported.dropped.to_string()
    }

    pub fn remarks(&self) -> String {
        self.imported.remarks.to_string()
    }
}

/// Imports files given by name and content.
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
    assert!(messages.is_sorted_by_key(|message| message.log_ns), "in order of log time");
    let counted: u64 = imported.topics.iter().map(|topic| topic.n_messages).sum();
    assert_eq!(counted, messages.len() as u64);
    assert_eq!(imported.start_ns as u64, messages[0].log_ns);
    assert_eq!(imported.end_ns as u64, messages[messages.len() - 1].log_ns);
    Ok(Log { imported, bytes, messages })
}
