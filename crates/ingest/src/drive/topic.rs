//! The topics of a drive: which channels carry them, and how their messages are read.

use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use dataset::{Loss, LossKind, Losses, Note, NoteKind, Subject};
use messages::{Encoding, MessageType, Source, is_plausible_message, read_stamp_ns};

use crate::error::IngestError;
use crate::mcap::chunk::{self, Buffer};
use crate::mcap::definitions::Channel;
use crate::mcap::framing::Piece;
use crate::mcap::log::{Contents, Log};
use crate::types::{LIDAR_TYPES, POSE_TYPES};

/// The files of one drive, in order of time, and their structure.
pub(crate) struct Drive<'a> {
    files: Vec<(&'a Log, Contents)>,
}

/// A topic of the options. Several channels can carry it.
#[derive(Debug, Clone)]
pub(crate) struct Topic {
    pub(crate) name: String,
    /// For each file, how the channels of the topic are read.
    sources: Vec<BTreeMap<u16, Source>>,
    /// Messages in channels of another type.
    pub(crate) losses: Losses,
    /// What was assumed.
    pub(crate) notes: Vec<Note>,
    /// Whether the clock of the stamps starts at 0, as that of a simulation. A stamp of 0 is a time then.
    pub(crate) starts_at_zero: bool,
}

/// A clock whose stamps are less than this starts at 0 \[ns\]: 11 days.
const MAX_FROM_ZERO_NS: i64 = 1_000_000_000_000_000;
/// The first stamp other than 0 is looked for in this number of pieces.
const N_FIRST_PIECES: usize = 3;

impl Topic {
    #[inline]
    pub(crate) fn source(&self, file: usize, channel: u16) -> Option<Source> {
        self.sources[file].get(&channel).copied()
    }

    /// Whether a piece can contain messages of the topic.
    pub(crate) fn may_be_in(&self, piece: &FilePiece<'_>) -> bool {
        piece.piece.may_hold(|id| self.source(piece.file, id).is_some())
    }

    /// Whether the predicate is true for a channel of the topic.
    pub(crate) fn any(&self, predicate: impl Fn(&Source) -> bool) -> bool {
        self.sources.iter().flat_map(BTreeMap::values).any(predicate)
    }
}

/// A piece of one of the files.
#[derive(Clone, Copy)]
pub(crate) struct FilePiece<'a> {
    pub(crate) file: usize,
    pub(crate) log: &'a Log,
    pub(crate) piece: &'a Piece,
    /// Total size of the files before \[bytes\].
    pub(crate) bytes_before: u64,
}

impl FilePiece<'_> {
    /// Size of the drive up to the end of the piece \[bytes\].
    pub(crate) fn end(&self) -> u64 {
        self.bytes_before + self.piece.range.end as u64
    }
}

