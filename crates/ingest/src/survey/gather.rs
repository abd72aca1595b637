//! Surveys a drive: reads all messages and summarizes each topic.

use std::collections::{BTreeMap, BTreeSet};

use dataset::{Loss, LossKind, Losses, StampedPose, Subject};
use messages::hdl32e::{self, BLOCKS, HORIZONTAL_LASER, HOUR_US, LASERS, Packet, ReturnMode};
use messages::{
    FrameIds, MessageType, NavSatFix, Source, read_frame_ids, read_joint_state, read_laser_scan,
    read_nav_sat_fix, read_transforms, read_velodyne,
};
use rayon::prelude::*;

use crate::drive::structure::{PieceStructure, StructureCheck};
use crate::drive::topic::{Drive, FilePiece};
use crate::drive::window::{PIECES_PER_THREAD, report_progress};
use crate::mcap::chunk::{self, Buffer};
use crate::mcap::definitions::Channel;
use crate::mcap::log::Log;
use crate::observe::topic::{TopicObserver, TopicPiece};
use crate::options::LidarOptions;
use crate::pose::gnss;
use crate::pose::joints::wheels_of_topic;
use crate::pose::message::{stamped_pose, undecodable};
use crate::scan::cloud::Rings;
use crate::survey::poses::poses_survey;
use crate::survey::report::{
    ClockSurvey, CloudsSurvey, Content, FrameSurvey, JointsSurvey, PacketsSurvey, ScansSurvey,
    StampSurvey, Survey, TopicSurvey, TransformSurvey,
};
use crate::types::{FRAME_TYPES, LIDAR_TYPES, POSE_TYPES};
use crate::velodyne::device_clock::device_gap_us;
use crate::velodyne::model::{HDL32E, Laser, ModelEvidence, format_lasers};
use crate::velodyne::packet::RingPacket;
use crate::velodyne::reorder::Reorderer;
use crate::velodyne::revolution::Revolution;
use crate::velodyne::split::{RevolutionSplitter, SplitSummary};

/// Surveys a drive from one log, or from several logs that it was split into.
///
/// `progress` is called with the number of bytes read so far.
pub fn survey(logs: &[&Log], progress: impl Fn(u64)) -> Survey {
    let drive = Drive::new(logs);
    let mut structure = StructureCheck::new(&drive);
    let mut survey = Survey {
        n_bytes: logs.iter().map(|log| log.n_bytes()).sum(),
        time_range_ns: drive.time_range_ns(),
        losses: drive.losses(),
        ..Survey::default()
    };
    let mut topics: BTreeMap<TopicKey, Gathered> =
        drive.channels().map(|(_, _, channel)| (key_of(channel), Gathered::default())).collect();
    let keys: Keys = drive
        .channels()
        .map(|(file, id, channel)| ((file, id), (key_of(channel), drive.source(file, id))))
        .collect();
    let pieces = drive.pieces(|_, _| true);
    for window in pieces.chunks(PIECES_PER_THREAD * rayon::current_num_threads()) {
        let found: Vec<(BTreeMap<TopicKey, Found>, Losses, PieceStructure)> = window
            .par_iter()
            .map_init(Buffer::default, |buffer, piece| read(&drive, piece, &keys, buffer))
            .collect();
        for (found, losses, shown) in found {
            survey.losses.merge(losses);
            structure.add(&drive, shown);
            for (key, found) in found {
                topics.entry(key).or_default().add(found);
            }
        }
        report_progress(window, &progress);
    }
    survey.losses.merge(structure.losses());
    survey.topics = topics
        .into_iter()
        .map(|(key, gathered)| gathered.finish(key, &mut survey.losses))
        .collect();
    survey
}

/// Topic, schema and encoding.
type TopicKey = (String, String, String);
/// For each file and channel: its topic, and how its messages are read.
type Keys = BTreeMap<(usize, u16), (TopicKey, Option<Source>)>;

