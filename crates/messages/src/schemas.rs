//! Schema texts of the ROS messages that can be written, in the form that MCAP defines for `ros2msg`
//! and `ros1msg`: the definition of the type, then each dependency after a line of `=` and its name.
//!
//! Source: the `.msg` files, without comments and constants, of the ROS packages `std_msgs`,
//! `builtin_interfaces`, `geometry_msgs`, `nav_msgs`, `sensor_msgs`, `tf2_msgs` and `velodyne_msgs`.

use crate::source::{Encoding, MessageType};

/// A schema, as it is stored in an MCAP file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Schema {
    /// The name, for example `sensor_msgs/msg/Imu`.
    pub name: &'static str,
    /// The encoding of the schema: `ros2msg` or `ros1msg`.
    pub encoding: &'static str,
    /// The definition of the type and of its dependencies.
    pub text: String,
}

/// The schema of a ROS message type in an encoding. `None` for Foxglove's types and for encodings in
/// which the type does not exist.
pub fn of(message_type: MessageType, encoding: Encoding) -> Option<Schema> {
    let schema_encoding = match encoding {
        Encoding::Cdr => "ros2msg",
        Encoding::Ros1 => "ros1msg",
        Encoding::Protobuf | Encoding::Json => return None,
    };
    let name = message_type.schema_name(encoding)?;
    let ros1_name = message_type.schema_name(Encoding::Ros1)?;
    let mut text = definition(ros1_name, encoding)?;
    for dependency in dependencies(ros1_name, encoding)? {
        text += &"=".repeat(80);
        text += &format!("\nMSG: {dependency}\n");
        text += &definition(dependency, encoding)?;
    }
    Some(Schema { name, encoding: schema_encoding, text })
}

/// The text of a `.msg` file. Types are written as `pkg/Type` in ROS 1 and in ROS 2.
fn definition(name: &str, encoding: Encoding) -> Option<String> {
    let (_, fields) = DEFINITIONS.iter().find(|(defined, _)| *defined == name)?;
    let mut text = String::new();
    for field in fields.split(", ") {
        match (field, encoding) {
            (ROS2_TIME_FIELD, Encoding::Ros1) => text += "time stamp",
            (ROS1_SEQ_FIELD, Encoding::Cdr) => continue,
            _ => text += field,
        }
        text.push('\n');
    }
    Some(text)
}

/// The types that a type depends on, in the order of their use. The header and its own dependency,
/// which most types share, come last.
fn dependencies(name: &str, encoding: Encoding) -> Option<Vec<&'static str>> {
    fn visit(name: &str, encoding: Encoding, found: &mut Vec<&'static str>) -> Option<()> {
        for line in definition(name, encoding)?.lines() {
            let field_type = line.split([' ', '[']).next()?;
            if field_type.contains('/') {
                let (dependency, _) = DEFINITIONS.iter().find(|(name, _)| *name == field_type)?;
                if !found.contains(dependency) {
                    found.push(dependency);
                    visit(dependency, encoding, found)?;
                }
            }
        }
        Some(())
    }
    let mut found = Vec::new();
    visit(name, encoding, &mut found)?;
    found.sort_by_key(|&name| [HEADER, TIME].iter().position(|&last| last == name));
    Some(found)
}

const HEADER: &str = "std_msgs/Header";
const TIME: &str = "builtin_interfaces/Time";
/// A field that is `time stamp` in ROS 1.
const ROS2_TIME_FIELD: &str = "builtin_interfaces/Time stamp";
/// A field that ROS 2 does not have.
const ROS1_SEQ_FIELD: &str = "uint32 seq";

