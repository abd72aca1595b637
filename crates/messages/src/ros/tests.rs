use super::*;
use crate::hdl32e::{PACKET_BYTES, PacketBuilder};
use crate::*;

const BOTH: [Encoding; 2] = [Encoding::Cdr, Encoding::Ros1];

fn source(message_type: MessageType, encoding: Encoding) -> Source {
    Source { message_type, encoding }
}

fn pose() -> StampedPose3 {
    StampedPose3 {
        stamp_ns: 1_330_000_000_049_999_872,
        position: [1.5, -2.25, 0.125],
        orientation: [0.0, 0.0, 0.6, 0.8],
    }
}

fn odometry() -> Odometry {
    Odometry {
        pose: pose(),
        frame_id: "odom".to_owned(),
        child_frame_id: "base_link".to_owned(),
        pose_covariance: std::array::from_fn(|k| k as f64),
        linear_velocity: [1.0, 2.0, 3.0],
        angular_velocity: [4.0, 5.0, 6.0],
    }
}

fn laser() -> LaserScan {
    LaserScan {
        stamp_ns: 5,
        angle_min: -1.5,
        angle_max: Some(-0.5),
        angle_increment: 0.5,
        time_increment_s: 0.0009765625,
        range_min: 0.1,
        range_max: 81.0,
        ranges: vec![1.0, f32::INFINITY, 81.83],
    }
}

fn imu() -> Imu {
    Imu {
        stamp_ns: 5_000_000_001,
        orientation: Some([0.0, 0.6, 0.0, 0.8]),
        angular_velocity: [0.1, 0.2, 0.3],
        linear_acceleration: Some([0.0, 0.0, 9.81]),
    }
}

fn joints() -> JointState {
    JointState {
        stamp_ns: 5,
        names: vec!["left_wheel".to_owned(), "right_wheel".to_owned()],
        positions: vec![],
        velocities: vec![1.25, 1.5],
    }
}

fn fix() -> NavSatFix {
    NavSatFix {
        stamp_ns: 3_000_000_007,
        status: -1,
        latitude_deg: 42.5,
        longitude_deg: -71.25,
        altitude_m: 10.0,
        covariance: std::array::from_fn(|k| k as f64),
    }
}

fn transforms() -> Vec<Transform> {
    let transform = |child: &str| Transform {
        stamp_ns: 5,
        parent: "map".to_owned(),
        child: child.to_owned(),
        translation: [1.0, 2.0, 3.0],
        rotation: [0.0, 0.0, 0.6, 0.8],
    };
    vec![transform("a"), transform("base_link")]
}

/// Two points as in `velodyne_pointcloud`, packed: x, y, z, intensity, ring and time in 22 bytes.
fn cloud() -> PointCloud<'static> {
    let field = |(name, offset, kind): (&str, usize, Scalar)| PointField {
        name: name.to_owned(),
        offset,
        kind,
    };
    let fields = [
        ("x", 0, Scalar::F32),
        ("y", 4, Scalar::F32),
        ("z", 8, Scalar::F32),
        ("intensity", 12, Scalar::F32),
        ("ring", 16, Scalar::U16),
        ("time", 18, Scalar::F32),
    ];
    let mut data = Vec::new();
    for (x, ring) in [(1.5f32, 23u16), (-2.0, 7)] {
        for value in [x, 0.25, 0.5, 100.0] {
            data.extend(value.to_le_bytes());
        }
        data.extend(ring.to_le_bytes());
        data.extend(0.001f32.to_le_bytes());
    }
    PointCloud {
        stamp_ns: 9,
        width: 2,
        height: 1,
        point_step: 22,
        row_step: 44,
        big_endian: false,
        fields: fields.map(field).to_vec(),
        data: data.into(),
    }
}