fn key_of(channel: &Channel) -> TopicKey {
    (channel.topic.clone(), channel.schema.clone(), channel.message_encoding.clone())
}

/// What one piece contains of one topic.
#[derive(Default)]
struct Found {
    n_messages: u64,
    source: Option<Source>,
    /// Log times of the first and the last message \[ns\].
    log_times: Option<(u64, u64)>,
    packets: Vec<RingPacket>,
    return_modes: BTreeMap<u8, u64>,
    /// Number of returns of each laser.
    n_returns: [u64; LASERS],
    /// Number of packets of other Velodyne models, by model name.
    foreign: BTreeMap<&'static str, u64>,
    poses: Vec<StampedPose>,
    /// Log time of each pose \[ns\].
    pose_log_ns: Vec<u64>,
    /// Satellite fixes, all with frame 0.
    fixes: Vec<(NavSatFix, u32)>,
    /// The names in each kind of `JointState` message.
    joints: BTreeSet<Vec<String>>,
    /// The transforms, by parent and child.
    transforms: BTreeMap<(String, String), FoundTransform>,
    /// Number of messages by frame and child frame.
    frames: BTreeMap<(String, String), u64>,
    scans: Option<ScansSurvey>,
    rings: Rings,
    seen: TopicPiece,
    losses: Losses,
}

/// The samples of one transform.
#[derive(Clone, Copy)]
struct FoundTransform {
    n_samples: u64,
    first: Value,
    is_constant: bool,
}

/// Translation and rotation.
type Value = ([f64; 3], [f64; 4]);

impl FoundTransform {
    fn new(first: Value) -> Self {
        Self { n_samples: 0, first, is_constant: true }
    }

    fn add(&mut self, other: Self) {
        self.n_samples += other.n_samples;
        self.is_constant &= other.is_constant && self.first == other.first;
    }
}

/// Reads the messages of a piece.
fn read(
    drive: &Drive<'_>,
    piece: &FilePiece<'_>,
    keys: &Keys,
    buffer: &mut Buffer,
) -> (BTreeMap<TopicKey, Found>, Losses, PieceStructure) {
    let mut found: BTreeMap<TopicKey, Found> = BTreeMap::new();
    let mut n_undefined = 0;
    let rest = chunk::messages(piece.log.bytes(), piece.piece, buffer, |header, data| {
        let time = header.log_time;
        match keys.get(&(piece.file, header.channel_id)) {
            Some((key, source)) => match found.get_mut(key) {
                Some(found) => found.add(&key.0, *source, time, data),
                None => found.entry(key.clone()).or_default().add(&key.0, *source, time, data),
            },
            None => n_undefined += 1,
        }
    });
    let structure = PieceStructure::new(drive, piece.file, n_undefined, rest.definitions);
    (found, rest.losses, structure)
}

impl Found {
    fn add(&mut self, topic: &str, source: Option<Source>, time: u64, data: &[u8]) {
        self.n_messages += 1;
        let (first, last) = self.log_times.unwrap_or((time, time));
        self.log_times = Some((first.min(time), last.max(time)));
        let Some(source) = source else { return };
        self.source = Some(source);
        self.add_frames(source, data);
        self.seen.add(source, time, data, None, false);
        if let Err(kind) = self.add_content(source, data) {
            self.losses.add(Loss::new(kind, Subject::topic(topic)), 1);
        }
        self.pose_log_ns.resize(self.poses.len(), time);
    }

    /// Counts the message in its frame. A message that cannot be decoded is counted with its content.
    fn add_frames(&mut self, source: Source, data: &[u8]) {
        let Ok(Some(FrameIds { frame_id, child_frame_id })) = read_frame_ids(source, data) else {
            return;
        };
        // Most messages of a topic are in the same frame: it is looked up without allocation.
        let known = self
            .frames
            .iter_mut()
            .find(|((frame, child), _)| *frame == frame_id && *child == child_frame_id);
        match known {
            Some((_, n)) => *n += 1,
            None => {
                let names = (frame_id.into_owned(), child_frame_id.into_owned());
                self.frames.insert(names, 1);
            }
        }
    }

