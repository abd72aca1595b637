//! How records are framed in the file, and the pieces in which a log is read.

use std::collections::BTreeSet;
use std::ops::Range;

use mcap::records::op;

/// A stretch of the file that holds messages.
#[derive(Debug, Clone)]
pub(crate) struct Piece {
    pub(crate) kind: PieceKind,
    pub(crate) range: Range<usize>,
    /// Channels with messages in it, where the index says so.
    pub(crate) channels: Option<BTreeSet<u16>>,
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

/// Opcodes from here on are for private records, below for those of the specification.
pub(crate) const FIRST_FREE_OPCODE: u8 = 0x80;

/// Bytes of a record's opcode and length.
pub(crate) const RECORD_HEADER: usize = 9;
/// The opcodes of the specification end before this one.
pub(crate) const END_OF_OPCODES: u8 = op::DATA_END + 1;

/// A top-level record: where its body lies.
pub(crate) struct RawRecord {
    pub(crate) opcode: u8,
    pub(crate) body: Range<usize>,
}

/// The record that starts at `at`; none where the file ends before it does.
pub(crate) fn record_at(bytes: &[u8], at: usize) -> Option<RawRecord> {
    let opcode = *bytes.get(at)?;
    let start = at.checked_add(RECORD_HEADER)?;
    let length = bytes.get(at + 1..start)?.try_into().ok()?;
    let end = start.checked_add(usize::try_from(u64::from_le_bytes(length)).ok()?)?;
    (end <= bytes.len()).then_some(RawRecord { opcode, body: start..end })
}

/// The records that lie wholly within a stretch of the file.
pub(crate) fn records(bytes: &[u8], range: Range<usize>) -> impl Iterator<Item = RawRecord> {
    let mut at = range.start;
    std::iter::from_fn(move || {
        let record = record_at(&bytes[..range.end], at)?;
        at = record.body.end;
        Some(record)
    })
}
