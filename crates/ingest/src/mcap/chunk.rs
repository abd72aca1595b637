//! One piece of a log -> its messages.

use std::borrow::Cow;
use std::io::Read;

use dataset::Dropped;
use mcap::records::{MessageHeader, Record, op};
use zstd::zstd_safe::{DCtx, zstd_sys::ZSTD_ErrorCode};

use crate::mcap::framing::{FIRST_FREE_OPCODE, Piece, PieceKind, RECORD_HEADER};
use crate::mcap::record;

/// A chunk that claims to be larger than this when decompressed is not believed. Writers make
/// chunks of about 1 to 4 MB.
const MAX_CHUNK_BYTES: u64 = 1 << 30;

/// What a chunk claims is believed up to this size, or up to so many times its compressed size;
/// beyond, memory is taken as bytes come out. Chunks of packets shrink up to 30 times.
const BELIEVED_BYTES: usize = 8 << 20;
const BELIEVED_RATIO: usize = 64;

/// What one thread needs to decompress chunks, used again for each.
#[derive(Default)]
pub(crate) struct Buffer {
    bytes: Vec<u8>,
    zstd: Option<DCtx<'static>>,
}

/// Calls `visit` with header and data of each message of a piece; returns what could not be read.
pub(crate) fn messages(
    log: &[u8],
    piece: &Piece,
    buffer: &mut Buffer,
    mut visit: impl FnMut(&MessageHeader, &[u8]),
) -> Dropped {
    records(log, piece, buffer, |record| {
        if let Record::Message { header, data } = record {
            visit(&header, &data);
        }
    })
}

