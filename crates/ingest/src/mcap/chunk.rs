//! Reads the messages of one piece of a log.

use std::borrow::Cow;
use std::io::Read;

use dataset::{LossKind, Losses};
use mcap::records::{MessageHeader, Record, op};
use zstd::zstd_safe::{DCtx, zstd_sys::ZSTD_ErrorCode};

use crate::mcap::bytes::LogBytes;
use crate::mcap::definitions::Definitions;
use crate::mcap::framing::{FIRST_PRIVATE_OPCODE, Piece, PieceKind, RECORD_HEADER};
use crate::mcap::record;

/// Maximum decompressed size of a chunk \[bytes\]. Writers make chunks of about 1 to 4 MB, so a larger
/// size in the header is an error.
const MAX_CHUNK_BYTES: u64 = 1 << 30;

/// The largest record of a chunk that is read \[bytes\]. Compressed data is hardly larger than the
/// decompressed data, and the header is small.
const MAX_CHUNK_RECORD_BYTES: usize = (MAX_CHUNK_BYTES + MAX_CHUNK_BYTES / 8) as usize;

/// Memory for a chunk is allocated at once up to this size, or up to this multiple of its compressed
/// size. Beyond that, it is allocated as decompressed bytes arrive. Chunks of packets compress by up
/// to a factor of 30.
const TRUSTED_BYTES: usize = 8 << 20;
const TRUSTED_RATIO: usize = 64;

/// Memory that a thread reuses for all chunks that it decompresses.
#[derive(Default)]
pub(crate) struct Buffer {
    bytes: Vec<u8>,
    zstd: Option<DCtx<'static>>,
    /// The bytes of the file.
    file: Vec<u8>,
}

/// What a piece contains besides its messages.
#[derive(Debug, Default)]
pub(crate) struct Rest {
    /// What could not be read.
    pub(crate) losses: Losses,
    /// The channels that the piece defines.
    pub(crate) definitions: Definitions,
}

/// Calls `visit` with the header and data of each message of a piece. Returns the rest.
pub(crate) fn messages(
    log: &LogBytes,
    piece: &Piece,
    buffer: &mut Buffer,
    mut visit: impl FnMut(&MessageHeader, &[u8]),
) -> Rest {
    let mut definitions = Definitions::default();
    let losses = records(log, piece, buffer, |record| match record {
        Record::Message { header, data } => visit(&header, &data),
        record => definitions.add(record),
    });
    Rest { losses, definitions }
}

