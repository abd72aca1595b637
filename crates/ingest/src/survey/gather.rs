//! A look at a whole drive: what its topics hold, how well, and what is wrong with it.

use std::collections::BTreeMap;

use dataset::{Dropped, StampedPose, Trajectory};
use messages::hdl32e::{self, BLOCKS, HORIZONTAL_LASER, HOUR_US, LASERS, Packet, ReturnMode};
use messages::{MessageType, NavSatFix, Source, read_laser_scan, read_velodyne};
use rayon::prelude::*;

use crate::drive::topic::{Drive, FilePiece};
use crate::drive::window::{PIECES_PER_THREAD, forget};
use crate::mcap::chunk::{self, Buffer};
use crate::mcap::log::{Channel, Log};
use crate::options::LidarOptions;
use crate::pose::{gnss, message};
use crate::scan::cloud::Rings;
use crate::survey::report::{
    ClockSurvey, CloudsSurvey, Content, PacketsSurvey, PosesSurvey, ScansSurvey, Survey,
    TopicSurvey, TransformSurvey,
};
use crate::types::{FRAME_TYPES, LIDAR_TYPES, POSE_TYPES};
use crate::velodyne::device_clock::device_gap_us;
use crate::velodyne::model::{self, HDL32E, Laser, PACKETS_TO_IDENTIFY};
use crate::velodyne::packet::RingPacket;
use crate::velodyne::reorder::Reorderer;
use crate::velodyne::split::RevolutionSplitter;

/// Surveys a drive, one log or several that were split from one.
///
/// `progress` is told how many bytes of the files have been read.
pub fn survey(logs: &[&Log], progress: impl Fn(u64)) -> Survey {
    let drive = Drive::new(logs);
    let mut survey = Survey {
        n_bytes: logs.iter().map(|log| log.bytes().len() as u64).sum(),
        time_range_ns: drive.time_range_ns(),
        dropped: drive.dropped(),
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
        let found: Vec<(BTreeMap<TopicKey, Found>, Dropped)> = window
            .par_iter()
            .map_init(Buffer::default, |buffer, piece| look(piece, &keys, buffer))
            .collect();
        for (found, dropped) in found {
            survey.dropped.merge(dropped);
            for (key, found) in found {
                topics.entry(key).or_default().add(found);
            }
        }
        forget(window, &progress);
    }
    survey.topics = topics
        .into_iter()
        .map(|(key, gathered)| gathered.finish(key, &mut survey.dropped))
        .collect();
    survey
}

/// Topic, schema and encoding.
type TopicKey = (String, String, String);
/// The topic of each file's channels, and how its messages are read.
type Keys = BTreeMap<(usize, u16), (TopicKey, Option<Source>)>;

fn key_of(channel: &Channel) -> TopicKey {
    (channel.topic.clone(), channel.schema.clone(), channel.message_encoding.clone())
}

/// What one piece holds of one topic.
#[derive(Default)]
struct Found {
    n_messages: u64,
    source: Option<Source>,
    /// Of the first and the last message.
    log_times: Option<(u64, u64)>,
    packets: Vec<RingPacket>,
    return_modes: BTreeMap<u8, u64>,
    /// Returns of each laser.
    n_returns: [u64; LASERS],
    foreign: BTreeMap<&'static str, u64>,
    poses: Vec<StampedPose>,
    fixes: Vec<NavSatFix>,
    /// How often each transform is told, by parent and child.
    transforms: BTreeMap<(String, String), u64>,
    scans: Option<ScansSurvey>,
    rings: Rings,
    dropped: Dropped,
}

fn look(
    piece: &FilePiece<'_>,
    keys: &Keys,
    buffer: &mut Buffer,
) -> (BTreeMap<TopicKey, Found>, Dropped) {
    let mut found: BTreeMap<TopicKey, Found> = BTreeMap::new();
    let mut strays = Dropped::default();
    let lost = chunk::messages(piece.log.bytes(), piece.piece, buffer, |header, data| {
        let time = header.log_time;
        match keys.get(&(piece.file, header.channel_id)) {
            Some((key, source)) => match found.get_mut(key) {
                Some(found) => found.add(&key.0, *source, time, data),
                None => found.entry(key.clone()).or_default().add(&key.0, *source, time, data),
            },
            None => strays.add("messages of channels that the log does not define", 1),
        }
    });
    strays.merge(lost);
    (found, strays)
}

