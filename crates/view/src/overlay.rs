//! The overlay: an MCAP file that Foxglove shows together with the log.

use std::collections::BTreeMap;
use std::io::{Seek, Write};

use dataset::{JudgedClosure, MapPose, Pose2, ScanId, StampedPose};
use mcap::records::{MessageHeader, Metadata};
use mcap::{WriteOptions, Writer};
use rayon::prelude::*;
use register::{Member, Square, Submap, SubmapOptions};
use serde_json::Value;

use crate::error::ViewError;
use crate::placed::PlacedScan;
use crate::schemas::Schema;
use crate::wire::{
    Entity, Line, LineType, frame_transform, point_cloud, poses_in_frame, scene_update,
};

/// Topic of the accepted closures.
pub(crate) const ACCEPTED: &str = "/loopboost/closures/accepted";
/// Topic of the rejected closures.
pub(crate) const REJECTED: &str = "/loopboost/closures/rejected";
/// Topic of the ellipses of the keyframes.
pub(crate) const COVARIANCES: &str = "/loopboost/covariances";
/// Topic of the trajectory by odometry.
pub(crate) const ODOMETRY: &str = "/loopboost/trajectory/odometry";
/// Topic of the trajectory by scan matching.
pub(crate) const SCAN_MATCHING: &str = "/loopboost/trajectory/scan_matching";
/// Topic of the optimized trajectory.
pub(crate) const OPTIMIZED: &str = "/loopboost/trajectory/optimized";
/// Topic of the submaps.
pub(crate) const SUBMAPS: &str = "/loopboost/submaps";
/// Topic of the transforms from the map to the lidar.
const TRANSFORMS: &str = "/loopboost/tf";

/// The topics and their types, in the order of their channels.
const TOPICS: [(&str, Schema); 8] = [
    (ACCEPTED, Schema::SceneUpdate),
    (REJECTED, Schema::SceneUpdate),
    (COVARIANCES, Schema::SceneUpdate),
    (ODOMETRY, Schema::PosesInFrame),
    (SCAN_MATCHING, Schema::PosesInFrame),
    (OPTIMIZED, Schema::PosesInFrame),
    (SUBMAPS, Schema::PointCloud),
    (TRANSFORMS, Schema::FrameTransform),
];

/// Approximate uncompressed size of a chunk \[bytes\].
const CHUNK_BYTES: u64 = 1 << 20;
/// The default of Zstandard.
const ZSTD_LEVEL: u32 = 3;
/// Path length of a submap \[m\].
const SUBMAP_M: f64 = 5.0;
/// Side of a square of a submap \[m\].
const SUBMAP_SQUARE_M: f64 = 0.1;
/// Points of an ellipse.
const ELLIPSE_POINTS: u32 = 24;
/// The 95 % quantile of the chi-square distribution with 2 degrees of freedom.
const CHI_SQUARE_95: f64 = 5.991;

const GREEN: [f64; 4] = [0.2, 0.8, 0.3, 1.0];
const YELLOW: [f64; 4] = [0.9, 0.8, 0.1, 0.8];

/// A closure between two keyframes of one map.
#[derive(Debug, Clone, Copy)]
pub struct ClosureLine<'a> {
    /// Row of the closure in `closures.parquet`, from 0.
    pub row: usize,
    /// The closure.
    pub closure: &'a JudgedClosure,
    /// Optimized poses of the query and of the reference.
    pub ends: [Pose2; 2],
}

/// The part of a log that lies in one map. It has at least one scan.
#[derive(Debug, Clone)]
pub struct MapPart<'a> {
    /// Number of the map in the run.
    pub map: u32,
    /// The closures whose query is in this part.
    pub closures: Vec<ClosureLine<'a>>,
    /// The keyframes.
    pub keyframes: Vec<&'a MapPose>,
    /// Poses of the registered scans by odometry, from the pose of the first one in the map.
    pub odometry: Vec<Pose2>,
    /// Poses of the registered scans by scan matching, from the pose of the first one in the map.
    pub scan_matching: Vec<Pose2>,
    /// The registered scans with their optimized poses.
    pub scans: Vec<PlacedScan<'a>>,
    /// The optimized poses of the lidar at every scan, in the order of time.
    pub poses: Vec<StampedPose>,
}