/// Calls `visit` with each record of a piece. Returns what could not be read.
pub(crate) fn records(
    log: &LogBytes,
    piece: &Piece,
    buffer: &mut Buffer,
    mut visit: impl FnMut(Record<'_>),
) -> Losses {
    let mut losses = Losses::default();
    let mut range = piece.range.clone();
    // A longer chunk is refused, whatever its data is.
    if piece.kind != PieceKind::Records {
        range.end = range.end.min(range.start.saturating_add(MAX_CHUNK_RECORD_BYTES));
    }
    let is_oversized = range.end < piece.range.end;
    let mut file = std::mem::take(&mut buffer.file);
    let body = log.get(range, &mut file);
    match piece.kind {
        PieceKind::Chunk if is_oversized => {
            losses.add(LossKind::OversizedChunks { max_bytes: MAX_CHUNK_BYTES }, 1);
        }
        PieceKind::Records => visit_records(body, false, &mut visit, &mut losses),
        PieceKind::Chunk => visit_chunk(body, buffer, &mut visit, &mut losses),
        PieceKind::TruncatedChunk => match truncated_chunk(body) {
            // Only the record length says that more bytes follow. The data of the chunk is complete.
            Some(chunk) if chunk.is_complete => {
                visit_chunk(&body[RECORD_HEADER..], buffer, &mut visit, &mut losses);
            }
            Some(chunk) => visit_truncated_chunk(&chunk, &mut visit, &mut losses),
            None => {}
        },
    }
    buffer.file = file;
    losses
}

fn visit_chunk(
    body: &[u8],
    buffer: &mut Buffer,
    visit: &mut impl FnMut(Record<'_>),
    losses: &mut Losses,
) {
    match decompress(body, buffer) {
        Ok(records) => visit_records(records, true, visit, losses),
        Err(kind) => losses.add(kind, 1),
    }
}

/// Decompresses the records of a chunk and checks them against the CRC of the chunk.
fn decompress<'a>(body: &'a [u8], buffer: &'a mut Buffer) -> Result<&'a [u8], LossKind> {
    let Some(Record::Chunk { header, data: Cow::Borrowed(data) }) = record::parse(op::CHUNK, body)
    else {
        return Err(LossKind::MalformedChunks);
    };
    if MAX_CHUNK_BYTES < header.uncompressed_size {
        return Err(LossKind::OversizedChunks { max_bytes: MAX_CHUNK_BYTES });
    }
    let size = header.uncompressed_size as usize;
    let records: &[u8] = match header.compression.as_str() {
        "" => data,
        "zstd" => {
            buffer.zstd(size, data)?;
            &buffer.bytes
        }
        "lz4" => {
            buffer.lz4(size, data)?;
            &buffer.bytes
        }
        other => {
            let compression = other.to_owned();
            return Err(LossKind::ChunksOfUnknownCompression { compression });
        }
    };
    if records.len() != size {
        return Err(LossKind::ChunkLengthMismatch);
    }
    check_crc(header.uncompressed_crc, records)?;
    Ok(records)
}

/// Checks a CRC. 0 means that the writer did not compute one (MCAP specification, "Chunk").
fn check_crc(crc: u32, records: &[u8]) -> Result<(), LossKind> {
    match crc {
        0 => Ok(()),
        expected if expected == crc32fast::hash(records) => Ok(()),
        _ => Err(LossKind::ChunkCrcMismatch),
    }
}

impl Buffer {
    fn zstd(&mut self, size: usize, data: &[u8]) -> Result<(), LossKind> {
        let decompressor = match &mut self.zstd {
            Some(decompressor) => decompressor,
            none => none.insert(DCtx::try_create().ok_or(LossKind::UndecompressableChunks)?),
        };
        let mut allocated = initial_size(size, data);
        loop {
            reserve(&mut self.bytes, allocated)?;
            match decompressor.decompress(&mut self.bytes, data) {
                Ok(_) => return Ok(()),
                // All allocated bytes were filled, and more follow.
                Err(code) if code == BUFFER_TOO_SMALL && allocated < size => {
                    allocated = allocated.saturating_mul(4).min(size);
                }
                Err(_) => return Err(LossKind::UndecompressableChunks),
            }
        }
    }

    fn lz4(&mut self, size: usize, data: &[u8]) -> Result<(), LossKind> {
        reserve(&mut self.bytes, initial_size(size, data))?;
        let decoder = lz4::Decoder::new(data).map_err(|_| LossKind::UndecompressableChunks)?;
        // Reading one byte more than the header claims is enough to detect a wrong claim.
        decoder
            .take(size as u64 + 1)
            .read_to_end(&mut self.bytes)
            .map(|_| ())
            .map_err(|_| LossKind::UndecompressableChunks)
    }
}

/// The zstd error code for a buffer that is too small. Error codes are negated numbers.
const BUFFER_TOO_SMALL: usize =
    (ZSTD_ErrorCode::ZSTD_error_dstSize_tooSmall as usize).wrapping_neg();

/// The size to allocate first.
fn initial_size(size: usize, data: &[u8]) -> usize {
    size.min(TRUSTED_BYTES.max(data.len().saturating_mul(TRUSTED_RATIO)))
}

fn reserve(bytes: &mut Vec<u8>, size: usize) -> Result<(), LossKind> {
    bytes.clear();
    bytes.try_reserve(size).map_err(|_| LossKind::ChunksBeyondMemory)
}

/// Visits records one after another, borrowing from `records`.
fn visit_records(
    mut records: &[u8],
    in_chunk: bool,
    visit: &mut impl FnMut(Record<'_>),
    losses: &mut Losses,
) {
    while let Some((&opcode, rest)) = records.split_first() {
        let record = rest.split_first_chunk::<8>().and_then(|(length, rest)| {
            rest.split_at_checked(usize::try_from(u64::from_le_bytes(*length)).ok()?)
        });
        let Some((body, rest)) = record else {
            losses.add(LossKind::TruncatedChunks, 1);
            return;
        };
        records = rest;
        match opcode {
            // Channels and schemas outside chunks are read with the structure of the log.
            op::SCHEMA | op::CHANNEL if !in_chunk => {}
            op::SCHEMA | op::CHANNEL | op::MESSAGE => match record::parse(opcode, body) {
                Some(record) => visit(record),
                None => losses.add(LossKind::MalformedRecords, 1),
            },
            // A chunk must not contain any other record, except private ones.
            _ if in_chunk && opcode < FIRST_PRIVATE_OPCODE => {
                losses.add(LossKind::MisplacedRecords, 1);
            }
            _ => {}
        }
    }
}

/// The existing part of a chunk that the end of the file cuts off.
struct TruncatedChunk<'a> {
    /// Decompressed size in the header \[bytes\].
    size: u64,
    crc: u32,
    compression: &'a [u8],
    data: &'a [u8],
    /// Whether the data is complete.
    is_complete: bool,
}

/// Parses a chunk record, from its opcode on (MCAP specification, "Chunk").
fn truncated_chunk(bytes: &[u8]) -> Option<TruncatedChunk<'_>> {
    let (_header_and_times, rest) = bytes.split_at_checked(RECORD_HEADER + 8 + 8)?;
    let (size, rest) = rest.split_first_chunk::<8>()?;
    let (crc, rest) = rest.split_first_chunk::<4>()?;
    let (length, rest) = rest.split_first_chunk::<4>()?;
    let (compression, rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
    let (compressed_size, data) = rest.split_first_chunk::<8>()?;
    let is_complete = u64::from_le_bytes(*compressed_size) <= data.len() as u64;
    let (size, crc) = (u64::from_le_bytes(*size), u32::from_le_bytes(*crc));
    Some(TruncatedChunk { size, crc, compression, data, is_complete })
}

/// Visits the complete records of a truncated chunk. The CRC covers the whole chunk, so it can be
/// checked only if all records are there.
///
/// The rest after the last complete record is lost. It is not counted here, because the missing
/// footer is already counted.
fn visit_truncated_chunk(
    chunk: &TruncatedChunk<'_>,
    visit: &mut impl FnMut(Record<'_>),
    losses: &mut Losses,
) {
    let mut decompressed = Vec::new();
    let size = chunk.size.min(MAX_CHUNK_BYTES);
    // At the missing part, both decoders stop and keep what they have decompressed.
    let records = match chunk.compression {
        b"" => chunk.data,
        b"zstd" => {
            if let Ok(decoder) = zstd::Decoder::with_buffer(chunk.data) {
                let _ = decoder.take(size).read_to_end(&mut decompressed);
            }
            &decompressed
        }
        b"lz4" => {
            if let Ok(decoder) = lz4::Decoder::new(chunk.data) {
                let _ = decoder.take(size).read_to_end(&mut decompressed);
            }
            &decompressed
        }
        _ => return,
    };
    if let Some(all) = usize::try_from(chunk.size).ok().and_then(|size| records.get(..size))
        && let Err(kind) = check_crc(chunk.crc, all)
    {
        losses.add(kind, 1);
        return;
    }
    visit_records(records, true, visit, &mut Losses::default());
}
