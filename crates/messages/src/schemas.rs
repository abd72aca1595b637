//! Schema texts for the messages that loopboost writes, in the form that MCAP prescribes for
//! `ros2msg` and `ros1msg`: the type's own definition, then each dependency behind a line of `=` and
//! its name.
//!
//! Source: the ROS packages `std_msgs`, `builtin_interfaces`, `geometry_msgs` and `velodyne_msgs`
//! (their `.msg` files without comments).

/// Schema name of a ROS 2 `VelodyneScan`.
pub const VELODYNE_SCAN_NAME: &str = "velodyne_msgs/msg/VelodyneScan";
/// Its `ros2msg` text.
pub const VELODYNE_SCAN: &str = "\
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

/// Schema name of a ROS 2 `PoseStamped`.
pub const POSE_STAMPED_NAME: &str = "geometry_msgs/msg/PoseStamped";
/// Its `ros2msg` text.
pub const POSE_STAMPED: &str = "\
std_msgs/Header header
geometry_msgs/Pose pose
================================================================================
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
================================================================================
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
================================================================================
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
";

/// Schema name of a ROS 1 `VelodyneScan`.
pub const ROS1_VELODYNE_SCAN_NAME: &str = "velodyne_msgs/VelodyneScan";
/// Its `ros1msg` text.
pub const ROS1_VELODYNE_SCAN: &str = "\
std_msgs/Header header
velodyne_msgs/VelodynePacket[] packets
================================================================================
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
================================================================================
MSG: velodyne_msgs/VelodynePacket
time stamp
uint8[1206] data
";

/// Schema name of a ROS 1 `PoseStamped`.
pub const ROS1_POSE_STAMPED_NAME: &str = "geometry_msgs/PoseStamped";
/// Its `ros1msg` text.
pub const ROS1_POSE_STAMPED: &str = "\
std_msgs/Header header
geometry_msgs/Pose pose
================================================================================
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
================================================================================
MSG: geometry_msgs/Pose
geometry_msgs/Point position
geometry_msgs/Quaternion orientation
================================================================================
MSG: geometry_msgs/Point
float64 x
float64 y
float64 z
================================================================================
MSG: geometry_msgs/Quaternion
float64 x
float64 y
float64 z
float64 w
";
