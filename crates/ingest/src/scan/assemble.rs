//! What the pieces of a log hold -> scans and poses, in the order of the file.

use std::collections::BTreeMap;
use std::path::Path;

use dataset::{Dropped, Pose2, Scan, Trajectory};
use messages::hdl32e::LASERS;
use rayon::prelude::*;

use crate::deskew::queue::{Deskewer, Raw, Released};
use crate::drive::topic::Topic;
use crate::error::IngestError;
use crate::options::{Clock, Options};
use crate::pose::readings::Motion;
use crate::pose::trajectory::{PoseSource, PoseTopics};
use crate::scan::decode::Decoded;
use crate::velodyne::model::{self, Laser, OtherSensor, PACKETS_TO_IDENTIFY};
use crate::velodyne::packet::RingPacket;
use crate::velodyne::reorder::Reorderer;
use crate::velodyne::revolution::ScanBuilder;
use crate::velodyne::split::{Ends, MARKED_HOLE_DEG, RevolutionSplitter};

/// Packets that do not follow each other, one in so many, come from more than one sensor: a network
/// loses packets in bursts and a clock jumps now and then.
const MIXED: u64 = 10;
const SEVERAL_SENSORS: &str =
    "its packets do not follow each other, as if more than one sensor sent to the topic";
/// Packets of another layout that are no accident, where there are none of the right one.
const FOREIGN_PACKETS: u64 = 3;

/// What a drive gave besides its scans.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Ingested {
    /// The poses, in order of time.
    pub trajectory: Trajectory,
    /// Whether they are in a map frame of this drive's own: where its wheels were first read, or
    /// where its first satellite fix was.
    pub is_own_frame: bool,
    /// Number of scans handed on.
    pub n_scans: usize,
    /// Turns at the two ends that lie only partly in the log; they are not counted as dropped,
    /// since every recording starts and ends somewhere in a turn.
    pub n_partial_revolutions: usize,
    /// What was in the log and could not be used.
    pub dropped: Dropped,
    /// What is to be known of the scans, though nothing was lost for it here.
    pub notes: Vec<String>,
}

/// Puts together what the pieces hold.
pub(crate) struct Assembler {
    laser: Laser,
    options: Options,
    reorderer: Reorderer,
    splitter: RevolutionSplitter,
    maker: ScanBuilder,
    /// The file that is being joined.
    file: usize,
    /// Packets of it that are no later than those of the files before are there twice \[ns\].
    file_from_ns: i64,
    newest_ns: i64,
    first_packets: Vec<RingPacket>,
    foreign: BTreeMap<&'static str, u64>,
    n_packets: u64,
    deskewer: Deskewer,
    motion: Motion,
    /// Poses that are earlier than the one before in the log.
    n_poses_back: u64,
    dropped: Dropped,
    n_scans: usize,
    n_sorted_clouds: u64,
    n_clouds_of_other_clock: u64,
    /// Scans with a hole of more than [`MARKED_HOLE_DEG`].
    n_marked: usize,
    n_firings: u64,
    n_returns: u64,
    lasers_with_returns: u32,
    n_messages: u64,
    is_damaged: bool,
}

impl Assembler {
    /// What has been dropped so far is given.
    pub(crate) fn new(options: &Options, laser: Laser, dropped: Dropped) -> Self {
        Self {
            laser,
            options: options.clone(),
            reorderer: Reorderer::default(),
            splitter: RevolutionSplitter::new(&options.lidar, laser),
            maker: ScanBuilder::new(&options.lidar, laser),
            deskewer: Deskewer::new(options),
            file: 0,
            file_from_ns: i64::MIN,
            newest_ns: i64::MIN,
            first_packets: Vec::new(),
            foreign: BTreeMap::new(),
            n_packets: 0,
            motion: Motion::default(),
            n_poses_back: 0,
            dropped,
            n_scans: 0,
            n_sorted_clouds: 0,
            n_clouds_of_other_clock: 0,
            n_marked: 0,
            n_firings: 0,
            n_returns: 0,
            lasers_with_returns: 0,
            n_messages: 0,
            is_damaged: false,
        }
    }