/// The fields of each type.
#[rustfmt::skip]
const DEFINITIONS: [(&str, &str); 24] = [
    ("velodyne_msgs/VelodyneScan",
     "std_msgs/Header header, velodyne_msgs/VelodynePacket[] packets"),
    ("velodyne_msgs/VelodynePacket",
     "builtin_interfaces/Time stamp, uint8[1206] data"),
    ("sensor_msgs/PointCloud2",
     "std_msgs/Header header, uint32 height, uint32 width, sensor_msgs/PointField[] fields, \
      bool is_bigendian, uint32 point_step, uint32 row_step, uint8[] data, bool is_dense"),
    ("sensor_msgs/PointField",
     "string name, uint32 offset, uint8 datatype, uint32 count"),
    ("sensor_msgs/LaserScan",
     "std_msgs/Header header, float32 angle_min, float32 angle_max, float32 angle_increment, \
      float32 time_increment, float32 scan_time, float32 range_min, float32 range_max, \
      float32[] ranges, float32[] intensities"),
    ("sensor_msgs/Imu",
     "std_msgs/Header header, geometry_msgs/Quaternion orientation, \
      float64[9] orientation_covariance, geometry_msgs/Vector3 angular_velocity, \
      float64[9] angular_velocity_covariance, geometry_msgs/Vector3 linear_acceleration, \
      float64[9] linear_acceleration_covariance"),
    ("sensor_msgs/JointState",
     "std_msgs/Header header, string[] name, float64[] position, float64[] velocity, \
      float64[] effort"),
    ("sensor_msgs/NavSatFix",
     "std_msgs/Header header, sensor_msgs/NavSatStatus status, float64 latitude, \
      float64 longitude, float64 altitude, float64[9] position_covariance, \
      uint8 position_covariance_type"),
    ("sensor_msgs/NavSatStatus",
     "int8 status, uint16 service"),
    ("geometry_msgs/PoseStamped",
     "std_msgs/Header header, geometry_msgs/Pose pose"),
    ("geometry_msgs/PoseWithCovarianceStamped",
     "std_msgs/Header header, geometry_msgs/PoseWithCovariance pose"),
    ("nav_msgs/Odometry",
     "std_msgs/Header header, string child_frame_id, geometry_msgs/PoseWithCovariance pose, \
      geometry_msgs/TwistWithCovariance twist"),
    ("tf2_msgs/TFMessage",
     "geometry_msgs/TransformStamped[] transforms"),
    ("geometry_msgs/TransformStamped",
     "std_msgs/Header header, string child_frame_id, geometry_msgs/Transform transform"),
    ("geometry_msgs/Transform",
     "geometry_msgs/Vector3 translation, geometry_msgs/Quaternion rotation"),
    ("geometry_msgs/PoseWithCovariance",
     "geometry_msgs/Pose pose, float64[36] covariance"),
    ("geometry_msgs/TwistWithCovariance",
     "geometry_msgs/Twist twist, float64[36] covariance"),
    ("geometry_msgs/Pose",
     "geometry_msgs/Point position, geometry_msgs/Quaternion orientation"),
    ("geometry_msgs/Twist",
     "geometry_msgs/Vector3 linear, geometry_msgs/Vector3 angular"),
    ("geometry_msgs/Point", "float64 x, float64 y, float64 z"),
    ("geometry_msgs/Vector3", "float64 x, float64 y, float64 z"),
    ("geometry_msgs/Quaternion", "float64 x, float64 y, float64 z, float64 w"),
    (HEADER, "uint32 seq, builtin_interfaces/Time stamp, string frame_id"),
    (TIME, "int32 sec, uint32 nanosec"),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn schema_texts_of_a_velodyne_scan() {
        let ros2 = of(MessageType::VelodyneScan, Encoding::Cdr).unwrap();
        assert_eq!((ros2.name, ros2.encoding), ("velodyne_msgs/msg/VelodyneScan", "ros2msg"));
        let expected = "\
std_msgs/Header header
velodyne_msgs/VelodynePacket[] packets
================================================================================
MSG: velodyne_msgs/VelodynePacket
builtin_interfaces/Time stamp
uint8[1206] data
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
";
        assert_eq!(ros2.text, expected);
        let ros1 = of(MessageType::VelodyneScan, Encoding::Ros1).unwrap();
        assert_eq!((ros1.name, ros1.encoding), ("velodyne_msgs/VelodyneScan", "ros1msg"));
        let expected = "\
std_msgs/Header header
velodyne_msgs/VelodynePacket[] packets
================================================================================
MSG: velodyne_msgs/VelodynePacket
time stamp
uint8[1206] data
================================================================================
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
";
        assert_eq!(ros1.text, expected);
    }

    #[test]
    fn a_type_used_twice_is_defined_once() {
        let text = of(MessageType::Odometry, Encoding::Cdr).unwrap().text;
        assert_eq!(text.matches("MSG: geometry_msgs/Vector3\n").count(), 1);
        assert_eq!(text.matches("MSG: ").count(), 9);
    }

    #[test]
    fn exactly_the_ros_types_have_schemas() {
        for message_type in MessageType::ALL {
            let of_ros = message_type.encodings() == [Encoding::Cdr, Encoding::Ros1];
            assert_eq!(of(message_type, Encoding::Cdr).is_some(), of_ros);
            assert_eq!(of(message_type, Encoding::Ros1).is_some(), of_ros);
            assert_eq!(of(message_type, Encoding::Json), None);
        }
    }
}
