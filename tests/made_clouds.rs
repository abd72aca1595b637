//! Point clouds made in the test: every layout, encoding and order of points gives the scan of the
//! ring as it was written.

use dataset::Scan;

use crate::made::{Logs, Message, SCHEMAS, Schema, log};
use crate::wire::{Encoding, FOXGLOVE, Protobuf, ROS, RosMessage, base64, foxglove_json};

const CLOUDS: usize = 3;
const COLUMNS: usize = 360;
/// Rings and the elevations of their beams \[deg\]; the index is the laser in firing order.
const RINGS: [(u16, f64); 3] = [(16, -28.0 / 3.0), (23, 0.0), (24, 4.0 / 3.0)];
const START_NS: i64 = 1_700_000_000_000_000_000;
const COLUMN_NS: i64 = 277_778;
const LASER_NS: i64 = 1_152;

#[derive(Debug, Clone, Copy)]
struct Point {
    xyz: [f32; 3],
    ring: u16,
    stamp_ns: i64,
}

/// The points of a cloud in firing order: clockwise columns of 1 deg. Every 7th return of ring 24 is
/// missing.
fn cloud(k: usize) -> Vec<Point> {
    let mut points = Vec::new();
    for column in 0..COLUMNS {
        for (laser, (ring, elevation_deg)) in RINGS.into_iter().enumerate() {
            if ring == 24 && column % 7 == 3 {
                continue;
            }
            let azimuth = -(column as f64 + 0.25).to_radians();
            let range = 3.0 + k as f64 + (column * (laser + 3) % 101) as f64 / 16.0;
            let (sin, cos) = elevation_deg.to_radians().sin_cos();
            let xyz = [azimuth.cos() * cos, azimuth.sin() * cos, sin].map(|u| (range * u) as f32);
            let at_ns = (k * COLUMNS + column) as i64 * COLUMN_NS + laser as i64 * LASER_NS;
            points.push(Point { xyz, ring, stamp_ns: START_NS + at_ns });
        }
    }
    points
}

/// A number type of point fields.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Kind {
    U8,
    U16,
    U32,
    I32,
    F32,
    F64,
}
use Kind::{F32, F64, I32, U8, U16, U32};

impl Kind {
    fn bytes(self, value: f64) -> Vec<u8> {
        match self {
            U8 => vec![value as u8],
            U16 => (value as u16).to_le_bytes().to_vec(),
            U32 => (value as u32).to_le_bytes().to_vec(),
            I32 => (value as i32).to_le_bytes().to_vec(),
            F32 => (value as f32).to_le_bytes().to_vec(),
            F64 => value.to_le_bytes().to_vec(),
        }
    }

    /// The number in `sensor_msgs/PointField`.
    fn ros(self) -> u8 {
        match self {
            U8 => 2,
            U16 => 4,
            I32 => 5,
            U32 => 6,
            F32 => 7,
            F64 => 8,
        }
    }

    /// The number in `foxglove.PackedElementField`.
    fn foxglove(self) -> u64 {
        match self {
            U8 => 1,
            U16 => 3,
            U32 => 5,
            I32 => 6,
            F32 => 7,
            F64 => 8,
        }
    }
}

/// How a driver lays out its points: fields with their offsets, and the bytes of a point.
struct Layout {
    name: &'static str,
    fields: &'static [(&'static str, Kind, usize)],
    point_step: usize,
    is_big_endian: bool,
    /// Resolution of the points' times \[ns\]; none: the points have no times.
    time_ns: Option<i64>,
}

const PACKED: Layout = Layout {
    name: "velodyne",
    fields: &[
        ("x", F32, 0),
        ("y", F32, 4),
        ("z", F32, 8),
        ("intensity", F32, 12),
        ("ring", U16, 16),
        ("time", F32, 18),
    ],
    point_step: 22,
    is_big_endian: false,
    time_ns: Some(8),
};

