//! Decodes one piece of a log into packets, scans and readings of the motion.

use dataset::{Loss, LossKind, Losses, Subject};
use messages::{MessageType, Source};

use crate::deskew::timed_scan::TimedScan;
use crate::drive::structure::PieceStructure;
use crate::drive::topic::{Drive, FilePiece, Topic};
use crate::drive::window::Part;
use crate::mcap::chunk::{self, Buffer, Rest};
use crate::observe::topic::TopicPiece;
use crate::options::Options;
use crate::pose::message::undecodable;
use crate::pose::readings::MotionReadings;
use crate::scan::beam::{Beam, is_cloud, is_packet};
use crate::scan::cloud_frame::ConeCheck;
use crate::scan::planar::{self, FromPlanar};
use crate::scan::planar_faults::PlanarReadings;
use crate::scan::{cloud, log_time};
use crate::stamp::Stamp;
use crate::velodyne::packet::Packets;

/// Decodes pieces. Several threads can use it at once.
pub(crate) struct Reader<'a> {
    pub(crate) drive: &'a Drive<'a>,
    pub(crate) lidar: &'a Topic,
    /// Topics of poses, or of the readings that poses are made from.
    pub(crate) pose_topics: &'a [&'a Topic],
    pub(crate) beam: Beam,
    pub(crate) options: &'a Options,
}

/// The content of one piece of a log.
#[derive(Default)]
pub(crate) struct Decoded {
    /// Number of the file of the piece.
    pub(crate) file: usize,
    pub(crate) packets: Packets,
    pub(crate) scans: Vec<TimedScan>,
    /// Number of clouds whose points were sorted.
    pub(crate) n_sorted_clouds: u64,
    /// Number of clouds whose point times come from another clock.
    pub(crate) n_clouds_of_other_clock: u64,
    pub(crate) motion: MotionReadings,
    /// What the messages of the lidar topic show.
    pub(crate) lidar: LidarPiece,
    /// What the messages of each pose topic show, in the order of the topics.
    pub(crate) poses: Vec<TopicPiece>,
    /// Number of messages of the topics, readable or not.
    pub(crate) n_messages: u64,
    /// Whether a part of the piece could not be read.
    pub(crate) is_damaged: bool,
    pub(crate) structure: PieceStructure,
    pub(crate) losses: Losses,
}

/// What the lidar messages of one piece show about their stamps, frames and readings.
#[derive(Default)]
pub(crate) struct LidarPiece {
    pub(crate) seen: TopicPiece,
    pub(crate) readings: PlanarReadings,
    /// Number of planar scans whose angles contradict each other, and the first contradiction.
    pub(crate) contradictory: Option<(u64, String)>,
    pub(crate) cones: ConeCheck,
    /// Number of clouds in `cones`.
    n_sampled_clouds: u64,
    /// Number of points of the ring of all clouds, and of those that are returns.
    pub(crate) n_points: (u64, u64),
}

impl LidarPiece {
    /// Adds what the next piece shows, except the stamps and frames.
    pub(crate) fn merge_readings(&mut self, later: Self) {
        self.readings.merge(later.readings);
        if let Some((n, first)) = later.contradictory {
            self.contradictory.get_or_insert((0, first)).0 += n;
        }
        self.cones.merge(later.cones);
        self.n_points.0 += later.n_points.0;
        self.n_points.1 += later.n_points.1;
    }
}

