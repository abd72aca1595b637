//! Reads `velodyne_hits.bin`: the returns of the HDL-32E, packet by packet.
//!
//! Layout (the data set's `read_vel_hits.py`), little endian:
//!
//! ```text
//! 44444 u16 x 4 | number of hits u32 | utime u64 [us] | padding 4 bytes | hits (see `hit.rs`)
//! ```
//!
//! All hits of a packet have the time of the packet. A cloud contains one revolution, split at
//! azimuth 0.

use std::collections::VecDeque;
use std::io::BufReader;
use std::path::{Path, PathBuf};

use dataset::{Loss, LossKind, Losses, Subject};
use messages::hdl32e::{BLOCKS, LASERS};

use crate::error::ImportError;
use crate::input::{Meter, Metered, bytes, file_name, read_full};
use crate::options::Topic;
use crate::record::{Body, Point, Record, Source, is_representable};

use super::hit::{HIT_BYTES, Hit};
use super::revolution::Revolution;
use super::rings::{self, Rings};

/// The start of every packet: 44444 four times.
const MAGIC: [u8; 8] = [0x9C, 0xAD, 0x9C, 0xAD, 0x9C, 0xAD, 0x9C, 0xAD];
const HEADER_BYTES: usize = 24;
/// The maximum number of hits in a packet: two returns for each laser of each block.
const MAX_HITS: usize = BLOCKS * LASERS * 2;

/// Whether a file starts like `velodyne_hits.bin`.
pub(crate) fn is_hits(head: &[u8]) -> bool {
    head.starts_with(&MAGIC)
}

/// Reads one file of hits.
pub(super) struct Hits {
    path: PathBuf,
    reader: BufReader<Metered>,
    /// The number of bytes read.
    at: u64,
    body: Vec<u8>,
    revolution: Revolution,
    rings: Option<Rings>,
    ready: VecDeque<Record>,
    ended: bool,
}

/// The result of reading a packet.
enum Packet {
    Hits { stamp_ns: i64 },
    Skipped,
    End,
}

impl Hits {
    pub fn open(path: &Path, meter: &Meter) -> Result<Self, ImportError> {
        Ok(Self {
            path: path.to_owned(),
            reader: bytes(path, meter)?,
            at: 0,
            body: Vec::new(),
            revolution: Revolution::default(),
            rings: None,
            ready: VecDeque::new(),
            ended: false,
        })
    }

    fn loss(&self, kind: LossKind) -> Loss {
        Loss::new(kind, Subject::file(file_name(&self.path)))
    }

    /// Reads the next packet. Its hits are then in `self.body`.
    fn packet(&mut self, losses: &mut Losses) -> Result<Packet, ImportError> {
        let mut header = [0; HEADER_BYTES];
        let n = self.read(&mut header)?;
        if self.at == n as u64 && !is_hits(&header[..n]) {
            return Err(ImportError::unexpected(
                &self.path,
                "byte 0",
                format!("{:02x?}", &header[..n.min(MAGIC.len())]),
                "9c ad four times, the start of every packet of velodyne_hits.bin",
            ));
        }
        if n == 0 {
            return Ok(Packet::End);
        }
        if n < HEADER_BYTES {
            losses.add(self.loss(LossKind::TruncatedHits), 1);
            return Ok(Packet::End);
        }
        let n_hits = u32::from_le_bytes(header[8..12].try_into().expect("4 bytes")) as usize;
        let utime = u64::from_le_bytes(header[12..20].try_into().expect("8 bytes"));
        if !is_hits(&header) || MAX_HITS < n_hits {
            losses.add(self.loss(LossKind::BytesBetweenPackets), 1);
            return self.resynchronise(&header);
        }
        let mut body = std::mem::take(&mut self.body);
        body.resize(n_hits * HIT_BYTES, 0);
        let read = self.read(&mut body)?;
        self.body = body;
        if read < self.body.len() {
            losses.add(self.loss(LossKind::TruncatedHits), 1);
            return Ok(Packet::End);
        }
        let stamp_ns = i64::try_from(utime).ok().and_then(|us| us.checked_mul(1000));
        match stamp_ns.filter(|&stamp_ns| is_representable(stamp_ns)) {
            Some(stamp_ns) => Ok(Packet::Hits { stamp_ns }),
            None => {
                let kind = LossKind::TimesOutOfRange { item: "packet".to_owned() };
                losses.add(self.loss(kind), 1);
                Ok(Packet::Skipped)
            }
        }
    }

