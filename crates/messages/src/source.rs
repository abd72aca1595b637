//! The type and the encoding of the messages of a channel.

use std::fmt;

/// The encoding of messages.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Encoding {
    /// ROS 2: CDR with an encapsulation header.
    Cdr,
    /// ROS 1.
    Ros1,
    /// Protocol buffers.
    Protobuf,
    /// JSON text.
    Json,
}

impl Encoding {
    const ALL: [Self; 4] = [Self::Cdr, Self::Ros1, Self::Protobuf, Self::Json];

    /// The encoding with this name in the `message_encoding` of an MCAP channel.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|encoding| encoding.name() == name)
    }

    /// The name in the `message_encoding` of an MCAP channel (MCAP registry, "Message encodings").
    pub fn name(self) -> &'static str {
        match self {
            Self::Cdr => "cdr",
            Self::Ros1 => "ros1",
            Self::Protobuf => "protobuf",
            Self::Json => "json",
        }
    }
}

impl fmt::Display for Encoding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// The message types that can be read.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum MessageType {
    /// `velodyne_msgs/VelodyneScan`: the packets of about one revolution.
    VelodyneScan,
    /// `velodyne_msgs/VelodynePacket`: one packet and its stamp.
    VelodynePacket,
    /// `sensor_msgs/PointCloud2`
    PointCloud2,
    /// `sensor_msgs/LaserScan`
    LaserScan,
    /// `foxglove.PointCloud`
    FoxglovePointCloud,
    /// `foxglove.LaserScan`
    FoxgloveLaserScan,
    /// `geometry_msgs/PoseStamped`
    PoseStamped,
    /// `geometry_msgs/PoseWithCovarianceStamped`
    PoseWithCovarianceStamped,
    /// `nav_msgs/Odometry`
    Odometry,
    /// `foxglove.PoseInFrame`
    FoxglovePoseInFrame,
    /// `tf2_msgs/TFMessage`, and the older `tf/tfMessage` of ROS 1, which has the same layout.
    Tf,
    /// `foxglove.FrameTransform`
    FoxgloveFrameTransform,
    /// `sensor_msgs/NavSatFix`
    NavSatFix,
    /// `sensor_msgs/Imu`
    Imu,
    /// `sensor_msgs/JointState`
    JointState,
}

impl MessageType {
    /// Every type, in the order of declaration.
    pub const ALL: [Self; 15] = [
        Self::VelodyneScan,
        Self::VelodynePacket,
        Self::PointCloud2,
        Self::LaserScan,
        Self::FoxglovePointCloud,
        Self::FoxgloveLaserScan,
        Self::PoseStamped,
        Self::PoseWithCovarianceStamped,
        Self::Odometry,
        Self::FoxglovePoseInFrame,
        Self::Tf,
        Self::FoxgloveFrameTransform,
        Self::NavSatFix,
        Self::Imu,
        Self::JointState,
    ];

    /// The type with this schema name, in the form of ROS 1 (`pkg/Type`), ROS 2 (`pkg/msg/Type`) or
    /// Foxglove (`foxglove.Type`).
    ///
    /// Only the name is used, because schema texts in logs can be missing or incomplete.
    pub fn from_schema_name(name: &str) -> Option<Self> {
        if name == "tf/tfMessage" {
            return Some(Self::Tf);
        }
        Self::ALL.into_iter().find(|message_type| {
            let (ros1, ros2) = message_type.schema_names();
            name == ros1 || name == ros2
        })
    }

