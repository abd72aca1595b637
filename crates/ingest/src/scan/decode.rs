//! Decodes one piece of a log into packets, scans and readings of the motion.

use dataset::{Loss, LossKind, Losses, Subject};
use messages::{MessageType, Source};

use crate::deskew::timed_scan::TimedScan;
use crate::drive::topic::{FilePiece, Topic};
use crate::drive::window::Part;
use crate::mcap::chunk::{self, Buffer};
use crate::options::Options;
use crate::pose::message::undecodable;
use crate::pose::readings::MotionReadings;
use crate::scan::beam::Beam;
use crate::scan::{cloud, planar};
use crate::velodyne::packet::Packets;

/// Decodes pieces. Several threads can use it at once.
pub(crate) struct Reader<'a> {
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
    /// Number of messages of the topics, readable or not.
    pub(crate) n_messages: u64,
    /// Whether a part of the piece could not be read.
    pub(crate) is_damaged: bool,
    pub(crate) losses: Losses,
}

impl Reader<'_> {
    /// Decodes the messages of a piece that belong to `part`.
    pub(crate) fn decode(&self, from: &FilePiece<'_>, part: Part, buffer: &mut Buffer) -> Decoded {
        let FilePiece { file, log, piece, .. } = *from;
        let mut decoded = Decoded { file, ..Decoded::default() };
        let piece_losses = chunk::messages(log.bytes(), piece, buffer, |header, data| {
            let channel = header.channel_id;
            if let Some(source) = self.lidar.source(file, channel)
                && part != Part::Motion
            {
                decoded.n_messages += 1;
                if let Err(error) = self.decode_lidar(source, data, &mut decoded) {
                    let kind = undecodable(source, &error);
                    decoded.losses.add(Loss::new(kind, Subject::topic(&self.lidar.name)), 1);
                }
            }
            let Some(options) = self.options.pose.as_ref().filter(|_| part != Part::Lidar) else {
                return;
            };
            for topic in self.pose_topics {
                let Some(source) = topic.source(file, channel) else { continue };
                decoded.n_messages += 1;
                let log_ns = header.log_time;
                let added = decoded.motion.add(&topic.name, source, log_ns, data, options);
                if let Err(kind) = added {
                    decoded.losses.add(Loss::new(kind, Subject::topic(&topic.name)), 1);
                }
            }
        });
        decoded.is_damaged = !piece_losses.is_empty();
        // A piece with lidar messages is read twice. Count its losses only once.
        if part != Part::Motion || !self.lidar.may_be_in(from) {
            decoded.losses.merge(piece_losses);
        }
        decoded
    }

    fn decode_lidar(
        &self,
        source: Source,
        data: &[u8],
        decoded: &mut Decoded,
    ) -> messages::Result<()> {
        match source.message_type {
            MessageType::VelodyneScan | MessageType::VelodynePacket => {
                decoded.packets.add(source, data, self.beam.laser.index)?;
            }
            MessageType::PointCloud2 | MessageType::FoxglovePointCloud => {
                let found = cloud::scan(source, data, self.beam.ring, &self.options.lidar)?;
                decoded.scans.push(found.scan);
                decoded.n_sorted_clouds += u64::from(found.is_sorted);
                if 0 < found.n_beyond {
                    let subject = Subject::topic(&self.lidar.name);
                    let loss = Loss::new(LossKind::ReturnsBeyondRevolution, subject);
                    decoded.losses.add(loss, found.n_beyond);
                }
                decoded.n_clouds_of_other_clock += u64::from(found.is_of_other_clock);
            }
            _ => decoded.scans.push(planar::scan(source, data, &self.options.lidar)?),
        }
        Ok(())
    }
}