/// One message of every type in an encoding.
fn one_of_each(encoding: Encoding) -> [(MessageType, Vec<u8>); 11] {
    let packet = PacketBuilder::new([9; 12], 7).finish();
    [
        (MessageType::VelodyneScan, write_velodyne_scan(encoding, "velodyne", 9, &[(5, packet)])),
        (MessageType::VelodynePacket, write_velodyne_packet(encoding, 9, &packet)),
        (MessageType::PointCloud2, write_point_cloud2(encoding, "velodyne", &cloud())),
        (MessageType::LaserScan, write_laser_scan(encoding, "laser", &laser())),
        (MessageType::PoseStamped, write_pose_stamped(encoding, "map", &pose())),
        (
            MessageType::PoseWithCovarianceStamped,
            write_pose_with_covariance_stamped(encoding, "map", &pose(), &[0.5; 36]),
        ),
        (MessageType::Odometry, write_odometry(encoding, &odometry())),
        (MessageType::Tf, write_tf(encoding, &transforms())),
        (MessageType::NavSatFix, write_nav_sat_fix(encoding, "gps", &fix())),
        (MessageType::Imu, write_imu(encoding, "imu", &imu())),
        (MessageType::JointState, write_joint_state(encoding, "", &joints())),
    ]
}

/// The values of a message as text, which makes NaN equal to itself.
fn read_as_text(source: Source, bytes: &[u8]) -> Result<String> {
    match source.message_type {
        MessageType::VelodyneScan | MessageType::VelodynePacket => {
            read_velodyne(source, bytes).map(|m| format!("{:?}", m.packets().collect::<Vec<_>>()))
        }
        MessageType::PointCloud2 | MessageType::FoxglovePointCloud => {
            read_point_cloud(source, bytes).map(|m| format!("{m:?}"))
        }
        MessageType::LaserScan | MessageType::FoxgloveLaserScan => {
            read_laser_scan(source, bytes).map(|m| format!("{m:?}"))
        }
        MessageType::Odometry => read_odometry(source, bytes).map(|m| format!("{m:?}")),
        MessageType::PoseStamped
        | MessageType::PoseWithCovarianceStamped
        | MessageType::FoxglovePoseInFrame => read_pose(source, bytes).map(|m| format!("{m:?}")),
        MessageType::Tf | MessageType::FoxgloveFrameTransform => {
            read_transforms(source, bytes).map(|m| format!("{m:?}"))
        }
        MessageType::NavSatFix => read_nav_sat_fix(source, bytes).map(|m| format!("{m:?}")),
        MessageType::Imu => read_imu(source, bytes).map(|m| format!("{m:?}")),
        MessageType::JointState => read_joint_state(source, bytes).map(|m| format!("{m:?}")),
    }
}

#[test]
fn poses_read_as_written_in_both_encodings() {
    for encoding in BOTH {
        for frame_id in ["", "map", "odom_frame"] {
            let bytes = write_pose_stamped(encoding, frame_id, &pose());
            assert_eq!(read_pose(source(MessageType::PoseStamped, encoding), &bytes), Ok(pose()));

            let covariance = std::array::from_fn(|k| k as f64);
            let bytes =
                write_pose_with_covariance_stamped(encoding, frame_id, &pose(), &covariance);
            let with_covariance = source(MessageType::PoseWithCovarianceStamped, encoding);
            assert_eq!(read_pose(with_covariance, &bytes), Ok(pose()));

            let odometry = Odometry { frame_id: frame_id.to_owned(), ..odometry() };
            let bytes = write_odometry(encoding, &odometry);
            let of_odometry = source(MessageType::Odometry, encoding);
            assert_eq!(read_stamp_ns(of_odometry, &bytes), Ok(Some(odometry.pose.stamp_ns)));
            assert_eq!(read_pose(of_odometry, &bytes), Ok(pose()));
            assert_eq!(read_odometry(of_odometry, &bytes), Ok(odometry));
        }
    }
}