    /// Skips to the start of the next packet.
    fn resynchronise(&mut self, header: &[u8; HEADER_BYTES]) -> Result<Packet, ImportError> {
        // Skips the start of the damaged header, which may have the magic.
        let mut window: VecDeque<u8> = header[1..].iter().copied().collect();
        loop {
            let found = window.make_contiguous().windows(MAGIC.len()).position(|w| w == MAGIC);
            if let Some(found) = found {
                window.drain(..found);
                return self.step_back(window.len());
            }
            window.drain(..window.len() - (MAGIC.len() - 1));
            let mut more = [0; 256];
            let n = self.read(&mut more)?;
            if n == 0 {
                return Ok(Packet::End);
            }
            window.extend(&more[..n]);
        }
    }

    /// Moves the read position back by `n` bytes.
    fn step_back(&mut self, n: usize) -> Result<Packet, ImportError> {
        self.reader
            .seek_relative(-(n as i64))
            .map_err(|source| ImportError::io("read", &self.path, source))?;
        self.at -= n as u64;
        Ok(Packet::Skipped)
    }

    fn read(&mut self, buffer: &mut [u8]) -> Result<usize, ImportError> {
        let n = read_full(&mut self.reader, buffer)
            .map_err(|source| ImportError::io("read", &self.path, source))?;
        self.at += n as u64;
        Ok(n)
    }

    /// Adds the hits of the packet in `self.body`.
    fn push_packet(&mut self, stamp_ns: i64, losses: &mut Losses) {
        let body = std::mem::take(&mut self.body);
        for raw in body.chunks_exact(HIT_BYTES) {
            let hit = Hit::parse(stamp_ns, raw);
            if LASERS <= usize::from(hit.laser) {
                losses.add(self.loss(LossKind::HitsOfUnknownLaser), 1);
            } else if let Some(hits) = self.revolution.push(hit) {
                self.push_cloud(&hits, losses);
            }
        }
        self.body = body;
    }

    /// Queues the cloud of a revolution.
    fn push_cloud(&mut self, hits: &[Hit], losses: &mut Losses) {
        let Some(&Hit { stamp_ns, .. }) = hits.first() else { return };
        if self.rings.is_none() {
            self.rings = rings::identify(hits);
        }
        if self.rings.is_none() {
            losses.add(self.loss(LossKind::RingsByFileNumber), 1);
        }
        let points = hits.iter().map(|hit| Point {
            position: hit.position.map(|metres| metres as f32),
            intensity: f32::from(hit.intensity),
            ring: self.rings.map_or(u16::from(hit.laser), |rings| rings[usize::from(hit.laser)]),
            time: ((hit.stamp_ns - stamp_ns) as f64 * 1e-9) as f32,
        });
        let body = Body::Cloud(points.collect());
        self.ready.push_back(Record { topic: Topic::Points, stamp_ns, body });
    }
}

impl Source for Hits {
    fn next(&mut self, losses: &mut Losses) -> Result<Option<Record>, ImportError> {
        while self.ready.is_empty() && !self.ended {
            match self.packet(losses)? {
                Packet::Hits { stamp_ns } => self.push_packet(stamp_ns, losses),
                Packet::Skipped => {}
                Packet::End => {
                    self.ended = true;
                    let last = self.revolution.finish();
                    self.push_cloud(&last, losses);
                }
            }
        }
        Ok(self.ready.pop_front())
    }
}
