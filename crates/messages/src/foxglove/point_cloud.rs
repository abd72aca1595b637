//! `foxglove.PointCloud`.

use std::borrow::Cow;

use prost::Message;
use serde::{Deserialize, Serialize};

use super::{Pose, Timestamp, decode, encode, stamp_ns, text};
use crate::wire::Decoded;
use crate::{Encoding, MessageError, MessageType, PointCloud, PointField, Result, Scalar};

/// The data type of each `PackedElementField.NumericType`, which starts at 1; 0 is unknown.
const NUMERIC_TYPES: [Scalar; 8] = [
    Scalar::U8,
    Scalar::I8,
    Scalar::U16,
    Scalar::I16,
    Scalar::U32,
    Scalar::I32,
    Scalar::F32,
    Scalar::F64,
];

#[derive(Clone, PartialEq, Message, Serialize, Deserialize)]
#[serde(default)]
struct PointCloudWire {
    #[prost(message, optional, tag = "1")]
    timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    frame_id: String,
    #[prost(message, optional, tag = "3")]
    pose: Option<Pose>,
    #[prost(fixed32, tag = "4")]
    point_stride: u32,
    #[prost(message, repeated, tag = "5")]
    fields: Vec<FieldWire>,
    #[prost(bytes = "vec", tag = "6")]
    #[serde(with = "text::base64")]
    data: Vec<u8>,
}

/// `foxglove.PackedElementField`
#[derive(Clone, PartialEq, Message, Serialize, Deserialize)]
#[serde(default)]
struct FieldWire {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(fixed32, tag = "2")]
    offset: u32,
    #[prost(int32, tag = "3")]
    r#type: i32,
}

/// Reads a `foxglove.PointCloud`. Its pose, the origin of the cloud in its frame, is ignored: a cloud is
/// in the frame of the lidar.
pub(crate) fn point_cloud(
    encoding: Encoding,
    bytes: &[u8],
) -> Result<Decoded<PointCloud<'static>>> {
    const TYPE: MessageType = MessageType::FoxglovePointCloud;
    let Decoded { value: wire, n_left } = decode::<PointCloudWire>(TYPE, encoding, bytes)?;
    let point_step = wire.point_stride as usize;
    let width = match wire.data.len() {
        0 => 0,
        n_bytes => match n_bytes.checked_rem(point_step) {
            Some(0) => n_bytes / point_step,
            _ => {
                return Err(MessageError::CloudLayout {
                    detail: format!(
                        "{n_bytes} bytes are not a multiple of {point_step} bytes per point"
                    ),
                });
            }
        },
    };
    let cloud = PointCloud {
        stamp_ns: stamp_ns(TYPE, wire.timestamp)?,
        width,
        height: 1,
        point_step,
        row_step: wire.data.len(),
        big_endian: false,
        fields: wire.fields.into_iter().map(field).collect::<Result<_>>()?,
        data: Cow::Owned(wire.data),
    };
    Ok(Decoded { value: cloud.checked()?, n_left })
}

fn field(wire: FieldWire) -> Result<PointField> {
    let index = usize::try_from(wire.r#type).ok().and_then(|number| number.checked_sub(1));
    match index.and_then(|index| NUMERIC_TYPES.get(index)) {
        Some(&kind) => Ok(PointField { name: wire.name, offset: wire.offset as usize, kind }),
        None => Err(MessageError::CloudLayout {
            detail: format!("field `{}` has type {}, expected 1 to 8", wire.name, wire.r#type),
        }),
    }
}

/// Writes a `foxglove.PointCloud` at the origin of its frame. The message type has no rows and is always
/// little endian; the points are converted.
///
/// # Panics
/// Panics if the encoding is not protobuf or JSON.
pub fn write_point_cloud(encoding: Encoding, frame_id: &str, cloud: &PointCloud<'_>) -> Vec<u8> {
    let fields = cloud.fields.iter().map(|field| FieldWire {
        name: field.name.clone(),
        offset: field.offset as u32,
        r#type: 1 + NUMERIC_TYPES.iter().take_while(|&&kind| kind != field.kind).count() as i32,
    });
    encode(
        encoding,
        &PointCloudWire {
            timestamp: Some(Timestamp::new(cloud.stamp_ns)),
            frame_id: frame_id.to_owned(),
            pose: Some(Pose::identity()),
            point_stride: cloud.point_step as u32,
            fields: fields.collect(),
            data: packed(cloud),
        },
    )
}

/// The points without gaps, little endian.
fn packed(cloud: &PointCloud<'_>) -> Vec<u8> {
    if cloud.is_empty() {
        return Vec::new();
    }
    let row = cloud.width * cloud.point_step;
    let mut data = Vec::with_capacity(row * cloud.height);
    for k in 0..cloud.height {
        data.extend_from_slice(&cloud.data[k * cloud.row_step..][..row]);
    }
    if cloud.big_endian {
        for point in data.chunks_exact_mut(cloud.point_step.max(1)) {
            for field in &cloud.fields {
                point[field.offset..][..field.kind.n_bytes()].reverse();
            }
        }
    }
    data
}
