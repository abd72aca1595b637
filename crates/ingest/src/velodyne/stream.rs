//! Processes the packets of a topic: deduplicate, reorder, split into revolutions.

use dataset::{LossKind, Losses};

use crate::options::LidarOptions;
use crate::velodyne::deduplicate::FileOverlap;
use crate::velodyne::model::{Laser, ModelEvidence};
use crate::velodyne::packet::Packets;
use crate::velodyne::reorder::Reorderer;
use crate::velodyne::revolution::Revolution;
use crate::velodyne::sensor_clocks::SensorClocks;
use crate::velodyne::split::{RevolutionSplitter, SplitSummary};

/// If at least one packet in this many is faulty, the packets come from more than one sensor. A
/// network loses packets in bursts, and clocks rarely jump, so a single sensor has fewer faults.
const MIXED_SENSORS_RATIO: u64 = 10;

/// Turns packets, in the order of the log, into revolutions.
pub(crate) struct PacketStream {
    overlap: FileOverlap,
    reorderer: Reorderer,
    splitter: RevolutionSplitter,
    pub(crate) model: ModelEvidence,
    clocks: SensorClocks,
    n_packets: u64,
    /// Lasers with a return, one bit each.
    lasers_with_returns: u32,
    /// Packets that were dropped.
    losses: Losses,
}

/// What was found in the packets of a drive.
#[derive(Debug)]
pub(crate) struct PacketSummary {
    pub(crate) split: SplitSummary,
    pub(crate) n_packets: u64,
    /// Number of late packets that were put back in order.
    pub(crate) n_late: u64,
    /// Lasers with a return, one bit each.
    pub(crate) lasers_with_returns: u32,
    /// Whether the packets seem to come from more than one sensor.
    pub(crate) is_mixed: bool,
    /// The device clocks of two sensors, if the packets come from two.
    pub(crate) two_sensors: Option<String>,
    /// Packets and revolutions that were dropped.
    pub(crate) losses: Losses,
}

impl PacketStream {
    pub(crate) fn new(options: &LidarOptions, laser: Laser) -> Self {
        Self {
            overlap: FileOverlap::default(),
            reorderer: Reorderer::default(),
            splitter: RevolutionSplitter::new(options, laser),
            model: ModelEvidence::default(),
            clocks: SensorClocks::default(),
            n_packets: 0,
            lasers_with_returns: 0,
            losses: Losses::default(),
        }
    }

    /// Adds the packets of a piece of a file. Appends complete revolutions to `revolutions`.
    pub(crate) fn push(
        &mut self,
        file: usize,
        packets: Packets,
        revolutions: &mut Vec<Revolution>,
    ) {
        self.overlap.enter_file(file);
        let mut n_in_two_files = 0;
        for packet in &packets.packets {
            if !self.overlap.is_new(packet) {
                n_in_two_files += 1;
                continue;
            }
            self.model.add_packet(packet);
            self.clocks.add(packet);
            self.reorderer.push(packet, |packet| self.splitter.push(packet, revolutions));
        }
        self.model.add_foreign(packets.foreign);
        self.n_packets += packets.packets.len() as u64;
        self.lasers_with_returns |= packets.lasers_with_returns;
        self.losses.add(LossKind::PacketsInTwoFiles, n_in_two_files);
        self.losses.merge(packets.losses);
    }

    /// Ends the last revolution.
    pub(crate) fn finish(&mut self, revolutions: &mut Vec<Revolution>) -> PacketSummary {
        self.reorderer.flush(&mut |packet| self.splitter.push(packet, revolutions));
        let split = self.splitter.finish(revolutions);
        let mut faults = split.losses.clone();
        faults.merge(std::mem::take(&mut self.reorderer.losses));
        let is_mixed = self.n_packets < MIXED_SENSORS_RATIO * faults.total();
        let mut losses = std::mem::take(&mut self.losses);
        losses.merge(faults);
        PacketSummary {
            split,
            n_packets: self.n_packets,
            n_late: self.reorderer.n_late,
            lasers_with_returns: self.lasers_with_returns,
            is_mixed,
            two_sensors: self.clocks.two_sensors(),
            losses,
        }
    }
}