    /// The name for messages to the user: the type name without the package, except for Foxglove's
    /// types.
    pub fn name(self) -> &'static str {
        let (ros1, _) = self.schema_names();
        ros1.split_once('/').map_or(ros1, |(_package, name)| name)
    }

    /// The encodings in which messages of this type can be read.
    pub fn encodings(self) -> &'static [Encoding] {
        match self.is_foxglove() {
            true => &[Encoding::Protobuf, Encoding::Json],
            false => &[Encoding::Cdr, Encoding::Ros1],
        }
    }

    /// The schema name for an encoding; `None` if the type does not exist in this encoding.
    pub fn schema_name(self, encoding: Encoding) -> Option<&'static str> {
        let (ros1, ros2) = self.schema_names();
        self.encodings().contains(&encoding).then_some(match encoding {
            Encoding::Cdr => ros2,
            Encoding::Ros1 | Encoding::Protobuf | Encoding::Json => ros1,
        })
    }

    fn is_foxglove(self) -> bool {
        matches!(
            self,
            Self::FoxglovePointCloud
                | Self::FoxgloveLaserScan
                | Self::FoxglovePoseInFrame
                | Self::FoxgloveFrameTransform
        )
    }

    /// The schema names in ROS 1 and in ROS 2. Both are the same for Foxglove's types.
    fn schema_names(self) -> (&'static str, &'static str) {
        match self {
            Self::VelodyneScan => ("velodyne_msgs/VelodyneScan", "velodyne_msgs/msg/VelodyneScan"),
            Self::VelodynePacket => {
                ("velodyne_msgs/VelodynePacket", "velodyne_msgs/msg/VelodynePacket")
            }
            Self::PointCloud2 => ("sensor_msgs/PointCloud2", "sensor_msgs/msg/PointCloud2"),
            Self::LaserScan => ("sensor_msgs/LaserScan", "sensor_msgs/msg/LaserScan"),
            Self::FoxglovePointCloud => ("foxglove.PointCloud", "foxglove.PointCloud"),
            Self::FoxgloveLaserScan => ("foxglove.LaserScan", "foxglove.LaserScan"),
            Self::PoseStamped => ("geometry_msgs/PoseStamped", "geometry_msgs/msg/PoseStamped"),
            Self::PoseWithCovarianceStamped => (
                "geometry_msgs/PoseWithCovarianceStamped",
                "geometry_msgs/msg/PoseWithCovarianceStamped",
            ),
            Self::Odometry => ("nav_msgs/Odometry", "nav_msgs/msg/Odometry"),
            Self::FoxglovePoseInFrame => ("foxglove.PoseInFrame", "foxglove.PoseInFrame"),
            Self::Tf => ("tf2_msgs/TFMessage", "tf2_msgs/msg/TFMessage"),
            Self::FoxgloveFrameTransform => ("foxglove.FrameTransform", "foxglove.FrameTransform"),
            Self::NavSatFix => ("sensor_msgs/NavSatFix", "sensor_msgs/msg/NavSatFix"),
            Self::Imu => ("sensor_msgs/Imu", "sensor_msgs/msg/Imu"),
            Self::JointState => ("sensor_msgs/JointState", "sensor_msgs/msg/JointState"),
        }
    }
}

impl fmt::Display for MessageType {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// The type and the encoding of the messages of a channel.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Source {
    /// The message type.
    pub message_type: MessageType,
    /// The encoding.
    pub encoding: Encoding,
}

impl Source {
    /// The source for the schema name and message encoding of a channel. `None` if such messages
    /// cannot be read.
    pub fn new(schema_name: &str, encoding_name: &str) -> Option<Self> {
        let message_type = MessageType::from_schema_name(schema_name)?;
        let encoding = Encoding::from_name(encoding_name)?;
        message_type.encodings().contains(&encoding).then_some(Self { message_type, encoding })
    }
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({})", self.message_type, self.encoding)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn schema_names_of_ros1_ros2_and_foxglove_give_their_type() {
        let t = MessageType::from_schema_name;
        assert_eq!(t("velodyne_msgs/msg/VelodyneScan"), Some(MessageType::VelodyneScan));
        assert_eq!(t("velodyne_msgs/VelodyneScan"), Some(MessageType::VelodyneScan));
        assert_eq!(t("nav_msgs/msg/Odometry"), Some(MessageType::Odometry));
        assert_eq!(t("nav_msgs/msg/Path"), None);
        assert_eq!(t("PoseStamped"), None);
        assert_eq!(t("tf2_msgs/msg/TFMessage"), Some(MessageType::Tf));
        assert_eq!(t("tf/tfMessage"), Some(MessageType::Tf));
        assert_eq!(t("foxglove.PointCloud"), Some(MessageType::FoxglovePointCloud));
        assert_eq!(t("foxglove/PointCloud"), None);
    }

    #[test]
    fn a_type_is_found_by_each_of_its_schema_names() {
        for message_type in MessageType::ALL {
            for &encoding in message_type.encodings() {
                let schema_name = message_type.schema_name(encoding).unwrap();
                assert!(schema_name.contains(message_type.name().trim_start_matches("foxglove.")));
                let source = Source { message_type, encoding };
                assert_eq!(Source::new(schema_name, encoding.name()), Some(source));
            }
        }
        assert_eq!(MessageType::Tf.name(), "TFMessage");
        assert_eq!(MessageType::FoxgloveLaserScan.name(), "foxglove.LaserScan");
    }

    #[test]
    fn a_type_in_an_encoding_that_it_does_not_exist_in_is_not_a_source() {
        assert_eq!(Source::new("sensor_msgs/msg/Imu", "json"), None);
        assert_eq!(Source::new("foxglove.LaserScan", "cdr"), None);
        assert_eq!(Source::new("sensor_msgs/msg/Imu", "cbor"), None);
        assert_eq!(MessageType::Imu.schema_name(Encoding::Protobuf), None);
        let source = Source::new("sensor_msgs/msg/Imu", "cdr").unwrap();
        assert_eq!(source.to_string(), "Imu (cdr)");
    }
}