impl Found {
    fn add(&mut self, topic: &str, source: Option<Source>, time: u64, data: &[u8]) {
        self.n_messages += 1;
        let (first, last) = self.log_times.unwrap_or((time, time));
        self.log_times = Some((first.min(time), last.max(time)));
        let Some(source) = source else { return };
        self.source = Some(source);
        let result = match source.message_type {
            MessageType::VelodyneScan | MessageType::VelodynePacket => {
                self.add_packets(source, data)
            }
            MessageType::LaserScan | MessageType::FoxgloveLaserScan => self.add_scan(source, data),
            // One of each piece tells the rings.
            MessageType::PointCloud2 | MessageType::FoxglovePointCloud => match self.n_messages {
                1 => self.rings.add(source, data),
                _ => Ok(()),
            },
            MessageType::Tf | MessageType::FoxgloveFrameTransform => {
                messages::read_transforms(source, data).map(|transforms| {
                    for transform in transforms {
                        let names = (transform.parent, transform.child);
                        *self.transforms.entry(names).or_default() += 1;
                    }
                })
            }
            MessageType::NavSatFix => {
                messages::read_nav_sat_fix(source, data).map(|fix| match gnss::check(&fix) {
                    Ok(()) => self.fixes.push(fix),
                    Err(reason) => self.dropped.add(format!("messages of {topic} {reason}"), 1),
                })
            }
            other if POSE_TYPES.contains(&other) => match message::stamped_pose(source, data) {
                Ok(pose) => {
                    self.poses.push(pose);
                    Ok(())
                }
                Err(reason) => {
                    self.dropped.add(format!("messages of {topic} {reason}"), 1);
                    Ok(())
                }
            },
            _ => Ok(()),
        };
        if let Err(error) = result {
            let kind = source.message_type.name();
            let reason =
                format!("messages of {topic} that do not decode as {kind} ({})", error.kind());
            self.dropped.add(reason, 1);
        }
    }

