//! One piece of a log -> the packets, scans and poses in it.

use dataset::Dropped;
use messages::{MessageType, Source};

use crate::chunk::{self, Buffer};
use crate::cloud::{self, Rings};
use crate::deskew::TimedScan;
use crate::error::IngestError;
use crate::motion::Motion;
use crate::options::{LidarOptions, Options};
use crate::planar;
use crate::ring::Packets;
use crate::sensor::Laser;
use crate::topic::{Drive, FilePiece, Topic};

/// What of the lidar makes the scan.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Beam {
    /// Of packets.
    pub(crate) laser: Laser,
    /// Of point clouds.
    pub(crate) ring: u32,
}

impl Beam {
    /// Finds the beam that the options ask for; in clouds by the elevations of their points.
    pub(crate) fn choose(
        drive: &Drive<'_>,
        lidar: &Topic,
        options: &LidarOptions,
    ) -> Result<Self, IngestError> {
        let no_beam = |asked, found| IngestError::NoBeam {
            path: drive.path(),
            topic: lidar.name.clone(),
            asked,
            found,
        };
        let mut beam = Self { laser: Laser::HORIZONTAL, ring: 0 };
        let is_cloud = |source: &Source| {
            matches!(
                source.message_type,
                MessageType::PointCloud2 | MessageType::FoxglovePointCloud
            )
        };
        let is_packet = |source: &Source| {
            matches!(source.message_type, MessageType::VelodyneScan | MessageType::VelodynePacket)
        };
        if lidar.any(is_packet) {
            beam.laser = Laser::choose(options).map_err(|(asked, found)| no_beam(asked, found))?;
        }
        if lidar.any(is_cloud) {
            let mut rings = Rings::default();
            let mut buffer = Buffer::default();
            let mut is_enough = false;
            for FilePiece { file, log, piece, .. } in drive.pieces_with(&[lidar]) {
                if is_enough {
                    break;
                }
                // What cannot be read is counted when the scans are made.
                chunk::messages(log.bytes(), piece, &mut buffer, |header, data| {
                    if let Some(source) = lidar.source(file, header.channel_id).filter(is_cloud)
                        && !is_enough
                    {
                        is_enough = rings.add(source, data).is_ok() && rings.is_enough(options);
                    }
                });
            }
            // Without a readable cloud there is no scan either, and the reasons are counted.
            let chosen = rings.choose(options).map_err(|(asked, found)| no_beam(asked, found))?;
            beam.ring = chosen.unwrap_or(beam.ring);
        }
        Ok(beam)
    }
}

/// Reads pieces, several at once.
pub(crate) struct Reader<'a> {
    pub(crate) lidar: &'a Topic,
    /// Topics of poses, or of what they are made from.
    pub(crate) of_pose: &'a [&'a Topic],
    pub(crate) beam: Beam,
    pub(crate) options: &'a Options,
}

/// What is read of a piece.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) enum Part {
    Lidar,
    Motion,
    Both,
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