#[test]
fn all_other_types_read_as_written_in_both_encodings() {
    for encoding in BOTH {
        let source = |message_type| source(message_type, encoding);
        let bytes = write_laser_scan(encoding, "laser", &laser());
        assert_eq!(read_laser_scan(source(MessageType::LaserScan), &bytes), Ok(laser()));
        let bytes = write_joint_state(encoding, "", &joints());
        assert_eq!(read_joint_state(source(MessageType::JointState), &bytes), Ok(joints()));
        let bytes = write_nav_sat_fix(encoding, "gps", &fix());
        assert_eq!(read_nav_sat_fix(source(MessageType::NavSatFix), &bytes), Ok(fix()));
        let bytes = write_tf(encoding, &transforms());
        assert_eq!(read_transforms(source(MessageType::Tf), &bytes), Ok(transforms()));
        for frame_id in ["", "a", "ab", "abc", "velodyne"] {
            let bytes = write_point_cloud2(encoding, frame_id, &cloud());
            assert_eq!(read_point_cloud(source(MessageType::PointCloud2), &bytes), Ok(cloud()));
        }
        let gyroscope_only = Imu { orientation: None, linear_acceleration: None, ..imu() };
        for imu in [imu(), gyroscope_only] {
            let bytes = write_imu(encoding, "imu", &imu);
            assert_eq!(read_imu(source(MessageType::Imu), &bytes), Ok(imu));
        }
    }
}

/// A driver that does not estimate the orientation may leave it zero without marking it as not measured.
#[test]
fn a_zero_orientation_is_none() {
    let zero = Imu { orientation: Some([0.0; 4]), ..imu() };
    let bytes = write_imu(Encoding::Cdr, "imu", &zero);
    let read = read_imu(source(MessageType::Imu, Encoding::Cdr), &bytes).unwrap();
    assert_eq!(read, Imu { orientation: None, ..imu() });
}

/// The layout, worked out by hand: encapsulation header, sec, nanosec, the string "map\0" (4 + 4), then
/// f64 values at multiples of 8 from the end of the encapsulation header.
#[test]
fn the_cdr_bytes_of_a_pose() {
    let pose = StampedPose3 {
        stamp_ns: 3_000_000_007,
        position: [1.0, 0.0, 0.0],
        orientation: [0.0, 0.0, 0.0, 1.0],
    };
    let bytes = write_pose_stamped(Encoding::Cdr, "map", &pose);
    assert_eq!(bytes.len(), 4 + 8 + 8 + 8 + 7 * 8 - 4 - 4);
    assert_eq!(&bytes[..20], [0, 1, 0, 0, 3, 0, 0, 0, 7, 0, 0, 0, 4, 0, 0, 0, b'm', b'a', b'p', 0]);
    assert_eq!(&bytes[20..28], 1.0f64.to_le_bytes());
}

/// The layout, worked out by hand: after the header (16 bytes in CDR, 19 in ROS 1) the status i8, the
/// service u16 at a multiple of 2, and the latitude f64 at a multiple of 8.
#[test]
fn the_bytes_of_a_fix() {
    let cdr = write_nav_sat_fix(Encoding::Cdr, "gps", &fix());
    assert_eq!(&cdr[4 + 16..4 + 24], [255, 0, 1, 0, 0, 0, 0, 0]);
    assert_eq!(&cdr[4 + 24..][..8], 42.5f64.to_le_bytes());
    assert_eq!(cdr.len(), 4 + 24 + 3 * 8 + 9 * 8 + 1);
    let ros1 = write_nav_sat_fix(Encoding::Ros1, "gps", &fix());
    assert_eq!(&ros1[..19], [0, 0, 0, 0, 3, 0, 0, 0, 7, 0, 0, 0, 3, 0, 0, 0, b'g', b'p', b's']);
    assert_eq!(&ros1[19..22], [255, 1, 0]);
    assert_eq!(&ros1[22..30], 42.5f64.to_le_bytes());
}

/// The layout, worked out by hand: a count, then the transforms. In ROS 1 the header of each transform
/// starts with a sequence number.
#[test]
fn the_bytes_of_a_transform() {
    let transforms = &transforms()[..1];
    let head = [
        1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 5, 0, 0, 0, 3, 0, 0, 0, b'm', b'a', b'p', 1, 0, 0, 0,
        b'a',
    ];
    let ros1 = write_tf(Encoding::Ros1, transforms);
    assert_eq!(ros1[..head.len()], head);
    assert_eq!(ros1.len(), head.len() + 7 * 8);
    let head = [
        0, 1, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 5, 0, 0, 0, 4, 0, 0, 0, b'm', b'a', b'p', 0, 2, 0, 0,
        0, b'a', 0,
    ];
    let cdr = write_tf(Encoding::Cdr, transforms);
    assert_eq!(cdr[..head.len()], head);
    assert_eq!(cdr.len(), 4 + 32 + 7 * 8);
}

