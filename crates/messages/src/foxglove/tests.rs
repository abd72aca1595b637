use super::poses::{FrameTransformWire, PoseInFrameWire};
use super::*;
use crate::*;

const BOTH: [Encoding; 2] = [Encoding::Protobuf, Encoding::Json];

// Messages written by the Python package `foxglove-schemas-protobuf` 0.4.0 (Foxglove's own `.proto`
// files) with `SerializeToString`. Their times are 3 s and 7 ns.
/// Beams from -1 to 1 rad with the ranges 1.5 m, infinity, 2 m. The pose of the scan is at x = 1 m.
const LASER_SCAN: &str = "0a040803100712056c617365721a160a0909000000000000f03f12092100000000\
    0000f03f21000000000000f0bf29000000000000f03f3218000000000000f83f000000000000f07f00000000000000\
    40";
/// Points of 6 bytes with x (FLOAT32) at byte 0 and ring (UINT16) at byte 4: (1.5, 23), (-2, 7).
const POINT_CLOUD: &str = "0a04080310071201761a0d0a00120921000000000000f03f25060000002a050a0178\
    18072a0d0a0472696e6715040000001803320c0000c03f1700000000c00700";
/// x = 2.5 m, not rotated.
const POSE_IN_FRAME: &str = "0a040803100712036d61701a160a09090000000000000440120921000000000000f0\
    3f";
/// `base` in `map`: y = -1 m, rotated by (z, w) = (0.6, 0.8).
const FRAME_TRANSFORM: &str = "0a040803100712036d61701a0462617365220911000000000000f0bf2a1219\
    333333333333e33f219a9999999999e93f";

const STAMP_NS: i64 = 3_000_000_007;

fn bytes_of(hex: &str) -> Vec<u8> {
    (0..hex.len()).step_by(2).map(|k| u8::from_str_radix(&hex[k..k + 2], 16).unwrap()).collect()
}

fn source(message_type: MessageType, encoding: Encoding) -> Source {
    Source { message_type, encoding }
}

fn laser() -> LaserScan {
    LaserScan {
        stamp_ns: STAMP_NS,
        angle_min: -1.0,
        angle_max: Some(1.0),
        angle_increment: 1.0,
        time_increment_s: 0.0,
        range_min: 0.0,
        range_max: f32::INFINITY,
        ranges: vec![1.5, f32::INFINITY, 2.0],
    }
}

fn cloud() -> PointCloud<'static> {
    let field = |name: &str, offset, kind| PointField { name: name.to_owned(), offset, kind };
    PointCloud {
        stamp_ns: STAMP_NS,
        width: 2,
        height: 1,
        point_step: 6,
        row_step: 12,
        big_endian: false,
        fields: vec![field("x", 0, Scalar::F32), field("ring", 4, Scalar::U16)],
        data: vec![0, 0, 0xc0, 0x3f, 23, 0, 0, 0, 0, 0xc0, 7, 0].into(),
    }
}

#[test]
fn protocol_buffers_of_another_implementation_are_read() {
    let protobuf = |message_type| source(message_type, Encoding::Protobuf);
    let bytes = bytes_of(LASER_SCAN);
    assert_eq!(read_laser_scan(protobuf(MessageType::FoxgloveLaserScan), &bytes), Ok(laser()));
    let bytes = bytes_of(POINT_CLOUD);
    assert_eq!(read_point_cloud(protobuf(MessageType::FoxglovePointCloud), &bytes), Ok(cloud()));
    let bytes = bytes_of(POSE_IN_FRAME);
    let pose = StampedPose3 {
        stamp_ns: STAMP_NS,
        position: [2.5, 0.0, 0.0],
        orientation: [0.0, 0.0, 0.0, 1.0],
    };
    assert_eq!(read_pose(protobuf(MessageType::FoxglovePoseInFrame), &bytes), Ok(pose));
    let bytes = bytes_of(FRAME_TRANSFORM);
    let transform = Transform {
        stamp_ns: STAMP_NS,
        parent: "map".to_owned(),
        child: "base".to_owned(),
        translation: [0.0, -1.0, 0.0],
        rotation: [0.0, 0.0, 0.6, 0.8],
    };
    let source = protobuf(MessageType::FoxgloveFrameTransform);
    assert_eq!(read_transforms(source, &bytes), Ok(vec![transform]));
}

#[test]
fn a_protocol_buffer_is_plausible_as_its_own_type_only() {
    let sniff = |hex| {
        let bytes = bytes_of(hex);
        let is_plausible = |&message_type: &MessageType| {
            is_plausible_message(source(message_type, Encoding::Protobuf), &bytes)
        };
        MessageType::ALL.into_iter().filter(is_plausible).collect::<Vec<_>>()
    };
    assert_eq!(sniff(LASER_SCAN), [MessageType::FoxgloveLaserScan]);
    assert_eq!(sniff(POINT_CLOUD), [MessageType::FoxglovePointCloud]);
    assert_eq!(sniff(POSE_IN_FRAME), [MessageType::FoxglovePoseInFrame]);
    assert_eq!(sniff(FRAME_TRANSFORM), [MessageType::FoxgloveFrameTransform]);
}

