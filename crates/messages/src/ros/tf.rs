//! `tf2_msgs/TFMessage`.

use serde::{Deserialize, Serialize};

use super::{
    Header, Sequenced, decode_cdr, decode_ros1, encode_cdr, encode_ros1, not_of_ros, sequence,
};
use crate::wire::Decoded;
use crate::{Encoding, MessageError, MessageType, Result, Transform};

/// `T` is a [`TransformWire`], or a [`Sequenced`] one in ROS 1.
#[derive(Serialize, Deserialize)]
#[serde(bound(deserialize = "T: Deserialize<'de>"))]
struct TfWire<T> {
    #[serde(deserialize_with = "sequence")]
    transforms: Vec<T>,
}

/// `geometry_msgs/TransformStamped`
#[derive(Serialize, Deserialize)]
struct TransformWire {
    header: Header,
    child_frame_id: String,
    translation: [f64; 3],
    rotation: [f64; 4],
}

impl TransformWire {
    fn new(transform: &Transform) -> Self {
        Self {
            header: Header::new(transform.stamp_ns, &transform.parent),
            child_frame_id: transform.child.clone(),
            translation: transform.translation,
            rotation: transform.rotation,
        }
    }

    fn into_transform(self) -> Transform {
        Transform {
            stamp_ns: self.header.stamp_ns(),
            parent: self.header.frame_id,
            child: self.child_frame_id,
            translation: self.translation,
            rotation: self.rotation,
        }
    }
}

pub(crate) fn transforms(encoding: Encoding, bytes: &[u8]) -> Result<Decoded<Vec<Transform>>> {
    const TYPE: MessageType = MessageType::Tf;
    let message = TYPE.name();
    match encoding {
        Encoding::Cdr => {
            let decoded = decode_cdr::<TfWire<TransformWire>>(message, bytes)?;
            Ok(decoded
                .map(|tf| tf.transforms.into_iter().map(TransformWire::into_transform).collect()))
        }
        Encoding::Ros1 => {
            let decoded = decode_ros1::<TfWire<Sequenced<TransformWire>>>(message, bytes)?;
            Ok(decoded.map(|tf| {
                tf.transforms.into_iter().map(|wire| wire.message.into_transform()).collect()
            }))
        }
        Encoding::Protobuf | Encoding::Json => {
            let expected = TYPE.encodings();
            Err(MessageError::WrongEncoding { message, expected, found: encoding })
        }
    }
}

/// Writes a `tf2_msgs/TFMessage`.
pub fn write_tf(encoding: Encoding, transforms: &[Transform]) -> Vec<u8> {
    let wires = transforms.iter().map(TransformWire::new);
    match encoding {
        Encoding::Cdr => encode_cdr(&TfWire { transforms: wires.collect() }),
        Encoding::Ros1 => {
            let sequenced = wires.map(|message| Sequenced { seq: 0, message });
            encode_ros1(&TfWire { transforms: sequenced.collect() })
        }
        Encoding::Protobuf | Encoding::Json => not_of_ros(encoding),
    }
}
