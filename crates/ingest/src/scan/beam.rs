//! Which beam of the lidar makes the scan.

use messages::{MessageType, Source};

use crate::drive::topic::{Drive, FilePiece, Topic};
use crate::error::IngestError;
use crate::mcap::chunk::{self, Buffer};
use crate::options::LidarOptions;
use crate::scan::cloud::Rings;
use crate::velodyne::model::Laser;

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
