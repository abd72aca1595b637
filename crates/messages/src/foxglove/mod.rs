//! Foxglove messages as protocol buffers and as JSON.
//!
//! Source: the schemas in `foxglove/foxglove-sdk`, `schemas/proto` and `schemas/jsonschema`. One
//! struct is used for both: the field numbers are those of the `.proto` files, and the names are those
//! of the JSON schemas. In JSON, a time is `{sec, nsec}` and bytes are base64.
//!
//! A protocol buffer that is cut between two fields is a valid, shorter message. Unlike in the other
//! encodings, such a loss cannot be detected. A message without a time or without a required pose is
//! an error.

mod laser_scan;
mod point_cloud;
mod poses;
mod text;

use prost::Message;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

pub use laser_scan::write_laser_scan;
pub use point_cloud::write_point_cloud;

pub(crate) use laser_scan::laser_scan;
pub(crate) use point_cloud::point_cloud;
pub(crate) use poses::{pose, transform};

use crate::wire::{Decoded, sec_and_nanosec};
use crate::{Encoding, MessageError, MessageType, Result};

/// `google.protobuf.Timestamp`
#[derive(Clone, PartialEq, Message, Serialize, Deserialize)]
struct Timestamp {
    #[prost(int64, tag = "1")]
    sec: i64,
    #[prost(int32, tag = "2")]
    nsec: i32,
}

impl Timestamp {
    fn new(stamp_ns: i64) -> Self {
        let (sec, nsec) = sec_and_nanosec(stamp_ns);
        Self { sec, nsec: nsec as i32 }
    }
}

#[derive(Clone, PartialEq, Message, Serialize, Deserialize)]
#[serde(default)]
struct Vector3 {
    #[prost(double, tag = "1")]
    #[serde(with = "text::number")]
    x: f64,
    #[prost(double, tag = "2")]
    #[serde(with = "text::number")]
    y: f64,
    #[prost(double, tag = "3")]
    #[serde(with = "text::number")]
    z: f64,
}

#[derive(Clone, PartialEq, Message, Serialize, Deserialize)]
#[serde(default)]
struct Quaternion {
    #[prost(double, tag = "1")]
    #[serde(with = "text::number")]
    x: f64,
    #[prost(double, tag = "2")]
    #[serde(with = "text::number")]
    y: f64,
    #[prost(double, tag = "3")]
    #[serde(with = "text::number")]
    z: f64,
    #[prost(double, tag = "4")]
    #[serde(with = "text::number")]
    w: f64,
}

#[derive(Clone, PartialEq, Message, Serialize, Deserialize)]
#[serde(default)]
struct Pose {
    #[prost(message, optional, tag = "1")]
    position: Option<Vector3>,
    #[prost(message, optional, tag = "2")]
    orientation: Option<Quaternion>,
}

impl Pose {
    fn identity() -> Self {
        Self {
            position: Some(Vector3::default()),
            orientation: Some(Quaternion { w: 1.0, ..Quaternion::default() }),
        }
    }
}

/// The start of a message. The other fields are skipped.
#[derive(Clone, PartialEq, Message, Serialize, Deserialize)]
#[serde(default)]
struct TimestampWire {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Timestamp>,
}

/// Reads the time of a message \[ns since the epoch\].
pub(crate) fn timestamp_ns(
    message_type: MessageType,
    encoding: Encoding,
    bytes: &[u8],
) -> Result<i64> {
    stamp_ns(message_type, decode::<TimestampWire>(message_type, encoding, bytes)?.value.timestamp)
}

/// Decodes a complete message. The protobuf decoder skips unknown fields; their bytes count as not
/// read.
fn decode<T: Message + Default + DeserializeOwned>(
    message_type: MessageType,
    encoding: Encoding,
    bytes: &[u8],
) -> Result<Decoded<T>> {
    let message = message_type.name();
    let decoded = match encoding {
        Encoding::Protobuf => T::decode(bytes).map_err(|e| e.to_string()).map(|value| {
            let n_left = bytes.len().abs_diff(value.encoded_len());
            Decoded { value, n_left }
        }),
        Encoding::Json => serde_json::from_slice(bytes)
            .map(|value| Decoded { value, n_left: 0 })
            .map_err(|e| e.to_string()),
        Encoding::Cdr | Encoding::Ros1 => {
            let expected = message_type.encodings();
            return Err(MessageError::WrongEncoding { message, expected, found: encoding });
        }
    };
    decoded.map_err(|detail| MessageError::Malformed { message, detail })
}

/// # Panics
/// Panics if the encoding is not protobuf or JSON.
fn encode<T: Message + Serialize>(encoding: Encoding, message: &T) -> Vec<u8> {
    match encoding {
        Encoding::Protobuf => message.encode_to_vec(),
        Encoding::Json => serde_json::to_vec(message).expect("a plain struct can be serialised"),
        Encoding::Cdr | Encoding::Ros1 => {
            panic!(
                "cannot write a Foxglove message in encoding {encoding}, expected protobuf or json"
            )
        }
    }
}

/// Checks that a required part of a message is present.
fn required<T>(message_type: MessageType, name: &str, part: Option<T>) -> Result<T> {
    part.ok_or_else(|| malformed(message_type, format!("it has no {name}")))
}

fn malformed(message_type: MessageType, detail: String) -> MessageError {
    MessageError::Malformed { message: message_type.name(), detail }
}

/// The time of a message \[ns since the epoch\].
fn stamp_ns(message_type: MessageType, timestamp: Option<Timestamp>) -> Result<i64> {
    let Timestamp { sec, nsec } = required(message_type, "timestamp", timestamp)?;
    sec.checked_mul(1_000_000_000)
        .and_then(|ns| ns.checked_add(i64::from(nsec)))
        .ok_or_else(|| malformed(message_type, format!("its time of {sec} s is out of range")))
}

#[cfg(test)]
mod tests;
