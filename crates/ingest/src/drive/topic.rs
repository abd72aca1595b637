//! A drive's topics: which channels of which file carry them, and how their messages are read.

use std::collections::{BTreeMap, BTreeSet};

use dataset::Dropped;
use messages::{Encoding, MessageType, Source, is_whole};

use crate::error::IngestError;
use crate::mcap::chunk::{self, Buffer};
use crate::mcap::framing::Piece;
use crate::mcap::log::{Channel, Contents, Log};
use crate::types::{LIDAR_TYPES, POSE_TYPES};

/// The files of one drive, in order of time, and what they hold.
pub(crate) struct Drive<'a> {
    files: Vec<(&'a Log, Contents)>,
}

/// A topic that was asked for; several channels can carry it.
#[derive(Debug, Clone)]
pub(crate) struct Topic {
    pub(crate) name: String,
    /// For each file, how the channels of the topic are read.
    sources: Vec<BTreeMap<u16, Source>>,
    /// Messages of the topic that cannot be read for the type of their channel.
    pub(crate) unfit: Dropped,
    /// What had to be guessed.
    pub(crate) notes: Vec<String>,
}

impl Topic {
    #[inline]
    pub(crate) fn source(&self, file: usize, channel: u16) -> Option<Source> {
        self.sources[file].get(&channel).copied()
    }

    /// Whether a piece may hold messages of it.
    pub(crate) fn may_be_in(&self, piece: &FilePiece<'_>) -> bool {
        piece.piece.may_hold(|id| self.source(piece.file, id).is_some())
    }

    /// Whether some of its messages are read in a way.
    pub(crate) fn any(&self, is_so: impl Fn(&Source) -> bool) -> bool {
        self.sources.iter().flat_map(BTreeMap::values).any(is_so)
    }
}

/// A piece of one of the files.
#[derive(Clone, Copy)]
pub(crate) struct FilePiece<'a> {
    pub(crate) file: usize,
    pub(crate) log: &'a Log,
    pub(crate) piece: &'a Piece,
    /// Bytes of the files before.
    pub(crate) bytes_before: u64,
}

impl FilePiece<'_> {
    /// Bytes of the drive up to the piece's end.
    pub(crate) fn end(&self) -> u64 {
        self.bytes_before + self.piece.range.end as u64
    }
}