/// The contents of an overlay.
#[derive(Debug, Clone, Copy)]
pub struct Overlay<'a> {
    /// The frame of the lidar in the log.
    pub lidar_frame: &'a str,
    /// The parts of the log, in the order of time.
    pub parts: &'a [MapPart<'a>],
    /// What the overlay was made from: names and digests of the tables. They are stored in the file.
    pub inputs: &'a BTreeMap<String, String>,
}

/// What an overlay contains.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct OverlaySummary {
    /// Number of lines of accepted closures.
    pub n_accepted: usize,
    /// Number of lines of rejected closures.
    pub n_rejected: usize,
    /// Number of transforms from the map to the lidar.
    pub n_transforms: usize,
}

/// The frame of a map in the overlay.
pub(crate) fn map_frame(map: u32) -> String {
    format!("loopboost_map_{map}")
}

/// Writes an overlay, in the order of time.
///
/// The lines, ellipses and trajectories of a map have the time of its first scan. A submap has the time of
/// its last scan, and a transform that of its scan.
pub fn write_overlay<W: Write + Seek>(
    out: W,
    overlay: &Overlay<'_>,
) -> Result<OverlaySummary, ViewError> {
    let mut messages = Vec::new();
    for part in overlay.parts {
        add_scenes(part, &mut messages);
        add_trajectories(part, &mut messages);
        add_submaps(part, &mut messages);
        let frame = map_frame(part.map);
        messages.extend(part.poses.iter().map(|StampedPose { stamp_ns, pose, .. }| Message {
            topic: TRANSFORMS,
            stamp_ns: *stamp_ns,
            value: frame_transform(*stamp_ns, &frame, overlay.lidar_frame, pose),
        }));
    }
    // Stable: messages of one time stay in the order of the topics.
    messages.sort_by_key(|message| message.stamp_ns);
    write(out, &messages, overlay.inputs)?;
    let closures = || overlay.parts.iter().flat_map(|part| &part.closures);
    let n_accepted = closures().filter(|line| line.closure.is_accepted()).count();
    Ok(OverlaySummary {
        n_accepted,
        n_rejected: closures().count() - n_accepted,
        n_transforms: overlay.parts.iter().map(|part| part.poses.len()).sum(),
    })
}

/// A message before it is written.
struct Message {
    topic: &'static str,
    stamp_ns: i64,
    value: Value,
}

fn write<W: Write + Seek>(
    out: W,
    messages: &[Message],
    inputs: &BTreeMap<String, String>,
) -> Result<(), ViewError> {
    let mut writer: Writer<W> = WriteOptions::new()
        .library("loopboost view")
        .compression(Some(mcap::Compression::Zstd))
        .compression_level(ZSTD_LEVEL)
        // With threads, Zstandard splits its input, and the output has other bytes.
        .compression_threads(0)
        .chunk_size(Some(CHUNK_BYTES))
        .create(out)?;
    writer.write_metadata(&Metadata { name: "inputs".to_owned(), metadata: inputs.clone() })?;
    let mut channels = BTreeMap::new();
    for (topic, schema) in TOPICS {
        let text = schema.json().to_string();
        let id = writer.add_schema(schema.name(), "jsonschema", text.as_bytes())?;
        let id = writer.add_channel(id, topic, "json", &BTreeMap::new())?;
        channels.insert(topic, (id, 0_u32));
    }
    for Message { topic, stamp_ns, value } in messages {
        let log_time =
            u64::try_from(*stamp_ns).map_err(|_| ViewError::BeforeEpoch { stamp_ns: *stamp_ns })?;
        let (channel_id, n) = channels.get_mut(topic).expect("every topic has a channel");
        let header = MessageHeader {
            channel_id: *channel_id,
            sequence: *n,
            log_time,
            publish_time: log_time,
        };
        *n += 1;
        writer.write_to_known_channel(&header, value.to_string().as_bytes())?;
    }
    writer.finish()?;
    Ok(())
}

