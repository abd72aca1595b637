//! The structure of an MCAP log: its channels, and the pieces that contain messages.
//!
//! The structure of an intact log is read from its summary. A log without a summary (truncated, or
//! the recorder crashed) is scanned record by record. Ranges of an intact log that no chunk index
//! covers are scanned too, because messages can lie outside chunks. No part of the file is skipped.

use std::collections::BTreeMap;
use std::io::SeekFrom;
use std::ops::Range;
use std::path::{Path, PathBuf};

use dataset::{LossKind, Losses};
use mcap::records::{Record, op};
use mcap::sans_io::summary_reader::{SummaryReadEvent, SummaryReader, SummaryReaderOptions};

use crate::error::IngestError;
use crate::mcap::bytes::{Changed, LogBytes, View};
use crate::mcap::chunk::{self, Buffer};
use crate::mcap::definitions::{Channel, Definitions, Redefined};
use crate::mcap::framing::{
    END_OF_OPCODES, FIRST_PRIVATE_OPCODE, Piece, PieceKind, RECORD_HEADER, RawRecord, record_at,
};
use crate::mcap::record;

/// A log: a file, or bytes in memory.
#[derive(Debug)]
pub struct Log {
    path: PathBuf,
    bytes: LogBytes,
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
    /// Channels with contradictory definitions.
    pub(crate) redefined: Vec<Redefined>,
    /// Number of messages of channels that the file does not define, as far as it is known.
    pub(crate) n_undefined: u64,
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
    /// Opens a file and checks that it starts with the MCAP magic bytes.
    ///
    /// The file must not be written while it is read: see [`Self::check_unchanged`].
    pub fn open(path: &Path) -> Result<Self, IngestError> {
        let failed = |source| IngestError::Open { path: path.to_owned(), source };
        Self::new(path, LogBytes::open(path).map_err(failed)?)
    }

    /// A log that is already in memory, for example one that was downloaded. `path` is its name in
    /// messages.
    pub fn from_bytes(path: &Path, bytes: Vec<u8>) -> Result<Self, IngestError> {
        Self::new(path, LogBytes::in_memory(bytes))
    }

    /// Checks that the bytes start with the MCAP magic bytes.
    fn new(path: &Path, bytes: LogBytes) -> Result<Self, IngestError> {
        let log = Self { path: path.to_owned(), bytes };
        let mut buffer = Vec::new();
        let magic = log.bytes.get(0..mcap::MAGIC.len(), &mut buffer);
        if magic != mcap::MAGIC {
            log.check_unchanged()?;
            let path = path.to_owned();
            let first = magic.iter().map(|b| format!("{b:02x}")).collect::<Vec<_>>();
            return Err(match first.is_empty() {
                true => IngestError::Empty { path },
                false => IngestError::NotMcap {
                    path,
                    found: format!(
                        "starts with {}, expected the magic bytes 89 4d 43 41 50 30 0d 0a",
                        first.join(" ")
                    ),
                    remedy:
                        "convert the recording to MCAP (`loopboost import`, `ros2 bag convert` \
                             or `mcap convert`)"
                            .to_owned(),
                },
            });
        }
        Ok(log)
    }

    /// The path of the file, or the name given to [`Self::from_bytes`].
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// The size of the log \[bytes\].
    pub fn n_bytes(&self) -> u64 {
        self.bytes.len() as u64
    }

    /// The bytes of the log.
    pub(crate) fn bytes(&self) -> &LogBytes {
        &self.bytes
    }

