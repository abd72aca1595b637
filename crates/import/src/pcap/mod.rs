//! A capture of a Velodyne sensor -> `VelodyneScan` and `NavSatFix` messages.
//!
//! Data packets are UDP datagrams of 1206 bytes to port 2368, position packets of 512 bytes to port
//! 8308 (HDL-32E User's Manual 63-9113, "Data packet format" and "Position packet"; later Velodyne
//! models keep both). The packets are carried over as they are, with their capture times.
//!
//! As in `velodyne_driver`, a message holds about one turn and has the stamp of its last packet. A
//! new one starts where the azimuth of a packet's first block falls behind that of the packet
//! before.

mod container;
mod network;
mod position;

use std::cell::Cell;
use std::collections::{BTreeMap, VecDeque};
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use messages::hdl32e::{AZIMUTH_COUNTS, PACKET_BYTES};

use crate::error::ImportError;
use crate::input::Meter;
use crate::options::{Options, Topic};
use crate::record::{Body, Losses, Record, Source, representable};
use container::{Frame, Frames};
use network::{Datagram, NotUdp};
use position::Position;

/// Bytes of a position packet (manual, "Position packet").
const POSITION_BYTES: usize = 512;
/// Packets of a message at most. An HDL-32E sends 1808 packets/s, so 362 in a turn at 5 Hz, its
/// slowest.
const MAX_PACKETS: usize = 400;
/// A message does not span a longer pause \[ns\]: no sensor turns slower than 5 Hz.
const MAX_PAUSE_NS: u64 = 500_000_000;
/// The first two bytes of a data packet, little endian: every block's flag (manual), and that of
/// the lower laser bank of an HDL-64E.
const BLOCK_FLAGS: [u16; 2] = [0xEEFF, 0xDDFF];

/// The one sensor of an import: chosen, or the first that is met.
#[derive(Debug, Clone)]
pub(crate) struct Sensor {
    chosen: bool,
    address: Rc<Cell<Option<IpAddr>>>,
}

impl Sensor {
    pub fn new(options: &Options) -> Self {
        Self { chosen: options.source_ip.is_some(), address: Rc::new(Cell::new(options.source_ip)) }
    }
}

/// One capture file.
pub(crate) struct Capture {
    path: PathBuf,
    frames: Frames,
    sensor: Sensor,
    data_port: u16,
    position_port: u16,
    /// Packets of the turn under way.
    turn: Vec<(i64, [u8; PACKET_BYTES])>,
    ready: VecDeque<Record>,
    ended: bool,
}

impl Capture {
    pub fn open(
        path: &Path,
        options: &Options,
        sensor: &Sensor,
        meter: &Meter,
    ) -> Result<Self, ImportError> {
        Ok(Self {
            path: path.to_owned(),
            frames: Frames::open(path, meter)?,
            sensor: sensor.clone(),
            data_port: options.udp_port,
            position_port: options.position_port,
            turn: Vec::with_capacity(MAX_PACKETS),
            ready: VecDeque::new(),
            ended: false,
        })
    }

    /// Takes one datagram in.
    fn datagram(&mut self, stamp_ns: i64, datagram: &Datagram, losses: &mut Losses) -> Taken {
        let is_data = datagram.port == self.data_port;
        if !is_data && datagram.port != self.position_port {
            losses.remarks.add("UDP datagrams to other ports", 1);
            return Taken::Yes;
        }
        if !is_data && datagram.payload.len() != POSITION_BYTES {
            let reason = "datagrams to the position port that have not 512 bytes";
            losses.remarks.add(reason, 1);
            return Taken::Yes;
        }
        let packet: Option<&[u8; PACKET_BYTES]> = datagram.payload.try_into().ok();
        if is_data && !packet.is_some_and(|packet| BLOCK_FLAGS.contains(&u16_at(packet, 0))) {
            let reason = "datagrams to the data port that are no Velodyne data packets \
                          (1206 bytes, from 0xeeff)";
            losses.dropped.add(reason, 1);
            return Taken::Yes;
        }
        match self.sensor.address.get() {
            Some(address) if address != datagram.source => {
                if !self.sensor.chosen {
                    return Taken::AnotherSensor;
                }
                losses.remarks.add("packets of other sensors", 1);
                return Taken::Yes;
            }
            Some(_) => {}
            // Positions may come from elsewhere; data tells the sensor.
            None if is_data => self.sensor.address.set(Some(datagram.source)),
            None => {}
        }
        if !representable(stamp_ns) {
            losses.dropped.add("packets with a capture time before 1970 or after 2037", 1);
            return Taken::Yes;
        }
        match packet {
            Some(packet) if is_data => self.data(stamp_ns, packet),
            _ => self.position(stamp_ns, datagram.payload, losses),
        }
        Taken::Yes
    }