/// The time of the first scan of a part \[ns since the epoch\].
fn start_ns(part: &MapPart<'_>) -> i64 {
    part.poses.first().map_or(0, |pose| pose.stamp_ns)
}

fn add_scenes(part: &MapPart<'_>, messages: &mut Vec<Message>) {
    let (accepted, rejected): (Vec<&ClosureLine<'_>>, Vec<_>) =
        part.closures.iter().partition(|line| line.closure.is_accepted());
    let of_closures = |lines: &[&ClosureLine<'_>]| lines.iter().map(|line| closure(line)).collect();
    let ellipses = part.keyframes.iter().filter_map(|keyframe| ellipse(keyframe)).collect();
    let scenes: [(&str, Vec<Entity>); 3] = [
        (ACCEPTED, of_closures(&accepted)),
        (REJECTED, of_closures(&rejected)),
        (COVARIANCES, ellipses),
    ];
    let stamp_ns = start_ns(part);
    messages.extend(scenes.into_iter().map(|(topic, entities)| Message {
        topic,
        stamp_ns,
        value: scene_update(stamp_ns, &map_frame(part.map), &entities),
    }));
}

fn name(id: &ScanId) -> String {
    format!("{}, scan {}", id.log, id.scan)
}

/// The line from the query to the reference, with the evidence.
fn closure(line: &ClosureLine<'_>) -> Entity {
    let JudgedClosure { closure, rejected } = line.closure;
    let mut metadata = vec![
        ("query", name(&closure.query)),
        ("reference", name(&closure.reference)),
        ("confidence", closure.confidence.to_string()),
        ("overlap", closure.overlap.to_string()),
        ("known_overlap", closure.known_overlap.to_string()),
        ("n_known", closure.n_known.to_string()),
        ("conflict", closure.conflict.to_string()),
        ("margin", closure.margin.to_string()),
        ("weakness", closure.weakness.to_string()),
        ("degenerate", closure.is_degenerate.to_string()),
    ];
    metadata.extend(closure.classifier.map(|value| ("classifier", value.to_string())));
    metadata.extend(rejected.clone().map(|reason| ("reason", reason)));
    Entity {
        id: format!("closure {}", line.row),
        metadata,
        line: Line {
            line_type: LineType::Strip,
            points_m: line.ends.iter().map(|pose| [pose.x_m, pose.y_m]).collect(),
            color: color(rejected.as_deref()),
            width_px: 2.0,
        },
    }
}

/// Green for an accepted closure, and a colour for each reason of `optimize`.
fn color(rejected: Option<&str>) -> [f64; 4] {
    match rejected {
        None => GREEN,
        Some("low_confidence") => [0.6, 0.6, 0.6, 0.4],
        Some("not_confirmed") => [1.0, 0.6, 0.0, 0.6],
        Some("unsupported") => [0.8, 0.2, 0.8, 0.8],
        Some(_) => [0.9, 0.1, 0.1, 0.8],
    }
}

/// The 95 % ellipse of a keyframe. `None` if its covariance is not known.
///
/// It is the image of a circle with the radius sqrt([`CHI_SQUARE_95`]) under the Cholesky factor of the
/// covariance of x and y.
fn ellipse(keyframe: &MapPose) -> Option<Entity> {
    let [xx, xy, _, yy, _, hh] = keyframe.covariance?;
    let a = xx.max(0.0).sqrt();
    let b = if 0.0 < a { xy / a } else { 0.0 };
    let c = (yy - b * b).max(0.0).sqrt();
    let radius = CHI_SQUARE_95.sqrt();
    let Pose2 { x_m, y_m, .. } = keyframe.pose;
    let points_m = (0..ELLIPSE_POINTS).map(|k| {
        let angle = f64::from(k) / f64::from(ELLIPSE_POINTS) * std::f64::consts::TAU;
        let (sin, cos) = libm::sincos(angle);
        [x_m + radius * a * cos, y_m + radius * (b * cos + c * sin)]
    });
    Some(Entity {
        id: name(&keyframe.id),
        metadata: vec![
            ("std_x_m", a.to_string()),
            ("std_y_m", yy.max(0.0).sqrt().to_string()),
            ("std_heading_deg", hh.max(0.0).sqrt().to_degrees().to_string()),
            ("travel_m", keyframe.travel_m.to_string()),
            ("degenerate", keyframe.is_degenerate.to_string()),
        ],
        line: Line {
            line_type: LineType::Loop,
            points_m: points_m.collect(),
            color: YELLOW,
            width_px: 1.0,
        },
    })
}

fn add_trajectories(part: &MapPart<'_>, messages: &mut Vec<Message>) {
    let optimized: Vec<Pose2> = part.poses.iter().map(|stamped| stamped.pose).collect();
    let paths =
        [(ODOMETRY, &part.odometry), (SCAN_MATCHING, &part.scan_matching), (OPTIMIZED, &optimized)];
    let stamp_ns = start_ns(part);
    messages.extend(paths.map(|(topic, poses)| Message {
        topic,
        stamp_ns,
        value: poses_in_frame(stamp_ns, &map_frame(part.map), poses.iter()),
    }));
}

/// One submap for every 5 m of path. Its points are the centres of its occupied squares.
fn add_submaps(part: &MapPart<'_>, messages: &mut Vec<Message>) {
    let mut path_m = 0.0;
    let mut piece = 0.0;
    let is_same_piece = |a: &PlacedScan<'_>, b: &PlacedScan<'_>| {
        path_m += a.pose.distance_m(&b.pose);
        let last = std::mem::replace(&mut piece, (path_m / SUBMAP_M).floor());
        last == piece
    };
    let pieces: Vec<&[PlacedScan<'_>]> = part.scans.chunk_by(is_same_piece).collect();
    let default = SubmapOptions::default();
    let reach_m = SUBMAP_M + default.max_range_m;
    let options = SubmapOptions {
        square_m: SUBMAP_SQUARE_M,
        n_squares: (2.0 * reach_m / SUBMAP_SQUARE_M) as u32,
        ..default
    };
    let frame = map_frame(part.map);
    let clouds: Vec<Message> = pieces
        .par_iter()
        .map(|scans| {
            let (first, last) = (scans[0], scans[scans.len() - 1]);
            let node_from_map = first.pose.inverse();
            let members: Vec<Member<'_>> = scans
                .iter()
                .map(|s| Member { node_from_scan: node_from_map * s.pose, scan: s.scan })
                .collect();
            let submap = Submap::new(&members, &options);
            let points_m = submap.centres(Square::Occupied);
            let value = point_cloud(last.stamp_ns, &frame, &first.pose, points_m);
            Message { topic: SUBMAPS, stamp_ns: last.stamp_ns, value }
        })
        .collect();
    messages.extend(clouds);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_before_1970_is_an_error_that_names_its_time() {
        let part = MapPart {
            map: 0,
            closures: Vec::new(),
            keyframes: Vec::new(),
            odometry: Vec::new(),
            scan_matching: Vec::new(),
            scans: Vec::new(),
            poses: vec![StampedPose::new(-5, Pose2::default())],
        };
        let inputs = BTreeMap::new();
        let overlay = Overlay { lidar_frame: "lidar", parts: &[part], inputs: &inputs };
        let error = write_overlay(std::io::Cursor::new(Vec::new()), &overlay).unwrap_err();
        assert!(error.to_string().starts_with("a pose at -5 ns"), "{error}");
    }
}