    fn add_content(&mut self, source: Source, data: &[u8]) -> Result<(), LossKind> {
        let undecodable = |error| undecodable(source, &error);
        match source.message_type {
            MessageType::VelodyneScan | MessageType::VelodynePacket => {
                self.add_packets(source, data).map_err(undecodable)?;
            }
            MessageType::LaserScan | MessageType::FoxgloveLaserScan => {
                self.add_scan(source, data).map_err(undecodable)?;
            }
            // One cloud per piece is enough to find the rings.
            MessageType::PointCloud2 | MessageType::FoxglovePointCloud if self.n_messages == 1 => {
                self.rings.add(source, data).map_err(undecodable)?;
            }
            MessageType::Tf | MessageType::FoxgloveFrameTransform => {
                for transform in read_transforms(source, data).map_err(undecodable)? {
                    let names = (transform.parent, transform.child);
                    let value = (transform.translation, transform.rotation);
                    let found = FoundTransform { n_samples: 1, ..FoundTransform::new(value) };
                    let of_names = self.transforms.entry(names);
                    of_names.or_insert(FoundTransform::new(value)).add(found);
                }
            }
            MessageType::JointState => {
                let names = read_joint_state(source, data).map_err(undecodable)?.names;
                if !self.joints.contains(&names) && self.joints.len() < MAX_JOINT_KINDS {
                    self.joints.insert(names);
                }
            }
            MessageType::NavSatFix => {
                let fix = read_nav_sat_fix(source, data).map_err(undecodable)?;
                gnss::check(&fix)?;
                self.fixes.push((fix, 0));
            }
            other if POSE_TYPES.contains(&other) => {
                self.poses.push(stamped_pose(source, data)?);
            }
            _ => {}
        }
        Ok(())
    }

    fn add_packets(&mut self, source: Source, data: &[u8]) -> messages::Result<()> {
        for (end_ns, bytes) in read_velodyne(source, data)?.packets() {
            let Ok(packet) = Packet::new(bytes) else {
                match hdl32e::foreign_layout(bytes) {
                    Some(model) => *self.foreign.entry(model).or_default() += 1,
                    None => self.losses.add(LossKind::MalformedPackets, 1),
                }
                continue;
            };
            self.packets.push(RingPacket::new(end_ns, &packet, HORIZONTAL_LASER));
            let mode = packet.return_mode().map_or(0, ReturnMode::byte);
            *self.return_modes.entry(mode).or_default() += 1;
            for (laser, n) in self.n_returns.iter_mut().enumerate() {
                let has_return = |&block: &usize| packet.distance(block, laser) != 0;
                *n += (0..BLOCKS).filter(has_return).count() as u64;
            }
        }
        Ok(())
    }

    fn add_scan(&mut self, source: Source, data: &[u8]) -> messages::Result<()> {
        let scan = read_laser_scan(source, data)?;
        let n = scan.ranges.len();
        let of_scans = self.scans.get_or_insert(ScansSurvey {
            n_beams: (n, n),
            coverage_deg: 0.0,
            range_m: (scan.range_min, scan.range_max),
        });
        of_scans.n_beams = (of_scans.n_beams.0.min(n), of_scans.n_beams.1.max(n));
        let coverage_deg = (scan.angle_increment.abs() * n.saturating_sub(1) as f64).to_degrees();
        of_scans.coverage_deg = of_scans.coverage_deg.max(coverage_deg);
        Ok(())
    }