    /// Checks that no other program wrote to the file since it was opened, and that it could be read.
    /// Otherwise, what was read is not the content of one file.
    pub fn check_unchanged(&self) -> Result<(), IngestError> {
        let path = || self.path.clone();
        self.bytes.check_unchanged().map_err(|changed| match changed {
            Changed::Written(change) => IngestError::Changed { path: path(), change },
            Changed::Unreadable(source) => IngestError::Open { path: path(), source },
        })
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
        let mut view = View::new(&self.bytes);
        if !ends_with_magic(&mut view) {
            return Err(UnusableIndex::Missing); // counted as a truncated file
        }
        if !summary_is_intact(&mut view) {
            return Err(DAMAGED_SUMMARY);
        }
        let summary =
            read_summary(&mut view).map_err(|_| DAMAGED_SUMMARY)?.ok_or(UnusableIndex::Missing)?;
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
        let n_undefined = counts.map_or(0, |counts| {
            counts.iter().filter(|(id, _)| !channels.contains_key(id)).map(|(_, n)| n).sum()
        });
        let time_range_ns = time_range_ns(&summary);
        let mut contents = Contents { channels, time_range_ns, n_undefined, ..Contents::default() };
        let mut at = mcap::MAGIC.len();
        for index in indexes {
            let record = indexed_chunk(&mut view, index).ok_or(CONTRADICTORY_INDEX)?;
            let (start, end) = (record.body.start - RECORD_HEADER, record.body.end);
            if start < at {
                return Err(CONTRADICTORY_INDEX);
            }
            let known =
                index.message_index_offsets.keys().all(|id| contents.channels.contains_key(id));
            if !known {
                return Err(UnusableIndex::Missing);
            }
            scan(&mut view, at..start, &mut contents);
            contents.pieces.push(Piece {
                kind: PieceKind::Chunk,
                range: record.body,
                // A writer can leave out message indexes. Then the chunk can contain any channel.
                channels: (!index.message_index_offsets.is_empty())
                    .then(|| index.message_index_offsets.keys().copied().collect()),
            });
            at = end;
        }
        // Scan to the end of the data section or the end of the file, whichever comes first.
        scan(&mut view, at..self.bytes.len(), &mut contents);
        Ok(contents)
    }

    /// Reads the structure by scanning the whole file and the channels in every chunk.
    fn scanned_contents(&self) -> Contents {
        let mut contents = Contents::default();
        let mut view = View::new(&self.bytes);
        let end = self.bytes.len();
        scan(&mut view, mcap::MAGIC.len()..end, &mut contents);
        let mut definitions = Definitions::default();
        let mut counts: BTreeMap<u16, u64> = BTreeMap::new();
        // Stop at the end of the data section. The summary repeats these records and can be damaged.
        let mut at = mcap::MAGIC.len();
        while let Some(record) = record_at(&mut view, at, end)
            && record.opcode != op::DATA_END
        {
            at = record.body.end;
            if matches!(record.opcode, op::SCHEMA | op::CHANNEL) {
                let body = view.get(record.body).unwrap_or_default();
                match record::parse(record.opcode, body) {
                    Some(parsed) => definitions.add(parsed),
                    None => contents.losses.add(LossKind::MalformedRecords, 1),
                }
            }
        }
        let mut buffer = Buffer::default();
        let mut times = None;
        for piece in &contents.pieces {
            // Losses are counted later, when the messages are read.
            chunk::records(&self.bytes, piece, &mut buffer, |record| match record {
                Record::Message { header, .. } => {
                    *counts.entry(header.channel_id).or_default() += 1;
                    let (first, last) = times.unwrap_or((header.log_time, header.log_time));
                    times = Some((first.min(header.log_time), last.max(header.log_time)));
                }
                record => definitions.add(record),
            });
        }
        contents.time_range_ns = times;
        contents.channels = definitions.channels;
        contents.redefined = definitions.redefined;
        for (id, channel) in &mut contents.channels {
            channel.n_messages = Some(counts.remove(id).unwrap_or(0));
        }
        contents.n_undefined = counts.into_values().sum();
        contents
    }
}

/// Adds the messages and chunks in a range of top-level records.
fn scan(view: &mut View<'_>, range: Range<usize>, contents: &mut Contents) {
    let to_end_of_file = range.end == view.len();
    let mut at = range.start;
    let mut ended = false;
    // Adjacent messages outside chunks form one piece, up to a maximum size.
    let mut loose: Option<Range<usize>> = None;
    let piece = |kind, range| Piece { kind, range, channels: None };
    while let Some(record) = record_at(view, at, range.end) {
        let start = std::mem::replace(&mut at, record.body.end);
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
                contents.losses.add(LossKind::BytesAfterEnd, bytes_after_end(view, start));
                break;
            }
            _ => {}
        }
    }
    contents.pieces.extend(loose.map(|range| piece(PieceKind::Records, range)));
    if !to_end_of_file && at != range.end {
        contents.losses.add(LossKind::BytesBetweenChunks, 1);
    }
    if to_end_of_file && !(ended && ends_with_magic(view)) {
        contents.losses.add(LossKind::TruncatedFile, 1);
        if !ended && view.get(at..at.saturating_add(1)) == Some(&[op::CHUNK]) {
            contents.pieces.push(piece(PieceKind::TruncatedChunk, at..view.len()));
        }
    }
}

