//! Calls every reader of messages, and checks what must be true for any bytes.

use messages::{
    Encoding, MessageType, PointCloud, Source, VelodyneScan, foxglove, is_plausible_message,
    read_frame_ids, read_imu, read_joint_state, read_laser_scan, read_nav_sat_fix, read_odometry,
    read_point_cloud, read_pose, read_transforms, read_velodyne, ros,
};

/// Reads the bytes as every message type in one encoding, also with types that do not exist in it.
///
/// A message that is plausible must be readable. A message that was read, then written and read
/// again, must be written with the same bytes.
pub fn read_as_every_type(encoding: Encoding, bytes: &[u8]) {
    for message_type in MessageType::ALL {
        let source = Source { message_type, encoding };
        let is_plausible = is_plausible_message(source, bytes);
        let mut is_read = false;
        let mut note = |is_ok: bool| is_read |= is_ok;
        // The names of the frames can be read from the start of a message that cannot be read.
        let _names = read_frame_ids(source, bytes);
        note(read_velodyne(source, bytes).map(|scan| all_packets(&scan)).is_ok());
        let write = match message_type {
            MessageType::FoxgloveLaserScan => foxglove::write_laser_scan,
            _ => ros::write_laser_scan,
        };
        note(match read_laser_scan(source, bytes) {
            Ok(scan) => {
                let written = write(encoding, "", &scan);
                let again =
                    read_laser_scan(source, &written).expect("a written message can be read");
                assert_eq!(again.ranges.len(), scan.ranges.len());
                true
            }
            Err(_) => false,
        });
        note(match read_point_cloud(source, bytes) {
            Ok(cloud) => {
                all_points(&cloud);
                match message_type {
                    MessageType::FoxglovePointCloud => {
                        check_rewrites(source, bytes, &owned_cloud, &|cloud| {
                            foxglove::write_point_cloud(encoding, "", cloud)
                        });
                    }
                    _ => {
                        foxglove::write_point_cloud(Encoding::Protobuf, "", &cloud);
                        check_rewrites(source, bytes, &owned_cloud, &|cloud| {
                            ros::write_point_cloud2(encoding, "", cloud)
                        });
                    }
                }
                true
            }
            Err(_) => false,
        });
        note(match read_pose(source, bytes) {
            Ok(_) if message_type != MessageType::FoxglovePoseInFrame => {
                let written = ros::write_pose_stamped(
                    encoding,
                    "",
                    &read_pose(source, bytes).expect("it was read before"),
                );
                let source = Source { message_type: MessageType::PoseStamped, encoding };
                check_rewrites(source, &written, &read_pose, &|pose| {
                    ros::write_pose_stamped(encoding, "", pose)
                });
                true
            }
            result => result.is_ok(),
        });
        note(check_rewrites(source, bytes, &read_odometry, &|odometry| {
            ros::write_odometry(encoding, odometry)
        }));
        note(check_rewrites(source, bytes, &read_imu, &|imu| ros::write_imu(encoding, "", imu)));
        note(check_rewrites(source, bytes, &read_joint_state, &|joints| {
            ros::write_joint_state(encoding, "", joints)
        }));
        note(check_rewrites(source, bytes, &read_nav_sat_fix, &|fix| {
            ros::write_nav_sat_fix(encoding, "", fix)
        }));
        note(match read_transforms(source, bytes) {
            Ok(_) if message_type == MessageType::Tf => {
                check_rewrites(source, bytes, &read_transforms, &|transforms| {
                    ros::write_tf(encoding, transforms)
                })
            }
            result => result.is_ok(),
        });
        assert!(is_read || !is_plausible, "{source} is plausible and cannot be read");
    }
}

/// Whether the bytes can be read. Checks that the value, written and read again, is written with the
/// same bytes.
fn check_rewrites<T>(
    source: Source,
    bytes: &[u8],
    read: &impl Fn(Source, &[u8]) -> messages::Result<T>,
    write: &impl Fn(&T) -> Vec<u8>,
) -> bool {
    let Ok(value) = read(source, bytes) else { return false };
    let once = write(&value);
    let twice = write(&read(source, &once).expect("a written message can be read"));
    assert_eq!(once, twice, "{source}");
    true
}

fn owned_cloud(source: Source, bytes: &[u8]) -> messages::Result<PointCloud<'static>> {
    let cloud = read_point_cloud(source, bytes)?;
    let data = cloud.data.into_owned().into();
    Ok(PointCloud { data, ..cloud })
}

/// Reads every packet of a message.
pub fn all_packets(scan: &VelodyneScan<'_>) {
    assert_eq!(scan.packets().len(), scan.len());
    for (_, bytes) in scan.packets() {
        packet(bytes);
    }
}

/// Reads every value of a packet, if the bytes are a packet.
pub fn packet(bytes: &[u8]) {
    use messages::hdl32e::{AZIMUTH_COUNTS, BLOCKS, LASERS, Packet, foreign_layout};
    let Ok(packet) = Packet::new(bytes) else {
        foreign_layout(bytes);
        return;
    };
    assert_eq!(foreign_layout(bytes), None);
    let mut returns = 0u32;
    for block in 0..BLOCKS {
        assert!(packet.azimuth(block) < AZIMUTH_COUNTS);
        for laser in 0..LASERS {
            returns |= u32::from(packet.distance(block, laser) != 0) << laser;
            std::hint::black_box(packet.intensity(block, laser));
        }
    }
    assert_eq!(packet.returns_of(), returns);
    std::hint::black_box((packet.device_time_us(), packet.return_mode(), packet.product()));
}

/// Reads every value of a cloud.
fn all_points(cloud: &PointCloud<'_>) {
    assert!(cloud.len() <= cloud.data.len());
    for field in &cloud.fields {
        let column = cloud.column(&field.name).expect("a cloud from a reader is consistent");
        assert_eq!(column.len(), cloud.len());
        let sum: f64 = (0..column.len()).map(|k| column.get(k)).sum();
        std::hint::black_box(sum);
    }
}
