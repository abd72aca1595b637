//! The structure of an MCAP log: its channels, and the pieces that contain messages.
//!
//! The structure of an intact log is read from its summary. A log without a summary (truncated, or
//! the recorder crashed) is scanned record by record. Ranges of an intact log that no chunk index
//! covers are scanned too, because messages can lie outside chunks. No part of the file is skipped.

use std::collections::BTreeMap;
use std::fs::File;
use std::ops::Range;
use std::path::{Path, PathBuf};

use dataset::{LossKind, Losses};
use mcap::records::{Record, op};
use memmap2::{Advice, Mmap, UncheckedAdvice};
use messages::Source;

use crate::error::IngestError;
use crate::mcap::chunk::{self, Buffer};
use crate::mcap::framing::{
    END_OF_OPCODES, FIRST_PRIVATE_OPCODE, Piece, PieceKind, RECORD_HEADER, RawRecord, record_at,
    records,
};
use crate::mcap::record;

/// A log: a memory-mapped file, or bytes in memory.
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
    /// The encoding of its messages, such as `cdr` or `ros1`.
    pub message_encoding: String,
    /// The name of the schema, empty if the channel has none.
    pub schema: String,
    /// Number of messages, if the log contains it.
    pub n_messages: Option<u64>,
}

/// The structure of a log.
#[derive(Debug, Clone, Default)]
pub struct Contents {
    /// Channels by their id.
    pub channels: BTreeMap<u16, Channel>,
    /// Time of the first and the last message \[ns\].
    pub time_range_ns: Option<(u64, u64)>,
    /// Damage in the structure of the log.
    pub losses: Losses,
    pub(crate) pieces: Vec<Piece>,
}

/// Messages outside chunks are read in pieces of about this size \[bytes\].
const LOOSE_PIECE_BYTES: usize = 1 << 20;

/// Why the index of a log cannot be used.
enum UnusableIndex {
    /// There is no index, or it does not list all channels.
    Missing,
    /// The index is damaged.
    Damaged(LossKind),
}

const DAMAGED_SUMMARY: UnusableIndex = UnusableIndex::Damaged(LossKind::DamagedSummary);
const CONTRADICTORY_INDEX: UnusableIndex = UnusableIndex::Damaged(LossKind::ContradictoryIndex);

impl Log {
    /// Maps a file into memory and checks that it starts with the MCAP magic bytes.
    pub fn open(path: &Path) -> Result<Self, IngestError> {
        let failed = |source| IngestError::Open { path: path.to_owned(), source };
        let file = File::open(path).map_err(failed)?;
        // SAFETY: the map is read-only. If another process truncates the file while it is mapped, the
        // operating system kills this process. Logs that are still being written are not supported.
        let bytes = unsafe { Mmap::map(&file) }.map_err(failed)?;
        // The advice is only a hint, so an error does not matter.
        let _ = bytes.advise(Advice::Sequential);
        Self::new(path, Bytes::Mapped(bytes))
    }

    /// A log that is already in memory, for example one that was downloaded. `path` is its name in
    /// messages.
    pub fn from_bytes(path: &Path, bytes: Vec<u8>) -> Result<Self, IngestError> {
        Self::new(path, Bytes::Owned(bytes))
    }

    /// Checks that the bytes start with the MCAP magic bytes.
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

    /// The path of the file, or the name given to [`Self::from_bytes`].
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The bytes of the log.
    pub fn bytes(&self) -> &[u8] {
        match &self.bytes {
            Bytes::Mapped(bytes) => bytes,
            Bytes::Owned(bytes) => bytes,
        }
    }

    /// Tells the operating system that the bytes before `end` need not stay in memory.
    pub(crate) fn forget_up_to(&self, end: usize) {
        let Bytes::Mapped(bytes) = &self.bytes else { return };
        const PAGE: usize = 4096;
        let whole_pages = end / PAGE * PAGE;
        // SAFETY: the map is read-only and shared. A page dropped here is read again on access.
        let _ = unsafe { bytes.unchecked_advise_range(UncheckedAdvice::DontNeed, 0, whole_pages) };
    }

    /// Reads the structure of the log, but not its messages.
    pub fn contents(&self) -> Contents {
        self.indexed_contents().unwrap_or_else(|unusable| {
            let mut contents = self.scanned_contents();
            if let UnusableIndex::Damaged(kind) = unusable {
                contents.losses.add(kind, 1);
            }
            contents
        })
    }

    /// Reads the structure from the summary.
    fn indexed_contents(&self) -> Result<Contents, UnusableIndex> {
        let bytes = self.bytes();
        if !bytes.ends_with(mcap::MAGIC) {
            return Err(UnusableIndex::Missing); // counted as a truncated file
        }
        if !summary_is_intact(bytes) {
            return Err(DAMAGED_SUMMARY);
        }
        let summary = mcap::Summary::read(bytes)
            .map_err(|_| DAMAGED_SUMMARY)?
            .ok_or(UnusableIndex::Missing)?;
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

        // A writer can leave the channels out of the summary. Then they are found by scanning.
        let n_channels = summary.stats.as_ref().map_or(0, |stats| stats.channel_count as usize);
        if channels.is_empty() || channels.len() < n_channels {
            return Err(UnusableIndex::Missing);
        }
        let mut indexes: Vec<_> = summary.chunk_indexes.iter().collect();
        indexes.sort_by_key(|index| index.chunk_start_offset);
        let mut contents =
            Contents { channels, time_range_ns: time_range_ns(&summary), ..Contents::default() };
        let mut at = mcap::MAGIC.len();
        let mut seen = Seen::new(self);
        for index in indexes {
            let record = indexed_chunk(bytes, index).ok_or(CONTRADICTORY_INDEX)?;
            let (start, end) = (record.body.start - RECORD_HEADER, record.body.end);
            if start < at {
                return Err(CONTRADICTORY_INDEX);
            }
            let known =
                index.message_index_offsets.keys().all(|id| contents.channels.contains_key(id));
            if !known {
                return Err(UnusableIndex::Missing);
            }
            self.scan(at..start, &mut contents);
            contents.pieces.push(Piece {
                kind: PieceKind::Chunk,
                range: record.body,
                // A writer can leave out message indexes. Then the chunk can contain any channel.
                channels: (!index.message_index_offsets.is_empty())
                    .then(|| index.message_index_offsets.keys().copied().collect()),
            });
            at = end;
            seen.reach(at);
        }
        // Scan to the end of the data section or the end of the file, whichever comes first.
        self.scan(at..bytes.len(), &mut contents);
        Ok(contents)
    }

