//! The structure of an MCAP log: channels, and the pieces that hold messages.
//!
//! An intact log is read through its summary. A log without one (cut, or its writer died) is
//! walked record by record from its start; so are the stretches of an intact log that no chunk
//! index covers, since messages may stand outside chunks. Nothing in the file is skipped unseen.

use std::collections::BTreeMap;
use std::fs::File;
use std::ops::Range;
use std::path::{Path, PathBuf};

use dataset::Dropped;
use mcap::records::{Record, op};
use memmap2::{Advice, Mmap, UncheckedAdvice};
use messages::Source;

use crate::error::IngestError;
use crate::mcap::chunk::{self, Buffer};
use crate::mcap::framing::{
    END_OF_OPCODES, FIRST_FREE_OPCODE, Piece, PieceKind, RECORD_HEADER, RawRecord, record_at,
    records,
};
use crate::mcap::record;

/// A log: a memory-mapped file, or bytes that came another way.
#[derive(Debug)]
pub struct Log {
    path: PathBuf,
    bytes: Bytes,
}

#[derive(Debug)]
enum Bytes {
    Mapped(Mmap),
    Owned(Vec<u8>),
}

/// A channel of a log.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Channel {
    /// The topic.
    pub topic: String,
    /// How its messages are encoded: `cdr`, `ros1`, ...
    pub message_encoding: String,
    /// The schema's name; empty where the channel has none.
    pub schema: String,
    /// Number of messages, where the log says so.
    pub n_messages: Option<u64>,
}

/// What a log holds.
#[derive(Debug, Clone, Default)]
pub struct Contents {
    /// Channels by their number.
    pub channels: BTreeMap<u16, Channel>,
    /// Time of the first and the last message \[ns\].
    pub time_range_ns: Option<(u64, u64)>,
    /// What of the log's structure is broken.
    pub dropped: Dropped,
    pub(crate) pieces: Vec<Piece>,
}

/// Messages outside chunks are read in stretches of about this size.
const LOOSE_BYTES: usize = 1 << 20;

/// What a cut file lacks, as a reason.
const CUT: &str =
    "ends of the log cut off (no footer: the recorder stopped early or the copy is incomplete)";

const DAMAGED_SUMMARY: &str = "summaries that are damaged (the log was read without its index)";
const WRONG_INDEX: &str =
    "indexes of chunks that the data contradicts (the log was read without its index)";

impl Log {
    /// Maps a file and checks that it starts as MCAP does.
    pub fn open(path: &Path) -> Result<Self, IngestError> {
        let failed = |source| IngestError::Open { path: path.to_owned(), source };
        let file = File::open(path).map_err(failed)?;
        // SAFETY: the map is read-only. Should another process cut the file while it is mapped,
        // the system ends this one; a log that is still being written is not for batch work.
        let bytes = unsafe { Mmap::map(&file) }.map_err(failed)?;
        // Advice is a hint; without it the log is read all the same.
        let _ = bytes.advise(Advice::Sequential);
        Self::new(path, Bytes::Mapped(bytes))
    }

    /// A log that is in memory already, as one that was downloaded; `path` stands for it in
    /// messages.
    pub fn from_bytes(path: &Path, bytes: Vec<u8>) -> Result<Self, IngestError> {
        Self::new(path, Bytes::Owned(bytes))
    }

    /// Checks that the bytes start as MCAP does.
    fn new(path: &Path, bytes: Bytes) -> Result<Self, IngestError> {
        let log = Self { path: path.to_owned(), bytes };
        let bytes = log.bytes();
        if !bytes.starts_with(mcap::MAGIC) {
            let path = path.to_owned();
            let first = bytes.iter().take(8).map(|b| format!("{b:02x}")).collect::<Vec<_>>();
            return Err(match first.is_empty() {
                true => IngestError::Empty { path },
                false => IngestError::NotMcap { path, found: first.join(" ") },
            });
        }
        Ok(log)
    }

    /// The file, or what stands for it.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The log's bytes.
    pub fn bytes(&self) -> &[u8] {
        match &self.bytes {
            Bytes::Mapped(bytes) => bytes,
            Bytes::Owned(bytes) => bytes,
        }
    }

    /// Tells the system that the bytes before `end` are not needed in memory any more.
    pub(crate) fn forget_up_to(&self, end: usize) {
        let Bytes::Mapped(bytes) = &self.bytes else { return };
        const PAGE: usize = 4096;
        let whole_pages = end / PAGE * PAGE;
        // SAFETY: the map is read-only and shared; a page dropped here is read again if touched.
        let _ = unsafe { bytes.unchecked_advise_range(UncheckedAdvice::DontNeed, 0, whole_pages) };
    }

    /// Reads the log's structure; its messages stay unread.
    pub fn contents(&self) -> Contents {
        self.indexed_contents().unwrap_or_else(|reason| {
            let mut contents = self.walked_contents();
            contents.dropped.add(reason.unwrap_or_default(), u64::from(reason.is_some()));
            contents
        })
    }

