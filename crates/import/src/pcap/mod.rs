//! Converts a capture of a Velodyne sensor to `VelodyneScan` and `NavSatFix` messages.
//!
//! Data packets are UDP datagrams of 1206 bytes to port 2368. Position packets are UDP datagrams of
//! 512 bytes to port 8308 (HDL-32E User's Manual 63-9113, "Data packet format" and "Position packet";
//! later Velodyne models use the same formats). Data packets are copied unchanged, with their capture
//! times.
//!
//! As in `velodyne_driver`, a message contains about one revolution and has the stamp of its last
//! packet. A new message starts when the azimuth of the first block of a packet is smaller than that
//! of the previous packet.

mod container;
mod network;
mod position;

use std::cell::Cell;
use std::collections::{BTreeMap, BTreeSet, VecDeque};
use std::net::IpAddr;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use dataset::{Loss, LossKind, Losses, Subject};
use messages::hdl32e::{AZIMUTH_COUNTS, PACKET_BYTES};

use crate::error::ImportError;
use crate::input::{Meter, file_name};
use crate::options::{Options, Topic};
use crate::record::{Body, Record, Source, is_representable};
pub(crate) use container::is_capture;
use container::{Frame, Frames};
use network::Datagram;
use position::Position;

/// Size of a position packet \[bytes\] (manual, "Position packet").
const POSITION_BYTES: usize = 512;
/// The maximum number of packets in a message. An HDL-32E sends 1808 packets/s, which gives 362
/// packets per revolution at its lowest speed, 5 Hz.
const MAX_PACKETS: usize = 400;
/// A longer pause ends a message \[ns\]. The lowest speed of the sensors is 5 Hz.
const MAX_PAUSE_NS: u64 = 500_000_000;
/// The first two bytes of a data packet, little endian: the flag of a block (manual), or the flag of
/// the lower laser bank of an HDL-64E.
const BLOCK_FLAGS: [u16; 2] = [0xEEFF, 0xDDFF];

/// The sensor of an import: the selected sensor, or the first one in the captures.
#[derive(Debug, Clone)]
pub(crate) struct Sensor {
    is_selected: bool,
    address: Rc<Cell<Option<IpAddr>>>,
}

impl Sensor {
    pub fn new(options: &Options) -> Self {
        let is_selected = options.source_ip.is_some();
        Self { is_selected, address: Rc::new(Cell::new(options.source_ip)) }
    }
}

/// Reads one capture file.
pub(crate) struct Capture {
    path: PathBuf,
    frames: Frames,
    sensor: Sensor,
    data_port: u16,
    position_port: u16,
    /// The packets of the current revolution.
    revolution: Vec<(i64, [u8; PACKET_BYTES])>,
    /// Whether there was a packet on the data port.
    has_data: bool,
    /// Datagrams to other ports, by port.
    other_ports: BTreeMap<u16, OtherPort>,
    ready: VecDeque<Record>,
    ended: bool,
}

/// Datagrams to a port that is not used.
#[derive(Debug, Clone, Copy, Default)]
struct OtherPort {
    n: u64,
    /// Number of datagrams that are data packets.
    n_data: u64,
}

impl OtherPort {
    fn add(&mut self, payload: &[u8]) {
        self.n += 1;
        self.n_data += u64::from(data_packet(payload).is_some());
    }
}