const PADDED: Layout = Layout {
    name: "padded",
    fields: &[
        ("x", F32, 0),
        ("y", F32, 4),
        ("z", F32, 8),
        ("intensity", F32, 16),
        ("ring", U16, 20),
        ("time", F32, 24),
    ],
    point_step: 32,
    ..PACKED
};

const NUSCENES: Layout = Layout {
    name: "nuscenes",
    fields: &[
        ("x", F32, 0),
        ("y", F32, 4),
        ("z", F32, 8),
        ("intensity", F32, 12),
        ("ring", F32, 16),
    ],
    point_step: 20,
    time_ns: None,
    ..PACKED
};

const OTHER_ORDER: Layout = Layout {
    name: "other-order",
    fields: &[("ring", U16, 0), ("time", F32, 2), ("z", F32, 6), ("y", F32, 10), ("x", F32, 14)],
    point_step: 18,
    ..PACKED
};

const BIG_ENDIAN: Layout = Layout { name: "big-endian", is_big_endian: true, ..PACKED };

const OUSTER: Layout = Layout {
    name: "ouster",
    fields: &[
        ("x", F32, 0),
        ("y", F32, 4),
        ("z", F32, 8),
        ("intensity", F32, 16),
        ("t", U32, 20),
        ("reflectivity", U16, 24),
        ("ring", U8, 26),
    ],
    point_step: 48,
    time_ns: Some(0),
    ..PACKED
};

const HESAI: Layout = Layout {
    name: "hesai",
    fields: &[
        ("x", F32, 0),
        ("y", F32, 4),
        ("z", F32, 8),
        ("intensity", F32, 16),
        ("timestamp", F64, 24),
        ("ring", U16, 32),
    ],
    point_step: 48,
    time_ns: Some(256),
    ..PACKED
};

const DOUBLES: Layout = Layout {
    name: "doubles",
    fields: &[("x", F64, 0), ("y", F64, 8), ("z", F64, 16), ("ring", I32, 24), ("time", F64, 28)],
    point_step: 36,
    time_ns: Some(1),
    ..PACKED
};

impl Layout {
    fn bytes(&self, points: &[Point], stamp_ns: i64) -> Vec<u8> {
        let mut bytes = vec![0; points.len() * self.point_step];
        for (point, at) in points.iter().zip(bytes.chunks_mut(self.point_step)) {
            for &(name, kind, offset) in self.fields {
                let after_ns = point.stamp_ns - stamp_ns;
                let value = match name {
                    "x" => point.xyz[0].into(),
                    "y" => point.xyz[1].into(),
                    "z" => point.xyz[2].into(),
                    "ring" => point.ring.into(),
                    "time" => after_ns as f64 * 1e-9,
                    "t" => after_ns as f64,
                    "timestamp" => point.stamp_ns as f64 * 1e-9,
                    _ => 0.0,
                };
                let mut value = kind.bytes(value);
                if self.is_big_endian {
                    value.reverse();
                }
                at[offset..][..value.len()].copy_from_slice(&value);
            }
        }
        bytes
    }
}

/// A `sensor_msgs/PointCloud2`, or a `foxglove.PointCloud` in protobuf or JSON.
fn message(
    layout: &Layout,
    encoding: Encoding,
    points: &[Point],
    width: usize,
    stamp_ns: i64,
) -> Message {
    let bytes = layout.bytes(points, stamp_ns);
    let data = match encoding {
        Encoding::Json => json_cloud(layout, &bytes, stamp_ns),
        Encoding::Protobuf => protobuf_cloud(layout, &bytes, stamp_ns),
        _ => {
            let height = points.len() / width;
            let start = RosMessage::with_header(encoding, stamp_ns).u32(height as u32);
            let start = start.u32(width as u32).u32(layout.fields.len() as u32);
            let fields = layout.fields.iter().fold(start, |m, (name, kind, offset)| {
                m.string(name).u32(*offset as u32).u8(kind.ros()).u32(1)
            });
            fields
                .u8(layout.is_big_endian.into())
                .u32(layout.point_step as u32)
                .u32((layout.point_step * width) as u32)
                .byte_sequence(&bytes)
                .u8(1)
                .finish()
        }
    };
    let is_foxglove = FOXGLOVE.contains(&encoding);
    let type_name = if is_foxglove { "foxglove.PointCloud" } else { "sensor_msgs/PointCloud2" };
    Message { topic: "/velodyne_points", type_name, encoding, stamp_ns, data }
}