impl Reader<'_> {
    /// Decodes the messages of a piece that belong to `part`.
    pub(crate) fn decode(&self, from: &FilePiece<'_>, part: Part, buffer: &mut Buffer) -> Decoded {
        let FilePiece { file, log, piece, .. } = *from;
        let mut decoded = Decoded { file, ..Decoded::default() };
        decoded.poses.resize_with(self.pose_topics.len(), TopicPiece::default);
        let mut n_undefined = 0;
        let rest = chunk::messages(log.bytes(), piece, buffer, |header, data| {
            let channel = header.channel_id;
            n_undefined += u64::from(!self.drive.defines(file, channel));
            if let Some(source) = self.lidar.source(file, channel)
                && part != Part::Motion
            {
                decoded.n_messages += 1;
                let log_ns = header.log_time;
                if let Err(error) = self.decode_lidar(source, log_ns, data, &mut decoded) {
                    let kind = undecodable(source, &error);
                    decoded.losses.add(Loss::new(kind, Subject::topic(&self.lidar.name)), 1);
                }
            }
            let Some(options) = self.options.pose.as_ref().filter(|_| part != Part::Lidar) else {
                return;
            };
            for (topic, seen) in self.pose_topics.iter().zip(&mut decoded.poses) {
                let Some(source) = topic.source(file, channel) else { continue };
                decoded.n_messages += 1;
                let log_ns = header.log_time;
                let wanted = match source.message_type {
                    MessageType::Imu => options.imu_frame_id.as_deref(),
                    _ => options.frame_id.as_deref(),
                };
                let header = seen.add(source, log_ns, data, wanted, topic.starts_at_zero);
                let is_unstamped = header.is_some_and(|header| header.is_unstamped);
                if is_unstamped && options.stamp == Stamp::Header {
                    let subject = Subject::topic(&topic.name);
                    decoded.losses.add(Loss::new(LossKind::UnstampedMessages, subject), 1);
                    continue;
                }
                let added = decoded.motion.add(&topic.name, source, log_ns, data, options);
                if let Err(kind) = added {
                    decoded.losses.add(Loss::new(kind, Subject::topic(&topic.name)), 1);
                }
            }
        });
        let Rest { losses, definitions } = rest;
        decoded.is_damaged = !losses.is_empty();
        // A piece with lidar messages is read twice. Count its losses only once.
        if part != Part::Motion || !self.lidar.may_be_in(from) {
            decoded.losses.merge(losses);
            decoded.structure = PieceStructure::new(self.drive, file, n_undefined, definitions);
        }
        decoded
    }

    fn decode_lidar(
        &self,
        source: Source,
        log_ns: u64,
        data: &[u8],
        decoded: &mut Decoded,
    ) -> messages::Result<()> {
        let options = &self.options.lidar;
        let (wanted, from_zero) = (options.frame_id.as_deref(), self.lidar.starts_at_zero);
        let seen = decoded.lidar.seen.add(source, log_ns, data, wanted, from_zero);
        // A message whose header cannot be read is counted below.
        if seen.as_ref().is_some_and(|header| !header.is_wanted) {
            return Ok(());
        }
        if is_packet(&source) {
            let log_ns = (options.stamp == Stamp::Log).then_some(log_ns);
            return decoded.packets.add(source, data, self.beam.laser.index, log_ns);
        }
        if seen.is_some_and(|header| header.is_unstamped) && options.stamp == Stamp::Header {
            let subject = Subject::topic(&self.lidar.name);
            decoded.losses.add(Loss::new(LossKind::UnstampedMessages, subject), 1);
            return Ok(());
        }
        let scan = match is_cloud(&source) {
            true => Some(self.decode_cloud(source, data, decoded)?),
            false => {
                let lidar = &mut decoded.lidar;
                match planar::scan(source, data, options, &mut lidar.readings)? {
                    FromPlanar::Scan(scan) => Some(scan),
                    FromPlanar::Contradictory(fault) => {
                        lidar.contradictory.get_or_insert((0, fault)).0 += 1;
                        None
                    }
                }
            }
        };
        decoded.scans.extend(scan.map(|scan| match options.stamp {
            Stamp::Header => scan,
            Stamp::Log => log_time::restamp(scan, log_ns),
        }));
        Ok(())
    }

    fn decode_cloud(
        &self,
        source: Source,
        data: &[u8],
        decoded: &mut Decoded,
    ) -> messages::Result<TimedScan> {
        let Beam { ring, point_time, .. } = &self.beam;
        let found = cloud::scan(source, data, *ring, point_time, &self.options.lidar)?;
        let lidar = &mut decoded.lidar;
        // One cloud per piece is enough to find out whether the rings are cones.
        if lidar.n_sampled_clouds == 0 {
            lidar.n_sampled_clouds += 1;
            cloud::check_frame(source, data, &mut lidar.cones)?;
        }
        lidar.n_points.0 += found.n_points;
        lidar.n_points.1 += found.scan.scan.len() as u64;
        decoded.n_sorted_clouds += u64::from(found.is_sorted);
        if 0 < found.n_beyond {
            let subject = Subject::topic(&self.lidar.name);
            let loss = Loss::new(LossKind::ReturnsBeyondRevolution, subject);
            decoded.losses.add(loss, found.n_beyond);
        }
        decoded.n_clouds_of_other_clock += u64::from(found.is_of_other_clock);
        Ok(found.scan)
    }
}