#[test]
fn json_of_foxglove_is_read() {
    let json = |message_type| source(message_type, Encoding::Json);
    let text = br#"{"timestamp":{"sec":3,"nsec":7},"frame_id":"laser",
        "pose":{"position":{"x":1,"y":0,"z":0},"orientation":{"x":0,"y":0,"z":0,"w":1}},
        "start_angle":-1,"end_angle":1.0,"ranges":[1.5,"Infinity",2],"intensities":[]}"#;
    assert_eq!(read_laser_scan(json(MessageType::FoxgloveLaserScan), text), Ok(laser()));

    let text = br#"{"timestamp":{"sec":3,"nsec":7},"frame_id":"v","point_stride":6,"unknown":[{}],
        "fields":[{"name":"x","offset":0,"type":7},{"name":"ring","offset":4,"type":3}],
        "data":"AADAPxcAAAAAwAcA"}"#;
    assert_eq!(read_point_cloud(json(MessageType::FoxglovePointCloud), text), Ok(cloud()));

    let text = br#"{"timestamp":{"sec":3,"nsec":7},"frame_id":"map",
        "pose":{"position":{"x":2.5,"y":0,"z":0},"orientation":{"x":0,"y":0,"z":0,"w":1}}}"#;
    let pose = read_pose(json(MessageType::FoxglovePoseInFrame), text).unwrap();
    assert_eq!((pose.stamp_ns, pose.position), (STAMP_NS, [2.5, 0.0, 0.0]));
}

#[test]
fn the_stamp_is_read_without_the_rest() {
    for encoding in BOTH {
        let bytes = write_laser_scan(encoding, "laser", &laser());
        let source = source(MessageType::FoxgloveLaserScan, encoding);
        assert_eq!(read_stamp_ns(source, &bytes), Ok(Some(STAMP_NS)));
    }
}

#[test]
fn a_range_that_is_not_a_number_is_nan() {
    let text = br#"{"timestamp":{"sec":3,"nsec":7},"start_angle":0,"end_angle":1,
        "ranges":[null,"NaN","nan","-Infinity",4e0]}"#;
    let source = source(MessageType::FoxgloveLaserScan, Encoding::Json);
    let ranges = read_laser_scan(source, text).unwrap().ranges;
    assert!(ranges[..3].iter().all(|range| range.is_nan()));
    assert_eq!(ranges[3..], [f32::NEG_INFINITY, 4.0]);
    let text = br#"{"timestamp":{"sec":3,"nsec":7},"ranges":["far"]}"#;
    assert!(matches!(read_laser_scan(source, text), Err(MessageError::Malformed { .. })));
}

#[test]
fn scans_and_clouds_read_as_written_in_both_encodings() {
    for encoding in BOTH {
        let bytes = write_laser_scan(encoding, "laser", &laser());
        let read = read_laser_scan(source(MessageType::FoxgloveLaserScan, encoding), &bytes);
        assert_eq!(read, Ok(laser()));
        let bytes = write_point_cloud(encoding, "v", &cloud());
        let read = read_point_cloud(source(MessageType::FoxglovePointCloud, encoding), &bytes);
        assert_eq!(read, Ok(cloud()));
    }
}

#[test]
fn the_writers_convert_range_limits_rows_and_big_endian() {
    let limited = LaserScan { range_min: 1.75, range_max: 9.0, ..laser() };
    let bytes = write_laser_scan(Encoding::Protobuf, "laser", &limited);
    let source = source(MessageType::FoxgloveLaserScan, Encoding::Protobuf);
    let ranges = read_laser_scan(source, &bytes).unwrap().ranges;
    assert!(ranges[0].is_nan() && ranges[1].is_nan());
    assert_eq!(ranges[2], 2.0);

    let rows = PointCloud {
        width: 1,
        height: 2,
        row_step: 7,
        big_endian: true,
        data: vec![0x3f, 0xc0, 0, 0, 0, 23, 99, 0xc0, 0, 0, 0, 0, 7].into(),
        ..cloud()
    };
    let source = Source { message_type: MessageType::FoxglovePointCloud, ..source };
    let bytes = write_point_cloud(Encoding::Protobuf, "v", &rows);
    assert_eq!(read_point_cloud(source, &bytes), Ok(cloud()));
}

