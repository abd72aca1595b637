//! Record framing, and the pieces in which a log is read.

use std::collections::BTreeSet;
use std::ops::Range;

use mcap::records::op;

use crate::mcap::bytes::View;

/// A range of the file that contains messages.
#[derive(Debug, Clone)]
pub(crate) struct Piece {
    pub(crate) kind: PieceKind,
    pub(crate) range: Range<usize>,
    /// Channels with messages in the piece, if the index lists them.
    pub(crate) channels: Option<BTreeSet<u16>>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum PieceKind {
    /// The body of a complete chunk record.
    Chunk,
    /// A chunk record that the end of the file cuts off, from its opcode on.
    TruncatedChunk,
    /// Complete top-level records outside chunks, including messages.
    Records,
}

impl Piece {
    /// Whether the piece can contain messages of a wanted channel.
    pub(crate) fn may_hold(&self, is_wanted: impl Fn(u16) -> bool) -> bool {
        self.channels.as_ref().is_none_or(|ids| ids.iter().any(|&id| is_wanted(id)))
    }
}

/// Opcodes from this one on are for private records. Lower ones belong to the specification.
pub(crate) const FIRST_PRIVATE_OPCODE: u8 = 0x80;
/// The first opcode that the specification does not use.
pub(crate) const END_OF_OPCODES: u8 = op::DATA_END + 1;
/// Size of the opcode and the length of a record \[bytes\].
pub(crate) const RECORD_HEADER: usize = 9;

/// A top-level record: opcode and range of the body.
pub(crate) struct RawRecord {
    pub(crate) opcode: u8,
    pub(crate) body: Range<usize>,
}

/// The record that starts at `at`. `None` if it does not end before `end` or the end of the file.
pub(crate) fn record_at(view: &mut View<'_>, at: usize, end: usize) -> Option<RawRecord> {
    let start = at.checked_add(RECORD_HEADER).filter(|&start| start <= end)?;
    let (&opcode, length) = view.get(at..start)?.split_first()?;
    let length = u64::from_le_bytes(length.try_into().ok()?);
    let body_end = start.checked_add(usize::try_from(length).ok()?)?;
    (body_end <= end.min(view.len())).then_some(RawRecord { opcode, body: start..body_end })
}
