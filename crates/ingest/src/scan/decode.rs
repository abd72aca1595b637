//! One piece of a log -> the packets, scans and poses in it.

use dataset::Dropped;
use messages::{MessageType, Source};

use crate::deskew::motion::TimedScan;
use crate::drive::topic::{FilePiece, Topic};
use crate::drive::window::Part;
use crate::mcap::chunk::{self, Buffer};
use crate::options::Options;
use crate::pose::readings::Motion;
use crate::scan::beam::Beam;
use crate::scan::cloud;
use crate::scan::planar;
use crate::velodyne::packet::Packets;

/// Reads pieces, several at once.
pub(crate) struct Reader<'a> {
    pub(crate) lidar: &'a Topic,
    /// Topics of poses, or of what they are made from.
    pub(crate) of_pose: &'a [&'a Topic],
    pub(crate) beam: Beam,
    pub(crate) options: &'a Options,
}

/// What one piece of the log holds.
#[derive(Default)]
pub(crate) struct Decoded {
    /// Number of the file it is of.
    pub(crate) file: usize,
    pub(crate) packets: Packets,
    pub(crate) scans: Vec<TimedScan>,
    pub(crate) n_sorted_clouds: u64,
    pub(crate) n_clouds_of_other_clock: u64,
    pub(crate) motion: Motion,
    /// Messages of the topics, whether they could be read or not.
    pub(crate) n_messages: u64,
    /// Whether a part of the piece itself could not be read.
    pub(crate) is_damaged: bool,
    pub(crate) dropped: Dropped,
}

impl Reader<'_> {
    pub(crate) fn decode(&self, from: &FilePiece<'_>, part: Part, buffer: &mut Buffer) -> Decoded {
        let FilePiece { file, log, piece, .. } = *from;
        let mut decoded = Decoded { file, ..Decoded::default() };
        let lost = chunk::messages(log.bytes(), piece, buffer, |header, data| {
            let channel = header.channel_id;
            if let Some(source) = self.lidar.source(file, channel)
                && part != Part::Motion
            {
                decoded.n_messages += 1;
                if let Err(error) = self.decode_lidar(source, data, &mut decoded) {
                    let (topic, kind) = (&self.lidar.name, source.message_type.name());
                    let why = error.kind();
                    let reason =
                        format!("messages of {topic} that do not decode as {kind} ({why})");
                    decoded.dropped.add(reason, 1);
                }
            }
            let Some(options) = self.options.pose.as_ref().filter(|_| part != Part::Lidar) else {
                return;
            };
            for topic in self.of_pose {
                let Some(source) = topic.source(file, channel) else { continue };
                decoded.n_messages += 1;
                if let Err(reason) = decoded.motion.add(&topic.name, source, data, options) {
                    decoded.dropped.add(format!("messages of {} {reason}", topic.name), 1);
                }
            }
        });
        decoded.is_damaged = !lost.is_empty();
        // A piece that is read for its lidar too is counted then.
        if part != Part::Motion || !self.lidar.may_be_in(from) {
            decoded.dropped.merge(lost);
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
                let of_cloud = cloud::scan(source, data, self.beam.ring, &self.options.lidar)?;
                decoded.scans.push(of_cloud.scan);
                decoded.n_sorted_clouds += u64::from(of_cloud.is_sorted);
                let reason = "returns beyond one turn of their cloud";
                decoded.dropped.add(reason, of_cloud.n_beyond);
                decoded.n_clouds_of_other_clock += u64::from(of_cloud.is_of_other_clock);
            }
            _ => decoded.scans.push(planar::scan(source, data, &self.options.lidar)?),
        }
        Ok(())
    }
}
