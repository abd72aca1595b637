use super::poses::{FrameTransformWire, PoseInFrameWire};
use super::*;
use crate::*;

const BOTH: [Encoding; 2] = [Encoding::Protobuf, Encoding::Json];

// Messages made by Python's `foxglove-schemas-protobuf` 0.4.0 (Foxglove's own `.proto` files) with
// `SerializeToString`; their times are 3 s and 7 ns.
/// Beams from -1 to 1 rad reading 1.5 m, infinity, 2 m; the scan's pose is at x = 1 m.
const LASER_SCAN: &str = "0a040803100712056c617365721a160a0909000000000000f03f12092100000000\
    0000f03f21000000000000f0bf29000000000000f03f3218000000000000f83f000000000000f07f00000000000000\
    40";
/// x FLOAT32 at 0 and ring UINT16 at 4, of 6 bytes: (1.5, 23), (-2, 7).
const POINT_CLOUD: &str = "0a04080310071201761a0d0a00120921000000000000f03f25060000002a050a0178\
    18072a0d0a0472696e6715040000001803320c0000c03f1700000000c00700";
/// x = 2.5 m, not turned.
const POSE_IN_FRAME: &str = "0a040803100712036d61701a160a09090000000000000440120921000000000000f0\
    3f";
/// `base` in `map`: y = -1 m, turned by (z, w) = (0.6, 0.8).
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
fn golden_protocol_buffers() {
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
fn a_protocol_buffer_is_told_from_all_other_types() {
    let told = |hex| {
        let bytes = bytes_of(hex);
        let fits = |&message_type: &MessageType| {
            is_plausible_message(source(message_type, Encoding::Protobuf), &bytes)
        };
        MessageType::ALL.into_iter().filter(fits).collect::<Vec<_>>()
    };
    assert_eq!(told(LASER_SCAN), [MessageType::FoxgloveLaserScan]);
    assert_eq!(told(POINT_CLOUD), [MessageType::FoxglovePointCloud]);
    assert_eq!(told(POSE_IN_FRAME), [MessageType::FoxglovePoseInFrame]);
    assert_eq!(told(FRAME_TRANSFORM), [MessageType::FoxgloveFrameTransform]);
}

#[test]
fn json_as_foxglove_writes_it() {
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
fn a_reading_that_is_no_number_is_nan() {
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
fn scans_and_clouds_survive_both_encodings() {
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
fn a_writer_undoes_range_limits_rows_and_big_endian() {
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

/// A protocol buffer cut between fields is a shorter message; never an altered one.
/// Without points the other sizes of a cloud say nothing: whatever they are, it can be written.
#[test]
fn a_cloud_without_points_is_written_whatever_its_sizes() {
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

#[test]
fn a_cut_of_a_message_is_an_error_or_a_shorter_message() {
    let scan = source(MessageType::FoxgloveLaserScan, Encoding::Protobuf);
    let whole = bytes_of(LASER_SCAN);
    for cut in 0..whole.len() {
        if let Ok(read) = read_laser_scan(scan, &whole[..cut]) {
            assert!(read.ranges.is_empty(), "cut at {cut}");
        }
    }
    let json = Source { encoding: Encoding::Json, ..scan };
    let whole = write_laser_scan(Encoding::Json, "laser", &laser());
    for cut in 0..whole.len() {
        assert!(read_laser_scan(json, &whole[..cut]).is_err(), "cut at {cut}");
    }
}

#[test]
fn what_must_be_there_is_named() {
    let timeless = PoseInFrameWire { pose: Some(Pose::identity()), ..Default::default() };
    let nowhere = PoseInFrameWire { timestamp: Some(Timestamp::new(1)), ..Default::default() };
    let unturned = FrameTransformWire {
        timestamp: Some(Timestamp::new(1)),
        translation: Some(Vector3::default()),
        ..Default::default()
    };
    for encoding in BOTH {
        let pose = source(MessageType::FoxglovePoseInFrame, encoding);
        let error = read_pose(pose, &encode(encoding, &timeless)).unwrap_err().to_string();
        assert!(error.ends_with("as foxglove.PoseInFrame: it has no timestamp"), "{error}");
        let error = read_pose(pose, &encode(encoding, &nowhere)).unwrap_err().to_string();
        assert!(error.ends_with("it has no pose"), "{error}");
        let transform = source(MessageType::FoxgloveFrameTransform, encoding);
        let bytes = encode(encoding, &unturned);
        let error = read_transforms(transform, &bytes).unwrap_err().to_string();
        assert!(error.ends_with("it has no rotation"), "{error}");
    }
}

#[test]
fn a_cloud_that_contradicts_itself_is_refused() {
    let error = |text: &[u8]| {
        let source = source(MessageType::FoxglovePointCloud, Encoding::Json);
        read_point_cloud(source, text).unwrap_err().to_string()
    };
    assert_eq!(
        error(
            br#"{"timestamp":{"sec":3,"nsec":7},"point_stride":6,"data":"AADAPxcA",
                "fields":[{"name":"ring","offset":5,"type":3}]}"#
        ),
        "point cloud layout: field `ring` ends at byte 7 of a point of 6 bytes"
    );
    assert_eq!(
        error(
            br#"{"timestamp":{"sec":3,"nsec":7},"point_stride":6,"data":"AADAPxcA",
                "fields":[{"name":"ring","offset":4}]}"#
        ),
        "point cloud layout: field `ring` has type 0, expected 1 to 8"
    );
    for point_stride in [0, 4, 7] {
        let text = format!(
            r#"{{"timestamp":{{"sec":3,"nsec":7}},"point_stride":{point_stride},
                "data":"AADAPxcA"}}"#
        );
        assert_eq!(
            error(text.as_bytes()),
            format!("point cloud layout: 6 bytes are no whole points of {point_stride} bytes")
        );
    }
}

#[test]
fn a_time_beyond_what_nanoseconds_count_is_refused() {
    let text = br#"{"timestamp":{"sec":9223372036854775807,"nsec":0},"ranges":[]}"#;
    let source = source(MessageType::FoxgloveLaserScan, Encoding::Json);
    assert!(matches!(read_laser_scan(source, text), Err(MessageError::Malformed { .. })));
}
