//! Selects the beam of the lidar that makes the scan.

use messages::{MessageType, Source, read_frame_ids};

use crate::drive::topic::{Drive, FilePiece, Topic};
use crate::error::{BeamNotFound, IngestError};
use crate::mcap::chunk::{self, Buffer};
use crate::observe::frames::without_slash;
use crate::options::LidarOptions;
use crate::scan::cloud::Rings;
use crate::scan::point_time::PointTimeFound;
use crate::velodyne::model::Laser;

/// The beam that makes the scan.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Beam {
    /// The laser, for packets.
    pub(crate) laser: Laser,
    /// The ring, for point clouds.
    pub(crate) ring: u32,
    /// How the points of clouds state their times.
    pub(crate) point_time: PointTimeFound,
}

impl Beam {
    /// Selects the beam by the options. In point clouds, the elevations of the points identify the
    /// beam.
    pub(crate) fn choose(
        drive: &Drive<'_>,
        lidar: &Topic,
        options: &LidarOptions,
    ) -> Result<Self, IngestError> {
        let no_beam = |BeamNotFound { requested, available }| IngestError::NoBeam {
            path: drive.path(),
            topic: lidar.name.clone(),
            requested,
            available,
        };
        let mut beam = Self { laser: Laser::HORIZONTAL, ring: 0, point_time: PointTimeFound::None };
        if lidar.any(is_packet) {
            beam.laser = Laser::choose(options).map_err(no_beam)?;
        }
        if lidar.any(is_cloud) {
            let rings = read_rings(drive, lidar, options);
            // Without a readable cloud there is no scan, and the losses say why.
            beam.ring = rings.choose(options).map_err(no_beam)?.unwrap_or(beam.ring);
            beam.point_time = rings.point_time();
        }
        Ok(beam)
    }
}

pub(crate) fn is_cloud(source: &Source) -> bool {
    matches!(source.message_type, MessageType::PointCloud2 | MessageType::FoxglovePointCloud)
}

pub(crate) fn is_packet(source: &Source) -> bool {
    matches!(source.message_type, MessageType::VelodyneScan | MessageType::VelodynePacket)
}

/// Whether a message is in the frame of the options. All messages are, if the options name no frame.
fn is_selected(source: Source, data: &[u8], options: &LidarOptions) -> bool {
    options.frame_id.as_deref().is_none_or(|wanted| {
        let found = read_frame_ids(source, data).ok().flatten();
        found.is_some_and(|ids| ids.frame_id == without_slash(wanted))
    })
}

/// Reads clouds until the rings and their elevations are known.
fn read_rings(drive: &Drive<'_>, lidar: &Topic, options: &LidarOptions) -> Rings {
    let mut rings = Rings::default();
    let mut buffer = Buffer::default();
    let mut is_enough = false;
    for FilePiece { file, log, piece, .. } in drive.pieces_with(&[lidar]) {
        if is_enough {
            break;
        }
        // Losses are counted later, when the scans are read.
        chunk::messages(log.bytes(), piece, &mut buffer, |header, data| {
            if let Some(source) = lidar.source(file, header.channel_id).filter(is_cloud)
                && !is_enough
                && is_selected(source, data, options)
            {
                is_enough = rings.add(source, data).is_ok() && rings.is_enough(options);
            }
        });
    }
    rings
}
