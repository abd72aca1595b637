use std::net::IpAddr;
use std::path::PathBuf;

/// The compression of the chunks of a log.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Compression {
    /// Zstandard, at its default level.
    #[default]
    Zstd,
    /// LZ4 frames.
    Lz4,
    /// No compression.
    None,
}

/// The options of an import.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// The compression of the chunks.
    pub compression: Compression,
    /// The names of the topics.
    pub topics: Topics,
    /// Captures: the UDP port of the data packets.
    pub udp_port: u16,
    /// Captures: the UDP port of the position packets.
    pub position_port: u16,
    /// Captures: the IP address of the sensor. Required if a capture contains several sensors.
    pub source_ip: Option<IpAddr>,
    /// Bags: the topics that are imported. All of them if it is empty.
    pub select: Vec<String>,
    /// Bags: where packed files are unpacked. The folder of the system for temporary files if it is `None`.
    pub scratch: Option<PathBuf>,
}

impl Default for Options {
    /// The ports are the factory settings of the sensor (HDL-32E User's Manual 63-9113, "Ethernet
    /// and power").
    fn default() -> Self {
        Self {
            compression: Compression::default(),
            topics: Topics::default(),
            udp_port: 2368,
            position_port: 8308,
            source_ip: None,
            select: Vec::new(),
            scratch: None,
        }
    }
}

macro_rules! topics {
    ($($(#[$doc:meta])* $field:ident $kind:ident = $default:literal,)*) => {
        /// The names of the topics in the log.
        #[derive(Debug, Clone, PartialEq, Eq)]
        pub struct Topics {
            $($(#[$doc])* pub $field: String,)*
        }

        impl Default for Topics {
            fn default() -> Self {
                Self { $($field: $default.to_owned(),)* }
            }
        }

        /// The topic of a record.
        #[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
        pub(crate) enum Topic {
            $($kind,)*
        }

        impl Topics {
            pub(crate) fn name(&self, topic: Topic) -> &str {
                match topic {
                    $(Topic::$kind => &self.$field,)*
                }
            }
        }
    };
}

topics! {
    /// Captures: `VelodyneScan`.
    packets Packets = "/velodyne_packets",
    /// Captures and NCLT: `NavSatFix`.
    fix Fix = "/fix",
    /// NCLT: `NavSatFix` of the RTK receiver.
    fix_rtk FixRtk = "/fix_rtk",
    /// NCLT: `PointCloud2`, one revolution per message.
    points Points = "/velodyne_points",
    /// NCLT: `Imu` of the Microstrain unit.
    imu Imu = "/imu/data",
    /// NCLT: `Imu` with the heading and the yaw rate of the fibre-optic gyro.
    kvh Kvh = "/kvh",
    /// NCLT: `JointState` with the wheel speeds.
    wheels Wheels = "/wheel_states",
    /// NCLT and CARMEN: `PoseStamped`, the ground truth.
    ground_truth GroundTruth = "/ground_truth",
    /// NCLT and CARMEN: `Odometry`.
    odom Odom = "/odom",
    /// CARMEN: `Odometry` of the `ODOM` lines, if the poses of the scans contradict them.
    odom_lines OdomLines = "/odom_lines",
    /// CARMEN: `LaserScan` of the front scanner.
    scan Scan = "/scan",
    /// CARMEN: `LaserScan` of the rear scanner.
    rear_scan RearScan = "/rear_scan",
    /// CARMEN: `PoseStamped`, the corrected pose.
    pose Pose = "/pose",
}
