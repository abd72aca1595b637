"""Parts of logs, and two logs joined into one."""

import struct

import mcap.reader
import numpy as np
from encode import STORES, pose_values, read, stamp_ns
from mcap.writer import Writer
from street import packet_starts

# Packets of the HDL-32E contain the time in microseconds since the last full hour.
HOUR_US = 3_600_000_000
# A part without revisits ends so long before the first one: between true poses, evaluate uses those near in
# time.
MARGIN_NS = 5_000_000_000
# Time between the last message of a log and the first one of the log that is joined to it.
GAP_NS = 100_000_000


def true_poses(log, topic):
    """Stamps [ns], x [m] and y [m] of the ground truth."""
    messages = list(read(log, topic, "geometry_msgs/msg/PoseStamped"))
    at = [(stamp_ns(m.header.stamp), m.pose.position.x, m.pose.position.y) for m in messages]
    stamps, x, y = zip(*sorted(at))
    return np.array(stamps), np.array(x), np.array(y)


def before_revisit_ns(log, topic, near_m=3.0, min_path_m=30.0):
    """A stamp before the first true pose that is near an earlier one."""
    stamps, x, y = true_poses(log, topic)
    path_m = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    for k, stamp in enumerate(stamps):
        earlier = path_m <= path_m[k] - min_path_m
        if (np.hypot(x[earlier] - x[k], y[earlier] - y[k]) <= near_m).any():
            return int(stamp) - MARGIN_NS
    raise ValueError(f"{log} has no revisit")


def stamped_later(data, schema, shift_ns):
    """A message in CDR whose stamps are later. Its first field is a header."""
    data = bytearray(data)

    def shift(at):
        sec, nanosec = struct.unpack_from("<iI", data, at)
        struct.pack_into("<iI", data, at, *divmod(sec * 10**9 + nanosec + shift_ns, 10**9))

    shift(4)
    if schema == "velodyne_msgs/msg/VelodyneScan":
        for start in packet_starts(data):
            shift(start)
            device = start + 8 + 1200
            (us,) = struct.unpack_from("<I", data, device)
            struct.pack_into("<I", data, device, (us + shift_ns // 1000) % HOUR_US)
    return bytes(data)


def odometry_pose(message):
    at, turn = message.pose.pose.position, message.pose.pose.orientation
    return np.array([at.x, at.y]), 2 * np.arctan2(turn.z, turn.w)


def continued(data, first, last):
    """A nav_msgs/Odometry in CDR. Its pose relative to `first` becomes the pose relative to `last`."""
    name = "nav_msgs/msg/Odometry"
    message = STORES["cdr"].deserialize_cdr(data, name)
    position, heading = odometry_pose(message)
    turn = last[1] - first[1]
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    x, y = last[0] + rotation @ (position - first[0])
    values = pose_values(x, y, heading + turn)
    for part in ("position", "orientation"):
        for axis, value in values[part].items():
            setattr(getattr(message.pose.pose, part), axis, float(value))
    return bytes(STORES["cdr"].serialize_cdr(message, name))


class Log:
    """Writes a log from messages of other logs."""

    def __init__(self, path):
        self.file = open(path, "wb")
        self.writer = Writer(self.file)
        self.writer.start()
        self.channels = {}
        self.last_ns, self.last_odometry = 0, None

    def add(self, log, end_ns=None, without=(), start_ns=None):
        """Adds the messages of a log from `start_ns` and before `end_ns`, except those of some topics. The
        stamps and the odometry continue those of the messages that were added before."""
        shift_ns, last, first = None, self.last_odometry, None
        with open(log, "rb") as file:
            for schema, channel, message in mcap.reader.make_reader(file).iter_messages(start_time=start_ns, end_time=end_ns):
                if channel.topic in without:
                    continue
                if shift_ns is None:
                    shift_ns = self.last_ns + GAP_NS - message.log_time if self.last_ns else 0
                data = message.data
                if schema.name == "nav_msgs/msg/Odometry":
                    first = first or odometry_pose(STORES["cdr"].deserialize_cdr(data, schema.name))
                    data = continued(data, first, last or first)
                    self.last_odometry = odometry_pose(STORES["cdr"].deserialize_cdr(data, schema.name))
                data = stamped_later(data, schema.name, shift_ns)
                ns = message.log_time + shift_ns
                self.writer.add_message(self.channel(schema, channel), ns, data, ns)
                self.last_ns = ns
        return self.last_ns

    def channel(self, schema, channel):
        if channel.topic not in self.channels:
            schema_id = self.writer.register_schema(schema.name, schema.encoding, schema.data)
            self.channels[channel.topic] = self.writer.register_channel(
                channel.topic, channel.message_encoding, schema_id
            )
        return self.channels[channel.topic]

    def finish(self):
        self.writer.finish()
        self.file.close()