/// Without points, the other sizes of a cloud may have any value.
#[test]
fn a_cloud_without_points_can_be_written_with_any_sizes() {
    const MANY: usize = u32::MAX as usize;
    let empty = PointCloud { row_step: 0, data: Vec::new().into(), ..cloud() };
    for (width, height, row_step) in [(0, 2, 58), (0, MANY, MANY), (MANY, 0, MANY), (0, 0, 1)] {
        let sizes = PointCloud { width, height, row_step, ..empty.clone() };
        let cdr = ros::write_point_cloud2(Encoding::Cdr, "v", &sizes);
        let read = read_point_cloud(source(MessageType::PointCloud2, Encoding::Cdr), &cdr).unwrap();
        assert_eq!(read, PointCloud { width, height, ..empty.clone() });
        assert_eq!(ros::write_point_cloud2(Encoding::Cdr, "v", &read).len(), cdr.len());
        for cloud in [sizes, read] {
            let bytes = write_point_cloud(Encoding::Protobuf, "v", &cloud);
            let source = source(MessageType::FoxglovePointCloud, Encoding::Protobuf);
            assert!(read_point_cloud(source, &bytes).unwrap().is_empty());
        }
    }
}

/// A protocol buffer that is cut between fields is a shorter message. It is never a different message.
#[test]
fn a_truncated_message_is_an_error_or_a_shorter_message() {
    let scan = source(MessageType::FoxgloveLaserScan, Encoding::Protobuf);
    let complete = bytes_of(LASER_SCAN);
    for cut in 0..complete.len() {
        if let Ok(read) = read_laser_scan(scan, &complete[..cut]) {
            assert!(read.ranges.is_empty(), "cut at {cut}");
        }
    }
    let json = Source { encoding: Encoding::Json, ..scan };
    let complete = write_laser_scan(Encoding::Json, "laser", &laser());
    for cut in 0..complete.len() {
        assert!(read_laser_scan(json, &complete[..cut]).is_err(), "cut at {cut}");
    }
}

#[test]
fn missing_required_parts_are_reported_by_name() {
    let without_time = PoseInFrameWire { pose: Some(Pose::identity()), ..Default::default() };
    let without_pose = PoseInFrameWire { timestamp: Some(Timestamp::new(1)), ..Default::default() };
    let without_rotation = FrameTransformWire {
        timestamp: Some(Timestamp::new(1)),
        translation: Some(Vector3::default()),
        ..Default::default()
    };
    for encoding in BOTH {
        let pose = source(MessageType::FoxglovePoseInFrame, encoding);
        let error = read_pose(pose, &encode(encoding, &without_time)).unwrap_err().to_string();
        assert!(error.ends_with("as foxglove.PoseInFrame: it has no timestamp"), "{error}");
        let error = read_pose(pose, &encode(encoding, &without_pose)).unwrap_err().to_string();
        assert!(error.ends_with("it has no pose"), "{error}");
        let transform = source(MessageType::FoxgloveFrameTransform, encoding);
        let bytes = encode(encoding, &without_rotation);
        let error = read_transforms(transform, &bytes).unwrap_err().to_string();
        assert!(error.ends_with("it has no rotation"), "{error}");
    }
}

#[test]
fn an_inconsistent_cloud_is_an_error() {
    let error = |text: &[u8]| {
        let source = source(MessageType::FoxglovePointCloud, Encoding::Json);
        read_point_cloud(source, text).unwrap_err().to_string()
    };
    assert_eq!(
        error(
            br#"{"timestamp":{"sec":3,"nsec":7},"point_stride":6,"data":"AADAPxcA",
                "fields":[{"name":"ring","offset":5,"type":3}]}"#
        ),
        "invalid point cloud layout: field `ring` ends at byte 7, but a point has 6 bytes"
    );
    assert_eq!(
        error(
            br#"{"timestamp":{"sec":3,"nsec":7},"point_stride":6,"data":"AADAPxcA",
                "fields":[{"name":"ring","offset":4}]}"#
        ),
        "invalid point cloud layout: field `ring` has type 0, expected 1 to 8"
    );
    for point_stride in [0, 4, 7] {
        let text = format!(
            r#"{{"timestamp":{{"sec":3,"nsec":7}},"point_stride":{point_stride},
                "data":"AADAPxcA"}}"#
        );
        assert_eq!(
            error(text.as_bytes()),
            format!(
                "invalid point cloud layout: 6 bytes are not a multiple of {point_stride} bytes per point"
            )
        );
    }
}

#[test]
fn a_time_out_of_the_range_of_nanoseconds_is_an_error() {
    let text = br#"{"timestamp":{"sec":9223372036854775807,"nsec":0},"ranges":[]}"#;
    let source = source(MessageType::FoxgloveLaserScan, Encoding::Json);
    assert!(matches!(read_laser_scan(source, text), Err(MessageError::Malformed { .. })));
}
