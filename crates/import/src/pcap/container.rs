//! Reads the frames of a capture file and their times.
//!
//! Sources: pcap-savefile(5) and draft-ietf-opsawg-pcapng ("PCAP Next Generation"). `pcap-parser`
//! reads the container and supports both byte orders, micro- and nanoseconds, sections and
//! interfaces. This file converts its blocks to frames and reports where reading stopped.

use std::io;
use std::path::{Path, PathBuf};

use dataset::{Loss, LossKind, Losses, Subject};
use pcap_parser::pcapng::{Block, EnhancedPacketBlock, OptionCode, PcapNGOption};
use pcap_parser::traits::PcapReaderIterator;
use pcap_parser::{LegacyPcapReader, Linktype, PcapBlockOwned, PcapError, PcapNGReader};

use crate::error::ImportError;
use crate::input::{Meter, Metered, bytes, file_name, read_full};

/// First four bytes of a libpcap file, in the byte order of the machine that wrote it
/// (pcap-savefile(5)): microseconds, nanoseconds, and Kuznetzov's modified format.
const PCAP_MAGICS: [u32; 3] = [0xA1B2_C3D4, 0xA1B2_3C4D, 0xA1B2_CD34];
/// First four bytes of a pcapng file: the type of its section header (draft-ietf-opsawg-pcapng,
/// section 4.1). They are the same in both byte orders.
const PCAPNG_MAGIC: u32 = 0x0A0D_0D0A;

/// Initial size of the buffer. An Ethernet frame has at most 1.5 kB.
const BUFFER_BYTES: usize = 1 << 18;
/// The largest block that is read. libpcap limits a packet to 256 KiB. A pcapng section can contain
/// larger blocks that are not packets.
const MAX_BUFFER_BYTES: usize = 1 << 24;
const SECOND_NS: i128 = 1_000_000_000;

/// Whether a file starts like a libpcap or pcapng capture.
pub(crate) fn is_capture(head: &[u8]) -> bool {
    head.first_chunk::<4>().is_some_and(|magic| {
        let (little, big) = (u32::from_le_bytes(*magic), u32::from_be_bytes(*magic));
        PCAP_MAGICS.contains(&little) || PCAP_MAGICS.contains(&big) || little == PCAPNG_MAGIC
    })
}

/// One captured frame.
pub(super) struct Frame<'a> {
    /// The capture time \[ns since the epoch\].
    pub stamp_ns: i64,
    pub link: Linktype,
    pub bytes: &'a [u8],
    /// Whether the capture contains only a part of the frame.
    pub is_truncated: bool,
}

/// How to read the frames of one interface.
#[derive(Debug, Clone, Copy)]
struct Interface {
    link: Linktype,
    /// The number of time units per second.
    units: u128,
    /// The offset that is added to the times \[s\].
    offset_s: i64,
}

/// The frames of a capture, in the order of the file.
pub(super) struct Frames {
    path: PathBuf,
    reader: Box<dyn PcapReaderIterator>,
    capacity: usize,
    /// The interfaces of the current section. A libpcap file has one.
    interfaces: Vec<Interface>,
    /// The byte order of the current section of a pcapng file.
    is_big_endian: bool,
    /// The bytes of the last frame.
    frame: Vec<u8>,
    ended: bool,
}

/// A block that does not borrow from the reader. The bytes of a packet are in [`Frames::frame`].
enum Event {
    Packet { interface: usize, ticks: u64, is_truncated: bool },
    Untimed,
    Other,
}

/// Why no block was read.
enum Stop {
    End,
    /// The file ends within a block.
    Truncated,
    Damaged,
    /// The buffer needs more bytes of the file.
    NeedsMore,
    /// The buffer is too small for the block.
    NeedsGrowth,
    ReadFailed,
}

