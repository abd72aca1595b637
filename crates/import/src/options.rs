use std::net::IpAddr;

/// How chunks are compressed.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Compression {
    /// Zstandard, at its default level.
    #[default]
    Zstd,
    /// LZ4 frames.
    Lz4,
    /// Not at all.
    None,
}

/// How a recording is imported.
#[derive(Debug, Clone, PartialEq)]
pub struct Options {
    /// Of the chunks written.
    pub compression: Compression,
    /// Names of the topics written.
    pub topics: Topics,
    /// Captures: UDP port that the sensor's data goes to.
    pub udp_port: u16,
    /// Captures: UDP port that the sensor's positions go to.
    pub position_port: u16,
    /// Captures: the sensor's address; needed where a capture holds several sensors.
    pub source_ip: Option<IpAddr>,
}

impl Default for Options {
    /// The ports are those of a sensor as it comes (HDL-32E manual 63-9113, "Ethernet and power").
    fn default() -> Self {
        Self {
            compression: Compression::default(),
            topics: Topics::default(),
            udp_port: 2368,
            position_port: 8308,
            source_ip: None,
        }
    }
}

macro_rules! topics {
    ($($(#[$doc:meta])* $field:ident $kind:ident = $default:literal,)*) => {
        /// Names of the topics written.
        #[derive(Debug, Clone, PartialEq, Eq)]
        pub struct Topics {
            $($(#[$doc])* pub $field: String,)*
        }

        impl Default for Topics {
            fn default() -> Self {
                Self { $($field: $default.to_owned(),)* }
            }
        }

        /// Where a record goes.
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
    /// NCLT: `PointCloud2`, one turn each.
    points Points = "/velodyne_points",
    /// NCLT: `Imu` of the Microstrain unit.
    imu Imu = "/imu/data",
    /// NCLT: `Imu` with the heading of the fibre-optic gyro and its rate.
    kvh Kvh = "/kvh",
    /// NCLT: `JointState` with the speeds of the wheels.
    wheels Wheels = "/wheel_states",
    /// NCLT and CARMEN: `PoseStamped`, the true pose.
    ground_truth GroundTruth = "/ground_truth",
    /// NCLT and CARMEN: `Odometry`.
    odom Odom = "/odom",
    /// CARMEN: `LaserScan` of the front scanner.
    scan Scan = "/scan",
    /// CARMEN: `LaserScan` of the rear scanner.
    rear_scan RearScan = "/rear_scan",
    /// CARMEN: `PoseStamped`, the corrected pose.
    pose Pose = "/pose",
}
