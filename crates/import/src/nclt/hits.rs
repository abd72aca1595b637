//! `velodyne_hits.bin`: the returns of the HDL-32E, packet by packet.
//!
//! Layout (the data set's `read_vel_hits.py`), little endian:
//!
//! ```text
//! packet:  44444 u16 x 4 | number of hits u32 | utime u64 [us] | padding 4 bytes | hits
//! hit:     x, y, z u16 [5 mm from -100 m] | intensity u8 | laser u8
//! ```
//!
//! The hits are in the sensor's frame. The data set's calibration places it in the body (x forward,
//! y right, z down) by the rotation (0.807, 0.166, -90.703) deg, so its y points forward, its x
//! left, its z down: an HDL-32E, which has x right, y forward, z up, hung upside down. Written are
//! x forward (their y), y left (their x), z up (minus their z).
//!
//! All hits of a packet have the packet's time.

use std::collections::VecDeque;
use std::f64::consts::{PI, TAU};
use std::io::BufReader;
use std::path::{Path, PathBuf};

use messages::hdl32e::{BLOCKS, LASERS};

use crate::error::ImportError;
use crate::input::{Meter, Metered, bytes, read_full};
use crate::options::Topic;
use crate::record::{Body, Losses, Point, Record, Source, representable};

use super::rings::{self, Rings};

/// Starts every packet: 44444 four times.
const MAGIC: [u8; 8] = [0x9C, 0xAD, 0x9C, 0xAD, 0x9C, 0xAD, 0x9C, 0xAD];
const HEADER_BYTES: usize = 24;
const HIT_BYTES: usize = 8;
/// Hits in a packet at most: one for each laser of each block, with room for two returns.
const MAX_HITS: usize = BLOCKS * LASERS * 2;
const METRES_PER_COUNT: f64 = 0.005;
const OFFSET_M: f64 = -100.0;
/// A turn does not span a longer pause \[ns\]: the slowest, at 5 Hz, takes 0.2 s.
const MAX_PAUSE_NS: u64 = 200_000_000;
/// Hits of a turn at most: twice what an HDL-32E can return at 5 Hz (1.39 million points a second).
const MAX_TURN_HITS: usize = 560_000;
/// Nearer than this there is no direction to a hit \[m\].
const MIN_LEVEL_M: f64 = 0.05;

/// One return, in x-forward, y-left, z-up axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Hit {
    pub stamp_ns: i64,
    /// \[m\]
    pub position: [f64; 3],
    pub intensity: u8,
    pub laser: u8,
}

/// Whether a file starts as one of hits does.
pub(crate) fn is_hits(head: &[u8]) -> bool {
    head.starts_with(&MAGIC)
}

/// One file of hits.
pub(super) struct Hits {
    path: PathBuf,
    reader: BufReader<Metered>,
    /// Bytes read.
    at: u64,
    body: Vec<u8>,
    turn: Turn,
    rings: Option<Rings>,
    ready: VecDeque<Record>,
    ended: bool,
}