/// At most this many ports are listed.
const MAX_LISTED_PORTS: usize = 8;

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
            revolution: Vec::with_capacity(MAX_PACKETS),
            has_data: false,
            other_ports: BTreeMap::new(),
            ready: VecDeque::new(),
            ended: false,
        })
    }

    /// Counts the datagrams to other ports. Data packets there are a loss if the data port has none.
    fn add_other_ports(&self, losses: &mut Losses) {
        let is_missed = |port: &OtherPort| !self.has_data && 0 < port.n_data;
        let mut ports: Vec<_> = self.other_ports.iter().collect();
        ports.sort_by_key(|(_, port)| std::cmp::Reverse(port.n));
        for (port, other) in ports.iter().filter(|(_, other)| is_missed(other)) {
            let (port, used) = (**port, self.data_port);
            losses.add(self.loss(LossKind::DataPacketsToOtherPort { port, used }), other.n_data);
        }
        let others: Vec<_> = ports.iter().filter(|(_, other)| !is_missed(other)).collect();
        let listed = others.iter().take(MAX_LISTED_PORTS);
        let mut list: Vec<_> = listed.map(|(port, other)| format!("{port}: {}", other.n)).collect();
        if MAX_LISTED_PORTS < others.len() {
            list.push(format!("{} more ports", others.len() - MAX_LISTED_PORTS));
        }
        let n = others.iter().map(|(_, other)| other.n).sum();
        let kind = LossKind::DatagramsToOtherPorts { ports: list.join(", ") };
        losses.add(self.loss(kind), n);
    }

    fn loss(&self, kind: LossKind) -> Loss {
        Loss::new(kind, Subject::file(file_name(&self.path)))
    }

    /// Handles one datagram.
    fn push_datagram(&mut self, stamp_ns: i64, datagram: &Datagram, losses: &mut Losses) -> Pushed {
        let is_data = datagram.port == self.data_port;
        if !is_data && datagram.port != self.position_port {
            self.other_ports.entry(datagram.port).or_default().add(datagram.payload);
            return Pushed::Done;
        }
        if !is_data && datagram.payload.len() != POSITION_BYTES {
            losses.add(self.loss(LossKind::DatagramsNotPositions), 1);
            return Pushed::Done;
        }
        let packet = data_packet(datagram.payload);
        if is_data && packet.is_none() {
            losses.add(self.loss(LossKind::DatagramsNotData), 1);
            return Pushed::Done;
        }
        match self.sensor.address.get() {
            Some(address) if address != datagram.source => {
                if !self.sensor.is_selected {
                    return Pushed::AnotherSensor;
                }
                losses.add(self.loss(LossKind::PacketsOfOtherSensors), 1);
                return Pushed::Done;
            }
            Some(_) => {}
            // Position packets may come from another device. Only data packets identify the sensor.
            None if is_data => self.sensor.address.set(Some(datagram.source)),
            None => {}
        }
        if !is_representable(stamp_ns) {
            let kind = LossKind::TimesOutOfRange { item: "packet".to_owned() };
            losses.add(self.loss(kind), 1);
            return Pushed::Done;
        }
        match packet {
            Some(packet) if is_data => {
                self.has_data = true;
                self.push_data(stamp_ns, packet);
            }
            _ => self.push_position(stamp_ns, datagram.payload, losses),
        }
        Pushed::Done
    }

    fn push_data(&mut self, stamp_ns: i64, packet: &[u8; PACKET_BYTES]) {
        if let Some((last_ns, last)) = self.revolution.last() {
            let azimuth = |packet| i32::from(u16_at(packet, 2));
            let passes_0 = i32::from(AZIMUTH_COUNTS / 2) < azimuth(last) - azimuth(packet);
            let paused = MAX_PAUSE_NS < stamp_ns.abs_diff(*last_ns);
            if passes_0 || paused || MAX_PACKETS <= self.revolution.len() {
                self.finish_revolution();
            }
        }
        self.revolution.push((stamp_ns, *packet));
    }

    fn finish_revolution(&mut self) {
        if let Some(&(stamp_ns, _)) = self.revolution.last() {
            let packets = std::mem::replace(&mut self.revolution, Vec::with_capacity(MAX_PACKETS));
            let body = Body::Packets(packets);
            self.ready.push_back(Record { topic: Topic::Packets, stamp_ns, body });
        }
    }

    fn push_position(&mut self, stamp_ns: i64, payload: &[u8], losses: &mut Losses) {
        match position::of_packet(payload) {
            Position::Fix(fix) => {
                let body = Body::Fix(fix);
                self.ready.push_back(Record { topic: Topic::Fix, stamp_ns, body });
            }
            Position::NoFix => losses.add(self.loss(LossKind::PositionsWithoutFix), 1),
            Position::Damaged => losses.add(self.loss(LossKind::DamagedPositions), 1),
        }
    }

    /// The error for a second sensor. It names all sensors of the capture.
    fn several_sensors(&mut self, another: IpAddr) -> Result<ImportError, ImportError> {
        let mut sources = BTreeSet::from([another]);
        sources.extend(self.sensor.address.get());
        let mut ignored = Losses::default();
        while let Some(frame) = self.frames.next(&mut ignored)? {
            if let Ok(datagram) = network::datagram(&frame)
                && datagram.port == self.data_port
            {
                sources.insert(datagram.source);
            }
        }
        let addresses: Vec<_> = sources.iter().map(ToString::to_string).collect();
        Ok(ImportError::SeveralSensors { path: self.path.clone(), addresses: addresses.join(", ") })
    }
}

/// The result of handling a datagram.
enum Pushed {
    Done,
    AnotherSensor,
}

impl Source for Capture {
    fn next(&mut self, losses: &mut Losses) -> Result<Option<Record>, ImportError> {
        while self.ready.is_empty() && !self.ended {
            // The frame borrows `self.frames`, and the payload is therefore copied.
            let Some(frame) = self.frames.next(losses)? else {
                self.ended = true;
                self.finish_revolution();
                self.add_other_ports(losses);
                break;
            };
            let Frame { stamp_ns, is_truncated, .. } = frame;
            match network::datagram(&frame) {
                Ok(datagram) => {
                    let source = datagram.source;
                    let owned = datagram.payload.to_vec();
                    let datagram = Datagram { payload: &owned, ..datagram };
                    if let Pushed::AnotherSensor = self.push_datagram(stamp_ns, &datagram, losses) {
                        return Err(self.several_sensors(source)?);
                    }
                }
                Err(not_udp) => {
                    let kind = not_udp.loss_kind(is_truncated);
                    losses.add(self.loss(kind), 1);
                }
            }
        }
        Ok(self.ready.pop_front())
    }
}

/// The payload of a datagram, if it is a data packet.
fn data_packet(payload: &[u8]) -> Option<&[u8; PACKET_BYTES]> {
    let packet: &[u8; PACKET_BYTES] = payload.try_into().ok()?;
    BLOCK_FLAGS.contains(&u16_at(packet, 0)).then_some(packet)
}

fn u16_at(packet: &[u8; PACKET_BYTES], at: usize) -> u16 {
    u16::from_le_bytes([packet[at], packet[at + 1]])
}