    /// Adds what some pieces hold; their scans go to `take`.
    pub(crate) fn join<E>(
        &mut self,
        decoded: Vec<Decoded>,
        take: &mut impl FnMut(Vec<Scan>) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut revolutions = Vec::new();
        let mut released = Vec::new();
        for piece in decoded {
            if self.file != piece.file {
                self.file = piece.file;
                self.file_from_ns = self.newest_ns;
            }
            for packet in &piece.packets.packets {
                if packet.end_ns <= self.file_from_ns {
                    self.dropped.add("packets that are in two files of the drive", 1);
                    continue;
                }
                self.newest_ns = self.newest_ns.max(packet.end_ns);
                if self.first_packets.len() < PACKETS_TO_IDENTIFY {
                    self.first_packets.push(*packet);
                }
                self.reorderer.push(packet, |packet| self.splitter.push(packet, &mut revolutions));
            }
            for (model, n) in piece.packets.foreign {
                *self.foreign.entry(model).or_default() += n;
            }
            self.lasers_with_returns |= piece.packets.lasers_with_returns;
            self.n_sorted_clouds += piece.n_sorted_clouds;
            self.n_clouds_of_other_clock += piece.n_clouds_of_other_clock;
            self.n_messages += piece.n_messages;
            self.is_damaged |= piece.is_damaged;
            let of_revolutions = revolutions.drain(..).map(Raw::Revolution);
            piece
                .scans
                .into_iter()
                .map(Raw::Scan)
                .chain(of_revolutions)
                .for_each(|raw| self.deskewer.hold(raw));
            self.follow(piece.motion);
            self.deskewer.release(false, &mut released);
            self.n_packets += piece.packets.packets.len() as u64;
            self.dropped.merge(piece.packets.dropped);
            self.dropped.merge(piece.dropped);
        }
        take(self.scan(released))
    }

    /// Adds what comes next of the robot's motion.
    fn follow(&mut self, mut next: Motion) {
        self.motion.add_frames(&mut next);
        if let Some(options) = &self.options.pose {
            self.motion.cut_down(options);
        }
        self.deskewer.follow(&next, &self.motion);
        self.n_poses_back += self.motion.extend(next);
    }

    fn scan(&mut self, released: Vec<Released>) -> Vec<Scan> {
        for (raw, _) in &released {
            if let Raw::Revolution(revolution) = raw {
                self.n_firings += revolution.firings.len() as u64;
                self.n_returns +=
                    revolution.firings.iter().filter(|f| f.distance != 0).count() as u64;
            }
        }
        let maker = &self.maker;
        let scans: Vec<Scan> =
            released.into_par_iter().map(|(raw, smear)| raw.scan(maker, smear.as_ref())).collect();
        self.n_scans += scans.len();
        self.n_marked += scans.iter().filter(|scan| MARKED_HOLE_DEG < scan.hole_deg).count();
        scans
    }

    /// The sensor that the packets are of, where it is no HDL-32E.
    pub(crate) fn other_sensor(&self) -> Option<OtherSensor> {
        match self.foreign.iter().max_by_key(|(_, n)| **n) {
            Some((&name, &n)) if self.first_packets.is_empty() && FOREIGN_PACKETS <= n => {
                Some(OtherSensor { name, evidence: "by the flags of its blocks".to_owned() })
            }
            _ => model::other_sensor(&self.first_packets),
        }
    }

    /// Compares the messages there were with those that the log says it holds. What a damaged
    /// piece held is lost with it, and counted as that piece.
    pub(crate) fn expect_messages(&mut self, n: Option<u64>) {
        if let (Some(n), false) = (n, self.is_damaged) {
            let reason = "messages that the log's statistics count and its data lacks";
            self.dropped.add(reason, n.saturating_sub(self.n_messages));
        }
    }

    /// Ends the last turn and sums up. `path` stands for the drive in errors.
    pub(crate) fn finish<E: From<IngestError>>(
        mut self,
        path: &Path,
        lidar: Topic,
        pose: Option<&PoseTopics>,
        mut take: impl FnMut(Vec<Scan>) -> Result<(), E>,
    ) -> Result<Ingested, E> {
        let mut revolutions = Vec::new();
        self.reorderer.flush(&mut |packet| self.splitter.push(packet, &mut revolutions));
        let ends = self.splitter.finish(&mut revolutions);
        revolutions
            .into_iter()
            .for_each(|revolution| self.deskewer.hold(Raw::Revolution(revolution)));
        let mut released = Vec::new();
        self.deskewer.release(true, &mut released);
        take(self.scan(released))?;
        let mut of_packets = ends.dropped.clone();
        of_packets.merge(std::mem::take(&mut self.reorderer.dropped));
        let n_faults: u64 = of_packets.iter().map(|(_, n)| n).sum();
        let is_mixed = self.n_packets < MIXED * n_faults;
        self.dropped.merge(of_packets);

        let mut notes = lidar.notes.clone();
        let pose_topics = pose.iter().flat_map(|topics| topics.all());
        notes.extend(pose_topics.flat_map(|topic| topic.notes.clone()));
        notes.extend(self.notes(&ends));
        if is_mixed {
            notes.push(SEVERAL_SENSORS.to_owned());
        }
        self.check_scans(path, lidar.name, &ends, is_mixed)?;
        let dropped = &mut self.dropped;
        let is_own_frame = self.options.pose.as_ref().is_some_and(|pose| {
            pose.is_own_frame() || (self.motion.has_fixes() && pose.origin.is_none())
        });
        let mount = self.options.lidar.mount.map_or(Pose2::default(), |mount| mount.pose());
        let trajectory = match (pose, &self.options.pose) {
            (Some(topics), Some(options)) => {
                let upside_down = self.options.lidar.upside_down;
                let from = PoseSource { path, topics, options, mount, upside_down };
                self.motion.trajectory(&from, dropped, &mut notes)?
            }
            _ => Trajectory::default(),
        };
        Ok(Ingested {
            trajectory,
            is_own_frame,
            n_scans: self.n_scans,
            n_partial_revolutions: ends.n_partial,
            dropped: self.dropped,
            notes,
        })
    }