impl<'a> Drive<'a> {
    pub(crate) fn new(logs: &[&'a Log]) -> Self {
        let mut files: Vec<_> = logs.iter().map(|&log| (log, log.contents())).collect();
        // A file without messages has no time; it says nothing wherever it stands.
        files.sort_by_key(|(_, contents)| contents.time_range_ns);
        Self { files }
    }

    /// Log time of the first and the last message \[ns\].
    pub(crate) fn time_range_ns(&self) -> Option<(u64, u64)> {
        let ranges = || self.files.iter().filter_map(|(_, contents)| contents.time_range_ns);
        Some((ranges().map(|(first, _)| first).min()?, ranges().map(|(_, last)| last).max()?))
    }

    /// Every channel, with the file's place and the channel's number in it.
    pub(crate) fn channels(&self) -> impl Iterator<Item = (usize, u16, &Channel)> {
        self.files.iter().enumerate().flat_map(|(file, (_, contents))| {
            contents.channels.iter().map(move |(&id, channel)| (file, id, channel))
        })
    }

    /// How the messages of a channel are read, lidars before poses where it has no schema.
    pub(crate) fn source(&self, file: usize, id: u16) -> Option<Source> {
        let (log, contents) = &self.files[file];
        let recognise = |types| recognise(log, contents, id, types);
        let named = contents.channels.get(&id)?.source();
        named.or_else(|| recognise(&LIDAR_TYPES)).or_else(|| recognise(&POSE_TYPES))
    }

    /// What of the files' structure is broken.
    pub(crate) fn dropped(&self) -> Dropped {
        let mut dropped = Dropped::default();
        self.files.iter().for_each(|(_, contents)| dropped.merge(contents.dropped.clone()));
        dropped
    }

    /// The first of the files, which stands for all in messages.
    pub(crate) fn path(&self) -> std::path::PathBuf {
        self.files.first().map(|(log, _)| log.path().to_owned()).unwrap_or_default()
    }

    /// Finds the channels of a topic and how to read them.
    pub(crate) fn topic(
        &self,
        name: &str,
        key: &'static str,
        types: &[MessageType],
    ) -> Result<Topic, IngestError> {
        let mut topic = Topic {
            name: name.to_owned(),
            sources: Vec::new(),
            unfit: Dropped::default(),
            notes: Vec::new(),
        };
        let mut unfit = Vec::new();
        for (log, contents) in &self.files {
            let mut sources = BTreeMap::new();
            for (&id, channel) in contents.channels.iter().filter(|(_, c)| c.topic == name) {
                let source = channel.source().or_else(|| recognise(log, contents, id, types));
                match source.filter(|source| types.contains(&source.message_type)) {
                    Some(source) => {
                        if channel.schema.is_empty() {
                            let read_as = source.message_type.name();
                            topic.notes.push(format!(
                                "{name} has no schema: its messages were read as {read_as}, as which they decode"
                            ));
                        }
                        sources.insert(id, source);
                    }
                    None => unfit.push(channel),
                }
            }
            topic.sources.push(sources);
        }
        if topic.sources.iter().any(|sources| !sources.is_empty()) {
            // Another channel of the topic, of a type that does not fit, is left out and counted.
            for channel in unfit {
                let reason = format!("messages of {name} in a channel of {}", channel.describe());
                topic.unfit.add(reason, channel.n_messages.unwrap_or(1));
            }
            topic.notes.sort();
            topic.notes.dedup();
            return Ok(topic);
        }
        let (path, remedy) = (self.path(), self.remedy(key, types));
        Err(match unfit.first() {
            None => IngestError::NoTopic { path, topic: topic.name, remedy },
            Some(channel) => IngestError::WrongType {
                path,
                topic: topic.name,
                found: channel.describe(),
                expected: expected(types),
                remedy,
            },
        })
    }

    /// To which topics an option can be set, or else which topics there are.
    fn remedy(&self, key: &str, types: &[MessageType]) -> String {
        let channels = || self.channels().map(|(_, _, channel)| channel);
        let list = |fits: &dyn Fn(&Channel) -> bool| {
            let fitting: BTreeSet<String> = channels()
                .filter(|channel| fits(channel))
                .map(|channel| format!("`{}` ({})", channel.topic, channel.describe()))
                .collect();
            fitting.into_iter().collect::<Vec<_>>().join(", ")
        };
        let fits = |channel: &Channel| {
            channel.source().is_some_and(|source| types.contains(&source.message_type))
        };
        match list(&fits) {
            none if none.is_empty() => match list(&|_| true) {
                none if none.is_empty() => match self.dropped() {
                    whole if whole.is_empty() => "it has no topic at all".to_owned(),
                    broken => format!("it has no topic that can be read ({broken})"),
                },
                all => format!("none would do; the log has {all}"),
            },
            some => format!("set `{key}` to one of: {some}"),
        }
    }

    /// Messages of the topics, where the files say how many.
    pub(crate) fn n_messages(&self, topics: &[&Topic]) -> Option<u64> {
        let is_wanted = |file, id| topics.iter().any(|topic| topic.source(file, id).is_some());
        let wanted = self.channels().filter(|&(file, id, _)| is_wanted(file, id));
        // What the files claim may be more than can be counted.
        wanted
            .map(|(_, _, channel)| channel.n_messages)
            .try_fold(0u64, |sum, n| Some(sum.saturating_add(n?)))
    }

    /// The pieces that hold, or may hold, messages of the topics, in order.
    pub(crate) fn pieces_with(&self, topics: &[&Topic]) -> Vec<FilePiece<'_>> {
        self.pieces(|file, id| topics.iter().any(|topic| topic.source(file, id).is_some()))
    }

    /// The pieces that hold, or may hold, messages of channels that are wanted, in order.
    pub(crate) fn pieces(&self, wanted: impl Fn(usize, u16) -> bool) -> Vec<FilePiece<'_>> {
        let mut pieces = Vec::new();
        let mut bytes_before = 0;
        for (file, (log, contents)) in self.files.iter().enumerate() {
            let may_hold =
                contents.pieces.iter().filter(|piece| piece.may_hold(|id| wanted(file, id)));
            pieces.extend(may_hold.map(|piece| FilePiece { file, log, piece, bytes_before }));
            bytes_before += log.bytes().len() as u64;
        }
        pieces
    }
}

/// "`A`, `B` or `C`".
fn expected(types: &[MessageType]) -> String {
    let names: Vec<String> = types.iter().map(|t| format!("`{}`", t.name())).collect();
    match names.split_last() {
        Some((last, [])) => last.clone(),
        Some((last, rest)) => format!("{} or {last}", rest.join(", ")),
        None => String::new(),
    }
}

/// How the messages of a channel without schema are read: as the only one of the types that its
/// first message decodes as, wholly and with values that make sense.
fn recognise(log: &Log, contents: &Contents, id: u16, types: &[MessageType]) -> Option<Source> {
    let channel = contents.channels.get(&id).filter(|channel| channel.schema.is_empty())?;
    let mut buffer = Buffer::default();
    let mut first: Option<Vec<u8>> = None;
    for piece in contents.pieces.iter().filter(|piece| piece.may_hold(|other| other == id)) {
        // What is broken is counted when the messages are read.
        chunk::messages(log.bytes(), piece, &mut buffer, |header, data| {
            if header.channel_id == id && first.is_none() {
                first = Some(data.to_owned());
            }
        });
        if first.is_some() {
            break;
        }
    }
    let first = first?;
    let encoding = Encoding::from_name(&channel.message_encoding)?;
    let mut fitting = types
        .iter()
        .map(|&message_type| Source { message_type, encoding })
        .filter(|source| source.message_type.encodings().contains(&encoding))
        .filter(|&source| is_whole(source, &first));
    fitting.next().filter(|_| fitting.next().is_none())
}
