//! `foxglove.PoseInFrame` and `foxglove.FrameTransform`.

use prost::Message;
use serde::{Deserialize, Serialize};

use super::{Pose, Quaternion, Timestamp, Vector3, decode, required, stamp_ns};
use crate::wire::Decoded;
use crate::{Encoding, MessageType, Result, StampedPose3, Transform};

#[derive(Clone, PartialEq, Message, Serialize, Deserialize)]
#[serde(default)]
pub(super) struct PoseInFrameWire {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    pub(super) frame_id: String,
    #[prost(message, optional, tag = "3")]
    pub(super) pose: Option<Pose>,
}

#[derive(Clone, PartialEq, Message, Serialize, Deserialize)]
#[serde(default)]
pub(super) struct FrameTransformWire {
    #[prost(message, optional, tag = "1")]
    pub(super) timestamp: Option<Timestamp>,
    #[prost(string, tag = "2")]
    pub(super) parent_frame_id: String,
    #[prost(string, tag = "3")]
    pub(super) child_frame_id: String,
    #[prost(message, optional, tag = "4")]
    pub(super) translation: Option<Vector3>,
    #[prost(message, optional, tag = "5")]
    pub(super) rotation: Option<Quaternion>,
}

pub(crate) fn pose(encoding: Encoding, bytes: &[u8]) -> Result<Decoded<StampedPose3>> {
    const TYPE: MessageType = MessageType::FoxglovePoseInFrame;
    let Decoded { value: wire, n_left } = decode::<PoseInFrameWire>(TYPE, encoding, bytes)?;
    let pose = required(TYPE, "pose", wire.pose)?;
    let pose = StampedPose3 {
        stamp_ns: stamp_ns(TYPE, wire.timestamp)?,
        position: vector(required(TYPE, "position", pose.position)?),
        orientation: quaternion(required(TYPE, "orientation", pose.orientation)?),
    };
    Ok(Decoded { value: pose, n_left })
}

pub(crate) fn transform(encoding: Encoding, bytes: &[u8]) -> Result<Decoded<Transform>> {
    const TYPE: MessageType = MessageType::FoxgloveFrameTransform;
    let Decoded { value: wire, n_left } = decode::<FrameTransformWire>(TYPE, encoding, bytes)?;
    let transform = Transform {
        stamp_ns: stamp_ns(TYPE, wire.timestamp)?,
        parent: wire.parent_frame_id,
        child: wire.child_frame_id,
        translation: vector(required(TYPE, "translation", wire.translation)?),
        rotation: quaternion(required(TYPE, "rotation", wire.rotation)?),
    };
    Ok(Decoded { value: transform, n_left })
}

fn vector(Vector3 { x, y, z }: Vector3) -> [f64; 3] {
    [x, y, z]
}

fn quaternion(Quaternion { x, y, z, w }: Quaternion) -> [f64; 4] {
    [x, y, z, w]
}
