//! Absolute references of a log: fixes, poses, and the place of the antenna.

#![allow(clippy::unwrap_used, reason = "a test panics if a value is missing")]

mod common;

use std::path::Path;

use common::{Entry, codes, options, planar_log, small_chunks, write};
use dataset::Pose2;
use ingest::{
    IngestError, LidarOptions, Log, Origin, PlanarPose, ReferenceMessages, ReferenceTopic, Stamp,
    read_references,
};
use messages::{Encoding, NavSatFix, Transform, ros};

const MS: i64 = 1_000_000;

/// Ten fixes on the way north. One has no fix, and one states no covariance.
fn fixes() -> Vec<Entry> {
    let fix = |k: i64| {
        let mut covariance = [0.0; 9];
        if k != 3 {
            (covariance[0], covariance[1], covariance[3], covariance[4]) = (0.25, 0.1, 0.1, 0.36);
        }
        let fix = NavSatFix {
            stamp_ns: k * 100 * MS,
            status: if k == 7 { -1 } else { 0 },
            latitude_deg: 42.29 + 1e-5 * k as f64,
            longitude_deg: -83.71,
            altitude_m: f64::NAN,
            covariance,
        };
        ros::write_nav_sat_fix(Encoding::Cdr, "gps", &fix)
    };
    (0..10).map(|k| ("/fix", "sensor_msgs/msg/NavSatFix", "cdr", fix(k))).collect()
}

/// A static transform with a yaw of 180 deg if `turned`, otherwise of 0.
fn transform(parent: &str, child: &str, translation: [f64; 3], turned: bool) -> Entry {
    let rotation = if turned { [0.0, 0.0, 1.0, 0.0] } else { [0.0, 0.0, 0.0, 1.0] };
    let (parent, child) = (parent.to_owned(), child.to_owned());
    let transform = Transform { stamp_ns: 0, parent, child, translation, rotation };
    ("/tf_static", "tf2_msgs/msg/TFMessage", "cdr", ros::write_tf(Encoding::Cdr, &[transform]))
}

fn topic(topic: &str) -> ReferenceTopic {
    ReferenceTopic { topic: topic.to_owned(), frame_id: None, stamp: Stamp::Header, mount: None }
}

fn read(
    more: Vec<Entry>,
    lidar: &LidarOptions,
    topic: &ReferenceTopic,
) -> Result<ReferenceMessages, IngestError> {
    let mut log = planar_log();
    log.extend(more);
    let bytes = write(&log, small_chunks());
    let log = Log::from_bytes(Path::new("drive.mcap"), bytes).unwrap();
    read_references(&[&log], lidar, topic)
}

#[test]
fn fixes_have_positions_covariances_and_losses() {
    let lidar = options("/scan", None).lidar;
    let read = read(fixes(), &lidar, &topic("/fix")).unwrap();
    assert_eq!(codes(&read.losses), [("no_gnss_fix", 1)]);
    assert_eq!((read.fixes.len(), read.poses.len()), (9, 0));
    assert_eq!(read.fixes[0].covariance, Some([0.25, 0.1, 0.36]));
    assert_eq!(read.fixes[3].covariance, None);
    // One degree of latitude is 111 068 m at 42.29 deg.
    let origin = Origin { latitude_deg: 42.29, longitude_deg: -83.71, altitude_m: 0.0 };
    let at = read.fixes[8].east_north(&origin);
    assert!(at.x_m.abs() < 1e-6 && (at.y_m - 9e-5 * 111_068.0).abs() < 1e-3, "{at:?}");
}

/// The lidar is 0.2 m in front of the robot and looks back, the antenna 0.5 m behind it and 0.3 m to the left.
/// Seen from the lidar, the antenna is 0.7 m in front of it and 0.3 m to the right.
#[test]
fn the_antenna_is_looked_up_in_the_transforms() {
    let lidar = options("/scan", None).lidar;
    let frame = lidar_frame();
    let mut more = fixes();
    more.push(transform("base_link", &frame, [0.2, 0.0, 0.4], true));
    more.push(transform("base_link", "gps", [-0.5, 0.3, 1.0], false));
    let found = read(more.clone(), &lidar, &topic("/fix")).unwrap();
    let point = found.lidar_from_point;
    assert!(found.is_point_known);
    assert!((point.x_m - 0.7).abs() < 1e-9 && (point.y_m + 0.3).abs() < 1e-9, "{point:?}");
    // Scans of a lidar that is mounted upside down are mirrored.
    let upside_down = LidarOptions { upside_down: true, ..lidar.clone() };
    let found = read(more.clone(), &upside_down, &topic("/fix")).unwrap();
    assert!((found.lidar_from_point.y_m - 0.3).abs() < 1e-9, "{:?}", found.lidar_from_point);
    // The options come first.
    let mount = Some(PlanarPose { x_m: 2.0, y_m: 1.0, heading_deg: 0.0 });
    let named = ReferenceTopic { mount, ..topic("/fix") };
    let found = read(more, &lidar, &named).unwrap();
    assert_eq!((found.lidar_from_point.x_m, found.lidar_from_point.y_m), (2.0, 1.0));
    // Without transforms, it is the origin of the robot.
    let mounted = PlanarPose { x_m: 0.2, y_m: 0.0, heading_deg: 0.0 };
    let lidar = LidarOptions { mount: Some(mounted), ..lidar };
    let found = read(fixes(), &lidar, &topic("/fix")).unwrap();
    assert!(!found.is_point_known);
    assert_eq!((found.lidar_from_point.x_m, found.lidar_from_point.y_m), (-0.2, 0.0));
}

/// The frame of the scans of [`planar_log`].
fn lidar_frame() -> String {
    "laser".to_owned()
}

#[test]
fn poses_of_a_topic_are_those_of_the_robot() {
    let lidar = options("/scan", None).lidar;
    let found = read(Vec::new(), &lidar, &topic("/pose")).unwrap();
    assert_eq!((found.fixes.len(), found.poses.len(), found.is_point_known), (0, 10, true));
    assert_eq!(found.lidar_from_point, Pose2::default());
    let error = read(Vec::new(), &lidar, &topic("/fix")).unwrap_err();
    assert!(matches!(error, IngestError::NoTopic { .. }), "{error}");
}