fn protobuf_cloud(layout: &Layout, bytes: &[u8], stamp_ns: i64) -> Vec<u8> {
    let start = Protobuf::foxglove(stamp_ns)
        .message(3, &Protobuf::pose([0.0; 3], [0.0, 0.0, 0.0, 1.0]))
        .fixed32(4, layout.point_step as u32);
    let fields = layout.fields.iter().fold(start, |message, (name, kind, offset)| {
        let field = Protobuf::default().bytes(1, name.as_bytes());
        message.message(5, &field.fixed32(2, *offset as u32).varint(3, kind.foxglove()))
    });
    fields.bytes(6, bytes).finish()
}

fn json_cloud(layout: &Layout, bytes: &[u8], stamp_ns: i64) -> Vec<u8> {
    let field = |(name, kind, offset): &(&str, Kind, usize)| serde_json::json!({ "name": name, "offset": offset, "type": kind.foxglove() });
    let fields: Vec<_> = layout.fields.iter().map(field).collect();
    let more = serde_json::json!({
        "point_stride": layout.point_step,
        "fields": fields,
        "data": base64(bytes),
    });
    foxglove_json(stamp_ns, more)
}

/// Points in an order of their own: one row of all points unless they are organised.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Order {
    Firing,
    /// Rows are rings, with NaN where there is no return.
    RowsOfRings,
    /// Rows are columns of the sensor, with NaN where there is no return.
    RowsOfFirings,
}

/// The points in an order, and the width of the cloud.
fn ordered(points: &[Point], order: Order) -> (Vec<Point>, usize) {
    if order == Order::Firing {
        return (points.to_vec(), points.len());
    }
    let first = points[0];
    let at = |column: usize, (laser, &(ring, _)): (usize, &(u16, f64))| {
        let at_ns = column as i64 * COLUMN_NS + laser as i64 * LASER_NS;
        let missing = Point { xyz: [f32::NAN; 3], ring, stamp_ns: first.stamp_ns + at_ns };
        let is_it = |p: &&Point| (p.ring, p.stamp_ns) == (ring, missing.stamp_ns);
        points.iter().find(is_it).copied().unwrap_or(missing)
    };
    let rings = || RINGS.iter().enumerate();
    if order == Order::RowsOfRings {
        let rows = rings().flat_map(|ring| (0..COLUMNS).map(move |column| at(column, ring)));
        (rows.collect(), COLUMNS)
    } else {
        let rows = (0..COLUMNS).flat_map(|column| rings().map(move |ring| at(column, ring)));
        (rows.collect(), RINGS.len())
    }
}

/// A log of all clouds, stamped at the first or at the last point.
fn cloud_log(
    layout: &Layout,
    encoding: Encoding,
    order: Order,
    is_stamped_at_end: bool,
    schema: Schema,
) -> Vec<u8> {
    let messages: Vec<Message> = (0..CLOUDS)
        .map(|k| {
            let points = cloud(k);
            let stamped = if is_stamped_at_end { points[points.len() - 1] } else { points[0] };
            let (points, width) = ordered(&points, order);
            message(layout, encoding, &points, width, stamped.stamp_ns)
        })
        .collect();
    log(&messages, schema)
}

