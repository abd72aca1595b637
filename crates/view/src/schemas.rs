//! JSON Schemas of the Foxglove messages in an overlay: names and fields as in `foxglove/foxglove-sdk`,
//! `schemas/jsonschema`.

use serde_json::{Map, Value, json};

/// A message type of an overlay.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Schema {
    FrameTransform,
    PointCloud,
    PosesInFrame,
    SceneUpdate,
}

impl Schema {
    /// The name, by which Foxglove recognizes the type.
    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::FrameTransform => "foxglove.FrameTransform",
            Self::PointCloud => "foxglove.PointCloud",
            Self::PosesInFrame => "foxglove.PosesInFrame",
            Self::SceneUpdate => "foxglove.SceneUpdate",
        }
    }

    /// The JSON Schema.
    pub(crate) fn json(self) -> Value {
        match self {
            Self::FrameTransform => object(
                self.name(),
                &[
                    ("timestamp", time()),
                    ("parent_frame_id", of("string")),
                    ("child_frame_id", of("string")),
                    ("translation", vector()),
                    ("rotation", quaternion()),
                ],
            ),
            Self::PointCloud => object(
                self.name(),
                &[
                    ("timestamp", time()),
                    ("frame_id", of("string")),
                    ("pose", pose()),
                    ("point_stride", of("integer")),
                    ("fields", array(&element_field())),
                    ("data", json!({ "type": "string", "contentEncoding": "base64" })),
                ],
            ),
            Self::PosesInFrame => object(
                self.name(),
                &[("timestamp", time()), ("frame_id", of("string")), ("poses", array(&pose()))],
            ),
            Self::SceneUpdate => object(
                self.name(),
                &[("deletions", array(&of("object"))), ("entities", array(&entity()))],
            ),
        }
    }
}

/// An object in which every field is required.
fn object(title: &str, fields: &[(&str, Value)]) -> Value {
    let names: Vec<&str> = fields.iter().map(|(name, _)| *name).collect();
    let properties: Map<String, Value> =
        fields.iter().map(|(name, schema)| ((*name).to_owned(), schema.clone())).collect();
    json!({ "title": title, "type": "object", "properties": properties, "required": names })
}

fn of(name: &str) -> Value {
    json!({ "type": name })
}

fn array(items: &Value) -> Value {
    json!({ "type": "array", "items": items })
}

fn numbers<const N: usize>(title: &str, names: [&str; N]) -> Value {
    object(title, &names.map(|name| (name, of("number"))))
}

fn time() -> Value {
    object("time", &[("sec", of("integer")), ("nsec", of("integer"))])
}

fn vector() -> Value {
    numbers("foxglove.Vector3", ["x", "y", "z"])
}

fn quaternion() -> Value {
    numbers("foxglove.Quaternion", ["x", "y", "z", "w"])
}

fn pose() -> Value {
    object("foxglove.Pose", &[("position", vector()), ("orientation", quaternion())])
}

fn color() -> Value {
    numbers("foxglove.Color", ["r", "g", "b", "a"])
}

fn element_field() -> Value {
    object(
        "foxglove.PackedElementField",
        &[("name", of("string")), ("offset", of("integer")), ("type", of("integer"))],
    )
}

fn key_value_pair() -> Value {
    object("foxglove.KeyValuePair", &[("key", of("string")), ("value", of("string"))])
}

/// An overlay has only lines. The other primitives are lists without entries.
fn entity() -> Value {
    let duration = object("duration", &[("sec", of("integer")), ("nsec", of("integer"))]);
    let line = object(
        "foxglove.LinePrimitive",
        &[
            ("type", of("integer")),
            ("pose", pose()),
            ("thickness", of("number")),
            ("scale_invariant", of("boolean")),
            ("points", array(&numbers("foxglove.Point3", ["x", "y", "z"]))),
            ("color", color()),
            ("colors", array(&color())),
            ("indices", array(&of("integer"))),
        ],
    );
    object(
        "foxglove.SceneEntity",
        &[
            ("timestamp", time()),
            ("frame_id", of("string")),
            ("id", of("string")),
            ("lifetime", duration),
            ("frame_locked", of("boolean")),
            ("metadata", array(&key_value_pair())),
            ("arrows", array(&of("object"))),
            ("cubes", array(&of("object"))),
            ("spheres", array(&of("object"))),
            ("cylinders", array(&of("object"))),
            ("lines", array(&line)),
            ("triangles", array(&of("object"))),
            ("texts", array(&of("object"))),
            ("models", array(&of("object"))),
        ],
    )
}
