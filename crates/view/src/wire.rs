//! Foxglove messages as JSON.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use dataset::Pose2;
use serde_json::{Value, json};

/// Number of `FLOAT32` in `foxglove.NumericType`.
const FLOAT32: u32 = 7;

/// How the points of a line are connected: `foxglove.LineType`.
#[derive(Debug, Clone, Copy)]
pub(crate) enum LineType {
    Strip = 0,
    Loop = 1,
}

/// A line with one colour.
pub(crate) struct Line {
    pub(crate) line_type: LineType,
    pub(crate) points_m: Vec<[f64; 2]>,
    /// Red, green, blue and opacity, 0 to 1.
    pub(crate) color: [f64; 4],
    /// Width on the screen \[px\].
    pub(crate) width_px: f64,
}

/// An object of a scene: a line that shows its metadata when it is selected.
pub(crate) struct Entity {
    pub(crate) id: String,
    pub(crate) metadata: Vec<(&'static str, String)>,
    pub(crate) line: Line,
}

/// `foxglove.FrameTransform`: the pose of `child` in `parent`.
pub(crate) fn frame_transform(stamp_ns: i64, parent: &str, child: &str, pose: &Pose2) -> Value {
    json!({
        "timestamp": time(stamp_ns),
        "parent_frame_id": parent,
        "child_frame_id": child,
        "translation": position(pose),
        "rotation": orientation(pose),
    })
}

/// `foxglove.PosesInFrame`
pub(crate) fn poses_in_frame<'a>(
    stamp_ns: i64,
    frame: &str,
    poses: impl Iterator<Item = &'a Pose2>,
) -> Value {
    let poses: Vec<Value> = poses.map(pose).collect();
    json!({ "timestamp": time(stamp_ns), "frame_id": frame, "poses": poses })
}

/// `foxglove.PointCloud`: points in the plane, relative to `origin`.
pub(crate) fn point_cloud(
    stamp_ns: i64,
    frame: &str,
    origin: &Pose2,
    points_m: impl Iterator<Item = [f64; 2]>,
) -> Value {
    let floats = points_m.flat_map(|[x, y]| [x as f32, y as f32, 0.0]);
    let data: Vec<u8> = floats.flat_map(f32::to_le_bytes).collect();
    let fields = [("x", 0), ("y", 4), ("z", 8)]
        .map(|(name, offset)| json!({ "name": name, "offset": offset, "type": FLOAT32 }));
    json!({
        "timestamp": time(stamp_ns),
        "frame_id": frame,
        "pose": pose(origin),
        "point_stride": 12,
        "fields": fields,
        "data": STANDARD.encode(data),
    })
}

/// `foxglove.SceneUpdate` that adds entities without an end.
pub(crate) fn scene_update(stamp_ns: i64, frame: &str, entities: &[Entity]) -> Value {
    let entities: Vec<Value> = entities.iter().map(|e| entity(stamp_ns, frame, e)).collect();
    json!({ "deletions": [], "entities": entities })
}

fn entity(stamp_ns: i64, frame: &str, entity: &Entity) -> Value {
    let metadata: Vec<Value> =
        entity.metadata.iter().map(|(key, value)| json!({ "key": key, "value": value })).collect();
    json!({
        "timestamp": time(stamp_ns),
        "frame_id": frame,
        "id": entity.id,
        "lifetime": { "sec": 0, "nsec": 0 },
        "frame_locked": false,
        "metadata": metadata,
        "arrows": [],
        "cubes": [],
        "spheres": [],
        "cylinders": [],
        "lines": [line(&entity.line)],
        "triangles": [],
        "texts": [],
        "models": [],
    })
}

fn line(line: &Line) -> Value {
    let points: Vec<Value> =
        line.points_m.iter().map(|[x, y]| json!({ "x": x, "y": y, "z": 0.0 })).collect();
    let [r, g, b, a] = line.color;
    json!({
        "type": line.line_type as u8,
        "pose": pose(&Pose2::default()),
        "thickness": line.width_px,
        "scale_invariant": true,
        "points": points,
        "color": { "r": r, "g": g, "b": b, "a": a },
        "colors": [],
        "indices": [],
    })
}

fn time(stamp_ns: i64) -> Value {
    const SECOND_NS: i64 = 1_000_000_000;
    json!({ "sec": stamp_ns.div_euclid(SECOND_NS), "nsec": stamp_ns.rem_euclid(SECOND_NS) })
}

fn pose(pose: &Pose2) -> Value {
    json!({ "position": position(pose), "orientation": orientation(pose) })
}

fn position(pose: &Pose2) -> Value {
    json!({ "x": pose.x_m, "y": pose.y_m, "z": 0.0 })
}

fn orientation(pose: &Pose2) -> Value {
    let (sin, cos) = libm::sincos(pose.heading_rad / 2.0);
    json!({ "x": 0.0, "y": 0.0, "z": sin, "w": cos })
}
