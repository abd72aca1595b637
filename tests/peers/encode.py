"""Writes logs with other libraries, and reads ROS 2 logs. `mcap` writes the containers, `rosbags` the
ROS messages and `foxglove-schemas-protobuf` the protocol buffers."""

import base64
import json
import os

import mcap.reader
import numpy as np
from foxglove_schemas_protobuf import LaserScan_pb2, PointCloud_pb2, PoseInFrame_pb2
from mcap.writer import CompressionType, Writer
from mcap_protobuf.schema import register_schema
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

STORES = {"ros1": get_typestore(Stores.ROS1_NOETIC), "cdr": get_typestore(Stores.ROS2_HUMBLE)}
for store in STORES.values():
    velodyne = "builtin_interfaces/Time stamp\nuint8[1206] data"
    store.register(get_types_from_msg(velodyne, "velodyne_msgs/msg/VelodynePacket"))
    velodyne = "std_msgs/Header header\nvelodyne_msgs/VelodynePacket[] packets"
    store.register(get_types_from_msg(velodyne, "velodyne_msgs/msg/VelodyneScan"))
FOXGLOVE = {
    "foxglove.LaserScan": LaserScan_pb2.LaserScan,
    "foxglove.PointCloud": PointCloud_pb2.PointCloud,
    "foxglove.PoseInFrame": PoseInFrame_pb2.PoseInFrame,
}


def time(ns):
    return {"sec": ns // 10**9, "nanosec": ns % 10**9}


def header(ns):
    return {"stamp": time(ns), "frame_id": "a frame"}


def pose_values(x, y, heading):
    """A pose in the plane, as a geometry_msgs/Pose."""
    orientation = {"x": 0.0, "y": 0.0, "z": np.sin(heading / 2), "w": np.cos(heading / 2)}
    return {"position": {"x": x, "y": y, "z": 0.0}, "orientation": orientation}


def foxglove(ns, pose=None):
    """The fields that all Foxglove messages have."""
    level = {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    origin = {"position": {"x": 0.0, "y": 0.0, "z": 0.0}, "orientation": level}
    stamp = {"seconds": ns // 10**9, "nanos": ns % 10**9}
    return {"timestamp": stamp, "frame_id": "a frame", "pose": pose or origin}


def ros(store, name, values):
    """A message of a rosbags type. Fields that `values` lacks are zero."""

    def of(kind, what, value):
        if kind == Nodetype.NAME:
            return ros(store, what, value or {})
        if kind == Nodetype.BASE:
            return value if value is not None else "" if what[0] == "string" else 0
        (kind, element), n = what
        if kind == Nodetype.NAME:
            return [ros(store, element, v) for v in value]
        return np.asarray(np.zeros(n) if value is None else value, element[0])

    fields = store.fielddefs[name][1]
    return store.types[name](*(of(*field, values.get(key)) for key, field in fields))


def plain(value):
    """The value in types that JSON has."""
    if isinstance(value, dict):
        if value.keys() == {"seconds", "nanos"}:
            return {"sec": value["seconds"], "nsec": value["nanos"]}
        return {key: plain(v) for key, v in value.items()}
    if isinstance(value, (list, np.ndarray)):
        return [plain(v) for v in value]
    if isinstance(value, bytes):
        return base64.b64encode(value).decode()
    if isinstance(value, float) and not np.isfinite(value):
        return None if np.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    return value


def encode(name, encoding, values):
    if encoding == "protobuf":
        return FOXGLOVE[name](**values).SerializeToString()
    if encoding == "json":
        return json.dumps(plain(values)).encode()
    if encoding == "ros1":
        return bytes(STORES["ros1"].serialize_ros1(ros(STORES["ros1"], name, values), name))
    message, is_little = ros(STORES["cdr"], name, values), encoding == "cdr"
    return bytes(STORES["cdr"].serialize_cdr(message, name, little_endian=is_little))


def write(path, messages, schema="full", compression=CompressionType.ZSTD, **options):
    """Writes messages (topic, type, encoding, stamp [ns], values) into a log whose schemas are
    "full", "empty", "partial" (a truncated text) or "none"."""
    os.makedirs(os.path.dirname(path), exist_ok=True)
    with open(path, "wb") as log:
        writer = Writer(log, compression=compression, **options)
        writer.start()
        channels = {}
        for topic, name, encoding, ns, values in messages:
            if (topic, name) not in channels:
                channels[topic, name] = register(writer, topic, name, encoding, schema)
            writer.add_message(channels[topic, name], ns, encode(name, encoding, values), ns)
        writer.finish()


def register(writer, topic, name, encoding, schema):
    text = None
    message_encoding = encoding.removesuffix("-big-endian")
    if schema == "none":
        return writer.register_channel(topic, message_encoding, 0)
    if encoding == "protobuf":
        return writer.register_channel(topic, encoding, register_schema(writer, FOXGLOVE[name]))
    if encoding == "json":
        kind, text = "jsonschema", "{}"
    else:
        version = 1 if encoding == "ros1" else 2
        text, _ = STORES[message_encoding].generate_msgdef(name, ros_version=version)
        name = name.replace("/msg/", "/") if version == 1 else name
        kind = f"ros{version}msg"
    text = {"full": text, "empty": "", "partial": text[: len(text) // 3]}[schema]
    schema_id = writer.register_schema(name, kind, text.encode())
    return writer.register_channel(topic, message_encoding, schema_id)


def read(path, topic, name):
    with open(path, "rb") as log:
        for _, _, message in mcap.reader.make_reader(log).iter_messages(topics=[topic]):
            yield STORES["cdr"].deserialize_cdr(message.data, name)


def stamp_ns(stamp):
    return stamp.sec * 10**9 + stamp.nanosec
