//! Selects the beam of the lidar that makes the scan.

use messages::{MessageType, Source, read_frame_ids};

use crate::drive::topic::{Drive, FilePiece, Topic};
use crate::error::{BeamNotFound, IngestError};
use crate::mcap::chunk::{self, Buffer};
use crate::observe::frames::without_slash;
use crate::options::LidarOptions;
use crate::scan::cloud::{Rings, check_frame};
use crate::scan::cloud_frame::{ConeCheck, FrameName};
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
            let Clouds { rings, cones, frame_id } = read_clouds(drive, lidar, options);
            let name = FrameName::of(&frame_id, std::iter::empty());
            // Rings of clouds in another frame have no elevation to select a beam by.
            let no_beam = |not_found| match cones.fault(name) {
                None => no_beam(not_found),
                Some(evidence) => {
                    let (path, topic) = (drive.path(), lidar.name.clone());
                    let frame_id = frame_id.clone();
                    IngestError::NotInSensorFrame { path, topic, frame_id, evidence }
                }
            };
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

/// What the first clouds of a drive show.
#[derive(Default)]
struct Clouds {
    rings: Rings,
    /// The rings of the first few clouds.
    cones: ConeCheck,
    /// Frame of the first cloud.
    frame_id: String,
}

/// Number of clouds whose frame is checked.
const N_CHECKED: usize = 10;

/// Reads clouds until the rings and their elevations are known.
fn read_clouds(drive: &Drive<'_>, lidar: &Topic, options: &LidarOptions) -> Clouds {
    let mut clouds = Clouds::default();
    let mut buffer = Buffer::default();
    let mut n_checked = 0;
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
                && clouds.rings.add(source, data).is_ok()
            {
                is_enough = clouds.rings.is_enough(options);
                if n_checked == 0 {
                    let ids = read_frame_ids(source, data).ok().flatten().unwrap_or_default();
                    clouds.frame_id = ids.frame_id.into_owned();
                }
                if n_checked < N_CHECKED && check_frame(source, data, &mut clouds.cones).is_ok() {
                    n_checked += 1;
                }
            }
        });
    }
    clouds
}
