//! A capture file -> frames with their times.
//!
//! Sources: pcap-savefile(5) and draft-ietf-opsawg-pcapng ("PCAP Next Generation"). The container
//! is read by `pcap-parser`, which knows both byte orders, micro- and nanoseconds, sections and
//! interfaces; this file turns its blocks into frames and says what stopped it.

use std::io;
use std::path::{Path, PathBuf};

use pcap_parser::pcapng::{Block, EnhancedPacketBlock};
use pcap_parser::traits::PcapReaderIterator;
use pcap_parser::{LegacyPcapReader, Linktype, PcapBlockOwned, PcapError, PcapNGReader};

use crate::error::ImportError;
use crate::input::{Meter, Metered, bytes, read_full};
use crate::recognise::PCAPNG_MAGIC;
use crate::record::Losses;

/// Buffer to begin with; a frame of Ethernet takes 1.5 kB.
const BUFFER_BYTES: usize = 1 << 18;
/// The largest record that is read. libpcap writes no snapshot above 256 KiB; a pcapng section can
/// hold larger blocks that are no packets.
const MAX_BUFFER_BYTES: usize = 1 << 24;
const SECOND_NS: i128 = 1_000_000_000;

/// One captured frame.
pub(super) struct Frame<'a> {
    /// When it was captured \[ns since the epoch\].
    pub stamp_ns: i64,
    pub link: Linktype,
    pub bytes: &'a [u8],
    /// Whether the capture kept less than was on the wire.
    pub cut: bool,
}

/// What tells how to read the frames of one interface.
#[derive(Debug, Clone, Copy)]
struct Interface {
    link: Linktype,
    /// Units of its times in a second.
    units: u64,
    /// Added to its times \[s\].
    offset_s: i64,
}

/// The frames of a capture, in the order of the file.
pub(super) struct Frames {
    path: PathBuf,
    reader: Box<dyn PcapReaderIterator>,
    capacity: usize,
    /// Of the section under way; a libpcap file has one.
    interfaces: Vec<Interface>,
    /// The frame handed out last.
    frame: Vec<u8>,
    ended: bool,
}

/// A block without its borrow of the reader; a packet's bytes lie in [`Frames::frame`].
enum Event {
    Packet { interface: usize, ticks: u64, cut: bool },
    Untimed,
    Other,
}

/// Why there is no block.
enum Stop {
    End,
    Cut,
    Damaged,
    More,
    Grow,
    Read,
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
            ImportError::foreign(
                path,
                "byte 0",
                "a file header that is cut or damaged",
                "the header of a libpcap or pcapng file",
            )
        })?;
        Ok(Self {
            path: path.to_owned(),
            reader,
            capacity: BUFFER_BYTES,
            interfaces: Vec::new(),
            frame: Vec::new(),
            ended: false,
        })
    }

    /// The next frame that has a time. A file that is cut or damaged ends there; that is counted.
    pub fn next(&mut self, losses: &mut Losses) -> Result<Option<Frame<'_>>, ImportError> {
        while !self.ended {
            match self.event() {
                Ok(Event::Packet { interface, ticks, cut }) => {
                    let Some(&interface) = self.interfaces.get(interface) else {
                        losses.dropped.add("packets of an interface that is not described", 1);
                        continue;
                    };
                    let stamp_ns = interface.stamp_ns(ticks);
                    return Ok(Some(Frame {
                        stamp_ns,
                        link: interface.link,
                        bytes: &self.frame,
                        cut,
                    }));
                }
                Ok(Event::Untimed) => {
                    losses.dropped.add("packets without a time (simple packet blocks)", 1);
                }
                Ok(Event::Other) => {}
                Err(Stop::More) => self.refill(losses)?,
                Err(Stop::Grow) => self.grow(losses),
                Err(Stop::Read) => return Err(self.read_error()),
                Err(Stop::End) => self.ended = true,
                Err(Stop::Cut) => {
                    losses.dropped.add("captures cut within a packet (what is whole is kept)", 1);
                    self.ended = true;
                }
                Err(Stop::Damaged) => self.damaged(losses),
            }
        }
        Ok(None)
    }

    /// The next block; a packet is copied out of the reader.
    fn event(&mut self) -> Result<Event, Stop> {
        let Self { reader, interfaces, frame, .. } = self;
        let (length, block) = match reader.next() {
            Ok(read) => read,
            Err(PcapError::Eof) => return Err(Stop::End),
            Err(PcapError::UnexpectedEof) => return Err(Stop::Cut),
            Err(PcapError::Incomplete(_)) => return Err(Stop::More),
            Err(PcapError::BufferTooSmall) => return Err(Stop::Grow),
            Err(PcapError::ReadError) => return Err(Stop::Read),
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
                let units = interfaces.first().map_or(1, |interface| interface.units);
                let ticks = u64::from(block.ts_sec) * units + u64::from(block.ts_usec);
                Event::Packet { interface: 0, ticks, cut: block.caplen < block.origlen }
            }
            PcapBlockOwned::NG(Block::SectionHeader(_)) => {
                interfaces.clear();
                Event::Other
            }
            PcapBlockOwned::NG(Block::InterfaceDescription(block)) => {
                interfaces.push(Interface {
                    link: block.linktype,
                    // A resolution beyond 64 bits: such times mean nothing.
                    units: block.ts_resolution().unwrap_or(u64::MAX),
                    offset_s: block.ts_offset(),
                });
                Event::Other
            }
            PcapBlockOwned::NG(Block::EnhancedPacket(block)) => {
                frame.clear();
                frame.extend_from_slice(packet_data(&block));
                let ticks = u64::from(block.ts_high) << 32 | u64::from(block.ts_low);
                let cut = block.caplen < block.origlen;
                Event::Packet { interface: block.if_id as usize, ticks, cut }
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
        let reason = format!(
            "captures damaged at byte {} ({}; what comes before is kept)",
            self.reader.consumed(),
            crate::file_name(&self.path)
        );
        losses.dropped.add(reason, 1);
        self.ended = true;
    }

    fn read_error(&self) -> ImportError {
        let place = format!("reading failed after byte {}", self.reader.consumed());
        ImportError::io("read", &self.path, io::Error::other(place))
    }
}

impl Interface {
    /// A time of this interface; one that does not fit is far beyond all that can be written.
    fn stamp_ns(self, ticks: u64) -> i64 {
        let ns = i128::from(ticks) * SECOND_NS / i128::from(self.units.max(1));
        i64::try_from(ns + i128::from(self.offset_s) * SECOND_NS).unwrap_or(i64::MAX)
    }
}

/// A packet's bytes without the padding.
fn packet_data<'a>(block: &EnhancedPacketBlock<'a>) -> &'a [u8] {
    block.data.get(..block.caplen as usize).unwrap_or(block.data)
}