/// Calls `visit` with each record of a piece; returns what could not be read.
pub(crate) fn records(
    log: &[u8],
    piece: &Piece,
    buffer: &mut Buffer,
    mut visit: impl FnMut(Record<'_>),
) -> Dropped {
    let mut dropped = Dropped::default();
    let body = &log[piece.range.clone()];
    match piece.kind {
        PieceKind::Records => visit_records(body, false, &mut visit, &mut dropped),
        PieceKind::Chunk => whole_chunk_records(body, buffer, &mut visit, &mut dropped),
        PieceKind::CutChunk => match cut_chunk(body) {
            // Only its length says that it goes on.
            Some(chunk) if chunk.is_whole => {
                whole_chunk_records(&body[RECORD_HEADER..], buffer, &mut visit, &mut dropped);
            }
            Some(chunk) => cut_chunk_records(&chunk, &mut visit, &mut dropped),
            None => {}
        },
    }
    dropped
}

fn whole_chunk_records(
    body: &[u8],
    buffer: &mut Buffer,
    visit: &mut impl FnMut(Record<'_>),
    dropped: &mut Dropped,
) {
    match decompress(body, buffer) {
        Ok(records) => visit_records(records, true, visit, dropped),
        Err(reason) => dropped.add(format!("chunks {reason}"), 1),
    }
}

/// The records of a chunk, decompressed and checked against the chunk's CRC.
///
/// The error says what is wrong with the chunk ("that ...").
fn decompress<'a>(body: &'a [u8], buffer: &'a mut Buffer) -> Result<&'a [u8], String> {
    let Some(Record::Chunk { header, data: Cow::Borrowed(data) }) = record::parse(op::CHUNK, body)
    else {
        return Err("with a malformed header".to_owned());
    };
    if MAX_CHUNK_BYTES < header.uncompressed_size {
        return Err(format!("that claim more than {MAX_CHUNK_BYTES} bytes"));
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
        other => return Err(format!("of unknown compression `{other}`")),
    };
    if records.len() != size {
        return Err("whose length is not what their header says".to_owned());
    }
    check_crc(header.uncompressed_crc, records)?;
    Ok(records)
}

/// A CRC of 0 means that the writer made none (MCAP specification, "Chunk").
fn check_crc(crc: u32, records: &[u8]) -> Result<(), String> {
    match crc {
        0 => Ok(()),
        expected if expected == crc32fast::hash(records) => Ok(()),
        _ => Err("whose CRC does not match: their bytes were altered".to_owned()),
    }
}

const DAMAGED: &str = "that do not decompress";

impl Buffer {
    fn zstd(&mut self, size: usize, data: &[u8]) -> Result<(), String> {
        let decompressor = match &mut self.zstd {
            Some(decompressor) => decompressor,
            none => none.insert(DCtx::try_create().ok_or_else(|| DAMAGED.to_owned())?),
        };
        let mut believed = believed(size, data);
        loop {
            reserve(&mut self.bytes, believed)?;
            match decompressor.decompress(&mut self.bytes, data) {
                Ok(_) => return Ok(()),
                // So much did come out, and there is more.
                Err(code) if code == BUFFER_TOO_SMALL && believed < size => {
                    believed = believed.saturating_mul(4).min(size);
                }
                Err(_) => return Err(DAMAGED.to_owned()),
            }
        }
    }

    fn lz4(&mut self, size: usize, data: &[u8]) -> Result<(), String> {
        reserve(&mut self.bytes, believed(size, data))?;
        let decoder = lz4::Decoder::new(data).map_err(|_| DAMAGED.to_owned())?;
        // One byte more than claimed is enough to see that the claim is wrong.
        decoder
            .take(size as u64 + 1)
            .read_to_end(&mut self.bytes)
            .map(|_| ())
            .map_err(|_| DAMAGED.to_owned())
    }
}

/// zstd's codes of errors are their numbers, negated.
const BUFFER_TOO_SMALL: usize =
    (ZSTD_ErrorCode::ZSTD_error_dstSize_tooSmall as usize).wrapping_neg();

/// What to make room for at first.
fn believed(size: usize, data: &[u8]) -> usize {
    size.min(BELIEVED_BYTES.max(data.len().saturating_mul(BELIEVED_RATIO)))
}

fn reserve(bytes: &mut Vec<u8>, size: usize) -> Result<(), String> {
    bytes.clear();
    bytes
        .try_reserve(size)
        .map_err(|_| format!("that claim {size} bytes, more than this machine has"))
}

/// Walks the records of a decompressed chunk, borrowing from it.
fn visit_records(
    mut records: &[u8],
    in_chunk: bool,
    visit: &mut impl FnMut(Record<'_>),
    dropped: &mut Dropped,
) {
    while let Some((&opcode, rest)) = records.split_first() {
        let record = rest.split_first_chunk::<8>().and_then(|(length, rest)| {
            rest.split_at_checked(usize::try_from(u64::from_le_bytes(*length)).ok()?)
        });
        let Some((body, rest)) = record else {
            dropped.add("chunks that end in the middle of a record", 1);
            return;
        };
        records = rest;
        match opcode {
            // Outside chunks channels and schemas are read with the log's structure.
            op::SCHEMA | op::CHANNEL if !in_chunk => {}
            op::SCHEMA | op::CHANNEL | op::MESSAGE => match record::parse(opcode, body) {
                Some(record) => visit(record),
                None => dropped.add("records that are malformed", 1),
            },
            // Nothing else stands in a chunk, unless someone uses the opcodes that are free.
            _ if in_chunk && opcode < FIRST_FREE_OPCODE => {
                dropped.add("records of a kind that does not stand in chunks", 1);
            }
            _ => {}
        }
    }
}

/// A chunk that the end of the file cuts, as far as it is there.
struct CutChunk<'a> {
    /// When decompressed.
    size: u64,
    crc: u32,
    compression: &'a [u8],
    data: &'a [u8],
    /// Whether all its data is there.
    is_whole: bool,
}

/// Takes a chunk record apart, from its opcode on (MCAP specification, "Chunk").
fn cut_chunk(bytes: &[u8]) -> Option<CutChunk<'_>> {
    let (_header_and_times, rest) = bytes.split_at_checked(RECORD_HEADER + 8 + 8)?;
    let (size, rest) = rest.split_first_chunk::<8>()?;
    let (crc, rest) = rest.split_first_chunk::<4>()?;
    let (length, rest) = rest.split_first_chunk::<4>()?;
    let (compression, rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
    let (compressed_size, data) = rest.split_first_chunk::<8>()?;
    let is_whole = u64::from_le_bytes(*compressed_size) <= data.len() as u64;
    let (size, crc) = (u64::from_le_bytes(*size), u32::from_le_bytes(*crc));
    Some(CutChunk { size, crc, compression, data, is_whole })
}

/// The complete records of a chunk that is cut. Its checksum is of the whole: where the end of it is
/// missing, nothing vouches for them.
///
/// What follows the last complete record is lost, which the log's missing footer already tells.
fn cut_chunk_records(
    chunk: &CutChunk<'_>,
    visit: &mut impl FnMut(Record<'_>),
    dropped: &mut Dropped,
) {
    let mut decompressed = Vec::new();
    let size = chunk.size.min(MAX_CHUNK_BYTES);
    // Both read up to what is missing and keep what they have read.
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
        && let Err(reason) = check_crc(chunk.crc, all)
    {
        dropped.add(format!("chunks {reason}"), 1);
        return;
    }
    visit_records(records, true, visit, &mut Dropped::default());
}