    /// Adds what another piece contains of the topic, except its packets.
    fn merge(&mut self, other: Self) {
        self.n_messages += other.n_messages;
        self.source = self.source.or(other.source);
        self.log_times = match (self.log_times, other.log_times) {
            (Some((a, b)), Some((c, d))) => Some((a.min(c), b.max(d))),
            (one, other) => one.or(other),
        };
        for (mode, n) in other.return_modes {
            *self.return_modes.entry(mode).or_default() += n;
        }
        self.n_returns.iter_mut().zip(other.n_returns).for_each(|(a, b)| *a += b);
        for (model, n) in other.foreign {
            *self.foreign.entry(model).or_default() += n;
        }
        self.poses.extend(other.poses);
        self.pose_log_ns.extend(other.pose_log_ns);
        self.fixes.extend(other.fixes);
        for (names, found) in other.transforms {
            let of_names = self.transforms.entry(names);
            of_names.or_insert(FoundTransform::new(found.first)).add(found);
        }
        for (names, n) in other.frames {
            *self.frames.entry(names).or_default() += n;
        }
        if let Some(scans) = other.scans {
            let merged = self.scans.get_or_insert_with(|| scans.clone());
            merged.n_beams =
                (merged.n_beams.0.min(scans.n_beams.0), merged.n_beams.1.max(scans.n_beams.1));
            merged.coverage_deg = merged.coverage_deg.max(scans.coverage_deg);
        }
        self.joints.extend(other.joints);
        self.rings.merge(other.rings);
        self.losses.merge(other.losses);
    }
}

/// What all pieces contain of one topic.
#[derive(Default)]
struct Gathered {
    found: Found,
    observer: TopicObserver,
    packets: Option<PacketCounts>,
}

impl Gathered {
    fn add(&mut self, mut found: Found) {
        for packet in std::mem::take(&mut found.packets) {
            self.packets.get_or_insert_with(PacketCounts::new).push(&packet);
        }
        self.observer.add(std::mem::take(&mut found.seen));
        self.found.merge(found);
    }

    fn finish(mut self, (topic, schema, encoding): TopicKey, losses: &mut Losses) -> TopicSurvey {
        let n_messages = self.found.n_messages;
        let rate_hz = self.found.log_times.and_then(|(first, last)| {
            (first < last && n_messages > 1)
                .then(|| (n_messages - 1) as f64 / ((last - first) as f64 * 1e-9))
        });
        let source = Source::new(&schema, &encoding).or(self.found.source);
        let message_type = source.map(|source| source.message_type);
        let stamps = self.stamps(message_type);
        if stamps.needs_log_times() {
            // As the suggested pipeline does.
            let log_ns = self.found.pose_log_ns.iter();
            for (pose, log_ns) in self.found.poses.iter_mut().zip(log_ns) {
                pose.stamp_ns = i64::try_from(*log_ns).unwrap_or(i64::MAX);
            }
        }
        let content = self.content(message_type);
        losses.merge(self.found.losses.on_topic(&topic));
        let frame = |((frame_id, child_frame_id), n_messages)| FrameSurvey {
            frame_id,
            child_frame_id,
            n_messages,
        };
        let frames = self.found.frames.into_iter().map(frame).collect();
        TopicSurvey { topic, schema, encoding, n_messages, rate_hz, frames, stamps, content }
    }

    /// Summarizes the stamps. Those of packets are in the packets, not in the header.
    fn stamps(&self, message_type: Option<MessageType>) -> StampSurvey {
        let TopicObserver { stamps, n_unstamped, .. } = &self.observer;
        let is_packets = message_type.is_some_and(|found| {
            matches!(found, MessageType::VelodyneScan | MessageType::VelodynePacket)
        });
        let steps = match stamps.steps_back() {
            [] => stamps.steps_against_log(),
            back => back.to_vec(),
        };
        StampSurvey {
            delay_s: stamps.delay_s(),
            n_unstamped: if is_packets { 0 } else { *n_unstamped },
            n_equal: stamps.n_equal(),
            n_stamped: stamps.n_messages(),
            steps_s: steps.iter().map(|step| step.step_ns as f64 * 1e-9).collect(),
        }
    }

