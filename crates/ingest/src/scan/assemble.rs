//! Assembles the decoded pieces of a drive into scans and poses, in file order.

use std::path::Path;

use dataset::{LossKind, Losses, Note, NoteKind, Pose2, Scan, StampedPose, Subject, Trajectory};
use messages::hdl32e::LASERS;
use rayon::prelude::*;

use crate::deskew::motion::LidarSpeed;
use crate::deskew::queue::{Deskewer, MeasuredScan, ReadyScan};
use crate::deskew::timed_scan::TimedScan;
use crate::drive::topic::Topic;
use crate::error::{IngestError, NoScansReason};
use crate::options::{Clock, Options};
use crate::pose::readings::MotionReadings;
use crate::pose::topics::PoseTopics;
use crate::pose::trajectory::{self, PoseSource};
use crate::scan::beam::Beam;
use crate::scan::decode::Decoded;
use crate::scan::observers::{Observed, Observers};
use crate::scan::point_time::PointTimeFound;
use crate::velodyne::model::{Laser, OtherSensor, format_lasers};
use crate::velodyne::revolution::ScanBuilder;
use crate::velodyne::stream::{PacketStream, PacketSummary};

/// Scans with a wider angle without packets are counted in the notes \[deg\].
const MIN_NOTED_HOLE_DEG: f32 = 5.0;

/// The result of ingesting a drive, apart from its scans.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Ingested {
    /// The poses, in order of time.
    pub trajectory: Trajectory,
    /// Whether the poses are in a map frame of this drive alone. Its origin is the first wheel
    /// reading or the first satellite fix.
    pub is_own_frame: bool,
    /// Number of scans.
    pub n_scans: usize,
    /// Number of partial revolutions at the start and end. They are not losses, because every
    /// recording starts and ends within a revolution.
    pub n_partial_revolutions: usize,
    /// Data that could not be used.
    pub losses: Losses,
    /// Remarks about the data.
    pub notes: Vec<Note>,
}

/// Assembles scans and poses.
pub(crate) struct Assembler {
    laser: Laser,
    options: Options,
    packets: PacketStream,
    builder: ScanBuilder,
    deskewer: Deskewer,
    motion: MotionReadings,
    observers: Observers,
    point_time: PointTimeFound,
    /// The last scan from a message.
    last_scan: Option<TimedScan>,
    counts: Counts,
    losses: Losses,
}

/// Counts over all pieces.
#[derive(Debug, Default)]
struct Counts {
    n_scans: usize,
    /// Scans with an angle of more than [`MIN_NOTED_HOLE_DEG`] without packets.
    n_scans_with_hole: u64,
    n_firings: u64,
    n_returns: u64,
    n_sorted_clouds: u64,
    n_clouds_of_other_clock: u64,
    n_messages: u64,
    /// Whether a part of a piece could not be read.
    is_damaged: bool,
}

impl Assembler {
    /// `losses` are the losses so far.
    pub(crate) fn new(options: &Options, beam: Beam, losses: Losses) -> Self {
        let laser = beam.laser;
        Self {
            laser,
            options: options.clone(),
            packets: PacketStream::new(&options.lidar, laser),
            builder: ScanBuilder::new(&options.lidar, laser),
            deskewer: Deskewer::new(options),
            motion: MotionReadings::default(),
            observers: Observers::default(),
            point_time: beam.point_time,
            last_scan: None,
            counts: Counts::default(),
            losses,
        }
    }

    /// Adds decoded pieces and passes their scans to `take`.
    pub(crate) fn add<E>(
        &mut self,
        decoded: Vec<Decoded>,
        take: &mut impl FnMut(Vec<Scan>) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut revolutions = Vec::new();
        let mut ready = Vec::new();
        for piece in decoded {
            self.packets.push(piece.file, piece.packets, &mut revolutions);
            self.observers.add(piece.lidar, piece.poses);
            let scans = self.without_duplicates(piece.scans);
            scans
                .into_iter()
                .map(MeasuredScan::Timed)
                .chain(revolutions.drain(..).map(MeasuredScan::Revolution))
                .for_each(|scan| self.deskewer.push(scan));
            self.add_motion(piece.motion);
            self.deskewer.release(false, &mut ready);
            self.counts.n_sorted_clouds += piece.n_sorted_clouds;
            self.counts.n_clouds_of_other_clock += piece.n_clouds_of_other_clock;
            self.counts.n_messages += piece.n_messages;
            self.counts.is_damaged |= piece.is_damaged;
            self.losses.merge(piece.losses);
        }
        take(self.build_scans(ready))
    }

