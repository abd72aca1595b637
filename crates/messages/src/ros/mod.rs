//! ROS messages in the two encodings that occur in MCAP logs: ROS 2 (CDR, OMG formal/02-06-51 section
//! 15.3, with the four-byte encapsulation header of DDSI-RTPS) and ROS 1 (packed little endian).
//!
//! Both have the same message definitions, except that a header in ROS 1 starts with a sequence
//! number. Messages with packets and points are read without copying. Small messages are read with
//! serde.
//!
//! The readers are in the root of the crate. Every writer in this module panics if the encoding is not
//! CDR or ROS 1.

mod laser_scan;
mod point_cloud;
mod poses;
mod sensors;
mod tf;
mod velodyne;

use std::fmt;
use std::marker::PhantomData;

use serde::de::{DeserializeOwned, SeqAccess, Visitor};
use serde::{Deserialize, Deserializer, Serialize};

pub use crate::source::{Encoding, MessageType};
pub use crate::types::{LaserScan, StampedPose3};
pub use laser_scan::write_laser_scan;
pub use point_cloud::write_point_cloud2;
pub use poses::{write_odometry, write_pose_stamped, write_pose_with_covariance_stamped};
pub use sensors::{write_imu, write_joint_state, write_nav_sat_fix};
pub use tf::write_tf;
pub use velodyne::{VelodyneScan, write_velodyne_packet, write_velodyne_scan};

pub(crate) use laser_scan::laser_scan;
pub(crate) use point_cloud::point_cloud;
pub(crate) use poses::{odometry, pose, pose_with_covariance};
pub(crate) use sensors::{imu, joint_state, nav_sat_fix};
pub(crate) use tf::transforms;

use crate::wire::{Decoded, cdr_is_big_endian, not_of_ros, sec_and_nanosec, time_ns};
use crate::{MessageError, Result};

#[derive(Serialize, Deserialize)]
struct Time {
    sec: u32,
    nanosec: u32,
}

/// `std_msgs/Header` without the sequence number of ROS 1 (see [`Sequenced`]).
#[derive(Serialize, Deserialize)]
struct Header {
    stamp: Time,
    frame_id: String,
}

impl Header {
    fn new(stamp_ns: i64, frame_id: &str) -> Self {
        let (sec, nanosec) = sec_and_nanosec(stamp_ns);
        Self { stamp: Time { sec: sec as u32, nanosec }, frame_id: frame_id.to_owned() }
    }

    fn stamp_ns(&self) -> i64 {
        time_ns(self.stamp.sec, self.stamp.nanosec)
    }
}

/// A ROS 1 message that starts with a header. The first field of the header is a sequence number,
/// which ROS 2 does not have.
#[derive(Serialize, Deserialize)]
struct Sequenced<T> {
    seq: u32,
    message: T,
}

/// Reads a message that starts with a header.
fn decode<T: DeserializeOwned>(
    message_type: MessageType,
    encoding: Encoding,
    bytes: &[u8],
) -> Result<Decoded<T>> {
    let message = message_type.name();
    match encoding {
        Encoding::Cdr => decode_cdr(message, bytes),
        Encoding::Ros1 => {
            let decoded = decode_ros1::<Sequenced<T>>(message, bytes)?;
            Ok(decoded.map(|sequenced| sequenced.message))
        }
        Encoding::Protobuf | Encoding::Json => {
            let expected = message_type.encodings();
            Err(MessageError::WrongEncoding { message, expected, found: encoding })
        }
    }
}

/// Writes a message that starts with a header.
fn encode<T: Serialize>(encoding: Encoding, message: &T) -> Vec<u8> {
    match encoding {
        Encoding::Cdr => encode_cdr(message),
        Encoding::Ros1 => encode_ros1(&Sequenced { seq: 0, message }),
        Encoding::Protobuf | Encoding::Json => not_of_ros(encoding),
    }
}

fn decode_cdr<T: DeserializeOwned>(message: &'static str, bytes: &[u8]) -> Result<Decoded<T>> {
    let body = bytes.get(4..).unwrap_or_default();
    let decoded = if cdr_is_big_endian(message, bytes)? {
        cdr_encoding::from_bytes::<T, byteorder::BigEndian>(body)
    } else {
        cdr_encoding::from_bytes::<T, byteorder::LittleEndian>(body)
    };
    decoded
        .map(|(value, n_read)| Decoded { value, n_left: body.len() - n_read })
        .map_err(|e| MessageError::Malformed { message, detail: e.to_string() })
}

fn decode_ros1<T: DeserializeOwned>(message: &'static str, bytes: &[u8]) -> Result<Decoded<T>> {
    let length = u32::try_from(bytes.len()).unwrap_or(u32::MAX);
    let mut decoder = roslibrust_serde_rosmsg::Deserializer::new(bytes, length);
    T::deserialize(&mut decoder)
        .map(|value| Decoded { value, n_left: decoder.into_inner().len() })
        .map_err(|e| MessageError::Malformed { message, detail: e.to_string() })
}

fn encode_cdr<T: Serialize>(value: &T) -> Vec<u8> {
    let mut out = vec![0, 1, 0, 0];
    out.extend(
        cdr_encoding::to_vec::<T, byteorder::LittleEndian>(value)
            .expect("a plain struct can be serialised"),
    );
    out
}

fn encode_ros1<T: Serialize>(value: &T) -> Vec<u8> {
    roslibrust_serde_rosmsg::to_vec_skip_length(value).expect("a plain struct can be serialised")
}

/// Reads a sequence and allocates memory only for elements that are present. serde reserves up to a
/// mebibyte from the count alone.
fn sequence<'de, D, T>(deserializer: D) -> std::result::Result<Vec<T>, D::Error>
where
    D: Deserializer<'de>,
    T: Deserialize<'de>,
{
    struct Growing<T>(PhantomData<T>);

    impl<'de, T: Deserialize<'de>> Visitor<'de> for Growing<T> {
        type Value = Vec<T>;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("a sequence")
        }

        fn visit_seq<A: SeqAccess<'de>>(
            self,
            mut elements: A,
        ) -> std::result::Result<Vec<T>, A::Error> {
            let mut grown = Vec::new();
            while let Some(element) = elements.next_element()? {
                grown.push(element);
            }
            Ok(grown)
        }
    }

    deserializer.deserialize_seq(Growing(PhantomData))
}

/// A covariance of six values, (6, 6). serde supports arrays of up to 32 elements.
type Covariance6 = [[f64; 6]; 6];

fn rows_of(flat: &[f64; 36]) -> Covariance6 {
    std::array::from_fn(|row| std::array::from_fn(|column| flat[6 * row + column]))
}

fn flat_of(rows: &Covariance6) -> [f64; 36] {
    std::array::from_fn(|k| rows[k / 6][k % 6])
}

#[cfg(test)]
mod tests;
