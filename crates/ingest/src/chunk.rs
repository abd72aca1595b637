//! One piece of a log -> its messages.

use std::borrow::Cow;
use std::io::Read;

use dataset::Dropped;
use mcap::records::{ChunkHeader, MessageHeader, Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};

use crate::log::{Piece, PieceKind};

/// A chunk that claims to be larger than this when decompressed is not believed. Writers make
/// chunks of about 1 to 4 MB.
const MAX_CHUNK_BYTES: u64 = 1 << 30;

/// What one thread needs to decompress chunks, used again for each.
#[derive(Default)]
pub(crate) struct Buffer {
    bytes: Vec<u8>,
    zstd: Option<zstd::bulk::Decompressor<'static>>,
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
        PieceKind::Records => visit_records(body, &mut visit, &mut dropped),
        PieceKind::CutChunk => cut_chunk_records(body, &mut visit),
        PieceKind::Chunk => match decompress(body, buffer) {
            Ok(records) => visit_records(records, &mut visit, &mut dropped),
            Err(reason) => dropped.add(format!("chunks {reason}"), 1),
        },
    }
    dropped
}

/// The records of a chunk, decompressed and checked against the chunk's CRC.
///
/// The error says what is wrong with the chunk ("that ...").
fn decompress<'a>(body: &'a [u8], buffer: &'a mut Buffer) -> Result<&'a [u8], String> {
    let Ok(Record::Chunk { header, data: Cow::Borrowed(data) }) =
        mcap::parse_record(op::CHUNK, body)
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
    check_crc(&header, records)?;
    Ok(records)
}

/// A CRC of 0 means that the writer made none (MCAP specification, "Chunk").
fn check_crc(header: &ChunkHeader, records: &[u8]) -> Result<(), String> {
    match header.uncompressed_crc {
        0 => Ok(()),
        expected if expected == crc32fast::hash(records) => Ok(()),
        _ => Err("whose CRC does not match: their bytes were altered".to_owned()),
    }
}

const DAMAGED: &str = "that do not decompress";

impl Buffer {
    fn zstd(&mut self, size: usize, data: &[u8]) -> Result<(), String> {
        if self.zstd.is_none() {
            self.zstd = zstd::bulk::Decompressor::new().ok();
        }
        self.reserve(size)?;
        let decompressor = self.zstd.as_mut().ok_or_else(|| DAMAGED.to_owned())?;
        decompressor
            .decompress_to_buffer(data, &mut self.bytes)
            .map(|_| ())
            .map_err(|_| DAMAGED.to_owned())
    }

    fn lz4(&mut self, size: usize, data: &[u8]) -> Result<(), String> {
        self.reserve(size)?;
        let decoder = lz4::Decoder::new(data).map_err(|_| DAMAGED.to_owned())?;
        // One byte more than claimed is enough to see that the claim is wrong.
        decoder
            .take(size as u64 + 1)
            .read_to_end(&mut self.bytes)
            .map(|_| ())
            .map_err(|_| DAMAGED.to_owned())
    }

    fn reserve(&mut self, size: usize) -> Result<(), String> {
        self.bytes.clear();
        self.bytes
            .try_reserve(size)
            .map_err(|_| format!("that claim {size} bytes, more than this machine has"))
    }
}

/// Walks the records of a decompressed chunk, borrowing from it.
fn visit_records(mut records: &[u8], visit: &mut impl FnMut(Record<'_>), dropped: &mut Dropped) {
    while let Some((&opcode, rest)) = records.split_first() {
        let record = rest.split_first_chunk::<8>().and_then(|(length, rest)| {
            rest.split_at_checked(usize::try_from(u64::from_le_bytes(*length)).ok()?)
        });
        let Some((body, rest)) = record else {
            dropped.add("chunks that end in the middle of a record", 1);
            return;
        };
        records = rest;
        // Message indexes do not stand in chunks; schemas and channels are read elsewhere too.
        match mcap::parse_record(opcode, body) {
            Ok(record) => visit(record),
            Err(_) => dropped.add("records that are malformed", 1),
        }
    }
}

/// The complete records of a chunk that the end of the file cuts; `bytes` starts at its opcode.
///
/// What follows the last complete record is lost, which the log's missing footer already tells.
fn cut_chunk_records(bytes: &[u8], visit: &mut impl FnMut(Record<'_>)) {
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true)
        .with_record_length_limit(MAX_CHUNK_BYTES as usize);
    let mut reader = LinearReader::new_with_options(options);
    let mut rest = bytes;
    while let Some(event) = reader.next_event() {
        match event {
            Ok(LinearReadEvent::ReadRequest(need)) => {
                let (now, later) = rest.split_at(need.min(rest.len()));
                reader.insert(now.len()).copy_from_slice(now);
                reader.notify_read(now.len());
                rest = later;
            }
            Ok(LinearReadEvent::Record { data, opcode }) => {
                if let Ok(record) = mcap::parse_record(opcode, data) {
                    visit(record);
                }
            }
            Err(_) => return,
        }
    }
}