    /// Removes scans that are the same as the scan before: the message was recorded twice.
    fn without_duplicates(&mut self, mut scans: Vec<TimedScan>) -> Vec<TimedScan> {
        let before = scans.len();
        scans.dedup();
        if let (Some(last), Some(first)) = (&self.last_scan, scans.first())
            && last == first
        {
            scans.remove(0);
        }
        self.losses.add(LossKind::DuplicateScans, (before - scans.len()) as u64);
        if let Some(last) = scans.last() {
            self.last_scan = Some(last.clone());
        }
        scans
    }

    /// Adds poses that are not in the log, before its first piece.
    pub(crate) fn add_poses(&mut self, poses: Vec<StampedPose>) {
        self.add_motion(MotionReadings { poses, ..MotionReadings::default() });
    }

    /// Deskews the scans by these speeds of the lidar, one for each.
    pub(crate) fn deskew_by(&mut self, speeds: &[Option<LidarSpeed>]) {
        self.deskewer.deskew_by(speeds);
    }

    /// Adds the motion of the next piece.
    fn add_motion(&mut self, mut next: MotionReadings) {
        self.motion.take_transforms(&mut next);
        if let Some(options) = &self.options.pose {
            self.motion.prune_transforms(options);
        }
        self.deskewer.add_readings(&next, &self.motion);
        self.motion.extend(next);
    }

    fn build_scans(&mut self, ready: Vec<ReadyScan>) -> Vec<Scan> {
        let counts = &mut self.counts;
        for scan in &ready {
            if let MeasuredScan::Revolution(revolution) = &scan.measured {
                let firings = &revolution.firings;
                counts.n_firings += firings.len() as u64;
                counts.n_returns += firings.iter().filter(|f| f.distance != 0).count() as u64;
            }
        }
        let builder = &self.builder;
        let scans: Vec<Scan> = ready.into_par_iter().map(|scan| scan.build(builder)).collect();
        counts.n_scans += scans.len();
        let has_hole = |scan: &&Scan| MIN_NOTED_HOLE_DEG < scan.hole_deg;
        counts.n_scans_with_hole += scans.iter().filter(has_hole).count() as u64;
        scans
    }

    /// The sensor that sent the packets, if it is not an HDL-32E.
    pub(crate) fn other_sensor(&self) -> Option<OtherSensor> {
        self.packets.model.other_sensor()
    }

    /// Whether the options use the device clock although it stands still.
    pub(crate) fn lacks_clock(&self) -> bool {
        self.options.lidar.clock != Clock::Host && self.packets.model.has_still_clock()
    }

    /// Adds losses that concern the drive as a whole.
    pub(crate) fn add_losses(&mut self, losses: Losses) {
        self.losses.merge(losses);
    }

    /// Compares the number of messages read with the statistics in the files. Messages in a damaged
    /// piece are already counted with the piece.
    pub(crate) fn check_message_count(&mut self, expected: Option<u64>) {
        if let (Some(expected), false) = (expected, self.counts.is_damaged) {
            let n_missing = expected.saturating_sub(self.counts.n_messages);
            self.losses.add(LossKind::MissingMessages, n_missing);
        }
    }

    /// Ends the last revolution, makes the trajectory, and sums up. `path` is the drive's name in
    /// errors.
    pub(crate) fn finish<E: From<IngestError>>(
        mut self,
        path: &Path,
        lidar: &Topic,
        pose: Option<&PoseTopics>,
        mut take: impl FnMut(Vec<Scan>) -> Result<(), E>,
    ) -> Result<Ingested, E> {
        let mut revolutions = Vec::new();
        let mut packets = self.packets.finish(&mut revolutions);
        revolutions.into_iter().for_each(|r| self.deskewer.push(MeasuredScan::Revolution(r)));
        let mut ready = Vec::new();
        self.deskewer.release(true, &mut ready);
        take(self.build_scans(ready))?;
        self.losses.merge(std::mem::take(&mut packets.losses).on_topic(&lidar.name));

        let mut notes = lidar.notes.clone();
        let pose_topics = pose.iter().flat_map(|topics| topics.all());
        notes.extend(pose_topics.flat_map(|topic| topic.notes.clone()));
        let on_lidar = |kind| Note::new(kind, Subject::topic(&lidar.name));
        notes.extend(self.deskewer.notes().into_iter().map(on_lidar));
        notes.extend(self.lidar_notes(&packets).into_iter().map(on_lidar));
        let pose_topics = pose.map(PoseTopics::all).unwrap_or_default();
        let observed = Observed {
            path,
            lidar,
            pose_topics: &pose_topics,
            options: &self.options,
            point_time: self.point_time,
        };
        self.observers.report(&observed, &mut self.losses, &mut notes)?;
        self.check_scans(path, &lidar.name, &packets)?;

        let is_own_frame = self.options.pose.as_ref().is_some_and(|pose| {
            pose.is_own_frame() || (self.motion.has_fixes() && pose.origin.is_none())
        });
        let base_from_lidar =
            self.options.lidar.mount.map_or(Pose2::default(), |mount| mount.pose());
        let trajectory = match (pose, &self.options.pose) {
            (Some(topics), Some(options)) => {
                let upside_down = self.options.lidar.upside_down;
                let source = PoseSource { path, topics, options, base_from_lidar, upside_down };
                trajectory::trajectory(self.motion, &source, &mut self.losses, &mut notes)?
            }
            _ => Trajectory::default(),
        };
        Ok(Ingested {
            trajectory,
            is_own_frame,
            n_scans: self.counts.n_scans,
            n_partial_revolutions: packets.split.n_partial,
            losses: self.losses,
            notes,
        })
    }