impl Frames {
    pub fn open(path: &Path, meter: &Meter) -> Result<Self, ImportError> {
        let mut magic = [0; 4];
        read_full(&mut bytes(path, &Meter::default())?, &mut magic)
            .map_err(|source| ImportError::io("read", path, source))?;
        let file = Metered::open(path, meter)?;
        let reader: Result<Box<dyn PcapReaderIterator>, _> = match u32::from_le_bytes(magic) {
            PCAPNG_MAGIC => PcapNGReader::new(BUFFER_BYTES, file).map(|r| Box::new(r) as _),
            _ => LegacyPcapReader::new(BUFFER_BYTES, file).map(|r| Box::new(r) as _),
        };
        let reader = reader.map_err(|_| {
            ImportError::unexpected(
                path,
                "byte 0",
                "a truncated or damaged file header",
                "the header of a libpcap or pcapng file",
            )
        })?;
        Ok(Self {
            path: path.to_owned(),
            reader,
            capacity: BUFFER_BYTES,
            interfaces: Vec::new(),
            is_big_endian: false,
            frame: Vec::new(),
            ended: false,
        })
    }

    /// The next frame with a time. A truncated or damaged file ends at the damage, which is counted
    /// as a loss.
    pub fn next(&mut self, losses: &mut Losses) -> Result<Option<Frame<'_>>, ImportError> {
        while !self.ended {
            match self.event() {
                Ok(Event::Packet { interface, ticks, is_truncated }) => {
                    let Some(&interface) = self.interfaces.get(interface) else {
                        losses.add(self.loss(LossKind::PacketsOfUnknownInterface), 1);
                        continue;
                    };
                    let stamp_ns = interface.stamp_ns(ticks);
                    return Ok(Some(Frame {
                        stamp_ns,
                        link: interface.link,
                        bytes: &self.frame,
                        is_truncated,
                    }));
                }
                Ok(Event::Untimed) => losses.add(self.loss(LossKind::PacketsWithoutTime), 1),
                Ok(Event::Other) => {}
                Err(Stop::NeedsMore) => self.refill(losses)?,
                Err(Stop::NeedsGrowth) => self.grow(losses),
                Err(Stop::ReadFailed) => return Err(self.read_error()),
                Err(Stop::End) => self.ended = true,
                Err(Stop::Truncated) => {
                    losses.add(self.loss(LossKind::TruncatedCapture), 1);
                    self.ended = true;
                }
                Err(Stop::Damaged) => self.damaged(losses),
            }
        }
        Ok(None)
    }

    /// Reads the next block. The bytes of a packet are copied to `self.frame`.
    fn event(&mut self) -> Result<Event, Stop> {
        let Self { reader, interfaces, is_big_endian, frame, .. } = self;
        let (length, block) = match reader.next() {
            Ok(read) => read,
            Err(PcapError::Eof) => return Err(Stop::End),
            Err(PcapError::UnexpectedEof) => return Err(Stop::Truncated),
            Err(PcapError::Incomplete(_)) => return Err(Stop::NeedsMore),
            Err(PcapError::BufferTooSmall) => return Err(Stop::NeedsGrowth),
            Err(PcapError::ReadError) => return Err(Stop::ReadFailed),
            Err(_) => return Err(Stop::Damaged),
        };
        let event = match block {
            PcapBlockOwned::LegacyHeader(header) => {
                let nanoseconds = header.is_nanosecond_precision();
                let units = if nanoseconds { 1_000_000_000 } else { 1_000_000 };
                interfaces.push(Interface { link: header.network, units, offset_s: 0 });
                Event::Other
            }
            PcapBlockOwned::Legacy(block) => {
                frame.clear();
                frame.extend_from_slice(block.data);
                let units = interfaces.first().map_or(1, |interface| interface.units as u64);
                let ticks = u64::from(block.ts_sec) * units + u64::from(block.ts_usec);
                let is_truncated = block.caplen < block.origlen;
                Event::Packet { interface: 0, ticks, is_truncated }
            }
            PcapBlockOwned::NG(Block::SectionHeader(section)) => {
                interfaces.clear();
                *is_big_endian = section.big_endian();
                Event::Other
            }
            PcapBlockOwned::NG(Block::InterfaceDescription(block)) => {
                interfaces.push(Interface {
                    link: block.linktype,
                    units: units_per_second(block.if_tsresol),
                    offset_s: offset_s(&block.options, *is_big_endian),
                });
                Event::Other
            }
            PcapBlockOwned::NG(Block::EnhancedPacket(block)) => {
                frame.clear();
                frame.extend_from_slice(packet_data(&block));
                let ticks = u64::from(block.ts_high) << 32 | u64::from(block.ts_low);
                let is_truncated = block.caplen < block.origlen;
                Event::Packet { interface: block.if_id as usize, ticks, is_truncated }
            }
            PcapBlockOwned::NG(Block::SimplePacket(_)) => Event::Untimed,
            PcapBlockOwned::NG(_) => Event::Other,
        };
        reader.consume(length);
        Ok(event)
    }

    fn refill(&mut self, losses: &mut Losses) -> Result<(), ImportError> {
        let before = self.reader.data().len();
        if self.reader.refill().is_err() {
            return Err(self.read_error());
        }
        if self.reader.data().len() == before && !self.reader.reader_exhausted() {
            self.grow(losses);
        }
        Ok(())
    }

    fn grow(&mut self, losses: &mut Losses) {
        self.capacity *= 2;
        if MAX_BUFFER_BYTES < self.capacity || !self.reader.grow(self.capacity) {
            self.damaged(losses);
        }
    }

    fn damaged(&mut self, losses: &mut Losses) {
        let at_byte = self.reader.consumed() as u64;
        losses.add(self.loss(LossKind::DamagedCapture { at_byte }), 1);
        self.ended = true;
    }

    fn read_error(&self) -> ImportError {
        let cause = format!("the read failed after byte {}", self.reader.consumed());
        ImportError::io("read", &self.path, io::Error::other(cause))
    }

    fn loss(&self, kind: LossKind) -> Loss {
        Loss::new(kind, Subject::file(file_name(&self.path)))
    }
}