/// A big-endian message, written by hand: one point of two bytes with a field "r" of datatype 4 (u16).
#[test]
fn a_big_endian_cloud_is_read() {
    let bytes = [
        &[0, 0, 0, 0][..],                     // encapsulation
        &[0, 0, 0, 3, 0, 0, 0, 7],             // stamp
        &[0, 0, 0, 1, 0, 0, 0, 0],             // frame_id "", padding
        &[0, 0, 0, 1, 0, 0, 0, 1],             // height, width
        &[0, 0, 0, 1],                         // fields
        &[0, 0, 0, 2, b'r', 0, 0, 0],          // name, padding
        &[0, 0, 0, 0, 4, 0, 0, 0, 0, 0, 0, 1], // offset, datatype, padding, count
        &[1, 0, 0, 0, 0, 0, 0, 2, 0, 0, 0, 2], // is_bigendian, padding, point_step, row_step
        &[0, 0, 0, 2, 1, 2, 1],                // data, is_dense
    ]
    .concat();
    let source = source(MessageType::PointCloud2, Encoding::Cdr);
    let cloud = read_point_cloud(source, &bytes).unwrap();
    assert_eq!((cloud.stamp_ns, cloud.len()), (3_000_000_007, 1));
    assert!(matches!(cloud.data, std::borrow::Cow::Borrowed(_)));
    assert_eq!(cloud.column("r").unwrap().get(0), 258.0);
    assert!(is_plausible_message(source, &bytes));
}

#[test]
fn the_columns_of_a_packed_cloud_are_read() {
    for encoding in BOTH {
        let bytes = write_point_cloud2(encoding, "velodyne", &cloud());
        let cloud = read_point_cloud(source(MessageType::PointCloud2, encoding), &bytes).unwrap();
        let column = |name| cloud.column(name).unwrap();
        assert_eq!((column("x").get(0), column("x").get(1)), (1.5, -2.0));
        assert_eq!((column("ring").get(0), column("ring").get(1)), (23.0, 7.0));
        assert_eq!(column("time").get(1), f64::from(0.001f32));
    }
}

/// Layouts in public logs: nuScenes (five `f32`, 20 bytes), and `velodyne_pointcloud` through PCL (`z`
/// padded to 16 bytes, the point padded to 32 bytes).
#[test]
fn the_columns_of_clouds_in_public_logs_are_read() {
    let nuscenes = (20, [("x", 0, Scalar::F32), ("z", 8, Scalar::F32), ("ring", 16, Scalar::F32)]);
    let pcl = (32, [("x", 0, Scalar::F32), ("ring", 20, Scalar::U16), ("time", 24, Scalar::F32)]);
    for (point_step, layout) in [nuscenes, pcl] {
        let mut data = vec![0xAB; 2 * point_step];
        for (k, (_, offset, kind)) in layout.iter().enumerate() {
            for point in 0..2 {
                let at = point * point_step + offset;
                let value = (10 * k + point) as u16;
                match kind {
                    Scalar::U16 => data[at..at + 2].copy_from_slice(&value.to_le_bytes()),
                    _ => data[at..at + 4].copy_from_slice(&f32::from(value).to_le_bytes()),
                }
            }
        }
        let fields = layout
            .map(|(name, offset, kind)| PointField { name: name.to_owned(), offset, kind })
            .to_vec();
        let row_step = data.len();
        let cloud = PointCloud { point_step, row_step, fields, data: data.into(), ..cloud() };
        for encoding in BOTH {
            let bytes = write_point_cloud2(encoding, "velodyne", &cloud);
            let source = source(MessageType::PointCloud2, encoding);
            let cloud = read_point_cloud(source, &bytes).unwrap();
            for (k, (name, _, _)) in layout.into_iter().enumerate() {
                let column = cloud.column(name).unwrap();
                let expected = (10 * k) as f64;
                assert_eq!((column.get(0), column.get(1)), (expected, expected + 1.0), "{name}");
            }
        }
    }
}