    /// Returns an error if there is no scan, or no return in any scan.
    fn check_scans(
        &self,
        path: &Path,
        topic: &str,
        packets: &PacketSummary,
    ) -> Result<(), IngestError> {
        let (path, topic) = (path.to_owned(), topic.to_owned());
        if let Some(evidence) = packets.two_sensors.clone() {
            return Err(IngestError::SeveralSensors { path, topic, evidence });
        }
        if self.counts.n_scans == 0 {
            let reason = match self.losses.is_empty() && 0 < packets.split.n_partial {
                true => NoScansReason::LessThanOneRevolution,
                false => NoScansReason::Losses(self.losses.clone()),
            };
            let is_mixed = packets.is_mixed;
            return Err(IngestError::NoScans { path, topic, reason, is_mixed });
        }
        if 0 < self.counts.n_firings && self.counts.n_returns == 0 {
            return Err(IngestError::DeadLaser {
                path,
                topic,
                laser: self.laser.index,
                elevation_deg: self.laser.elevation_deg,
                n_firings: self.counts.n_firings,
                alive: match format_lasers(packets.lasers_with_returns) {
                    none if none.is_empty() => "none".to_owned(),
                    some => some,
                },
            });
        }
        Ok(())
    }

    /// Notes about the messages of the lidar topic.
    fn lidar_notes(&self, packets: &PacketSummary) -> Vec<NoteKind> {
        let counts = &self.counts;
        let split = &packets.split;
        let silent = !packets.lasers_with_returns;
        let noted = [
            (packets.is_mixed, NoteKind::SeveralSensors),
            (
                0 < split.n_partial,
                NoteKind::PartialRevolutions { n_revolutions: split.n_partial as u64 },
            ),
            (
                0 < split.n_missing_packets,
                NoteKind::MissingPackets {
                    n_packets: split.n_missing_packets,
                    n_scans: counts.n_scans_with_hole,
                    min_hole_deg: f64::from(MIN_NOTED_HOLE_DEG),
                },
            ),
            (0 < split.n_clock_jumps, NoteKind::DeviceClockJumps { n_jumps: split.n_clock_jumps }),
            (
                0 < split.n_stamp_steps,
                NoteKind::StampSteps {
                    n_steps: split.n_stamp_steps,
                    largest_s: split.largest_stamp_step_s,
                },
            ),
            (
                self.options.lidar.clock == Clock::Host
                    && packets.n_packets < 2 * split.n_same_stamp,
                NoteKind::OneStampPerMessage,
            ),
            (0 < packets.n_late, NoteKind::PacketsReordered { n_packets: packets.n_late }),
            (
                0 < counts.n_sorted_clouds,
                NoteKind::CloudsSorted { n_clouds: counts.n_sorted_clouds },
            ),
            (
                0 < counts.n_clouds_of_other_clock,
                NoteKind::CloudTimesIgnored { n_clouds: counts.n_clouds_of_other_clock },
            ),
            (
                0 < counts.n_firings && silent != 0,
                NoteKind::SilentLasers {
                    n_returning: LASERS as u64 - u64::from(silent.count_ones()),
                    n_lasers: LASERS as u64,
                    silent: format_lasers(silent),
                },
            ),
        ];
        noted.into_iter().filter(|(is_noted, _)| *is_noted).map(|(_, note)| note).collect()
    }
}