    /// Whether the device clock stands still though it is to give the time.
    pub(crate) fn lacks_clock(&self) -> bool {
        let [first, .., last] = self.first_packets.as_slice() else { return false };
        self.options.lidar.clock != Clock::Host
            && self.first_packets.len() == PACKETS_TO_IDENTIFY
            && self.first_packets.iter().all(|packet| packet.device_us == first.device_us)
            && first.azimuth != last.azimuth
    }

    /// Refuses a log that gives no scan, or none with a return.
    fn check_scans(
        &self,
        path: &Path,
        topic: String,
        ends: &Ends,
        is_mixed: bool,
    ) -> Result<(), IngestError> {
        let path = path.to_owned();
        if self.n_scans == 0 {
            let mut detail = match self.dropped.is_empty() && ends.n_partial > 0 {
                true => {
                    ": its packets span less than one turn between two cuts at azimuth 0".to_owned()
                }
                false => in_parentheses(&self.dropped),
            };
            if is_mixed {
                detail.push_str(&format!(": {SEVERAL_SENSORS}"));
            }
            return Err(IngestError::NoScans { path, topic, detail });
        }
        if self.n_firings > 0 && self.n_returns == 0 {
            return Err(IngestError::DeadLaser {
                path,
                topic,
                laser: self.laser.index,
                elevation_deg: self.laser.elevation_deg,
                n_firings: self.n_firings,
                alive: match model::lasers(self.lasers_with_returns) {
                    none if none.is_empty() => "none".to_owned(),
                    some => some,
                },
            });
        }
        Ok(())
    }

    fn notes(&self, ends: &Ends) -> Vec<String> {
        let mut notes: Vec<String> = self.deskewer.told().into_iter().collect();
        if ends.n_partial > 0 {
            notes.push(format!("{} turns cut by the log's ends", ends.n_partial));
        }
        if ends.n_missing_packets > 0 {
            notes.push(format!(
                "{} packets missing; {} scans have a hole of more than {MARKED_HOLE_DEG} deg (hole_deg)",
                ends.n_missing_packets, self.n_marked
            ));
        }
        if ends.n_clock_jumps > 0 {
            notes.push(format!(
                "the device clock jumps {} times, alone: nothing is lost for it",
                ends.n_clock_jumps
            ));
        }
        if let (n @ 1.., largest_s) = self.splitter.stamp_steps() {
            notes.push(format!(
                "the stamps step {n} times against the device clock, by up to {largest_s:.2} s: scans and poses may be that far apart there"
            ));
        }
        if self.n_poses_back > 0 {
            notes.push(format!(
                "{} poses are earlier than the one before in the log; they were put in order of time",
                self.n_poses_back
            ));
        }
        if self.options.lidar.clock == Clock::Host && self.n_packets < 2 * ends.n_same_stamp {
            notes.push("packets of a message have one stamp, so that scans may be late by its time: set `ingest.lidar.clock` to \"device\"".to_owned());
        }
        if self.reorderer.n_late > 0 {
            notes
                .push(format!("{} packets came late and were put in order", self.reorderer.n_late));
        }
        if self.n_sorted_clouds > 0 {
            notes.push(format!(
                "{} clouds have their points in no firing order; they were sorted by azimuth",
                self.n_sorted_clouds
            ));
        }
        if self.n_clouds_of_other_clock > 0 {
            notes.push(format!(
                "{} clouds have point times more than 1 s from their stamp; the stamp was taken",
                self.n_clouds_of_other_clock
            ));
        }
        let dead = !self.lasers_with_returns;
        if self.n_firings > 0 && dead != 0 {
            let n = LASERS - dead.count_ones() as usize;
            notes.push(format!(
                "{n} of {LASERS} lasers seen to return; none seen from {}",
                model::lasers(dead)
            ));
        }
        notes
    }
}

/// What was dropped, for the end of an error.
fn in_parentheses(dropped: &Dropped) -> String {
    match dropped.is_empty() {
        true => String::new(),
        false => format!(" (dropped: {dropped})"),
    }
}