    /// Reads the structure by scanning the whole file and the channels in every chunk.
    fn scanned_contents(&self) -> Contents {
        let mut contents = Contents::default();
        self.scan(mcap::MAGIC.len()..self.bytes().len(), &mut contents);
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
        // Stop at the end of the data section. The summary repeats these records and can be damaged.
        let data = records(self.bytes(), mcap::MAGIC.len()..self.bytes().len())
            .take_while(|record| record.opcode != op::DATA_END);
        let mut seen = Seen::new(self);
        for record in data {
            seen.reach(record.body.end);
            if matches!(record.opcode, op::SCHEMA | op::CHANNEL) {
                match record::parse(record.opcode, &self.bytes()[record.body]) {
                    Some(parsed) => define(parsed),
                    None => contents.losses.add(LossKind::MalformedRecords, 1),
                }
            }
        }
        let mut buffer = Buffer::default();
        let mut seen = Seen::new(self);
        for piece in &contents.pieces {
            seen.reach(piece.range.end);
            // Losses are counted later, when the messages are read.
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

    /// Adds the messages and chunks in a range of top-level records.
    fn scan(&self, range: Range<usize>, contents: &mut Contents) {
        let to_end_of_file = range.end == self.bytes().len();
        let mut at = range.start;
        let mut ended = false;
        // Adjacent messages outside chunks form one piece, up to a maximum size.
        let mut loose: Option<Range<usize>> = None;
        let piece = |kind, range| Piece { kind, range, channels: None };
        let mut seen = Seen::new(self);
        for record in records(self.bytes(), range.clone()) {
            let start = std::mem::replace(&mut at, record.body.end);
            seen.reach(at);
            match record.opcode {
                op::MESSAGE => {
                    let range = loose.get_or_insert(start..start);
                    range.end = at;
                    if range.len() < LOOSE_PIECE_BYTES {
                        continue;
                    }
                }
                op::CHUNK | op::DATA_END | op::FOOTER => {}
                0 | END_OF_OPCODES..FIRST_PRIVATE_OPCODE => {
                    contents.losses.add(LossKind::UnknownRecords, 1);
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
            contents.losses.add(LossKind::BytesBetweenChunks, 1);
        }
        if to_end_of_file && !(ended && self.bytes().ends_with(mcap::MAGIC)) {
            contents.losses.add(LossKind::TruncatedFile, 1);
            if !ended && self.bytes().get(at) == Some(&op::CHUNK) {
                let range = at..self.bytes().len();
                contents.pieces.push(piece(PieceKind::TruncatedChunk, range));
            }
        }
    }
}

/// Releases the pages of the file while its structure is read. Reading one byte of a chunk loads 16
/// pages around it, which adds up for many chunks.
struct Seen<'a> {
    log: &'a Log,
    forgotten: usize,
}

impl<'a> Seen<'a> {
    /// Pages are released whenever this many bytes have been passed.
    const INTERVAL: usize = 64 << 20;

    fn new(log: &'a Log) -> Self {
        Self { log, forgotten: 0 }
    }

    fn reach(&mut self, end: usize) {
        if self.forgotten + Self::INTERVAL < end {
            self.log.forget_up_to(end);
            self.forgotten = end;
        }
    }
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
}

/// Time of the first and the last message, from the statistics or else the chunk indexes.
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

/// Whether the CRC of the summary matches, if there is one. It covers all bytes from the start of the
/// summary to the CRC itself (MCAP specification, "Footer"). A flipped bit in an index could hide
/// chunks.
fn summary_is_intact(bytes: &[u8]) -> bool {
    let Ok(footer) = mcap::read::footer(bytes) else { return false };
    let end = bytes.len() - mcap::MAGIC.len() - size_of::<u32>();
    match usize::try_from(footer.summary_start) {
        Ok(0) => true,
        Ok(start) if start <= end => {
            let is_intact = footer.summary_crc == 0
                || footer.summary_crc == crc32fast::hash(&bytes[start..end]);
            // Private records are allowed and skipped.
            let is_sound = |raw: RawRecord| {
                FIRST_PRIVATE_OPCODE <= raw.opcode || record::is_sound(raw.opcode, &bytes[raw.body])
            };
            is_intact && records(bytes, start..bytes.len()).all(is_sound)
        }
        _ => false,
    }
}

/// The chunk that an index points to. `None` if something else is there.
fn indexed_chunk(bytes: &[u8], index: &mcap::records::ChunkIndex) -> Option<RawRecord> {
    let start = usize::try_from(index.chunk_start_offset).ok()?;
    let end = start.checked_add(usize::try_from(index.chunk_length).ok()?)?;
    let record = record_at(bytes, start)?;
    (record.opcode == op::CHUNK && record.body.end == end).then_some(record)
}