    /// From the summary; the error says what is wrong with it, nothing where it is absent or holds
    /// too little.
    fn indexed_contents(&self) -> Result<Contents, Option<&'static str>> {
        let bytes = self.bytes();
        if !bytes.ends_with(mcap::MAGIC) {
            return Err(None); // and is counted as cut
        }
        if !summary_is_intact(bytes) {
            return Err(Some(DAMAGED_SUMMARY));
        }
        let summary = mcap::Summary::read(bytes).map_err(|_| Some(DAMAGED_SUMMARY))?.ok_or(None)?;
        let counts = summary.stats.as_ref().map(|stats| &stats.channel_message_counts);
        let channels: BTreeMap<u16, Channel> = summary
            .channels
            .iter()
            .map(|(&id, channel)| {
                let schema = channel.schema.as_ref().map_or("", |schema| schema.name.as_str());
                let channel = Channel {
                    topic: channel.topic.clone(),
                    message_encoding: channel.message_encoding.clone(),
                    schema: schema.to_owned(),
                    n_messages: counts.map(|counts| counts.get(&id).copied().unwrap_or(0)),
                };
                (id, channel)
            })
            .collect();

        // A writer may leave the channels out of the summary; then the data has to be looked into.
        let n_channels = summary.stats.as_ref().map_or(0, |stats| stats.channel_count as usize);
        if channels.is_empty() || channels.len() < n_channels {
            return Err(None);
        }
        let mut indexes: Vec<_> = summary.chunk_indexes.iter().collect();
        indexes.sort_by_key(|index| index.chunk_start_offset);
        let mut contents =
            Contents { channels, time_range_ns: time_range_ns(&summary), ..Contents::default() };
        let mut at = mcap::MAGIC.len();
        let mut seen = Seen::new(self);
        for index in indexes {
            let record = indexed_chunk(bytes, index).ok_or(Some(WRONG_INDEX))?;
            let (start, end) = (record.body.start - RECORD_HEADER, record.body.end);
            if start < at {
                return Err(Some(WRONG_INDEX));
            }
            let known =
                index.message_index_offsets.keys().all(|id| contents.channels.contains_key(id));
            if !known {
                return Err(None);
            }
            self.walk(at..start, &mut contents);
            contents.pieces.push(Piece {
                kind: PieceKind::Chunk,
                range: record.body,
                // A writer may leave out message indexes; then the chunk has to be looked into.
                channels: (!index.message_index_offsets.is_empty())
                    .then(|| index.message_index_offsets.keys().copied().collect()),
            });
            at = end;
            seen.reach(at);
        }
        // Up to the end of the data section or of the file, whatever comes first.
        self.walk(at..bytes.len(), &mut contents);
        Ok(contents)
    }

    /// By walking the whole file, looking into every chunk for its channels.
    fn walked_contents(&self) -> Contents {
        let mut contents = Contents::default();
        self.walk(mcap::MAGIC.len()..self.bytes().len(), &mut contents);
        let mut schemas = BTreeMap::new();
        let mut channels: BTreeMap<u16, mcap::records::Channel> = BTreeMap::new();
        let mut counts: BTreeMap<u16, u64> = BTreeMap::new();
        let mut times = None;
        let mut define = |record: Record<'_>| match record {
            Record::Schema { header, .. } => {
                schemas.entry(header.id).or_insert(header.name);
            }
            Record::Channel(channel) => {
                channels.entry(channel.id).or_insert(channel);
            }
            Record::Message { header, .. } => {
                *counts.entry(header.channel_id).or_default() += 1;
                let (first, last) = times.unwrap_or((header.log_time, header.log_time));
                times = Some((first.min(header.log_time), last.max(header.log_time)));
            }
            _ => {}
        };
        // Up to the end of the data: the summary repeats them, and may be what is damaged.
        let data = records(self.bytes(), mcap::MAGIC.len()..self.bytes().len())
            .take_while(|record| record.opcode != op::DATA_END);
        let mut seen = Seen::new(self);
        for record in data {
            seen.reach(record.body.end);
            if matches!(record.opcode, op::SCHEMA | op::CHANNEL) {
                match record::parse(record.opcode, &self.bytes()[record.body]) {
                    Some(parsed) => define(parsed),
                    None => contents.dropped.add("records that are malformed", 1),
                }
            }
        }
        let mut buffer = Buffer::default();
        let mut seen = Seen::new(self);
        for piece in &contents.pieces {
            seen.reach(piece.range.end);
            // What is broken is counted when the messages are read.
            chunk::records(self.bytes(), piece, &mut buffer, &mut define);
        }
        contents.time_range_ns = times;
        contents.channels = channels
            .into_iter()
            .map(|(id, channel)| {
                let channel = Channel {
                    topic: channel.topic,
                    message_encoding: channel.message_encoding,
                    schema: schemas.get(&channel.schema_id).cloned().unwrap_or_default(),
                    n_messages: Some(counts.get(&id).copied().unwrap_or(0)),
                };
                (id, channel)
            })
            .collect();
        contents
    }

    /// Adds the messages and chunks of a stretch of top-level records.
    fn walk(&self, range: Range<usize>, contents: &mut Contents) {
        let to_end_of_file = range.end == self.bytes().len();
        let mut at = range.start;
        let mut ended = false;
        // Messages outside chunks are taken together, up to a size.
        let mut loose: Option<Range<usize>> = None;
        let piece = |kind, range| Piece { kind, range, channels: None };
        let mut seen = Seen::new(self);
        for record in records(self.bytes(), range.clone()) {
            let start = std::mem::replace(&mut at, record.body.end);
            seen.reach(at);
            match record.opcode {
                op::MESSAGE => {
                    let stretch = loose.get_or_insert(start..start);
                    stretch.end = at;
                    if stretch.len() < LOOSE_BYTES {
                        continue;
                    }
                }
                op::CHUNK | op::DATA_END | op::FOOTER => {}
                0 | END_OF_OPCODES..FIRST_FREE_OPCODE => {
                    contents.dropped.add("records of a kind that the format does not have", 1);
                    continue;
                }
                _ => continue,
            }
            contents.pieces.extend(loose.take().map(|range| piece(PieceKind::Records, range)));
            match record.opcode {
                op::CHUNK => contents.pieces.push(piece(PieceKind::Chunk, record.body)),
                op::DATA_END | op::FOOTER => {
                    ended = true;
                    break;
                }
                _ => {}
            }
        }
        contents.pieces.extend(loose.map(|range| piece(PieceKind::Records, range)));
        if !to_end_of_file && at != range.end {
            contents.dropped.add("stretches between chunks that hold no records", 1);
        }
        if to_end_of_file && !(ended && self.bytes().ends_with(mcap::MAGIC)) {
            contents.dropped.add(CUT, 1);
            if !ended && self.bytes().get(at) == Some(&op::CHUNK) {
                let range = at..self.bytes().len();
                contents.pieces.push(Piece { kind: PieceKind::CutChunk, range, channels: None });
            }
        }
    }
}