    /// Summarizes the messages. Takes the poses, transforms and scans.
    fn content(&mut self, message_type: Option<MessageType>) -> Content {
        let found = &mut self.found;
        match message_type {
            Some(MessageType::VelodyneScan | MessageType::VelodynePacket) => {
                let packets = self.packets.take();
                packets_survey(packets, found).map_or(Content::Other, Content::Packets)
            }
            Some(MessageType::PointCloud2 | MessageType::FoxglovePointCloud) => {
                let point_times = found.rings.point_time().describe();
                Content::Clouds(CloudsSurvey { rings: found.rings.medians(), point_times })
            }
            Some(lidar) if LIDAR_TYPES.contains(&lidar) => {
                found.scans.take().map_or(Content::Other, Content::Scans)
            }
            Some(pose) if POSE_TYPES.contains(&pose) => {
                if let Some((first, _)) = found.fixes.first() {
                    found.poses = gnss::poses(&found.fixes, &gnss::origin(first));
                }
                let (poses, losses) = poses_survey(&std::mem::take(&mut found.poses));
                found.losses.merge(losses);
                Content::Poses(poses)
            }
            Some(tf) if FRAME_TYPES.contains(&tf) => {
                let transforms = std::mem::take(&mut found.transforms).into_iter();
                let survey = |((parent, child), found): (_, FoundTransform)| TransformSurvey {
                    parent,
                    child,
                    n_samples: found.n_samples,
                    is_constant: found.is_constant,
                };
                Content::Transforms(transforms.map(survey).collect())
            }
            Some(MessageType::JointState) => {
                let [joints, left, right] = wheels_of_topic(&found.joints);
                Content::Joints(JointsSurvey { joints, left, right })
            }
            _ => Content::Other,
        }
    }
}

/// Different kinds of `JointState` messages of a topic. More than this are not collected.
const MAX_JOINT_KINDS: usize = 100;

/// A device clock with a smaller offset agrees with the host clock \[s\]. GPS receivers and hosts with
/// NTP agree better. A free-running clock is that close by chance once in 900 times.
const ON_TIME_S: f64 = 2.0;

/// Packets that are reordered and split into revolutions, but not kept.
struct PacketCounts {
    n_packets: u64,
    model: ModelEvidence,
    first: Option<RingPacket>,
    reorderer: Reorderer,
    splitter: RevolutionSplitter,
    revolution_stamps_ns: Vec<i64>,
    stands_still: bool,
    /// The least of stamp minus device clock, past the hour \[s\].
    offset_s: f64,
}

impl PacketCounts {
    fn new() -> Self {
        Self {
            n_packets: 0,
            model: ModelEvidence::default(),
            first: None,
            reorderer: Reorderer::default(),
            splitter: RevolutionSplitter::new(&LidarOptions::default(), Laser::HORIZONTAL),
            revolution_stamps_ns: Vec::new(),
            stands_still: true,
            offset_s: f64::INFINITY,
        }
    }

    fn push(&mut self, packet: &RingPacket) {
        self.n_packets += 1;
        self.model.add_packet(packet);
        let first = self.first.get_or_insert(*packet);
        self.stands_still &= device_gap_us(first, packet) == 0.0;
        if packet.end_ns != 0 {
            self.offset_s = self.offset_s.min(offset_s(packet));
        }
        let mut revolutions = Vec::new();
        self.reorderer.push(packet, |packet| self.splitter.push(packet, &mut revolutions));
        self.add_revolutions(&revolutions);
    }

    fn add_revolutions(&mut self, revolutions: &[Revolution]) {
        self.revolution_stamps_ns.extend(revolutions.iter().map(|r| r.stamp_ns));
    }

