//! Channels of a log, and contradictions between their definitions.
//!
//! A file can define a channel several times, but all definitions must be the same (MCAP
//! specification, "Channel"). Files that were joined byte by byte, or by a tool with a bug, use one id
//! for two topics. `mcap doctor` reports them.

use std::collections::BTreeMap;
use std::fmt;

use mcap::records::Record;
use messages::Source;

/// A channel of a log.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Channel {
    /// The topic.
    pub topic: String,
    /// The encoding of its messages, such as `cdr` or `ros1`.
    pub message_encoding: String,
    /// The name of the schema, empty if the channel has none.
    pub schema: String,
    /// Number of messages, if the log contains it.
    pub n_messages: Option<u64>,
}

impl Channel {
    /// The type and encoding of its messages, if both are known.
    pub fn source(&self) -> Option<Source> {
        Source::new(&self.schema, &self.message_encoding)
    }

    /// Schema and encoding, for messages to the user.
    pub fn describe(&self) -> String {
        let schema = if self.schema.is_empty() { "no schema" } else { &self.schema };
        format!("{schema}, {}", self.message_encoding)
    }

    /// Whether both describe messages in the same way.
    fn agrees_with(&self, other: &Self) -> bool {
        (&self.topic, &self.message_encoding, &self.schema)
            == (&other.topic, &other.message_encoding, &other.schema)
    }
}

/// A channel with two definitions that contradict each other.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct Redefined {
    pub(crate) id: u16,
    pub(crate) first: Channel,
    pub(crate) second: Channel,
}

impl fmt::Display for Redefined {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let describe = |channel: &Channel| format!("`{}` ({})", channel.topic, channel.describe());
        write!(f, "{} and as {}", describe(&self.first), describe(&self.second))
    }
}

/// The channels that a part of a log defines, in the order of the file.
#[derive(Debug, Default)]
pub(crate) struct Definitions {
    schemas: BTreeMap<u16, String>,
    pub(crate) channels: BTreeMap<u16, Channel>,
    pub(crate) redefined: Vec<Redefined>,
}

impl Definitions {
    /// Adds a record. Only schemas and channels are used.
    pub(crate) fn add(&mut self, record: Record<'_>) {
        match record {
            Record::Schema { header, .. } => {
                self.schemas.insert(header.id, header.name);
            }
            Record::Channel(channel) => {
                let id = channel.id;
                let defined = Channel {
                    topic: channel.topic,
                    message_encoding: channel.message_encoding,
                    schema: self.schemas.get(&channel.schema_id).cloned().unwrap_or_default(),
                    n_messages: None,
                };
                self.define(id, defined);
            }
            _ => {}
        }
    }

    fn define(&mut self, id: u16, second: Channel) {
        match self.channels.get_mut(&id) {
            None => {
                self.channels.insert(id, second);
            }
            // The schema may follow the channel.
            Some(first) if first.schema.is_empty() && first.topic == second.topic => {
                *first = second;
            }
            Some(first)
                if first.agrees_with(&second)
                    || second.schema.is_empty() && first.topic == second.topic => {}
            Some(first) => {
                let is_known = self.redefined.iter().any(|known| known.id == id);
                if !is_known {
                    self.redefined.push(Redefined { id, first: first.clone(), second });
                }
            }
        }
    }

    /// The channels of this part of a log whose definitions contradict those of the whole log.
    pub(crate) fn contradictions(self, log: &BTreeMap<u16, Channel>) -> Vec<Redefined> {
        let mut all = Self { channels: log.clone(), redefined: self.redefined, ..Self::default() };
        for (id, channel) in self.channels {
            all.define(id, channel);
        }
        all.redefined
    }
}
