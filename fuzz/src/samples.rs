//! A small message of every type in each of its encodings, for seeds.

use messages::hdl32e::{BLOCKS, PACKET_BYTES, PacketBuilder, ReturnMode};
use messages::{
    Encoding, Imu, JointState, LaserScan, MessageType, NavSatFix, Odometry, PointCloud, PointField,
    Scalar, StampedPose3, Transform, foxglove, ros,
};

/// Packet `k` of a sensor that rotates by 1 deg per block, has 30 packets per revolution, and sees a
/// wall at 5 m.
pub fn packet(k: u32) -> [u8; PACKET_BYTES] {
    let azimuths =
        std::array::from_fn(|b| ((100 * (k * BLOCKS as u32 + b as u32)) % 36_000) as u16);
    let mut packet = PacketBuilder::new(azimuths, k * 553);
    for block in 0..BLOCKS {
        packet.set_return(block, 15, 2500, 100);
        packet.set_return(block, 31, 400, 7);
    }
    packet.finish()
}

/// A packet in dual-return mode.
pub fn dual_packet() -> [u8; PACKET_BYTES] {
    let mut packet = PacketBuilder::new(std::array::from_fn(|b| 100 * (b as u16 / 2)), 9);
    packet.set_return_mode(ReturnMode::Dual);
    packet.set_return(3, 15, 500, 9);
    packet.finish()
}

/// A cloud with two rings of four points.
pub fn cloud(stamp_ns: i64) -> PointCloud<'static> {
    let field = |name: &str, offset, kind| PointField { name: name.to_owned(), offset, kind };
    let mut data = Vec::new();
    for k in 0..8u16 {
        let angle = f32::from(k / 2) * 1.5;
        for value in [3.0 * angle.cos(), -3.0 * angle.sin(), f32::from(k % 2)] {
            data.extend(value.to_le_bytes());
        }
        data.extend((k % 2).to_le_bytes());
        data.extend((0.01 * f32::from(k)).to_le_bytes());
    }
    PointCloud {
        stamp_ns,
        width: 8,
        height: 1,
        point_step: 18,
        row_step: 144,
        big_endian: false,
        fields: vec![
            field("x", 0, Scalar::F32),
            field("y", 4, Scalar::F32),
            field("z", 8, Scalar::F32),
            field("ring", 12, Scalar::U16),
            field("time", 14, Scalar::F32),
        ],
        data: data.into(),
    }
}

/// A scan with seven beams.
pub fn laser_scan(stamp_ns: i64) -> LaserScan {
    LaserScan {
        stamp_ns,
        angle_min: -1.5,
        angle_max: None,
        angle_increment: 0.5,
        time_increment_s: 0.0,
        range_min: 0.1,
        range_max: 50.0,
        ranges: (0..7u8).map(|beam| 1.0 + f32::from(beam)).collect(),
    }
}

/// A pose.
pub fn pose(stamp_ns: i64) -> StampedPose3 {
    StampedPose3 { stamp_ns, position: [1.0, 2.0, 3.0], orientation: [0.0, 0.0, 0.6, 0.8] }
}

/// A `foxglove.PoseInFrame`, built by hand because `messages` cannot write it.
pub fn pose_in_frame(encoding: Encoding) -> Vec<u8> {
    match encoding {
        Encoding::Json => br#"{"timestamp":{"sec":1,"nsec":5},"frame_id":"map","pose":{"position":{"x":1,"y":2.5,"z":"NaN"},"orientation":{"x":0,"y":0,"z":0.6,"w":0.8}}}"#.to_vec(),
        _ => {
            let vector = |values: &[f64]| {
                let mut bytes = Vec::new();
                for (tag, value) in (1u8..).zip(values) {
                    bytes.push(tag << 3 | 1);
                    bytes.extend(value.to_le_bytes());
                }
                bytes
            };
            let part = |tag: u8, bytes: &[u8]| [&[tag << 3 | 2, bytes.len() as u8], bytes].concat();
            let position = part(1, &vector(&[1.0, 2.0, 3.0]));
            let orientation = part(2, &vector(&[0.0, 0.0, 0.6, 0.8]));
            let pose = part(3, &[position, orientation].concat());
            [part(1, &[8, 1, 16, 5]), part(2, b"map"), pose].concat()
        }
    }
}

/// A message of every type that exists in the encoding.
pub fn all(encoding: Encoding) -> Vec<(MessageType, Vec<u8>)> {
    if matches!(encoding, Encoding::Protobuf | Encoding::Json) {
        return vec![
            (
                MessageType::FoxgloveLaserScan,
                foxglove::write_laser_scan(encoding, "lidar", &laser_scan(1)),
            ),
            (
                MessageType::FoxglovePointCloud,
                foxglove::write_point_cloud(encoding, "lidar", &cloud(1)),
            ),
            (MessageType::FoxglovePoseInFrame, pose_in_frame(encoding)),
        ];
    }
    let transform = Transform {
        stamp_ns: 1,
        parent: "map".to_owned(),
        child: "base".to_owned(),
        translation: [1.0, 2.0, 3.0],
        rotation: [0.0, 0.0, 0.6, 0.8],
    };
    let odometry = Odometry {
        pose: pose(1),
        frame_id: "odom".to_owned(),
        child_frame_id: "base".to_owned(),
        pose_covariance: [0.5; 36],
        linear_velocity: [1.0, 0.0, 0.0],
        angular_velocity: [0.0, 0.0, 0.1],
    };
    let imu = Imu {
        stamp_ns: 1,
        orientation: None,
        angular_velocity: [0.1, 0.2, 0.3],
        linear_acceleration: Some([0.0, 0.0, 9.81]),
    };
    let joints = JointState {
        stamp_ns: 1,
        names: vec!["left".to_owned(), "right".to_owned()],
        positions: vec![1.0; 2],
        velocities: vec![],
    };
    let fix = NavSatFix {
        stamp_ns: 1,
        status: 0,
        latitude_deg: 42.36,
        longitude_deg: -71.09,
        altitude_m: f64::NAN,
        covariance: [0.0; 9],
    };
    let packets = [(1, packet(0)), (2, packet(1)), (3, dual_packet())];
    vec![
        (MessageType::VelodyneScan, ros::write_velodyne_scan(encoding, "velodyne", 9, &packets)),
        (MessageType::VelodynePacket, ros::write_velodyne_packet(encoding, 9, &packet(0))),
        (MessageType::PointCloud2, ros::write_point_cloud2(encoding, "velodyne", &cloud(1))),
        (MessageType::LaserScan, ros::write_laser_scan(encoding, "laser", &laser_scan(1))),
        (MessageType::PoseStamped, ros::write_pose_stamped(encoding, "map", &pose(1))),
        (
            MessageType::PoseWithCovarianceStamped,
            ros::write_pose_with_covariance_stamped(encoding, "map", &pose(1), &[0.5; 36]),
        ),
        (MessageType::Odometry, ros::write_odometry(encoding, &odometry)),
        (MessageType::Tf, ros::write_tf(encoding, &[transform.clone(), transform])),
        (MessageType::NavSatFix, ros::write_nav_sat_fix(encoding, "gps", &fix)),
        (MessageType::Imu, ros::write_imu(encoding, "imu", &imu)),
        (MessageType::JointState, ros::write_joint_state(encoding, "", &joints)),
    ]
}