    /// Ends the last revolution.
    fn finish(&mut self) -> SplitSummary {
        let mut revolutions = Vec::new();
        self.reorderer.flush(&mut |packet| self.splitter.push(packet, &mut revolutions));
        let summary = self.splitter.finish(&mut revolutions);
        self.add_revolutions(&revolutions);
        summary
    }

    /// Median rotation rate \[Hz\].
    fn spin_hz(&self) -> Option<f64> {
        let stamps = &self.revolution_stamps_ns;
        let mut periods: Vec<i64> = stamps.windows(2).map(|pair| pair[1] - pair[0]).collect();
        periods.sort_unstable();
        let period_ns = periods.get(periods.len() / 2).copied().filter(|&ns| ns > 0);
        period_ns.map(|ns| 1e9 / ns as f64)
    }

    fn clock(&self) -> ClockSurvey {
        match self.stands_still {
            true => ClockSurvey::Still,
            false if self.offset_s.abs() < ON_TIME_S => {
                ClockSurvey::OnTime { offset_s: self.offset_s }
            }
            false => ClockSurvey::FreeRunning { offset_s: self.offset_s },
        }
    }
}

/// Stamp minus device clock, past the hour \[s\]: the shorter way around the hour.
fn offset_s(packet: &RingPacket) -> f64 {
    let hour_s = f64::from(HOUR_US) * 1e-6;
    let host_s = packet.end_ns.rem_euclid(i64::from(HOUR_US) * 1000) as f64 * 1e-9;
    let offset_s = (host_s - f64::from(packet.device_us) * 1e-6).rem_euclid(hour_s);
    if hour_s / 2.0 < offset_s { offset_s - hour_s } else { offset_s }
}

/// Summarizes packets, and adds the losses to `found`. `None` without packets.
fn packets_survey(packets: Option<PacketCounts>, found: &mut Found) -> Option<PacketsSurvey> {
    let Some(mut packets) = packets else {
        let (model, &n) = found.foreign.iter().max_by_key(|(_, n)| **n)?;
        return Some(PacketsSurvey::of_other_sensor(format!("Velodyne {model}"), n));
    };
    if let Some(other) = packets.model.other_sensor() {
        let name = format!("Velodyne {} ({})", other.name, other.evidence);
        return Some(PacketsSurvey::of_other_sensor(name, packets.n_packets));
    }
    let split = packets.finish();
    for (model, &n) in &found.foreign {
        let model = (*model).to_owned();
        found.losses.add(LossKind::PacketsOfOtherModel { model }, n);
    }
    found.losses.merge(packets.reorderer.losses.clone());
    found.losses.merge(split.losses);
    let n_firings = packets.n_packets as f64 * BLOCKS as f64;
    let dead = (0..LASERS).filter(|&laser| found.n_returns[laser] == 0);
    let mode = found.return_modes.iter().max_by_key(|(_, n)| **n).map(|(mode, _)| *mode);
    Some(PacketsSurvey {
        sensor: format!("Velodyne {HDL32E}"),
        is_hdl32e: true,
        return_mode: [
            (ReturnMode::Strongest, "strongest"),
            (ReturnMode::Last, "last"),
            (ReturnMode::Dual, "dual"),
        ]
        .into_iter()
        .find_map(|(known, name)| (Some(known.byte()) == mode).then_some(name)),
        n_packets: packets.n_packets,
        n_missing: split.n_missing_packets,
        n_late: packets.reorderer.n_late,
        n_same_stamp: split.n_same_stamp,
        n_stamp_steps: split.n_stamp_steps,
        largest_stamp_step_s: split.largest_stamp_step_s,
        n_revolutions: packets.revolution_stamps_ns.len(),
        spin_hz: packets.spin_hz(),
        return_share: found.n_returns.iter().map(|&n| n as f64 / n_firings).collect(),
        dead_lasers: format_lasers(dead.fold(0, |mask, laser| mask | 1 << laser)),
        clock: packets.clock(),
    })
}