/// Lets go of the file's pages as its structure is read: a look at one byte of a chunk brings in
/// 16 pages around it, which for many chunks adds up.
struct Seen<'a> {
    log: &'a Log,
    forgotten: usize,
}

impl<'a> Seen<'a> {
    /// Bytes after which pages are let go.
    const STRETCH: usize = 64 << 20;

    fn new(log: &'a Log) -> Self {
        Self { log, forgotten: 0 }
    }

    fn reach(&mut self, end: usize) {
        if self.forgotten + Self::STRETCH < end {
            self.log.forget_up_to(end);
            self.forgotten = end;
        }
    }
}

impl Channel {
    /// How its messages are read, where that is known.
    pub fn source(&self) -> Option<Source> {
        Source::new(&self.schema, &self.message_encoding)
    }

    /// Schema and encoding, for messages.
    pub fn describe(&self) -> String {
        let schema = if self.schema.is_empty() { "no schema" } else { &self.schema };
        format!("{schema}, {}", self.message_encoding)
    }
}

/// Time of the first and the last message, from the statistics or else from the chunk indexes.
fn time_range_ns(summary: &mcap::Summary) -> Option<(u64, u64)> {
    match &summary.stats {
        Some(stats) if stats.message_count == 0 => None,
        Some(stats) => Some((stats.message_start_time, stats.message_end_time)),
        None => {
            let first = summary.chunk_indexes.iter().map(|index| index.message_start_time).min()?;
            let last = summary.chunk_indexes.iter().map(|index| index.message_end_time).max()?;
            Some((first, last))
        }
    }
}

/// Whether the summary's CRC, where there is one, matches (MCAP specification, "Footer": over all
/// bytes from the start of the summary to the CRC itself). An index with a flipped bit could hide
/// chunks.
fn summary_is_intact(bytes: &[u8]) -> bool {
    let Ok(footer) = mcap::read::footer(bytes) else { return false };
    let end = bytes.len() - mcap::MAGIC.len() - size_of::<u32>();
    match usize::try_from(footer.summary_start) {
        Ok(0) => true,
        Ok(start) if start <= end => {
            let is_intact = footer.summary_crc == 0
                || footer.summary_crc == crc32fast::hash(&bytes[start..end]);
            // Private records may stand there, and are passed over.
            let is_sound = |raw: RawRecord| {
                FIRST_FREE_OPCODE <= raw.opcode || record::is_sound(raw.opcode, &bytes[raw.body])
            };
            is_intact && records(bytes, start..bytes.len()).all(is_sound)
        }
        _ => false,
    }
}

/// The chunk that an index points to; none where something else is there.
fn indexed_chunk(bytes: &[u8], index: &mcap::records::ChunkIndex) -> Option<RawRecord> {
    let start = usize::try_from(index.chunk_start_offset).ok()?;
    let end = start.checked_add(usize::try_from(index.chunk_length).ok()?)?;
    let record = record_at(bytes, start)?;
    (record.opcode == op::CHUNK && record.body.end == end).then_some(record)
}