#[test]
fn a_field_of_unknown_datatype_is_reported_by_name() {
    let one_field = PointCloud { fields: vec![cloud().fields[0].clone()], ..cloud() };
    let mut bytes = write_point_cloud2(Encoding::Ros1, "", &one_field);
    // seq, stamp, frame_id, height, width, number of fields; "x", offset; datatype.
    let datatype_at = 4 + 8 + 4 + 4 + 4 + 4 + 5 + 4;
    assert_eq!(bytes[datatype_at], 7);
    bytes[datatype_at] = 9;
    let error = read_point_cloud(source(MessageType::PointCloud2, Encoding::Ros1), &bytes);
    assert_eq!(
        error.unwrap_err().to_string(),
        "invalid point cloud layout: field `x` has datatype 9, expected 1 to 8"
    );
}

#[test]
fn packets_read_as_written_in_both_encodings_with_frame_names_of_any_length() {
    let packets: Vec<_> = (0..3u16)
        .map(|k| (1_000_000_000 + i64::from(k), PacketBuilder::new([k; 12], 7).finish()))
        .collect();
    for encoding in BOTH {
        for frame_id in ["", "a", "ab", "abc", "abcd", "velodyne"] {
            let bytes = write_velodyne_scan(encoding, frame_id, 9, &packets);
            let scan = read_velodyne(source(MessageType::VelodyneScan, encoding), &bytes).unwrap();
            assert_eq!((scan.stamp_ns, scan.len(), scan.is_empty()), (9, 3, false));
            for ((stamp, bytes), (expected_stamp, expected)) in scan.packets().zip(&packets) {
                assert_eq!(stamp, *expected_stamp);
                assert_eq!(bytes, expected);
            }
        }
    }
}

/// The count follows the stamp and the empty frame name. In ROS 1, a sequence number precedes the
/// stamp; in CDR, the encapsulation header does.
#[test]
fn a_count_that_hides_packets_is_an_error() {
    for (encoding, at) in [(Encoding::Cdr, 4 + 8 + 4 + 4), (Encoding::Ros1, 4 + 8 + 4)] {
        let source = source(MessageType::VelodyneScan, encoding);
        let packets = [(1, PacketBuilder::new([7; 12], 0).finish()); 3];
        let mut bytes = write_velodyne_scan(encoding, "", 0, &packets);
        assert_eq!((bytes[at], read_velodyne(source, &bytes).unwrap().len()), (3, 3));
        for count in [0, 1, 2] {
            bytes[at] = count;
            let error = read_velodyne(source, &bytes).unwrap_err().to_string();
            assert!(error.ends_with(&format!(" bytes follow its {count} packets")), "{error}");
        }
        bytes[at] = 3;
        // The frame name now covers 3 KB of the packets. The bytes after it are zero: 0 packets.
        bytes[12..14].copy_from_slice(&3000u16.to_le_bytes());
        assert!(read_velodyne(source, &bytes).is_err());
    }
}

/// The layout, written by hand: the stamp and the data, in CDR after the encapsulation header.
#[test]
fn a_velodyne_packet_is_read_as_a_scan_of_one_packet() {
    let packet = PacketBuilder::new([9; 12], 7).finish();
    let stamp = [3, 0, 0, 0, 7, 0, 0, 0];
    for (encoding, head) in [(Encoding::Cdr, &[0, 1, 0, 0][..]), (Encoding::Ros1, &[])] {
        let bytes = [head, &stamp, &packet].concat();
        assert_eq!(write_velodyne_packet(encoding, 3_000_000_007, &packet), bytes);
        let scan = read_velodyne(source(MessageType::VelodynePacket, encoding), &bytes).unwrap();
        assert_eq!((scan.stamp_ns, scan.len()), (3_000_000_007, 1));
        assert_eq!(scan.packets().next(), Some((3_000_000_007, &packet[..])));
    }
}