    fn add_packets(&mut self, source: Source, data: &[u8]) -> messages::Result<()> {
        for (end_ns, bytes) in read_velodyne(source, data)?.packets() {
            let Ok(packet) = Packet::new(bytes) else {
                match hdl32e::foreign_layout(bytes) {
                    Some(model) => *self.foreign.entry(model).or_default() += 1,
                    None => {
                        let reason = "packets without the layout of an HDL-32E data packet";
                        self.dropped.add(reason, 1);
                    }
                }
                continue;
            };
            self.packets.push(RingPacket::new(end_ns, &packet, HORIZONTAL_LASER));
            *self
                .return_modes
                .entry(packet.return_mode().map_or(0, ReturnMode::byte))
                .or_default() += 1;
            for (laser, n) in self.n_returns.iter_mut().enumerate() {
                *n +=
                    (0..BLOCKS).filter(|&block| packet.distance(block, laser) != 0).count() as u64;
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
}

/// What all pieces hold of one topic.
#[derive(Default)]
struct Gathered {
    found: Found,
    packets: Option<PacketsOfTopic>,
}

/// Packets, put in order and cut into turns, but not kept.
struct PacketsOfTopic {
    n_packets: u64,
    first: Vec<RingPacket>,
    reorderer: Reorderer,
    splitter: RevolutionSplitter,
    revolution_stamps_ns: Vec<i64>,
    still: bool,
    /// Least of stamps minus device clock, past the hour \[s\].
    offset_s: f64,
}

/// A device clock this near to the host's is on time \[s\]: GPS receivers and hosts on NTP agree
/// better; a free-running clock comes this near by chance once in 900 times.
const ON_TIME_S: f64 = 2.0;

impl PacketsOfTopic {
    fn new() -> Self {
        Self {
            n_packets: 0,
            first: Vec::new(),
            reorderer: Reorderer::default(),
            splitter: RevolutionSplitter::new(&LidarOptions::default(), Laser::HORIZONTAL),
            revolution_stamps_ns: Vec::new(),
            still: true,
            offset_s: f64::INFINITY,
        }
    }

    fn push(&mut self, packet: &RingPacket) {
        self.n_packets += 1;
        if let Some(first) = self.first.first() {
            self.still &= device_gap_us(first, packet) == 0.0;
        }
        if self.first.len() < PACKETS_TO_IDENTIFY {
            self.first.push(*packet);
        }
        if packet.end_ns != 0 {
            self.offset_s = self.offset_s.min(offset_s(packet));
        }
        let mut revolutions = Vec::new();
        self.reorderer.push(packet, |packet| self.splitter.push(packet, &mut revolutions));
        self.revolution_stamps_ns.extend(revolutions.iter().map(|revolution| revolution.stamp_ns));
    }
}

/// Stamp less device clock, past the hour; of the two ways around the shorter \[s\].
fn offset_s(packet: &RingPacket) -> f64 {
    let hour_s = f64::from(HOUR_US) * 1e-6;
    let host_s = packet.end_ns.rem_euclid(i64::from(HOUR_US) * 1000) as f64 * 1e-9;
    let offset_s = (host_s - f64::from(packet.device_us) * 1e-6).rem_euclid(hour_s);
    if hour_s / 2.0 < offset_s { offset_s - hour_s } else { offset_s }
}

impl Gathered {
    fn add(&mut self, found: Found) {
        let all = &mut self.found;
        all.n_messages += found.n_messages;
        all.source = all.source.or(found.source);
        all.log_times = match (all.log_times, found.log_times) {
            (Some((a, b)), Some((c, d))) => Some((a.min(c), b.max(d))),
            (one, other) => one.or(other),
        };
        for (mode, n) in found.return_modes {
            *all.return_modes.entry(mode).or_default() += n;
        }
        all.n_returns.iter_mut().zip(found.n_returns).for_each(|(a, b)| *a += b);
        for (model, n) in found.foreign {
            *all.foreign.entry(model).or_default() += n;
        }
        all.poses.extend(found.poses);
        all.fixes.extend(found.fixes);
        for (names, n) in found.transforms {
            *all.transforms.entry(names).or_default() += n;
        }
        if let Some(scans) = found.scans {
            let merged = all.scans.get_or_insert_with(|| scans.clone());
            merged.n_beams =
                (merged.n_beams.0.min(scans.n_beams.0), merged.n_beams.1.max(scans.n_beams.1));
            merged.coverage_deg = merged.coverage_deg.max(scans.coverage_deg);
        }
        all.rings.merge(found.rings);
        all.dropped.merge(found.dropped);
        for packet in &found.packets {
            self.packets.get_or_insert_with(PacketsOfTopic::new).push(packet);
        }
    }

    fn finish(mut self, (topic, schema, encoding): TopicKey, dropped: &mut Dropped) -> TopicSurvey {
        dropped.merge(std::mem::take(&mut self.found.dropped));
        let n_messages = self.found.n_messages;
        let rate_hz = self.found.log_times.and_then(|(first, last)| {
            (first < last && n_messages > 1)
                .then(|| (n_messages - 1) as f64 / ((last - first) as f64 * 1e-9))
        });
        let source = Source::new(&schema, &encoding).or(self.found.source);
        let message_type = source.map(|source| source.message_type);
        let content = match message_type {
            Some(MessageType::VelodyneScan | MessageType::VelodynePacket) => {
                self.packets_survey(dropped).map_or(Content::Other, Content::Packets)
            }
            Some(MessageType::PointCloud2 | MessageType::FoxglovePointCloud) => {
                Content::Clouds(CloudsSurvey { rings: self.found.rings.medians() })
            }
            Some(lidar) if LIDAR_TYPES.contains(&lidar) => {
                self.found.scans.map_or(Content::Other, Content::Scans)
            }
            Some(pose) if POSE_TYPES.contains(&pose) => {
                if let Some(first) = self.found.fixes.first() {
                    self.found.poses = gnss::poses(&self.found.fixes, &gnss::origin(first));
                }
                let (trajectory, n_duplicates) = Trajectory::new(self.found.poses);
                let reason = format!("poses of {topic} with the stamp of another pose");
                dropped.add(reason, n_duplicates as u64);
                Content::Poses(poses_survey(&trajectory))
            }
            Some(tf) if FRAME_TYPES.contains(&tf) => {
                let told =
                    |((parent, child), n_samples)| TransformSurvey { parent, child, n_samples };
                Content::Transforms(self.found.transforms.into_iter().map(told).collect())
            }
            _ => Content::Other,
        };
        TopicSurvey { topic, schema, encoding, n_messages, rate_hz, content }
    }

    fn packets_survey(&mut self, dropped: &mut Dropped) -> Option<PacketsSurvey> {
        let foreign = self.found.foreign.iter().max_by_key(|(_, n)| **n);
        let Some(mut packets) = self.packets.take() else {
            let (model, &n) = foreign?;
            return Some(PacketsSurvey::of_another(format!("Velodyne {model}"), n));
        };
        if let Some(other) = model::other_sensor(&packets.first) {
            let name = format!("Velodyne {} ({})", other.name, other.evidence);
            return Some(PacketsSurvey::of_another(name, packets.n_packets));
        }
        let mut revolutions = Vec::new();
        packets.reorderer.flush(&mut |packet| packets.splitter.push(packet, &mut revolutions));
        let ends = packets.splitter.finish(&mut revolutions);
        packets
            .revolution_stamps_ns
            .extend(revolutions.iter().map(|revolution| revolution.stamp_ns));
        dropped.merge(packets.reorderer.dropped);
        dropped.merge(ends.dropped);
        for (model, &n) in &self.found.foreign {
            dropped.add(format!("packets of a Velodyne {model}"), n);
        }
        let stamps = &packets.revolution_stamps_ns;
        let mut periods: Vec<i64> = stamps.windows(2).map(|pair| pair[1] - pair[0]).collect();
        periods.sort_unstable();
        let period_ns = periods.get(periods.len() / 2).copied().filter(|&ns| ns > 0);
        let n_blocks = packets.n_packets as f64 * BLOCKS as f64;
        let dead = (0..LASERS).filter(|&laser| self.found.n_returns[laser] == 0);
        let mode = self.found.return_modes.iter().max_by_key(|(_, n)| **n).map(|(mode, _)| *mode);
        let (n_stamp_steps, largest_stamp_step_s) = packets.splitter.stamp_steps();
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
            n_missing: ends.n_missing_packets,
            n_late: packets.reorderer.n_late,
            n_same_stamp: ends.n_same_stamp,
            n_stamp_steps,
            largest_stamp_step_s,
            n_revolutions: stamps.len(),
            spin_hz: period_ns.map(|ns| 1e9 / ns as f64),
            return_share: self.found.n_returns.iter().map(|&n| n as f64 / n_blocks).collect(),
            dead_lasers: model::lasers(dead.fold(0, |mask, laser| mask | 1 << laser)),
            clock: match packets.still {
                true => ClockSurvey::Still,
                false if packets.offset_s.abs() < ON_TIME_S => {
                    ClockSurvey::OnTime { offset_s: packets.offset_s }
                }
                false => ClockSurvey::FreeRunning { offset_s: packets.offset_s },
            },
        })
    }
}

fn poses_survey(trajectory: &Trajectory) -> PosesSurvey {
    let poses = trajectory.poses();
    let extent = |along: fn(&StampedPose) -> f64| {
        let (least, most) = poses
            .iter()
            .map(along)
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(least, most), value| {
                (least.min(value), most.max(value))
            });
        (most - least).max(0.0)
    };
    let steps = || poses.windows(2).map(|pair| (&pair[0], &pair[1]));
    PosesSurvey {
        // From 0, since the sum of nothing is -0.
        path_m: steps().fold(0.0, |path, (a, b)| path + a.pose.distance_m(&b.pose)),
        widest_gap_s: steps()
            .map(|(a, b)| b.stamp_ns.saturating_sub(a.stamp_ns) as f64 * 1e-9)
            .fold(0.0, f64::max),
        extent_m: (extent(|p| p.pose.x_m), extent(|p| p.pose.y_m)),
    }
}