impl<'a> Drive<'a> {
    pub(crate) fn new(logs: &[&'a Log]) -> Self {
        let mut files: Vec<_> = logs.iter().map(|&log| (log, log.contents())).collect();
        // A file without messages has no time. Its place does not matter.
        files.sort_by_key(|(_, contents)| contents.time_range_ns);
        Self { files }
    }

    /// Log time of the first and the last message \[ns\].
    pub(crate) fn time_range_ns(&self) -> Option<(u64, u64)> {
        let ranges = || self.files.iter().filter_map(|(_, contents)| contents.time_range_ns);
        Some((ranges().map(|(first, _)| first).min()?, ranges().map(|(_, last)| last).max()?))
    }

    /// All channels, with the number of the file and the channel id.
    pub(crate) fn channels(&self) -> impl Iterator<Item = (usize, u16, &Channel)> {
        self.files.iter().enumerate().flat_map(|(file, (_, contents))| {
            contents.channels.iter().map(move |(&id, channel)| (file, id, channel))
        })
    }

    /// How the messages of a channel are read. A channel without schema is tried as a lidar first,
    /// then as poses.
    pub(crate) fn source(&self, file: usize, id: u16) -> Option<Source> {
        let (log, contents) = &self.files[file];
        let sniff = |types| sniff(log, contents, id, types);
        let by_schema = contents.channels.get(&id)?.source();
        by_schema.or_else(|| sniff(&LIDAR_TYPES)).or_else(|| sniff(&POSE_TYPES))
    }

    pub(crate) fn n_files(&self) -> usize {
        self.files.len()
    }

    /// The structure of a file.
    pub(crate) fn contents(&self, file: usize) -> &Contents {
        &self.files[file].1
    }

    pub(crate) fn path_of(&self, file: usize) -> PathBuf {
        self.files[file].0.path().to_owned()
    }

    /// Whether the file defines a channel.
    pub(crate) fn defines(&self, file: usize, id: u16) -> bool {
        self.files[file].1.channels.contains_key(&id)
    }

    /// Damage in the structure of the files.
    pub(crate) fn losses(&self) -> Losses {
        let mut losses = Losses::default();
        self.files.iter().for_each(|(_, contents)| losses.merge(contents.losses.clone()));
        losses
    }

    /// The first file, which is the name of the drive in messages.
    pub(crate) fn path(&self) -> PathBuf {
        self.files.first().map(|(log, _)| log.path().to_owned()).unwrap_or_default()
    }

    /// Finds the channels of a topic and how to read them.
    pub(crate) fn topic(
        &self,
        name: &str,
        key: &'static str,
        types: &[MessageType],
    ) -> Result<Topic, IngestError> {
        let subject = || Subject::topic(name);
        let mut sources = Vec::new();
        let mut read_without_schema = BTreeSet::new();
        let mut unsuitable = Vec::new();
        for (log, contents) in &self.files {
            let mut in_file = BTreeMap::new();
            for (&id, channel) in contents.channels.iter().filter(|(_, c)| c.topic == name) {
                let source = channel.source().or_else(|| sniff(log, contents, id, types));
                match source.filter(|source| types.contains(&source.message_type)) {
                    Some(source) => {
                        if channel.schema.is_empty() {
                            read_without_schema.insert(source.message_type.name());
                        }
                        in_file.insert(id, source);
                    }
                    None => unsuitable.push(channel),
                }
            }
            sources.push(in_file);
        }
        if sources.iter().all(BTreeMap::is_empty) {
            return Err(self.no_topic(name, key, types, unsuitable.first().copied()));
        }
        let mut losses = Losses::default();
        for channel in unsuitable {
            let kind = LossKind::MessagesOfOtherType { found: channel.describe() };
            losses.add(Loss::new(kind, subject()), channel.n_messages.unwrap_or(1));
        }
        let notes = read_without_schema.into_iter().map(|read_as| {
            let read_as = read_as.to_owned();
            Note::new(NoteKind::NoSchema { read_as }, subject())
        });
        let notes = notes.collect();
        let mut topic =
            Topic { name: name.to_owned(), sources, losses, notes, starts_at_zero: false };
        topic.starts_at_zero = self.first_stamp_ns(&topic).is_some_and(|ns| ns < MAX_FROM_ZERO_NS);
        Ok(topic)
    }

    /// A topic without channels, for data that is not in the drive.
    pub(crate) fn no_channels(&self, name: &str) -> Topic {
        let sources = vec![BTreeMap::new(); self.files.len()];
        let (losses, notes) = Default::default();
        Topic { name: name.to_owned(), sources, losses, notes, starts_at_zero: false }
    }

    /// The first stamp of a topic that is not 0 \[ns\].
    fn first_stamp_ns(&self, topic: &Topic) -> Option<i64> {
        let mut buffer = Buffer::default();
        let mut first = None;
        for FilePiece { file, log, piece, .. } in
            self.pieces_with(&[topic]).into_iter().take(N_FIRST_PIECES)
        {
            // Losses are counted later, when the messages are read.
            chunk::messages(log.bytes(), piece, &mut buffer, |header, data| {
                if first.is_none()
                    && let Some(source) = topic.source(file, header.channel_id)
                {
                    let stamp_ns = read_stamp_ns(source, data).ok().flatten();
                    first = stamp_ns.filter(|&stamp_ns| stamp_ns != 0);
                }
            });
            if first.is_some() {
                break;
            }
        }
        first
    }

    /// The error for a topic that does not exist, or has only a channel of an unsuitable type.
    fn no_topic(
        &self,
        name: &str,
        key: &str,
        types: &[MessageType],
        unsuitable: Option<&Channel>,
    ) -> IngestError {
        let (path, topic, remedy) = (self.path(), name.to_owned(), self.remedy(key, types));
        match unsuitable {
            None => IngestError::NoTopic { path, topic, remedy },
            Some(channel) => IngestError::WrongType {
                path,
                topic,
                found: channel.describe(),
                expected: expected(types),
                remedy,
            },
        }
    }

    /// Lists the topics that an option can be set to, or else all topics.
    fn remedy(&self, key: &str, types: &[MessageType]) -> String {
        let channels = || self.channels().map(|(_, _, channel)| channel);
        let list = |is_listed: &dyn Fn(&Channel) -> bool| {
            let listed: BTreeSet<String> = channels()
                .filter(|channel| is_listed(channel))
                .map(|channel| format!("`{}` ({})", channel.topic, channel.describe()))
                .collect();
            listed.into_iter().collect::<Vec<_>>().join(", ")
        };
        let is_suitable = |channel: &Channel| {
            channel.source().is_some_and(|source| types.contains(&source.message_type))
        };
        match list(&is_suitable) {
            none if none.is_empty() => match list(&|_| true) {
                none if none.is_empty() => match self.losses() {
                    intact if intact.is_empty() => "the log has no topics".to_owned(),
                    losses => format!("the log has no readable topics ({losses})"),
                },
                all => format!("no topic of the log has a suitable type; its topics are {all}"),
            },
            some => format!("set `{key}` to one of: {some}"),
        }
    }

    /// Number of messages of the topics, if the files contain it.
    pub(crate) fn n_messages(&self, topics: &[&Topic]) -> Option<u64> {
        let is_wanted = |file, id| topics.iter().any(|topic| topic.source(file, id).is_some());
        let wanted = self.channels().filter(|&(file, id, _)| is_wanted(file, id));
        // The numbers in a damaged file can be so large that their sum overflows.
        wanted
            .map(|(_, _, channel)| channel.n_messages)
            .try_fold(0u64, |sum, n| Some(sum.saturating_add(n?)))
    }

    /// The pieces that can contain messages of the topics, in order.
    pub(crate) fn pieces_with(&self, topics: &[&Topic]) -> Vec<FilePiece<'_>> {
        self.pieces(|file, id| topics.iter().any(|topic| topic.source(file, id).is_some()))
    }