impl Interface {
    /// A time of this interface. A time that does not fit into 64 bits becomes the latest time, which
    /// no message can contain.
    fn stamp_ns(self, ticks: u64) -> i64 {
        // The product fits: 2^64 * 10^9 < 2^94.
        let ns = u128::from(ticks) * SECOND_NS as u128 / self.units.max(1);
        i64::try_from(ns as i128 + i128::from(self.offset_s) * SECOND_NS).unwrap_or(i64::MAX)
    }
}

/// The time units per second of the option `if_tsresol` (draft-ietf-opsawg-pcapng, section 4.2): a
/// negative power of 10, or of 2 if the highest bit is set. `pcap-parser` 0.17 does not read powers of
/// 2. Units finer than 128 bits can count make every time 0 s.
fn units_per_second(if_tsresol: u8) -> u128 {
    let exponent = u32::from(if_tsresol & 0x7F);
    let base: u128 = if if_tsresol & 0x80 == 0 { 10 } else { 2 };
    base.checked_pow(exponent).unwrap_or(u128::MAX)
}

/// The option `if_tsoffset` \[s\], which is in the byte order of the section. `pcap-parser` 0.17 reads
/// it as little endian.
fn offset_s(options: &[PcapNGOption<'_>], is_big_endian: bool) -> i64 {
    let offset = options.iter().find(|option| option.code == OptionCode::IfTsoffset);
    match offset.and_then(|option| option.value.first_chunk::<8>()) {
        Some(bytes) if is_big_endian => i64::from_be_bytes(*bytes),
        Some(bytes) => i64::from_le_bytes(*bytes),
        None => 0,
    }
}

/// The bytes of a packet without the padding.
fn packet_data<'a>(block: &EnhancedPacketBlock<'a>) -> &'a [u8] {
    block.data.get(..block.caplen as usize).unwrap_or(block.data)
}