    fn data(&mut self, stamp_ns: i64, packet: &[u8; PACKET_BYTES]) {
        if let Some((last_ns, last)) = self.turn.last() {
            let azimuth = |packet| i32::from(u16_at(packet, 2));
            let passed_0 = i32::from(AZIMUTH_COUNTS / 2) < azimuth(last) - azimuth(packet);
            let paused = MAX_PAUSE_NS < stamp_ns.abs_diff(*last_ns);
            if passed_0 || paused || MAX_PACKETS <= self.turn.len() {
                self.finish_turn();
            }
        }
        self.turn.push((stamp_ns, *packet));
    }

    fn finish_turn(&mut self) {
        if let Some(&(stamp_ns, _)) = self.turn.last() {
            let packets = std::mem::replace(&mut self.turn, Vec::with_capacity(MAX_PACKETS));
            let body = Body::Packets(packets);
            self.ready.push_back(Record { topic: Topic::Packets, stamp_ns, body });
        }
    }

    fn position(&mut self, stamp_ns: i64, payload: &[u8], losses: &mut Losses) {
        match position::of_packet(payload) {
            Position::Fix(fix) => {
                losses.remarks.add("position packets with a fix", 1);
                let body = Body::Fix(fix);
                self.ready.push_back(Record { topic: Topic::Fix, stamp_ns, body });
            }
            Position::NoFix => losses.remarks.add("position packets without a fix", 1),
            Position::Damaged => {
                losses.dropped.add("position packets with a damaged NMEA sentence", 1);
            }
        }
    }

    /// The error for a second sensor: names all that the capture holds.
    fn several_sensors(&mut self, another: IpAddr) -> Result<ImportError, ImportError> {
        let mut counts: BTreeMap<IpAddr, u64> = BTreeMap::from([(another, 1)]);
        counts.extend(self.sensor.address.get().map(|first| (first, self.turn.len() as u64)));
        let mut beside = Losses::default();
        while let Some(frame) = self.frames.next(&mut beside)? {
            if let Ok(datagram) = network::datagram(&frame)
                && datagram.port == self.data_port
            {
                *counts.entry(datagram.source).or_default() += 1;
            }
        }
        let addresses: Vec<_> = counts.keys().map(ToString::to_string).collect();
        Ok(ImportError::SeveralSensors { path: self.path.clone(), addresses: addresses.join(", ") })
    }
}

/// What became of a datagram.
enum Taken {
    Yes,
    AnotherSensor,
}

impl Source for Capture {
    fn next(&mut self, losses: &mut Losses) -> Result<Option<Record>, ImportError> {
        while self.ready.is_empty() && !self.ended {
            // The frame borrows the reader, the datagram is taken in by what is beside it.
            let Some(frame) = self.frames.next(losses)? else {
                self.ended = true;
                self.finish_turn();
                break;
            };
            let Frame { stamp_ns, cut, .. } = frame;
            match network::datagram(&frame) {
                Ok(datagram) => {
                    let source = datagram.source;
                    let owned = datagram.payload.to_vec();
                    let datagram = Datagram { payload: &owned, ..datagram };
                    if let Taken::AnotherSensor = self.datagram(stamp_ns, &datagram, losses) {
                        return Err(self.several_sensors(source)?);
                    }
                }
                Err(NotUdp::Other(kind)) => losses.remarks.add(kind, 1),
                Err(NotUdp::Undecodable(_)) if cut => {
                    losses.dropped.add("frames cut short by the capture's snapshot length", 1);
                }
                Err(NotUdp::Undecodable(kind)) => losses.dropped.add(kind, 1),
            }
        }
        Ok(self.ready.pop_front())
    }
}

fn u16_at(packet: &[u8; PACKET_BYTES], at: usize) -> u16 {
    u16::from_le_bytes([packet[at], packet[at + 1]])
}