    /// The pieces that can contain messages of wanted channels, in order.
    pub(crate) fn pieces(&self, is_wanted: impl Fn(usize, u16) -> bool) -> Vec<FilePiece<'_>> {
        let mut pieces = Vec::new();
        let mut bytes_before = 0;
        for (file, (log, contents)) in self.files.iter().enumerate() {
            let may_hold =
                contents.pieces.iter().filter(|piece| piece.may_hold(|id| is_wanted(file, id)));
            pieces.extend(may_hold.map(|piece| FilePiece { file, log, piece, bytes_before }));
            bytes_before += log.n_bytes();
        }
        pieces
    }
}

/// Formats types as "`A`, `B` or `C`".
fn expected(types: &[MessageType]) -> String {
    let names: Vec<String> = types.iter().map(|t| format!("`{}`", t.name())).collect();
    match names.split_last() {
        Some((last, [])) => last.clone(),
        Some((last, rest)) => format!("{} or {last}", rest.join(", ")),
        None => String::new(),
    }
}

/// Finds the type of a channel without schema from the content of its first message: the only one of
/// the types that decodes the whole message to plausible values.
fn sniff(log: &Log, contents: &Contents, id: u16, types: &[MessageType]) -> Option<Source> {
    let channel = contents.channels.get(&id).filter(|channel| channel.schema.is_empty())?;
    let mut buffer = Buffer::default();
    let mut first: Option<Vec<u8>> = None;
    for piece in contents.pieces.iter().filter(|piece| piece.may_hold(|other| other == id)) {
        // Losses are counted later, when the messages are read.
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
    let mut suitable = types
        .iter()
        .map(|&message_type| Source { message_type, encoding })
        .filter(|source| source.message_type.encodings().contains(&encoding))
        .filter(|&source| is_plausible_message(source, &first));
    suitable.next().filter(|_| suitable.next().is_none())
}
