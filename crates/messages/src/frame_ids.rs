//! The names of the frames in the header of a message.

use std::borrow::Cow;

use prost::Message;
use serde::{Deserialize, Serialize};

use crate::wire::Cursor;
use crate::{Encoding, MessageError, MessageType, Result, Source};

/// The names of the frames in the header of a message, without the leading slash that ROS 1 allows.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub struct FrameIds<'a> {
    /// The frame of the data (`header.frame_id`). It can be empty.
    pub frame_id: Cow<'a, str>,
    /// The frame whose pose it is, which only `nav_msgs/Odometry` has; otherwise empty.
    pub child_frame_id: Cow<'a, str>,
}

/// Reads the names of the frames of a message. It is `None` for types without a header: a
/// `VelodynePacket`, and transforms, which have a frame each.
///
/// Only the start of a ROS message is read.
pub fn read_frame_ids(source: Source, bytes: &[u8]) -> Result<Option<FrameIds<'_>>> {
    let Source { message_type, encoding } = source;
    match message_type {
        MessageType::VelodynePacket | MessageType::Tf | MessageType::FoxgloveFrameTransform => {
            Ok(None)
        }
        MessageType::FoxglovePointCloud
        | MessageType::FoxgloveLaserScan
        | MessageType::FoxglovePoseInFrame => of_foxglove(source, bytes).map(Some),
        _ => {
            let mut cursor = Cursor::new(message_type, encoding, bytes)?;
            let frame_id = cursor.header_frame_id()?;
            let child_frame_id =
                if message_type == MessageType::Odometry { cursor.string()? } else { "" };
            let [frame_id, child_frame_id] =
                [frame_id, child_frame_id].map(|name| Cow::Borrowed(without_slash(name)));
            Ok(Some(FrameIds { frame_id, child_frame_id }))
        }
    }
}

/// The start of the Foxglove messages with a frame: the field has the same name and number in all.
#[derive(Clone, PartialEq, Message, Serialize, Deserialize)]
#[serde(default)]
struct InFrameWire {
    #[prost(string, tag = "2")]
    frame_id: String,
}

fn of_foxglove(source: Source, bytes: &[u8]) -> Result<FrameIds<'static>> {
    let message = source.message_type.name();
    let decoded = match source.encoding {
        Encoding::Protobuf => InFrameWire::decode(bytes).map_err(|e| e.to_string()),
        Encoding::Json => serde_json::from_slice::<InFrameWire>(bytes).map_err(|e| e.to_string()),
        found => {
            let expected = source.message_type.encodings();
            return Err(MessageError::WrongEncoding { message, expected, found });
        }
    };
    let wire = decoded.map_err(|detail| MessageError::Malformed { message, detail })?;
    let frame_id = Cow::Owned(without_slash(&wire.frame_id).to_owned());
    Ok(FrameIds { frame_id, child_frame_id: Cow::Borrowed("") })
}

fn without_slash(name: &str) -> &str {
    name.trim_start_matches('/')
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{LaserScan, NavSatFix, Odometry, StampedPose3, foxglove, ros};

    fn scan() -> LaserScan {
        LaserScan {
            stamp_ns: 5,
            angle_min: -1.5,
            angle_max: None,
            angle_increment: 0.5,
            time_increment_s: 0.0,
            range_min: 0.1,
            range_max: 81.0,
            ranges: vec![1.0, 2.0],
        }
    }

    fn check(message_type: MessageType, encoding: Encoding, bytes: &[u8], expected: (&str, &str)) {
        let ids = read_frame_ids(Source { message_type, encoding }, bytes).unwrap().unwrap();
        assert_eq!((&*ids.frame_id, &*ids.child_frame_id), expected, "{message_type:?}");
    }

    #[test]
    fn the_frames_of_ros_messages_are_in_their_header() {
        for encoding in [Encoding::Cdr, Encoding::Ros1] {
            let pose = StampedPose3 {
                stamp_ns: 9,
                position: [1.0, 2.0, 3.0],
                orientation: [0.0, 0.0, 0.0, 1.0],
            };
            let bytes = ros::write_pose_stamped(encoding, "/map", &pose);
            check(MessageType::PoseStamped, encoding, &bytes, ("map", ""));
            let odometry = Odometry {
                pose,
                frame_id: "odom".to_owned(),
                child_frame_id: "/base_link".to_owned(),
                pose_covariance: [0.0; 36],
                linear_velocity: [0.0; 3],
                angular_velocity: [0.0; 3],
            };
            let bytes = ros::write_odometry(encoding, &odometry);
            check(MessageType::Odometry, encoding, &bytes, ("odom", "base_link"));
            let bytes = ros::write_laser_scan(encoding, "", &scan());
            check(MessageType::LaserScan, encoding, &bytes, ("", ""));
            let fix = NavSatFix {
                stamp_ns: 9,
                status: 0,
                latitude_deg: 1.0,
                longitude_deg: 2.0,
                altitude_m: 3.0,
                covariance: [0.0; 9],
            };
            let bytes = ros::write_nav_sat_fix(encoding, "gps", &fix);
            check(MessageType::NavSatFix, encoding, &bytes, ("gps", ""));
            let source = Source { message_type: MessageType::NavSatFix, encoding };
            assert!(read_frame_ids(source, &bytes[..8]).is_err());
            let tf = Source { message_type: MessageType::Tf, encoding };
            assert_eq!(read_frame_ids(tf, &[]).unwrap(), None);
        }
    }

    #[test]
    fn the_frames_of_foxglove_messages_are_read_in_both_encodings() {
        for encoding in [Encoding::Protobuf, Encoding::Json] {
            let bytes = foxglove::write_laser_scan(encoding, "laser", &scan());
            check(MessageType::FoxgloveLaserScan, encoding, &bytes, ("laser", ""));
            let source = Source { message_type: MessageType::FoxgloveLaserScan, encoding };
            assert!(read_frame_ids(source, b"\xff").is_err());
        }
    }
}