#[test]
fn a_truncated_message_is_an_error() {
    for encoding in BOTH {
        for (message_type, complete) in one_of_each(encoding) {
            let source = source(message_type, encoding);
            read_as_text(source, &complete).unwrap();
            for cut in 0..complete.len() {
                assert!(read_as_text(source, &complete[..cut]).is_err(), "{source}, cut at {cut}");
            }
        }
    }
}

/// Among the replaced bytes are the counts of packets, fields, points, joint names and ranges.
#[test]
fn a_count_larger_than_the_message_is_an_error() {
    for encoding in BOTH {
        for (message_type, complete) in one_of_each(encoding) {
            for at in 0..complete.len() - 4 {
                let mut bytes = complete.clone();
                bytes[at..at + 4].copy_from_slice(&u32::MAX.to_le_bytes());
                let _ = read_as_text(source(message_type, encoding), &bytes);
            }
        }
    }
    let mut bytes = write_velodyne_scan(Encoding::Cdr, "velodyne", 9, &[]);
    let at = bytes.len() - 4;
    bytes[at..].copy_from_slice(&u32::MAX.to_le_bytes());
    assert!(matches!(
        read_velodyne(source(MessageType::VelodyneScan, Encoding::Cdr), &bytes),
        Err(MessageError::TooShort { .. })
    ));
}

#[test]
fn an_unknown_encapsulation_is_an_error() {
    for (message_type, mut bytes) in one_of_each(Encoding::Cdr) {
        bytes[1] = 3;
        assert_eq!(
            read_as_text(source(message_type, Encoding::Cdr), &bytes).unwrap_err(),
            MessageError::Encapsulation { found: 3 }
        );
    }
}

#[test]
fn a_reader_reports_messages_of_another_type() {
    let pose = source(MessageType::PoseStamped, Encoding::Cdr);
    let error = read_laser_scan(pose, &[]).unwrap_err();
    assert_eq!(error.to_string(), "cannot read a laser scan from PoseStamped messages");
    for (message_type, bytes) in one_of_each(Encoding::Ros1) {
        let error = read_as_text(source(message_type, Encoding::Json), &bytes).unwrap_err();
        let name = message_type.name();
        assert_eq!(
            error.to_string(),
            format!("cannot read {name} messages in encoding json, expected cdr or ros1")
        );
    }
}

proptest::proptest! {
    #[test]
    fn no_bytes_make_a_reader_panic(
        bytes in proptest::collection::vec(proptest::num::u8::ANY, 0..400),
    ) {
        for message_type in MessageType::ALL {
            for encoding in [Encoding::Cdr, Encoding::Ros1, Encoding::Protobuf, Encoding::Json] {
                let source = source(message_type, encoding);
                let _ = read_as_text(source, &bytes);
                let _ = is_plausible_message(source, &bytes);
                // Random bytes rarely start with a valid encapsulation header, so add one.
                let _ = read_as_text(source, &[&[0, 1, 0, 0], &bytes[..]].concat());
            }
        }
    }

    /// Messages with a few altered bytes test more of the readers than random bytes do.
    #[test]
    fn no_altered_message_makes_a_reader_panic(
        choice in 0..22usize,
        changes in proptest::collection::vec((0..4096usize, proptest::num::u8::ANY), 1..6),
    ) {
        let encoding = BOTH[choice % 2];
        let (message_type, mut bytes) = one_of_each(encoding)[choice / 2].clone();
        for (at, value) in changes {
            let at = at % bytes.len();
            bytes[at] = value;
        }
        let source = source(message_type, encoding);
        let _ = read_as_text(source, &bytes);
        if let Ok(scan) = read_velodyne(source, &bytes) {
            assert!(scan.packets().all(|(_, packet)| packet.len() == PACKET_BYTES));
            assert_eq!(scan.packets().count(), scan.len());
        }
        if let Ok(cloud) = read_point_cloud(source, &bytes) {
            for column in cloud.fields.iter().filter_map(|field| cloud.column(&field.name)) {
                let sum: f64 = (0..column.len()).map(|index| column.get(index)).sum();
                std::hint::black_box(sum);
            }
        }
    }
}