/// The coordinates of a ring are exactly those written, in firing order; its stamp is the time of
/// its first point, or the cloud's where points have no times.
fn check_scans(scans: &[Scan], ring: u16, time_ns: Option<i64>) {
    assert_eq!(scans.len(), CLOUDS);
    for (k, scan) in scans.iter().enumerate() {
        let points = cloud(k);
        let of_ring: Vec<&Point> = points.iter().filter(|point| point.ring == ring).collect();
        let stamp_ns = if time_ns.is_some() { of_ring[0].stamp_ns } else { points[0].stamp_ns };
        assert!((scan.stamp_ns - stamp_ns).abs() <= time_ns.unwrap_or(0), "cloud {k}");
        assert!(scan.is_ring());
        let expected: Vec<[f32; 2]> = of_ring.iter().map(|p| [p.xyz[0], p.xyz[1]]).collect();
        let found: Vec<[f32; 2]> = scan.x_m.iter().zip(&scan.y_m).map(|(&x, &y)| [x, y]).collect();
        assert_eq!(found, expected, "cloud {k}");
    }
}

/// Ingests the logs for each way to choose a ring, and checks the exit code and the scans of all.
fn check(logs: &Logs, times_ns: &[(String, Option<i64>)], code: i32) {
    for (option, ring) in [
        (None, 23),
        (Some("ingest.lidar.ring=24"), 24),
        (Some("ingest.lidar.elevation_deg=-9.33"), 16),
    ] {
        let mut options = vec!["ingest.lidar.topic=/velodyne_points"];
        options.extend(option);
        let ingested = logs.ingest(&options, code);
        for (name, time_ns) in times_ns {
            println!("{name}, ring {ring}");
            check_scans(&ingested.scans[name], ring, *time_ns);
        }
    }
}

#[test]
fn the_layouts_of_every_driver_give_the_same_scans() {
    let mut logs = Logs::default();
    let mut times_ns = Vec::new();
    for layout in [PACKED, PADDED, NUSCENES, OTHER_ORDER, BIG_ENDIAN, OUSTER, HESAI, DOUBLES] {
        for encoding in ROS {
            let name = format!("{}-{encoding:?}", layout.name);
            logs.add(&name, cloud_log(&layout, encoding, Order::Firing, false, Schema::Empty));
            times_ns.push((name, layout.time_ns));
        }
    }
    check(&logs, &times_ns, 0);
}

#[test]
fn foxglove_clouds_give_the_same_scans() {
    let mut logs = Logs::default();
    let mut times_ns = Vec::new();
    for (layout, encoding) in
        [PACKED, NUSCENES].iter().flat_map(|layout| FOXGLOVE.map(|encoding| (layout, encoding)))
    {
        for schema in [Schema::Empty, Schema::Missing] {
            let name = format!("{}-{encoding:?}-{schema:?}", layout.name);
            logs.add(&name, cloud_log(layout, encoding, Order::Firing, false, schema));
            times_ns.push((name, layout.time_ns));
        }
    }
    // A channel without a schema is a warning.
    check(&logs, &times_ns, 3);
}

#[test]
fn organised_clouds_and_clouds_stamped_at_their_end_give_the_same_scans() {
    let mut logs = Logs::default();
    let mut times_ns = Vec::new();
    for encoding in ROS {
        for order in [Order::RowsOfRings, Order::RowsOfFirings] {
            let name = format!("{order:?}-{encoding:?}");
            logs.add(&name, cloud_log(&PADDED, encoding, order, false, Schema::Empty));
            times_ns.push((name, PADDED.time_ns));
        }
        let name = format!("stamped-at-end-{encoding:?}");
        logs.add(&name, cloud_log(&PACKED, encoding, Order::Firing, true, Schema::Empty));
        times_ns.push((name, PACKED.time_ns));
    }
    check(&logs, &times_ns, 0);
}

#[test]
fn clouds_with_an_incomplete_or_missing_schema_give_the_same_scans() {
    let mut logs = Logs::default();
    let mut times_ns = Vec::new();
    for (encoding, schema) in ROS.iter().flat_map(|e| SCHEMAS.map(|schema| (*e, schema))) {
        let name = format!("{encoding:?}-{schema:?}");
        logs.add(&name, cloud_log(&PACKED, encoding, Order::Firing, false, schema));
        times_ns.push((name, PACKED.time_ns));
    }
    // A channel without a schema is a warning.
    check(&logs, &times_ns, 3);
}
