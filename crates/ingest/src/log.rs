//! The structure of an MCAP log: channels, and the pieces that hold messages.
//!
//! An intact log is read through its summary. A log without one (cut, or its writer died) is
//! walked record by record from its start; so are the stretches of an intact log that no chunk
//! index covers, since messages may stand outside chunks. Nothing in the file is skipped unseen.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::File;
use std::ops::Range;
use std::path::{Path, PathBuf};

use dataset::Dropped;
use mcap::records::{Record, op};
use memmap2::{Advice, Mmap, UncheckedAdvice};
use messages::Source;

use crate::IngestError;
use crate::chunk::{self, Buffer};

/// A memory-mapped log.
#[derive(Debug)]
pub struct Log {
    path: PathBuf,
    bytes: Mmap,
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

/// A stretch of the file that holds messages.
#[derive(Debug, Clone)]
pub(crate) struct Piece {
    pub(crate) kind: PieceKind,
    pub(crate) range: Range<usize>,
    /// Channels with messages in it, where the index says so.
    channels: Option<BTreeSet<u16>>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum PieceKind {
    /// The body of a whole chunk record.
    Chunk,
    /// A chunk record, from its opcode on, that the end of the file cuts.
    CutChunk,
    /// Whole top-level records, messages among them, outside any chunk.
    Records,
}

impl Piece {
    /// Whether it can hold messages of a channel that is wanted.
    pub(crate) fn may_hold(&self, wanted: impl Fn(u16) -> bool) -> bool {
        self.channels.as_ref().is_none_or(|ids| ids.iter().any(|&id| wanted(id)))
    }
}

/// Messages outside chunks are read in stretches of about this size.
const LOOSE_BYTES: usize = 1 << 20;

/// What a cut file lacks, as a reason.
const CUT: &str =
    "ends of the log cut off (no footer: the recorder stopped early or the copy is incomplete)";

impl Log {
    /// Maps a file and checks that it starts as MCAP does.
    pub fn open(path: &Path) -> Result<Self, IngestError> {
        let failed = |source| IngestError::Open { path: path.to_owned(), source };
        let file = File::open(path).map_err(failed)?;
        // SAFETY: the map is read-only. Should another process cut the file while it is mapped,
        // the system ends this one; a log that is still being written is not for batch work.
        let bytes = unsafe { Mmap::map(&file) }.map_err(failed)?;
        if !bytes.starts_with(mcap::MAGIC) {
            let path = path.to_owned();
            let first = bytes.iter().take(8).map(|b| format!("{b:02x}")).collect::<Vec<_>>();
            return Err(match first.is_empty() {
                true => IngestError::Empty { path },
                false => IngestError::NotMcap { path, found: first.join(" ") },
            });
        }
        // Advice is a hint; without it the log is read all the same.
        let _ = bytes.advise(Advice::Sequential);
        Ok(Self { path: path.to_owned(), bytes })
    }

    /// The file.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The file's bytes.
    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    /// Tells the system that the bytes before `end` are not needed in memory any more.
    pub(crate) fn forget_up_to(&self, end: usize) {
        const PAGE: usize = 4096;
        let whole_pages = end / PAGE * PAGE;
        // SAFETY: the map is read-only and shared; a page dropped here is read again if touched.
        let _ =
            unsafe { self.bytes.unchecked_advise_range(UncheckedAdvice::DontNeed, 0, whole_pages) };
    }

    /// Reads the log's structure; its messages stay unread.
    pub fn contents(&self) -> Contents {
        self.indexed_contents().unwrap_or_else(|| self.walked_contents())
    }

    /// From the summary; none where it is absent or contradicts the file.
    fn indexed_contents(&self) -> Option<Contents> {
        let bytes = self.bytes();
        if !summary_is_intact(bytes) {
            return None;
        }
        let summary = mcap::Summary::read(bytes).ok()??;
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
            return None;
        }
        let mut indexes: Vec<_> = summary.chunk_indexes.iter().collect();
        indexes.sort_by_key(|index| index.chunk_start_offset);
        let mut contents =
            Contents { channels, time_range_ns: time_range_ns(&summary), ..Contents::default() };
        let mut at = mcap::MAGIC.len();
        let mut seen = Seen::new(self);
        for index in indexes {
            let start = usize::try_from(index.chunk_start_offset).ok()?;
            let end = start.checked_add(usize::try_from(index.chunk_length).ok()?)?;
            let record = record_at(bytes, start)?;
            if record.opcode != op::CHUNK || record.body.end != end || start < at {
                return None;
            }
            let known =
                index.message_index_offsets.keys().all(|id| contents.channels.contains_key(id));
            if !known {
                return None;
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
        Some(contents)
    }

    /// By walking the whole file, looking into every chunk for its channels.
    fn walked_contents(&self) -> Contents {
        let mut contents = Contents::default();
        self.walk(mcap::MAGIC.len()..self.bytes.len(), &mut contents);
        if self.bytes.ends_with(mcap::MAGIC) && !summary_is_intact(self.bytes()) {
            contents
                .dropped
                .add("summaries that are damaged (the log was read without its index)", 1);
        }
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
        let data = records(self.bytes(), mcap::MAGIC.len()..self.bytes.len())
            .take_while(|record| record.opcode != op::DATA_END);
        let mut seen = Seen::new(self);
        for record in data {
            seen.reach(record.body.end);
            if matches!(record.opcode, op::SCHEMA | op::CHANNEL)
                && let Ok(parsed) = mcap::parse_record(record.opcode, &self.bytes()[record.body])
            {
                define(parsed);
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
        let to_end_of_file = range.end == self.bytes.len();
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
        if to_end_of_file && !(ended && self.bytes.ends_with(mcap::MAGIC)) {
            contents.dropped.add(CUT, 1);
            if !ended && self.bytes.get(at) == Some(&op::CHUNK) {
                let range = at..self.bytes.len();
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
            footer.summary_crc == 0 || footer.summary_crc == crc32fast::hash(&bytes[start..end])
        }
        _ => false,
    }
}

/// A top-level record: where its body lies.
struct RawRecord {
    opcode: u8,
    body: Range<usize>,
}

/// The record that starts at `at`; none where the file ends before it does.
fn record_at(bytes: &[u8], at: usize) -> Option<RawRecord> {
    let opcode = *bytes.get(at)?;
    let length = bytes.get(at + 1..at + 9)?.try_into().ok()?;
    let start = at + 9;
    let end = start.checked_add(usize::try_from(u64::from_le_bytes(length)).ok()?)?;
    (end <= bytes.len()).then_some(RawRecord { opcode, body: start..end })
}

/// The records that lie wholly within a stretch of the file.
fn records(bytes: &[u8], range: Range<usize>) -> impl Iterator<Item = RawRecord> {
    let mut at = range.start;
    std::iter::from_fn(move || {
        let record = record_at(&bytes[..range.end], at)?;
        at = record.body.end;
        Some(record)
    })
}
