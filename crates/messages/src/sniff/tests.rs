use super::*;
use crate::hdl32e::PacketBuilder;
use crate::*;

const POSE: StampedPose3 =
    StampedPose3 { stamp_ns: 9, position: [1.0, 2.0, 3.0], orientation: [0.0, 0.0, 0.6, 0.8] };

fn source(message_type: MessageType, encoding: Encoding) -> Source {
    Source { message_type, encoding }
}

/// The types that the bytes are plausible as.
fn sniff(encoding: Encoding, bytes: &[u8]) -> Vec<MessageType> {
    MessageType::ALL
        .into_iter()
        .filter(|&message_type| is_plausible_message(source(message_type, encoding), bytes))
        .collect()
}

#[test]
fn a_message_is_plausible_as_its_own_type_only() {
    let packet = PacketBuilder::new([9; 12], 7).finish();
    let laser = LaserScan {
        stamp_ns: 5,
        angle_min: -1.5,
        angle_max: None,
        angle_increment: 0.5,
        time_increment_s: 0.0,
        range_min: 0.1,
        range_max: 81.0,
        ranges: vec![1.0; 7],
    };
    let joints = JointState {
        stamp_ns: 5,
        names: vec!["left_wheel".to_owned()],
        positions: vec![],
        velocities: vec![1.25],
    };
    let imu = Imu {
        stamp_ns: 5,
        orientation: None,
        angular_velocity: [0.1, 0.2, 0.3],
        linear_acceleration: Some([0.0, 0.0, 9.81]),
    };
    let transform = Transform {
        stamp_ns: 5,
        parent: "map".to_owned(),
        child: "base".to_owned(),
        translation: [1.0, 2.0, 3.0],
        rotation: POSE.orientation,
    };
    for encoding in [Encoding::Cdr, Encoding::Ros1] {
        let bytes = ros::write_velodyne_scan(encoding, "velodyne", 9, &[(1, packet), (2, packet)]);
        assert_eq!(sniff(encoding, &bytes), [MessageType::VelodyneScan]);
        let bytes = ros::write_velodyne_packet(encoding, 9, &packet);
        assert_eq!(sniff(encoding, &bytes), [MessageType::VelodynePacket]);
        let bytes = ros::write_laser_scan(encoding, "laser", &laser);
        assert_eq!(sniff(encoding, &bytes), [MessageType::LaserScan]);
        let bytes = ros::write_pose_stamped(encoding, "map", &POSE);
        assert_eq!(sniff(encoding, &bytes), [MessageType::PoseStamped]);
        let bytes = ros::write_pose_with_covariance_stamped(encoding, "map", &POSE, &[0.5; 36]);
        assert_eq!(sniff(encoding, &bytes), [MessageType::PoseWithCovarianceStamped]);
        let bytes = ros::write_joint_state(encoding, "", &joints);
        assert_eq!(sniff(encoding, &bytes), [MessageType::JointState]);
        let bytes = ros::write_imu(encoding, "imu", &imu);
        assert_eq!(sniff(encoding, &bytes), [MessageType::Imu]);
        let bytes = ros::write_tf(encoding, std::slice::from_ref(&transform));
        assert_eq!(sniff(encoding, &bytes), [MessageType::Tf]);
    }
}

#[test]
fn padding_is_accepted_in_cdr_only() {
    for (encoding, max_padding) in [(Encoding::Cdr, 8), (Encoding::Ros1, 0)] {
        let source = source(MessageType::PoseStamped, encoding);
        let complete = ros::write_pose_stamped(encoding, "map", &POSE);
        for n_padding in 0..12 {
            let padded = [&complete[..], &[0; 12][..n_padding]].concat();
            assert_eq!(
                is_plausible_message(source, &padded),
                n_padding <= max_padding,
                "{n_padding}"
            );
        }
    }
}

#[test]
fn messages_with_implausible_values_are_not_plausible() {
    let is_pose = |pose: &StampedPose3| {
        let bytes = ros::write_pose_stamped(Encoding::Cdr, "map", pose);
        is_plausible_message(source(MessageType::PoseStamped, Encoding::Cdr), &bytes)
    };
    assert!(is_pose(&POSE));
    assert!(!is_pose(&StampedPose3 { orientation: [0.0, 0.0, 0.6, 0.802], ..POSE }));
    assert!(!is_pose(&StampedPose3 { position: [f64::NAN, 0.0, 0.0], ..POSE }));

    let is_scan = |packets: &[(i64, [u8; 1206])]| {
        let bytes = ros::write_velodyne_scan(Encoding::Cdr, "velodyne", 9, packets);
        is_plausible_message(source(MessageType::VelodyneScan, Encoding::Cdr), &bytes)
    };
    let packet = PacketBuilder::new([9; 12], 7).finish();
    assert!(is_scan(&[(1, packet)]));
    assert!(!is_scan(&[]));
    assert!(!is_scan(&[(1, packet), (2, [0; 1206])]));

    let laser = |angle_min, n_beams| {
        let scan = LaserScan {
            stamp_ns: 5,
            angle_min,
            angle_max: None,
            angle_increment: 0.5,
            time_increment_s: 0.0,
            range_min: 0.1,
            range_max: 81.0,
            ranges: vec![1.0; n_beams],
        };
        let bytes = ros::write_laser_scan(Encoding::Cdr, "laser", &scan);
        is_plausible_message(source(MessageType::LaserScan, Encoding::Cdr), &bytes)
    };
    assert!(laser(0.0, 2));
    assert!(!laser(0.0, 1));
    assert!(!laser(f64::INFINITY, 2));
}