/// What follows in the file.
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
            turn: Turn::default(),
            rings: None,
            ready: VecDeque::new(),
            ended: false,
        })
    }

    /// Reads the next packet; its hits lie in `self.body` then.
    fn packet(&mut self, losses: &mut Losses) -> Result<Packet, ImportError> {
        let mut header = [0; HEADER_BYTES];
        let n = self.read(&mut header)?;
        if self.at == n as u64 && !is_hits(&header[..n]) {
            return Err(ImportError::foreign(
                &self.path,
                "byte 0",
                format!("{:02x?}", &header[..n.min(MAGIC.len())]),
                "9c ad four times, which starts every packet of velodyne_hits.bin",
            ));
        }
        if n == 0 {
            return Ok(Packet::End);
        }
        if n < HEADER_BYTES {
            losses.dropped.add(CUT, 1);
            return Ok(Packet::End);
        }
        let n_hits = u32::from_le_bytes(header[8..12].try_into().expect("4 bytes")) as usize;
        let utime = u64::from_le_bytes(header[12..20].try_into().expect("8 bytes"));
        if !is_hits(&header) || MAX_HITS < n_hits {
            losses.dropped.add("stretches of velodyne_hits.bin that are no packets", 1);
            return self.resynchronise(&header);
        }
        let mut body = std::mem::take(&mut self.body);
        body.resize(n_hits * HIT_BYTES, 0);
        let read = self.read(&mut body)?;
        self.body = body;
        if read < self.body.len() {
            losses.dropped.add(CUT, 1);
            return Ok(Packet::End);
        }
        let stamp_ns = i64::try_from(utime).ok().and_then(|us| us.checked_mul(1000));
        match stamp_ns.filter(|&stamp_ns| representable(stamp_ns)) {
            Some(stamp_ns) => Ok(Packet::Hits { stamp_ns }),
            None => {
                losses.dropped.add("packets of hits before 1970 or after 2037", 1);
                Ok(Packet::Skipped)
            }
        }
    }

    /// Reads up to where the next packet starts.
    fn resynchronise(&mut self, header: &[u8; HEADER_BYTES]) -> Result<Packet, ImportError> {
        // The damaged header's own magic, if it has one, is passed over.
        let mut window: VecDeque<u8> = header[1..].iter().copied().collect();
        loop {
            let found = window.make_contiguous().windows(MAGIC.len()).position(|w| w == MAGIC);
            if let Some(found) = found {
                window.drain(..found);
                return self.go_back(window.len());
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

    /// Goes on with the last `n` bytes read.
    fn go_back(&mut self, n: usize) -> Result<Packet, ImportError> {
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

    fn take_in(&mut self, stamp_ns: i64, losses: &mut Losses) {
        let body = std::mem::take(&mut self.body);
        for raw in body.chunks_exact(HIT_BYTES) {
            let hit = hit(stamp_ns, raw);
            if LASERS <= usize::from(hit.laser) {
                losses.dropped.add("hits of a laser above 31", 1);
            } else if let Some(turn) = self.turn.push(hit) {
                self.finish_turn(&turn, losses);
            }
        }
        self.body = body;
    }

    fn finish_turn(&mut self, hits: &[Hit], losses: &mut Losses) {
        let Some(&Hit { stamp_ns, .. }) = hits.first() else { return };
        if self.rings.is_none() {
            self.rings = rings::tell(hits);
        }
        if self.rings.is_none() {
            let remark = "turns whose rings are the file's laser numbers (their elevations are in \
                          no order of an HDL-32E)";
            losses.remarks.add(remark, 1);
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

const CUT: &str = "files of hits cut within a packet (what is whole is kept)";

impl Source for Hits {
    fn next(&mut self, losses: &mut Losses) -> Result<Option<Record>, ImportError> {
        while self.ready.is_empty() && !self.ended {
            match self.packet(losses)? {
                Packet::Hits { stamp_ns } => self.take_in(stamp_ns, losses),
                Packet::Skipped => {}
                Packet::End => {
                    self.ended = true;
                    let last = self.turn.finish();
                    self.finish_turn(&last, losses);
                }
            }
        }
        Ok(self.ready.pop_front())
    }
}

fn hit(stamp_ns: i64, raw: &[u8]) -> Hit {
    let metres = |at: usize| {
        f64::from(u16::from_le_bytes([raw[at], raw[at + 1]])) * METRES_PER_COUNT + OFFSET_M
    };
    let (left, forward, down) = (metres(0), metres(2), metres(4));
    Hit { stamp_ns, position: [forward, left, -down], intensity: raw[6], laser: raw[7] }
}

/// The hits since azimuth 0 (straight ahead) was passed.
#[derive(Debug, Default)]
struct Turn {
    hits: Vec<Hit>,
    /// The last hit's azimuth, 0 to a full turn \[rad\].
    azimuth: Option<f64>,
    /// How often azimuth 0 was passed, counter-clockwise less clockwise; and the least and the most
    /// that this has been. The lasers of a block are a fraction of a degree apart, so that near
    /// azimuth 0 they go back and forth: a turn begins when one is reached that was not there yet.
    passes: i64,
    least: i64,
    most: i64,
}

impl Turn {
    /// Adds a hit; the turn that ends before it.
    fn push(&mut self, hit: Hit) -> Option<Vec<Hit>> {
        let paused = self
            .hits
            .last()
            .is_some_and(|last| MAX_PAUSE_NS < hit.stamp_ns.abs_diff(last.stamp_ns));
        let cut = self.passes_0(hit.position) || paused || MAX_TURN_HITS <= self.hits.len();
        let ended = (cut && !self.hits.is_empty()).then(|| self.finish());
        self.hits.push(hit);
        ended
    }

    fn finish(&mut self) -> Vec<Hit> {
        std::mem::take(&mut self.hits)
    }

    fn passes_0(&mut self, [x, y, _]: [f64; 3]) -> bool {
        if libm::hypot(x, y) < MIN_LEVEL_M {
            return false;
        }
        let azimuth = libm::atan2(y, x).rem_euclid(TAU);
        let before = self.azimuth.replace(azimuth).unwrap_or(azimuth);
        if PI < before - azimuth {
            self.passes += 1;
        } else if PI < azimuth - before {
            self.passes -= 1;
        }
        let new = self.passes < self.least || self.most < self.passes;
        self.least = self.least.min(self.passes);
        self.most = self.most.max(self.passes);
        new
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(azimuth_deg: f64) -> Hit {
        let azimuth = azimuth_deg.to_radians();
        let position = [10.0 * libm::cos(azimuth), 10.0 * libm::sin(azimuth), 0.0];
        Hit { stamp_ns: 0, position, intensity: 0, laser: 0 }
    }

    fn lengths(azimuths: &[f64]) -> Vec<usize> {
        let mut turn = Turn::default();
        let mut lengths: Vec<usize> =
            azimuths.iter().filter_map(|&deg| turn.push(at(deg))).map(|hits| hits.len()).collect();
        lengths.push(turn.finish().len());
        lengths
    }

    #[test]
    fn a_turn_ends_where_azimuth_0_is_passed_in_either_sense() {
        assert_eq!(lengths(&[200.0, 300.0, 10.0, 130.0, 250.0, 5.0]), [2, 3, 1]);
        assert_eq!(lengths(&[100.0, 20.0, 350.0, 230.0, 110.0, 355.0]), [2, 3, 1]);
    }

    #[test]
    fn going_back_and_forth_at_azimuth_0_cuts_once() {
        assert_eq!(lengths(&[250.0, 359.9, 0.1, 359.9, 0.1, 120.0, 240.0, 359.8, 0.2]), [2, 6, 1]);
    }

    /// 21,000 is 5 m, 20,000 is 0, 19,000 is -5 m.
    #[test]
    fn the_sensor_hangs_upside_down() {
        let raw = [21_000u16, 20_400, 19_000].map(u16::to_le_bytes).concat();
        let hit = hit(7, &[&raw[..], &[200, 31]].concat());
        let expected = [2.0, 5.0, 5.0];
        for (found, expected) in hit.position.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-9, "{hit:?}");
        }
        assert_eq!((hit.intensity, hit.laser), (200, 31));
    }
}