/// The number of bytes after the first footer and its magic bytes, from a position before it. Files that
/// were joined byte by byte have another log there.
fn bytes_after_end(view: &mut View<'_>, mut at: usize) -> u64 {
    while let Some(record) = record_at(view, at, view.len()) {
        at = record.body.end;
        // A damaged opcode in the summary is not a footer: magic bytes follow a footer.
        let end = at.saturating_add(mcap::MAGIC.len());
        if record.opcode == op::FOOTER && view.get(at..end) == Some(mcap::MAGIC) {
            return view.len().saturating_sub(end) as u64;
        }
    }
    0
}

fn ends_with_magic(view: &mut View<'_>) -> bool {
    let end = view.len();
    let start = end.saturating_sub(mcap::MAGIC.len());
    view.get(start..end) == Some(mcap::MAGIC)
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

/// Reads the summary, if there is one.
fn read_summary(view: &mut View<'_>) -> mcap::McapResult<Option<mcap::Summary>> {
    let n_bytes = view.len() as u64;
    let mut reader =
        SummaryReader::new_with_options(SummaryReaderOptions::default().with_file_size(n_bytes));
    let mut at = 0_usize;
    while let Some(event) = reader.next_event() {
        match event? {
            SummaryReadEvent::ReadRequest(n) => {
                let end = at.saturating_add(n).min(view.len());
                let bytes = view.get(at..end).unwrap_or_default();
                reader.insert(bytes.len()).copy_from_slice(bytes);
                reader.notify_read(bytes.len());
                at = end;
            }
            SummaryReadEvent::SeekRequest(to) => {
                let to = match to {
                    SeekFrom::Start(to) => Some(to),
                    SeekFrom::End(by) => n_bytes.checked_add_signed(by),
                    SeekFrom::Current(by) => (at as u64).checked_add_signed(by),
                };
                at = to.and_then(|to| usize::try_from(to).ok()).ok_or(mcap::McapError::BadIndex)?;
                reader.notify_seeked(at as u64);
            }
        }
    }
    Ok(reader.finish())
}

/// Whether the CRC of the summary matches, if there is one. It covers all bytes from the start of the
/// summary to the CRC itself (MCAP specification, "Footer"). A flipped bit in an index could hide
/// chunks.
fn summary_is_intact(view: &mut View<'_>) -> bool {
    /// Footer: opcode, length, start of the summary, start of the offsets, CRC.
    const FOOTER_BYTES: usize = RECORD_HEADER + 20;
    let Some(end) = view.len().checked_sub(mcap::MAGIC.len()) else { return false };
    let footer = end.checked_sub(FOOTER_BYTES).and_then(|at| record_at(view, at, end));
    let Some(footer) = footer.filter(|r| r.opcode == op::FOOTER && r.body.end == end) else {
        return false;
    };
    let Some(Record::Footer(footer)) =
        view.get(footer.body).and_then(|body| record::parse(op::FOOTER, body))
    else {
        return false;
    };
    let end = end - size_of::<u32>();
    match usize::try_from(footer.summary_start) {
        Ok(0) => true,
        Ok(start) if start <= end => {
            let crc = |bytes: &[u8]| footer.summary_crc == crc32fast::hash(bytes);
            let is_intact = footer.summary_crc == 0 || view.get(start..end).is_some_and(crc);
            is_intact && has_sound_records(view, start)
        }
        _ => false,
    }
}

/// Whether all records from a position on can be parsed. Private records are allowed and skipped.
fn has_sound_records(view: &mut View<'_>, mut at: usize) -> bool {
    while let Some(record) = record_at(view, at, view.len()) {
        at = record.body.end;
        let is_sound = |body: &[u8]| record::is_sound(record.opcode, body);
        if record.opcode < FIRST_PRIVATE_OPCODE && !view.get(record.body).is_some_and(is_sound) {
            return false;
        }
    }
    true
}

/// The chunk that an index points to. `None` if something else is there.
fn indexed_chunk(view: &mut View<'_>, index: &mcap::records::ChunkIndex) -> Option<RawRecord> {
    let start = usize::try_from(index.chunk_start_offset).ok()?;
    let end = start.checked_add(usize::try_from(index.chunk_length).ok()?)?;
    let record = record_at(view, start, end)?;
    (record.opcode == op::CHUNK && record.body.end == end).then_some(record)
}
